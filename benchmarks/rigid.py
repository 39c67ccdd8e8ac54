"""Rigid bodies that turn: ours and what users have today, time against what is missed, on the same steps.

Ours is one call for all steps, each a world of its own or all in one scene, and a call for each step. An answer is
missed where ours finds a contact and the other finds none. What ours says is itself held against intersections at many
times of each step: positions come from `rigid_scenes`, which shares no code with the package, and `find_intersections`
decides by integer arithmetic. All on one thread, the processor time of each in interleaved rounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from rigid_peers import peers_of
from rigid_scenes import SCENES, RigidSteps
from timing import figures, interleaved

import ccd_warp as ccd

OURS, OURS_TOGETHER, OURS_EACH = "ours, a world for each step", "ours, all in one scene", "ours, a call for each step"
# A toi of another differs from that of ours by more than its tolerance and rounding.
LATE = 1e-5
# How far apart the bodies may be at a toi that is right: the tolerance of ours, and rounding, in parts of the size.
GAP = 1e-5
# Steps of each scene, times at which each is looked at, and rounds.
SIZES, QUICK_SIZES = (1_000, 1_001, 3), (100, 101, 2)


def positions_at(steps: RigidSteps, times: np.ndarray) -> np.ndarray:
    """Positions of all vertices, each step at a time of its own, shape [n, V, 3]."""
    moving, fixed = steps.body.mesh[0], steps.obstacles.mesh[0]
    matrices = np.stack([steps.poses_at(k, times[k : k + 1])[0] for k in range(len(steps))])
    placed = moving @ matrices[:, :3, :3].transpose(0, 2, 1) + matrices[:, None, :3, 3]
    return np.concatenate([placed, np.broadcast_to(fixed, (len(steps), *fixed.shape))], axis=1)


def mesh_of(steps: RigidSteps, bodies: int = 1, **options: Any) -> ccd.CollisionMesh:
    """The body, so many times, and the obstacles, which are static; none collides with itself."""
    arrays = [each.mesh for each in [steps.body] * bodies + [steps.obstacles]]
    return ccd.CollisionMesh.from_arrays(arrays, static=[bodies], self_collision=False, **options)


def touching_at(steps: RigidSteps, t: float, mesh: ccd.CollisionMesh) -> np.ndarray:
    """Whether surfaces meet in each step at a time, shape [n]; the mesh has a world for each."""
    touching = np.zeros(len(steps), dtype=bool)
    touching[ccd.find_intersections(mesh, positions_at(steps, np.full(len(steps), t))).world] = True
    return touching


def starting_apart(steps: RigidSteps) -> RigidSteps:
    """The steps at whose start surfaces do not meet, and no obstacle is inside the body."""
    apart = ~(touching_at(steps, 0.0, mesh_of(steps).replicate(len(steps))) | _inside(steps))
    return replace(steps, poses=steps.poses[apart], omega=steps.omega[apart], moves=steps.moves[apart])


def _inside(steps: RigidSteps) -> np.ndarray:
    """Whether the centre of an obstacle is in a box of the body at the start, shape [n]."""
    start = np.stack([steps.poses_at(k, np.zeros(1))[0] for k in range(len(steps))])
    places = (steps.obstacles.centers - start[:, None, :3, 3]) @ start[:, :3, :3]
    offsets = np.abs(places[:, :, None] - steps.body.centers)
    return (offsets <= 0.5 * steps.body.sizes).all(axis=-1).any(axis=(1, 2))


def evidence(steps: RigidSteps, toi: np.ndarray, samples: int) -> dict[str, int]:
    """What looks at many times of each step, and at the toi of ours, say of ours.

    Returns:
        samples; missed: steps in which a sample touches, and ours says that none does; late: in which a sample before
        the toi touches; apart: that are not near a contact at the toi.
    """
    mesh = mesh_of(steps).replicate(len(steps))
    first = np.full(len(steps), np.inf)
    for t in np.linspace(0.0, 1.0, samples):
        first[touching_at(steps, t, mesh) & (first == np.inf)] = t
    hit, is_near = toi < np.inf, np.zeros(len(steps), dtype=bool)
    near = ccd.find_proximity(mesh, positions_at(steps, np.where(hit, toi, 0.0)), GAP * steps.body.reach)
    is_near[mesh.vertex_world[near.vertices[:, 0]]] = True
    wrong = {"missed": ~hit & (first < np.inf), "late": hit & (first < toi), "apart": hit & ~is_near}
    return {"samples": samples} | {name: int(which.sum()) for name, which in wrong.items()}


def matrices_of(steps: RigidSteps) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the body and of the obstacles at both ends of each step, shape [n, 2, 4, 4]."""
    ends = np.tile(np.eye(4), (2, len(steps), 2, 1, 1))
    ends[0, :, 0] = [steps.poses_at(k, np.zeros(1))[0] for k in range(len(steps))]
    ends[1, :, 0] = steps.ends()
    return ends[0], ends[1]


def ours(steps: RigidSteps) -> dict[str, Callable[[], np.ndarray]]:
    """The calls of ours, each of which gives the toi of every step."""
    first, last = matrices_of(steps)
    worlds = mesh_of(steps).replicate(len(steps))
    count = len(steps)
    meets = np.zeros((count + 1, count + 1), dtype=bool)
    meets[-1] = meets[:, -1] = True
    scene = mesh_of(steps, count, body_pairs=meets)
    of_scene = [np.concatenate([poses[:, 0], poses[:1, 1]]) for poses in (first, last)]
    one = mesh_of(steps)

    def each(k: int) -> float:
        return ccd.rigid_ccd(one, first[k], last[k], path=steps.path, num_threads=1).toi

    return {
        OURS: lambda: ccd.rigid_ccd(worlds, first, last, path=steps.path, num_threads=1).world_toi,
        OURS_TOGETHER: lambda: ccd.rigid_ccd(scene, *of_scene, path=steps.path, num_threads=1).body_toi[:-1],
        OURS_EACH: lambda: np.array([each(k) for k in range(count)]),
    }


def judged(toi: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    """Faults of an answer, and how far its tois are off where both have one."""
    hit, is_true = toi < np.inf, truth < np.inf
    both = hit & is_true
    error = np.abs(toi[both] - truth[both])
    return {
        "missed": int((is_true & ~hit).sum()),
        "phantom": int((hit & ~is_true).sum()),
        "late": int((both & (toi > truth + LATE)).sum() if both.any() else 0),
        "error": float(error.max()) if both.any() else None,
    }


def measure(make: Callable[[int], RigidSteps], count: int, samples: int, rounds: int) -> list[dict]:
    """A row for each program on a scene, and what looks at exact positions say of ours.

    Args:
        make: Makes the steps.
        count: Their number; those that touch at their start are left out.
        samples: Times at which each step is looked at.
        rounds: Rounds of each call.
    """
    steps = starting_apart(make(count))
    calls = ours(steps) | dict(peers_of(steps))
    answers: dict[str, np.ndarray] = {}
    times = figures(interleaved(calls, rounds, clock=time.process_time, after=answers.__setitem__))
    truth = answers[OURS]
    about = {"scene": steps.name, "steps": len(steps), "hits": int((truth < np.inf).sum())}
    about["evidence"] = evidence(steps, truth, samples)
    each = [
        {"method": name, "seconds": times["seconds"][name] / len(steps), **judged(answers[name], truth)}
        for name in calls
    ]
    return [about | row for row in each]


def measure_all(is_quick: bool) -> list[dict]:
    """The rows of all scenes."""
    return [row for make in SCENES for row in measure(make, *(QUICK_SIZES if is_quick else SIZES))]
