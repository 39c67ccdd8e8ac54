"""Steps of one scene on 1 and more ranks, one thread each, beside one process with as many threads.

    mpiexec -n 1 python -m ccd_warp.benchmarks.distributed_scaling --faces 1000000
    mpiexec -n 2 python -m ccd_warp.benchmarks.distributed_scaling --faces 1000000 --output two.json

Each rank takes a part of the scene, a band of the cloth and of the sphere; rank 0 keeps all of it only for the process
that it compares with. The bands are across a diagonal, along which no region is cut, as a code that divides its mesh by
place does not know ours. With ``--parts torn`` each rank has every other face in the order of the mesh and so all
vertices, which rank 0 owns: the worst that can be handed in. Prints seconds of a step by stage and rank, the median of
the steps, and bytes sent.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
        if parts == "torn":
            chosen.append(np.arange(begin + rank, end, size))
            continue
        along = scene.vertices_t0[scene.faces[begin:end], :2].sum(axis=(1, 2))
        ordered = begin + np.argsort(along, kind="stable")
        chosen.append(np.array_split(ordered, size)[rank])
    faces = scene.faces[np.concatenate(chosen)]
    rows, local = np.unique(faces, return_inverse=True)
    firsts = [scene.faces[a:b].min() for a, b in bodies]
    mesh = DistributedMesh(
        comm,
        scene.vertices_t0[rows],
        local.reshape(-1, 3),
        vertex_ids=rows,
        bodies=np.searchsorted(firsts, rows, side="right") - 1,
        static=scene.static,
        self_collision=scene.self_collision,
    )
    return mesh, rows


def seconds_of(step, frames, rounds: int, comm) -> list[float]:
    """Seconds of each of some steps, on all ranks together; the cloth goes on a little in each."""
    start, end = frames
    seconds = []
    for k in range(rounds + 2):
        shift = (end - start) * (0.01 * k)
        x, y = start + shift, end + shift
        comm.Barrier()
        begin = time.perf_counter()
        step(x, y)
        comm.Barrier()
        seconds.append(time.perf_counter() - begin)
    return seconds[2:]


def seconds_alone(scene: Scene, call: str, rounds: int, num_threads: int) -> list[float]:
    """Seconds of the same steps in one process with so many threads."""
    seconds = []
    with on_all_cores():
        pipeline = ccd.CollisionPipeline(scene.mesh(ccd), num_threads=num_threads, device="cpu")
        for k in range(rounds + 2):
            shift = (scene.vertices_t1 - scene.vertices_t0) * (0.01 * k)
            x, y = scene.vertices_t0 + shift, scene.vertices_t1 + shift
            begin = time.perf_counter()
            getattr(pipeline, call)(x, y)
            seconds.append(time.perf_counter() - begin)
    return seconds[2:]


@contextmanager
def on_all_cores() -> Iterator[None]:
    """A block whose threads may run on every core; mpiexec binds a rank, and so its threads, to one."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def measure(comm, num_faces: int, rounds: int, parts: str) -> dict:
    """Steps of the scene on these ranks, and on rank 0 alone."""
    scene = cloth_over_sphere(num_faces)
    mesh, rows = part_of(comm, scene, parts)
    frames = scene.vertices_t0[rows], scene.vertices_t1[rows]
    result: dict = {"faces": num_faces, "ranks": comm.Get_size(), "parts": parts, "calls": {}}
    for call in ("mesh_ccd", "collision_free_step"):
        pipeline = DistributedPipeline(mesh, num_threads=1, device="cpu")
        stages = []

        def step(x, y, call=call, pipeline=pipeline, stages=stages):
            getattr(pipeline, call)(x, y)
            stages.append((pipeline.work.timings, pipeline.work.bytes_sent))

        seconds = seconds_of(step, frames, rounds, comm)
        names = sorted({name for timings, _ in stages for name in timings})
        median = {name: float(np.median([timings.get(name, 0.0) for timings, _ in stages[2:]])) for name in names}
        work = pipeline.work
        mine = {
            "stages": median,
            "bytes": int(np.median([sent for _, sent in stages[2:]])),
            "primitives": work.num_primitives,
            "ghosts": work.num_ghosts,
            "imbalance": work.imbalance,
            "plans": sum("plan" in timings for timings, _ in stages),
        }
        result["calls"][call] = {"seconds": seconds, "by_rank": comm.gather(mine, root=0)}
        if comm.Get_rank() == 0:
            result["calls"][call]["one_process"] = seconds_alone(scene, call, rounds, comm.Get_size())
        # the others wait without taking a core
        request = comm.Ibarrier()
        while not request.Test():
            time.sleep(0.01)
    return result


def lines_of(result: dict) -> list[str]:
    """What is printed."""
    heading = f"{result['faces']:,} faces on {result['ranks']} ranks, one thread each, parts: {result['parts']}"
    lines = [f"{heading}; milliseconds, least and median"]
    for call, of in result["calls"].items():
        ours, alone = (1e3 * np.array(of[name]) for name in ("seconds", "one_process"))
        lines.append(
            f"{call}: {ours.min():.1f}, {np.median(ours):.1f}; "
            f"one process with as many threads {alone.min():.1f}, {np.median(alone):.1f}"
        )
        for rank, mine in enumerate(of["by_rank"]):
            stages = ", ".join(f"{name} {1e3 * seconds:.1f}" for name, seconds in mine["stages"].items())
            lines.append(
                f"  rank {rank}: {mine['primitives']:,} primitives, {mine['ghosts']:,} of them of other regions, "
                f"{mine['bytes']:,} bytes a step, {mine['plans']} plans; {stages}"
            )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faces", type=int, default=1_000_000, help="faces of the scene (1000000)")
    parser.add_argument("--parts", choices=["place", "torn"], default="place", help="what a rank hands in (place)")
    parser.add_argument("--rounds", type=int, default=20, help="steps that are measured (20)")
    parser.add_argument("--output", type=Path, help="file for the raw figures")
    arguments = parser.parse_args()
    from mpi4py import MPI

    result = measure(MPI.COMM_WORLD, arguments.faces, arguments.rounds, arguments.parts)
    if MPI.COMM_WORLD.Get_rank() == 0:
        print("\n".join(lines_of(result)))
        if arguments.output:
            arguments.output.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
