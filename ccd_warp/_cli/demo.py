"""Scenes of ``ccd-warp demo``, built with trimesh: a bullet through a thin wall, and a cloth over a sphere."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from ccd_warp._files.frames import Body, make_body


@dataclass(frozen=True)
class DemoScene:
    """A scene of the demo.

    Attributes:
        name: Short name, also of its files.
        title: What it shows.
        bodies: Moving and static bodies.
        self_collision: Whether a body may touch itself.
        compare_static_test: Whether to show the result of a test at both ends of the step.
    """

    name: str
    title: str
    bodies: list[Body]
    self_collision: bool
    compare_static_test: bool


def bullet_scene() -> DemoScene:
    """A ball of radius 0.1 flies nine units in one step through a wall 0.02 thick."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    wall = trimesh.creation.box(extents=(0.02, 5.0, 5.0))
    start = ball.vertices + [0.5, 3.5, 0.0]
    end = ball.vertices + [9.5, 3.5, 0.0]
    return DemoScene(
        name="bullet",
        title="bullet through a thin wall, one step",
        bodies=[
            make_body("bullet", start, end, ball.faces),
            # Off the bullet's line, so that it does not hit the diagonal between two faces of the wall.
            make_body("wall", wall.vertices + [5.0, 3.5, 0.4], None, wall.faces, is_static=True),
        ],
        self_collision=False,
        compare_static_test=True,
    )


def cloth_scene(cells: int = 71) -> DemoScene:
    """A rippled square cloth of ``2 cells²`` faces drops onto a sphere of radius 1."""
    steps = np.linspace(-1.5, 1.5, cells + 1)
    x, y = (grid.reshape(-1) for grid in np.meshgrid(steps, steps, indexing="ij"))
    ripple = 0.02 * np.sin(5.0 * x) * np.cos(4.0 * y)
    start = np.column_stack([x, y, 1.15 + ripple])
    # Free fall of the middle while the corners lag: the step deforms the cloth and ends inside the sphere.
    end = np.column_stack([0.99 * x, 0.99 * y, start[:, 2] - 0.35 + 0.05 * (x * x + y * y)])
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    faces = np.vstack(
        [
            np.column_stack([corner, corner + cells + 1, corner + 1]),
            np.column_stack([corner + 1, corner + cells + 1, corner + cells + 2]),
        ]
    )
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    return DemoScene(
        name="cloth",
        title="cloth over a sphere, one step",
        bodies=[
            make_body("cloth", start, end, faces),
            make_body("sphere", sphere.vertices, None, sphere.faces, is_static=True),
        ],
        self_collision=True,
        compare_static_test=False,
    )


def surfaces_intersect(a_vertices, a_faces, b_vertices, b_faces) -> bool:
    """Whether two surfaces cross at one instant: does an edge of one pass through a face of the other?

    This is the test that a simulation without CCD makes. It tests every edge against every face, which is affordable
    for small meshes.
    """
    a_vertices, b_vertices = np.asarray(a_vertices), np.asarray(b_vertices)
    return _edges_cross_faces(a_vertices, a_faces, b_vertices, b_faces) or _edges_cross_faces(
        b_vertices, b_faces, a_vertices, a_faces
    )


def _edges_cross_faces(edge_vertices, edge_faces, vertices, faces) -> bool:
    edges = np.unique(np.sort(np.vstack([edge_faces[:, [0, 1]], edge_faces[:, [1, 2]], edge_faces[:, [2, 0]]])), axis=0)
    p, q = (edge_vertices[edges[:, k]][:, None] for k in (0, 1))
    a, b, c = (vertices[faces[:, k]][None] for k in (0, 1, 2))

    def volume(d, e, f, g):
        return np.einsum("...k,...k", d - g, np.cross(e - g, f - g))

    sides = volume(a, b, c, p) * volume(a, b, c, q) <= 0.0
    around = np.stack([volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)])
    return bool((sides & ((around >= 0.0).all(axis=0) | (around <= 0.0).all(axis=0))).any())


def static_test(bodies: Sequence[Body]) -> tuple[bool, bool]:
    """Whether the first two bodies' surfaces cross at the start and at the end of the step."""
    a, b = bodies[:2]
    return (
        surfaces_intersect(a.vertices_t0, a.faces, b.vertices_t0, b.faces),
        surfaces_intersect(a.vertices_t1, a.faces, b.vertices_t1, b.faces),
    )
