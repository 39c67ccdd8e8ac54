"""Whether rigid bodies touch at one time, exactly, for many times: what shows an answer to be wrong.

Positions come from `rigid_scenes`, which shares no code with the package, and `find_intersections` decides by integer
arithmetic whether surfaces meet at that time; for spheres the distances of their centres do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from rigid_scenes import Boxes, RigidSteps, Spheres

import ccd_warp as ccd

# How far apart the bodies may be at a toi that is right: the tolerance of ours, and rounding, in parts of the size.
GAP = 1e-5


def positions_at(steps: RigidSteps, times: np.ndarray) -> np.ndarray:
    """Positions of all vertices, each step at a time of its own, shape [n, V, 3]."""
    moving, fixed = steps.body.mesh[0], steps.obstacles.mesh[0]
    matrices = np.stack([steps.poses_at(k, times[k : k + 1])[0] for k in range(len(steps))])
    placed = moving @ matrices[:, :3, :3].transpose(0, 2, 1) + matrices[:, None, :3, 3]
    return np.concatenate([placed, np.broadcast_to(fixed, (len(steps), *fixed.shape))], axis=1)


def mesh_of(steps: RigidSteps, bodies: int = 1, **options: Any) -> ccd.CollisionMesh:
    """The body, so many times, and the obstacles, which are static; none collides with itself."""
    made_of = [steps.body] * bodies + [steps.obstacles]
    if isinstance(steps.body, Spheres):
        options |= {"codimensional_points": True, "radius": np.repeat(*_radii(made_of))}
    arrays = [each.mesh for each in made_of]
    return ccd.CollisionMesh.from_arrays(arrays, static=[bodies], self_collision=False, **options)


def _radii(made_of: list) -> tuple[list[float], list[int]]:
    return [each.radius for each in made_of], [len(each.centers) for each in made_of]


def worlds_of(steps: RigidSteps) -> ccd.CollisionMesh:
    """A world for each step."""
    return mesh_of(steps).replicate(len(steps))


def touching_at(steps: RigidSteps, times: np.ndarray | float, mesh: ccd.CollisionMesh | None = None) -> np.ndarray:
    """Whether surfaces meet in each step at a time of its own, shape [n]."""
    positions = positions_at(steps, np.broadcast_to(np.asarray(times, dtype=float), (len(steps),)))
    if isinstance(steps.body, Spheres):
        return _gaps(steps, positions) <= 0.0
    touching = np.zeros(len(steps), dtype=bool)
    touching[ccd.find_intersections(mesh or worlds_of(steps), positions).world] = True
    return touching


def _gaps(steps: RigidSteps, positions: np.ndarray) -> np.ndarray:
    """Distances between the spheres of the body and those of the obstacles, shape [n]."""
    assert isinstance(steps.body, Spheres) and isinstance(steps.obstacles, Spheres)
    count = len(steps.body.centers)
    gaps = np.linalg.norm(positions[:, :count, None] - steps.obstacles.centers, axis=-1)
    return gaps.min(axis=(1, 2)) - (steps.body.radius + steps.obstacles.radius)


def starting_apart(steps: RigidSteps) -> RigidSteps:
    """The steps at whose start surfaces do not meet, and no obstacle is inside the body."""
    apart = ~(touching_at(steps, 0.0) | _inside(steps))
    return replace(steps, poses=steps.poses[apart], omega=steps.omega[apart], moves=steps.moves[apart])


def _inside(steps: RigidSteps) -> np.ndarray:
    """Whether the centre of an obstacle is in a box of the body at the start, shape [n]."""
    if not isinstance(steps.body, Boxes):
        return np.zeros(len(steps), dtype=bool)
    start = np.stack([steps.poses_at(k, np.zeros(1))[0] for k in range(len(steps))])
    places = (steps.obstacles.centers - start[:, None, :3, 3]) @ start[:, :3, :3]
    offsets = np.abs(places[:, :, None] - steps.body.centers)
    return (offsets <= 0.5 * steps.body.sizes).all(axis=-1).any(axis=(1, 2))


@dataclass(frozen=True)
class Evidence:
    """What samples say of the answers of ours.

    Attributes:
        samples: Number of times at which each step was looked at.
        missed: Steps in which a sample touches, and ours says that none does.
        late: Steps in which a sample before the toi of ours touches.
        apart: Steps that are not near a contact at the toi of ours.
    """

    samples: int
    missed: int
    late: int
    apart: int


def evidence(steps: RigidSteps, toi: np.ndarray, samples: int) -> Evidence:
    """Look at every step at many times, and at the toi of ours."""
    mesh = worlds_of(steps)
    first = np.full(len(steps), np.inf)
    for t in np.linspace(0.0, 1.0, samples):
        first[touching_at(steps, t, mesh) & (first == np.inf)] = t
    hit = toi < np.inf
    size = steps.body.reach
    positions = positions_at(steps, np.where(hit, toi, 0.0))
    if isinstance(steps.body, Spheres):
        is_near = _gaps(steps, positions) <= GAP * size
    else:
        near = ccd.find_proximity(mesh, positions, GAP * size)
        is_near = np.zeros(len(steps), dtype=bool)
        is_near[mesh.vertex_world[near.vertices[:, 0]]] = True
    return Evidence(
        samples, int((~hit & (first < np.inf)).sum()), int((hit & (first < toi)).sum()), int((hit & ~is_near).sum())
    )
