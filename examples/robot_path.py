"""A path for a robot's arm among shelves: edges of a roadmap, all certain to be free or with the time of their contact.

A planner scatters configurations of an arm of seven joints and joins each to its neighbours by straight lines in joint
space. Whether such an edge is free is what it spends its time on, with samples along the edge, between which a thin
shelf is missed. Here all edges are worlds of one mesh and one call:

1. `JointMotion` has the links exactly where the joints take them, on curves that are no arcs;
2. `mesh_ccd` gives each edge its toi, the fraction up to which it is certain to be free, `inf` where all of it is;
3. the shortest path over free edges takes the tool out of one bay of a shelf and into another.

    python examples/robot_path.py

takes 10 s on two cores, and longer with `--edges 3000`. With `--output robot` and `pip install -e '.[viz]'` it draws
robot/robot_path.png.
"""

import argparse
import heapq
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

import ccd_warp as ccd

# Lengths and radii of the links in metres; they roll about their own axis and pitch across it, in turn.
LENGTHS, RADII = (0.35, 0.3, 0.3, 0.25, 0.25, 0.12, 0.14), (0.08, 0.07, 0.07, 0.06, 0.06, 0.05, 0.03)
LIMITS = np.array([2.9, 1.9, 2.9, 2.3, 2.9, 2.2, 2.9])
NEIGHBOURS, KEPT = 8, 0.002  # neighbours of a configuration; what is left between surfaces at least
# Boards of two shelves, as sides and centres.
BOARDS = [((0.4, 1.2, 0.01), (0.9, 0.0, z)) for z in (0.05, 0.45, 0.85, 1.25)]
BOARDS += [((0.4, 0.01, 1.2), (0.9, y, 0.65)) for y in (-0.6, 0.0, 0.6)]
BOARDS += [((1.2, 0.4, 0.01), (0.0, 0.9, z)) for z in (0.2, 0.6, 1.0)]
# The tool in a lower bay on the right, and in a higher one on the left.
START, GOAL = np.array([-0.33, 0.93, 0, 1.8, 0, -1.16, 0]), np.array([0.33, 0.42, 0, 1.67, 0, -0.52, 0])


def arm() -> tuple[list[ccd.Joint], list[trimesh.Trimesh]]:
    """The joints, each of which carries the next link, and the links: capsules along z in their own frames."""
    names = ["base", *(f"link {k}" for k in range(len(LENGTHS)))]
    joints = []
    for k, height in enumerate((0.0, *LENGTHS[:-1])):
        axis = (0, 1, 0) if k % 2 else (0, 0, 1)
        joints.append(ccd.Joint(f"joint {k}", names[k], names[k + 1], "revolute", axis, (0, 0, height, 0, 0, 0, 1)))
    links = [trimesh.creation.capsule(length, r, count=[10, 8]) for length, r in zip(LENGTHS, RADII, strict=True)]
    return joints, links


class Roadmap:
    """Configurations, and edges between each of them and its neighbours."""

    def __init__(self, num_edges: int, seed: int = 0) -> None:
        self.joints, links = arm()
        boards = [trimesh.creation.box(sides).apply_translation(centre) for sides, centre in BOARDS]
        self.num_links, count = len(links), len(links) + len(boards)
        overlap = [(k, k + 1) for k in range(self.num_links - 1)]  # links that a joint joins
        self.mesh = ccd.CollisionMesh.from_trimesh(
            [*links, *boards],
            rigid=range(self.num_links),
            static=range(self.num_links, count),
            exclude_pairs={"bodies": overlap},
        )
        random = np.random.default_rng(seed)
        # half of the configurations anywhere, half around the straight line that is not free
        num_nodes = max(num_edges // 4, 4)
        self.nodes = random.uniform(-LIMITS, LIMITS, (num_nodes, len(LIMITS)))
        near = START + random.uniform(0, 1, (num_nodes, 1)) * (GOAL - START)
        self.nodes[::2] = (near + random.normal(scale=0.5, size=near.shape))[::2].clip(-LIMITS, LIMITS)
        self.nodes[:2] = START, GOAL
        self.nodes = self.nodes[~self.touches(self.motion(self.nodes, self.nodes), 0.0)]
        self.edges = self.nearest(num_edges)

    def nearest(self, count: int) -> NDArray[np.intp]:
        """The shortest pairs of configurations among each and its neighbours, shape [count, 2]."""
        apart = np.linalg.norm(self.nodes[:, None] - self.nodes, axis=2)
        others = np.argsort(apart, axis=1)[:, 1 : NEIGHBOURS + 1]
        pairs = np.stack([np.repeat(np.arange(len(others)), others.shape[1]), others.ravel()], axis=1)
        pairs = np.unique(np.sort(pairs, axis=1), axis=0)
        return pairs[np.argsort(apart[pairs[:, 0], pairs[:, 1]])][:count]

    def motion(self, q0: NDArray[np.float64], q1: NDArray[np.float64]) -> ccd.JointMotion:
        """The motion along edges, each a world of its own."""
        return ccd.JointMotion(self.joints, q0, q1, links=[joint.child for joint in self.joints])

    def positions(self, motion: ccd.JointMotion, t: float) -> NDArray[np.float64]:
        """Where all vertices are at a time, shape [edges, V, 3]."""
        at = np.tile(self.mesh.vertices, (motion.num_worlds, 1, 1))
        for k in range(self.num_links):
            own, pose = self.mesh.vertex_body == k, motion.at(t)[:, k, None]
            twice = 2.0 * np.cross(pose[..., 3:6], at[:, own])
            at[:, own] += pose[..., 6:] * twice + np.cross(pose[..., 3:6], twice) + pose[..., :3]
        return at

    def touches(self, motion: ccd.JointMotion, t: float) -> NDArray[np.bool_]:
        """Whether anything intersects at a time, for each edge."""
        found = np.zeros(motion.num_worlds, dtype=bool)
        worlds = self.mesh.replicate(motion.num_worlds)
        found[ccd.find_intersections(worlds, self.positions(motion, t)).world] = True
        return found

    def check(self) -> NDArray[np.float64]:
        """The toi of every edge, inf where it is certain to be free and something is left between surfaces."""
        motion, vertices = self.motion(*self.nodes[self.edges.T]), self.mesh.vertices
        return ccd.mesh_ccd(self.mesh, vertices, vertices, motion=motion, minimum_distance=KEPT).world_toi

    def path(self, is_free: NDArray[np.bool_]) -> list[int]:
        """The shortest path from the first configuration to the second over free edges (Dijkstra); empty if none."""
        links: dict[int, list[tuple[int, float]]] = {}
        for a, b in self.edges[is_free].tolist():
            length = float(np.linalg.norm(self.nodes[a] - self.nodes[b]))
            links.setdefault(a, []).append((b, length))
            links.setdefault(b, []).append((a, length))
        queue, reached = [(0.0, [0])], set()
        while queue:
            length, path = heapq.heappop(queue)
            if path[-1] == 1:
                return path
            if path[-1] not in reached:
                reached.add(path[-1])
                for node, more in links.get(path[-1], []):
                    heapq.heappush(queue, (length + more, [*path, node]))
        return []


def draw(file: Path, roadmap: Roadmap, path: list[int]) -> None:
    """The shelves, the arm at the configurations of the path and between them, and the way of its tip."""
    from ccd_warp.viz import drawing_without_display

    motion = roadmap.motion(roadmap.nodes[path[:-1]], roadmap.nodes[path[1:]])
    with drawing_without_display() as pyvista:
        plotter = pyvista.Plotter(off_screen=True, window_size=(1100, 800))
        body = roadmap.mesh.face_body
        for t, color, opacity in ((0.0, "#3b6ea5", 1.0), (0.5, "#a9c4e0", 0.35), (1.0, "#3b6ea5", 1.0)):
            for at in roadmap.positions(motion, t):
                moving = pyvista.PolyData.from_regular_faces(at, roadmap.mesh.faces[body < roadmap.num_links])
                plotter.add_mesh(moving, color=color, opacity=opacity, smooth_shading=True)
        boards = roadmap.mesh.faces[body >= roadmap.num_links]
        plotter.add_mesh(
            pyvista.PolyData.from_regular_faces(roadmap.mesh.vertices, boards), color="#c9a66b", opacity=0.6
        )
        of_tool = roadmap.mesh.vertex_body == roadmap.num_links - 1
        tip = np.stack([roadmap.positions(motion, t)[:, of_tool].mean(axis=1) for t in np.linspace(0, 1, 20)], axis=1)
        plotter.add_mesh(pyvista.lines_from_points(tip.reshape(-1, 3)), color="#b03030", line_width=5)
        plotter.camera_position = [(-1.0, -3.0, 2.2), (0.35, 0.05, 0.6), (0.0, 0.0, 1.0)]
        plotter.background_color = "white"
        plotter.screenshot(file)
        plotter.close()


def main() -> None:
    """Check the edges of a roadmap, find a path, print, and draw."""
    parser = argparse.ArgumentParser(
        description="A path for an arm among shelves, over edges certain to be free, in 10 s."
    )
    parser.add_argument("--edges", type=int, default=600, help="default 600")
    parser.add_argument("--seed", type=int, default=0, help="default 0")
    parser.add_argument("--output", type=Path, help="folder of the picture (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    roadmap = Roadmap(options.edges, options.seed)
    begin = time.perf_counter()
    toi = roadmap.check()
    seconds = time.perf_counter() - begin
    is_free = toi == np.inf
    print(f"{len(roadmap.nodes)} configurations, {len(toi)} edges, {1e3 * seconds / len(toi):.1f} ms an edge")
    print(f"{is_free.sum()} edges are free; the others go on to {np.median(toi[~is_free]):.2f} of their way (median)")
    path = roadmap.path(is_free)
    length = np.linalg.norm(np.diff(roadmap.nodes[path], axis=0), axis=1).sum()
    print(
        f"the path has {len(path) - 1} edges, {length:.1f} rad long" if path else "no path; more --edges may have one"
    )
    if options.output is not None and path:
        options.output.mkdir(parents=True, exist_ok=True)
        draw(options.output / "robot_path.png", roadmap, path)


if __name__ == "__main__":
    main()
