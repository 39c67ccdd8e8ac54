"""The cloth of the example stays where it is with CCD, and does not without, as CGAL sees it."""

import numpy as np
import pytest
from conftest import loaded_example

RESOLUTION, NUM_FRAMES = 21, 15


@pytest.fixture(scope="module")
def cloth_drop():
    pytest.importorskip("igl.copyleft.cgal", reason="the extra examples is not installed")
    with loaded_example("cloth_drop") as module:
        yield module


def _counts(module, with_ccd: bool) -> tuple[list[int], np.ndarray]:
    scene = module.ClothDrop(RESOLUTION, with_ccd=with_ccd)
    counts = [module.intersecting_pairs(frame, scene.mesh.faces) for frame in scene.frames(NUM_FRAMES)]
    return counts, np.linalg.norm(scene.positions[: scene.num_cloth], axis=1)


def test_no_faces_intersect_with_ccd(cloth_drop):
    counts, radius = _counts(cloth_drop, True)
    assert counts == [0] * NUM_FRAMES
    assert radius.max() < cloth_drop.GLOBE_RADIUS


def test_the_steps_are_too_large_without_ccd(cloth_drop):
    assert max(_counts(cloth_drop, False)[0]) > 0


def test_the_check_sees_a_crossing(cloth_drop):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1], [0.4, 0.2, 1.0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)
    assert cloth_drop.intersecting_pairs(vertices, faces) == 1
    assert cloth_drop.intersecting_pairs(vertices + [[0], [0], [0], [2], [2], [2]], faces) == 0


def test_springs_of_a_group_share_no_vertex(cloth_drop):
    groups = cloth_drop.cloth_springs(7)
    assert all(len(np.unique(pairs)) == pairs.size for pairs, _ in groups)
    every = np.sort(np.vstack([pairs for pairs, _ in groups]), axis=1)
    assert len(np.unique(every, axis=0)) == len(every) == 2 * 7 * 6 + 2 * 6 * 6 + 2 * 7 * 5
