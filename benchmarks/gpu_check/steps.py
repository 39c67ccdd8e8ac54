"""Small scenes made by code: each kind of body, pair and mesh option at least once."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import trimesh
from ccd_warp.benchmarks.scenes import grid

import ccd_warp as ccd


class Step(NamedTuple):
    """A mesh and its positions at both ends of a step."""

    mesh: ccd.CollisionMesh
    start: np.ndarray
    end: np.ndarray

    @property
    def capacities(self) -> dict[str, int]:
        """Capacities of a launch that suffice."""
        return {"max_pairs": max(1 << 12, 64 * len(self.start)), "max_contacts": max(1 << 12, 8 * len(self.start))}


def sheet_over_ball(
    rows: int, *, static: bool = True, half_spaces: tuple[ccd.HalfSpace, ...] = (), **options: Any
) -> Step:
    """A wavy sheet that falls through a ball, which turns a little if it is not static, and half-spaces."""
    sheet, faces = grid(rows, rows, 1.0, 1.0)
    sheet[:, 2] = 0.02 * np.sin(8 * sheet[:, 0]) * np.cos(7 * sheet[:, 1])
    ball = trimesh.creation.icosphere(subdivisions=1 if rows < 10 else 2, radius=0.3)
    bodies = [(sheet, faces), (np.asarray(ball.vertices), ball.faces)]
    mesh = ccd.CollisionMesh.from_arrays([*bodies, *half_spaces], static=[1] if static else [], **options)
    start = np.concatenate([sheet + [0.013, 0.007, 0.4], ball.vertices])
    end = start.copy()
    end[: len(sheet), 2] -= 0.35
    if not static:
        end[len(sheet) :] = ball.vertices @ trimesh.transformations.rotation_matrix(0.3, [1, 2, 3])[:3, :3].T
    return Step(mesh, start, end)


def crowd(num_faces: int, **options: Any) -> Step:
    """Faces at random places that move at random and share vertices, in two bodies, with cables and particles."""
    rng = np.random.default_rng(5)
    count = 3 * num_faces
    bodies, positions = [], []
    for _ in range(2):
        at = np.repeat(rng.random((num_faces, 1, 3)), 3, axis=1).reshape(-1, 3)
        at += 0.08 * rng.standard_normal((count, 3))
        edges = np.stack([np.arange(0, 30, 3), np.arange(4, 34, 3)], axis=1)
        bodies.append((at, np.arange(count).reshape(-1, 3) % (count - 9), edges))
        positions.append(at)
    start = np.concatenate(positions)
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True, **options)
    return Step(mesh, start, start + 0.1 * rng.standard_normal(start.shape))


def worlds(count: int) -> Step:
    """Copies of a sheet over a static ball in worlds of their own, with a ground; each moves a little differently."""
    one = sheet_over_ball(5, half_spaces=(ccd.HalfSpace([0, 0, 0.15], [0.1, 0, 2]),))
    start = np.tile(one.start, (count, 1))
    move = np.tile(one.end - one.start, (count, 1))
    move *= np.repeat(np.linspace(0.2, 1.2, count), len(one.start))[:, None]
    return Step(one.mesh.replicate(count), start, start + move)


def polygons() -> Step:
    """Two polygons in the plane that turn through each other."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * np.where(np.arange(24) % 2, 1.0, 0.6)[:, None]
    edges = np.stack([np.arange(24), (np.arange(24) + 1) % 24], axis=1)
    mesh = ccd.CollisionMesh.from_arrays([(ring, edges), (ring + [1.7, 0.1], edges)])
    start = np.concatenate([ring, ring + [1.9, 0.1]])
    return Step(mesh, start, np.concatenate([ring @ [[0.8, 0.6], [-0.6, 0.8]], ring + [1.4, 0.1]]))


def all_steps(is_short: bool) -> dict[str, Callable[[], Step]]:
    """The scenes, each small, or large enough for many blocks of threads, and made anew at each call."""
    rows, faces, count = (6, 24, 3) if is_short else (80, 600, 40)
    excluded = {"vertex_face": [[0, 1], [2, 20], [5, 9]], "edge_edge": [[0, 9], [3, 40]], "bodies": [[0, 0]]}
    steps: dict[str, Callable[[], Step]] = {
        "sheet over ball": partial(sheet_over_ball, rows),
        "crowd": partial(crowd, faces),
        "crowd without some pairs": partial(crowd, faces, exclude_pairs=excluded),
        f"{count} worlds": partial(worlds, count),
        "polygons": polygons,
    }
    if not is_short:
        apart = np.array([[True, False], [False, True]])
        steps |= {
            "sheet over a turning ball": partial(sheet_over_ball, rows, static=False, self_collision=[True, False]),
            "crowd without neighbours": partial(crowd, faces, exclusion_rings=2),
            "crowd of bodies apart": partial(crowd, faces, body_pairs=apart),
        }
    return steps
