"""A path for a robot's arm among shelves: edges of a roadmap, each certain to be free or open from a time on.

A planner scatters configurations of an arm of seven joints and joins each to its neighbours by straight lines in joint
space. Whether such an edge is free is what it spends its time on, with samples along the edge, between which a thin
shelf is missed. The links move on no arcs, but in a short window of an edge they are near a screw:

1. a bound on the accelerations of the links says how near, and `RigidMotion` takes that as `within`;
2. a window of each edge is a world of one mesh, one call of `mesh_ccd` for all edges, and is halved where it is open;
3. the shortest path over free edges takes the tool out of one bay of a shelf and into another.

    python examples/robot_path.py

takes half a minute on two cores. With `--output robot` and `pip install -e '.[viz]'` it draws robot/robot_path.png.
"""

import argparse
import heapq
import time
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

import ccd_warp as ccd

Array = NDArray[np.float64]
# Lengths and radii of the links in metres; they roll about their own axis and pitch across it, in turn.
LENGTHS, RADII = np.array([0.35, 0.3, 0.3, 0.25, 0.25, 0.12, 0.14]), (0.08, 0.07, 0.07, 0.06, 0.06, 0.05, 0.03)
LIMITS = np.array([2.9, 1.9, 2.9, 2.3, 2.9, 2.2, 2.9])
NEIGHBOURS, KEPT = 8, 0.002  # neighbours of a configuration; what is left between surfaces at least
SHORTEST, TURN = 2.0**-12, 0.25  # of windows, as a share of an edge; what joints turn by in one at most, summed up
# Boards of two shelves, as sides and centres.
BOARDS = [((0.4, 1.2, 0.01), (0.9, 0.0, z)) for z in (0.05, 0.45, 0.85, 1.25)]
BOARDS += [((0.4, 0.01, 1.2), (0.9, y, 0.65)) for y in (-0.6, 0.0, 0.6)]
BOARDS += [((1.2, 0.4, 0.01), (0.0, 0.9, z)) for z in (0.2, 0.6, 1.0)]
# The tool in a lower bay on the right, and in a higher one on the left.
START, GOAL = np.array([-0.33, 0.93, 0, 1.8, 0, -1.16, 0]), np.array([0.33, 0.42, 0, 1.67, 0, -0.52, 0])


def turned(q: Array, v: Array) -> Array:
    """Vectors turned by unit quaternions x y z w."""
    return v + 2.0 * np.cross(q[..., :3], q[..., 3:] * v + np.cross(q[..., :3], v))


def poses(q: Array) -> Array:
    """The poses of the links at configurations, shape [n, 7, 7]: link k turns at the end of the one before it."""
    found = np.zeros((len(q), len(LENGTHS), 7))
    place, v, w = np.zeros((len(q), 3)), np.zeros((len(q), 3)), np.ones((len(q), 1))
    for k, height in enumerate((0.0, *LENGTHS[:-1])):
        place = place + turned(np.hstack([v, w]), np.array([[0.0, 0.0, height]]))
        s, c, axis = np.sin(0.5 * q[:, [k]]), np.cos(0.5 * q[:, [k]]), np.eye(3)[2 - k % 2]
        v, w = c * v + s * (w * axis + np.cross(v, axis)), c * w - s * v @ axis[:, None]
        found[:, k] = np.hstack([place, v, w])
    return found


def off_screws(turns: Array) -> Array:
    """How far links are from screws between their poses at both ends of windows, in which joints turn so far, [n, 7].

    A point of a link and its place on the screw are the same at both ends, so in between they are no farther apart than
    an eighth of the sum of their largest accelerations. A link turns at a rate of at most the sum w of the joints', and
    that of a point at r from its origin is at most (w' + w²) r beyond the origin's. On a screw, by an angle θ <= w < 1,
    it is θ times the speed, which is at most (θ/2) / sin(θ/2) < 1.05 times the chord.
    """
    found, (rate, change, speed, bend) = np.zeros(turns.shape), np.zeros((4, len(turns)))
    reach = LENGTHS + RADII  # of a capsule that begins a radius before its origin
    for k, height in enumerate((0.0, *LENGTHS[:-1])):
        speed, bend = speed + rate * height, bend + (change + rate**2) * height
        change, rate = change + rate * np.abs(turns[:, k]), rate + np.abs(turns[:, k])
        accelerated = bend + (change + rate**2) * reach[k] + 1.05 * rate * (speed + rate * reach[k])
        found[:, k] = accelerated / 8.0 + 1e-12  # and the rounding of poses
    return found


class Roadmap:
    """Configurations, and edges between each of them and its neighbours."""

    def __init__(self, num_edges: int, seed: int = 0) -> None:
        links = [trimesh.creation.capsule(length, r, count=[10, 8]) for length, r in zip(LENGTHS, RADII, strict=True)]
        boards = [trimesh.creation.box(sides).apply_translation(centre) for sides, centre in BOARDS]
        self.num_links, count = len(links), len(links) + len(boards)
        overlap = {"bodies": [(k, k + 1) for k in range(self.num_links - 1)]}  # links that a joint joins
        moves = {"rigid": range(self.num_links), "static": range(self.num_links, count)}
        self.mesh = ccd.CollisionMesh.from_trimesh([*links, *boards], exclude_pairs=overlap, **moves)
        random = np.random.default_rng(seed)
        # half of the configurations anywhere, half around the straight line, which is not free
        self.nodes = random.uniform(-LIMITS, LIMITS, (max(num_edges // 4, 4), len(LIMITS)))
        near = START + random.uniform(0, 1, (len(self.nodes), 1)) * (GOAL - START)
        self.nodes[::2] = (near + random.normal(scale=0.5, size=near.shape))[::2].clip(-LIMITS, LIMITS)
        self.nodes[:2] = START, GOAL
        self.nodes = self.nodes[~self.touches(self.nodes[None])[0]]
        # the shortest pairs of configurations among each and its neighbours
        apart = np.linalg.norm(self.nodes[:, None] - self.nodes, axis=2)
        others = np.argsort(apart, axis=1)[:, 1 : NEIGHBOURS + 1]
        pairs = np.stack([np.repeat(np.arange(len(others)), others.shape[1]), others.ravel()], axis=1)
        pairs = np.unique(np.sort(pairs, axis=1), axis=0)
        self.edges = pairs[np.argsort(apart[tuple(pairs.T)])][:num_edges]

    def at(self, t: Array | float, some: NDArray[np.intp] | slice = slice(None)) -> Array:
        """The configurations at a time of each of some edges, or of all."""
        q0, q1 = self.nodes[self.edges[some].T]
        return q0 + np.reshape(t, (-1, 1)) * (q1 - q0)

    def positions(self, q: Array) -> Array:
        """Where all vertices are at configurations, shape [n, V, 3]."""
        at, own = np.tile(self.mesh.vertices, (len(q), 1, 1)), self.mesh.vertex_body < self.num_links
        pose = poses(q)[:, self.mesh.vertex_body[own]]
        at[:, own] = turned(pose[..., 3:], at[:, own]) + pose[..., :3]
        return at

    def touches(self, samples: Array) -> NDArray[np.bool_]:
        """Whether anything intersects at configurations, shape [k, n, 7]; n at a time."""
        found = np.zeros(samples.shape[:2], dtype=bool)
        pipeline = ccd.CollisionPipeline(self.mesh.replicate(samples.shape[1]))
        for row, q in zip(found, samples, strict=True):
            row[pipeline.find_intersections(self.positions(q)).world] = True
        return found

    def check(self) -> tuple[Array, int]:
        """Up to where each edge is certain to keep its distance, inf where all of it is; and the number of windows."""
        pipeline, x, windows = ccd.CollisionPipeline(self.mesh, minimum_distance=KEPT), self.mesh.vertices, 0
        longest = 1.0 / np.ceil(np.abs(self.at(1.0) - self.at(0.0)).sum(axis=1) / TURN)
        free, length = np.zeros(len(longest)), longest.copy()
        while len(some := np.flatnonzero((free < 1.0) & (length > SHORTEST))):
            begin, end = free[some], np.minimum(free[some] + length[some], 1.0)
            q0, q1 = self.at(begin, some), self.at(end, some)
            motion = ccd.RigidMotion(poses(q0), poses(q1), path="screw", within=off_screws(q1 - q0))
            toi = pipeline.mesh_ccd(x, x, motion=motion).world_toi
            is_free, windows = np.isinf(toi), windows + len(some)
            reached = np.nextafter(begin + np.where(is_free, 0.0, toi) * (end - begin), 0.0)
            free[some] = np.where(is_free, end, reached)  # rounded down
            length[some] = np.where(is_free, np.minimum(2.0 * length[some], longest[some]), 0.5 * length[some])
        return np.where(free < 1.0, free, np.inf), windows

    def num_missed(self, free: Array, num_samples: int) -> int:
        """How many edges intersect something at one of some samples before the time up to which they are free."""
        t = np.linspace(0, 1, num_samples)[:, None]
        return int((self.touches(np.stack([*map(self.at, t)])) & (t <= free)).any(axis=0).sum())

    def path(self, is_free: NDArray[np.bool_]) -> list[int]:
        """The shortest path from the first configuration to the second over free edges (Dijkstra); empty if none."""
        edges = np.concatenate([self.edges[is_free], self.edges[is_free, ::-1]])
        queue, reached = [(0.0, [0])], set()
        while queue:
            length, path = heapq.heappop(queue)
            if path[-1] == 1:
                return path
            if path[-1] not in reached:
                reached.add(path[-1])
                for node in edges[edges[:, 0] == path[-1], 1].tolist():
                    apart = np.linalg.norm(self.nodes[path[-1]] - self.nodes[node])
                    heapq.heappush(queue, (length + float(apart), [*path, node]))
        return []


def draw(file: Path, roadmap: Roadmap, path: list[int]) -> None:
    """The shelves, and the arm at the configurations of the path and between them."""
    from ccd_warp.viz import drawing_without_display

    nodes, mesh, is_board = roadmap.nodes[path], roadmap.mesh, roadmap.mesh.face_body >= roadmap.num_links
    with drawing_without_display() as pyvista:
        plotter = pyvista.Plotter(off_screen=True, window_size=(1100, 800))
        for q, color, opacity in ((nodes, "#3b6ea5", 1.0), (0.5 * nodes[:-1] + 0.5 * nodes[1:], "#a9c4e0", 0.35)):
            for at in roadmap.positions(q):
                links = pyvista.PolyData.from_regular_faces(at, mesh.faces[~is_board])
                plotter.add_mesh(links, color=color, opacity=opacity, smooth_shading=True)
        boards = pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.faces[is_board])
        plotter.add_mesh(boards, color="#c9a66b", opacity=0.6)
        plotter.camera_position = [(-1.0, -3.0, 2.2), (0.35, 0.05, 0.6), (0.0, 0.0, 1.0)]
        plotter.background_color = "white"
        plotter.screenshot(file)
        plotter.close()


def main() -> None:
    """Check the edges of a roadmap, compare them with samples, find a path, print, and draw."""
    parser = argparse.ArgumentParser(description="A path for an arm among shelves, over edges certain to be free.")
    parser.add_argument("--edges", type=int, default=300, help="default 300")
    parser.add_argument("--samples", type=int, default=50, help="of each edge to compare with, default 50")
    parser.add_argument("--seed", type=int, default=0, help="default 0")
    parser.add_argument("--output", type=Path, help="folder of the picture (none is drawn without)")
    options = parser.parse_args()
    roadmap, begin = Roadmap(options.edges, options.seed), time.perf_counter()
    free, windows = roadmap.check()
    seconds, count = time.perf_counter() - begin, len(free)
    is_free, per_edge = free == np.inf, f"{1e3 * seconds / count:.1f} ms and {windows / count:.1f} windows an edge"
    print(f"{len(roadmap.nodes)} configurations, {count} edges, {per_edge}")
    print(f"{is_free.sum()} edges are free; the others go on to {np.median(free[~is_free]):.2f} of their way (median)")
    missed, path = roadmap.num_missed(free, options.samples), roadmap.path(is_free)
    print(f"{missed} edges touch at one of {options.samples} samples of what is free")
    length = np.linalg.norm(np.diff(roadmap.nodes[path], axis=0), axis=1).sum()
    print(f"the path has {len(path) - 1} edges, {length:.1f} rad long" if path else "no path; take more --edges")
    if options.output and path:
        options.output.mkdir(parents=True, exist_ok=True)
        draw(options.output / "robot_path.png", roadmap, path)


if __name__ == "__main__":
    main()
