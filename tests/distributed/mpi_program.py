"""What `test_distributed.py` runs on several ranks: cuts of meshes, whose results have the bits of one process.

    mpiexec -n 3 python -m mpi4py tests/distributed/mpi_program.py [CASE ...]

One program goes through many cases, because starting processes and loading kernels takes most of the time: of three
ranks two make half of them. It prints a line for each, on rank 0; by ``-m mpi4py``, a failure on one rank ends all. In
the case ``killed`` the last rank is killed as the others wait for it; that they end is up to MPI.
"""

import contextlib
import copy
import gc
import io
import os
import pickle
import re
import signal
import sys
import time
import warnings
from pathlib import Path
from unittest import mock

sys.path += [str(Path(__file__).resolve().parents[1] / folder) for folder in ("", "helpers")]

import numpy as np
import warp as wp
from laws.calls import AT_ONE_TIME, ON_HOST, PRECISIONS, SCALARS, SEARCHES
from laws.scenes import drawn, pressed
from mpi4py import MPI
from mpi_parts import Cut, compare_call, wait_for_all, whole_mesh
from scenes import FACE, NO_FACES, TRIANGLE, sheet, with_static_at_rest

import ccd_warp as ccd
from ccd_warp.distributed import DistributedMesh, DistributedPipeline

EVERY = MPI.COMM_WORLD
IDS = np.arange(3)
GROUND = ccd.HalfSpace([0, 0, -1], [0, 0, 1])


def use(comm):
    """Let the cases run on these ranks."""
    global COMM, RANK, SIZE, LAST
    COMM, RANK, SIZE = comm, comm.Get_rank(), comm.Get_size()
    LAST = SIZE - 1


def interleaved(mesh, seed=0):
    """Every face on a rank by chance."""
    return np.random.default_rng(seed).integers(0, SIZE, mesh.num_faces)


def in_blocks(mesh):
    """Consecutive faces on a rank."""
    return np.arange(mesh.num_faces) * SIZE // max(mesh.num_faces, 1)


def cut_of(mesh, rank_of_face, with_owners=False):
    """The mesh as ranks number it, and the part of it on this one."""
    mesh = whole_mesh(mesh)
    return mesh, Cut(COMM, mesh, rank_of_face(mesh), np.random.default_rng(RANK), with_owners)


def check(mesh, start, end, rank_of_face, calls, **options):
    """Make the calls on all ranks and in one process, and compare; returns the pipeline of the ranks."""
    return check_cut(*cut_of(mesh, rank_of_face, options.pop("with_owners", False)), start, end, calls, **options)


def check_cut(mesh, cut, start, end, calls, **options):
    """The same of a mesh whose part on this rank is made."""
    start, end = (np.asarray(x).reshape(-1, mesh.dimension) for x in (start, end))
    pipelines = DistributedPipeline(cut.mesh, **options), ccd.CollisionPipeline(mesh, **options)
    for call in calls:
        compare_call(COMM, cut, *pipelines, start, end, call)
    return pipelines[0]


def wavy_sheets(count=12, **options):
    """A wavy sheet that falls through another, and where both are at both ends."""
    upper, faces = sheet(count)
    upper += 0.3 * np.sin(9 * upper[:, [1, 0, 0]]) * [0, 0, 1] + [0.013, 0.007, 0.2]
    mesh = ccd.CollisionMesh.from_arrays([(upper, faces), sheet(count // 2, 1.1)], **options)
    return mesh, mesh.vertices, mesh.vertices - [0.02, 0.01, 0.45] * (mesh.vertex_body == 0)[:, None]


def drawn_scenes(seeds, family=None):
    """Scenes of the laws, on which the ranks make some of the calls each."""
    for seed in seeds:
        case = drawn(seed, family)
        mesh, start, end = case.make()
        if (mesh.planes.vertices >= 0).any() or mesh.exclusion_rings > 1:
            continue  # half-spaces that move, and more rings, are those of one process
        of_step = {name: value for name, value in case.options.items() if name not in ("num_threads", "max_work")}
        of_search = {name: value for name, value in of_step.items() if name != "t_max"}
        of_search["precision"] = PRECISIONS[seed % 2]
        groups = ([*ON_HOST[:2], *SCALARS], of_step), (AT_ONE_TIME, {}), (SEARCHES, of_search)
        own = cut_of(mesh, (interleaved, in_blocks)[seed // 3 % 2], with_owners=seed % 5 == 0)
        for calls, options in groups:
            calls = [call for call in calls if ON_HOST.index(call) % 3 == seed % 3]
            if mesh.radius is not None:  # boxes hold the radii of neighbours, which a part lacks at its rim
                calls = [call for call in calls if call != "find_candidates"]
            if calls:
                check_cut(*own, start, end, calls, **options)


def scenes_that_are_drawn():
    drawn_scenes(range(8))
    for seed in (8, 14):  # sheets a rounding within their distances, of which every other one is pressed down
        mesh, start, way = (scene := pressed(seed)).make()
        end = start + way * (mesh.vertex_body % 2 == 1)[:, None]
        options = {name: value for name, value in scene.without_end().items() if name != "num_threads"}
        check(mesh, start, end, interleaved, SEARCHES, **options)


def more_scenes_that_are_drawn():
    drawn_scenes(range(8, 16))


def starts_that_are_not_sound():
    """What touches and what passes through, in common planes and on a grid."""
    for seed in range(12):
        mesh, start, end = drawn(seed, ("touching", "in plane", "worlds")[seed % 3]).make()
        if not (mesh.planes.vertices >= 0).any():
            x = with_static_at_rest(mesh, start, 0.5 * start + 0.5 * end) if seed % 2 else start
            check(mesh, x, x, (interleaved, in_blocks)[seed // 2 % 2], ["find_intersections"])


# --- what ranks have of their own ---


def a_sheet_in_blocks():
    pipeline = check(*wavy_sheets(), in_blocks, ON_HOST)
    # each vertex is in the region of one rank, and a ghost in the parts of others
    own = pipeline.work.counts.num_vertices - pipeline.work.num_ghosts
    assert COMM.allreduce(own) == pipeline.mesh.num_vertices and pipeline.work.num_ghosts > 0
    check(
        *wavy_sheets(static=[1]), interleaved, ["mesh_ccd", "line_search vertex"], with_owners=True, broad_phase="hash"
    )
    check(*wavy_sheets(), lambda mesh: np.full(mesh.num_faces, SIZE - 1), ON_HOST[:2] + SCALARS)


def what_one_rank_knows_of_a_vertex_of_another():
    """Contacts, and what is near at the start, that only one of the ranks has which have a vertex."""
    rng = np.random.default_rng(0)
    mesh, start, end = wavy_sheets(16)
    check(mesh, start, end + 0.15 * rng.standard_normal(end.shape), in_blocks, ["line_search vertex"])
    lower, faces = sheet(20)
    for noise, way in ((0.0, 0.0), (0.001, 0.1)):
        upper = lower + [0, 0, 0.03] + noise * rng.standard_normal(lower.shape)
        mesh = ccd.CollisionMesh.from_arrays([(lower, faces), (upper, faces)])
        end = mesh.vertices + [0, 0, way] * (mesh.vertex_body == 1)[:, None]
        end += (0.002 if way else 0.05) * rng.standard_normal(end.shape)
        check(mesh, mesh.vertices, end, in_blocks, ["line_search vertex", SCALARS[0]], minimum_distance=0.04)


def a_giant_face():
    """A face that is larger than all regions together."""
    giant = TRIANGLE * 50.0 + [0.3, 0.2, -0.2]
    mesh = ccd.CollisionMesh.from_arrays([sheet(10), (giant, FACE)], static=[1])
    end = mesh.vertices - [0.01, 0.02, 0.5] * (mesh.vertex_body == 0)[:, None]
    check(mesh, mesh.vertices, end, interleaved, ON_HOST[:2] + SCALARS)


def nothing_at_all():
    """On all ranks, or, in the plane, on all but the last, which has a cable."""
    mesh = ccd.CollisionMesh.from_arrays([(np.zeros((0, 3)), NO_FACES)])
    calls = ["mesh_ccd", "collision_free_step", "find_candidates", "find_intersections"]
    pipeline = check(mesh, mesh.vertices, mesh.vertices, interleaved, calls)
    assert pipeline.mesh_ccd([], []).toi == np.inf  # an empty list has no columns
    k = np.arange(24)
    x, edges = np.stack([k / 24, 0.5 + 0.05 * np.sin(k)], axis=1), np.stack([k[:-1], k[1:]], axis=1)
    end = x + 0.3 * np.random.default_rng(8).standard_normal(x.shape)
    own = (x, end, edges) if RANK == LAST else ([], [], None)
    whole = DistributedMesh(COMM, own[0], vertex_ids=np.arange(len(own[0])), edges=own[2])
    assert (whole.dimension, whole.num_vertices) == (2, 24)
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
        pipeline = check(mesh, x, end, interleaved, [ON_HOST[k] for k in (0, 2, 3, 5, -1)])
        assert "take no part" in repr(pipeline.mesh)
        assert not np.isin(pipeline._plan.ids, 2 * np.flatnonzero(is_unused) + 5).any()


def many_steps():
    """A plan is kept while boxes stay in it, made anew when they leave it, and static bodies may be moved."""
    mesh, cut = cut_of(wavy_sheets(static=[1])[0], in_blocks)
    x = mesh.vertices
    pipeline, one, num_plans = DistributedPipeline(cut.mesh), ccd.CollisionPipeline(mesh), 0
    velocity = [0, 0, -0.02] * (mesh.vertex_body == 0)[:, None]
    for k in range(12):
        x = x + {6: [0.001, 0, 0], 9: [5.0, 0, 0]}.get(k, [0, 0, 0]) * (mesh.vertex_body >= (k == 6))[:, None]
        compare_call(COMM, cut, pipeline, one, x, x + velocity, "mesh_ccd")
        num_plans += pipeline.work.is_planned
        x = x + velocity
    assert 2 <= num_plans <= 8, num_plans


def the_page():
    """The block of the page prints on three ranks what the page says."""
    page = (Path(__file__).parents[2] / "docs" / "distributed.md").read_text(encoding="utf-8")
    (code,), (output,) = (re.findall(rf"^```{fence}\n(.*?)^```$", page, re.S | re.M) for fence in ("python", "text"))
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(code, {})
    assert SIZE != 3 or printed.getvalue() == output * (RANK == 0), printed.getvalue()


# --- a fault of one rank is the error of all ---


def everywhere(parts, call, kind=ValueError):
    """Make a call that fails on one rank, and check that all ranks raise the same error."""
    try:
        call()
    except kind as error:
        text = str(error)
    else:
        text = "no error"
    texts = COMM.allgather(text)
    assert len(set(texts)) == 1 and all(part in texts[0] for part in parts), texts


def strike():
    """Ctrl-C on the last rank."""
    if RANK == LAST:
        os.kill(os.getpid(), signal.SIGINT)


def struck(holder, name, *when):
    """Ctrl-C before and after a method of the last rank, or at one of these."""
    original = getattr(holder, name)

    def method(*given, **named):
        try:
            if "before" in when:
                strike()
            return original(*given, **named)
        finally:
            if "after" in when:
                strike()

    return mock.patch.object(holder, name, method)


def interrupted(pipeline, x, y):
    """Ctrl-C on one rank, in its part and where others wait for its messages, ends the call on all."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have had it ignored
    pipeline.mesh_ccd(x, y)
    for of, *where in (
        (lambda: pipeline.mesh, "_frames", "before", "after"),
        (lambda: pipeline._plan.exchange, "forward", "after"),
        (lambda: pipeline._plan.pipeline, "mesh_ccd", "before"),
        (lambda: pipeline._ranks, "exchange", "before"),
    ):
        with struck(of(), *where):
            everywhere([f"rank {LAST}: interrupted"], lambda: pipeline.mesh_ccd(x, y), KeyboardInterrupt)
        pipeline.mesh_ccd(x, y)
    # after the last agreement the others do not learn of it
    with struck(pipeline._ranks, "agree", "after"), contextlib.suppress(KeyboardInterrupt):
        with pipeline._ranks.together("one agreement"):
            pass
        assert RANK != LAST
    # a program that only notes what it is asked, to end after the step
    asked = []
    signal.signal(signal.SIGINT, lambda *_: asked.append("to end"))
    with struck(pipeline._plan.exchange, "forward", "after"):
        pipeline.mesh_ccd(x, y)
    assert asked == ["to end"] * (RANK == LAST), asked
    signal.signal(signal.SIGINT, signal.default_int_handler)


def made(vertices=TRIANGLE, faces=FACE, **changed):
    """A mesh of one triangle, which all ranks have."""
    return lambda: DistributedMesh(COMM, vertices, faces, **({"vertex_ids": IDS} | changed))


def refused_calls(mesh, x, y):
    """What is wrong on one rank, or differs between ranks, and calls that have it."""
    pipeline, own = DistributedPipeline(mesh), int(np.flatnonzero(mesh.is_owned)[3])
    limited = DistributedPipeline(mesh, **({"memory_limit": 1000} if RANK == LAST else {}))
    bad = x.copy()
    bad[own, 1] = np.nan if RANK == LAST else bad[own, 1]
    number = ["nan", f"vertex id {COMM.bcast(int(mesh.vertex_ids[own]), root=LAST)}"]
    by_rank = lambda first, other: other if RANK else first  # noqa: E731
    for parts, of, name, *given in (
        ([f"rank {LAST}: vertices_t0", *number], pipeline, "mesh_ccd", bad, y),
        ([f"rank {LAST}: positions", *number], pipeline, "find_proximity", bad, 0.1),
        ([f"rank {LAST}: positions", *number], pipeline, "find_intersections", bad),
        (["rank 0: vertices_t1 has shape"], pipeline, "collision_free_step", x, by_rank(y[:-1], y)),
        # a fault deep in the engine, on one rank only
        *(([f"rank {LAST}: memory_limit is 1000 bytes"], limited, name, x, *given)
          for name, *given in (("mesh_ccd", y), ("find_intersections",), ("collision_free_step", y))),
        (["rank 0 calls find_candidates(inflation=0.0)"], pipeline, "find_candidates", x, y, 0.1 * RANK),
        (["rank 1 displacement_bounds(search_radius=2.0)"], pipeline, "displacement_bounds", x, 1.0 + RANK),
        (["rank 0: displacement_bounds: search_radius is 0"], pipeline, "displacement_bounds", x, RANK),
        (["of pipeline"], by_rank(pipeline, limited), "mesh_ccd", x, y),
    ):  # fmt: skip
        yield parts, lambda of=of, name=name, given=given: getattr(of, name)(*given)
    # ranks that would wait for each other
    for calls in (("mesh_ccd", "collision_free_step"), ("line_search", "find_candidates")):
        parts = [f"rank 0 calls {calls[0]}", f"and rank 1 {calls[1]}"]
        yield parts, lambda calls=calls: getattr(pipeline, by_rank(*calls))(x, y)
    searches = by_rank(lambda: pipeline.find_intersections(x), lambda: pipeline.find_proximity(x, 0.1))
    yield ["rank 0 calls find_intersections", "and rank 1 find_proximity"], searches
    yield ["rank 0: mesh_ccd: motion is 1; expected None"], lambda: pipeline.mesh_ccd(x, y, motion=1 - RANK or None)
    yield ["rank 0: line_search: per is"], lambda: pipeline.line_search(x, y, per="hour")
    for name, values in (("per", ("body", "vertex")), ("safety", (0.5, 0.6)), ("max_rounds", (3, 4))):
        given = {name: by_rank(*values)}
        yield [f"{name}={v!r}" for v in values], lambda given=given: pipeline.line_search(x, y, **given)
    by_tolerance = [f"rank {r} {'calls ' * (r == 0)}DistributedPipeline(tolerance={1e-6 * (1 + r)!r})" for r in (0, 1)]
    yield by_tolerance, lambda: DistributedPipeline(mesh, tolerance=1e-6 * (1 + RANK))
    yield ["max_work is given"], lambda: DistributedPipeline(mesh, max_work=1000)
    yield ["minimum_separation is 0.1"], lambda: DistributedPipeline(made(radius=0.1)(), minimum_separation=0.1)


def refused_meshes():
    """What is wrong on one rank, or differs between ranks, and meshes that have it."""
    ones, on_first, on_last = np.ones(3, dtype=bool), RANK == 0, RANK == LAST
    flat, columns = ccd.HalfSpace([0, 0, 0], [0, 0, 0]), 2 if on_last else 3
    huge = IDS.astype(np.uint64) + np.uint64(2**63 + 3)
    of_vertices = lambda pairs: {"exclude_pairs": {"vertices": pairs}}  # noqa: E731
    for part, changed in (
        (f"rank 0: owned is set for vertex id 0 on {SIZE} ranks", {"owned": ones}),
        ("rank 0: owned is set for vertex id 0 on 0 ranks", {"owned": ~ones}),
        ("owned is given on some ranks", {"owned": ~ones if on_first else None}),
        ("bodies of vertex id 0 differs between ranks 0 and 1", {"bodies": np.full(3, min(RANK, 1))}),
        (f"rank {LAST}: vertex_ids holds 4 more than once", {"vertex_ids": np.array([4, 4, 5]) if on_last else IDS}),
        ("vertex_ids holds 9223372036854775813", {"vertex_ids": huge}),
        ("static, kinematic", {"static": [0] if on_first else []}),
        ("radius is given on some ranks", {"radius": 0.1 if on_first else None}),
        ("rank 0: exclude_pairs is", {"exclude_pairs": {"edge_edge": [[0, 1]]}}),
        ("holds id 7; expected ids of the whole", of_vertices(np.array([[7, 1]], np.uint64))),
        ("exclude_pairs['vertices'] has shape (1, 0, 2)", of_vertices(np.zeros((1, 0, 2)))),
        ("exclude_pairs['vertices'] is a masked array", of_vertices(np.ma.array([[0, 1]], mask=True))),
        ("half_spaces differs by rank", {"half_spaces": {} if on_first else {1: GROUND}}),
        ("half_spaces differs", {"half_spaces": {1: ccd.HalfSpace([0, 0, RANK], [0, 0, 1])}}),
        ("rank 0: bodies gives vertex id 0 body 0, which is a half-space", {"half_spaces": {0: GROUND}}),
        ("rank 0: normal of body 1 is [0.0, 0.0, 0.0]", {"half_spaces": {1: flat}}),
        ("rank 0: half_spaces is", {"half_spaces": [GROUND]}),
        ("rank 0: half_spaces has the key 'ground'", {"half_spaces": {"ground": GROUND}}),
        (f"rank {LAST}: half_spaces holds", {"half_spaces": {1: 2.0 if on_last else GROUND}}),
        ("half_spaces holds 99; expected numbers below", {"half_spaces": {99: GROUND}}),
        ("exclusion_rings is 2; expected 1", {"exclusion_rings": 2}),
        ("half_spaces holds all bodies",
         {"vertices": TRIANGLE[:0], "faces": FACE[:0], "vertex_ids": IDS[:0], "half_spaces": {0: GROUND}}),
        (f"rank {LAST}: faces holds index 3", {"faces": FACE + on_last}),
        ("bodies gives faces[0] the values [1, 0, 0]", {"bodies": np.array([1, 0, 0])}),
        (f"rank {LAST}: vertices has shape (3, 2)", {"vertices": TRIANGLE[:, :columns], "faces": None}),
        ("faces has shape (1, 3)", {"vertices": TRIANGLE[:, :2]}),
    ):  # fmt: skip
        yield [part], made(**changed)
    in_plane = DistributedPipeline(made(TRIANGLE[:, :2], None, edges=[[0, 1]])())
    yield ["vertices_t0 has shape (3, 3); expected (3, 2)"], lambda: in_plane.mesh_ccd(TRIANGLE, TRIANGLE)


def begun():
    """A mesh, its part on this rank with a pipeline, and where its vertices are at both ends."""
    mesh, start, end = wavy_sheets()
    mesh, cut = cut_of(mesh, in_blocks)
    return mesh, cut, DistributedPipeline(cut.mesh), start, end


def together():
    """All ranks say what failed on one of them."""
    mesh, cut, pipeline, start, end = begun()
    one = ccd.CollisionPipeline(mesh)
    x, y = cut.local(start), cut.local(end)
    compare_call(COMM, cut, pipeline, one, start, end, "mesh_ccd")
    for parts, call in (*refused_calls(cut.mesh, x, y), *refused_meshes()):
        everywhere(parts, call)
    everywhere(["rank 0", "no_option"], lambda: DistributedPipeline(cut.mesh, no_option=1), TypeError)

    def unforeseen(*_, **options):
        raise KeyError("unforeseen")

    with mock.patch.object(pipeline, "_pairs", unforeseen) if RANK == 0 else contextlib.nullcontext():
        everywhere(["rank 0: KeyError", "unforeseen"], lambda: pipeline.mesh_ccd(x, y), RuntimeError)
    interrupted(pipeline, x, y)
    # a result is saved on each rank; what belongs to all of them stays behind
    found = pipeline.mesh_ccd(x, y)
    for again in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found)):
        assert again.toi == found.toi and np.array_equal(again.contacts.points, found.contacts.points)
        everywhere(["to_root() is called on a copy"], again.contacts.to_root)
    found = pipeline.line_search(x, y)
    assert np.array_equal(pickle.loads(pickle.dumps(found)).shortened_by.points, found.shortened_by.points)
    # the same pairs, in the integers that each rank has; and none at all
    made(exclude_pairs={"vertices": np.array([[0, 1]], dtype=np.int32 if RANK == 0 else np.int64)})()
    made(exclude_pairs={"vertices": []})()
    in_plane = made(TRIANGLE[:, :2], None, edges=[[0, 1]])()
    assert ["in the plane" in repr(each) for each in (in_plane, cut.mesh)] == [True, False]
    # MPI has few communicators to give, some thousands; a program may make a mesh in every step
    assert made()().ranks.comm == cut.mesh.ranks.comm
    grounded = DistributedPipeline(made(half_spaces={1: GROUND})())
    assert 0.499 < grounded.mesh_ccd(TRIANGLE, TRIANGLE - [0, 0, 2]).toi <= 0.5
    # and after all that the pipeline works
    compare_call(COMM, cut, pipeline, one, start, end, "mesh_ccd")


def on_the_emulated_device():
    """Each rank takes the host's path for CUDA, and runs the CUDA source of the kernels."""
    from emulated.device import emulation

    mesh, start, end = wavy_sheets(8)
    with emulation():
        check(mesh, start, end, in_blocks, ["mesh_ccd", "collision_free_step", "find_proximity", "line_search vertex"])


def killed():
    _, cut, pipeline, start, end = begun()
    for k in range(1_000_000):
        if k == 3 and RANK == LAST:
            os.kill(os.getpid(), signal.SIGKILL)
        pipeline.collision_free_step(cut.local(start), cut.local(end))


CASES = [scenes_that_are_drawn, more_scenes_that_are_drawn, starts_that_are_not_sound, a_sheet_in_blocks]
CASES += [what_one_rank_knows_of_a_vertex_of_another, a_giant_face]
CASES += [nothing_at_all, coordinates_at_the_ends_of_float64, vertices_that_take_no_part]
CASES += [many_steps, together, the_page]


def main(given):
    gc.set_threshold(20_000, 10, 10)  # as in `conftest.py`
    wp.config.log_level = wp.LOG_ERROR
    every_rank = EVERY.Get_rank()
    pair = EVERY.Split(every_rank < 2, every_rank)
    chosen = [case for case in [*CASES, killed, on_the_emulated_device] if case.__name__ in given] or CASES
    for number, case in enumerate(chosen):
        is_of_all = case is the_page  # a program of its own
        of_two = EVERY.Get_size() == 3 and chosen is CASES and number % 2 == 0 and not is_of_all
        use(pair if of_two else EVERY)
        begin = time.perf_counter()
        if every_rank < SIZE:
            case()
        wait_for_all(EVERY)
        if every_rank == 0:
            print(f"{case.__name__} on {SIZE} ranks: done, {time.perf_counter() - begin:.1f} s", flush=True)
    if every_rank == 0:
        print(f"all of {len(chosen)} cases", flush=True)
    if EVERY.Get_size() == 3:
        use(EVERY)
        killed()


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(sys.argv[1:])
