"""How the vertices of a drawn step move: straight, or on arcs with rigid bodies."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._results.contact_place import TURN, BodyMotion, MovingVertices
from ccd_warp._scene.input.arguments import shown
from ccd_warp._scene.mesh import CollisionMesh

_DIRECTIONS = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]) - 1.0


def moving_vertices(
    mesh: CollisionMesh, vertices_t0: ArrayLike, vertices_t1: ArrayLike, motion: BodyMotion | None
) -> MovingVertices:
    """How all vertices move in space; where no body of the mesh is rigid, a motion is one of all, as of ``rigid_ccd``.

    Raises:
        ValueError: If the positions or the motion do not match the mesh.
    """
    start, end = map(mesh._in_space, mesh.frames(vertices_t0, vertices_t1))
    if motion is None:
        return MovingVertices(mesh, start, end)
    if not isinstance(motion, BodyMotion):
        raise ValueError(f"motion is {shown(motion)}; expected a RigidMotion")
    return motion._moving(mesh, start, end)


def outermost(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """The positions that lie farthest along the axes and their diagonals, shape [26, 3]."""
    return positions[(positions @ _DIRECTIONS.T).argmax(axis=0)]


def arcs_of(moving: MovingVertices, most: int) -> list[NDArray[np.float64]]:
    """Paths of the outermost vertices of the first bodies that turn, shape [k, 3] each."""
    paths, mesh = moving.paths, moving.mesh
    if paths is None:
        return []
    turns = np.linalg.norm(paths.omega, axis=1) >= TURN
    bodies = np.flatnonzero(turns & (np.diff(mesh.body_vertex_range) > 0))
    outermost = []
    for body in bodies[:most].tolist():
        first, last = mesh.body_vertex_range[body : body + 2].tolist()
        sides = moving.start[first:last] @ np.hstack([np.eye(3), -np.eye(3)])
        outermost += (first + np.unique(sides.argmax(axis=0))).tolist()
    vertices = np.array(outermost, dtype=np.int64)
    if not len(vertices):
        return []
    places = [moving.at(vertices, np.full((len(vertices), 1), t)) for t in moving.times]
    return list(np.stack(places, axis=1))
