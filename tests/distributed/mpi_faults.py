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

sys.path.append(str(Path(__file__).resolve().parents[1] / "helpers"))

import numpy as np
import scenes
from mpi4py import MPI
from mpi_parts import Cut, compare_call, whole_mesh

import ccd_warp as ccd
from ccd_warp.distributed import DistributedMesh, DistributedPipeline, _exchange, _part

COMM = MPI.COMM_WORLD
RANK, SIZE = COMM.Get_rank(), COMM.Get_size()
LAST = SIZE - 1


def everywhere(kind, parts, call):
    """Make a call that fails on one rank, and check that all ranks raise the same error."""
    try:
        call()
    except kind as error:
        text = str(error)
    else:
        text = "no error"
    texts = COMM.allgather(text)
    assert len(set(texts)) == 1 and all(part in texts[0] for part in parts), texts


def interrupted(pipeline, x, y):
    """Ctrl-C on one rank, in the engine and where others wait for its messages, ends the call on all."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have had it ignored

    def strike():
        if RANK == LAST:
            os.kill(os.getpid(), signal.SIGINT)

    def before(original):
        return lambda *given, **named: (strike(), original(*given, **named))[1]

    def after(original):
        return lambda *given, **named: (original(*given, **named), strike())[0]

    pipeline.mesh_ccd(x, y)
    for of, name, struck in (
        (lambda: pipeline, "_run", before),
        (lambda: pipeline, "_bring", after),
        (lambda: pipeline._planned.part.everything._of(False, 1), "start", after),
        (lambda: pipeline._planned.part.everything._of(False, 1), "wait", before),
    ):
        holder = of()
        original = getattr(holder, name)
        setattr(holder, name, struck(original))
        everywhere(KeyboardInterrupt, [f"rank {LAST}"], lambda: pipeline.mesh_ccd(x, y))
        setattr(holder, name, original)
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
    everywhere(KeyboardInterrupt, [f"rank {LAST}"], lambda: pipeline.mesh_ccd(x, y))
    del pipeline.mesh.frames

    # an error that all know of is on its way when one rank is struck
    class Struck(DistributedPipeline):
        def __setattr__(self, name, value):
            super().__setattr__(name, value)
            if name == "_plan" and value is None and hasattr(self, "_workspace"):
                strike()

    struck = Struck(pipeline.mesh)
    struck._run = lambda *_, **__: 1 / (RANK != 0)
    try:
        struck.mesh_ccd(x, y)
        raise AssertionError("no error")
    except KeyboardInterrupt:
        assert RANK == LAST
    except RuntimeError as error:
        assert "rank 0: ZeroDivisionError" in str(error)

    # a program that only notes what it is asked, to end after the step
    asked = []
    signal.signal(signal.SIGINT, lambda *_: asked.append("to end"))
    waits = pipeline._planned.part.everything._of(False, 1)
    for of, name in ((pipeline, "_bring"), (waits, "start")):
        original = getattr(of, name)
        setattr(of, name, after(original))
        pipeline.mesh_ccd(x, y)
        setattr(of, name, original)
    assert asked == ["to end"] * (2 * (RANK == LAST)), asked
    signal.signal(signal.SIGINT, signal.default_int_handler)

    # what one rank has not noted any more
    pipeline._work = None if RANK == LAST else np.ones(len(pipeline.mesh.owned_rows))
    pipeline._wants_plan, pipeline._last_imbalance = True, float(RANK)
    pipeline.mesh.ranks._duplicate.num_pipelines += RANK == LAST
    assert DistributedPipeline(pipeline.mesh).mesh_ccd(x, y).toi == pipeline.mesh_ccd(x, y).toi


def copies(found):
    """A result is saved on each rank; what belongs to all of them stays behind."""
    for again in (pickle.loads(pickle.dumps(found)), copy.deepcopy(found)):
        assert again.toi == found.toi and np.array_equal(again.contacts.points, found.contacts.points)
        everywhere(ValueError, ["to_root() is called on a copy"], again.contacts.to_root)


def together():
    mesh, start, end = scenes.sheet_over_ball()
    mesh = whole_mesh(mesh)
    rank_of_face = np.arange(mesh.num_faces) * SIZE // mesh.num_faces
    cut = Cut(COMM, mesh, rank_of_face, np.random.default_rng(RANK))
    pipeline, one = DistributedPipeline(cut.mesh), ccd.CollisionPipeline(mesh)
    x, y = cut.local(start), cut.local(end)
    compare_call(COMM, cut, pipeline, one, start, end, "mesh_ccd")

    own = int(cut.mesh.owned_rows[3])
    bad = x.copy()
    bad[own, 1] = np.nan if RANK == LAST else bad[own, 1]
    vertex = COMM.bcast(int(cut.mesh.vertex_ids[own]), root=LAST)
    everywhere(
        ValueError, [f"rank {LAST}: vertices_t0", "nan", f"vertex id {vertex}"], lambda: pipeline.mesh_ccd(bad, y)
    )
    everywhere(
        ValueError, [f"rank {LAST}: positions", "nan", f"vertex id {vertex}"], lambda: pipeline.find_proximity(bad, 0.1)
    )
    everywhere(
        ValueError, [f"rank {LAST}: positions", "nan", f"vertex id {vertex}"], lambda: pipeline.find_intersections(bad)
    )
    short = y[:-1] if RANK == 0 else y
    everywhere(ValueError, ["rank 0: vertices_t1 has shape"], lambda: pipeline.collision_free_step(x, short))
    # a fault deep in the engine, on one rank only
    limits = {"memory_limit": 1000} if RANK == LAST else {}
    limited = DistributedPipeline(cut.mesh, **limits)
    everywhere(ValueError, [f"rank {LAST}: memory_limit is 1000 bytes"], lambda: limited.mesh_ccd(x, y))
    everywhere(ValueError, [f"rank {LAST}: memory_limit is 1000 bytes"], lambda: limited.find_intersections(x))
    everywhere(ValueError, [f"rank {LAST}: memory_limit is 1000 bytes"], lambda: limited.collision_free_step(x, y))

    def unforeseen(*_, **options):
        raise KeyError("unforeseen")

    pipeline._run = unforeseen if RANK == 0 else type(pipeline)._run.__get__(pipeline)
    everywhere(RuntimeError, ["rank 0: KeyError", "unforeseen"], lambda: pipeline.mesh_ccd(x, y))
    del pipeline._run
    everywhere(ValueError, ["options differ"], lambda: DistributedPipeline(cut.mesh, tolerance=1e-6 * (1 + RANK)))
    thick = DistributedMesh(COMM, scenes.TRIANGLE, scenes.FACE, vertex_ids=np.arange(3), radius=0.1)
    everywhere(ValueError, ["minimum_separation is 0.1"], lambda: DistributedPipeline(thick, minimum_separation=0.1))
    everywhere(TypeError, ["rank 0", "no_option"], lambda: DistributedPipeline(cut.mesh, no_option=1))
    everywhere(ValueError, ["rank 0: line_search: per is"], lambda: pipeline.line_search(x, y, per="hour"))
    everywhere(ValueError, ["inflation is"], lambda: pipeline.find_candidates(x, y, 0.1 * RANK))
    everywhere(ValueError, ["search_radius is 1.0 on"], lambda: pipeline.displacement_bounds(x, 1.0 + RANK))
    everywhere(
        ValueError, ["rank 0: displacement_bounds: search_radius is 0"], lambda: pipeline.displacement_bounds(x, RANK)
    )

    # ranks that would wait for each other
    for calls in (("mesh_ccd", "collision_free_step"), ("line_search", "find_candidates")):
        everywhere(
            ValueError,
            ["rank 0 calls", f"{calls[0]}", f"and rank 1 {calls[1]}"],
            lambda calls=calls: getattr(pipeline, calls[min(RANK, 1)])(x, y),
        )
    everywhere(
        ValueError,
        ["rank 0 calls find_intersections and rank 1 find_proximity"],
        lambda: pipeline.find_proximity(x, 0.1) if RANK else pipeline.find_intersections(x),
    )
    for name, values in (("per", ("body", "vertex")), ("safety", (0.5, 0.6)), ("max_rounds", (3, 4))):
        given = {name: values[min(RANK, 1)]}
        everywhere(
            ValueError,
            [f"{name}={values[0]!r}", f"{name}={values[1]!r}"],
            lambda given=given: pipeline.line_search(x, y, **given),
        )
    several = [pipeline, limited]
    everywhere(ValueError, ["of pipeline 2"], lambda: several[min(RANK, 1)].mesh_ccd(x, y))
    interrupted(pipeline, x, y)
    # no memory for the buffers of an exchange: what was begun of it ends without a word
    unraisable, sys.unraisablehook = [], lambda given: unraisable.append(given.exc_value)
    with contextlib.suppress(MemoryError, ValueError):
        _exchange._Requests(cut.mesh.ranks, [1 << 60] * SIZE, [0] * SIZE, 3)
    sys.unraisablehook = sys.__unraisablehook__
    assert not unraisable, unraisable
    copies(pipeline.mesh_ccd(x, y))
    assert len(pickle.loads(pickle.dumps(pipeline.find_intersections(x)))) == 0

    triangle, face = scenes.TRIANGLE, scenes.FACE
    ids, ground = np.arange(3), ccd.HalfSpace([0, 0, -1], [0, 0, 1])

    def made(**changed):
        return lambda: DistributedMesh(COMM, triangle, face, **({"vertex_ids": ids} | changed))

    for parts, call in (
        (["rank 0: owned is set for vertex id", f"on {SIZE} ranks"], made(owned=np.ones(3, dtype=bool))),
        (["owned is given on some ranks"], made(owned=np.zeros(3, dtype=bool) if RANK == 0 else None)),
        (["bodies of vertex id 0 differs between ranks 0 and 1"], made(bodies=np.full(3, min(RANK, 1)))),
        (
            [f"rank {LAST}: vertex_ids holds 4 more than once"],
            made(vertex_ids=np.array([4, 4, 5]) if RANK == LAST else ids),
        ),
        (["vertex_ids holds 9223372036854775813"], made(vertex_ids=ids.astype(np.uint64) + np.uint64(2**63 + 3))),
        (["static", "differs between ranks"], made(static=[0] if RANK == 0 else [])),
        (["radius is given on some ranks"], made(radius=0.1 if RANK == 0 else None)),
        (["rank 0: exclude_pairs is"], made(exclude_pairs={"edge_edge": [[0, 1]]})),
        (["half_spaces differs between ranks"], made(half_spaces={1: ground} if RANK else {})),
        (["half_spaces differs"], made(half_spaces={1: ccd.HalfSpace([0, 0, RANK], [0, 0, 1])})),
        (["rank 0: bodies gives vertex id 0 body 0, which is a half-space"], made(half_spaces={0: ground})),
        (["rank 0: normal of body 1 is [0.0, 0.0, 0.0]"], made(half_spaces={1: ccd.HalfSpace([0, 0, 0], [0, 0, 0])})),
        (["rank 0: half_spaces is"], made(half_spaces=[ground])),
        (["rank 0: half_spaces has the key 'ground'"], made(half_spaces={"ground": ground})),
        ([f"rank {LAST}: half_spaces holds"], made(half_spaces={1: 2.0 if RANK == LAST else ground})),
        (["half_spaces holds 9; expected numbers below 4"], made(half_spaces={9: ground})),
        (["holds id 7; expected ids of the whole"], made(exclude_pairs={"vertices": np.array([[7, 1]], np.uint64)})),
        (
            ["exclude_pairs['vertices'] is a masked array"],
            made(exclude_pairs={"vertices": np.ma.array([[0, 1]], mask=True)}),
        ),
    ):
        everywhere(ValueError, parts, call)
    # the same pairs, in the integers that each rank has; and none at all
    made(exclude_pairs={"vertices": np.array([[0, 1]], dtype=np.int32 if RANK == 0 else np.int64)})()
    made(exclude_pairs={"vertices": []})()
    # MPI has few communicators to give, some thousands; a program may make a mesh in every step
    assert DistributedMesh(COMM, triangle, face, vertex_ids=ids).ranks.comm == cut.mesh.ranks.comm
    # keys of contacts leave vertices that meet planes a bit less; here there is no memory for so many
    grounded = DistributedPipeline(DistributedMesh(COMM, triangle, face, vertex_ids=ids, half_spaces={1: ground}))
    most, _part.MOST_WITH_PLANES = _part.MOST_WITH_PLANES, 2
    everywhere(ValueError, ["holds 3 vertices; expected at most 2"], lambda: grounded.mesh_ccd(triangle, triangle))
    _part.MOST_WITH_PLANES = most
    assert 0.499 < grounded.mesh_ccd(triangle, triangle - [0, 0, 2]).toi <= 0.5
    wrong = face + (RANK == LAST)
    everywhere(
        ValueError,
        [f"rank {LAST}: faces holds index 3"],
        lambda: DistributedMesh(COMM, triangle, wrong, vertex_ids=ids),
    )
    descending = {"vertex_ids": np.array([0, 7, 9]), "bodies": np.array([1, 0, 0])}
    everywhere(
        ValueError,
        ["bodies gives vertex id 0 body 1 and the next, 7, body 0"],
        lambda: DistributedMesh(COMM, triangle, scenes.NO_FACES, **descending),
    )
    columns = 2 if RANK == LAST else 3
    everywhere(
        ValueError,
        [f"vertices has 2 columns on rank {LAST} and 3 on rank 0"],
        lambda: DistributedMesh(COMM, triangle[:, :columns], vertex_ids=ids),
    )
    flat = DistributedPipeline(DistributedMesh(COMM, triangle[:, :2], vertex_ids=ids, edges=[[0, 1]]))
    everywhere(ValueError, ["vertices_t0 has shape (3, 3); expected (3, 2)"], lambda: flat.mesh_ccd(triangle, triangle))
    everywhere(
        ValueError, ["faces has shape (1, 3)"], lambda: DistributedMesh(COMM, triangle[:, :2], face, vertex_ids=ids)
    )
    alone = {"vertex_ids": ids[:0], "half_spaces": {0: ground}}
    everywhere(
        ValueError, ["half_spaces holds all bodies"], lambda: DistributedMesh(COMM, triangle[:0], face[:0], **alone)
    )
    # and after all that the pipeline works
    compare_call(COMM, cut, pipeline, one, start, end, "mesh_ccd")
    print(f"rank {RANK} has seen the errors of the others", flush=True)


def killed():
    mesh, start, end = scenes.sheet_over_ball()
    mesh = whole_mesh(mesh)
    cut = Cut(COMM, mesh, np.arange(mesh.num_faces) % SIZE, np.random.default_rng(RANK))
    pipeline = DistributedPipeline(cut.mesh)
    for k in range(1_000_000):
        if k == 3 and RANK == LAST:
            os.kill(os.getpid(), signal.SIGKILL)
        pipeline.collision_free_step(cut.local(start), cut.local(end))


if __name__ == "__main__":
    {"together": together, "killed": killed}[sys.argv[1]]()
