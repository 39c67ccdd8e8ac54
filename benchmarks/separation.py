"""The cost of a minimum separation: pairs, contacts and time of a step for different separations."""

from __future__ import annotations

import scenes
from timing import interleaved, medians

import ccd_warp as ccd

NUM_FACES = 20_000
SEPARATIONS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2)
STAGES = ("candidates", "after the cull", "contacts")
ROUNDS = 9


def measure(num_faces: int, separations: tuple[float, ...] = SEPARATIONS) -> list[dict]:
    """One row for each separation, with interleaved rounds."""
    scene = scenes.cloth_over_sphere(num_faces)
    mesh = scene.mesh(ccd)
    frames = (scene.vertices_t0, scene.vertices_t1)
    pipelines = {s: ccd.CollisionPipeline(mesh, minimum_separation=s, length_scale=1.0) for s in separations}
    calls = {s: lambda p=pipeline: p.mesh_ccd(*frames) for s, pipeline in pipelines.items()}
    seconds = medians(interleaved(calls, ROUNDS))
    edges = mesh.vertices[mesh.edges]
    edge_length = float(((edges[:, 0] - edges[:, 1]) ** 2).sum(axis=1).mean() ** 0.5)
    rows = []
    for separation, pipeline in pipelines.items():
        result = pipeline.mesh_ccd(*frames)
        counts = (result.counts.num_candidates, result.counts.num_after_cull, result.counts.num_contacts)
        both = {stage: sum(of_kind.values()) for stage, of_kind in zip(STAGES, counts, strict=True)}
        rows.append({"separation": separation, "edge_length": edge_length, **both, "toi": result.toi})
        rows[-1]["seconds"] = seconds[separation]
    return rows
