"""A heap of dice that all turn in one step, on a plane: ours, and python-fcl's manager of bodies at sampled poses.

What is compared are the pairs of bodies that touch in the step; the plane is a half-space of ours, and left out for the
manager, which takes the dice alone.
"""

from __future__ import annotations

import time
from importlib.util import find_spec
from typing import Any

import numpy as np
from ccd_warp.benchmarks.rigid_scenes import dice, matrix_of, rotations
from ccd_warp.benchmarks.timing import interleaved, medians

import ccd_warp as ccd

TURN, FALL = 0.3, 0.05
SAMPLES = (10, 100)


class Dice:
    """A mesh of dice and a plane, and poses at both ends of a step in which all fall and turn."""

    def __init__(self, count: int) -> None:
        vertices, faces, self.poses, self.omega = dice(count, TURN)
        self.die, self.count = (vertices, faces), count
        plane = ccd.HalfSpace((0, 0, 0), (0, 0, 1))
        self.mesh = ccd.CollisionMesh.from_arrays(
            [self.die] * count + [plane], self_collision=False, rigid=range(count)
        )
        twist = np.hstack([np.tile([0, 0, -FALL], (count, 1)), self.omega])
        self.motion = ccd.RigidMotion(self.poses, twist=twist)

    def poses_at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Rotations and positions of all dice at a time."""
        start = np.stack([matrix_of(pose[3:]) for pose in self.poses])
        return rotations(t * self.omega) @ start, self.poses[:, :3] - [0, 0, t * FALL]

    def positions_at(self, t: float) -> np.ndarray:
        """Positions of all vertices of the dice at a time."""
        turns, places = self.poses_at(t)
        return (self.die[0] @ turns.transpose(0, 2, 1) + places[:, None]).reshape(-1, 3)


def pairs_of_bodies(bodies: np.ndarray, count: int) -> set[tuple[int, int]]:
    """Pairs of dice among pairs of bodies."""
    chosen = np.sort(bodies[(bodies < count).all(axis=1)], axis=1)
    return {(int(a), int(b)) for a, b in np.unique(chosen, axis=0)}


def sampled(scene: Dice, samples: int) -> set[tuple[int, int]]:
    """Pairs of dice that python-fcl's manager finds in touch at sampled times."""
    import fcl

    vertices, faces = scene.die
    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(faces))
    model.addSubModel(vertices, faces)
    model.endModel()
    objects = [fcl.CollisionObject(model, fcl.Transform()) for _ in range(scene.count)]
    manager = fcl.DynamicAABBTreeCollisionManager()
    manager.registerObjects(objects)
    found: set[tuple[int, int]] = set()

    def meet(a: Any, b: Any, index: dict[bytes, int]) -> bool:
        first, second = sorted(index[each.getTranslation().tobytes()] for each in (a, b))
        if (first, second) not in found and fcl.collide(a, b):
            found.add((first, second))
        return False

    for t in np.linspace(0.0, 1.0, samples):
        index = {}
        for k, (turn, place) in enumerate(zip(*scene.poses_at(t), strict=True)):
            objects[k].setTransform(fcl.Transform(turn, place))
            index[objects[k].getTranslation().tobytes()] = k  # what a callback is given has no other name
        manager.update(objects)
        manager.collide(index, meet)
    return found


def measure(count: int, rounds: int, samples: tuple[int, ...] = SAMPLES) -> dict:
    """One record: ours with its stages, on one thread and on all, and the manager by the number of its samples."""
    scene = Dice(count)
    x = scene.mesh.vertices
    pipelines = {
        "mesh_ccd, one thread": ccd.CollisionPipeline(scene.mesh, num_threads=1),
        "mesh_ccd": ccd.CollisionPipeline(scene.mesh),
        "collision_free_step": ccd.CollisionPipeline(scene.mesh),
    }
    calls = {
        name: lambda name=name, of=of: getattr(of, name.partition(",")[0])(x, x, motion=scene.motion)
        for name, of in pipelines.items()
    }
    straight = ccd.CollisionPipeline(
        ccd.CollisionMesh.from_arrays([scene.die] * count + [ccd.HalfSpace((0, 0, 0), (0, 0, 1))], self_collision=False)
    )
    plane = x[count * len(scene.die[0]) :]
    ends = [np.concatenate([scene.positions_at(t), plane]) for t in (0.0, 1.0)]
    calls["mesh_ccd on chords"] = lambda: straight.mesh_ccd(*ends)
    stages: dict[str, list[dict[str, float]]] = {name: [] for name in calls}
    results: dict[str, Any] = {}

    def keep(name: str, result: Any) -> None:
        results[name] = result
        of = straight if name == "mesh_ccd on chords" else pipelines[name]
        stages[name].append(dict(of.timings))

    times = medians(interleaved(calls, rounds, after=keep))
    touching = pairs_of_bodies(results["mesh_ccd"].contacts.bodies, count)
    rows: list[dict[str, Any]] = [
        {
            "method": name,
            "seconds": times[name],
            "stages": {stage: float(np.median([each[stage] for each in stages[name]])) for stage in stages[name][0]},
        }
        for name in calls
    ]
    for number in samples if find_spec("fcl") is not None else ():
        begin = time.perf_counter()
        found = sampled(scene, number)
        rows.append(
            {
                "method": f"python-fcl's manager, {number} samples",
                "seconds": time.perf_counter() - begin,
                "missed": len(touching - found),
                "phantom": len(found - touching),
            }
        )
    counts = results["mesh_ccd"].counts
    return {
        "what": "dice",
        "scene": f"{count:,} dice of {len(scene.die[1])} faces, {TURN} rad",
        "touching": len(touching),
        "contacts": len(results["mesh_ccd"].contacts),
        "solved": sum(counts.num_after_cull.values()),
        "toi": results["mesh_ccd"].toi,
        "rows": rows,
    }
