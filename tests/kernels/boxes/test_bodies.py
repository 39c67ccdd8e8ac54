"""Bodies that another may touch, against every pair of boxes in integers."""

import numpy as np
import pytest
import warp as wp

import ccd_warp as ccd
from ccd_warp._engine.boxes import body_boxes
from ccd_warp._engine.boxes.body_boxes import bodies_near
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.threads import StopFlag

FACE = np.array([[0, 1, 2]])
NO_VERTICES = (np.zeros((0, 3)), FACE[:0])


@pytest.fixture(autouse=True, params=["tree", "all with all"])
def way(request, monkeypatch):
    """Both ways, also for numbers of bodies for which the other one is faster."""
    monkeypatch.setattr(body_boxes, "_FEW_BODIES", 0 if request.param == "tree" else 1 << 30)


def near(mesh, start, end, inflation=0.0, num_threads=2):
    device = wp.get_device("cpu")
    execution = Execution(device, num_threads, StopFlag(device))
    return bodies_near(Topology.of(mesh, device), mesh.frames(start, end), inflation, execution)


def near_exactly(mesh, start, end, inflation=0.0):
    """By every pair of boxes, in integers: coordinates and inflation are multiples of a quarter."""
    quarters = np.stack([start, end]) * 4
    assert (quarters == np.round(quarters)).all() and 4 * inflation == round(4 * inflation)
    filled = np.flatnonzero(np.diff(mesh.body_vertex_range))
    first = mesh.body_vertex_range[filled]
    low = np.minimum.reduceat(quarters.min(axis=0).astype(np.int64), first, axis=0)
    high = np.maximum.reduceat(quarters.max(axis=0).astype(np.int64), first, axis=0)
    gap = np.maximum(low[:, None] - high, low - high[:, None]).max(axis=2)
    is_possible = ~np.eye(len(filled), dtype=bool)
    if mesh.body_pairs is not None:
        is_possible &= mesh.body_pairs[np.ix_(filled, filled)]
    for a, b in mesh.exclude_pairs.get("bodies", []):
        is_possible[np.ix_(filled == a, filled == b)] = is_possible[np.ix_(filled == b, filled == a)] = False
    expected = mesh.self_collision.copy()
    expected[filled] |= (is_possible & (gap <= round(8 * inflation))).any(axis=1)
    return expected & ~mesh.static


@pytest.mark.parametrize("num_bodies", [2, 15, 16, 17, 40, 300])
@pytest.mark.parametrize("with_pairs", [False, True])
@pytest.mark.parametrize("inflation", [0.0, 0.25])
def test_bodies_near_another_are_those_of_every_pair_of_boxes(num_bodies, with_pairs, inflation):
    """On a lattice, so that many boxes touch in a point, an edge or a side."""
    rng = np.random.default_rng(num_bodies)
    for _ in range(4):
        places = rng.integers(0, round(2.0 * num_bodies ** (1 / 3)) + 1, (num_bodies, 3))
        triangles = 0.5 * rng.integers(0, 2, (num_bodies, 3, 3)) + places[:, None]
        bodies = [NO_VERTICES if rng.random() < 0.1 else (triangle, FACE) for triangle in triangles]
        pairs = rng.random((num_bodies, num_bodies)) < 0.5
        excluded = [(a, b) for a, b in rng.integers(0, num_bodies, (num_bodies // 2, 2)) if a != b]
        mesh = ccd.CollisionMesh.from_arrays(
            bodies,
            static=np.flatnonzero(rng.random(num_bodies) < 0.2),
            self_collision=rng.random(num_bodies) < 0.2,
            body_pairs=pairs | pairs.T if with_pairs else None,
            exclude_pairs={"bodies": excluded} if excluded else None,
        )
        end = mesh.vertices + 0.5 * rng.integers(-1, 2, (num_bodies, 3))[mesh.vertex_body] * ~mesh.static[
            mesh.vertex_body
        ].reshape(-1, 1)
        expected = near_exactly(mesh, mesh.vertices, end, inflation)
        # rounding outward may bring in boxes that are an ulp apart, and on this lattice none is
        assert np.array_equal(near(mesh, mesh.vertices, end, inflation), expected)


@pytest.mark.parametrize("scale", [1e-320, 1e-160, 1.0, 1e150, 1.7e308])
@pytest.mark.parametrize("offset", [0.0, 1.0])
def test_bodies_that_touch_in_one_point_are_near_at_any_size_and_place(scale, offset):
    corner = np.array([[0.0, 0, 0], [0.25, 0, 0], [0.25, 0.25, 0.25]])
    points = np.concatenate([corner, corner + 0.25, corner + [0.5, 0.75, 0.75]])
    start = 0.5 * scale * (points + offset)
    mesh = ccd.CollisionMesh.from_arrays([(part, FACE) for part in np.split(start, 3)], self_collision=False)
    assert near(mesh, start, start).tolist() == [True, True, False]


def test_bodies_one_ulp_apart_are_not_near_and_a_giant_one_meets_all():
    cube = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 1]])
    start = np.concatenate([cube, cube + [np.nextafter(1.0, 2.0), 0, 0]])
    mesh = ccd.CollisionMesh.from_arrays([(part, FACE) for part in np.split(start, 2)], self_collision=False)
    assert near(mesh, start, start).tolist() == [False, False]
    many = [cube + [3.0 * k, 0, 0] for k in range(40)]
    giant = 1e30 * (cube - 0.5)
    mesh = ccd.CollisionMesh.from_arrays([(part, FACE) for part in [*many, giant]], self_collision=False)
    assert near(mesh, mesh.vertices, mesh.vertices).all()
    assert not near(
        ccd.CollisionMesh.from_arrays([(part, FACE) for part in many], self_collision=False),
        *[np.concatenate(many)] * 2,
    ).any()


def test_bodies_without_vertices_are_near_nothing():
    triangle = np.array([[-1.0, -1, -1], [1, 0, 0], [0, 1, 1]])
    bodies = [(triangle, FACE), NO_VERTICES, NO_VERTICES]
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=False)
    assert not near(mesh, triangle, triangle).any()
    pipeline = ccd.CollisionPipeline(mesh)
    assert pipeline.mesh_ccd(triangle, triangle).toi == np.inf
    assert pipeline.counts.num_active_bodies == 0
