"""A newton cloth passes through nothing with ccd_warp, and does without, by exact arithmetic on integers.

Optional: `pip install -e '.[test,newton]'`.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from conftest import loaded_example

pytest.importorskip("newton", reason="the extra newton is not installed")

import ccd_warp as ccd

RESOLUTION, NUM_STEPS = 16, 6


@pytest.fixture(scope="module")
def newton_cloth():
    with loaded_example("newton_cloth") as module:
        yield module


def _integers(vertices: np.ndarray) -> np.ndarray:
    """Coordinates as Python integers, all by one power of two: exact for floats that are multiples of 2^-200."""
    scaled = [int(x * 2.0**200) for x in np.asarray(vertices, dtype=np.float64).ravel()]
    return np.array(scaled, dtype=object).reshape(-1, 3)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    x, y, z = a.T
    u, v, w = b.T
    return np.column_stack([y * w - z * v, z * u - x * w, x * v - y * u])


def _side(a: np.ndarray, b: np.ndarray, c: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Sign of the volume of a, b, c, p, exactly."""
    volume = (_cross(b - a, c - a) * (p - a)).sum(axis=1)
    return np.array([(x > 0) - (x < 0) for x in volume], dtype=int)


def _meet_in_plane(p: np.ndarray, q: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> bool:
    """Whether the edge pq touches the triangle abc, all in one plane: no line along a side of either parts them."""
    normal = _cross((b - a)[None], (c - a)[None])[0]
    kept = [k for k in range(3) if k != max(range(3), key=lambda k: abs(normal[k]))]
    edge, triangle = [x[kept] for x in (p, q)], [x[kept] for x in (a, b, c)]
    sides = [edge, *([triangle[k], triangle[k - 1]] for k in range(3))]
    axes = [(m[1] - n[1], n[0] - m[0]) for m, n in sides] + [tuple(edge[1] - edge[0])]
    for x, y in axes:
        first, second = ([x * point[0] + y * point[1] for point in points] for points in (edge, triangle))
        if max(first) < min(second) or max(second) < min(first):
            return False
    return True


def _num_crossings(mesh: ccd.CollisionMesh, vertices: np.ndarray) -> int:
    """Pairs of an edge and a face, without a common vertex and not both static, that touch or cross.

    Two triangles without a common vertex meet only where an edge of one meets the other.
    """
    low, high = vertices[mesh.edges].min(axis=1), vertices[mesh.edges].max(axis=1)
    face_low, face_high = vertices[mesh.faces].min(axis=1), vertices[mesh.faces].max(axis=1)
    pairs = []
    for face in range(len(mesh.faces)):
        near = np.flatnonzero(((low <= face_high[face]) & (face_low[face] <= high)).all(axis=1))
        common = (mesh.edges[near][:, :, None] == mesh.faces[face]).any(axis=(1, 2))
        is_static = mesh.static[mesh.edge_body[near]] & mesh.static[mesh.face_body[face]]
        pairs.append(np.column_stack([near[~common & ~is_static], np.full((~common & ~is_static).sum(), face)]))
    edge, face = np.vstack(pairs).T
    exact = _integers(vertices)
    p, q = exact[mesh.edges[edge]].transpose(1, 0, 2)
    a, b, c = exact[mesh.faces[face]].transpose(1, 0, 2)
    p_side, q_side = _side(a, b, c, p), _side(a, b, c, q)
    around = np.column_stack([_side(p, q, a, b), _side(p, q, b, c), _side(p, q, c, a)])
    within = (around >= 0).all(axis=1) | (around <= 0).all(axis=1)
    flat = (p_side == 0) & (q_side == 0)
    num_flat = sum(_meet_in_plane(*points) for points in zip(*(x[flat] for x in (p, q, a, b, c)), strict=True))
    return int(((p_side * q_side <= 0) & within & ~flat).sum()) + num_flat


class Throw(NamedTuple):
    """What is seen of a cloth after each step."""

    crossings: list[int]
    below: list[int]  # vertices below the plate
    stretch: list[float]  # 99th percentile
    height: np.ndarray  # of its lowest and highest vertex, shape [steps, 2]


@cache
def _thrown(module, mode: str) -> Throw:
    throw = module.ClothThrow(mode, RESOLUTION)
    frames, count = [throw.step() for _ in range(NUM_STEPS)], throw.model.particle_count
    return Throw(
        [_num_crossings(throw.mesh, frame) for frame in frames],
        [module.vertices_below_plate(throw.mesh, frame) for frame in frames],
        [module.stretch(throw.mesh, frame) for frame in frames],
        np.array([[frame[:count, 2].min(), frame[:count, 2].max()] for frame in frames]),
    )


@pytest.mark.parametrize("mode", ["iterations", "end"])
def test_cloth_passes_through_nothing_with_ccd(newton_cloth, mode):
    thrown = _thrown(newton_cloth, mode)
    assert thrown.crossings == [0] * NUM_STEPS
    assert thrown.below == [0] * NUM_STEPS


def test_contacts_as_forces_keep_the_cloth_at_its_thickness_from_both_obstacles(newton_cloth):
    thrown = _thrown(newton_cloth, "iterations")
    # 1.7 at most and 1.4 at the end; 2.2 with the contacts left out, 3.0 with those of obstacles turned
    assert max(thrown.stretch) < 1.9 and thrown.stretch[-1] < 1.6
    thickness = 0.7 * newton_cloth.THICKNESS  # forces give way a little
    lowest, highest = thrown.height[-1]
    assert newton_cloth.PLATE_TOP + thickness < lowest < newton_cloth.PLATE_TOP + 3 * thickness
    assert newton_cloth.BALL_RADIUS + thickness < highest < newton_cloth.BALL_RADIUS + 3 * thickness


def test_the_steps_are_too_large_without_ccd(newton_cloth):
    thrown = _thrown(newton_cloth, "newton")
    assert max(thrown.crossings) > 0
    assert thrown.below[-1] == (RESOLUTION + 1) ** 2


def test_the_check_sees_a_crossing():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1], [0.4, 0.2, 1.0]])
    mesh = ccd.CollisionMesh.from_arrays([(vertices[:3], [[0, 1, 2]]), (vertices[3:], [[0, 1, 2]])])
    assert _num_crossings(mesh, vertices) > 0
    assert _num_crossings(mesh, vertices + [[0], [0], [0], [2], [2], [2]]) == 0
