"""Steps of one scene on ranks of one thread each, beside one rank that has all of it; what they send and hold.

    mpiexec -n 2 python benchmarks/ranks.py --faces 1000000

Each rank takes a part of the scene, a band of the cloth and of the sphere. The bands are across a diagonal, along which
no region is cut, as a code that divides its mesh by place does not know ours. With ``--parts torn`` each rank has every
other face in the order of the mesh and so all vertices, which rank 0 owns: the worst that can be handed in. Steps of
all ranks and of one alternate, and the least of each counts, of wall time and of the processor time of the busiest rank
beside waits, which others on the machine disturb less. Prints milliseconds of a step by stage and rank, what a rank
sends in one, and by how much its memory has grown from before its mesh was made.
"""

from __future__ import annotations

import argparse
import itertools
import os
import time

import numpy as np
from scenes import Scene, cloth_over_sphere

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


def resident() -> float:
    """Memory of this process in MiB."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def wait_for_all(comm) -> None:
    """A barrier at which ranks sleep: elsewhere MPI asks all the time, on cores that the others need."""
    request = comm.Ibarrier()
    while not request.Test():
        time.sleep(1e-4)


class Waits:
    """What mpi4py offers, with the processor time that calls of it take, as ranks that wait ask all the time."""

    seconds = 0.0

    def __init__(self, of) -> None:
        self._of = of

    def __getattr__(self, name: str):
        found = getattr(self._of, name)
        if name not in ("Allreduce", "Alltoall", "Waitall", "Request"):
            return found
        return Waits(found)

    def __call__(self, *arguments, **named):
        begin = time.process_time()
        try:
            return self._of(*arguments, **named)
        finally:
            Waits.seconds += time.process_time() - begin


class Loop:
    """Steps of a scene on some ranks; the cloth goes on a little in each."""

    def __init__(self, comm, scene: Scene, parts: str, call: str) -> None:
        self.comm, before = comm, resident()
        mesh, rows = part_of(comm, scene, parts)
        self.pipeline = DistributedPipeline(mesh, num_threads=1, device="cpu")
        self.start, self.end = scene.vertices_t0[rows], scene.vertices_t1[rows]
        self.call, self.seconds, self.busy, self.works, self._before = call, [], [], [], before
        mesh.ranks.comm, mesh.ranks.mpi = Waits(mesh.ranks.comm), Waits(mesh.ranks.mpi)

    def step(self, k: int) -> None:
        """Measure a step."""
        shift = (self.end - self.start) * (0.01 * k)
        x, y = self.start + shift, self.end + shift
        wait_for_all(self.comm)
        Waits.seconds, begin, busy = 0.0, time.perf_counter(), time.process_time()
        getattr(self.pipeline, self.call)(x, y)
        self.seconds.append(time.perf_counter() - begin)
        self.busy.append(time.process_time() - busy - Waits.seconds)
        self.works.append(self.pipeline.work)

    def described(self) -> str:
        """What this rank did in the steps in which the plan was kept."""
        kept = [work for work in self.works[2:] if not work.is_planned]
        names = sorted({name for work in kept for name in work.timings})
        of_stages = ", ".join(f"{name} {1e3 * min(work.timings.get(name, 0.0) for work in kept):.1f}" for name in names)
        work, sent = kept[-1], kept[-1].sent
        return (
            f"  rank {self.comm.rank}: {work.counts.num_vertices:,} vertices, {work.num_ghosts:,} of other regions; "
            f"a step sends {sent.num_bytes:,} bytes in {sent.num_messages} messages and takes {sent.num_reductions} "
            f"reductions; {len(self.works) - len(kept) - 1} plans; {resident() - self._before:.0f} MiB; ms: {of_stages}"
        )


def measure(comm, num_faces: int, rounds: int, parts: str) -> None:
    """Steps of the scene on these ranks, and on rank 0 alone."""
    from mpi4py import MPI

    scene = cloth_over_sphere(num_faces)
    if comm.rank == 0:
        print(f"{num_faces:,} faces on {comm.size} ranks, one thread each, parts: {parts}")
    for call in ("mesh_ccd", "collision_free_step"):
        ours = Loop(comm, scene, parts, call)
        alone = Loop(MPI.COMM_SELF, scene, parts, call) if comm.rank == 0 else None
        for k in range(rounds + 2):
            ours.step(k)
            wait_for_all(comm)
            if alone is not None:
                alone.step(k)
            wait_for_all(comm)
        slowest = [np.max(comm.allgather(values), axis=0) for values in (ours.seconds, ours.busy)]
        of_ranks = comm.gather(ours.described(), root=0)
        if alone is not None:
            least, busy = (1e3 * values[2:].min() for values in slowest)
            of_one, busy_one = 1e3 * min(alone.seconds[2:]), 1e3 * min(alone.busy[2:])
            print(
                f"{call}: {least:.1f} ms, on one rank {of_one:.1f}: {least / of_one:.2f}; of processor time of the "
                f"busiest rank without waits {busy:.1f} and {busy_one:.1f}: {busy / busy_one:.2f}"
            )
            print("\n".join([*of_ranks, alone.described()]), flush=True)


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
