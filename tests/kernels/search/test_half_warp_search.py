"""The search and the cull of CUDA, run on the CPU: what they find is what the walk of the CPU finds."""

import numpy as np
import pytest
import warp as wp
from launches import check_same, on_device
from scenes import cables_and_particles, cloth_and_ball_in_worlds, crowd, leaning_stack, sheet, single, soup

import ccd_warp as ccd
from ccd_warp._engine import stages
from ccd_warp._runtime.launch import Execution


@pytest.fixture
def as_on_cuda(monkeypatch):
    """A function after whose call kernels are launched as on CUDA."""
    return lambda: monkeypatch.setattr(Execution, "is_cuda", True)


def three_bodies(**options):
    """Three bodies of faces at random places that move at random."""
    rng = np.random.default_rng(5)
    bodies = [soup(rng, count, 0.08) for count in (120, 120, 60)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, **options)
    start = np.concatenate([vertices for vertices, _ in bodies])
    end = start + 0.1 * rng.standard_normal(start.shape)
    is_static = mesh.static[mesh.vertex_body]
    end[is_static] = start[is_static]
    return mesh, start, end


def rings():
    vertices, faces = sheet(12)
    mesh = ccd.CollisionMesh.from_arrays([(vertices, faces)], exclusion_rings=3)
    return mesh, vertices, vertices + 0.08 * np.random.default_rng(6).standard_normal(vertices.shape)


def worlds():
    _, mesh, start, end = cloth_and_ball_in_worlds(5)
    return mesh, start.reshape(-1, 3), end.reshape(-1, 3)


def cables():
    start, faces, edges = cables_and_particles(np.random.default_rng(7), 60, 0.05)
    mesh = ccd.CollisionMesh.from_arrays([(start, faces, edges)], codimensional_points=True)
    return mesh, start, start + 0.08 * np.random.default_rng(8).standard_normal(start.shape)


def plane():
    rng = np.random.default_rng(9)
    points, edges = rng.random((200, 2)), np.arange(200).reshape(-1, 2)
    mesh = ccd.CollisionMesh.from_arrays([(points[:100], edges[:50]), (points[100:], edges[:50])], static=[1])
    return mesh, points, np.concatenate([points[:100] + 0.1 * rng.standard_normal((100, 2)), points[100:]])


def equal_coordinates():
    """Corners on a coarse lattice, so that sides of boxes are equal in quantized coordinates."""
    start = np.round(8 * np.random.default_rng(3).random((240, 3))) / 8
    return single(start, np.arange(240).reshape(-1, 3)), start, np.roll(start, 9, axis=0)


LISTED = {"bodies": [(0, 2)], "edge_edge": [(0, 400), (3, 5), (10, 500)], "vertex_face": [(0, 130)]}
NOT_TWO = np.array([[1, 0, 1], [0, 1, 1], [1, 1, 1]], dtype=bool)
SCENES = {
    "crowd, four levels": lambda: crowd(np.random.default_rng(1), 1500, 0.02),
    "one body": lambda: crowd(np.random.default_rng(2), 5, 0.3),
    "moving and static bodies": lambda: three_bodies(static=[1]),
    "static bodies first and last": lambda: three_bodies(static=[0, 2]),
    "no self-collision": lambda: three_bodies(self_collision=False),
    "bodies that may not collide": lambda: three_bodies(body_pairs=NOT_TWO),
    "listed pairs": lambda: three_bodies(exclude_pairs=LISTED),
    "rings": rings,
    "worlds": worlds,
    "cables and particles": cables,
    "in the plane": plane,
    "equal coordinates": equal_coordinates,
    "all boxes overlap": lambda: leaning_stack(60, 1e-3),
}


@pytest.mark.parametrize("scene", SCENES)
def test_half_warps_find_the_same_pairs(scene, as_on_cuda):
    mesh, start, end = SCENES[scene]()
    expected = [ccd.find_candidates(mesh, start, end, inflation=x).sorted() for x in (0.0, 0.003)]
    result = ccd.mesh_ccd(mesh, start, end, minimum_separation=0.003)
    step = ccd.collision_free_step(mesh, start, end)
    as_on_cuda()
    for inflation, pairs in zip((0.0, 0.003), expected, strict=True):
        found = ccd.find_candidates(mesh, start, end, inflation=inflation)
        for name, values in vars(pairs).items():
            np.testing.assert_array_equal(getattr(found, name), values)
    other = ccd.mesh_ccd(mesh, start, end, minimum_separation=0.003)
    for name in ("num_candidates", "num_after_cull", "num_contacts"):
        assert getattr(other.counts, name) == getattr(result.counts, name)
    for name, values in vars(result.contacts).items():
        np.testing.assert_array_equal(getattr(other.contacts, name), values)
    assert ccd.collision_free_step(mesh, start, end) == step


@pytest.mark.parametrize("scene", ["moving and static bodies", "listed pairs", "worlds", "all boxes overlap"])
def test_a_list_too_short_for_the_candidates_loses_nothing(scene, as_on_cuda, monkeypatch):
    """The second search culls them where it finds them; few half warps take all queries in turn."""
    mesh, start, end = SCENES[scene]()
    result = ccd.mesh_ccd(mesh, start, end)
    most = max(result.counts.num_after_cull.values())
    assert max(result.counts.num_candidates.values()) > most
    as_on_cuda()
    monkeypatch.setattr("ccd_warp._engine.device_step.CANDIDATES_EACH", 1)
    monkeypatch.setattr(stages, "_MOST_REST", 3)
    pipeline = ccd.CollisionPipeline(mesh, max_pairs=most, max_contacts=most)
    check_same(pipeline.launch(on_device(start), on_device(end)), result)


def test_pairs_beyond_the_capacity_count_with_toi_0_in_half_warps(as_on_cuda):
    mesh, start, end = three_bodies()
    as_on_cuda()
    for max_pairs in (10, 1000):  # the candidates exceed their list, and they do not
        result = ccd.CollisionPipeline(mesh, max_pairs=max_pairs).launch(on_device(start), on_device(end))
        assert result.toi.numpy()[0] == 0.0
        assert result.flags.numpy()[0] & ccd.LaunchFlag.PAIRS_OVERFLOW


def test_candidates_of_a_large_step_come_in_parts(as_on_cuda):
    """Far more candidates than pairs, with little memory: the search is repeated in parts."""
    mesh, start, end = leaning_stack(150, 1e-3)
    expected = ccd.mesh_ccd(mesh, start, end)
    as_on_cuda()
    mesh, start, end = leaning_stack(150, 1e-3)  # whose plans are those of CUDA
    with pytest.raises(ValueError, match="expected at least") as error:
        ccd.mesh_ccd(mesh, start, end, memory_limit=1)
    limit = int(str(error.value).split("expected at least ")[1].split()[0])
    result = ccd.mesh_ccd(mesh, start, end, memory_limit=limit)
    assert result.counts.num_candidates == expected.counts.num_candidates
    assert result.counts.num_batches > 1
    for name, values in vars(expected.contacts).items():
        np.testing.assert_array_equal(getattr(result.contacts, name), values)


def test_a_search_of_no_pairs(as_on_cuda):
    mesh, start, end = crowd(np.random.default_rng(4), 40, 0.001, 0.0)
    as_on_cuda()
    assert len(ccd.find_candidates(mesh, start, end).edge_edge) == 0
    launched = ccd.CollisionPipeline(mesh).launch(wp.array(start, dtype=wp.vec3d), wp.array(end, dtype=wp.vec3d))
    assert launched.toi.numpy()[0] == np.inf
