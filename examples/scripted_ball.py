"""A ball that moves as it is told, through cloth that falls on it and on a floor, and neither crosses nor stands still.

Nobody can stop the ball: its body is `kinematic`, and a line search that cannot take the cloth out of its way reports
what is `struck`. Every frame a few lines of position-based dynamics find where the cloth would like to be, keeping the
two sides of what `find_proximity` has found apart by a plane across the gap. Then

1. `line_search` moves each vertex there as far as is certain to be free;
2. where something is struck, or stopped, its contacts are planes that the response has missed, and so are those that
   have shortened the motion of others (`shortened_by`: a vertex in the way of the ball is often kept there by another
   layer): with their normals and weights they are added to those of the response, which goes on from where it ended,
   this time without springs, as these may be what keeps the cloth in the way;
3. where that does not help in some rounds, the script waits: the ball alone goes a part of its way, or none, in this
   frame. The response keeps all of its push, so that the cloth is out of the way in the next.

The lower row is the same scene where the whole step is cut in place of 2 and 3, and the response with it: the gap stays
what it was, so the next frame is struck as well, and all stands still.

    pip install -e '.[viz]' && python examples/scripted_ball.py --output ball

takes a minute on two cores and draws ball/scripted_ball.png. It prints

    moved by its contacts: 300 frames, 0 with intersections, 0 stand still;
      the ball went 100.0% of its way, least distance 1.000000 of both radii
    whole steps cut: 300 frames, 0 with intersections, 26 stand still;
      the ball went 91.1% of its way, least distance 1.000000 of both radii
"""

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

import ccd_warp as ccd

# Lengths in metres, times in seconds.
FRAME_TIME = 1.0 / 150.0
GRAVITY = np.array([0.0, 0.0, -9.81])
SIDE, BALL_RADIUS = 1.0, 0.22
CLOTH, BALL, FLOOR = range(3)
RADIUS = np.array([6e-3, 4e-3, 0.0])  # of each body: a pair keeps the sum of two
# The response aims at a little more than the search demands; pairs within a reach beyond the radii have planes.
AIM, REACH = 1.15, 8e-3
ITERATIONS, ROUNDS, DAMPING, DRAG = 20, 4, 0.005, 0.1
BEND = 3e-4 / FRAME_TIME**2  # compliance of springs that leave out a vertex, over the frame time squared
UP = np.array([0.08, -0.05, 1.0])  # of the floor, which passes through the origin
MAX_ROUNDS = 64  # of a search: all of a world stops where they do not suffice
STILL = 0.05, 1e-3  # of its way in a frame, and the speed of the cloth: less is none
KEY_FRAMES = (30, 80, 150)


def script(time: float) -> NDArray[np.float64]:
    """Where the ball is at a time, as it is told."""
    return np.array([0.18 * np.sin(1.7 * time), 0.15 * np.cos(1.3 * time) - 0.15, 0.28 + 0.1 * np.sin(2.1 * time)])


def cloth(resolution: int) -> tuple[trimesh.Trimesh, NDArray[np.int64]]:
    """A square sheet in general position, and its springs: edges, and pairs of vertices with one between them."""
    grid = np.arange(resolution**2).reshape(resolution, resolution)
    x, y = SIDE * (np.mgrid[:resolution, :resolution].reshape(2, -1) / (resolution - 1) - 0.5)
    a, b, c, d = (part.ravel() for part in (grid[:-1, :-1], grid[1:, :-1], grid[:-1, 1:], grid[1:, 1:]))
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([c, b, d])])
    pairs = [(grid[:, :-2], grid[:, 2:]), (grid[:-2], grid[2:])]
    bends = np.vstack([np.column_stack([one.ravel(), other.ravel()]) for one, other in pairs])
    sheet = trimesh.Trimesh(np.column_stack([x, y, 0.01 * np.sin(7 * x + 3 * y)]), faces, process=False)
    sheet.apply_transform(trimesh.transformations.euler_matrix(0.31, -0.23, 0.7))
    sheet.apply_translation([0.03, -0.02, 0.62])
    return sheet, np.vstack([sheet.edges_unique, bends])


class ScriptedBall:
    """The simulation. Positions are those of all vertices, the cloth's first."""

    def __init__(self, resolution: int = 17, *, cuts: bool = False) -> None:
        self.cuts = cuts
        sheet, self.springs = cloth(resolution)
        bodies = [sheet, trimesh.creation.icosphere(3, BALL_RADIUS), ccd.HalfSpace(point=[0, 0, 0], normal=UP)]
        self.mesh = ccd.CollisionMesh.from_trimesh(bodies, kinematic=[BALL], radius=RADIUS)
        self.pipeline = ccd.CollisionPipeline(self.mesh)
        self.moves, self.is_ball = (self.mesh.vertex_body == body for body in (CLOTH, BALL))
        self.positions = self.mesh.vertices + self.is_ball[:, None] * script(0.0)
        self.velocity = np.zeros_like(self.positions)
        self.rest_length = np.linalg.norm(np.subtract(*self.positions[self.springs.T]), axis=1)
        self.compliance = np.where(np.arange(len(self.springs)) < len(sheet.edges_unique), 0.0, BEND)
        self.time = 0.0  # of the script

    def advance(self) -> float:
        """One frame; returns the part of its way that the ball has gone."""
        start, planes = self.positions, [self.pipeline.find_proximity(self.positions, REACH, unique=True)]
        way = script(self.time + FRAME_TIME) - script(self.time)
        free = start + self.moves[:, None] * FRAME_TIME * (self.velocity + FRAME_TIME * GRAVITY)
        wish, part, count = self.solve(free + self.is_ball[:, None] * way, planes), 1.0, 0
        found = self.pipeline.line_search(start, wish, per="vertex", max_rounds=MAX_ROUNDS)
        while len(found.struck):
            count += 1
            if self.cuts:
                cut = 0.9 * found.struck.toi.min()
                wish, part = start + cut * (wish - start), cut * part
            else:
                planes += [found.struck, found.touching, found.shortened_by]
                if count >= ROUNDS:
                    part = 0.5 * part if count < 2 * ROUNDS else 0.0
                wish[self.is_ball] = start[self.is_ball] + part * way
                wish = self.solve(wish, planes, pulls=False)
            found = self.pipeline.line_search(start, wish, per="vertex", max_rounds=MAX_ROUNDS)
        self.velocity = (1.0 - DAMPING) * (found.vertices - start) / FRAME_TIME
        rubs = planes[0].vertices[(planes[0].bodies != CLOTH).any(axis=1)]
        self.velocity[rubs[self.moves[rubs]]] *= 1.0 - DRAG  # once a vertex
        self.positions, self.time = found.vertices, self.time + part * FRAME_TIME
        return part

    def solve(self, wish: NDArray[np.float64], planes: list, *, pulls: bool = True) -> NDArray[np.float64]:
        """Where springs keep their lengths, and planes both sides apart: the mean of all corrections, repeatedly.

        Planes have the last word, without springs, where something is struck: these may be what keeps it in the way.
        """
        normals = [each.direction if isinstance(each, ccd.Proximities) else each.normal for each in planes]
        vertices, weights, bodies = (
            np.concatenate([getattr(each, name) for each in planes]) for name in ("vertices", "weights", "bodies")
        )
        normal, aim = np.concatenate(normals), AIM * RADIUS[bodies].sum(axis=1)
        mobility, (i, j) = (weights**2 * self.moves[vertices]).sum(axis=1), self.springs.T
        for _ in range(ITERATIONS):
            change, count = np.zeros_like(wish), np.full(len(wish), 1e-12)
            if pulls:
                way = wish[i] - wish[j]
                length = np.linalg.norm(way, axis=1)
                pull = ((self.rest_length - length) / (2.0 + self.compliance) / length)[:, None] * way
                np.add.at(change, self.springs, np.stack([pull, -pull], axis=1))
                np.add.at(count, self.springs, 1.0)
            gap = np.einsum("mk,mkx,mx->m", weights, wish[vertices], normal)  # of a vertex to the floor, too
            acts = (gap < aim) & (mobility > 0.0)
            push = ((aim - gap)[acts] / mobility[acts])[:, None, None] * normal[acts][:, None]
            np.add.at(change, vertices[acts], weights[acts][..., None] * push)
            np.add.at(count, vertices[acts], weights[acts] != 0.0)
            wish = wish + self.moves[:, None] * change / count[:, None]
        return wish

    def clearance(self) -> float:
        """The least distance of a pair as a share of its radii; infinite beyond a reach."""
        near = self.pipeline.find_proximity(self.positions, REACH)
        return (near.distance / RADIUS[near.bodies].sum(axis=1)).min(initial=np.inf)


def draw(pyvista, plotter, state: tuple[ScriptedBall, NDArray[np.float64]]) -> None:
    """Add the cloth, the ball and the floor."""
    scene, positions = state
    for body, style in ((CLOTH, {"color": "#f0a04b", "backface_params": {"color": "#5b9bd5"}}), (BALL, {})):
        surface = pyvista.PolyData.from_regular_faces(positions, scene.mesh.faces[scene.mesh.face_body == body])
        plotter.add_mesh(surface, smooth_shading=True, ambient=0.15, **{"color": "#b8b8b8"} | style)
    plotter.add_mesh(pyvista.Plane(center=(0, 0, 0), direction=UP, i_size=1.6, j_size=1.6), color="#dddddd")


def main() -> None:
    """Run in both ways, count the frames that cross or stand still, print, and draw."""
    parser = argparse.ArgumentParser(description="A ball that moves as it is told, through cloth, in a minute.")
    parser.add_argument("--frames", type=int, default=300, help="default 300")
    parser.add_argument("--resolution", type=int, default=17, help="vertices along a side of the cloth (default 17)")
    parser.add_argument("--output", type=Path, help="folder for scripted_ball.png (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    rows = [], []
    for row, cuts, title in zip(rows, (False, True), ("moved by its contacts", "whole steps cut"), strict=True):
        scene, parts = ScriptedBall(options.resolution, cuts=cuts), []
        num_still, num_crossing, least = 0, 0, np.inf
        for frame in range(options.frames):
            parts.append(scene.advance())
            speed = np.linalg.norm(scene.velocity[scene.moves], axis=1).max()
            num_still += parts[-1] < STILL[0] or speed < STILL[1]
            num_crossing += len(scene.pipeline.find_intersections(scene.positions)) > 0
            least = min(least, scene.clearance())
            if frame in {*KEY_FRAMES, options.frames - 1}:
                row.append((f"{title}, frame {frame}", (scene, scene.positions)))
        print(f"{title}: {options.frames} frames, {num_crossing} with intersections, {num_still} stand still;")
        print(f"  the ball went {np.mean(parts):.1%} of its way, least distance {least:.6f} of both radii")
    if options.output:
        from key_frames import draw_rows

        draw_rows(options.output / "scripted_ball.png", rows, draw, [(1.3, -1.5, 1.2), (0, 0, 0.2), (0, 0, 1)])


if __name__ == "__main__":
    main()
