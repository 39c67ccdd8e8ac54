"""Whole steps for the benchmark: published frames, and generated scenes of any size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import checkout  # noqa: F401
import numpy as np
import trimesh
from fine_meshes import Scene, grid, joined, sphere, spheres_through_each_other
from public_data import find_steps, read_step


def cloth_over_sphere(num_faces: int, fall: float = 0.05) -> Scene:
    """A wavy sheet of four fifths of the faces falls on a sphere."""
    n = int((0.4 * num_faces) ** 0.5) + 1
    sheet, faces = grid(n, n)
    sheet[:, 2] = 0.02 * np.sin(8 * sheet[:, 0]) * np.cos(7 * sheet[:, 1])
    ball, ball_faces = sphere(num_faces // 5, 0.5)
    ball = ball - [0, 0, 0.54]
    return joined(f"cloth over sphere, {num_faces:,}", [(sheet, sheet - [0, 0, fall], faces), (ball, ball, ball_faces)])


def worlds(count: int) -> Scene:
    """Worlds of a coarse cloth that falls on a sphere, in each of which pairs touch."""
    one = cloth_over_sphere(400, fall=0.15)
    ends = {name: np.tile(getattr(one, name), (count, 1)) for name in ("vertices_t0", "vertices_t1")}
    return replace(one, name=f"{count:,} worlds of {len(one.faces)} faces", worlds=count, **ends)


def falling_copies(
    vertices: np.ndarray, faces: np.ndarray, count: int, *, spacing: float, angle: float, stretch: float = 0.0
) -> list:
    """Copies of a body on a lattice, each stretched at random along the axes, that fall and turn a little: parts."""
    rng = np.random.default_rng(0)
    side = round(count ** (1 / 3) + 0.499)
    places = np.stack(np.meshgrid(*[np.arange(side)] * 3), axis=-1).reshape(-1, 3)[:count] * spacing
    parts = []
    for place in places:
        start = vertices * (rng.uniform(1 - stretch, 1 + stretch, 3) if stretch else 1.0) + place
        turn = trimesh.transformations.rotation_matrix(angle, rng.standard_normal(3))[:3, :3]
        parts.append((start, (start - place) @ turn.T + place - [0, 0, 0.05], faces))
    return parts


def pile(num_bodies: int, faces_each: int) -> Scene:
    """Many bodies, close to each other, that fall and turn a little."""
    ball, faces = sphere(faces_each, 0.5)
    parts = falling_copies(ball, faces, num_bodies, spacing=1.02, angle=0.05, stretch=0.1)
    return joined(f"pile of {num_bodies:,} bodies, {num_bodies * len(faces):,}", parts)


def ground_under_cloth(num_faces: int) -> Scene:
    """One giant face under a fine sheet."""
    n = int((num_faces / 2) ** 0.5) + 1
    sheet, faces = grid(n, n)
    sheet[:, 2] = 0.03 + 0.02 * np.sin(8 * sheet[:, 0]) * np.cos(7 * sheet[:, 1])
    ground = 100.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
    return joined(
        f"giant face under cloth, {num_faces:,}",
        [(sheet, sheet - [0, 0, 0.04], faces), (ground, ground, np.array([[0, 1, 2]]))],
    )


def long_step(num_faces: int) -> Scene:
    """Two sheets that slide past each other by many edge lengths, and never touch."""
    n = int((num_faces / 4) ** 0.5) + 1
    sheet, faces = grid(n, n)
    upper = sheet + [0, 0, 0.01]
    edge = 2.0 / (n - 1)
    wave = 0.003 * np.sin(9 * sheet[:, :1])
    return joined(
        f"step of 20 edge lengths, {num_faces:,}",
        [
            (sheet, sheet + [20 * edge, 0, 0] + wave * [0, 0, 1], faces),
            (upper, upper - [20 * edge, 0, 0] + wave * [0, 0, 1], faces),
        ],
    )


def waves(rng: np.random.Generator, at: np.ndarray, wavelength: float) -> np.ndarray:
    """A smooth random vector field at points, shape [n, d]: 32 plane waves, of root mean square 1 along each axis."""
    direction = rng.standard_normal((32, at.shape[1]))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    phase = at @ direction.T * (2 * np.pi / wavelength / rng.uniform(0.7, 1.4, 32)) + rng.uniform(0, 2 * np.pi, 32)
    return np.sin(phase) @ rng.standard_normal((32, 3)) / 4


def folded(along: np.ndarray, gap: float) -> tuple[np.ndarray, np.ndarray]:
    """Lengths along a strip folded to and fro into layers of length 1, a gap apart, as the coordinates (x, z)."""
    layer, along = np.divmod(along, 1.0 + np.pi * gap / 2)
    turn = np.maximum(along - 1.0, 0.0) / (gap / 2)  # angle in the half circle that joins two layers
    x = np.minimum(along, 1.0) + gap / 2 * np.sin(turn)
    return np.where(layer % 2 == 0, x, 1.0 - x), layer * gap + gap / 2 * (1.0 - np.cos(turn))


def crumpled_cloth(num_faces: int) -> Scene:
    """A folded and wrinkled sheet, 24 layers one edge length apart, whose layers slide and press against each other.

    Each part of the cloth moves by a random displacement that varies smoothly along it, of one and a half edge lengths
    along the layers and one across them in the root mean square, so that layers slide by several edge lengths in any
    direction and some pass through their neighbours. The wrinkles stay where they are, and the cloth slides along them.
    """
    layers = 24
    edge = (2 * layers / num_faces) ** 0.5
    length = layers + (layers - 1) * np.pi * edge / 2
    rows, columns = round(length / edge), round(1 / edge)
    sheet, faces = grid(rows, columns, length, 1.0)
    material = sheet[:, :2] + [length / 2, 0.5]
    x, z = folded(material[:, 0], edge)
    start = np.stack([x, material[:, 1], z], axis=1)
    end = start + edge * np.array([1.5, 1.5, 1.0]) * waves(np.random.default_rng(0), material, 0.6)
    wrinkled = [at + 0.03 * waves(np.random.default_rng(1), at, 0.7) for at in (start, end)]
    return Scene(f"crumpled cloth, {len(faces):,}", *wrinkled, faces)


def bodies_through_each_other(num_bodies: int, faces_each: int) -> Scene:
    """Bodies that turn and fly in random directions, by about their diameter, through whatever is in their way."""
    ball, faces = sphere(faces_each, 0.5)
    turned = falling_copies(ball, faces, num_bodies, spacing=1.1, angle=0.5, stretch=0.1)
    moves = 0.5 * np.random.default_rng(1).standard_normal((num_bodies, 3))
    parts = [(start, end + move, faces) for (start, end, faces), move in zip(turned, moves, strict=True)]
    return joined(f"{num_bodies:,} bodies through each other, {num_bodies * len(faces):,}", parts)


def two_small_spheres(subdivisions: int) -> Scene:
    """Two icospheres, of 40 faces in all and four times as many for each subdivision, fly into each other."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.5)
    faces = np.asarray(ball.faces)
    left, right = ball.vertices - [0.6, 0, 0], ball.vertices + [0.6, 0.013, 0.017]
    move = np.array([0.3, 0, 0])
    parts = [(left, left + move, faces), (right, right - move, faces)]
    return joined(f"two spheres, {2 * len(faces):,}", parts)


def few_boxes(num_boxes: int) -> Scene:
    """Boxes close to each other that fall and turn a little."""
    box = trimesh.creation.box()
    faces = np.asarray(box.faces)
    parts = falling_copies(np.asarray(box.vertices), faces, num_boxes, spacing=1.1, angle=0.2)
    return joined(f"{num_boxes} boxes, {num_boxes * len(faces)}", parts)


def tetrahedron_on_a_plane() -> Scene:
    """A tetrahedron that falls on a static square of two faces."""
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.2
    start = corners + [0.05, 0.03, 0.25]
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    plane, plane_faces = grid(2, 2)
    parts = [(start, start - [0, 0, 0.2], faces), (plane, plane, plane_faces)]
    return joined("tetrahedron on a plane, 6", parts, static=(1,))


def sheet_on_ball(across: int, subdivisions: int) -> Scene:
    """A flat sheet, of so many vertices across, that falls on a static icosphere."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.3)
    sheet, faces = grid(across, across, 1.37, 1.37)
    sheet = sheet + [0.035, 0.035, 0.33]
    parts = [(sheet, sheet - [0, 0, 0.1], faces), (ball.vertices, ball.vertices, np.asarray(ball.faces))]
    return joined(f"sheet on a ball, {len(faces) + len(ball.faces):,}", parts, static=(1,))


def small_scenes() -> list[Scene]:
    """Scenes where the fixed cost of a call counts."""
    return [*(two_small_spheres(k) for k in range(4)), few_boxes(20), tetrahedron_on_a_plane()]


def published_scenes(folder: Path | None) -> list[tuple[str, Callable[[], Scene]]]:
    """The steps that a folder in the public formats holds, by name."""
    if folder is None:
        return []

    def load(name: str, frames: tuple[Path, Path]) -> Scene:
        step = read_step(*frames)
        return Scene(name, step.vertices_t0, step.vertices_t1, step.faces)

    steps = find_steps(folder)
    return [(Path(name).name, lambda n=name, f=frames: load(Path(n).name, f)) for name, frames in steps.items()]


# Scenes of which the frontier shows every method with several settings.
FRONTIER = ("cloth-funnel", "cloth 10k", "rod-twist", "spheres 100k")


def all_scenes(folder: Path | None, quick: bool) -> list[tuple[str, Callable[[], Scene]]]:
    """Every scene of the benchmark by name, with the function that builds it."""
    made: dict[str, Callable[[], Scene]] = {
        "cloth 10k": partial(cloth_over_sphere, 10_000),
        "cloth 100k": partial(cloth_over_sphere, 100_000),
        "spheres 100k": partial(spheres_through_each_other, 100_000),
        "pile": partial(pile, 1_000, 100),
        "giant face 100k": partial(ground_under_cloth, 100_000),
        "long step": partial(long_step, 20_000),
        "crumpled cloth 50k": partial(crumpled_cloth, 50_000),  # the narrow phase is most of the step
        "bodies through each other": partial(bodies_through_each_other, 300, 100),  # and here
        "cloth 1M": partial(cloth_over_sphere, 1_000_000),
    }
    return [*published_scenes(folder), *list(made.items())[: 3 if quick else None]]
