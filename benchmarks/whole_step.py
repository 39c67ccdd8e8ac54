"""Whole steps against ipc-toolkit: broad phase, collision-free step, all contacts; and how the cost grows.

Peer: `Candidates.build` with `LBVH`, its fastest, then `compute_collision_free_stepsize` with `TightInclusionCCD`, both
on all cores. Each round calls the peer and ours in turn on the same step; the figures are medians. The construction of
the mesh is not timed for either; the first call, which orders the mesh once, is given separately.
"""

from __future__ import annotations

import json
import sys
import time
from functools import partial

import ipctk
import numpy as np
import warp as wp
from memory import PeakMemory
from scaling import run_apart
from scenes import Scene, cloth_over_sphere
from timing import figures, interleaved, medians

import ccd_warp as ccd

CALLS = ("find_candidates", "collision_free_step", "mesh_ccd")


class ToolkitScene:
    """ipc-toolkit on one scene. All bodies are one mesh to it, and static bodies have displacement 0."""

    def __init__(self, scene: Scene, mesh: ccd.CollisionMesh) -> None:
        self.scene = scene
        edges = np.asarray(mesh.edges, dtype=np.int32)
        self.mesh = ipctk.CollisionMesh(scene.vertices_t0, edges, scene.faces.astype(np.int32))

    def build(self):
        """The candidates of its fastest broad phase."""
        candidates = ipctk.Candidates()
        candidates.build(self.mesh, self.scene.vertices_t0, self.scene.vertices_t1, broad_phase=ipctk.LBVH())
        return candidates

    def step(self, candidates, narrow_phase=None) -> float:
        """The collision-free step of a narrow phase, Tight-Inclusion if none is given."""
        return candidates.compute_collision_free_stepsize(
            self.mesh,
            self.scene.vertices_t0,
            self.scene.vertices_t1,
            narrow_phase_ccd=narrow_phase or ipctk.TightInclusionCCD(),
        )


def measure(scene: Scene, device: str, budget: float, least: int = 3) -> dict:
    """One row: medians of interleaved rounds, at least ``least`` and as many as fit ``budget`` seconds."""
    mesh = scene.mesh(ccd)
    frames = (scene.vertices_t0, scene.vertices_t1)
    pipeline = ccd.CollisionPipeline(mesh, device=device)
    calls = {name: partial(getattr(pipeline, name), *frames) for name in CALLS}
    first = {}
    for name, call in calls.items():
        begin = time.perf_counter()
        call()
        first[name] = time.perf_counter() - begin
    peer = ToolkitScene(scene, mesh)
    results: dict = {"peer build": peer.build()}
    theirs = {"peer build": peer.build, "peer step": lambda: peer.step(results["peer build"])}
    seconds = interleaved(theirs | calls, least, budget=budget, is_settled=True, after=results.__setitem__)
    times = figures(seconds)
    found, contacts, candidates = (results[name] for name in ("find_candidates", "mesh_ccd", "peer build"))
    middle = times["seconds"]
    whole = middle["peer build"] + middle["peer step"]
    return {
        "scene": scene.name,
        "device": device,
        "faces": len(scene.faces),
        "rounds": len(seconds["peer build"]),
        **times,
        "first": first,
        "ratio": {
            "find_candidates": middle["peer build"] / middle["find_candidates"],
            "collision_free_step": whole / middle["collision_free_step"],
            "mesh_ccd": whole / middle["mesh_ccd"],
        },
        "candidates": len(found.vertex_face) + len(found.edge_edge),
        "disagreements": disagreements(scene, mesh, found, candidates),
        "peer_candidates": len(candidates.fv_candidates) + len(candidates.ee_candidates),
        "contacts": len(contacts.contacts),
        "step": results["collision_free_step"],
        "toi": contacts.toi,
        "peer_step": results["peer step"],
    }


def disagreements(scene: Scene, mesh: ccd.CollisionMesh, found: ccd.Candidates, peer) -> int:
    """Candidates that only one of the two has, without those of the peer whose boxes do not overlap in float64."""
    frames = np.stack(mesh.frames(scene.vertices_t0, scene.vertices_t1))
    count = 0
    kinds = (
        (found.vertex_face, [(c.vertex_id, c.face_id) for c in peer.fv_candidates], None, mesh.faces),
        (found.edge_edge, [sorted((c.edge0_id, c.edge1_id)) for c in peer.ee_candidates], mesh.edges, mesh.edges),
    )
    for ours, theirs, first, second in kinds:
        theirs = np.asarray(theirs, dtype=np.int64).reshape(-1, 2)
        keys = [pairs[:, 0].astype(np.int64) << 32 | pairs[:, 1] for pairs in (ours, theirs)]
        count += int((~np.isin(keys[0], keys[1])).sum())
        more = theirs[~np.isin(keys[1], keys[0])]
        corners = [more[:, :1] if first is None else first[more[:, 0]], second[more[:, 1]]]
        low, high = zip(*((frames[:, c].min(axis=(0, 2)), frames[:, c].max(axis=(0, 2))) for c in corners), strict=True)
        count += int(((low[0] <= high[1]) & (low[1] <= high[0])).all(axis=1).sum())
    return count


def grow(num_faces: int) -> dict:
    """Time and memory of one size; to be run in a separate process."""
    scene = cloth_over_sphere(num_faces)
    mesh = scene.mesh(ccd)
    frames = (scene.vertices_t0, scene.vertices_t1)
    few = cloth_over_sphere(2_000)  # kernels are loaded, which takes 100 MiB
    small = ccd.CollisionPipeline(few.mesh(ccd))
    for call in (small.collision_free_step, small.mesh_ccd, small.find_candidates):
        call(few.vertices_t0, few.vertices_t1)
    memory = PeakMemory()
    pipeline = ccd.CollisionPipeline(mesh)
    row: dict = {"faces": len(scene.faces), "seconds": {}}
    for name in ("collision_free_step", "mesh_ccd", "find_candidates"):
        row["seconds"] |= medians(interleaved({name: partial(getattr(pipeline, name), *frames)}, 5, is_settled=True))
    row["peak_bytes_above_input"] = memory.bytes()
    return row


def grow_apart(num_faces: int) -> dict:
    """`grow` in a separate process, whose memory contains nothing else."""
    return json.loads(run_apart([sys.executable, __file__, str(num_faces)]).splitlines()[-1])


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_ERROR
    print(json.dumps(grow(int(sys.argv[1]))))
