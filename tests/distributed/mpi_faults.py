"""What `test_distributed.py` runs on several ranks to see that a fault of one becomes the error of all.

    mpiexec -n 3 python tests/distributed/mpi_faults.py together | killed

``together`` ends well on every rank, each of which has seen the same errors. In ``killed`` the last rank is killed
while the others wait for it; that they end is up to MPI, and is what the test looks at.
"""

import contextlib
import copy
import os
import pickle
import signal
import sys
from pathlib import Path

sys.path += [str(Path(__file__).resolve().parents[1] / folder) for folder in ("", "helpers")]

import numpy as np
from mpi4py import MPI
from mpi_parts import compare_call
from mpi_program import NO_FACES, Cut, falling, in_blocks, whole_mesh

import ccd_warp as ccd
from ccd_warp.distributed import DistributedMesh, DistributedPipeline, _exchange, _part

COMM = MPI.COMM_WORLD
RANK, SIZE = COMM.Get_rank(), COMM.Get_size()
LAST = SIZE - 1
TRIANGLE, FACE, IDS = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), np.arange(3)
GROUND = ccd.HalfSpace([0, 0, -1], [0, 0, 1])


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


@contextlib.contextmanager
def struck(holder, name, is_before):
    """Ctrl-C before or after a method of the last rank."""
    original = getattr(holder, name)

    def method(*given, **named):
        if is_before:
            strike()
        result = original(*given, **named)
        if not is_before:
            strike()
        return result

    setattr(holder, name, method)
    yield
    setattr(holder, name, original)


def interrupted(pipeline, x, y):
    """Ctrl-C on one rank, in the engine and where others wait for its messages, ends the call on all."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have had it ignored
    pipeline.mesh_ccd(x, y)
    for of, name, is_before in (
        (lambda: pipeline, "_run", True),
        (lambda: pipeline, "_bring", False),
        (lambda: pipeline._planned.part.everything._of(False, 1), "start", False),
        (lambda: pipeline._planned.part.everything._of(False, 1), "wait", True),
    ):
        with struck(of(), name, is_before):
            everywhere([f"rank {LAST}"], lambda: pipeline.mesh_ccd(x, y), KeyboardInterrupt)
        pipeline.mesh_ccd(x, y)

    # impatience: the second comes while the others are told of the first
    def twice(*given):
        try:
            strike()
            return original(*given)
        finally:
            strike()

    original = pipeline.mesh.frames
    pipeline.mesh.frames = twice
    everywhere([f"rank {LAST}"], lambda: pipeline.mesh_ccd(x, y), KeyboardInterrupt)
    del pipeline.mesh.frames

    # an error that all know of is on its way when one rank is struck
    class Struck(DistributedPipeline):
        def __setattr__(self, name, value):
            super().__setattr__(name, value)
            if name == "_plan" and value is None and hasattr(self, "_workspace"):
                strike()

    own = Struck(pipeline.mesh)
    own._run = lambda *_, **__: 1 / (RANK != 0)
    try:
        own.mesh_ccd(x, y)
        raise AssertionError("no error")
    except KeyboardInterrupt:
        assert RANK == LAST
    except RuntimeError as error:
        assert "rank 0: ZeroDivisionError" in str(error)

    # a program that only notes what it is asked, to end after the step
    asked = []
    signal.signal(signal.SIGINT, lambda *_: asked.append("to end"))
    for of, name in ((pipeline, "_bring"), (pipeline._planned.part.everything._of(False, 1), "start")):
        with struck(of, name, False):
            pipeline.mesh_ccd(x, y)
    assert asked == ["to end"] * (2 * (RANK == LAST)), asked
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # what one rank has not noted any more
    pipeline._work = None if RANK == LAST else np.ones(len(pipeline.mesh.owned_rows))
    pipeline._wants_plan, pipeline._last_imbalance = True, float(RANK)
    pipeline.mesh.ranks._duplicate.num_pipelines += RANK == LAST
    assert DistributedPipeline(pipeline.mesh).mesh_ccd(x, y).toi == pipeline.mesh_ccd(x, y).toi


def made(vertices=TRIANGLE, faces=FACE, **changed):
    """A mesh of one triangle, which all ranks have."""
    return lambda: DistributedMesh(COMM, vertices, faces, **({"vertex_ids": IDS} | changed))


def refused_calls(mesh, x, y):
    """What is wrong on one rank, or differs between ranks, and calls that have it."""
    pipeline, own = DistributedPipeline(mesh), int(mesh.owned_rows[3])
    limited = DistributedPipeline(mesh, **({"memory_limit": 1000} if RANK == LAST else {}))
    bad = x.copy()
    bad[own, 1] = np.nan if RANK == LAST else bad[own, 1]
    vertex = f"vertex id {COMM.bcast(int(mesh.vertex_ids[own]), root=LAST)}"
    short = y[:-1] if RANK == 0 else y
    by_rank = lambda first, other: other if RANK else first  # noqa: E731
    memory, several = [f"rank {LAST}: memory_limit is 1000 bytes"], by_rank(pipeline, limited)
    yield [f"rank {LAST}: vertices_t0", "nan", vertex], lambda: pipeline.mesh_ccd(bad, y)
    yield [f"rank {LAST}: positions", "nan", vertex], lambda: pipeline.find_proximity(bad, 0.1)
    yield [f"rank {LAST}: positions", "nan", vertex], lambda: pipeline.find_intersections(bad)
    yield ["rank 0: vertices_t1 has shape"], lambda: pipeline.collision_free_step(x, short)
    # a fault deep in the engine, on one rank only
    yield memory, lambda: limited.mesh_ccd(x, y)
    yield memory, lambda: limited.find_intersections(x)
    yield memory, lambda: limited.collision_free_step(x, y)
    yield ["options differ"], lambda: DistributedPipeline(mesh, tolerance=1e-6 * (1 + RANK))
    yield ["minimum_separation is 0.1"], lambda: DistributedPipeline(made(radius=0.1)(), minimum_separation=0.1)
    yield ["rank 0: line_search: per is"], lambda: pipeline.line_search(x, y, per="hour")
    yield ["inflation is"], lambda: pipeline.find_candidates(x, y, 0.1 * RANK)
    yield ["search_radius is 1.0 on"], lambda: pipeline.displacement_bounds(x, 1.0 + RANK)
    yield ["rank 0: displacement_bounds: search_radius is 0"], lambda: pipeline.displacement_bounds(x, RANK)
    # ranks that would wait for each other
    for calls in (("mesh_ccd", "collision_free_step"), ("line_search", "find_candidates")):
        yield (
            [f"rank 0 calls {calls[0]}", f"and rank 1 {calls[1]}"],
            lambda calls=calls: getattr(pipeline, by_rank(*calls))(x, y),
        )
    searches = by_rank(lambda: pipeline.find_intersections(x), lambda: pipeline.find_proximity(x, 0.1))
    yield ["rank 0 calls find_intersections", "and rank 1 find_proximity"], searches
    for name, values in (("per", ("body", "vertex")), ("safety", (0.5, 0.6)), ("max_rounds", (3, 4))):
        given = {name: by_rank(*values)}
        yield [f"{name}={v!r}" for v in values], lambda given=given: pipeline.line_search(x, y, **given)
    yield ["of pipeline"], lambda: several.mesh_ccd(x, y)
    turning, at = DistributedPipeline(made(rigid=[0])()), [[0.0, 0, 0, 0, 0, 0, 1]]
    for count, share, words in (
        (1, by_rank(1.0, 0.5), "motion differs between ranks"),
        (2, 1.0, "2 rows for 1 rigid body"),
    ):
        motion = ccd.RigidMotion(at * count, twist=[[0.1, 0, 0, 0, 0, 0.3]] * count).shortened(share)
        yield [words], lambda motion=motion: turning.mesh_ccd(TRIANGLE, TRIANGLE, motion=motion)


def refused_meshes():
    """What is wrong on one rank, or differs between ranks, and meshes that have it."""
    ones, on_first = np.ones(3, dtype=bool), RANK == 0
    yield ["rank 0: owned is set for vertex id", f"on {SIZE} ranks"], made(owned=ones)
    yield ["owned is given on some ranks"], made(owned=~ones if on_first else None)
    yield ["bodies of vertex id 0 differs between ranks 0 and 1"], made(bodies=np.full(3, min(RANK, 1)))
    twice = np.array([4, 4, 5])
    yield [f"rank {LAST}: vertex_ids holds 4 more than once"], made(vertex_ids=twice if RANK == LAST else IDS)
    yield ["vertex_ids holds 9223372036854775813"], made(vertex_ids=IDS.astype(np.uint64) + np.uint64(2**63 + 3))
    yield ["static", "differs between ranks"], made(static=[0] if on_first else [])
    yield ["radius is given on some ranks"], made(radius=0.1 if on_first else None)
    yield ["rank 0: exclude_pairs is"], made(exclude_pairs={"edge_edge": [[0, 1]]})
    yield ["half_spaces differs between ranks"], made(half_spaces={} if on_first else {1: GROUND})
    yield ["half_spaces differs"], made(half_spaces={1: ccd.HalfSpace([0, 0, RANK], [0, 0, 1])})
    yield ["rank 0: bodies gives vertex id 0 body 0, which is a half-space"], made(half_spaces={0: GROUND})
    flat = ccd.HalfSpace([0, 0, 0], [0, 0, 0])
    yield ["rank 0: normal of body 1 is [0.0, 0.0, 0.0]"], made(half_spaces={1: flat})
    yield ["rank 0: half_spaces is"], made(half_spaces=[GROUND])
    yield ["rank 0: half_spaces has the key 'ground'"], made(half_spaces={"ground": GROUND})
    yield [f"rank {LAST}: half_spaces holds"], made(half_spaces={1: 2.0 if RANK == LAST else GROUND})
    yield ["half_spaces holds 9; expected numbers below 4"], made(half_spaces={9: GROUND})
    elsewhere = {"vertices": np.array([[7, 1]], np.uint64)}
    yield ["holds id 7; expected ids of the whole"], made(exclude_pairs=elsewhere)
    masked = {"vertices": np.ma.array([[0, 1]], mask=True)}
    yield ["exclude_pairs['vertices'] is a masked array"], made(exclude_pairs=masked)
    yield [f"rank {LAST}: faces holds index 3"], made(faces=FACE + (RANK == LAST))
    yield (
        ["bodies gives vertex id 0 body 1 and the next, 7, body 0"],
        made(faces=NO_FACES, vertex_ids=np.array([0, 7, 9]), bodies=np.array([1, 0, 0])),
    )
    columns = 2 if RANK == LAST else 3
    yield [f"vertices has 2 columns on rank {LAST} and 3 on rank 0"], made(TRIANGLE[:, :columns], None)
    yield ["faces has shape (1, 3)"], made(TRIANGLE[:, :2])
    alone = {"vertex_ids": IDS[:0], "half_spaces": {0: GROUND}}
    yield ["half_spaces holds all bodies"], made(TRIANGLE[:0], FACE[:0], **alone)
    in_plane = DistributedPipeline(made(TRIANGLE[:, :2], None, edges=[[0, 1]])())
    yield ["vertices_t0 has shape (3, 3); expected (3, 2)"], lambda: in_plane.mesh_ccd(TRIANGLE, TRIANGLE)


def begun():
    """A mesh, its part on this rank with a pipeline, and where its vertices are at both ends."""
    mesh, start, end = falling()
    mesh = whole_mesh(mesh)
    cut = Cut(COMM, mesh, in_blocks(mesh), np.random.default_rng(RANK))
    return mesh, cut, DistributedPipeline(cut.mesh), start, end


def together():
    mesh, cut, pipeline, start, end = begun()
    one = ccd.CollisionPipeline(mesh)
    x, y = cut.local(start), cut.local(end)
    compare_call(COMM, cut, pipeline, one, start, end, "mesh_ccd")
    for parts, call in (*refused_calls(cut.mesh, x, y), *refused_meshes()):
        everywhere(parts, call)
    everywhere(["rank 0", "no_option"], lambda: DistributedPipeline(cut.mesh, no_option=1), TypeError)

    def unforeseen(*_, **options):
        raise KeyError("unforeseen")

    pipeline._run = unforeseen if RANK == 0 else type(pipeline)._run.__get__(pipeline)
    everywhere(["rank 0: KeyError", "unforeseen"], lambda: pipeline.mesh_ccd(x, y), RuntimeError)
    del pipeline._run
    interrupted(pipeline, x, y)
    # no memory for the buffers of an exchange: what was begun of it ends without a word
    unraisable, sys.unraisablehook = [], lambda given: unraisable.append(given.exc_value)
    with contextlib.suppress(MemoryError, ValueError):
        _exchange._Requests(cut.mesh.ranks, [1 << 60] * SIZE, [0] * SIZE, 3)
    sys.unraisablehook = sys.__unraisablehook__
    assert not unraisable, unraisable
    # a result is saved on each rank; what belongs to all of them stays behind
    found = pipeline.mesh_ccd(x, y)
    for again in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found)):
        assert again.toi == found.toi and np.array_equal(again.contacts.points, found.contacts.points)
        everywhere(["to_root() is called on a copy"], again.contacts.to_root)
    # the same pairs, in the integers that each rank has; and none at all
    made(exclude_pairs={"vertices": np.array([[0, 1]], dtype=np.int32 if RANK == 0 else np.int64)})()
    made(exclude_pairs={"vertices": []})()
    # MPI has few communicators to give, some thousands; a program may make a mesh in every step
    assert made()().ranks.comm == cut.mesh.ranks.comm
    # keys of contacts leave vertices that meet planes a bit less; here there is no memory for so many
    grounded = DistributedPipeline(made(half_spaces={1: GROUND})())
    most, _part.MOST_WITH_PLANES = _part.MOST_WITH_PLANES, 2
    everywhere(["holds 3 vertices; expected at most 2"], lambda: grounded.mesh_ccd(TRIANGLE, TRIANGLE))
    _part.MOST_WITH_PLANES = most
    assert 0.499 < grounded.mesh_ccd(TRIANGLE, TRIANGLE - [0, 0, 2]).toi <= 0.5
    # and after all that the pipeline works
    compare_call(COMM, cut, pipeline, one, start, end, "mesh_ccd")
    print(f"rank {RANK} has seen the errors of the others", flush=True)


def killed():
    _, cut, pipeline, start, end = begun()
    for k in range(1_000_000):
        if k == 3 and RANK == LAST:
            os.kill(os.getpid(), signal.SIGKILL)
        pipeline.collision_free_step(cut.local(start), cut.local(end))


if __name__ == "__main__":
    {"together": together, "killed": killed}[sys.argv[1]]()
