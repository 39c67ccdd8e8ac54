"""Edges of a motion planner for the benchmark: an arm of seven joints among obstacles, and random edges between poses.

What is here of chains shares no code with the package.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ccd_warp.benchmarks.rigid_scenes import Boxes, rotations

import ccd_warp as ccd

# The arm: axes of its joints, which roll and pitch in turn, and lengths and radii of its links, in metres.
AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1]], dtype=float)
LENGTHS = (0.30, 0.20, 0.25, 0.20, 0.25, 0.10, 0.15)
RADII = (0.07, 0.06, 0.06, 0.055, 0.05, 0.045, 0.03)
LIMITS = np.array([2.9, 1.8, 2.9, 2.2, 2.9, 2.2, 2.9])
EDGE = 1.0  # length of an edge in joint space, in radians
NUM_LINKS, NUM_OBSTACLES, NUM_FACES = len(AXES), 50, 20_000
Arrays = tuple[np.ndarray, np.ndarray]


def capsule(length: float, radius: float, faces: int) -> Arrays:
    """Vertices and faces, about as many as given, of a capsule around the z axis from 0 to a length."""
    around = max(4, round((0.5 * faces) ** 0.5))
    rows = max(3, round(0.5 * faces / around))
    cap = max(1, rows // 4)
    latitude = np.concatenate([np.linspace(-0.5, 0.0, cap + 1), np.linspace(0.0, 0.5, cap + 1)])[1:-1] * np.pi
    middle = np.linspace(0.0, length, max(2, rows - 2 * cap + 1))[1:-1]
    r = np.concatenate([radius * np.cos(latitude[:cap]), np.full(len(middle), radius), radius * np.cos(latitude[cap:])])
    z = [radius * np.sin(latitude[:cap]), middle, length + radius * np.sin(latitude[cap:])]
    angle = 2.0 * np.pi / around * np.arange(around)
    rings = np.stack(np.broadcast_arrays(np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle)), np.hstack(z)[:, None]))
    vertices = np.vstack([rings.reshape(3, -1).T, [[0, 0, -radius], [0, 0, length + radius]]])
    number = np.arange(len(r) * around).reshape(-1, around)
    a, b = number, np.roll(number, -1, axis=1)
    low, high = len(vertices) - 2, len(vertices) - 1
    sides = [[a[:-1], b[:-1], b[1:]], [a[:-1], b[1:], a[1:]]]
    ends = [[b[0], a[0], np.full(around, low)], [a[-1], b[-1], np.full(around, high)]]
    found = [np.stack([x.ravel() for x in corners], axis=1) for corners in [*sides, *ends]]
    return vertices, np.concatenate(found)


@dataclass(frozen=True)
class ArmEdges:
    """An arm among obstacles, and edges between its configurations.

    Attributes:
        links: Vertices and faces of each link, in its own frame.
        obstacles: Boxes, in the frame of the world.
        q0: Configurations at the start of the edges, shape [n, 7].
        q1: Those at the end.
    """

    links: list[Arrays]
    obstacles: Boxes
    q0: np.ndarray
    q1: np.ndarray

    def __len__(self) -> int:
        return len(self.q0)

    @cached_property
    def joints(self) -> list[ccd.Joint]:
        """The joints; link k is carried by joint k."""
        heights = (0.0, *LENGTHS[:-1])
        names = ["base", *(f"link{k}" for k in range(NUM_LINKS))]
        return [
            ccd.Joint(f"joint{k}", names[k], names[k + 1], "revolute", tuple(AXES[k]), (0, 0, heights[k], 0, 0, 0, 1))
            for k in range(NUM_LINKS)
        ]

    @cached_property
    def bodies(self) -> list[Arrays]:
        """Vertices and faces of the links, and then of each obstacle."""
        vertices, faces = self.obstacles.mesh
        boxes = [(vertices[8 * k : 8 * k + 8], faces[:12]) for k in range(len(self.obstacles.sizes))]
        return [*self.links, *boxes]

    @cached_property
    def mesh(self) -> ccd.CollisionMesh:
        """One world: links that are neighbours are not tested against each other."""
        count = len(self.bodies)
        may = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) > 1
        may[:, NUM_LINKS:] = may[NUM_LINKS:] = True
        static = range(NUM_LINKS, count)
        return ccd.CollisionMesh.from_arrays(
            self.bodies, rigid=range(NUM_LINKS), static=static, self_collision=False, body_pairs=may
        )

    def motion(self, chosen: slice | np.ndarray) -> ccd.JointMotion:
        """The motion of some of the edges, each a world."""
        names = [f"link{k}" for k in range(NUM_LINKS)]
        return ccd.JointMotion(self.joints, self.q0[chosen], self.q1[chosen], links=names)

    def matrices_at(self, k: int | np.ndarray, t: float | np.ndarray) -> np.ndarray:
        """Where the links of an edge are at times, or those of several edges at a time of each, [..., 7, 4, 4]."""
        t = np.asarray(t, dtype=float)
        q = self.q0[k] + t[..., None] * (self.q1[k] - self.q0[k])
        heights = (0.0, *LENGTHS[:-1])
        pose = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))
        found = []
        for j in range(NUM_LINKS):
            step = np.tile(np.eye(4), (*q.shape[:-1], 1, 1))
            step[..., :3, :3] = rotations((q[..., j : j + 1] * AXES[j]).reshape(-1, 3)).reshape(*q.shape[:-1], 3, 3)
            step[..., 2, 3] = heights[j]
            pose = pose @ step
            found.append(pose)
        return np.stack(found, axis=-3)

    def positions_at(self, chosen: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Positions of all vertices for several edges, at a time of each, shape [n, V, 3]."""
        matrices = self.matrices_at(chosen, t)
        placed = [
            x @ matrices[:, j, :3, :3].transpose(0, 2, 1) + matrices[:, j, None, :3, 3]
            for j, (x, _) in enumerate(self.links)
        ]
        fixed = self.obstacles.mesh[0]
        return np.concatenate([*placed, np.broadcast_to(fixed, (len(chosen), *fixed.shape))], axis=1)


def arm_edges(count: int, faces: int = NUM_FACES, obstacles: int = NUM_OBSTACLES, seed: int = 5) -> ArmEdges:
    """Edges of a roadmap: random configurations, and a step of a given length in a random direction."""
    rng = np.random.default_rng(seed)
    links = [capsule(length, r, faces // NUM_LINKS) for length, r in zip(LENGTHS, RADII, strict=True)]
    # boxes around the arm, as far from its base as it reaches, and not where it stands
    centers = []
    while len(centers) < obstacles:
        center = rng.uniform([-1.0, -1.0, 0.0], [1.0, 1.0, 1.2])
        if np.hypot(*center[:2]) > 0.3:
            centers.append(center)
    sizes = rng.uniform(0.03, 0.2, (obstacles, 3))
    q0 = rng.uniform(-LIMITS, LIMITS, (count, NUM_LINKS))
    step = rng.standard_normal((count, NUM_LINKS))
    q1 = q0 + EDGE * step / np.linalg.norm(step, axis=1, keepdims=True)
    return ArmEdges(links, Boxes(sizes, np.array(centers)), q0, q1)
