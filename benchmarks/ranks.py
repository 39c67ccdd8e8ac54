"""Steps of one scene on 1 and more ranks, one thread each, beside one process with as many threads.

    mpiexec -n 2 python benchmarks/ranks.py --faces 1000000

Each rank takes a part of the scene, a band of the cloth and of the sphere; rank 0 keeps all of it only for the process
that it compares with. The bands are across a diagonal, along which no region is cut, as a code that divides its mesh by
place does not know ours. With ``--parts torn`` each rank has every other face in the order of the mesh and so all
vertices, which rank 0 owns: the worst that can be handed in. Prints seconds of a step by stage and rank, the median of
the steps, and bytes sent.
"""

from __future__ import annotations

import argparse
import itertools
import os
import time
from collections.abc import Callable

import numpy as np
from scenes import Scene, cloth_over_sphere

import ccd_warp as ccd
from ccd_warp.distributed import DistributedMesh, DistributedPipeline


def part_of(comm, scene: Scene, parts: str) -> tuple[DistributedMesh, np.ndarray]:
    """The part of a scene on a rank, as many faces of every body as on the others, and the rows of its vertices."""
    rank, size = comm.Get_rank(), comm.Get_size()
    bodies = list(itertools.pairwise(np.cumsum([0, *scene.body_faces])))
    chosen = []
    for begin, end in bodies:
        along = scene.vertices_t0[scene.faces[begin:end], :2].sum(axis=(1, 2))
        ordered = begin + np.argsort(along, kind="stable")
        torn = np.arange(begin + rank, end, size)
        chosen.append(torn if parts == "torn" else np.array_split(ordered, size)[rank])
    rows, local = np.unique(scene.faces[np.concatenate(chosen)], return_inverse=True)
    firsts = [scene.faces[a:b].min() for a, b in bodies]
    options = {"bodies": np.searchsorted(firsts, rows, side="right") - 1, "self_collision": scene.self_collision}
    start, faces = scene.vertices_t0[rows], local.reshape(-1, 3)
    return DistributedMesh(comm, start, faces, vertex_ids=rows, static=scene.static, **options), rows


def seconds_of(
    step: Callable, start: np.ndarray, end: np.ndarray, rounds: int, barrier: Callable = lambda: None
) -> np.ndarray:
    """Milliseconds of each of some steps; the cloth goes on a little in each."""
    seconds = []
    for k in range(rounds + 2):
        shift = (end - start) * (0.01 * k)
        x, y = start + shift, end + shift
        barrier()
        begin = time.perf_counter()
        step(x, y)
        barrier()
        seconds.append(time.perf_counter() - begin)
    return 1e3 * np.array(seconds[2:])


def measure(comm, num_faces: int, rounds: int, parts: str) -> None:
    """Steps of the scene on these ranks, and on rank 0 alone."""
    scene = cloth_over_sphere(num_faces)
    mesh, rows = part_of(comm, scene, parts)
    rank, size = comm.Get_rank(), comm.Get_size()
    if rank == 0:
        print(f"{num_faces:,} faces on {size} ranks, one thread each, parts: {parts}; milliseconds, least and median")
    for call in ("mesh_ccd", "collision_free_step"):
        pipeline = DistributedPipeline(mesh, num_threads=1, device="cpu")
        works = []

        def step(x, y, call=call, pipeline=pipeline, works=works):
            getattr(pipeline, call)(x, y)
            works.append(pipeline.work)

        frames = scene.vertices_t0[rows], scene.vertices_t1[rows]
        ours = seconds_of(step, *frames, rounds, comm.Barrier)
        names = sorted({name for work in works for name in work.timings})
        median = {name: 1e3 * np.median([work.timings.get(name, 0.0) for work in works[2:]]) for name in names}
        sent = int(np.median([work.bytes_sent for work in works[2:]]))
        plans = sum("plan" in work.timings for work in works)
        mine = (
            f"  rank {rank}: {pipeline.work.num_primitives:,} primitives, {pipeline.work.num_ghosts:,} of them of "
            f"other regions, {sent:,} bytes a step, {plans} plans; "
        )
        of_ranks = comm.gather(mine + ", ".join(f"{name} {ms:.1f}" for name, ms in median.items()), root=0)
        if rank == 0:
            bound = os.sched_getaffinity(0)
            os.sched_setaffinity(0, range(os.cpu_count() or 1))  # mpiexec binds a rank, and so its threads, to one core
            whole = ccd.CollisionPipeline(scene.mesh(ccd), num_threads=size, device="cpu")
            alone = seconds_of(getattr(whole, call), scene.vertices_t0, scene.vertices_t1, rounds)
            os.sched_setaffinity(0, bound)
            print(
                f"{call}: {ours.min():.1f}, {np.median(ours):.1f}; one process with as many threads "
                f"{alone.min():.1f}, {np.median(alone):.1f}"
            )
            print("\n".join(of_ranks))
        request = comm.Ibarrier()  # the others wait without taking a core
        while not request.Test():
            time.sleep(0.01)


def main() -> None:
    """Measure on the ranks of MPI."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faces", type=int, default=1_000_000, help="faces of the scene (1000000)")
    parser.add_argument("--parts", choices=["place", "torn"], default="place", help="what a rank hands in (place)")
    parser.add_argument("--rounds", type=int, default=20, help="steps that are measured (20)")
    arguments = parser.parse_args()
    from mpi4py import MPI

    measure(MPI.COMM_WORLD, arguments.faces, arguments.rounds, arguments.parts)


if __name__ == "__main__":
    main()
