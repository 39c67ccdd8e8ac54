"""The two broad phases beside ipc-toolkit's LBVH: candidates, and the stages of a whole step that differ.

Each round calls the peer's `Candidates.build` with `LBVH` and ours with a tree and with a spatial hash in turn, each
call twice in a row, the second of which counts; the figures are medians. In `mesh_ccd` the stage "boxes" computes the
boxes, and sorts them into the hash; "pairs" searches, and culls what it finds.
"""

from __future__ import annotations

from functools import partial

from scenes import Scene
from timing import figures, interleaved
from whole_step import ToolkitScene, disagreements

import ccd_warp as ccd

PEER = "LBVH"
BROAD_PHASES = ("tree", "hash")
STAGES = ("boxes", "pairs")


def measure(scene: Scene, device: str, budget: float, least: int = 3) -> dict:
    """One row: medians of interleaved rounds, at least ``least`` and as many as fit ``budget`` seconds."""
    mesh = scene.mesh(ccd)
    frames = (scene.vertices_t0, scene.vertices_t1)
    pipelines = {name: ccd.CollisionPipeline(mesh, device=device, broad_phase=name) for name in BROAD_PHASES}
    calls = {PEER: ToolkitScene(scene, mesh).build}
    for name, pipeline in pipelines.items():
        calls[f"{name} find_candidates"] = partial(pipeline.find_candidates, *frames)
        calls[f"{name} mesh_ccd"] = partial(pipeline.mesh_ccd, *frames)
    stages: dict[str, list[float]] = {f"{name} {stage}": [] for name in BROAD_PHASES for stage in STAGES}
    results = {}

    def keep(call: str, result: object) -> None:
        results[call] = result
        name, _, what = call.partition(" ")
        if what == "mesh_ccd":
            for stage in STAGES:
                stages[f"{name} {stage}"].append(pipelines[name].timings[stage])

    seconds = interleaved(calls, least, budget=budget, is_settled=True, after=keep)
    tree, hashed = results["tree find_candidates"].sorted(), results["hash find_candidates"]
    tree_result, hash_result = results["tree mesh_ccd"], results["hash mesh_ccd"]
    return {
        "scene": scene.name,
        "device": device,
        "faces": len(scene.faces),
        "rounds": len(seconds[PEER]),
        **figures(seconds | stages),
        "candidates": len(tree.vertex_face) + len(tree.edge_edge),
        "are_equal": bool(
            all((a == b).all() for a, b in zip(vars(tree).values(), vars(hashed).values(), strict=True))
            and (tree_result.vertex_toi == hash_result.vertex_toi).all()
        ),
        "disagreements": disagreements(scene, mesh, hashed, results[PEER]),
    }
