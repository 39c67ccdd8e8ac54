"""What a minimum separation costs: pairs, contacts and time of a step that is the same but for it.

python -m ccd_warp.benchmarks.separation --output benchmarks/results/separation.json --docs docs/choosing.md
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path

import warp as wp
from ccd_warp.benchmarks import scenes
from ccd_warp.benchmarks.machine import describe, machine
from ccd_warp.benchmarks.numbers import table, time_text
from ccd_warp.benchmarks.report import with_table

import ccd_warp as ccd

NUM_FACES = 20_000
SEPARATIONS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2)
STAGES = ("candidates", "after the cull", "contacts")
ROUNDS = 9


def measure(num_faces: int, separations: tuple[float, ...] = SEPARATIONS) -> list[dict]:
    """One row a separation, the rounds interleaved."""
    scene = scenes.cloth_over_sphere(num_faces)
    mesh = scene.mesh(ccd)
    frames = (scene.vertices_t0, scene.vertices_t1)
    pipelines = [ccd.CollisionPipeline(mesh, minimum_separation=s, length_scale=1.0) for s in separations]
    seconds: list[list[float]] = [[] for _ in pipelines]
    results = []
    for k in range(ROUNDS + 1):
        results = []
        for pipeline, times in zip(pipelines, seconds, strict=True):
            begin = time.perf_counter()
            results.append(pipeline.mesh_ccd(*frames))
            if k:
                times.append(time.perf_counter() - begin)
    edges = mesh.vertices[mesh.edges]
    edge_length = float(((edges[:, 0] - edges[:, 1]) ** 2).sum(axis=1).mean() ** 0.5)
    rows = []
    for separation, result, times in zip(separations, results, seconds, strict=True):
        kinds = ("vertex-face", "edge-edge")
        both = {stage: sum(result.counts[f"{kind} {stage}"] for kind in kinds) for stage in STAGES}
        rows.append({"separation": separation, "edge_length": edge_length, **both, "toi": result.toi})
        rows[-1]["seconds"] = statistics.median(times)
    return rows


def rows_table(rows: list[dict]) -> list[str]:
    """The table of docs/choosing.md."""
    cells = (
        [
            f"{row['separation']:g}",
            f"{row['separation'] / row['edge_length']:.2g}",
            *(f"{row[stage]:,}" for stage in STAGES),
            f"{row['toi']:.5f}",
            time_text(row["seconds"]),
        ]
        for row in rows
    )
    return table(["separation", "in edge lengths", *STAGES, "toi", "`mesh_ccd`"], cells)


def main() -> None:
    """Measure, print a table and write the figures."""
    parser = argparse.ArgumentParser(description="What a minimum separation costs, as a table and as JSON.")
    parser.add_argument("--output", type=Path, help="where the figures go, JSON")
    parser.add_argument("--docs", type=Path, help="docs/choosing.md, whose table is written")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    rows = measure(NUM_FACES)
    here = machine()
    print("\n".join([describe(here), "", *rows_table(rows)]))
    if options.output:
        options.output.write_text(json.dumps({"machine": here, "rows": rows}, indent=1) + "\n", encoding="utf-8")
    if options.docs:
        text = options.docs.read_text(encoding="utf-8")
        options.docs.write_text(with_table(text, "separation", rows_table(rows)), encoding="utf-8")


if __name__ == "__main__":
    main()
