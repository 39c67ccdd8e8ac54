"""Bodies that another may touch, against every pair of boxes in integers."""

import numpy as np
import pytest
import warp as wp
from scenes import FACE

import ccd_warp as ccd
from ccd_warp._engine.boxes import body_boxes
from ccd_warp._engine.boxes.body_boxes import bodies_near
from ccd_warp._engine.mesh.topology import Topology
from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.threads import StopFlag


@pytest.fixture(autouse=True, params=["tree", "all with all"])
def way(request, monkeypatch):
    """Both ways, also for numbers of bodies for which the other one is faster."""
    monkeypatch.setattr(body_boxes, "_FEW_BODIES", 0 if request.param == "tree" else 1 << 30)


def near(mesh, start, end, inflation=0.0):
    device = wp.get_device("cpu")
    return bodies_near(
        Topology.of(mesh, device), mesh.frames(start, end), inflation, Execution(device, 2, StopFlag(device))
    )


@pytest.mark.parametrize("num_bodies", [2, 16, 17, 300])
@pytest.mark.parametrize("inflation", [0.0, 0.25])
def test_bodies_near_another_are_those_of_every_pair_of_boxes(num_bodies, inflation):
    """On a lattice, so that many boxes touch in a point, an edge or a side, and none is an ulp from another."""
    rng = np.random.default_rng(num_bodies)
    for share in (1.0, 0.5):
        places = rng.integers(0, round(2.0 * num_bodies ** (1 / 3)) + 1, (num_bodies, 1, 3))
        x = 0.5 * rng.integers(0, 2, (num_bodies, 3, 3)) + places
        pairs = rng.random((num_bodies, num_bodies)) < share
        static = rng.random(num_bodies) < 0.2
        mesh = ccd.CollisionMesh.from_arrays(
            [(triangle, FACE) for triangle in x],
            static=np.flatnonzero(static),
            self_collision=rng.random(num_bodies) < 0.2,
            body_pairs=pairs & pairs.T,
            exclude_pairs={"bodies": rng.integers(0, num_bodies, (num_bodies // 4, 2))},
        )
        y = x + 0.5 * rng.integers(-1, 2, (num_bodies, 1, 3)) * ~static[:, None, None]
        low, high = (f(np.concatenate([x, y], axis=1), axis=1) for f in (np.min, np.max))
        is_possible = (pairs & pairs.T) & ~np.eye(num_bodies, dtype=bool)
        for a, b in mesh.exclude_pairs.get("bodies", ()):
            is_possible[a, b] = is_possible[b, a] = False
        touch = (np.maximum(low[:, None] - high, low - high[:, None]).max(axis=2) <= 2 * inflation) & is_possible
        expected = (mesh.self_collision | touch.any(axis=1)) & ~static
        assert near(mesh, mesh.vertices, y.reshape(-1, 3), inflation).tolist() == expected.tolist()


def test_bodies_that_touch_in_one_point_or_miss_by_one_ulp_at_any_size_and_place():
    corner = np.array([[0.0, 0, 0], [0.25, 0, 0], [0.25, 0.25, 0.25]])
    for scale in (1e-320, 1e-160, 1.0, 1e150, 1.7e308):
        for offset in (0.0, 1.0):
            parts = [0.5 * scale * (corner + offset + shift) for shift in (0.0, 0.25, [0.5, 0.75, 0.75])]
            mesh = ccd.CollisionMesh.from_arrays([(part, FACE) for part in parts], self_collision=False)
            assert near(mesh, mesh.vertices, mesh.vertices).tolist() == [True, True, False]
    beside = 4 * corner + [np.nextafter(1.0, 2.0), 0, 0]
    for many, expected in (([4 * corner, beside], False), ([4 * corner, beside, 1e30 * (corner - 0.1)], True)):
        mesh = ccd.CollisionMesh.from_arrays([(part, FACE) for part in many], self_collision=False)
        assert (near(mesh, mesh.vertices, mesh.vertices) == expected).all()
