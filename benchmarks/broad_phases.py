"""The two broad phases beside ipc-toolkit's LBVH: candidates, and the stages of a whole step that differ.

Each round calls the peer's `Candidates.build` with `LBVH` and ours with a tree and with a spatial hash in turn, each
call twice in a row, the second of which counts; the figures are medians. In `mesh_ccd` the stage "boxes" computes the
boxes, and sorts them into the hash; "pairs" searches, and culls what it finds.
"""

from __future__ import annotations

import statistics
import time

from ccd_warp.benchmarks.scenes import Scene
from ccd_warp.benchmarks.whole_step import ToolkitScene, disagreements, timed

import ccd_warp as ccd

PEER = "LBVH"
BROAD_PHASES = ("tree", "hash")
STAGES = ("boxes", "pairs")


def measure(scene: Scene, device: str, budget: float, least: int = 3) -> dict:
    """One row: medians of interleaved rounds, at least ``least`` and as many as fit ``budget`` seconds."""
    mesh = scene.mesh(ccd)
    frames = (scene.vertices_t0, scene.vertices_t1)
    pipelines = {name: ccd.CollisionPipeline(mesh, device=device, broad_phase=name) for name in BROAD_PHASES}
    for pipeline in pipelines.values():
        pipeline.find_candidates(*frames)
        pipeline.mesh_ccd(*frames)
    peer = ToolkitScene(scene, mesh)
    seconds: dict[str, list[float]] = {}
    results = {}
    begin = time.perf_counter()
    while len(seconds.get(PEER, ())) < least or time.perf_counter() - begin < budget:
        theirs, t = timed(peer.build)
        seconds.setdefault(PEER, []).append(t)
        for name, pipeline in pipelines.items():
            found, t = timed(lambda p=pipeline: p.find_candidates(*frames))
            seconds.setdefault(f"{name} find_candidates", []).append(t)
            result, t = timed(lambda p=pipeline: p.mesh_ccd(*frames))
            seconds.setdefault(f"{name} mesh_ccd", []).append(t)
            for stage in STAGES:
                seconds.setdefault(f"{name} {stage}", []).append(pipeline.timings[stage])
            results[name] = (found, result)
    (tree, tree_result), (hashed, hash_result) = results.values()
    tree = tree.sorted()
    return {
        "scene": scene.name,
        "device": device,
        "faces": len(scene.faces),
        "rounds": len(seconds[PEER]),
        "seconds": {name: statistics.median(values) for name, values in seconds.items()},
        "spread": {name: [min(values), max(values)] for name, values in seconds.items()},
        "candidates": [len(tree.vertex_face), len(tree.edge_edge)],
        "are_equal": bool(
            all((a == b).all() for a, b in zip(vars(tree).values(), vars(hashed).values(), strict=True))
            and (tree_result.vertex_toi == hash_result.vertex_toi).all()
        ),
        "disagreements": disagreements(scene, mesh, hashed, theirs),
    }
