"""Steps of one scene on 1 and more ranks, one thread each, beside one process with as many threads.

    mpiexec -n 1 python -m ccd_warp.benchmarks.distributed_scaling --faces 1000000
    mpiexec -n 2 python -m ccd_warp.benchmarks.distributed_scaling --faces 1000000 --output two.json

Each rank makes a part of the scene, a band of the cloth and of the sphere; rank 0 makes all of it only for the process
that it compares with. Prints seconds of a step by stage and rank, the median of the steps, and bytes sent.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from pathlib import Path

import numpy as np
from ccd_warp.benchmarks.scenes import Scene, cloth_over_sphere

import ccd_warp as ccd
from ccd_warp.distributed import DistributedMesh, DistributedPipeline


def part_of(comm, scene: Scene) -> tuple[DistributedMesh, np.ndarray]:
    """The part of a scene on a rank, consecutive faces of every body, and the rows of its vertices."""
    rank, size = comm.Get_rank(), comm.Get_size()
    low = np.cumsum([0, *scene.body_faces])
    bodies = list(itertools.pairwise(low))
    chosen = [np.arange(a + (b - a) * rank // size, a + (b - a) * (rank + 1) // size) for a, b in bodies]
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


def measure(comm, num_faces: int, rounds: int) -> dict:
    """Steps of the scene on these ranks, and on rank 0 alone."""
    scene = cloth_over_sphere(num_faces)
    mesh, rows = part_of(comm, scene)
    frames = scene.vertices_t0[rows], scene.vertices_t1[rows]
    result: dict = {"faces": num_faces, "ranks": comm.Get_size(), "calls": {}}
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
            one = ccd.CollisionPipeline(scene.mesh(ccd), num_threads=comm.Get_size(), device="cpu")
        alone = []
        for k in range(rounds + 2):
            # the other ranks wait without taking a core
            if comm.Get_rank() == 0:
                shift = (scene.vertices_t1 - scene.vertices_t0) * (0.01 * k)
                x, y = scene.vertices_t0 + shift, scene.vertices_t1 + shift
                begin = time.perf_counter()
                getattr(one, call)(x, y)
                alone.append(time.perf_counter() - begin)
        result["calls"][call]["one_process"] = alone[2:]
        request = comm.Ibarrier()
        while not request.Test():
            time.sleep(0.01)
    return result


def lines_of(result: dict) -> list[str]:
    """What is printed."""
    lines = [f"{result['faces']:,} faces on {result['ranks']} ranks, one thread each; milliseconds, least and median"]
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
    parser.add_argument("--rounds", type=int, default=20, help="steps that are measured (20)")
    parser.add_argument("--output", type=Path, help="file for the raw figures")
    arguments = parser.parse_args()
    from mpi4py import MPI

    result = measure(MPI.COMM_WORLD, arguments.faces, arguments.rounds)
    if MPI.COMM_WORLD.Get_rank() == 0:
        print("\n".join(lines_of(result)))
        if arguments.output:
            arguments.output.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
