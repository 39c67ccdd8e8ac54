"""The partition and the plan of many ranks, run in one process without MPI, and a model of the time of a step.

    python -m ccd_warp.benchmarks.distributed_simulation --faces 4000000 16000000 --ranks 16 64 256 1024

The regions, the primitives that meet them, and the vertices that travel are what ranks would have: they come from the
same functions. The application is taken to own vertices by the same regions. Seconds are a **model**: the work of the
slowest rank at a measured rate of one core, and its messages on a network of 10 GB/s and 2 µs.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from ccd_warp.benchmarks.scenes import Scene, cloth_over_sphere, pile

import ccd_warp as ccd
from ccd_warp._input.edges import unique_edges
from ccd_warp.distributed import _partition as partition
from ccd_warp.distributed._plan import Bounds, scene_box, united
from ccd_warp.distributed._planning import LEAST_SAMPLES, SAMPLES_EACH

BYTES_A_SECOND = 10e9
LATENCY = 2e-6
# Reductions and agreements of a step, each of which takes the latency once for every level of a tree of ranks.
_REDUCTIONS = 24
# Positions at both ends of a step, and a toi on the way back.
_BYTES_FORTH, _BYTES_BACK = 48, 8
# What docs/architecture.md says of memory: a primitive with two AABBs, a vertex with two of its own; and here what a
# vertex takes beside that: positions twice on either side, boxes of the plan, numbers.
_BYTES_A_PRIMITIVE, _BYTES_A_VERTEX = 32 + 2 * 26, 2 * 32 + 4 * 24 + 3 * 32 + 32
_CHUNK = 1 << 21


@dataclass(frozen=True)
class Simulated:
    """One scene on a number of ranks; of ranks the mean and the largest.

    Attributes:
        scene: Its name.
        faces: Faces of the scene.
        ranks: Number of ranks.
        faces_each: Faces on a rank.
        ghosts_each: Those of them whose boxes begin in another region.
        imbalance: The most primitives of a rank in multiples of the mean.
        duplicates: Primitives of all ranks in multiples of those of the scene.
        neighbours: Ranks from which a rank gets positions.
        bytes_each: Bytes that a rank receives in a step.
        memory_each: Bytes that a part takes.
        seconds_to_plan: Seconds of this process for the partition and the lists.
        model: Modelled seconds of a step: of the work, of messages, of reductions, and all.
        efficiency: Modelled speed in multiples of one core, for each rank.
    """

    scene: str
    faces: int
    ranks: int
    faces_each: tuple[float, int]
    ghosts_each: tuple[float, int]
    imbalance: float
    duplicates: float
    neighbours: tuple[float, int]
    bytes_each: tuple[float, int]
    memory_each: tuple[float, int]
    seconds_to_plan: float
    model: dict[str, float]
    efficiency: float


def chunks(count: int) -> Iterator[slice]:
    """Ranges of items, so many at a time that their boxes fit into memory."""
    return (slice(k, min(k + _CHUNK, count)) for k in range(0, count, _CHUNK))


def simulate(scene: Scene, edges: np.ndarray, num_ranks: int, seconds_a_primitive: float) -> Simulated:
    """Divide a scene over ranks, given its edges and the time of a primitive on one core."""
    begin = time.perf_counter()
    start, end = scene.vertices_t0, scene.vertices_t1
    count = len(start)
    sample = edges[partition.even_samples(len(edges), 100_000)]
    extent = float(np.abs(start[sample[:, 0]] - start[sample[:, 1]]).max(axis=1).mean())
    bounds = Bounds.of(extent, 0.0, *scene_box(start, end))
    lower, upper = bounds.boxes(start, end, np.zeros(1, dtype=np.int64))
    kinds = {"vertex": np.arange(count)[:, None], "edge": edges, "face": scene.faces}
    total = sum(map(len, kinds.values()))
    boxes = []
    for corners in kinds.values():
        num = max(LEAST_SAMPLES, SAMPLES_EACH * num_ranks) * len(corners) // total
        boxes.append(np.concatenate(united(lower, upper, corners[partition.even_samples(len(corners), num)])))
    samples = np.concatenate(boxes, axis=1)
    regions = partition.bisected(samples[:4], np.ones(samples.shape[1]), num_ranks, samples[4:])
    owner = partition.region_of(regions, lower)
    primitives = np.zeros(num_ranks, dtype=np.int64)
    ghosts, faces = np.zeros(num_ranks, dtype=np.int64), np.zeros(num_ranks, dtype=np.int64)
    needed: list[list[np.ndarray]] = [[] for _ in range(num_ranks)]
    for kind, corners in kinds.items():
        for part in chunks(len(corners)):
            box = united(lower, upper, corners[part])
            met = partition.regions_met(regions, *box)
            sizes = np.array([len(items) for items in met])
            primitives += sizes
            if kind == "face":
                faces += sizes
                ghosts += sizes - np.bincount(partition.region_of(regions, box[0]), minlength=num_ranks)
            for rank, items in enumerate(met):
                used = corners[part][items]
                # vertices of its own a rank has anyway
                needed[rank].append(np.unique(used[owner[used] != rank]))
    remote = np.zeros(num_ranks, dtype=np.int64)
    neighbours = np.zeros(num_ranks, dtype=np.int64)
    for rank in range(num_ranks):
        vertices = np.unique(np.concatenate(needed[rank]))
        remote[rank] = len(vertices)
        neighbours[rank] = len(np.unique(owner[vertices]))
    seconds = time.perf_counter() - begin
    own = np.bincount(owner, minlength=num_ranks)
    memory = _BYTES_A_PRIMITIVE * primitives + _BYTES_A_VERTEX * (own + remote)
    traffic = (_BYTES_FORTH + _BYTES_BACK) * remote
    work = seconds_a_primitive * float(primitives.max())
    messages = float((2 * LATENCY * neighbours + traffic / BYTES_A_SECOND).max())
    reductions = _REDUCTIONS * LATENCY * math.ceil(math.log2(num_ranks))
    model = {"work": work, "messages": messages, "reductions": reductions, "all": work + messages + reductions}

    def each(values: np.ndarray) -> tuple[float, int]:
        return float(values.mean()), int(values.max())

    return Simulated(
        scene.name,
        len(scene.faces),
        num_ranks,
        each(faces),
        each(ghosts),
        partition.imbalance(primitives),
        float(primitives.sum()) / total,
        each(neighbours),
        each(traffic),
        each(memory),
        seconds,
        model,
        seconds_a_primitive * total / model["all"] / num_ranks,
    )


def measured_rate(num_faces: int = 200_000, rounds: int = 7) -> float:
    """Seconds of a primitive in `mesh_ccd` on one core: the least of some steps, divided by all primitives."""
    scene = cloth_over_sphere(num_faces)
    mesh = scene.mesh(ccd)
    pipeline = ccd.CollisionPipeline(mesh, num_threads=1, device="cpu")
    seconds = []
    for _ in range(rounds):
        begin = time.perf_counter()
        pipeline.mesh_ccd(scene.vertices_t0, scene.vertices_t1)
        seconds.append(time.perf_counter() - begin)
    return min(seconds) / (mesh.num_vertices + mesh.num_edges + mesh.num_faces)


def table(rows: list[Simulated]) -> list[str]:
    """The figures as a table of Markdown."""
    head = (
        "| scene | ranks | faces a rank: mean, most | ghosts: mean, most | imbalance | duplicates "
        "| neighbours: mean, most | MB a step: mean, most | memory, MB: mean, most | model: ms of a step "
        "| of these work | efficiency |"
    )
    lines = [head, "|" + "---|" * 12]
    for row in rows:
        both = [f"{mean:,.0f}, {most:,}" for mean, most in (row.faces_each, row.ghosts_each)]
        sizes = [f"{mean / 1e6:.2f}, {most / 1e6:.2f}" for mean, most in (row.bytes_each, row.memory_each)]
        lines.append(
            f"| {row.scene} | {row.ranks:,} | {both[0]} | {both[1]} | {row.imbalance:.2f} | {row.duplicates:.3f} "
            f"| {row.neighbours[0]:.1f}, {row.neighbours[1]} | {sizes[0]} | {sizes[1]} "
            f"| {1e3 * row.model['all']:.2f} | {1e3 * row.model['work']:.2f} | {row.efficiency:.2f} |"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faces", type=int, nargs="+", default=[4_000_000, 16_000_000], help="faces of the scenes")
    parser.add_argument("--ranks", type=int, nargs="+", default=[16, 64, 256, 1024], help="numbers of ranks")
    parser.add_argument("--nanoseconds", type=float, help="of a primitive on one core (measured)")
    parser.add_argument("--output", type=Path, help="file for the raw figures")
    arguments = parser.parse_args()
    rate = 1e-9 * arguments.nanoseconds if arguments.nanoseconds else measured_rate()
    print(f"{1e9 * rate:.1f} ns of a primitive on one core; the time of a step is a model, not a measurement\n")
    rows: list[Simulated] = []
    for num_faces in arguments.faces:
        for scene in (cloth_over_sphere(num_faces), pile(max(8, num_faces // 4_000), 4_000)):
            edges, _ = unique_edges(scene.faces, np.zeros((0, 2), dtype=np.int64))
            for num_ranks in arguments.ranks:
                rows.append(simulate(scene, edges, num_ranks, rate))
                print("\n".join(table(rows)[-1:] if len(rows) > 1 else table(rows)), flush=True)
    if arguments.output:
        raw = {"seconds_a_primitive": rate, "rows": [asdict(row) for row in rows]}
        arguments.output.write_text(json.dumps(raw, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
