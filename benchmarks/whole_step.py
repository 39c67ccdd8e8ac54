"""Whole steps against ipc-toolkit and against exact arithmetic: what is certain to be free, and all contacts.

Peers: `Candidates.build` with `LBVH`, ipc-toolkit's fastest, then `compute_collision_free_stepsize` with one of its
narrow phases. Each round makes every call in turn on the same step, on one thread and again on all. The construction of
a mesh is timed for none. The error of a step is that of the fraction which is said to be free against the exact toi.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from functools import partial

import ipctk
import numpy as np
import warp as wp
from accuracy import ExactTimes, apart_along, corners_of, first_contact
from memory import PeakMemory
from methods import BISECTION_ITERATIONS, CUBIC, ENDS, KINDS, OURS, PEERS
from scaling import run_apart
from scenes import Scene, cloth_over_sphere
from timing import interleaved, medians, quartiles
from univariate import ends_ccd, univariate_ccd

import ccd_warp as ccd
from ccd_warp._runtime.threads import default_num_threads

LBVH, LEAST_SHARE = "LBVH", 1e-6
# Narrow phases of the peer with what they are given: tolerance, and the share of a start gap that a step leaves. What
# has "default" is that of ipc-toolkit; a step that leaves a share of the gap as small as LEAST_SHARE is like ours.
NARROW = {
    (PEERS[0], "default: 1e-6, leaves 0.2"): ipctk.TightInclusionCCD(),
    (PEERS[0], "1e-6, leaves 1e-6"): ipctk.TightInclusionCCD(1e-6, conservative_rescaling=1 - LEAST_SHARE),
    (PEERS[1], "default: leaves 0.1"): ipctk.AdditiveCCD(),
    (PEERS[1], "leaves 1e-6"): ipctk.AdditiveCCD(conservative_rescaling=1 - LEAST_SHARE),
}
# What the frontier has besides.
MORE_NARROW = {
    **{
        (PEERS[0], f"{tolerance:.0e}, leaves 1e-6"): ipctk.TightInclusionCCD(tolerance, conservative_rescaling=1 - 1e-6)
        for tolerance in (1e-3, 1e-9)
    },
    **{
        (PEERS[1], f"leaves {share:.0e}"): ipctk.AdditiveCCD(conservative_rescaling=1 - share)
        for share in (0.5, 1e-3, 1e-9)
    },
}
CALLS = ("find_candidates", "find_candidates, hash", "collision_free_step", "mesh_ccd", "mesh_ccd, hash")
_OURS = [(OURS, call) for call in CALLS]
MORE_OURS: dict[tuple[str, str], dict] = {
    **{(OURS, f"{t:.0e}"): {"tolerance": t} for t in (1e-3, 1e-9)},
    **{("ours float32", f"{t:.0e}"): {"tolerance": t, "precision": "float32"} for t in (1e-3, 1e-6)},
    **{
        ("plain bisection", f"{t:.0e}"): {"tolerance": t, "method": "bisection", "max_iterations": BISECTION_ITERATIONS}
        for t in (1e-3, 1e-6)
    },
}
BASELINES: dict[str, Callable[..., np.ndarray]] = {CUBIC: univariate_ccd, ENDS: ends_ccd}
_Name = tuple[str, str]  # of a method, and of a setting or a call


class ToolkitScene:
    """ipc-toolkit on one scene. All bodies are one mesh to it, and static bodies have displacement 0."""

    def __init__(self, scene: Scene, mesh: ccd.CollisionMesh) -> None:
        ipctk.set_logger_level(ipctk.LoggerLevel.off)  # additive CCD warns of every small gap
        self.frames = (scene.vertices_t0, scene.vertices_t1)
        edges = np.asarray(mesh.edges, dtype=np.int32)
        self.mesh = ipctk.CollisionMesh(scene.vertices_t0, edges, scene.faces.astype(np.int32))

    def build(self):
        """The candidates of its fastest broad phase."""
        candidates = ipctk.Candidates()
        candidates.build(self.mesh, *self.frames, broad_phase=ipctk.LBVH())
        return candidates

    def step(self, candidates, narrow_phase) -> float:
        """The collision-free step of a narrow phase."""
        return candidates.compute_collision_free_stepsize(self.mesh, *self.frames, narrow_phase_ccd=narrow_phase)


def measure(scene: Scene, device: str, budget: float, least: int, has_frontier: bool) -> Iterator[dict]:
    """Rows of calls on one thread and on all: rounds, at least ``least`` and as many as fit ``budget`` seconds."""
    mesh = scene.mesh(ccd)
    frames = (scene.vertices_t0, scene.vertices_t1)
    about = {"scene": scene.name, "device": device, "faces": len(scene.faces)}
    exact = None
    for threads in sorted({1, default_num_threads()}):
        ipctk.set_num_threads(threads)
        results: dict[_Name, object] = {}
        calls, before = _calls(scene, mesh, {"device": device, "num_threads": threads}, results)
        if not has_frontier or threads > 1:
            calls = {name: call for name, call in calls.items() if name in NARROW or name in ((LBVH, ""), *_OURS)}
        seconds = interleaved(calls, least, budget=budget, is_settled=True, after=results.__setitem__)
        if exact is None:
            found, peer = results[_OURS[0]], results[LBVH, ""]
            pairs = found.vertex_face, found.edge_edge
            theirs = peer_pairs(peer)
            about |= {"candidates": sum(map(len, pairs)), "peer_candidates": sum(map(len, theirs))}
            about["disagreements"] = disagreements(mesh, frames, pairs, theirs)
            exact = first_contact(mesh, *frames, pairs, results[OURS, "mesh_ccd"].first)
            about["exact"] = float(exact.below[0])
        for name, values in seconds.items():
            both = np.array(values) + (seconds[before[name]] if name in before else 0.0)
            row = {"method": name[0], "setting": name[1], "threads": threads, "rounds": len(both)}
            row |= {"seconds": float(np.median(both)), "quartiles": quartiles(both)}
            yield about | row | _judged(results[name], exact)


def peer_pairs(candidates) -> list[np.ndarray]:
    """Its vertex-face and edge-edge candidates, the edges of each in order, [n, 2] each."""
    vertex_face = np.fromiter((i for c in candidates.fv_candidates for i in (c.vertex_id, c.face_id)), np.int64)
    edge_edge = np.fromiter((i for c in candidates.ee_candidates for i in (c.edge0_id, c.edge1_id)), np.int64)
    return [vertex_face.reshape(-1, 2), np.sort(edge_edge.reshape(-1, 2), axis=1)]


def _calls(scene: Scene, mesh: ccd.CollisionMesh, options: dict, results: dict) -> tuple[dict, dict]:
    """Every call by method and setting, and of those that take the result of another, which before them, its name."""
    frames = (scene.vertices_t0, scene.vertices_t1)
    peer = ToolkitScene(scene, mesh)
    calls: dict[_Name, Callable[[], object]] = {(LBVH, ""): peer.build}
    before: dict[_Name, _Name] = {}
    for name, phase in (NARROW | MORE_NARROW).items():
        calls[name], before[name] = lambda phase=phase: peer.step(results[LBVH, ""], phase), (LBVH, "")
    pipelines = {name: ccd.CollisionPipeline(mesh, broad_phase=name, **options) for name in ("tree", "hash")}
    for name in _OURS:
        call, _, search = name[1].partition(", ")
        calls[name] = partial(getattr(pipelines[search or "tree"], call), *frames)
    for (method, setting), of in MORE_OURS.items():
        calls[method, setting] = partial(ccd.CollisionPipeline(mesh, **options, **of).collision_free_step, *frames)
    for method, solve in BASELINES.items():
        calls[method, ""] = lambda solve=solve: _earliest(mesh, frames, results[_OURS[0]], solve)
        before[method, ""] = _OURS[0]
    results |= {(LBVH, ""): peer.build(), _OURS[0]: calls[_OURS[0]]()}
    return calls, before


def _earliest(mesh: ccd.CollisionMesh, frames: tuple, found: ccd.Candidates, solve: Callable[..., np.ndarray]) -> float:
    """The least toi of all candidates by a baseline, 1 without one."""
    tois = [1.0]
    for kind, pairs in zip(KINDS, (found.vertex_face, found.edge_edge), strict=True):
        corners = corners_of(mesh, kind, pairs)
        tois += [solve(kind, *(x[corners] for x in frames)).min()] if len(pairs) else []
    return min(tois)


def _judged(result: object, exact: ExactTimes) -> dict:
    """Of a free step, or what has a toi: the step, its faults, and by which part it is short of the exact toi."""
    toi = result if isinstance(result, float) else getattr(result, "toi", None)
    if toi is None:
        return {}
    step, whole = min(toi, 1.0), float(exact.below[0]) if exact.hit[0] else 1.0
    short = float(exact.early_by(np.array([step]))[0]) if exact.hit[0] else 1.0 - step
    faults = exact.faults(np.array([step if step < 1.0 else np.inf]))
    return {"step": step, "short": short / whole if whole else short, **faults}


def disagreements(mesh: ccd.CollisionMesh, frames: tuple, ours: tuple, theirs: list[np.ndarray]) -> int:
    """Candidates that only one of the two has, without those of the peer whose boxes do not overlap in float64."""
    count = 0
    for kind, found, other in zip(KINDS, ours, theirs, strict=True):
        keys = [pairs.reshape(-1, 2).astype(np.int64) @ [1 << 32, 1] for pairs in (found, other)]
        more = other.reshape(-1, 2)[~np.isin(keys[1], keys[0])]
        x, y = (end[corners_of(mesh, kind, more)] for end in mesh.frames(*frames))
        apart = [apart_along(kind, x, y, np.broadcast_to(axis, x[:, 0].shape), 0.0) for axis in np.eye(3)]
        count += int((~np.isin(keys[0], keys[1])).sum()) + int((~np.any(apart, axis=0)).sum())
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
