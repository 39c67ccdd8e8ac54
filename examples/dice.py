"""Dice thrown on a table: rigid bodies that turn, collide with each other, and come to rest without a penetration.

In a frame a die turns by up to a radian, so that its corners move on arcs. The bodies fly freely until something would
come too near, bounce, and fly on:

1. `find_proximity` finds what is near, and impulses with friction make it bounce or rest;
2. `collision_free_step` with a `RigidMotion` says which part of the rest of the frame is certain to be free, for
   exactly these arcs, and `motion.at` gives the poses there. With `minimum_distance` something is left between the
   surfaces.

Every accepted motion has been found free, so there is nothing to push apart afterwards. A cube has the same moment of
inertia about all axes, so in flight its angular velocity stays the same, and `twist` is its true motion.

The same throw runs once more without CCD, in whole frames: dice get into each other and through the table.

    pip install -e '.[viz]' && python examples/dice.py --output dice

takes 10 s on two cores and draws dice/dice.png.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import ccd_warp as ccd

# Lengths in metres, times in seconds; masses are 1.
FRAME_TIME, GRAVITY = 1.0 / 60.0, 9.81
SIDE, INERTIA = 0.016, 0.016**2 / 6.0
KEPT, AIM, NEAR = 0.005 * SIDE, 0.01 * SIDE, 0.02 * SIDE  # between surfaces: at least, where they rest, where they act
RESTITUTION, FRICTION = 0.45, 0.3
SLOW = 2.0 * GRAVITY * FRAME_TIME  # what approaches more slowly does not bounce
SAFETY = 0.999  # of the way to an event, so that what bounces starts from beyond what is kept
MOST_EVENTS, SWEEPS = 24, 8
KEY_FRAMES = (0, 8, 16)
# Corners in binary order, faces of two triangles, and the number of pips on each face, -x +x -y +y -z +z.
CORNERS = SIDE * (np.stack(np.meshgrid(*3 * [[0, 1]], indexing="ij"), axis=-1).reshape(-1, 3) - 0.5)
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
PIPS = (1, 6, 2, 5, 3, 4)


def rotated(quaternions: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors turned by quaternions x y z w, in all combinations of leading axes."""
    axis, w = quaternions[..., :3], quaternions[..., 3:]
    twice = 2.0 * np.cross(axis, vectors)
    return vectors + w * twice + np.cross(axis, twice)


def velocity_of(arms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matrices that take the twist of a body to the velocity of its point at an arm, shape [m, 3, 6]."""
    turning = -np.cross(arms[:, None], np.eye(3)).transpose(0, 2, 1)
    return np.concatenate([np.broadcast_to(np.eye(3), turning.shape), turning], axis=2)


class Throw:
    """The simulation. A pose is the centre of a die and its quaternion x y z w."""

    def __init__(self, num_dice: int = 12, seed: int = 0, *, with_ccd: bool = True) -> None:
        faces = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])
        table = ccd.HalfSpace([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
        self.mesh = ccd.CollisionMesh.from_arrays(
            [*num_dice * [(CORNERS, faces)], table], rigid=range(num_dice), self_collision=False
        )
        self.pipeline, self.with_ccd = ccd.CollisionPipeline(self.mesh, minimum_distance=KEPT), with_ccd
        # two hands, which throw towards each other
        random = np.random.default_rng(seed)
        hand = np.where(np.arange(num_dice) % 2 == 0, -1.0, 1.0)
        place = np.arange(num_dice) // 2
        centres = np.stack([hand * (0.08 + 0.03 * (place // 3)), 0.03 * (place % 3 - 1.0), 0.06 + 0.0 * hand], axis=1)
        quaternions = random.normal(size=(num_dice, 4))
        self.poses = np.hstack([centres, quaternions / np.linalg.norm(quaternions, axis=1)[:, None]])
        # velocity and angular velocity of each die, and last of the table, which has no inverse mass either
        self.twist = np.zeros((num_dice + 1, 6))
        self.twist[:-1] = random.normal(scale=3 * [0.1] + 3 * [25.0], size=(num_dice, 6))
        self.twist[:-1, 0] -= 1.2 * hand
        self.inverse_mass = np.array([3 * [1.0] + 3 * [1.0 / INERTIA]] * num_dice + [6 * [0.0]])
        self.num_events = 0

    def positions(self) -> NDArray[np.float64]:
        """Where all corners are, shape [V, 3]."""
        corners = rotated(self.poses[:, None, 3:], CORNERS) + self.poses[:, None, :3]
        return corners.reshape(-1, 3)

    def advance(self) -> None:
        """One frame: from one event to the next, until its time is over."""
        self.twist[:-1, 2] -= FRAME_TIME * GRAVITY
        left = FRAME_TIME
        for _ in range(MOST_EVENTS):
            self.respond(left)
            motion = ccd.RigidMotion(self.poses, twist=left * self.twist[:-1])
            corners = self.mesh.vertices  # in the frames of the dice
            free = self.pipeline.collision_free_step(corners, corners, motion=motion) if self.with_ccd else 1.0
            free *= 1.0 if free == 1.0 else SAFETY
            self.poses = motion.at(free)
            left *= 1.0 - free
            self.num_events += 1
            if free == 1.0:
                break

    def respond(self, left: float) -> None:
        """Impulses between what is near: none comes nearer than it may in the time that is left."""
        near = self.pipeline.find_proximity(self.positions(), NEAR, unique=True)
        bodies, directions = near.bodies, near.direction
        centres = np.vstack([self.poses[:, :3], np.zeros((1, 3))])
        # the relative velocity of the closest points is this times both twists; and what an impulse does to these
        ahead = np.concatenate([velocity_of(near.points[:, k] - centres[bodies[:, k]]) for k in (0, 1)], axis=2)
        ahead[:, :, 6:] *= -1.0
        back = self.inverse_mass[bodies].reshape(-1, 12, 1) * ahead.transpose(0, 2, 1)
        yields = ahead @ back
        approach = -np.einsum("mx,mxk,mk->m", directions, ahead, self.twist[bodies].reshape(-1, 12))
        # what is nearer than where it rests is to part, gently
        least = np.minimum((AIM - near.distance) / left, 0.05)
        least = np.where(approach > SLOW, np.maximum(RESTITUTION * approach, least), least)
        pushes, drags = np.zeros(len(near)), np.zeros((len(near), 3))
        for _ in range(SWEEPS):
            for k, direction in enumerate(directions):
                slip = ahead[k] @ self.twist[bodies[k]].ravel()
                speed = slip @ direction
                push = max(pushes[k] + (least[k] - speed) / (direction @ yields[k] @ direction), 0.0)
                slip = slip + (push - pushes[k]) * (yields[k] @ direction)
                slip -= (slip @ direction) * direction
                square = slip @ slip
                drag = drags[k] - slip * square / max(slip @ yields[k] @ slip, 1e-300)
                drag *= min(1.0, FRICTION * push / max(np.sqrt(drag @ drag), 1e-300))
                impulse = (push - pushes[k]) * direction + drag - drags[k]
                self.twist[bodies[k]] += (back[k] @ impulse).reshape(2, 6)
                pushes[k], drags[k] = push, drag

    def num_penetrations(self) -> int:
        """Pairs of primitives that touch or cross, and corners that are not above the table."""
        positions = self.positions()
        return len(self.pipeline.find_intersections(positions)) + int((positions[:, 2] <= 0.0).sum())

    def speed(self) -> float:
        """The largest speed of a corner."""
        arms = rotated(self.poses[:, None, 3:], CORNERS)
        velocity, spin = self.twist[:-1, None, :3], self.twist[:-1, None, 3:]
        return float(np.linalg.norm(velocity + np.cross(spin, arms), axis=2).max())

    def pips(self) -> list[int]:
        """The number on the upper face of each die."""
        up = rotated(self.poses[:, 3:] * [-1, -1, -1, 1], np.array([0.0, 0.0, 1.0]))
        axis = np.abs(up).argmax(axis=1)
        return [PIPS[2 * k + int(up[d, k] > 0.0)] for d, k in enumerate(axis.tolist())]


def pip_places() -> NDArray[np.float64]:
    """Centres of the pips of a die, in its frame."""
    a = 0.25 * SIDE
    rows = {1: [(0, 0)], 2: [(-1, -1), (1, 1)], 4: [(-1, -1), (-1, 1), (1, -1), (1, 1)]}
    rows |= {3: rows[1] + rows[2], 5: rows[1] + rows[4], 6: rows[4] + [(-1, 0), (1, 0)]}
    places = [(side, u, v) for side, number in enumerate(PIPS) for u, v in rows[number]]
    return np.array([np.insert([a * u, a * v], side // 2, (side % 2 - 0.5) * SIDE) for side, u, v in places])


def draw(pyvista, plotter, poses: NDArray[np.float64]) -> None:
    """Add the dice with their pips, and the table."""
    quads = [QUADS + len(CORNERS) * die for die in range(len(poses))]
    corners = (rotated(poses[:, None, 3:], CORNERS) + poses[:, None, :3]).reshape(-1, 3)
    dice = pyvista.PolyData.from_regular_faces(corners, np.concatenate(quads))
    plotter.add_mesh(dice, color="#f2ead9", show_edges=True, edge_color="#b9ad94")
    pips = (rotated(poses[:, None, 3:], 1.01 * pip_places()) + poses[:, None, :3]).reshape(-1, 3)
    plotter.add_points(pips, color="#b03030", point_size=3, render_points_as_spheres=True)
    table = pyvista.Plane(center=(0, 0, 0), direction=(0, 0, 1), i_size=0.6, j_size=0.4)
    plotter.add_mesh(table, color="#9fb8a5", opacity=0.6)


def main() -> None:
    """Throw with CCD and without, check, print, and draw."""
    parser = argparse.ArgumentParser(description="Dice thrown on a table, with CCD and without, in 10 s.")
    parser.add_argument("--frames", type=int, default=60, help="default 60")
    parser.add_argument("--dice", type=int, default=12, help="default 12")
    parser.add_argument("--output", type=Path, help="folder for dice.png (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    rows = [], []
    for row, with_ccd, title in zip(rows, (True, False), ("with CCD", "without CCD"), strict=True):
        scene, num_bad, turn = Throw(options.dice, with_ccd=with_ccd), 0, 0.0
        for frame in range(options.frames):
            turn = max(turn, FRAME_TIME * float(np.linalg.norm(scene.twist[:, 3:], axis=1).max()))
            scene.advance()
            count = scene.num_penetrations()
            num_bad += count > 0
            if frame in {*KEY_FRAMES, options.frames - 1}:
                row.append((f"{title}, frame {frame}: {count} penetrations", scene.poses))
        print(f"{title}: {num_bad} of {options.frames} frames with penetrations,", end=" ")
        print(f"turns of up to {turn:.1f} rad a frame, fastest corner in the end {1e3 * scene.speed():.1f} mm/s")
        print(f"{title}: the upper faces are {' '.join(map(str, scene.pips()))}")
    if options.output:
        from key_frames import draw_rows

        draw_rows(options.output / "dice.png", rows, draw, [(0.06, -0.32, 0.15), (0, 0, 0.005), (0, 0, 1)])


if __name__ == "__main__":
    main()
