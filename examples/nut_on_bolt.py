"""A nut turned down a bolt by a whole turn a step, until it sits on the head, and back up.

Between two steps of a whole turn the nut has the same orientation: nothing at the ends of the step says that it turned,
and on straight lines its thread would hit that of the bolt at once. `RigidMotion` with `path="screw"` and a `twist` has
every vertex on its helix, for any number of turns, and `collision_free_step` says how far the nut is certain to go:

1. a nut of the bolt's pitch goes down turn by turn, with a tenth of a millimetre between the threads, and stops where
   it sits on the head, at the very angle that the lengths of both give;
2. from there it goes up again: with `minimum_distance` what is near may part;
3. a nut that advances by 2 % too much in each turn jams, when that has used up the clearance of the threads.

The nut stands in a frame of its own, as from a CAD file, whose origin is not on the axis of the screw.

    python examples/nut_on_bolt.py

takes half a minute on two cores and prints

    bolt of 14,616 faces, nut of 1,368
    down: 45 steps of 1 turn, then 0.49 of a turn; it sits on the head after 45.495 turns, 45.495 by its lengths
    up: 2 steps of 10 turns
    2 % too fast: it jams after 0.98 turns
    on straight lines: it jams after 0.025 turns

With `--output nut` and `pip install -e '.[viz]'` it draws nut/nut_on_bolt.png.
"""

import argparse
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import ccd_warp as ccd

# Lengths in millimetres, angles in radians.
PITCH, CREST, ROOT, CLEARANCE = 2.0, 5.0, 4.2, 0.1
CORNERS = 36  # of a turn
BOLT_TURNS, NUT_TURNS, START = 50, 4, 45  # the nut starts so many turns above the end of the thread
HEAD_TOP, KEPT = -1.0, 0.01
WIDTH = 16.0  # across the flats of the nut
AXIS = np.array([12.0, 5.0, 0.0])  # of the thread, in the frame of the nut
Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]


def grid(rows: NDArray[np.float64], *, is_closed: bool) -> Arrays:
    """Vertices and faces between rows of points, shape [n, m, 3]; closed ones end where they begin."""
    n, m = rows.shape[:2]
    number = np.arange(n * m).reshape(n, m)
    number = np.hstack([number, number[:, :1]]) if is_closed else number
    a, b, c, d = (x.ravel() for x in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    return rows.reshape(-1, 3), np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def thread(turns: int, radius: float) -> Arrays:
    """The surface of a thread, of a trapezoidal profile: rows along the helix, larger by ``radius`` than the bolt's."""
    angle = 2.0 * np.pi / CORNERS * np.arange(turns * CORNERS + 1)[:, None]
    r = radius + np.array([ROOT, ROOT, CREST, CREST, ROOT])
    z = PITCH * (angle / (2.0 * np.pi) + np.array([0.0, 0.25, 0.5, 0.75, 1.0]))
    return grid(np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1), is_closed=False)


def rings(radii: list[NDArray[np.float64] | float], heights: list[float]) -> Arrays:
    """The surface between rings around the axis, each with a radius for all corners or one for each."""
    angle = 2.0 * np.pi / CORNERS * np.arange(CORNERS)
    rows = [
        np.stack([r * np.cos(angle), r * np.sin(angle), z + 0.0 * angle], axis=-1)
        for r, z in zip(radii, heights, strict=True)
    ]
    return grid(np.array(rows), is_closed=True)


def hexagon(width: float) -> NDArray[np.float64]:
    """Distances of a hexagon from its middle, at the angles of all corners."""
    angle = 2.0 * np.pi / CORNERS * np.arange(CORNERS)
    return 0.5 * width / np.cos((angle + np.pi / 6) % (np.pi / 3) - np.pi / 6)


def joined(*parts: Arrays) -> Arrays:
    """Surfaces as one."""
    first = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    faces = [faces + k for (_, faces), k in zip(parts, first, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def bolt() -> Arrays:
    """A bolt: thread and head; its axis is z, and the thread begins at z = 0."""
    head = rings([0.1, hexagon(1.2 * WIDTH), hexagon(1.2 * WIDTH), 0.1], [HEAD_TOP, HEAD_TOP, -8.0, -8.0])
    return joined(thread(BOLT_TURNS, 0.0), head)


def nut() -> Arrays:
    """A nut that fits, with the same place on the thread and its lower side at z = 0, in a frame of its own."""
    hole, outside, top = CREST + CLEARANCE, hexagon(WIDTH), (NUT_TURNS + 1) * PITCH
    vertices, faces = joined(thread(NUT_TURNS, CLEARANCE), rings([hole, outside, outside, hole], [0.0, 0.0, top, top]))
    return vertices + AXIS, faces


class Nut:
    """A nut on a bolt. A pose is the place of the nut's origin and its quaternion x y z w."""

    def __init__(self) -> None:
        self.mesh = ccd.CollisionMesh.from_arrays([bolt(), nut()], static=[0], rigid=["nut"], names=["bolt", "nut"])
        self.pipeline = ccd.CollisionPipeline(self.mesh, minimum_distance=KEPT)
        self.pose = np.array([[*-AXIS, 0.0, 0.0, 0.0, 1.0]])
        self.pose[0, 2] += START * PITCH
        self.turns = 0.0

    def motion(self, turns: float, advance: float = PITCH) -> ccd.RigidMotion:
        """The nut turned by so many turns, those to the left being negative, with its advance in each of them."""
        turn = np.array([0.0, 0.0, 2.0 * np.pi * turns])
        # its origin, which is beside the axis, moves around it
        velocity = np.cross(turn, self.pose[0, :3] * [1.0, 1.0, 0.0]) + [0.0, 0.0, advance * turns]
        return ccd.RigidMotion(self.pose, twist=[[*velocity, *turn]], path="screw")

    def turn(self, turns: float, advance: float = PITCH) -> float:
        """Turn the nut as far as it goes, and say which part of this it was."""
        motion, frame = self.motion(turns, advance), self.mesh.vertices
        free = self.pipeline.collision_free_step(frame, frame, motion=motion)
        self.pose = motion.at(free)
        self.turns += free * turns
        return free

    def positions(self) -> NDArray[np.float64]:
        """Where all vertices are, shape [V, 3]."""
        positions = self.mesh.vertices.copy()
        rows = self.mesh.vertex_body == 1
        (x, y, z), (i, j, k, w) = self.pose[0, :3], self.pose[0, 3:]
        assert max(abs(i), abs(j)) < 1e-12
        c, s = w * w - k * k, 2.0 * w * k
        positions[rows] = positions[rows] @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [x, y, z]
        return positions


def draw(path: Path, mesh: ccd.CollisionMesh, pictures: list[tuple[str, NDArray[np.float64]]]) -> None:
    """Write the places of the nut side by side, the nut cut open."""
    from ccd_warp.viz import drawing_without_display

    with drawing_without_display() as pyvista:
        size = (len(pictures) * 300, 760)
        plotter = pyvista.Plotter(off_screen=True, shape=(1, len(pictures)), window_size=size, border=False)
        for k, (title, positions) in enumerate(pictures):
            plotter.subplot(0, k)
            for body, colour in enumerate(("#a9b4bf", "#d09a55")):
                faces = mesh.faces[mesh.face_body == body]
                if body == 1:
                    faces = faces[positions[faces].mean(axis=1)[:, 1] > 0.0]
                surface = pyvista.PolyData.from_regular_faces(positions, faces, deep=True)
                plotter.add_mesh(surface, color=colour, smooth_shading=False)
            plotter.add_text(title, font_size=9, color="#222222")
            plotter.camera_position = [(40.0, -240.0, 90.0), (0.0, 0.0, 46.0), (0.0, 0.0, 1.0)]
            plotter.camera.zoom(1.05)
            plotter.background_color = "white"
        plotter.screenshot(path)
        plotter.close()


def main() -> None:
    """Turn the nut down and up, jam it, print, and draw."""
    parser = argparse.ArgumentParser(description="A nut turned down a bolt by whole turns, in half a minute.")
    parser.add_argument("--output", type=Path, help="folder of the picture (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    scene, begin = Nut(), time.perf_counter()
    num_faces = np.bincount(scene.mesh.face_body)
    print(f"bolt of {num_faces[0]:,} faces, nut of {num_faces[1]:,}")
    pictures, steps, free = [("start", scene.positions())], 0, 1.0
    while free == 1.0:
        free = scene.turn(-1.0)
        steps += free == 1.0
        if steps == 20 and free == 1.0:
            pictures.append(("after 20 turns", scene.positions()))
    seconds = (time.perf_counter() - begin) / (steps + 1)
    expected = (START * PITCH - HEAD_TOP - KEPT) / PITCH
    print(f"down: {steps} steps of 1 turn, then {free:.2f} of a turn; it sits on the head after", end=" ")
    print(f"{-scene.turns:.3f} turns, {expected:.3f} by its lengths")
    pictures.append(("on the head", scene.positions()))
    steps = sum(scene.turn(10.0) == 1.0 for _ in range(2))
    print(f"up: {steps} steps of 10 turns")
    scene = Nut()
    while scene.turn(-1.0, 1.02 * PITCH) == 1.0:
        pass
    print(f"2 % too fast: it jams after {-scene.turns:.2f} turns")
    scene = Nut()
    start = scene.positions()
    scene.pose = scene.motion(-1.0).poses_t1
    straight = ccd.CollisionMesh.from_arrays([bolt(), nut()], static=[0], self_collision=False)
    free = ccd.collision_free_step(straight, start, scene.positions(), minimum_distance=KEPT)
    print(f"on straight lines: it jams after {free:.3f} turns")
    print(f"{seconds:.2f} s a turn")
    if options.output is not None:
        options.output.mkdir(parents=True, exist_ok=True)
        draw(options.output / "nut_on_bolt.png", scene.mesh, pictures)


if __name__ == "__main__":
    main()
