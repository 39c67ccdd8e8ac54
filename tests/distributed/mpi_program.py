"""What `test_distributed.py` runs on several ranks: cuts of meshes, whose results have the bits of one process.

    mpiexec -n 3 python -m mpi4py tests/distributed/mpi_program.py [2 | 3 | CASE ...]

One program goes through many cases, because starting processes and compiling kernels takes most of the time: those of
two ranks, of three, or all. It prints a line for each, on rank 0; by ``-m mpi4py``, a failure on one rank ends all.
"""

import sys
import time
import warnings
from pathlib import Path
from unittest import mock

sys.path += [str(Path(__file__).resolve().parents[1] / folder) for folder in ("", "helpers")]

import numpy as np
import warp as wp
from laws.calls import PRECISIONS
from laws.scenes import drawn, with_static_at_rest
from mpi4py import MPI
from mpi_parts import CALLS, OF_STARTS, SCALARS, SEARCHES, Cut, compare, compare_call, whole_mesh

import ccd_warp as ccd
from ccd_warp._engine.mesh import topology
from ccd_warp.distributed import DistributedMesh, DistributedPipeline, _ranks

COMM = MPI.COMM_WORLD
RANK, SIZE = COMM.Get_rank(), COMM.Get_size()
NO_FACES = np.zeros((0, 3), dtype=int)


def interleaved(mesh, seed=0):
    """Every face on a rank by chance."""
    return np.random.default_rng(seed).integers(0, SIZE, mesh.num_faces)


def in_blocks(mesh):
    """Consecutive faces on a rank."""
    return np.arange(mesh.num_faces) * SIZE // max(mesh.num_faces, 1)


def check(mesh, start, end, rank_of_face, calls, *, with_owners=False, motion=None, **options):
    mesh = whole_mesh(mesh)
    cut = Cut(COMM, mesh, rank_of_face(mesh), np.random.default_rng(RANK), with_owners)
    return compare(COMM, cut, mesh, start, end, calls, options, motion)


def sheet(count, size=1.0):
    """A square of 2 count² faces."""
    x = np.linspace(0, size, count + 1)
    vertices = np.stack([*np.meshgrid(x, x, indexing="ij"), np.zeros((count + 1,) * 2)], axis=-1).reshape(-1, 3)
    a = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    faces = [np.stack([a, a + count + 1, a + 1], 1), np.stack([a + 1, a + count + 1, a + count + 2], 1)]
    return vertices, np.concatenate(faces)


def falling(count=12, **options):
    """A wavy sheet that falls through another, and where both are at both ends."""
    upper, faces = sheet(count)
    upper += 0.3 * np.sin(9 * upper[:, [1, 0, 0]]) * [0, 0, 1] + [0.013, 0.007, 0.2]
    mesh = ccd.CollisionMesh.from_arrays([(upper, faces), sheet(count // 2, 1.1)], **options)
    return mesh, mesh.vertices, mesh.vertices - [0.02, 0.01, 0.45] * (mesh.vertex_body == 0)[:, None]


# --- scenes that are drawn, with the calls by turns ---


def drawn_scenes(seeds, family=None):
    """Scenes of the laws, on which the ranks make some of the calls each."""
    for seed in seeds:
        case = drawn(seed, family)
        mesh, start, end = case.make()
        if (mesh.planes.vertices >= 0).any():
            continue  # half-spaces that move are those of one process
        of_step = {name: value for name, value in case.options.items() if name != "num_threads"}
        of_search = {name: value for name, value in of_step.items() if name != "t_max"} | {
            "precision": PRECISIONS[seed % 2]
        }
        motion = None if case.make_motion is None else case.make_motion()
        groups = ([*CALLS[:2], *SCALARS], of_step), (OF_STARTS * (motion is None), {}), (SEARCHES, of_search)
        for calls, options in groups:
            calls = [call for call in calls if CALLS.index(call) % 3 == seed % 3]
            if calls:
                cut = (interleaved, in_blocks)[seed // 3 % 2]
                check(mesh, start, end, cut, calls, with_owners=seed % 5 == 0, motion=motion, **options)


def scenes_that_are_drawn():
    drawn_scenes(range(8))


def more_scenes_that_are_drawn():
    drawn_scenes(range(8, 16))
    drawn_scenes(range(4), "arcs")


def starts_that_are_not_sound():
    """What touches and what passes through, in common planes and on a grid."""
    for seed in range(12):
        mesh, start, end = drawn(seed, ("touching", "in plane", "worlds")[seed % 3]).make()
        if not (mesh.planes.vertices >= 0).any():
            x = with_static_at_rest(mesh, start, 0.5 * start + 0.5 * end) if seed % 2 else start
            check(mesh, x, x, (interleaved, in_blocks)[seed // 2 % 2], ["find_intersections"])


# --- what ranks have of their own ---


def a_sheet_in_blocks():
    check(*falling(), in_blocks, CALLS)
    check(*falling(static=[1]), interleaved, ["mesh_ccd", "line_search vertex"], with_owners=True, broad_phase="hash")
    with mock.patch.object(_ranks, "MOST_BYTES", 5_000):  # what does not fit into a message comes in several
        check(*falling(), lambda mesh: np.full(mesh.num_faces, SIZE - 1), CALLS[:2] + SCALARS)


def a_giant_face():
    """A face that is larger than all regions together."""
    giant = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]) * 50.0 + [0.3, 0.2, -0.2]
    mesh = ccd.CollisionMesh.from_arrays([sheet(10), (giant, [[0, 1, 2]])], static=[1])
    end = mesh.vertices - [0.01, 0.02, 0.5] * (mesh.vertex_body == 0)[:, None]
    pipeline = check(mesh, mesh.vertices, end, interleaved, CALLS[:2] + SCALARS)
    # the giant face, its edges and vertices are everywhere, but not twice
    part = pipeline._planned.part
    assert pipeline.work.num_primitives >= 7
    for numbers in (part.face_numbers, part.edge_numbers, part.vertex_numbers):
        assert (np.diff(numbers) > 0).all()


def nothing_at_all():
    """On all ranks, or, in the plane, on all but the last, which has a cable."""
    mesh = ccd.CollisionMesh.from_arrays([(np.zeros((0, 3)), NO_FACES)])
    calls = ["mesh_ccd", "collision_free_step", "find_candidates", "find_intersections"]
    pipeline = check(mesh, mesh.vertices, mesh.vertices, interleaved, calls)
    assert pipeline.mesh_ccd([], []).toi == np.inf  # an empty list has no columns
    k = np.arange(24)
    x, edges = np.stack([k / 24, 0.5 + 0.05 * np.sin(k)], axis=1), np.stack([k[:-1], k[1:]], axis=1)
    end = x + 0.3 * np.random.default_rng(8).standard_normal(x.shape)
    own = (x, end, edges) if RANK == SIZE - 1 else ([], [], None)
    whole = DistributedMesh(COMM, own[0], vertex_ids=np.arange(len(own[0])), edges=own[2])
    assert (whole.dimension, whole.num_edges) == (2, 23)
    expected = ccd.mesh_ccd(ccd.CollisionMesh.from_arrays([(x, edges)]), x, end).toi
    assert DistributedPipeline(whole).mesh_ccd(*own[:2]).toi == expected < 1.0


def coordinates_at_the_ends_of_float64():
    """Scenes that are small beside the least scale of quantized coordinates, far beyond their origin, without end."""
    unit = 2.0 * np.random.default_rng(6).random((60, 3)) - 1.0
    for scale, shift in ((1e-318, 1e-305), (1e295, 1.5e308), (1.7e308, 0.0)):
        mesh = ccd.CollisionMesh.from_arrays([(unit * scale + shift, np.arange(60).reshape(-1, 3))])
        options = {"length_scale": min(1e4 * scale, 1e308), "minimum_distance": 1e-3 * scale}
        check(mesh, mesh.vertices, mesh.vertices, interleaved, ["mesh_ccd", "find_intersections"], **options)


def vertices_that_take_no_part():
    """Of a list of nodes that two bodies share, at no number and far away."""
    nodes, faces = np.random.default_rng(5).random((120, 3)), np.arange(120).reshape(-1, 3)
    is_unused = np.repeat([False, True, True, False], 60)[:, None]
    for far, options in ((np.nan, {"radius": 0.01}), (1e200, {"static": [1], "self_collision": False})):
        x = np.where(is_unused, far, np.tile(nodes, (2, 1)))
        mesh = ccd.CollisionMesh.from_arrays([(x[:120], faces[:20]), (x[120:], faces[20:])], **options)
        end = with_static_at_rest(mesh, x, 0.9 * x)
        pipeline = check(mesh, x, end, interleaved, [CALLS[k] for k in (0, 2, 3, 5, -1)])
        assert "take no part" in repr(pipeline.mesh)
        assert not np.isin(pipeline._planned.part.vertex_ids, 2 * np.flatnonzero(is_unused) + 5).any()


def work_that_open_pairs_share():
    """Pairs that stay open in the first round share what is left; some ranks work in many batches all the same."""
    rng = np.random.default_rng(5)
    start, faces = rng.random((90, 3)), np.arange(90).reshape(-1, 3)
    mesh = whole_mesh(ccd.CollisionMesh.from_arrays([(start, faces)]))
    end = start[rng.permutation(len(start))]
    check(mesh, start, end, interleaved, ["mesh_ccd", "collision_free_step"], method="bisection", max_work=1)
    cut = Cut(COMM, mesh, interleaved(mesh), np.random.default_rng(RANK))
    limit = {"memory_limit": 280_000} if RANK % 2 == 0 else {}
    given = {"method": "bisection", "max_work": 3_000}
    pipeline, one = DistributedPipeline(cut.mesh, **given, **limit), ccd.CollisionPipeline(mesh, **given)
    compare_call(COMM, cut, pipeline, one, start, end, "collision_free_step")


def a_bound_from_a_sample():
    """A large mesh is sampled first, by primitives that are the same wherever they are; here a small one is.

    The bound cuts off what comes later, also a solution that a limit has left too early, so it must be the same bound.
    """
    with mock.patch.object(topology, "WORTH_SAMPLING", 1):
        for options in ({"max_iterations": 1}, {"precision": "float32"}, {"broad_phase": "hash", "max_iterations": 1}):
            check(*falling(16), interleaved, SCALARS, **options)


def many_steps():
    """A plan is kept while boxes stay in it, made anew when they leave it, and static bodies may be moved."""
    mesh, x, _ = falling(static=[1])
    mesh = whole_mesh(mesh)
    cut = Cut(COMM, mesh, in_blocks(mesh), np.random.default_rng(RANK))
    pipeline, one, num_plans = DistributedPipeline(cut.mesh), ccd.CollisionPipeline(mesh), 0
    velocity = [0, 0, -0.02] * (mesh.vertex_body == 0)[:, None]
    for k in range(12):
        x = x + {6: [0.001, 0, 0], 9: [5.0, 0, 0]}.get(k, [0, 0, 0]) * (mesh.vertex_body >= (k == 6))[:, None]
        compare_call(COMM, cut, pipeline, one, x, x + velocity, "mesh_ccd")
        num_plans += pipeline.work.is_planned
        x = x + velocity
    assert 2 <= num_plans <= 8, num_plans


def one_rank_has_more_work():
    """A crumpled part takes most of the work: the plan is made anew, with smaller regions there; for starts, too."""
    rng = np.random.default_rng(2)
    calm, faces = sheet(20)
    bodies = [(calm, faces), (calm + 0.1 * rng.random(calm.shape) + [2.0, 0, 0], faces)]
    mesh = whole_mesh(ccd.CollisionMesh.from_arrays(bodies))
    end = mesh.vertices + 0.1 * rng.standard_normal(mesh.vertices.shape) * (mesh.vertex_body == 1)[:, None]
    cut = Cut(COMM, mesh, in_blocks(mesh), np.random.default_rng(RANK))
    pipeline, one, seen = DistributedPipeline(cut.mesh), ccd.CollisionPipeline(mesh), []
    for call in ("mesh_ccd", "mesh_ccd", "find_intersections", "mesh_ccd", "mesh_ccd"):
        compare_call(COMM, cut, pipeline, one, mesh.vertices, end, call)
        seen.append((pipeline.work.imbalance, pipeline.work.is_planned))
    assert SIZE == 1 or (seen[0][0] > 1.3 and seen[1][1] and not seen[4][1] and seen[4][0] < 0.9 * seen[0][0]), seen


CASES = [scenes_that_are_drawn, more_scenes_that_are_drawn, starts_that_are_not_sound, a_sheet_in_blocks, a_giant_face]
CASES += [nothing_at_all, coordinates_at_the_ends_of_float64, vertices_that_take_no_part, work_that_open_pairs_share]
CASES += [a_bound_from_a_sample, many_steps, one_rank_has_more_work]


def main(given):
    wp.config.log_level = wp.LOG_ERROR
    chosen = {("2",): CASES[::2], ("3",): CASES[1::2]}.get(tuple(given), CASES)
    for case in [case for case in chosen if case.__name__ in given] or chosen:
        begin = time.perf_counter()
        case()
        if RANK == 0:
            print(f"{case.__name__}: the bits of one process, {time.perf_counter() - begin:.1f} s", flush=True)
    if RANK == 0:
        print(f"all of {len(chosen)} cases")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(sys.argv[1:])
