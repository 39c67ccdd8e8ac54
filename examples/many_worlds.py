"""Thousands of worlds at once: a ball learns the shortest way through the windows of three walls, by trial and error.

A way is a chain of straight legs, each of which crosses one of the places where a wall may stand. Every generation
tries a thousand ways, and the cross-entropy method draws the next ones around the best (Rubinstein 1999). A way costs
its length, and a fine for each leg that meets a wall: the less of the leg was free, the more.

Each leg of each way is a world of its own: `mesh.replicate` makes them once, and one call a generation says in
`world_toi` up to which part each is certain to be free. The search runs once more with a test at the ends of the legs
alone, without CCD, and goes straight through the walls.

    pip install -e '.[viz]' && python examples/many_worlds.py --output worlds

takes 10 s on two cores and draws worlds/many_worlds.png.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import ccd_warp as ccd

LEGS, RADIUS, HALF = 6, 0.12, 1.5  # number of legs, each 1 long in x; of the ball; half the side of a wall
WINDOWS = {1.5: (0.5, 0.4), 2.5: (-0.4, 0.6), 4.5: (0.3, -0.6)}  # places of walls, centres of their windows in y and z
WINDOW = 0.3  # half the side of a window
START, GOAL = np.array([0.0, 0.0, 0.0]), np.array([float(LEGS), 0.0, 0.0])
ELITE, FINE = 0.02, 5.0  # share of the best; for a leg that is not free at all
SPREAD, LEAST_SPREAD = 0.6, 0.01  # of the first generation, and of any


def wall(x: float, window: tuple[float, float]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of a wall around its window: an outer square, an inner one, and a ring between them."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    both = np.vstack([HALF * corners, WINDOW * corners + window])
    k, n = np.arange(4), (np.arange(4) + 1) % 4
    return np.insert(both, 0, x, axis=1), np.vstack([np.stack([k, n, k + 4], 1), np.stack([n, n + 4, k + 4], 1)])


class Search:
    """The cross-entropy method over the places between legs, with CCD or with a test at the ends of legs."""

    def __init__(self, num_ways: int, *, with_ccd: bool = True, seed: int = 0) -> None:
        self.num_ways, self.with_ccd, self.random = num_ways, with_ccd, np.random.default_rng(seed)
        ball = (np.zeros((1, 3)), np.zeros((0, 3), dtype=int))
        walls = [wall(x, window) for x, window in WINDOWS.items()]
        options = {"static": [1, 2, 3], "codimensional_points": True, "radius": [RADIUS, 0.0, 0.0, 0.0]}
        mesh = ccd.CollisionMesh.from_arrays([ball, *walls], **options)
        self.worlds = ccd.CollisionPipeline(mesh.replicate(num_ways * LEGS), pair_kinds=["vertex_face"])
        self.start, self.end = (np.tile(mesh.vertices, (num_ways * LEGS, 1, 1)) for _ in range(2))
        self.elite, self.deviation = np.zeros((1, LEGS - 1, 2)), SPREAD

    def ways(self) -> NDArray[np.float64]:
        """The next generation, shape [ways, legs + 1, 3]: the best of the last one, and others around their mean."""
        ways = np.linspace(START, GOAL, LEGS + 1) + np.zeros((self.num_ways, 1, 1))
        noise = self.random.normal(size=(self.num_ways, LEGS - 1, 2))
        ways[:, 1:-1, 1:] = self.elite.mean(axis=0) + self.deviation * noise
        ways[: len(self.elite), 1:-1, 1:] = self.elite
        return ways

    def free(self, ways: NDArray[np.float64]) -> NDArray[np.float64]:
        """The part of each leg that is certain to be free, shape [ways, legs]."""
        self.start[:, 0], self.end[:, 0] = ways[:, :-1].reshape(-1, 3), ways[:, 1:].reshape(-1, 3)
        end = self.end if self.with_ccd else self.start  # without CCD the ball is tested where it stands
        toi = self.worlds.mesh_ccd(self.start, end).world_toi
        return np.minimum(toi, 1.0).reshape(-1, LEGS)

    def generation(self) -> tuple[NDArray[np.float64], float, int]:
        """Try a generation, and learn from it: its best way, what that costs, and how many ways are free."""
        ways = self.ways()
        free = self.free(ways)
        cost = np.linalg.norm(np.diff(ways, axis=1), axis=2).sum(axis=1) + FINE * (1.0 - free).sum(axis=1)
        best = np.argsort(cost)[: max(int(ELITE * self.num_ways), 2)]
        self.elite = ways[best, 1:-1, 1:]
        self.deviation = self.elite.std(axis=0) + LEAST_SPREAD
        return ways[best[0]], float(cost[best[0]]), int((free == 1.0).all(axis=1).sum())


def draw(pyvista, plotter, way: NDArray[np.float64]) -> None:
    """Add the walls and a way, with the ball on it."""
    for x, window in WINDOWS.items():
        surface = pyvista.PolyData.from_regular_faces(*wall(x, window))
        plotter.add_mesh(surface, color="#c9a66b", lighting=False, opacity=0.7)
    plotter.add_mesh(pyvista.lines_from_points(way), color="#3b6ea5", line_width=3)
    for t in np.linspace(0.0, LEGS, 4 * LEGS + 1):
        place = [np.interp(t, range(LEGS + 1), values) for values in way.T]
        plotter.add_mesh(pyvista.Sphere(radius=RADIUS, center=place), color="#d05050")


def main() -> None:
    """Search with CCD and without, print, and draw."""
    parser = argparse.ArgumentParser(description="A search in thousands of worlds, with CCD and without, in 10 s.")
    parser.add_argument("--generations", type=int, default=25, help="default 25")
    parser.add_argument("--ways", type=int, default=1000, help="ways in a generation, of six legs (default 1000)")
    parser.add_argument("--output", type=Path, help="folder for many_worlds.png (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    rows = [], []
    for row, with_ccd, title in zip(rows, (True, False), ("with CCD", "without CCD"), strict=True):
        search = Search(options.ways, with_ccd=with_ccd)
        for k in range(options.generations):
            way, cost, num_free = search.generation()
            if k in {0, 4, options.generations - 1}:
                print(
                    f"{title}, generation {k}: {num_free} ways of {options.ways} seem free, the best costs {cost:.2f}"
                )
                row.append((f"{title}, generation {k}: cost {cost:.2f}", way))
    if options.output:
        from key_frames import draw_rows

        camera = [(-1, -6, 3.4), (2.9, 0, -0.1), (0, 0, 1)]
        draw_rows(options.output / "many_worlds.png", rows, draw, camera, (460, 300))


if __name__ == "__main__":
    main()
