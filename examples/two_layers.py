"""Two layers of cloth fall on a ball, rest on each other without friction, and come free when they are lifted.

Every frame a few lines of position-based dynamics find where the cloth would like to be, and `line_search`, with its
defaults, moves each vertex there as far as is certain to be free. The mesh has a thickness, `radius`, on either side of
every surface, and with it the search keeps all that moves 1 mm apart. What it has stopped at 1 mm starts the next frame
there: it may part and slide, and comes no closer. So nothing has to be tuned for what is in contact to stay free to
move. The response keeps a little more than the search demands, by a plane across each gap that `find_proximity` has
found, so that the search stops only what the response has missed.

After 100 frames both layers are lifted as one, in one search: any vertex that were stuck would stay behind.

Run it: python examples/two_layers.py

It prints, with the time of a frame:

    1800 vertices, 100 frames, 0 with intersections
    least distance 1.000000000 mm, after the lift 1.000000000 mm
    lifted by 200.0 mm, every vertex rose by 200.0 to 200.0 mm

With `start_gap_fraction=None` the thickness is kept as well, but not one vertex rises; with 0.5 all rise less than a
millionth of the way, since layers are less than 1e-9 mm apart by then.
"""

import argparse
import time

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


def cloth(resolution: int, height: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of a square sheet."""
    x, y = np.meshgrid(*2 * [np.linspace(-0.5 * SIDE, 0.5 * SIDE, resolution)], indexing="ij")
    a = np.arange(resolution**2).reshape(resolution, resolution)[:-1, :-1].ravel()
    b, c, d = a + resolution, a + 1, a + resolution + 1
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([c, b, d])])
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)]), faces


class TwoLayers:
    """The simulation. Positions are those of all vertices, the ball's last."""

    def __init__(self, resolution: int = 30) -> None:
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
        wish = self.solve(wish, self.pipeline.find_proximity(self.positions, REACH).unique())
        reached = self.pipeline.line_search(self.positions, wish, per="vertex").vertices
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


def main() -> None:
    """Run, check, and print."""
    parser = argparse.ArgumentParser(description="Two layers of cloth on a ball, pressed and lifted.")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--resolution", type=int, default=30, help="vertices along a side of the cloth (default 30)")
    options = parser.parse_args()
    scene = TwoLayers(options.resolution)
    least, num_crossing, seconds = np.inf, 0, 0.0
    for _ in range(options.frames):
        begin = time.perf_counter()
        scene.advance()
        seconds += time.perf_counter() - begin
        least = min(least, scene.least_distance())
        num_crossing += len(scene.pipeline.find_intersections(scene.positions)) > 0
    rise = scene.lift()
    print(f"{scene.moves.sum()} vertices, {options.frames} frames, {num_crossing} with intersections")
    print(f"least distance {1e3 * least:.9f} mm, after the lift {1e3 * scene.least_distance():.9f} mm")
    print(f"lifted by {1e3 * LIFT[2]:.1f} mm, every vertex rose by {1e3 * rise.min():.1f} to {1e3 * rise.max():.1f} mm")
    print(f"{1e3 * seconds / options.frames:.0f} ms a frame without the checks")


if __name__ == "__main__":
    main()
