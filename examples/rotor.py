"""A mixer: a rotor turns through a bed of grains, by a third of a radian a frame, and none gets into its blades.

The rotor is rigid and turns as it is told, so its blades sweep arcs. The grains are spheres (codimensional points with
a radius), move straight in a frame, push each other apart softly, and fall. What they do to the rotor is left out.

1. `mesh_ccd` with a `RigidMotion` says which grains meet a blade, the floor or a wall on the way they wish to go, and
   when. `contacts.relative_velocity` along the normal is how fast the two approach; in the rest of the frame the grain
   would get so much inside, and its end is moved as far outside. After some rounds nothing is met.
2. What would still be met stops the frame: `result.toi` says which part of it is certain to be free for all, and the
   rotor waits there, as a motor that is overloaded.

Every accepted path has been found free. An independent check follows the grains in the frame of the rotor, in 200
places a frame, and counts those that are nearer to a blade than their radius. The same mixer runs once more with the
vertices of the rotor on chords, straight from frame to frame: blades shrink in a turn, and grains get into them.

    pip install -e '.[viz]' && python examples/rotor.py --output rotor

takes 20 s on two cores and draws rotor/rotor.png.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.transformations import rotation_matrix

import ccd_warp as ccd

# Lengths in metres, times in seconds.
FRAME_TIME, GRAVITY = 1.0 / 60.0, np.array([0.0, 0.0, -9.81])
SIDE, RADIUS, SAMPLES = 0.5, 0.012, 200  # of the box; of a grain; places of the check in a frame
TURN, FIRST_TURN = 0.35, 20  # radians a frame, from this frame on
BLADES, BLADE = 4, np.array([0.2, 0.008, 0.06])  # length, thickness and height
PITCH, BLADE_HEIGHT = np.radians(-35.0), 0.036  # the front of a blade looks up
ROUNDS, ITERATIONS, DRAG, SAFETY = 24, 6, 0.02, 0.9
FARTHER, GAP = 1.2, 0.1 * RADIUS  # how much farther outside than inside an end is moved
KEY_FRAMES = (19, 24, 36)


def rotor() -> tuple[list[NDArray[np.float64]], trimesh.Trimesh]:
    """Frames of the blades in that of the rotor, [4, 4] each, and the mesh of the rotor."""
    tilt = rotation_matrix(PITCH, [1.0, 0.0, 0.0])
    tilt[0, 3] = 0.5 * BLADE[0] + 0.01
    frames = [rotation_matrix(2.0 * np.pi * k / BLADES, [0, 0, 1]) @ tilt for k in range(BLADES)]
    parts = [trimesh.creation.box(BLADE, frame) for frame in frames]
    shaft = trimesh.creation.cylinder(0.015, 0.4, sections=24).apply_translation([0.0, 0.0, 0.18])
    return frames, trimesh.util.concatenate([*parts, shaft])


def grains(count: int) -> NDArray[np.float64]:
    """At least ``count`` grains in layers above the rotor."""
    spacing, layers = 2.2 * RADIUS, count // 200 + 1
    n = int((SIDE - 2 * RADIUS) / spacing)
    lattice = spacing * (np.mgrid[:n, :n, :layers].reshape(3, -1).T - [0.5 * (n - 1), 0.5 * (n - 1), 0.0])
    lattice = lattice[np.hypot(*lattice.T[:2]) > 0.05] + [0.0, 0.0, 0.14]  # not in the shaft
    lattice = lattice[np.argsort(lattice[:, 2], kind="stable")[:count]]
    return lattice + np.random.default_rng(0).uniform(-0.05, 0.05, lattice.shape) * RADIUS


class Mixer:
    """The simulation. The vertices of the rotor come first, in its own frame, then the grains."""

    def __init__(self, num_grains: int = 2000, *, with_arcs: bool = True) -> None:
        self.with_arcs, (self.blades, mesh) = with_arcs, rotor()
        sides = [s * axis for axis in np.eye(3)[:2] for s in (-1.0, 1.0)]
        planes = [*(ccd.HalfSpace(0.5 * SIDE * side, -side) for side in sides), ccd.HalfSpace([0, 0, 0], [0, 0, 1])]
        self.x = grains(num_grains)
        self.mesh = ccd.CollisionMesh.from_arrays(
            [(mesh.vertices, mesh.faces), (self.x, np.zeros((0, 3), dtype=int)), *planes],
            rigid=[0] if with_arcs else [],
            kinematic=[0],
            codimensional_points=[False, True, *5 * [False]],
            radius=[0.0, RADIUS, *5 * [0.0]],
            self_collision=False,
        )
        # grains meet the rotor and the walls; among each other they are soft
        self.pipeline = ccd.CollisionPipeline(self.mesh, pair_kinds=["vertex_face", "vertex_plane"])
        neighbours = ccd.CollisionMesh.from_arrays([(self.x, np.zeros((0, 3), dtype=int))], codimensional_points=True)
        self.neighbours = ccd.CollisionPipeline(neighbours)
        self.num_rotor, self.velocity = len(mesh.vertices), np.zeros_like(self.x)
        self.angle, self.waited = 0.0, 0.0

    def pose(self, angle: float) -> NDArray[np.float64]:
        """The rotor turned by an angle, a matrix [1, 4, 4]."""
        pose = rotation_matrix(angle, [0.0, 0.0, 1.0])
        pose[2, 3] = BLADE_HEIGHT
        return pose[None]

    def step(self, wish: NDArray[np.float64], turn: float) -> ccd.MeshResult:
        """The step in which the rotor turns and the grains go where they wish."""
        motion, ends = None, [self.mesh.vertices[: self.num_rotor]] * 2  # in its own frame
        if self.with_arcs:
            motion = ccd.RigidMotion(self.pose(self.angle), twist=[[0.0, 0.0, 0.0, 0.0, 0.0, turn]])
        else:
            ends = [self.rotor_at(angle) for angle in (self.angle, self.angle + turn)]
        start, end = (np.concatenate(parts) for parts in zip(ends, (self.x, wish), strict=True))
        return self.pipeline.mesh_ccd(start, end, motion=motion)

    def rotor_at(self, angle: float) -> NDArray[np.float64]:
        """Where the vertices of the rotor are."""
        pose = self.pose(angle)[0]
        return self.mesh.vertices[: self.num_rotor] @ pose[:3, :3].T + pose[:3, 3]

    def advance(self, turn: float) -> tuple[NDArray[np.float64], float]:
        """One frame; where the grains were, and by how much the rotor has turned."""
        wish = self.x + FRAME_TIME * ((1.0 - DRAG) * self.velocity + FRAME_TIME * GRAVITY)
        for _ in range(ITERATIONS):
            wish = self.apart(wish)
        for _ in range(ROUNDS):
            result = self.step(wish, turn)
            if not result.hit:
                break
            wish = self.pushed(wish, result.contacts)
        else:
            result = self.step(wish, turn)
        part, before = SAFETY * result.toi if result.hit else 1.0, self.x
        self.x = (1.0 - part) * before + part * wish
        self.velocity = (self.x - before) / FRAME_TIME
        self.angle += part * turn
        self.waited += 1.0 - part
        return before, part * turn

    def apart(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Grains that overlap move apart, each by the mean of its pushes."""
        near = self.neighbours.find_proximity(x, 2.0 * RADIUS)
        i, j = near.primitives.T
        push = 0.5 * (2.0 * RADIUS - near.distance)[:, None] * near.direction
        change, count = np.zeros_like(x), 1.0 + 0.5 * np.bincount(near.primitives.ravel(), minlength=len(x))
        np.add.at(change, i, push)
        np.add.at(change, j, -push)
        return x + change / count[:, None]

    def pushed(self, wish: NDArray[np.float64], contacts: ccd.Contacts) -> NDArray[np.float64]:
        """Grains that would meet something end as far outside as they would have got inside, and a little farther."""
        approach = -(contacts.relative_velocity * contacts.normal).sum(axis=1)
        depth = FARTHER * np.maximum((1.0 - contacts.toi) * approach, 0.0) + GAP
        grain = contacts.vertices[:, 0] - self.num_rotor  # the first primitive of both kinds
        # of several contacts of a grain the deepest
        order = np.argsort(depth)
        change = np.zeros_like(wish)
        change[grain[order]] = (depth[:, None] * contacts.normal)[order]
        return wish + change

    def num_inside(self, before: NDArray[np.float64], turn: float) -> int:
        """Grains that were nearer to a blade than their radius in one of many places of the last frame."""
        is_inside = np.zeros(len(self.x), dtype=bool)
        for t in np.linspace(0.0, 1.0, SAMPLES):
            pose = self.pose(self.angle - (1.0 - t) * turn)[0]
            x = ((1.0 - t) * before + t * self.x - pose[:3, 3]) @ pose[:3, :3]
            near = np.flatnonzero((np.abs(x[:, 2]) < BLADE[2]) & (np.hypot(x[:, 0], x[:, 1]) < 1.2 * BLADE[0]))
            for blade in self.blades:
                local = (x[near] - blade[:3, 3]) @ blade[:3, :3]
                outside = np.maximum(np.abs(local) - 0.5 * BLADE, 0.0)
                is_inside[near[np.linalg.norm(outside, axis=1) < (1.0 - 1e-9) * RADIUS]] = True
        return int(is_inside.sum())


def draw(pyvista, plotter, state: tuple[Mixer, float, NDArray[np.float64]]) -> None:
    """Add the rotor, the grains, coloured by where they were at first, and the box."""
    scene, angle, x = state
    faces = scene.mesh.faces[scene.mesh.face_body == 0]
    plotter.add_mesh(pyvista.PolyData.from_regular_faces(scene.rotor_at(angle), faces), color="#8796a5")
    cloud = pyvista.PolyData(x)
    cloud["radius"] = np.hypot(*scene.mesh.vertices[scene.num_rotor :, :2].T)
    ball = pyvista.Sphere(radius=RADIUS, theta_resolution=10, phi_resolution=10)
    balls = cloud.glyph(geom=ball, scale=False, orient=False)
    plotter.add_mesh(balls, scalars="radius", cmap="YlOrBr_r", show_scalar_bar=False)
    box = pyvista.Box(0.5 * SIDE * np.array([-1, 1, -1, 1, 0, 1]))
    plotter.add_mesh(box, style="wireframe", color="#999999")


def main() -> None:
    """Run with arcs and with chords, count, print, and draw."""
    parser = argparse.ArgumentParser(description="A rotor in a bed of grains, on arcs and on chords, in 20 s.")
    parser.add_argument("--frames", type=int, default=60, help="default 60")
    parser.add_argument("--grains", type=int, default=1000, help="default 1000")
    parser.add_argument("--output", type=Path, help="folder for rotor.png (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    rows = [], []
    for row, with_arcs, title in zip(rows, (True, False), ("arcs", "chords"), strict=True):
        scene, inside = Mixer(options.grains, with_arcs=with_arcs), 0
        for frame in range(options.frames):
            inside += scene.num_inside(*scene.advance(TURN if frame >= FIRST_TURN else 0.0))
            if frame in {*KEY_FRAMES, options.frames - 1}:
                row.append((f"{title}, frame {frame}: {inside} in a blade so far", (scene, scene.angle, scene.x)))
        print(f"{title:6} {inside} times a grain got into a blade, in {scene.angle / 2 / np.pi:.1f} turns", end=" ")
        print(f"among {len(scene.x)} grains; the rotor waited for {scene.waited:.2f} frames")
    if options.output:
        from key_frames import draw_rows

        draw_rows(options.output / "rotor.png", rows, draw, [(0.5, -0.95, 0.75), (0, 0, 0.08), (0, 0, 1)])


if __name__ == "__main__":
    main()
