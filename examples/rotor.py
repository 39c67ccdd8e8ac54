"""A mixer: a rotor turns through a bed of grains, by a third of a radian a frame, and none gets into its blades.

The rotor is rigid and turns as it is told, so its blades sweep arcs. The grains are spheres (codimensional points with
a radius), move straight in a frame, push each other apart softly, and fall. What they do to the rotor is left out.

1. `mesh_ccd` with a `RigidMotion` says which grains meet a blade, the floor or a wall on the way they wish to go, and
   when. `contacts.relative_velocity` along the normal is how fast the two approach; in the rest of the frame the grain
   would get so much inside, and its end is moved as far outside. After some rounds nothing is met.
2. What would still be met stops the frame: `result.toi` says which part of it is certain to be free for all, and the
   rotor waits there, as a motor that is overloaded.

Every accepted path has been found free. An independent check follows the grains in the frame of the rotor, in 200
places a frame, and counts those that are nearer to a blade than their radius. With `--chords` the vertices of the rotor
move straight from frame to frame, as without a motion: blades shrink in a turn, and hundreds of grains get into them.

    pip install -e '.[viz]' && python examples/rotor.py --output rotor
"""

import argparse
import time
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

import ccd_warp as ccd

# Lengths in metres, times in seconds.
FRAME_TIME = 1.0 / 60.0
GRAVITY = np.array([0.0, 0.0, -9.81])
SIDE, RADIUS = 0.5, 0.012  # of the box; of a grain
TURN, FIRST_TURN = 0.35, 30  # radians a frame, from this frame on
BLADES, BLADE = 4, np.array([0.2, 0.008, 0.06])  # length, thickness and height
PITCH, BLADE_HEIGHT = np.radians(-35.0), 0.036  # the front of a blade looks up
ROUNDS, ITERATIONS, DRAG, SAFETY = 24, 6, 0.02, 0.9
FARTHER, GAP = 1.2, 0.1 * RADIUS  # how much farther outside than inside an end is moved
SAMPLES = 200  # of the check, in a frame
KEY_FRAMES = (29, 36, 50)


def rotor() -> tuple[list[NDArray[np.float64]], trimesh.Trimesh]:
    """Frames of the blades in that of the rotor, [4, 4] each, and the mesh of the rotor."""
    tilt = trimesh.transformations.rotation_matrix(PITCH, [1.0, 0.0, 0.0])
    tilt[0, 3] = 0.5 * BLADE[0] + 0.01
    frames = [
        trimesh.transformations.rotation_matrix(2.0 * np.pi * k / BLADES, [0, 0, 1]) @ tilt for k in range(BLADES)
    ]
    parts = [trimesh.creation.box(BLADE, frame) for frame in frames]
    shaft = trimesh.creation.cylinder(0.015, 0.4, sections=24)
    shaft.apply_translation([0.0, 0.0, 0.18])
    return frames, trimesh.util.concatenate([*parts, shaft])


def grains(count: int) -> NDArray[np.float64]:
    """At least ``count`` grains in layers above the rotor."""
    spacing = 2.2 * RADIUS
    n = int((SIDE - 2 * RADIUS) / spacing)
    k = spacing * (np.arange(n) - 0.5 * (n - 1))
    z = 0.14 + spacing * np.arange(-(-count // n**2) + 1)
    lattice = np.stack(np.meshgrid(k, k, z, indexing="ij"), axis=-1).reshape(-1, 3)
    lattice = lattice[np.hypot(*lattice.T[:2]) > 0.05]  # not in the shaft
    lattice = lattice[np.argsort(lattice[:, 2], kind="stable")[:count]]
    return lattice + np.random.default_rng(0).uniform(-0.05, 0.05, lattice.shape) * RADIUS


class Mixer:
    """The simulation. The vertices of the rotor come first, in its own frame, then the grains."""

    def __init__(self, num_grains: int = 2000, *, with_arcs: bool = True) -> None:
        self.blades, mesh = rotor()
        self.with_arcs = with_arcs
        walls = [
            ([s * 0.5 * SIDE if k == axis else 0.0 for k in range(3)], [-s if k == axis else 0.0 for k in range(3)])
            for axis in (0, 1)
            for s in (-1.0, 1.0)
        ]
        planes = [ccd.HalfSpace(*wall) for wall in [*walls, ([0, 0, 0], [0, 0, 1])]]
        self.x = grains(num_grains)
        self.mesh = ccd.CollisionMesh.from_arrays(
            [(mesh.vertices, mesh.faces), (self.x, np.zeros((0, 3), dtype=int)), *planes],
            names=["rotor", "grains", "x-", "x+", "y-", "y+", "floor"],
            rigid=["rotor"] if with_arcs else [],
            kinematic=["rotor"],
            codimensional_points=[False, True, *5 * [False]],
            radius=[0.0, RADIUS, *5 * [0.0]],
            self_collision=False,
        )
        # grains meet the rotor and the walls; among each other they are soft
        self.pipeline = ccd.CollisionPipeline(self.mesh, pair_kinds=["vertex_face", "vertex_plane"])
        neighbours = ccd.CollisionMesh.from_arrays([(self.x, np.zeros((0, 3), dtype=int))], codimensional_points=True)
        self.neighbours = ccd.CollisionPipeline(neighbours)
        self.num_rotor = len(mesh.vertices)
        self.velocity = np.zeros_like(self.x)
        self.angle, self.waited = 0.0, 0.0

    def pose(self, angle: float) -> NDArray[np.float64]:
        """The rotor turned by an angle, a matrix [1, 4, 4]."""
        pose = trimesh.transformations.rotation_matrix(angle, [0.0, 0.0, 1.0])
        pose[2, 3] = BLADE_HEIGHT
        return pose[None]

    def step(self, wish: NDArray[np.float64], turn: float) -> ccd.MeshResult:
        """The step in which the rotor turns and the grains go where they wish."""
        own = self.mesh.vertices[: self.num_rotor]
        if self.with_arcs:
            motion = ccd.RigidMotion(self.pose(self.angle), twist=[[0.0, 0.0, 0.0, 0.0, 0.0, turn]])
            return self.pipeline.mesh_ccd(self.all(own, self.x), self.all(own, wish), motion=motion)
        ends = [self.rotor_at(angle) for angle in (self.angle, self.angle + turn)]
        return self.pipeline.mesh_ccd(self.all(ends[0], self.x), self.all(ends[1], wish))

    def all(self, rotor: NDArray[np.float64], grains: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions of all vertices."""
        return np.concatenate([rotor, grains])

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
        part = SAFETY * result.toi if result.hit else 1.0
        before = self.x
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
        change, count = np.zeros_like(x), np.ones(len(x))
        for rows, by in ((i, push), (j, -push)):
            np.add.at(change, rows, by)
            np.add.at(count, rows, 0.5)
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


def draw(path: Path, scene: Mixer, pictures: list[tuple[str, float, NDArray[np.float64]]]) -> None:
    """Write key frames side by side, grains coloured by where they were at first."""
    from ccd_warp.viz import drawing_without_display

    layers = np.hypot(*scene.mesh.vertices[scene.num_rotor :, :2].T)
    faces = scene.mesh.faces[scene.mesh.face_body == 0]
    with drawing_without_display() as pyvista:
        columns = (len(pictures) + 1) // 2
        plotter = pyvista.Plotter(off_screen=True, shape=(2, columns), window_size=(columns * 400, 640), border=False)
        for k, (title, angle, x) in enumerate(pictures):
            plotter.subplot(*divmod(k, columns))
            blades = pyvista.PolyData.from_regular_faces(scene.rotor_at(angle), faces, deep=True)
            plotter.add_mesh(blades, color="#8796a5")
            cloud = pyvista.PolyData(x)
            cloud["layer"] = layers
            ball = pyvista.Sphere(radius=RADIUS, theta_resolution=10, phi_resolution=10)
            balls = cloud.glyph(geom=ball, scale=False, orient=False)
            plotter.add_mesh(balls, scalars="layer", cmap="YlOrBr_r", show_scalar_bar=False)
            plotter.add_mesh(
                pyvista.Box(0.5 * SIDE * np.array([-1, 1, -1, 1, 0, 1])), style="wireframe", color="#999999"
            )
            plotter.add_text(title, font_size=10, color="#222222")
            plotter.camera_position = [(0.5, -0.95, 0.75), (0.0, 0.0, 0.1), (0.0, 0.0, 1.0)]
            plotter.background_color = "white"
        plotter.screenshot(path)
        plotter.close()


def main() -> None:
    """Run, check, print, and draw."""
    parser = argparse.ArgumentParser(description="A rotor in a bed of grains.")
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--grains", type=int, default=2000)
    parser.add_argument("--chords", action="store_true", help="move the vertices of the rotor straight")
    parser.add_argument("--output", type=Path, help="folder of the picture (none is drawn without)")
    options = parser.parse_args()
    scene = Mixer(options.grains, with_arcs=not options.chords)
    pictures, inside, seconds = [], [], 0.0
    for frame in range(options.frames):
        begin = time.perf_counter()
        before, turn = scene.advance(TURN if frame >= FIRST_TURN else 0.0)
        seconds += time.perf_counter() - begin
        inside.append(scene.num_inside(before, turn))
        if frame in {*KEY_FRAMES, options.frames - 1}:
            pictures.append((f"frame {frame}: {sum(inside)} in a blade", scene.angle, scene.x))
    print(
        f"{len(scene.x)} grains, {options.frames} frames, the rotor turned by {scene.angle / 2 / np.pi:.1f} turns",
        end="",
    )
    print(f" and waited for {scene.waited:.2f} frames")
    print(f"{sum(inside)} times a grain got into a blade, in {np.count_nonzero(inside)} frames")
    print(f"{1e3 * seconds / options.frames:.0f} ms a frame without the check")
    if options.output is not None:
        options.output.mkdir(parents=True, exist_ok=True)
        draw(options.output / "rotor.png", scene, pictures)


if __name__ == "__main__":
    main()
