"""Towards many machines, by simulation: plans of 16 to 1,024 ranks, made in one process without MPI.

    python -m ccd_warp.benchmarks.distributed_simulation --output benchmarks/results/distributed_simulation.json \\
        --docs docs/distributed.md --figure docs/figures/distributed_model.png

The regions of all ranks, who has which primitives, and what goes from rank to rank come from the functions that
`ccd_warp.distributed` itself calls. The engine runs on the parts: of the least number of ranks on all, one after the
other, which also says where the pairs are; of more ranks on the one with the most work. The time of a step is then a
**model**: the CPU time of that rank, measured on one core of this machine and no less than its share of the time of all
parts, and its messages and the reductions on a network of 2 µs a message and 10 GB/s.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from ccd_warp.benchmarks import scenes, side_figures
from ccd_warp.benchmarks.numbers import count_text, table, time_text
from ccd_warp.benchmarks.virtual_mesh import Traffic, VirtualMesh, VirtualPlan
from ccd_warp.kernels.step.minima import FOUND

from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.topology import NUM_SAMPLES
from ccd_warp._input.option_types import MeshOptions
from ccd_warp._input.options import options_of
from ccd_warp._status import PairKind
from ccd_warp.distributed import _partition as partition
from ccd_warp.distributed import _planning as planning
from ccd_warp.distributed._part import Part, PartTopology
from ccd_warp.distributed._part_step import PartStep
from ccd_warp.distributed._pipeline import _MOST_IMBALANCE
from ccd_warp.distributed._plan import axes_below, is_within

RANKS = (16, 64, 256, 1024)
LATENCY, BANDWIDTH = 2e-6, 10e9
# Small collective operations of `mesh_ccd` with a plan that is kept, and one more where ranks have ghosts;
# `tests/distributed/mpi_program.py` counts them.
NUM_REDUCTIONS = 15
FACES_OF_BODY = 4_000
_REPEATS = 3
_TABLES = {PairKind.VERTEX_FACE: ("vertex", "face"), PairKind.EDGE_EDGE: ("edge", "edge")}


def all_scenes(sizes: Sequence[int]) -> list[tuple[str, Callable[[], scenes.Scene]]]:
    """Name and maker of each scene."""
    made: list[tuple[str, Callable[[], scenes.Scene]]] = []
    for size in sizes:
        made.append(("cloth over sphere", lambda n=size: scenes.cloth_over_sphere(n)))
        each = min(FACES_OF_BODY, size // 8)
        made.append(("pile", lambda n=size, k=each: scenes.pile(n // k, k)))
    return made


@dataclass(frozen=True)
class Worked:
    """What the engine has done on a part.

    Attributes:
        seconds: CPU time of a step on one thread, boxes to contacts.
        copy_seconds: CPU time to see whether positions are within the plan, and to copy them twice.
        num_candidates: Candidates of its search.
        pairs: Pairs that the cull left there, by kind, as numbers in the whole mesh, shape [n, 2].
        num_bytes: Memory that the part takes.
        vertices: Its vertices.
    """

    seconds: float
    copy_seconds: float
    num_candidates: int
    pairs: dict[PairKind, np.ndarray]
    num_bytes: int
    vertices: np.ndarray


def worked(mesh: VirtualMesh, plan: VirtualPlan, rank: int) -> Worked:
    """Run the engine on the part of a rank."""
    part = planning._part_of(mesh, [planning._message(mesh, plan.items[rank])])
    start, end = (x[part.vertex_numbers] for x in (mesh.start, mesh.end))
    vars(part.mesh)["vertices"] = start.copy()
    lower, upper = plan.bounds.boxes(start, end, part.mesh.vertex_world, part.box_radius)
    topology = PartTopology(
        part, wp.get_device("cpu"), axes_below(lower, plan.regions.lower[rank]), None, mesh.num_vertices
    )
    # the quantization is that of the part, which is as good
    together = SimpleNamespace(whole=mesh, topology=topology, ranks=mesh.ranks, collect_samples=lambda positions: None)
    limits = plan.bounds.limits(lower, upper, part.box_radius)
    workspace = Workspace(part.mesh, topology.device, topology)
    options = options_of("distributed_simulation", MeshOptions, {"num_threads": 1, "device": "cpu"})
    seconds, copies = [], []
    for k in range(_REPEATS + 1):
        begin = time.process_time()
        step = PartStep(together, workspace, (start, end), options)
        step.contacts()
        middle = time.process_time()
        all(is_within(x, limits) for x in (start, end))
        buffers = [np.take(x, np.arange(len(x)), axis=0) for x in (start, end)]
        for x, buffer in zip((start, end), buffers, strict=True):
            np.copyto(x, buffer)
        if k:
            seconds.append(middle - begin)
            copies.append(time.process_time() - middle)
    return Worked(
        min(seconds),
        min(copies),
        sum(step.counts.num_candidates.values()),
        _pairs_of(part, step),
        step.fixed_bytes + _bytes_of(part) + _bytes_of(part.mesh) + 4 * start.nbytes,
        part.vertex_numbers,
    )


def _pairs_of(part: Part, step: PartStep) -> dict[PairKind, np.ndarray]:
    """The pairs that the last search found, by kind, as numbers in the whole mesh."""
    if step.plan.num_batches != 1:
        raise ValueError(f"the pairs of a part came in {step.plan.num_batches} batches; expected one: take more ranks")
    numbers = {"vertex": part.vertex_numbers, "edge": part.edge_numbers, "face": part.face_numbers}
    pairs = {}
    for kind, of in _TABLES.items():
        keys = step.plan.found_keys(kind, int(step.plan.counts()[kind, FOUND])).numpy()
        keys = np.where(keys < 0, ~keys, keys)
        first, second = keys >> 32, keys & 0xFFFFFFFF
        pairs[kind] = np.stack([numbers[of[0]][first], numbers[of[1]][second]], axis=1)
    return pairs


def _bytes_of(holder: Any) -> int:
    return sum(value.nbytes for value in vars(holder).values() if isinstance(value, np.ndarray))


def work_of(mesh: VirtualMesh, done: list[Worked]) -> tuple[np.ndarray, np.ndarray]:
    """Work of all parts by vertices, as `PartStep.work_by_vertex` sees it, and the candidates' share of it."""
    candidates = np.zeros(mesh.num_vertices)
    of_pairs = np.zeros(mesh.num_vertices)
    for each in done:
        of_each = planning.WORK_OF_CANDIDATE * each.num_candidates / max(len(each.vertices), 1)
        candidates[each.vertices] += of_each
        for kind, pairs in each.pairs.items():
            first = mesh.edges[pairs[:, 0], 0] if kind == PairKind.EDGE_EDGE else pairs[:, 0]
            of_pairs += planning.WORK_OF_PAIR * np.bincount(first, minlength=mesh.num_vertices)
    return candidates + of_pairs, candidates


def pairs_by_rank(mesh: VirtualMesh, plan: VirtualPlan, pairs: dict[PairKind, np.ndarray]) -> np.ndarray:
    """How many pairs each rank counts: those whose boxes' intersection has its lower corner in its region."""
    result = np.zeros(plan.regions.count, dtype=np.int64)
    for kind, of in _TABLES.items():
        corner = np.full((4, len(pairs[kind])), -np.inf)
        for side, name in enumerate(of):
            vertices = mesh.primitives[name].corners[pairs[kind][:, side]]
            np.maximum(corner, plan.lower[:, vertices].min(axis=2), out=corner)
        result += np.bincount(partition.region_of(plan.regions, corner), minlength=plan.regions.count)
    return result


def work_by_rank(mesh: VirtualMesh, plan: VirtualPlan, pairs: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Work of each rank, in the weights by which the pipeline measures it."""
    home = partition.region_of(plan.regions, plan.lower)
    spread = np.bincount(home, weights=candidates, minlength=plan.regions.count)
    return planning.WORK_OF_PRIMITIVE * plan.num_primitives + spread + planning.WORK_OF_PAIR * pairs


def network_seconds(num_ranks: int, traffic: Traffic, num_bodies: int) -> float:
    """The model: the busiest rank's messages one after the other, and reductions in rounds of all ranks."""
    rounds = (num_ranks - 1).bit_length()
    reduced = 2 * 3 * 8 * 3 * NUM_SAMPLES + 8 * (2 + num_bodies) + 8 * num_ranks
    messages = LATENCY * traffic.num_messages + traffic.num_sent / BANDWIDTH
    return float(messages.max()) + rounds * ((NUM_REDUCTIONS + 1) * LATENCY + reduced / BANDWIDTH)


def modelled(row: dict) -> dict:
    """A row with the model: the part with the most work takes no less than its share of one core's time."""
    share = row["one_core_seconds"] * row["imbalance"] / row["ranks"]
    work = max(row["engine_seconds"], share) + row["copy_seconds"]
    step = work + row["network_seconds"]
    efficiency = row["one_core_seconds"] / (row["ranks"] * step)
    return row | {"work_seconds": work, "step_seconds": step, "efficiency": efficiency}


def simulate(name: str, scene: scenes.Scene, ranks: tuple[int, ...]) -> list[dict]:
    """One row for each number of ranks."""
    mesh = VirtualMesh(scene)
    first = VirtualPlan.of(mesh, ranks[0], None, mesh.owners(ranks[0]))
    done = [worked(mesh, first, rank) for rank in range(ranks[0])]
    work, candidates = work_of(mesh, done)
    pairs = {kind: np.concatenate([each.pairs[kind] for each in done]) for kind in _TABLES}
    on_one_core = sum(each.seconds for each in done)
    num_pairs, num_candidates = sum(map(len, pairs.values())), sum(each.num_candidates for each in done)
    del done
    rows = []
    for num_ranks in ranks:
        owner = mesh.owners(num_ranks)
        plan = first if num_ranks == ranks[0] else VirtualPlan.of(mesh, num_ranks, None, owner)
        blind = partition.imbalance(work_by_rank(mesh, plan, pairs_by_rank(mesh, plan, pairs), candidates))
        if blind > _MOST_IMBALANCE:
            plan = VirtualPlan.of(mesh, num_ranks, work, owner)
        load = work_by_rank(mesh, plan, pairs_by_rank(mesh, plan, pairs), candidates)
        chosen = {"busiest": int(load.argmax()), "largest": int(plan.num_primitives.argmax())}
        of = {rank: worked(mesh, plan, rank) for rank in set(chosen.values())}
        busiest, largest = (of[rank] for rank in chosen.values())
        near = Traffic.of(mesh, plan, owner)
        far = Traffic.of(mesh, plan, np.arange(mesh.num_vertices) * num_ranks // mesh.num_vertices)
        on_network = network_seconds(num_ranks, near, mesh.num_bodies)
        ghosts = plan.num_primitives - plan.num_home
        row = {
            "scene": name,
            "faces": mesh.num_faces,
            "primitives": mesh.num_vertices + mesh.num_edges + mesh.num_faces,
            "pairs": num_pairs,
            "candidates": num_candidates,
            "ranks": num_ranks,
            "faces_mean": float(plan.num_faces.mean()),
            "faces_most": int(plan.num_faces.max()),
            "ghosts_mean": float(ghosts.mean()),
            "ghosts_most": int(ghosts.max()),
            "ghost_share": float(ghosts.sum() / plan.num_home.sum()),
            "imbalance_first": blind,
            "imbalance": partition.imbalance(load),
            "neighbours_mean": float(near.num_neighbours.mean()),
            "neighbours_most": int(near.num_neighbours.max()),
            "bytes_mean": float(near.num_sent.mean()),
            "bytes_most": int(near.num_sent.max()),
            "bytes_most_by_index": int(far.num_sent.max()),
            "plan_bytes_most": int(plan.message_bytes.max()),
            "memory_most": largest.num_bytes,
            "one_core_seconds": on_one_core,
            "engine_seconds": busiest.seconds,
            "copy_seconds": busiest.copy_seconds,
            "network_seconds": on_network,
        }
        rows.append(modelled(row))
        print(f"{name}, {mesh.num_faces:,} faces, {num_ranks} ranks: {row}", flush=True)
    return rows


def rows_table(rows: list[dict]) -> list[str]:
    """The table of docs/distributed.md."""
    header = [
        "scene",
        "ranks",
        "faces a rank, most",
        "ghosts a rank",
        "imbalance",
        "neighbours, most",
        "sent a step, most",
        "memory, most",
        "work (model)",
        "network (model)",
        "step (model)",
        "efficiency (model)",
    ]
    cells = (
        [
            f"{row['scene']}, {count_text(row['faces'])}",
            f"{row['ranks']:,}",
            f"{count_text(row['faces_mean'])}, {count_text(row['faces_most'])}",
            f"{row['ghost_share']:.1%}",
            f"{row['imbalance_first']:.2f} → {row['imbalance']:.2f}",
            f"{row['neighbours_mean']:.1f}, {row['neighbours_most']}",
            f"{row['bytes_most'] / 2**20:.2f} MiB",
            f"{row['memory_most'] / 2**20:.0f} MiB",
            time_text(row["work_seconds"]),
            time_text(row["network_seconds"]),
            time_text(row["step_seconds"]),
            f"{row['efficiency']:.0%}",
        ]
        for row in rows
    )
    return table(header, cells)


def draw(rows: list[dict], path: Path) -> None:
    """Draw the modelled time of a step against the number of ranks."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for name, faces in dict.fromkeys((row["scene"], row["faces"]) for row in rows):
        chosen = [row for row in rows if (row["scene"], row["faces"]) == (name, faces)]
        ranks = [row["ranks"] for row in chosen]
        (line,) = axes.loglog(
            ranks, [1e3 * row["step_seconds"] for row in chosen], "o-", label=f"{name}, {count_text(faces)} faces"
        )
        axes.loglog(ranks, [1e3 * chosen[0]["one_core_seconds"] / n for n in ranks], ":", color=line.get_color())
    axes.set(xlabel="ranks", ylabel="ms of a step", title="A model, not a measurement; dotted: one core's time / ranks")
    axes.set_xticks(ranks, [f"{n:,}" for n in ranks])
    axes.minorticks_off()
    axes.legend(frameon=False)
    figure.savefig(path, dpi=110, metadata={"Software": None})


def main() -> None:
    """Simulate, print a table and write the figures."""
    parser = side_figures.parser("Plans of many ranks, made in one process", "docs/distributed.md")
    parser.add_argument("--figure", type=Path, help="where a picture of the model goes")
    parser.add_argument("--quick", action="store_true", help="scenes of 100,000 faces on 16 and 64 ranks")
    parser.add_argument("--faces", type=int, nargs="+", default=[4_000_000, 16_000_000], help="faces of the scenes")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    begin = time.perf_counter()
    sizes, ranks = ([100_000], RANKS[:2]) if options.quick else (options.faces, RANKS)
    rows = side_figures.rows_of(
        options, lambda: [row for name, make in all_scenes(sizes) for row in simulate(name, make(), ranks)]
    )
    side_figures.publish(options, "simulation", rows, rows_table(rows))
    print(f"{time.perf_counter() - begin:.0f} s; the time of a step is a model, not a measurement")
    if options.figure:
        draw(rows, options.figure)


if __name__ == "__main__":
    main()
