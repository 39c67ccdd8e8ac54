"""Edges of a planner: ours, and python-fcl at sampled configurations along each edge, as planners check them.

Ours is one call for all edges, with a mesh of one world. The sampler has a manager for the obstacles and asks of each
sample whether a link touches one of them or a link that is not its neighbour; where links are is not timed, as
planners have it anyway. It may stop at the first sample that touches, as planners do.
"""

from __future__ import annotations

import time
from importlib.util import find_spec
from typing import Any

import numpy as np
from ccd_warp.benchmarks.rigid_arm_scene import NUM_LINKS, ArmEdges, Arrays, arm_edges
from ccd_warp.benchmarks.rigid_truth import GAP

import ccd_warp as ccd

SAMPLES = (10, 100)
# Edges that are looked at together, as worlds of a mesh have to fit into memory.
_AT_A_TIME = 100
# Edges whose answer is looked at, and that a sampler with the most samples takes.
_MOST_LOOKED_AT = 40


def touching_at(edges: ArmEdges, chosen: np.ndarray, times: np.ndarray, mesh: ccd.CollisionMesh) -> np.ndarray:
    """Whether anything intersects in edges at a time of each, exactly; ``mesh`` has a world for each."""
    touching = np.zeros(len(chosen), dtype=bool)
    touching[ccd.find_intersections(mesh, edges.positions_at(chosen, times)).world] = True
    return touching


def starting_apart(edges: ArmEdges) -> ArmEdges:
    """The edges at whose start nothing intersects."""
    apart = np.zeros(len(edges), dtype=bool)
    for first in range(0, len(edges), _AT_A_TIME):
        chosen = np.arange(first, min(first + _AT_A_TIME, len(edges)))
        worlds = edges.mesh.replicate(len(chosen))
        apart[chosen] = ~touching_at(edges, chosen, np.zeros(len(chosen)), worlds)
    return ArmEdges(edges.links, edges.obstacles, edges.q0[apart], edges.q1[apart])


def ours(edges: ArmEdges) -> tuple[np.ndarray, dict[str, float], float, float]:
    """The toi of each edge, seconds by stage, and the time of the processor and of the clock, but for compilation."""
    pipeline, x = ccd.CollisionPipeline(edges.mesh), edges.mesh.vertices
    pipeline.mesh_ccd(x, x, motion=edges.motion(slice(0, _AT_A_TIME)))  # compiles
    begin = time.perf_counter(), time.process_time()
    result = pipeline.mesh_ccd(x, x, motion=edges.motion(slice(None)))
    of_processor, on_clock = time.process_time() - begin[1], time.perf_counter() - begin[0]
    return result.world_toi, result.timings, of_processor, on_clock


def evidence(edges: ArmEdges, toi: np.ndarray, samples: int) -> dict[str, int]:
    """Exact looks at some edges at many times, and at the toi of ours: what shows a toi to be wrong."""
    chosen = np.arange(min(len(edges), _MOST_LOOKED_AT))
    mesh = edges.mesh.replicate(len(chosen))
    first = np.full(len(chosen), np.inf)
    for t in np.linspace(0.0, 1.0, samples):
        first[touching_at(edges, chosen, np.full(len(chosen), t), mesh) & (first == np.inf)] = t
    hit = toi[chosen] < np.inf
    at_toi = edges.positions_at(chosen, np.where(hit, toi[chosen], 0.0))
    is_near = np.zeros(len(chosen), dtype=bool)
    is_near[mesh.vertex_world[ccd.find_proximity(mesh, at_toi, GAP).vertices[:, 0]]] = True
    return {
        "edges": len(chosen),
        "samples": samples,
        "missed": int((~hit & (first < np.inf)).sum()),
        "late": int((hit & (first < toi[chosen])).sum()),
        "apart": int((hit & ~is_near).sum()),
    }


class Sampler:
    """python-fcl's test of configurations."""

    def __init__(self, edges: ArmEdges) -> None:
        import fcl

        def model(body: Arrays) -> Any:
            made = fcl.BVHModel()
            made.beginModel(len(body[0]), len(body[1]))
            made.addSubModel(*body)
            made.endModel()
            return fcl.CollisionObject(made, fcl.Transform())

        self._fcl = fcl
        self._links = [model(body) for body in edges.links]
        self._obstacles = fcl.DynamicAABBTreeCollisionManager()
        self._obstacles.registerObjects([model(body) for body in edges.bodies[NUM_LINKS:]])
        self._obstacles.setup()

    def first(self, matrices: np.ndarray) -> int:
        """The first of several configurations that touches, -1 if none does; poses of the links, [n, 7, 4, 4]."""
        fcl = self._fcl
        for k, poses in enumerate(matrices):
            for link, pose in zip(self._links, poses, strict=True):
                link.setTransform(fcl.Transform(np.ascontiguousarray(pose[:3, :3]), pose[:3, 3]))
            for a, link in enumerate(self._links):
                data = fcl.CollisionData()
                self._obstacles.collide(link, data, fcl.defaultCollisionCallback)
                if data.result.is_collision or any(fcl.collide(link, other) for other in self._links[a + 2 :]):
                    return k
        return -1


def sampled(edges: ArmEdges, samples: int) -> tuple[np.ndarray, float]:
    """The time of the first sample that touches on each edge, inf for none, and seconds of the processor."""
    sampler, times = Sampler(edges), np.linspace(0.0, 1.0, samples)
    toi, seconds = np.full(len(edges), np.inf), 0.0
    for k in range(len(edges)):
        matrices = edges.matrices_at(np.full(samples, k), times)
        begin = time.process_time()
        first = sampler.first(matrices)
        seconds += time.process_time() - begin
        if first >= 0:
            toi[k] = times[first]
    return toi, seconds


def measure(count: int, looks: int, samples: tuple[int, ...] = SAMPLES, **sizes: int) -> dict:
    """One record: ours by its stages, and the sampler by the number of its samples.

    Args:
        count: Number of edges; those that touch at their start are left out.
        looks: Exact looks at each of some edges.
        samples: Samples an edge.
        sizes: Faces of the arm and number of obstacles, as of `arm_edges`.
    """
    edges = starting_apart(arm_edges(count, **sizes))
    toi, stages, of_processor, on_clock = ours(edges)
    each = len(edges)
    rows: list[dict[str, Any]] = [
        {
            "method": "ours, all edges in one call, all threads",
            "seconds": of_processor / each,
            "on clock": on_clock / each,
            "stages": {name: seconds / each for name, seconds in stages.items() if name != "total"},
            "missed": 0,
        }
    ]
    for number in samples if find_spec("fcl") is not None else ():
        found, seconds = sampled(edges, number)
        rows.append(
            {
                "method": f"python-fcl, {number} samples",
                "seconds": seconds / each,
                "missed": int(((toi < np.inf) & (found == np.inf)).sum()),
                "phantom": int(((toi == np.inf) & (found < np.inf)).sum()),
            }
        )
    mesh = edges.mesh
    return {
        "what": "edges",
        "scene": f"an arm of {NUM_LINKS} joints and {sum(len(f) for _, f in edges.links):,} faces",
        "obstacles": len(edges.obstacles.sizes),
        "bodies": mesh.num_bodies,
        "edges": each,
        "free": int((toi == np.inf).sum()),
        "evidence": evidence(edges, toi, looks),
        "rows": rows,
    }
