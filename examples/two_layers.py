"""Two layers of cloth fall on a ball, rest on each other without friction, and come free when they are lifted.

Every frame a few lines of position-based dynamics find where the cloth would like to be, and `line_search`, with its
defaults, moves each vertex there as far as is certain to be free. The mesh has a thickness, `radius`, on either side of
every surface, and with it the search keeps all that moves 1 mm apart. What it has stopped at 1 mm starts the next frame
there: it may part and slide, and comes no closer. So nothing has to be tuned for what is in contact to stay free to
move. The response keeps a little more than the search demands, by a plane across each gap that `find_proximity` has
found, so that the search stops only what the response has missed.

In the end both layers are lifted as one, in one search: any vertex that were stuck would stay behind.

    pip install -e '.[viz]' && python examples/two_layers.py --output layers

takes 20 s on two cores, with the same scene without CCD, where the response alone keeps the layers apart, and draws
layers/two_layers.png. It prints

    with CCD: 1152 vertices, 60 frames, 0 with intersections
    least distance 1.000000000 mm, after the lift 1.000000000 mm
    lifted by 200.0 mm, every vertex rose by 200.0 to 200.0 mm

With `start_gap_fraction=None` the thickness is kept as well, but not one vertex rises; with 0.5 all rise less than a
millionth of the way, since layers are less than 1e-9 mm apart by then.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

import ccd_warp as ccd

# Lengths in metres, times in seconds.
FRAME_TIME = 1.0 / 60.0
GRAVITY = np.array([0.0, 0.0, -9.81])
SIDE, BALL_RADIUS = 0.45, 0.3
RADIUS = 0.5e-3  # half of what is kept between surfaces
KEEP, REACH = 1.2e-3, 5e-3  # what the response keeps, and from where on it acts
LIFT = np.array([0.0, 0.0, 0.2])
ITERATIONS, DAMPING = 20, 0.02
KEY_FRAMES = (4, 8, 20)


def cloth(resolution: int, height: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of a square sheet."""
    x, y = np.meshgrid(*2 * [np.linspace(-0.5 * SIDE, 0.5 * SIDE, resolution)], indexing="ij")
    a = np.arange(resolution**2).reshape(resolution, resolution)[:-1, :-1].ravel()
    b, c, d = a + resolution, a + 1, a + resolution + 1
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([c, b, d])])
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)]), faces


class TwoLayers:
    """The simulation. Positions are those of all vertices, the ball's last."""

    def __init__(self, resolution: int = 30, *, with_ccd: bool = True) -> None:
        self.with_ccd = with_ccd
        ball = trimesh.creation.icosphere(subdivisions=3, radius=BALL_RADIUS)
        layers = [cloth(resolution, BALL_RADIUS + height) for height in (0.02, 0.03)]
        self.mesh = ccd.CollisionMesh.from_arrays([*layers, (ball.vertices, ball.faces)], static=[2], radius=RADIUS)
        self.pipeline = ccd.CollisionPipeline(self.mesh)
        self.positions = self.mesh.vertices.copy()
        self.velocity = np.zeros_like(self.positions)
        self.moves = self.mesh.vertex_body < 2
        self.springs = self.mesh.edges[self.moves[self.mesh.edges].all(axis=1)]
        self.rest_length = np.linalg.norm(np.subtract(*self.positions[self.springs.T]), axis=1)

    def advance(self) -> None:
        """One frame."""
        wish = self.positions.copy()
        wish[self.moves] += FRAME_TIME * (self.velocity[self.moves] + FRAME_TIME * GRAVITY)
        wish = self.solve(wish, self.pipeline.find_proximity(self.positions, REACH, unique=True))
        reached = self.pipeline.line_search(self.positions, wish, per="vertex").vertices if self.with_ccd else wish
        self.velocity = (1.0 - DAMPING) * (reached - self.positions) / FRAME_TIME
        self.positions = reached

    def solve(self, wish: NDArray[np.float64], near: ccd.Proximities) -> NDArray[np.float64]:
        """Where springs keep their lengths, and what is near keeps apart: the mean of all corrections, repeatedly."""
        i, j = self.springs.T
        mobility = (near.weights**2 * self.moves[near.vertices]).sum(axis=1)
        for _ in range(ITERATIONS):
            change, count = np.zeros_like(wish), np.full(len(wish), 1e-12)
            way = wish[i] - wish[j]
            length = np.linalg.norm(way, axis=1)
            pull = (0.5 * (self.rest_length - length) / length)[:, None] * way
            gap = np.einsum("mk,mkx,mx->m", near.weights, wish[near.vertices], near.direction)
            acts = gap < KEEP
            push = ((KEEP - gap[acts]) / mobility[acts])[:, None, None] * near.direction[acts][:, None]
            for rows, by in ((i, pull), (j, -pull), (near.vertices[acts], near.weights[acts][..., None] * push)):
                np.add.at(change, rows, by)
                np.add.at(count, rows, 1.0)
            wish = wish + self.moves[:, None] * change / count[:, None]
        return wish

    def lift(self) -> NDArray[np.float64]:
        """By how much each vertex of the cloth rises when all of them are lifted in one step."""
        wish = self.positions + self.moves[:, None] * LIFT
        reached = self.pipeline.line_search(self.positions, wish, per="vertex").vertices
        rise = (reached - self.positions)[self.moves, 2]
        self.positions = reached
        return rise

    def least_distance(self) -> float:
        """The least distance of two surfaces, infinite beyond a reach."""
        return self.pipeline.find_proximity(self.positions, REACH).distance.min(initial=np.inf)


def draw(pyvista, plotter, state: tuple[TwoLayers, NDArray[np.float64]]) -> None:
    """Add both layers and the ball."""
    scene, positions = state
    for body, color in enumerate(("#5b9bd5", "#f0a04b", "#b8b8b8")):
        surface = pyvista.PolyData.from_regular_faces(positions, scene.mesh.faces[scene.mesh.face_body == body])
        plotter.add_mesh(surface, color=color, smooth_shading=True, ambient=0.15)


def main() -> None:
    """Run with CCD and without, check, print, and draw."""
    parser = argparse.ArgumentParser(description="Two layers of cloth on a ball, pressed and lifted, in 20 s.")
    parser.add_argument("--frames", type=int, default=60, help="default 60")
    parser.add_argument("--resolution", type=int, default=24, help="vertices along a side of the cloth (default 24)")
    parser.add_argument("--output", type=Path, help="folder for two_layers.png (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    rows = [], []
    for row, with_ccd, title in zip(rows, (True, False), ("with CCD", "without CCD"), strict=True):
        scene, least, num_crossing = TwoLayers(options.resolution, with_ccd=with_ccd), np.inf, 0
        for frame in range(options.frames):
            scene.advance()
            least = min(least, scene.least_distance())
            count = len(scene.pipeline.find_intersections(scene.positions))
            num_crossing += count > 0
            if frame in {*KEY_FRAMES, options.frames - 1}:
                row.append((f"{title}, frame {frame}: {count} intersections", (scene, scene.positions)))
        print(f"{title}: {scene.moves.sum()} vertices, {options.frames} frames, {num_crossing} with intersections")
        if with_ccd:
            rise = 1e3 * scene.lift()
            print(f"least distance {1e3 * least:.9f} mm, after the lift {1e3 * scene.least_distance():.9f} mm")
            print(f"lifted by {1e3 * LIFT[2]:.1f} mm, every vertex rose by {rise.min():.1f} to {rise.max():.1f} mm")
    if options.output:
        from key_frames import draw_rows

        draw_rows(options.output / "two_layers.png", rows, draw, [(0.8, -1.3, 0.75), (0, 0, 0.18), (0, 0, 1)])


if __name__ == "__main__":
    main()
