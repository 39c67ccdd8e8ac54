"""Scenes of a few faces and single pairs, where the fixed cost of a call dominates: ours beside ipc-toolkit.

Peers: `Candidates.build` with `LBVH`, then `compute_collision_free_stepsize` with the narrow phases of `whole_step`, on
all threads; for a single pair, the query of `AdditiveCCD`. A round calls each in turn, as often in a row as fits some
milliseconds, and takes the mean; medians over the rounds.
"""

from __future__ import annotations

import checkout  # noqa: F401
import ipctk
import numpy as np
import warp as wp
from hard_cases import FAMILIES
from scenes import Scene
from timing import figures, interleaved
from whole_step import NARROW, ToolkitScene

import ccd_warp as ccd

# The narrow phases by what the tables call them, each with LBVH before it.
PEERS = {", ".join(filter(None, name)): phase for name, phase in NARROW.items()}
ADDITIVE = "additive CCD"
CALLS = ("collision_free_step", "mesh_ccd", "pipeline.collision_free_step", "pipeline.mesh_ccd", "launch")
PAIR_KINDS = ("vertex_face", "edge_edge", "point_segment", "point_point")
_SECONDS = 4e-3  # of a call's repetitions in a round


def measure(scene: Scene, device: str, rounds: int) -> dict:
    """One row: the peers, ours as one-shot functions and by a pipeline, and a launch of arrays on the device."""
    mesh = scene.mesh(ccd)
    frames = (scene.vertices_t0, scene.vertices_t1)
    pipeline = ccd.CollisionPipeline(mesh, device=device)
    launched = ccd.CollisionPipeline(mesh, device=device)
    launched.reserve(vertices=scene.vertices_t0)
    vertices_t0, vertices_t1 = (wp.array(x, dtype=wp.vec3d, device=device) for x in frames)
    peer = ToolkitScene(scene, mesh)

    def launch():
        result = launched.launch(vertices_t0, vertices_t1)
        wp.synchronize_device(device)
        return result

    calls = {
        **{name: lambda phase=phase: peer.step(peer.build(), phase) for name, phase in PEERS.items()},
        "collision_free_step": lambda: ccd.collision_free_step(mesh, *frames, device=device),
        "mesh_ccd": lambda: ccd.mesh_ccd(mesh, *frames, device=device),
        "pipeline.collision_free_step": lambda: pipeline.collision_free_step(*frames),
        "pipeline.mesh_ccd": lambda: pipeline.mesh_ccd(*frames),
        "launch": launch,
    }
    result = calls["mesh_ccd"]()
    row = {
        "scene": scene.name,
        "device": device,
        "faces": len(scene.faces),
        "contacts": len(result.contacts),
        "toi": result.toi,
        "step": calls["collision_free_step"](),
        "peer_step": {name: calls[name]() for name in PEERS},
    }
    return row | figures(interleaved(calls, rounds, is_settled=True, fill=_SECONDS))


def measure_pair(kind: str, device: str, rounds: int) -> dict:
    """One row: a call with a single pair that touches."""
    points = [x[0] for x in FAMILIES["random_colliding"](kind.replace("_", "-"), 1, np.random.default_rng(1))]
    solve = getattr(ccd, f"{kind}_ccd")
    names = {"vertex_face": "point_triangle", "point_segment": "point_edge"}
    query = getattr(ipctk.AdditiveCCD(), f"{names.get(kind, kind)}_ccd")
    corners = [*points[0], *points[1]]
    batch = [x[None] for x in points]
    calls = {ADDITIVE: lambda: query(*corners), "ours": lambda: solve(*batch, device=device)}
    row = {"pair": kind, "device": device, "toi": float(calls["ours"]().toi[0])}
    return row | figures(interleaved(calls, rounds, is_settled=True, fill=_SECONDS))
