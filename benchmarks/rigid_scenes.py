"""Steps of rigid bodies that turn for the benchmark: one body moves through obstacles that stand still.

Bodies are made of boxes, which every peer knows, as a primitive or as a mesh. Poses are positions and quaternions,
scalar last. What is here of rotations shares no code with the package.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# Step sizes of drake's checker of edges, in metres and radians; those of its tutorials are 0.05 to 0.01.
EDGE_STEPS = (0.1, 0.01, 0.001)
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
_FACES = np.array([[a, b, c] for i, j, k, m in _SIDES for a, b, c in ((i, j, k), (i, k, m))])


@dataclass(frozen=True)
class Boxes:
    """A rigid body of boxes along its own axes.

    Attributes:
        sizes: Full sides of each box, shape [N, 3].
        centers: Their centres in the frame of the body, shape [N, 3].
    """

    sizes: np.ndarray
    centers: np.ndarray

    @property
    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and faces, 8 and 12 of each box."""
        vertices = self.centers[:, None] + 0.5 * self.sizes[:, None] * _CORNERS
        faces = _FACES + 8 * np.arange(len(self.sizes))[:, None, None]
        return vertices.reshape(-1, 3), faces.reshape(-1, 3)

    @property
    def reach(self) -> float:
        """Distance of the farthest vertex from the origin."""
        return float(np.linalg.norm(self.mesh[0], axis=1).max())


@dataclass(frozen=True)
class RigidSteps:
    """Steps of one body, each on its own, among the same obstacles.

    Attributes:
        name: What they are.
        body: The one that moves.
        obstacles: What stands still, in the frame of the world.
        poses: Poses at t = 0, shape [n, 7].
        omega: Rotation vectors of the steps in the frame of the world, of less than π, shape [n, 3].
        moves: Displacements of the origin of the body, shape [n, 3].
        path: "linear" or "screw".
        edge_steps: Step sizes of drake's checker; none where it does not know the path.
    """

    name: str
    body: Boxes
    obstacles: Boxes
    poses: np.ndarray
    omega: np.ndarray
    moves: np.ndarray
    path: str
    edge_steps: tuple[float, ...]

    def __len__(self) -> int:
        return len(self.poses)

    def poses_at(self, k: int, times: np.ndarray) -> np.ndarray:
        """Matrices of a step at times, shape [len(times), 4, 4]."""
        matrices = np.tile(np.eye(4), (len(times), 1, 1))
        turns = rotations(np.asarray(times)[:, None] * self.omega[k])
        matrices[:, :3, :3] = turns @ matrix_of(self.poses[k, 3:])
        along = np.asarray(times)[:, None] * self.moves[k]
        if self.path == "screw":
            along = self._on_screw(k, np.asarray(times))
        matrices[:, :3, 3] = self.poses[k, :3] + along
        return matrices

    def _on_screw(self, k: int, times: np.ndarray) -> np.ndarray:
        """Displacements of the origin on the screw between both ends: Rot(tω) about the point c that it fixes."""
        angle = np.linalg.norm(self.omega[k])
        axis = self.omega[k] / angle
        along = axis * (axis @ self.moves[k])
        across = self.moves[k] - along
        # (1 - Rot(ω)) c = across, for c across the axis, from the origin of the body
        center = 0.5 * (across + np.cross(axis, across) / np.tan(0.5 * angle))
        return times[:, None] * along + center - rotations(times[:, None] * self.omega[k]) @ center

    def ends(self) -> np.ndarray:
        """Poses at t = 1, shape [n, 4, 4]."""
        return np.stack([self.poses_at(k, np.ones(1))[0] for k in range(len(self))])


def rotations(vectors: np.ndarray) -> np.ndarray:
    """Rotation matrices of rotation vectors, shape [n, 3, 3] (Rodrigues)."""
    angles = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = (vectors / np.maximum(angles[:, 0], 1e-300)).T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    return np.eye(3) + np.sin(angles) * cross + (1 - np.cos(angles)) * (cross @ cross)


def matrix_of(quaternion: np.ndarray) -> np.ndarray:
    """The rotation matrix of a unit quaternion x y z w."""
    vector, w = quaternion[:3], quaternion[3]
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def _quaternions(rng: np.random.Generator, n: int) -> np.ndarray:
    q = rng.standard_normal((n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def _directions(rng: np.random.Generator, n: int) -> np.ndarray:
    d = rng.standard_normal((n, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def _one(size: tuple[float, float, float], center: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Boxes:
    return Boxes(np.array([size]), np.array([center]))


def _thrown(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses, displacements and turns of a tool of 60 mm that passes the origin within 60 mm."""
    rng = np.random.default_rng(1)
    poses = np.empty((n, 7))
    poses[:, 3:] = _quaternions(rng, n)
    moves = np.empty((n, 3))
    for k, pose in enumerate(poses):
        across = np.cross(matrix_of(pose[3:])[:, 2], _directions(rng, 1)[0])
        moves[k] = across / np.linalg.norm(across)  # 1 m
        # the middle of the step is near the plate, whose rim is as often passed as not
        poses[k, :3] = rng.uniform(-0.06, 0.06, 3) - 0.5 * moves[k]
    return poses, moves, 0.5 * _directions(rng, n)


def tool_and_plate(n: int) -> RigidSteps:
    """Drake's thin obstacle: a tool 5 mm thick passes a plate of 1 mm, across its own length, and turns by 0.5 rad."""
    poses, moves, turns = _thrown(n)
    body, plate = _one((0.005, 0.005, 0.06)), _one((0.06, 0.06, 0.001))
    return RigidSteps("tool of 5 mm, plate of 1 mm", body, plate, poses, turns, moves, "linear", EDGE_STEPS)


def wire_among_grains(n: int) -> RigidSteps:
    """A wire of 1 mm, as of a whisk, turns by 1 rad among 100 grains of 0.5 mm."""
    rng = np.random.default_rng(2)
    grains = Boxes(np.full((100, 3), 0.0005), rng.uniform(-1, 1, (100, 3)) * [0.3, 0.3, 0.01])
    wire = _one((0.25, 0.001, 0.001), (0.15, 0.0, 0.0))
    angles = rng.uniform(0, 2 * np.pi, n)
    poses = np.zeros((n, 7))
    poses[:, 2] = rng.uniform(-0.01, 0.01, n)
    poses[:, 5:] = np.column_stack([np.sin(0.5 * angles), np.cos(0.5 * angles)])
    turns = np.tile([0.0, 0.0, 1.0], (n, 1))
    name = "wire of 1 mm, grains of 0.5 mm"
    return RigidSteps(name, wire, grains, poses, turns, np.zeros((n, 3)), "linear", EDGE_STEPS)


def bar_in_a_cage(n: int) -> RigidSteps:
    """A bar turns by up to 1.5 rad on a screw among the 12 bars of a cage."""
    rng = np.random.default_rng(3)
    sizes, centers = [], []
    for axis in range(3):
        for a in (-0.05, 0.05):
            for b in (-0.05, 0.05):
                size = np.full(3, 0.002)
                size[axis] = 0.1
                sizes.append(size)
                centers.append(np.insert([a, b], axis, 0.0))
    poses = np.empty((n, 7))
    poses[:, :3] = rng.uniform(-0.05, 0.05, (n, 3))
    poses[:, 3:] = _quaternions(rng, n)
    turns = rng.uniform(0.2, 1.5, (n, 1)) * _directions(rng, n)
    moves = 0.04 * _directions(rng, n)
    cage = Boxes(np.array(sizes), np.array(centers))
    body = _one((0.003, 0.003, 0.08))
    return RigidSteps("bar in a cage, on a screw", body, cage, poses, turns, moves, "screw", ())


SCENES: tuple[Callable[[int], RigidSteps], ...] = (tool_and_plate, wire_among_grains, bar_in_a_cage)
