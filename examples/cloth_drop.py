"""A cloth falls on a ball in a glass globe that is kicked about, and on itself: 300 frames without one penetration.

The obstacle, a ball and the thin globe around it, moves rigidly, by many edge lengths of the cloth in a frame, and
nothing can stop it. Extended position-based dynamics (XPBD) moves the cloth, with one large step for each frame. A test
at one instant finds them already past each other: without CCD the cloth is soon outside the globe.

With CCD, each frame is solved in the frame of reference of the obstacle, where the obstacle is stationary and straight
paths stay straight. There, a cloth that does not move is carried along with the obstacle, which is always free of
collisions. `mesh_ccd` computes the contacts on the path to the desired end. From the start, a round

1. finds by `find_proximity` what is near, and keeps the two sides of each pair, and of each contact, apart by a plane
   across its gap,
2. lets XPBD find an end that obeys springs and planes,
3. moves each vertex towards it as far as `line_search` allows, which is certain to be free,

and the next round continues from there. Motion that the rounds do not complete is lost, like momentum in an inelastic
impact. Every accepted position is the end of a path that CCD has found free, and no path enters the thickness of the
cloth, twice the `radius` of its vertices, which is larger than the rounding of positions in the world. What comes to
rest at this distance can part and slide in the next search; planes aim at a larger one. Every frame is checked
independently: CGAL searches for intersecting faces by exact arithmetic.

Run it: python examples/cloth_drop.py --output drop
        python examples/cloth_drop.py --output drop_no_ccd --no-ccd

It needs: pip install 'ccd-warp[examples]'. It writes key frames as cloth_drop.png and all frames as frame_0000.ply …
(in single precision, for viewing), and prints, with CCD:

    10201 vertices, obstacle up to 8.0 edge lengths a frame
    300 frames, 0 with intersecting faces, at most 0 pairs of them
    0% of the cloth outside the globe at the end
    99 in 100 edges shorter than 1.304 of their rest length in the median frame, 1.673 in the worst; ...

and without:

    300 frames, 22 with intersecting faces, at most 756 pairs of them
    100% of the cloth outside the globe at the end
"""

import argparse
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
import trimesh
import warp as wp
from numpy.typing import NDArray

import ccd_warp as ccd
from ccd_warp.viz import drawing_without_display

wp.set_module_options({"enable_backward": False})

# Lengths in metres, times in seconds.
FRAME_TIME = 1.0 / 60.0
GRAVITY = np.array([0.0, 0.0, -9.81])
CLOTH_SIDE, CLOTH_HEIGHT, CLOTH_ANGLE = 0.9, 0.12, 0.3
GLOBE_RADIUS, BALL_RADIUS, BALL_HEIGHT = 0.75, 0.22, -0.25
# Again and again the obstacle stands still, and then moves to another place within a few frames.
KICKS = 0.45 * np.array(
    [[0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, -1], [-1, 0, 0], [0, 0, 1], [0, -1, 0], [0, 0, -1]], dtype=np.float64
)
FIRST_KICK, FRAMES_BETWEEN_KICKS, FRAMES_OF_KICK = 4, 48, 12
ROUNDS, ITERATIONS = 2, 64
FRICTION, AIR_DRAG = 0.3, 3.0
SHEAR_COMPLIANCE, BEND_COMPLIANCE = 0.5, 5.0  # of unit masses, over the frame time squared
# In edge lengths: half the thickness of the cloth, which any path keeps, and the gaps beyond it that planes aim at, and
# within which a pair has a plane.
RADIUS, MARGIN, REACH = 0.02, 0.16, 0.32
BALL_SUBDIVISIONS, GLOBE_SUBDIVISIONS = 3, 4
KEY_FRAMES = (3, 8, 18, 50, 57, 68, 112, 299)


@wp.kernel
def pull_springs(
    # in
    springs: wp.array[wp.vec2i],
    rest_length: wp.array[wp.float64],
    compliance: wp.float64,
    # in and out
    multiplier: wp.array[wp.float64],
    positions: wp.array[wp.vec3d],
):
    """One XPBD projection of springs that share no vertex."""
    k = wp.tid()
    i, j = springs[k][0], springs[k][1]
    way = positions[i] - positions[j]
    length = wp.length(way)
    if length > wp.float64(0.0):
        change = (rest_length[k] - length - compliance * multiplier[k]) / (wp.float64(2.0) + compliance)
        multiplier[k] = multiplier[k] + change
        positions[i] = positions[i] + way * (change / length)
        positions[j] = positions[j] - way * (change / length)


@wp.kernel
def push_contacts(
    # in
    corners: wp.array[wp.vec4i],
    weights: wp.array[wp.vec4d],
    normals: wp.array[wp.vec3d],
    distances: wp.array[wp.float64],
    friction: wp.float64,
    num_cloth: int,
    start: wp.array[wp.vec3d],
    positions: wp.array[wp.vec3d],
    # out
    push: wp.array[wp.vec3d],
    num_pushes: wp.array[wp.float64],
):
    """Add up the corrections of each contact for its vertices: the distance along its normal, and friction."""
    c = wp.tid()
    normal = normals[c]
    gap = wp.vec3d()
    slide = wp.vec3d()
    mobility = wp.float64(0.0)
    for k in range(4):
        i, w = corners[c][k], weights[c][k]
        gap += w * positions[i]
        slide += w * (positions[i] - start[i])
        if i < num_cloth:
            mobility += w * w
    depth = distances[c] - wp.dot(normal, gap)
    if depth > wp.float64(0.0) and mobility > wp.float64(0.0):
        slide -= wp.dot(normal, slide) * normal
        damping = wp.min(wp.float64(1.0), friction * depth / wp.max(wp.length(slide), wp.float64(1e-12)))
        change = (depth * normal - damping * slide) / mobility
        for k in range(4):
            i, w = corners[c][k], weights[c][k]
            if i < num_cloth:
                wp.atomic_add(push, i, w * change)
                wp.atomic_add(num_pushes, i, wp.float64(1.0))


@wp.kernel
def apply_pushes(
    # in and out
    push: wp.array[wp.vec3d],
    num_pushes: wp.array[wp.float64],
    positions: wp.array[wp.vec3d],
):
    """Move each vertex by the mean of the corrections of its contacts."""
    i = wp.tid()
    if num_pushes[i] > wp.float64(0.0):
        positions[i] = positions[i] + push[i] / num_pushes[i]
    push[i] = wp.vec3d()
    num_pushes[i] = wp.float64(0.0)


def cloth_grid(resolution: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices and faces of a square that is not quite flat, so that it folds as it likes."""
    i, j = np.divmod(np.arange(resolution**2), resolution)
    x, y = ((k / (resolution - 1) - 0.5) * CLOTH_SIDE for k in (i, j))
    height = CLOTH_HEIGHT + 0.004 * np.sin(9.0 * x + 1.0) * np.cos(7.0 * y)
    cos, sin = np.cos(CLOTH_ANGLE), np.sin(CLOTH_ANGLE)
    a = np.flatnonzero((i < resolution - 1) & (j < resolution - 1))
    b, c, d = a + resolution, a + 1, a + resolution + 1
    faces = np.vstack([np.column_stack([a, b, c]), np.column_stack([c, b, d])])
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, height]), faces.astype(np.int32)


def cloth_springs(resolution: int) -> list[tuple[NDArray[np.int64], float]]:
    """Springs along edges, across and over two edges, in groups that share no vertex, with their compliance."""
    index = np.arange(resolution**2).reshape(resolution, resolution)
    rows, columns = np.divmod(index, resolution)
    groups = []
    for di, dj, compliance in (
        (0, 1, 0.0), (1, 0, 0.0), (1, 1, SHEAR_COMPLIANCE), (1, -1, SHEAR_COMPLIANCE),
        (0, 2, BEND_COMPLIANCE), (2, 0, BEND_COMPLIANCE),
    ):  # fmt: skip
        from_columns = slice(max(-dj, 0), resolution - max(dj, 0))
        to_columns = slice(max(dj, 0), resolution + min(dj, 0))
        first, second = index[: resolution - di, from_columns], index[di:, to_columns]
        along, reach = (rows, di) if di else (columns, dj)
        for colour in (0, 1):
            chosen = along[: resolution - di, from_columns] // reach % 2 == colour
            groups.append((np.column_stack([first[chosen], second[chosen]]), compliance))
    return groups


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


class Planes(NamedTuple):
    """Pairs of primitives that stay on their sides: normal · Σ weight · corner >= distance."""

    pairs: NDArray[np.int32]  # kind and primitives, shape [m, 3]
    corners: NDArray[np.int32]  # vertices, shape [m, 4]
    weights: NDArray[np.float64]  # shape [m, 4]
    normals: NDArray[np.float64]  # shape [m, 3]

    @classmethod
    def between(cls, pairs: ccd.Contacts | ccd.Proximities, normals: NDArray[np.float64]) -> Self:
        """A plane across the gap of each pair."""
        keys = np.column_stack([pairs.kind, pairs.primitives])
        return cls(keys, pairs.vertices, pairs.weights, normals)

    def joined(self, earlier: Self | None) -> Self:
        """These planes and the earlier ones of other pairs."""
        if earlier is None:
            return self
        both = Planes(*(np.concatenate(values) for values in zip(self, earlier, strict=True)))
        kept = np.unique(both.pairs, axis=0, return_index=True)[1]
        return Planes(*(values[kept] for values in both))


class ClothDrop:
    """The simulation. Positions are those of all vertices, the cloth's first, relative to the obstacle."""

    def __init__(self, resolution: int, *, with_ccd: bool = True) -> None:
        vertices, faces = cloth_grid(resolution)
        obstacle = obstacle_mesh()
        self.with_ccd = with_ccd
        self.num_cloth = len(vertices)
        self.edge_length = CLOTH_SIDE / (resolution - 1)
        bodies = [(vertices, faces), (obstacle.vertices, obstacle.faces)]
        radius = [RADIUS * self.edge_length, 0.0]
        self.mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1], radius=radius)
        self.positions = self.mesh.vertices.copy()
        self.velocity = np.zeros_like(vertices)  # in the world
        self.margin, self.reach = MARGIN * self.edge_length, REACH * self.edge_length
        self.pipeline = ccd.CollisionPipeline(self.mesh)
        self.springs = []
        for pairs, compliance in cloth_springs(resolution):
            rest = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
            on_device = [wp.array(pairs, dtype=wp.vec2i), wp.array(rest, dtype=wp.float64)]
            self.springs.append((*on_device, compliance, wp.zeros(len(pairs), dtype=wp.float64)))
        self.push = wp.zeros(self.num_cloth, dtype=wp.vec3d)
        self.num_pushes = wp.zeros(self.num_cloth, dtype=wp.float64)

    def advance(self, obstacle_step: NDArray[np.float64]) -> None:
        """One frame, in which the obstacle moves by a step."""
        start, cloth = self.positions, slice(self.num_cloth)
        wish = start.copy()
        wish[cloth] += FRAME_TIME * (self.velocity + FRAME_TIME * GRAVITY) - obstacle_step
        for _, _, _, multiplier in self.springs:
            multiplier.zero_()
        planes = None
        if self.with_ccd:
            met = self.pipeline.mesh_ccd(start, wish).contacts
            planes = Planes.between(met, met.normal)
        reached = start
        for _ in range(ROUNDS):
            near = self.pipeline.find_proximity(reached if self.with_ccd else wish, self.reach)
            planes = Planes.between(near, near.direction).joined(planes)
            wish = self.solve(start, wish, planes)
            reached = self.pipeline.line_search(reached, wish, per="vertex").vertices if self.with_ccd else wish
        self.positions = reached
        # the air moves with the globe
        self.velocity = ((1.0 - AIR_DRAG * FRAME_TIME) * (reached[cloth] - start[cloth]) + obstacle_step) / FRAME_TIME

    def solve(self, start: NDArray[np.float64], wish: NDArray[np.float64], planes: Planes) -> NDArray[np.float64]:
        """Solve springs and contacts in turn, from the end of the last round."""
        positions, start = (wp.array(values, dtype=wp.vec3d) for values in (wish, start))
        distances = self.margin + self.mesh.radius[planes.corners[:, [0, 3]]].sum(axis=1)
        sides = [wp.array(planes.corners, dtype=wp.vec4i), wp.array(planes.weights, dtype=wp.vec4d)]
        sides += [wp.array(planes.normals, dtype=wp.vec3d), wp.array(distances, dtype=wp.float64)]
        sides += [FRICTION, self.num_cloth, start, positions]
        pushes = [self.push, self.num_pushes]
        for _ in range(ITERATIONS):
            for springs, rest_length, compliance, multiplier in self.springs:
                given = [springs, rest_length, compliance]
                wp.launch(pull_springs, dim=len(springs), inputs=given, outputs=[multiplier, positions])
            wp.launch(push_contacts, dim=len(distances), inputs=sides, outputs=pushes)
            wp.launch(apply_pushes, dim=self.num_cloth, outputs=[*pushes, positions])
        return positions.numpy()

    def frames(self, num_frames: int) -> Iterator[NDArray[np.float64]]:
        """Positions in the world after each frame, shape [V, 3]."""
        for frame in range(num_frames):
            before, after = obstacle_offset(frame), obstacle_offset(frame + 1)
            self.advance(after - before)
            yield self.positions + after


def intersecting_pairs(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> int:
    """Number of pairs of faces that intersect beyond a vertex or an edge that they share, by CGAL's exact kernel."""
    from igl.copyleft import cgal  # imported here, so that everything else runs without it

    found = cgal.remesh_self_intersections(vertices, faces.astype(np.int64), detect_only=True)
    return len(found[2])


def lengths(scene: ClothDrop, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of the cloth's edges along its threads, as multiples of their lengths at rest."""
    edges = np.concatenate([pairs.numpy() for pairs, *_ in scene.springs[:4]])
    rest = np.concatenate([length.numpy() for _, length, *_ in scene.springs[:4]])
    return np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1) / rest


def draw(path: Path, scene: ClothDrop, pictures: list[tuple[str, NDArray[np.float64]]]) -> None:
    """Draw key frames side by side, in the frame of reference of the obstacle."""
    num_ball = 20 * 4**BALL_SUBDIVISIONS
    is_cloth = scene.mesh.face_body == 0
    cloth, obstacle = scene.mesh.faces[is_cloth], scene.mesh.faces[~is_cloth]
    with drawing_without_display() as pyvista:
        columns = (len(pictures) + 1) // 2
        plotter = pyvista.Plotter(off_screen=True, shape=(2, columns), window_size=(columns * 480, 960), border=False)
        for k, (title, vertices) in enumerate(pictures):
            plotter.subplot(*divmod(k, columns))
            for faces, style in (
                (cloth, {"color": "#f0a04b", "ambient": 0.15, "backface_params": {"color": "#5b9bd5"}}),
                (obstacle[:num_ball], {"color": "#b8b8b8"}),
                (obstacle[num_ball:], {"color": "#8fb8d0", "opacity": 0.13}),
            ):
                used, local = np.unique(faces, return_inverse=True)
                surface = pyvista.PolyData.from_regular_faces(vertices[used], local.reshape(-1, 3), deep=True)
                plotter.add_mesh(surface, smooth_shading=True, **style)
            plotter.add_text(title, font_size=12, color="#222222")
            middle = vertices[scene.num_cloth :].mean(axis=0)
            plotter.camera_position = [middle + np.array([1.27, -2.75, 1.16]), middle, (0.0, 0.0, 1.0)]
            plotter.background_color = "white"
        plotter.screenshot(path)
        plotter.close()


def main() -> None:
    """Run, check, and write the results."""
    parser = argparse.ArgumentParser(description="A cloth in a globe that is kicked about, with CCD or without.")
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--resolution", type=int, default=101, help="vertices along a side of the cloth (default 101)")
    parser.add_argument("--no-ccd", action="store_true", help="look at the end of each step only")
    parser.add_argument("--output", type=Path, default=Path("cloth_drop"), help="folder (default cloth_drop)")
    options = parser.parse_args()
    if options.frames < 1 or options.resolution < 3:
        parser.error("expected --frames of at least 1 and --resolution of at least 3")
    missing = [name for name in ("igl", "tqdm", "pyvista") if find_spec(name) is None]
    if missing:
        sys.exit(f"cloth_drop.py needs {', '.join(missing)}; install with: pip install 'ccd-warp[examples]'")
    from tqdm import tqdm

    options.output.mkdir(parents=True, exist_ok=True)
    wp.config.log_level = wp.LOG_WARNING
    scene = ClothDrop(options.resolution, with_ccd=not options.no_ccd)
    key_frames = {frame for frame in KEY_FRAMES if frame < options.frames} | {options.frames - 1}
    pictures: list[tuple[str, NDArray[np.float64]]] = []
    counts, ranges, seconds = [], [], 0.0
    with tqdm(total=options.frames, unit="frame") as bar:
        begin = time.perf_counter()
        for frame, vertices in enumerate(scene.frames(options.frames)):
            seconds += time.perf_counter() - begin
            counts.append(intersecting_pairs(vertices, scene.mesh.faces))
            ranges.append(np.quantile(lengths(scene, vertices), [0.01, 0.99]))
            trimesh.Trimesh(vertices, scene.mesh.faces, process=False).export(options.output / f"frame_{frame:04d}.ply")
            if frame in key_frames:
                pictures.append((f"frame {frame}: {counts[-1]} pairs of faces intersect", vertices))
            bar.set_postfix(intersecting=sum(count > 0 for count in counts))
            bar.update()
            begin = time.perf_counter()
    steps = [np.linalg.norm(obstacle_offset(k + 1) - obstacle_offset(k)) for k in range(options.frames)]
    outside = np.linalg.norm(scene.positions[: scene.num_cloth], axis=1) > GLOBE_RADIUS
    print(f"{scene.num_cloth} vertices, obstacle up to {max(steps) / scene.edge_length:.1f} edge lengths a frame")
    num_bad = sum(count > 0 for count in counts)
    print(f"{len(counts)} frames, {num_bad} with intersecting faces, at most {max(counts)} pairs of them")
    print(f"{outside.mean():.0%} of the cloth outside the globe at the end")
    shortest, longest = np.transpose(ranges)
    print(f"99 in 100 edges shorter than {np.median(longest):.3f} of their rest length in the median frame,", end=" ")
    print(f"{longest.max():.3f} in the worst; longer than {np.median(shortest):.3f}, {shortest.min():.3f}")
    print(f"{seconds / len(counts):.2f} s a frame without the check")
    draw(options.output / "cloth_drop.png", scene, pictures)


if __name__ == "__main__":
    main()
