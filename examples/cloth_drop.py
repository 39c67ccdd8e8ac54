"""A cloth falls on a ball in a glass globe that is kicked about, and gets through neither, nor through itself.

The obstacle, a ball and the thin globe around it, moves by several edge lengths of the cloth in a frame, and nothing
can stop it. Extended position-based dynamics (XPBD) moves the cloth, in NumPy, with one large step for each frame. A
test at one instant finds them already past each other: without CCD the cloth is soon outside the globe.

Each frame is solved in the frame of reference of the obstacle, where the obstacle is stationary and straight paths stay
straight. `mesh_ccd` computes the contacts on the path to the desired end. From the start, a round

1. finds by `find_proximity` what is near, and keeps the two sides of each pair, and of each contact, apart by a plane,
2. lets XPBD find an end that obeys springs and planes,
3. moves each vertex towards it as far as `line_search` allows, which is certain to be free,

and the next round continues from there. Motion that the rounds do not complete is lost, as in an inelastic impact. The
cloth has a thickness, twice the `radius` of its vertices, and no path enters it; planes aim at a larger gap.

    pip install -e '.[viz]' && python examples/cloth_drop.py --output drop

takes 40 s on two cores, with the same scene without CCD, and draws drop/cloth_drop.png.
"""

import argparse
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

import ccd_warp as ccd

# Lengths in metres, times in seconds.
FRAME_TIME, GRAVITY = 1.0 / 60.0, np.array([0.0, 0.0, -9.81])
CLOTH_SIDE, CLOTH_HEIGHT, CLOTH_ANGLE = 0.9, 0.12, 0.3
GLOBE_RADIUS, BALL_RADIUS, BALL_HEIGHT = 0.75, 0.22, -0.25
# The obstacle moves to another place within some frames, in which it slows down, and stands still before the next.
KICKS = 0.45 * np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0], [0, 0, -1], [-1, 0, 0], [0, 0, 1], [0, -1, 0], [0, 0, -1]])
FIRST_KICK, FRAMES_BETWEEN_KICKS, FRAMES_OF_KICK = 4, 36, 12
ROUNDS, ITERATIONS = 2, 64
FRICTION, AIR_DRAG = 0.3, 3.0
# Springs: steps along both sides of the grid, and the compliance, of unit masses, over the frame time squared.
SPRINGS = ((0, 1, 0.0), (1, 0, 0.0), (1, 1, 0.5), (1, -1, 0.5), (0, 2, 5.0), (2, 0, 5.0))
# In edge lengths: half the thickness of the cloth, and the gaps that planes aim at, and within which a pair has one.
RADIUS, MARGIN, REACH = 0.02, 0.16, 0.32
BALL_SUBDIVISIONS, GLOBE_SUBDIVISIONS = 3, 4
KEY_FRAMES = (3, 8, 40)


def cloth_grid(resolution: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of a square that is not quite flat, so that it folds as it likes."""
    x, y = CLOTH_SIDE * (np.mgrid[:resolution, :resolution].reshape(2, -1) / (resolution - 1) - 0.5)
    height = CLOTH_HEIGHT + 0.004 * np.sin(9.0 * x + 1.0) * np.cos(7.0 * y)
    cos, sin = np.cos(CLOTH_ANGLE), np.sin(CLOTH_ANGLE)
    a = np.arange(resolution**2).reshape(resolution, -1)[:-1, :-1].reshape(-1, 1)
    faces = np.vstack([a + [0, resolution, 1], a + [1, resolution, resolution + 1]])
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, height]), faces


def cloth_springs(grid: NDArray) -> Iterator[tuple[NDArray, NDArray, float]]:
    """Both ends of springs, as views of a grid, in groups that share no vertex, and their compliance."""
    n = len(grid)
    for di, dj, compliance in SPRINGS:
        one, other = grid[: n - di, max(-dj, 0) : n - max(dj, 0)], grid[di:, max(dj, 0) : n + min(dj, 0)]
        stride = 2 * max(di, dj)
        for first in range(stride):
            group = np.s_[first::stride] if di else np.s_[:, first::stride]
            yield one[group], other[group], compliance


def obstacle_mesh() -> trimesh.Trimesh:
    """A ball and the globe around it, which move together."""
    ball = trimesh.creation.icosphere(subdivisions=BALL_SUBDIVISIONS, radius=BALL_RADIUS)
    ball.apply_translation([0.0, 0.0, BALL_HEIGHT])
    globe = trimesh.creation.icosphere(subdivisions=GLOBE_SUBDIVISIONS, radius=GLOBE_RADIUS)
    return trimesh.util.concatenate([ball, globe])


def obstacle_offset(frame: int) -> NDArray[np.float64]:
    """Position of the obstacle."""
    s = np.clip((frame - FIRST_KICK - FRAMES_BETWEEN_KICKS * np.arange(len(KICKS))) / FRAMES_OF_KICK, 0.0, 1.0)
    return (s * (2.0 - s)) @ KICKS


class ClothDrop:
    """The simulation. Positions are those of all vertices, the cloth's first, relative to the obstacle."""

    def __init__(self, resolution: int, *, with_ccd: bool = True) -> None:
        vertices, faces = cloth_grid(resolution)
        obstacle = obstacle_mesh()
        self.with_ccd, self.resolution, self.num_cloth = with_ccd, resolution, len(vertices)
        self.edge_length = CLOTH_SIDE / (resolution - 1)
        bodies = [(vertices, faces), (obstacle.vertices, obstacle.faces)]
        self.mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1], radius=[RADIUS * self.edge_length, 0.0])
        self.positions = self.mesh.vertices.copy()
        self.velocity = np.zeros_like(vertices)  # in the world
        self.pipeline = ccd.CollisionPipeline(self.mesh)
        grid = vertices.reshape(resolution, resolution, 3)
        self.rest = [np.linalg.norm(one - other, axis=2, keepdims=True) for one, other, _ in cloth_springs(grid)]

    def advance(self, obstacle_step: NDArray[np.float64]) -> None:
        """One frame, in which the obstacle moves by a step."""
        start, cloth, met = self.positions, slice(self.num_cloth), None
        wish = start.copy()
        wish[cloth] += FRAME_TIME * (self.velocity + FRAME_TIME * GRAVITY) - obstacle_step
        if self.with_ccd:
            met = self.pipeline.mesh_ccd(start, wish).contacts
        reached = start
        for _ in range(ROUNDS):
            # without CCD only what is near at the end is known
            near = self.pipeline.find_proximity(reached if self.with_ccd else wish, REACH * self.edge_length)
            sides = [(near.vertices, near.weights, near.direction)]
            sides += [(met.vertices, met.weights, met.normal)] if met is not None else []
            wish = self.solve(start, wish, *(np.concatenate(arrays) for arrays in zip(*sides, strict=True)))
            reached = self.pipeline.line_search(reached, wish, per="vertex").vertices if self.with_ccd else wish
        self.positions = reached
        # the air moves with the globe
        self.velocity = ((1.0 - AIR_DRAG * FRAME_TIME) * (reached[cloth] - start[cloth]) + obstacle_step) / FRAME_TIME

    def solve(
        self, start: NDArray, wish: NDArray, corners: NDArray, weights: NDArray, normals: NDArray
    ) -> NDArray[np.float64]:
        """Solve springs and planes, normal · Σ weight · corner >= distance, in turn, from the end of the last round."""
        x = wish.copy()
        grid = x[: self.num_cloth].reshape(self.resolution, self.resolution, 3)  # the same memory
        springs = [(*spring, rest, 0.0 * rest) for spring, rest in zip(cloth_springs(grid), self.rest, strict=True)]
        moves = weights * (corners < self.num_cloth)
        mobility = np.maximum((moves**2).sum(axis=1), 1e-12)
        distance = MARGIN * self.edge_length + self.mesh.radius[corners[:, [0, 3]]].sum(axis=1)
        for _ in range(ITERATIONS):
            for one, other, compliance, rest, multiplier in springs:
                way = one - other
                length = np.sqrt((way * way).sum(axis=2, keepdims=True))
                change = (rest - length - compliance * multiplier) / (2.0 + compliance)
                multiplier += change
                way *= change / length
                one += way
                other -= way
            depth = distance - np.einsum("ck,ckx,cx->c", weights, x[corners], normals)
            acts = depth > 0.0
            depth, normal, rows = depth[acts, None], normals[acts], corners[acts]
            slide = np.einsum("ck,ckx->cx", weights[acts], x[rows] - start[rows])
            slide -= (slide * normal).sum(axis=1, keepdims=True) * normal
            damping = FRICTION * depth / np.maximum(np.linalg.norm(slide, axis=1, keepdims=True), 1e-12)
            change = (depth * normal - np.minimum(damping, 1.0) * slide) / mobility[acts, None]
            push, rows = (moves[acts][..., None] * change[:, None]).reshape(-1, 3), rows.ravel()
            count = np.maximum(np.bincount(rows, minlength=len(x)), 1.0)
            x += np.column_stack([np.bincount(rows, part, len(x)) / count for part in push.T])
        return x

    def frames(self, num_frames: int) -> Iterator[NDArray[np.float64]]:
        """Positions in the world after each frame, shape [V, 3]."""
        for frame in range(num_frames):
            before, after = obstacle_offset(frame), obstacle_offset(frame + 1)
            self.advance(after - before)
            yield self.positions + after


def draw(pyvista, plotter, state: tuple[ClothDrop, NDArray[np.float64]]) -> None:
    """Add the cloth, the ball and the globe."""
    scene, vertices = state
    split = np.cumsum([(scene.mesh.face_body == 0).sum(), 20 * 4**BALL_SUBDIVISIONS])
    styles = [{"color": "#f0a04b", "ambient": 0.15, "backface_params": {"color": "#5b9bd5"}}]
    styles += [{"color": "#b8b8b8"}, {"color": "#8fb8d0", "opacity": 0.13}]
    for faces, style in zip(np.split(scene.mesh.faces, split), styles, strict=True):
        used, local = np.unique(faces, return_inverse=True)
        surface = pyvista.PolyData.from_regular_faces(vertices[used], local.reshape(-1, 3))
        plotter.add_mesh(surface, smooth_shading=True, **style)


def main() -> None:
    """Run with CCD and without, count what intersects, print, and draw."""
    parser = argparse.ArgumentParser(
        description="A cloth in a globe that is kicked about, with CCD and without, in 40 s."
    )
    parser.add_argument("--frames", type=int, default=60, help="default 60")
    parser.add_argument("--resolution", type=int, default=41, help="vertices along a side of the cloth (default 41)")
    parser.add_argument("--output", type=Path, help="folder for cloth_drop.png (none is drawn without)")
    options = parser.parse_args()
    if options.output and find_spec("pyvista") is None:
        parser.error("--output needs pyvista; install it with: pip install 'ccd-warp[viz]'")
    rows = [], []
    for with_ccd, title in ((True, "with CCD"), (False, "without CCD")):
        scene, num_bad = ClothDrop(options.resolution, with_ccd=with_ccd), 0
        for frame, _ in enumerate(scene.frames(options.frames)):
            count = len(scene.pipeline.find_intersections(scene.positions))
            num_bad += count > 0
            if frame in {*KEY_FRAMES, options.frames - 1}:
                rows[not with_ccd].append((f"{title}, frame {frame}: {count} intersections", (scene, scene.positions)))
        outside = np.linalg.norm(scene.positions[: scene.num_cloth], axis=1) > GLOBE_RADIUS
        print(f"{title}: {num_bad} of {options.frames} frames with intersections,", end=" ")
        print(f"{outside.mean():.0%} of {scene.num_cloth} vertices outside the globe in the end")
    if options.output:
        from key_frames import draw_rows

        draw_rows(options.output / "cloth_drop.png", rows, draw, [(1.27, -2.75, 1.16), (0, 0, 0), (0, 0, 1)])


if __name__ == "__main__":
    main()
