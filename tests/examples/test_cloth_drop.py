"""The cloth of the example hangs over the ball, unstretched and in the globe; without CCD faces intersect, by CGAL."""

from typing import NamedTuple

import numpy as np
import pytest
from conftest import loaded_example

RESOLUTION, NUM_FRAMES = 21, 15


@pytest.fixture(scope="module")
def cloth_drop():
    pytest.importorskip("igl.copyleft.cgal", reason="the extra examples is not installed")
    with loaded_example("cloth_drop") as module:
        yield module


class Drop(NamedTuple):
    """What is seen of a cloth in some frames: pairs of faces that intersect, stretch, and where it is at the end."""

    counts: list[int]
    stretch: np.ndarray  # 1st and 99th percentile of the lengths of edges over those at rest, shape [frames, 2]
    cloth: np.ndarray  # relative to the obstacle
    edge_length: float


def intersecting_pairs(vertices, faces):
    """Number of pairs of faces that intersect beyond a vertex or an edge that they share, by CGAL's exact kernel."""
    from igl.copyleft import cgal

    return len(cgal.remesh_self_intersections(vertices, faces.astype(np.int64), detect_only=True)[2])


def lengths(scene, vertices):
    """Lengths of the cloth's edges along its threads, as multiples of their lengths at rest."""
    edges = scene.mesh.edges[scene.mesh.edge_body == 0]
    now, rest = (np.linalg.norm(np.subtract(*x[edges.T]), axis=1) for x in (vertices, scene.mesh.vertices))
    is_side = rest < 1.1 * scene.edge_length
    return now[is_side] / rest[is_side]


@pytest.fixture(scope="module")
def drop(cloth_drop):
    """The cloth with CCD."""
    scene = cloth_drop.ClothDrop(RESOLUTION, with_ccd=True)
    counts, stretch = [], []
    for frame in scene.frames(NUM_FRAMES):
        counts.append(intersecting_pairs(frame, scene.mesh.faces))
        stretch.append(np.quantile(lengths(scene, frame), [0.01, 0.99]))
    return Drop(counts, np.array(stretch), scene.positions[: scene.num_cloth], scene.edge_length)


def test_no_faces_intersect_with_ccd(drop):
    assert drop.counts == [0] * NUM_FRAMES


def test_the_cloth_keeps_its_size(drop):
    # 0.998 and 1.013; 0.17 and 3.3 with the planes of some pairs turned to their other sides
    assert drop.stretch.min() > 0.97 and drop.stretch.max() < 1.05


def test_the_cloth_hangs_over_the_ball_in_the_globe(cloth_drop, drop):
    assert np.linalg.norm(drop.cloth, axis=1).max() < cloth_drop.GLOBE_RADIUS
    centre = np.array([0.0, 0.0, cloth_drop.BALL_HEIGHT])
    assert np.linalg.norm(drop.cloth - centre, axis=1).min() > cloth_drop.BALL_RADIUS
    height = drop.cloth[:, 2] - centre[2]
    assert cloth_drop.BALL_RADIUS < height.max() < cloth_drop.BALL_RADIUS + 0.5 * drop.edge_length
    # its corners are 0.64 from its middle, and the ball is 0.44 across
    assert height.min() < -0.5 * cloth_drop.BALL_RADIUS


def test_the_steps_are_too_large_without_ccd(cloth_drop):
    scene = cloth_drop.ClothDrop(RESOLUTION, with_ccd=False)
    assert any(intersecting_pairs(frame, scene.mesh.faces) for frame in scene.frames(NUM_FRAMES))


def test_the_check_sees_a_crossing(cloth_drop):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1], [0.4, 0.2, 1.0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)
    assert intersecting_pairs(vertices, faces) == 1
    assert intersecting_pairs(vertices + [[0], [0], [0], [2], [2], [2]], faces) == 0


def test_springs_of_a_group_share_no_vertex(cloth_drop):
    groups = [(one.ravel(), other.ravel()) for one, other, _ in cloth_drop.cloth_springs(np.arange(49).reshape(7, 7))]
    assert all(len(np.unique(pairs)) == 2 * len(pairs[0]) for pairs in groups)
    every = np.sort(np.concatenate(groups, axis=1).T, axis=1)
    assert len(np.unique(every, axis=0)) == len(every) == 2 * 7 * 6 + 2 * 6 * 6 + 2 * 7 * 5
