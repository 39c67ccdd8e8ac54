"""How all vertices of a mesh move in a step: those of bodies on paths on arcs, the others straight."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._body_paths import BodyPaths
from ccd_warp._display import counted
from ccd_warp._input.names import body_label
from ccd_warp._rotations import arcs, rotated

if TYPE_CHECKING:
    from ccd_warp._mesh import CollisionMesh


@dataclass(frozen=True, eq=False, repr=False)
class MeshPaths(BodyPaths):
    """The paths of all bodies of a mesh.

    Attributes:
        is_rigid: Bodies on a path, bool, shape [B]; the rows of the others mean nothing.
        excess: How far points of each body may be from the path, a length, shape [B].
        active: Bodies that are searched, bool, shape [B].
        turn: Angle for whose slices the step is cut, no less than that of any body; None for the largest of them.
    """

    is_rigid: NDArray[np.bool_]
    excess: NDArray[np.float64]
    active: NDArray[np.bool_]
    turn: float | None = None

    @classmethod
    def of(cls, mesh: CollisionMesh, given: BodyPaths, excess: NDArray[np.float64] | None = None) -> MeshPaths:
        """The paths of the rigid bodies of a mesh, for which a motion has given a row each, and an ``excess``.

        Raises:
            ValueError: If the numbers of bodies differ, the mesh is in the plane, or a static body moves.
        """
        if mesh.dimension == 2:
            raise ValueError("motion is given with a mesh in the plane; expected a mesh in space, whose bodies turn")
        bodies = np.flatnonzero(mesh.rigid)
        check_rows(mesh, bodies, len(given))
        check_worlds(mesh)
        check_rest(mesh, bodies, given)
        rows: dict[str, Any] = {}
        for field in fields(BodyPaths):
            of_rigid = getattr(given, field.name)
            rows[field.name] = np.zeros((mesh.num_bodies, of_rigid.shape[1]))
            rows[field.name][bodies] = of_rigid
        of_all = np.zeros(mesh.num_bodies)
        if excess is not None:
            of_all[bodies] = excess
        return cls(**rows, is_rigid=mesh.rigid.copy(), excess=of_all, active=np.ones(mesh.num_bodies, dtype=bool))

    def check_own_frames(self, mesh: CollisionMesh, start: NDArray[np.float64], end: NDArray[np.float64]) -> None:
        """Check that the rows of rigid bodies, which are in their own frames, are the same at both ends.

        Raises:
            ValueError: If one differs.
        """
        if start is end:
            return
        differs = (start != end).any(axis=1) & self.is_rigid[mesh.vertex_body]
        differs[mesh.unused_vertices] = False
        for vertex in np.flatnonzero(differs)[:1].tolist():
            raise ValueError(
                f"vertices_t1 has another row for vertex {vertex}{mesh._where(vertex)} than vertices_t0, and its body "
                f"is rigid; expected its place in the body's own frame in both, as the motion says where the body is"
            )

    def at(
        self, mesh: CollisionMesh, start: NDArray[np.float64], end: NDArray[np.float64], t: Any, vertices: Any = None
    ) -> NDArray[np.float64]:
        """Where vertices are at a time, one for all or one a vertex; all of them by default."""
        vertices = np.arange(len(start)) if vertices is None else vertices
        return self.places(mesh.vertex_body[vertices], start[vertices], end[vertices], t)

    def places(
        self, body: NDArray[np.integer], start: NDArray[np.float64], end: NDArray[np.float64], t: Any
    ) -> NDArray[np.float64]:
        """Where vertices of these bodies, with these positions at both ends, are at a time, shape [n, 3]."""
        times = _times(t, len(body))
        with np.errstate(invalid="ignore"):  # of vertices that take no part
            x: NDArray[np.float64] = (1.0 - times) * start + times * end
            rigid = np.flatnonzero(self.is_rigid[body])
            x[rigid] = self.positions(start[rigid], body[rigid], times[rigid, 0])
        return x

    def velocities(
        self, body: NDArray[np.integer], start: NDArray[np.float64], end: NDArray[np.float64], t: Any
    ) -> NDArray[np.float64]:
        """How vertices of these bodies move at a time, as displacements in the whole step, shape [n, 3]."""
        v: NDArray[np.float64] = end - start
        rigid = np.flatnonzero(self.is_rigid[body])
        rows, times = body[rigid], _times(t, len(body))[rigid, 0]
        omega, turning = self.omega[rows], self.turning[rows]
        arms = rotated(self.rotation[rows], start[rigid] - self.pivot[rows])
        arms = arms + arcs(omega, arms, times)
        v[rigid] = self.velocity[rows] + np.cross(omega, arms) + turning + arcs(omega, turning, times)
        return v


def moved(start: NDArray[np.float64], end: NDArray[np.float64], fraction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions at the fractions of the displacements: exactly the start at 0 and the end at 1."""
    f = fraction[..., None]
    # No difference of two distant positions is formed, which could overflow. Stationary coordinates must not move by
    # rounding. Vertices that take no part may be at no number.
    with np.errstate(invalid="ignore"):
        return np.where((f == 0) | (start == end), start, np.where(f == 1, end, (1 - f) * start + f * end))


def _times(t: Any, count: int) -> NDArray[np.float64]:
    """One time for all, or one for each, shape [count, 1]."""
    return np.broadcast_to(np.asarray(t, dtype=np.float64).reshape(-1, 1), (count, 1))


def check_rows(mesh: CollisionMesh, bodies: NDArray[np.intp], num_rows: int) -> None:
    """Check that a motion has a row for each of the rigid bodies, of which there are some.

    Raises:
        ValueError: If not.
    """
    if len(bodies) == 0:
        raise ValueError(
            "motion is given, and no body of the mesh is rigid; expected rigid=[…] where the mesh was built, or "
            "rigid_ccd, for which all bodies are"
        )
    if num_rows != len(bodies):
        count, left = divmod(num_rows, len(bodies))
        worlds = "" if left or count < 2 else f", or for {count} worlds mesh.replicate({count})"
        raise ValueError(
            f"motion has {counted(num_rows, 'row', 'rows')} for "
            f"{counted(len(bodies), 'rigid body', 'rigid bodies')} of the mesh; expected one a body{worlds}"
        )


def check_worlds(mesh: CollisionMesh) -> None:
    """Check that no rigid body has vertices in several worlds, which may have to stop it at different times.

    Raises:
        ValueError: If one has.
    """
    if mesh.num_worlds == 1:
        return
    first = np.zeros(mesh.num_bodies, dtype=np.int32)
    filled = np.flatnonzero(np.diff(mesh.body_vertex_range))
    first[filled] = mesh.vertex_world[mesh._stand_ins[mesh.body_vertex_range[filled]]]
    differs = (mesh.vertex_world != first[mesh.vertex_body]) & mesh.rigid[mesh.vertex_body]
    differs[mesh.unused_vertices] = False
    for vertex in np.flatnonzero(differs)[:1].tolist():
        body = int(mesh.vertex_body[vertex])
        raise ValueError(
            f"motion is given, and {body_label(body, mesh.names)}, which is rigid, has vertices in worlds "
            f"{first[body]} and {mesh.vertex_world[vertex]}; expected a body for each world"
        )


def check_rest(mesh: CollisionMesh, bodies: NDArray[np.intp], given: BodyPaths) -> None:
    """Check that paths of these bodies, of one world after another, leave the static ones where they are.

    Raises:
        ValueError: If one moves.
    """
    moves = given.omega.any(axis=1) | given.velocity.any(axis=1) | given.turning.any(axis=1)
    num_worlds = len(given) // len(bodies)
    for row in np.flatnonzero(moves & np.tile(mesh.static[bodies], num_worlds))[:1].tolist():
        world, k = divmod(row, len(bodies))
        where = f" in world {world}" if num_worlds > 1 else ""
        raise ValueError(
            f"motion moves {body_label(int(bodies[k]), mesh.names)}{where}, which is static; expected equal poses at "
            f"both ends, or kinematic in place of static for a body that moves as it is told"
        )
