"""How all vertices of a mesh move in a step: those of bodies on paths on arcs, the others straight."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.host.workspace import Workspace
from ccd_warp._engine.mesh.topology import Positions, Topology
from ccd_warp._engine.motion import Motion, Slice, Slices
from ccd_warp._results.contact_place import Times
from ccd_warp._rigid.body_paths import UNSEEN, BodyPaths
from ccd_warp._rigid.rotations import arc_factors, arcs, cross, in_space, rotated
from ccd_warp._runtime.display import counted, listed
from ccd_warp._scene.input.names import body_label
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh

# Turn of a slice, in radians: of finer slices there are more, and of coarser ones boxes that are near each other.
TURN_OF_A_SLICE = 0.33
_ROUNDING = 1e-6  # of the length of a rotation vector; a slice may turn by up to `arcs.LARGEST_TURN`


@dataclass(frozen=True, eq=False, repr=False)
class MeshPaths(BodyPaths):
    """The paths of all bodies of a mesh.

    Attributes:
        is_rigid: Bodies on a path, bool, shape [B]; the rows of the others mean nothing.
        searched: The slices that are searched; None for all of the step, cut by the largest turn of a body.
    """

    is_rigid: NDArray[np.bool_]
    searched: list[Slice] | None = None
    is_of_worlds: ClassVar[bool] = False

    @classmethod
    def of(cls, mesh: CollisionMesh, paths: BodyPaths) -> MeshPaths:
        """The paths of the rigid bodies of a mesh, for which a motion has given a row each.

        Raises:
            ValueError: If the numbers of bodies differ, a static body moves, or any leaves the plane of a mesh in it.
        """
        check_motion(mesh, paths)
        check_worlds(mesh)
        return cls.of_checked(mesh, paths)

    @classmethod
    def of_checked(cls, mesh: CollisionMesh, paths: BodyPaths, **further: Any) -> MeshPaths:
        """Those of a motion that is known to fit the mesh, with ``further`` attributes."""
        paths, bodies = paths.seen(), np.flatnonzero(mesh.rigid)
        rows: dict[str, Any] = {}
        for field in fields(BodyPaths):
            of_rigid = getattr(paths, field.name)
            rows[field.name] = np.zeros((mesh.num_bodies, *of_rigid.shape[1:]))
            rows[field.name][bodies] = of_rigid
        return cls(**rows, is_rigid=mesh.rigid.copy(), **further)

    def begin(self, workspace: Workspace, positions: Positions, options: Options, *, for_impacts: bool) -> Motion:
        """Begin a step on the host along these paths; for impacts alone without slices in which nothing is near."""
        from ccd_warp._rigid.arcs import Arcs  # not before a scene needs it

        arcs = workspace.kept(Arcs, lambda: Arcs(workspace.topology))
        arcs.begin(self)
        searched = self.searched
        if for_impacts and searched is None:
            searched = self._near_slices(workspace.topology, positions, options)
        return arcs.begin_on_host(searched or slices_of(self, options.t_max).all(), positions)

    def _near_slices(self, topology: Topology, positions: Positions, options: Options) -> list[Slice] | None:
        """The slices in which anything is near; None where that is not looked for."""
        from ccd_warp._rigid.parts.near_search import body_parts, find_near, touching_distance

        slices, dimension = slices_of(self, options.t_max), topology.mesh.dimension
        start, end = (x[:, :dimension] for x in positions)
        parts = body_parts(topology, (start, start if positions[0] is positions[1] else end))
        paths, distance = self.rows(np.flatnonzero(self.is_rigid)), touching_distance(topology.mesh, options)
        near = find_near(topology, parts, positions, paths, slices, distance, options.threads)
        return None if near is None else near.slices(slices)

    def shortened(self, fraction: NDArray[np.float64]) -> Self:
        """The paths up to a fraction of the step for each body, shape [N], all of whose slices are searched."""
        return replace(super().shortened(fraction), searched=None)

    def at(
        self,
        mesh: CollisionMesh,
        start: NDArray[np.float64],
        end: NDArray[np.float64],
        t: Times,
        vertices: NDArray[np.integer] | None = None,
    ) -> NDArray[np.float64]:
        """Where vertices are at a time, one for all or one a vertex; all of them by default."""
        vertices = np.arange(len(start)) if vertices is None else vertices
        return self.places(mesh.vertex_body[vertices], start[vertices], end[vertices], t)

    def places(
        self, body: NDArray[np.integer], start: NDArray[np.float64], end: NDArray[np.float64], t: Times
    ) -> NDArray[np.float64]:
        """Where vertices of these bodies, with these positions at both ends, are at a time, shape [n, 3]."""
        times = _times(t, len(body))
        with np.errstate(invalid="ignore"):  # of vertices that take no part
            x: NDArray[np.float64] = (1.0 - times) * start + times * end
            rigid, rows = self._rows_of(body)
            x[rigid] = self.positions(in_space(start[rigid]), rows, times[rigid, 0])[:, : x.shape[1]]
        return x

    def velocities(
        self, body: NDArray[np.integer], start: NDArray[np.float64], end: NDArray[np.float64], t: Times
    ) -> NDArray[np.float64]:
        """How vertices of these bodies move at a time, as displacements in the whole step, shape [n, 3]."""
        v: NDArray[np.float64] = end - start
        rigid, rows = self._rows_of(body)
        times = _times(t, len(body))[rigid, 0]
        omega, turning = self.omega[rows], self.turning[rows]
        factors = arc_factors(omega, times)
        arms = rotated(self.rotation[rows], in_space(start[rigid]) - self.pivot[rows])
        arms = arms + arcs(omega, arms, times, factors)
        turned = self.velocity[rows] + cross(omega, arms) + turning + arcs(omega, turning, times, factors)
        turned[(self.excess[rows] > 0.0) & (np.abs(turned) <= UNSEEN).all(axis=1)] = 0.0
        v[rigid] = turned[:, : v.shape[1]]
        return v

    def _rows_of(self, body: NDArray[np.integer]) -> tuple[NDArray[np.intp], NDArray[np.integer]]:
        """Which vertices, given the body of each, are on a path, and the rows of these paths."""
        rigid = np.flatnonzero(self.is_rigid[body])
        return rigid, body[rigid]


class WorldPaths(MeshPaths):
    """The paths of the rigid bodies of a mesh of one world in many: body b in world w has the number w B + b.

    There are rows of rigid bodies alone, so that what stands in all worlds costs nothing.
    """

    is_of_worlds = True

    @classmethod
    def of_worlds(cls, mesh: CollisionMesh, paths: BodyPaths) -> WorldPaths:
        """Of a motion that has a row for each rigid body, of one world after another."""
        return cls(**vars(paths.seen()), is_rigid=mesh.rigid)

    def _rows_of(self, body: NDArray[np.integer]) -> tuple[NDArray[np.intp], NDArray[np.integer]]:
        world, body_in_world = np.divmod(body, len(self.is_rigid))
        rigid = np.flatnonzero(self.is_rigid[body_in_world])
        number = np.cumsum(self.is_rigid)
        return rigid, world[rigid] * number[-1] + number[body_in_world[rigid]] - 1


def slices_of(paths: BodyPaths, t_max: float) -> Slices:
    """The slices of [0, t_max], in each of which no body turns by more than `TURN_OF_A_SLICE`."""
    return Slices(max(1, int(np.ceil(paths.largest_turn * t_max / TURN_OF_A_SLICE - _ROUNDING))), t_max)


def _times(t: Times, count: int) -> NDArray[np.float64]:
    """One time for all, or one for each, shape [count, 1]."""
    return np.broadcast_to(np.asarray(t, dtype=np.float64).reshape(-1, 1), (count, 1))


def check_motion(mesh: CollisionMesh, paths: BodyPaths, num_worlds: int = 1) -> None:
    """Check that a motion fits a mesh, of whose rigid bodies it has a row each in so many worlds.

    Raises:
        ValueError: If not.
    """
    bodies = np.flatnonzero(mesh.rigid)
    check_rows(mesh, bodies, len(paths) // max(num_worlds, 1))
    _check_static_bodies(mesh, bodies, paths)
    _check_plane(mesh, bodies, paths)


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
            f"motion has {counted(num_rows, 'row', 'rows')} for {counted(len(bodies), 'rigid body', 'rigid bodies')} "
            f"of the mesh, {listed([body_label(body, mesh.names) for body in bodies.tolist()])}; expected one a "
            f"body, or more bodies in rigid= where the mesh is built{worlds}"
        )


def check_own_frames(mesh: CollisionMesh, start: NDArray[np.float64], end: NDArray[np.float64]) -> None:
    """Check that the rows of rigid bodies, which are in their own frames, are the same at both ends.

    Raises:
        ValueError: If one differs.
    """
    if start is end:
        return
    differs = (start != end).any(axis=1) & mesh.rigid[mesh.vertex_body]
    differs[mesh.unused_vertices] = False
    for vertex in np.flatnonzero(differs)[:1].tolist():
        raise ValueError(
            f"vertices_t1 has another row for vertex {vertex}{mesh._where(vertex)} than vertices_t0, and its body "
            f"is rigid; expected its place in the body's own frame in both, as the motion says where the body is"
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
        worlds = f"{first[body]} and {mesh.vertex_world[vertex]}"
        raise ValueError(
            f"motion is given, and {body_label(body, mesh.names)}, which is rigid, has vertices in worlds {worlds}; "
            f"expected a body for each world"
        )


def _check_static_bodies(mesh: CollisionMesh, bodies: NDArray[np.intp], paths: BodyPaths) -> None:
    """Check that paths of these bodies, of one world after another, leave the static ones where they are.

    Raises:
        ValueError: If one moves.
    """
    if not mesh.static[bodies].any():
        return
    num_worlds = len(paths) // len(bodies)
    is_static = np.tile(mesh.static[bodies], num_worlds)
    for row in np.flatnonzero(is_static & (paths.excess > 0.0))[:1].tolist():
        raise ValueError(
            f"within of the motion lets {_body_of(mesh, bodies, paths, row)} leave its pose, which is static; expected "
            f"0 for it, or kinematic in place of static for a body that moves as it is told"
        )
    for row in np.flatnonzero(is_static & paths.moves)[:1].tolist():
        raise ValueError(
            f"motion moves {_body_of(mesh, bodies, paths, row)}, which is static; expected equal poses at "
            f"both ends, or kinematic in place of static for a body that moves as it is told"
        )


def _check_plane(mesh: CollisionMesh, bodies: NDArray[np.intp], paths: BodyPaths) -> None:
    """Check that paths of these bodies, of one world after another, stay in the plane of a mesh in it.

    Raises:
        ValueError: If one leaves it.
    """
    if mesh.dimension == 3:
        return
    across = {
        "quaternion at the start": ("x and y", paths.rotation[:, :2]),
        "rotation vector": ("x and y", paths.omega[:, :2]),
        "pivot": ("z", paths.pivot[:, 2:]),
        "place at the start": ("z", paths.pivot_t0[:, 2:]),
        "displacement": ("z", paths.velocity[:, 2:] + paths.turning[:, 2:]),
    }
    for name, (axes, values) in across.items():
        for row in np.flatnonzero(values.any(axis=1))[:1].tolist():
            numbers = " and ".join(str(value) for value in values[row].tolist())
            raise ValueError(
                f"motion takes {_body_of(mesh, bodies, paths, row)} out of the plane of the mesh: {axes} of its {name} "
                f"{'is' if axes == 'z' else 'are'} {numbers}; expected 0, as bodies in the plane turn about z alone: "
                f"poses (x, y, 0) with quaternions (0, 0, z, w), twists (x, y, 0, 0, 0, angle)"
            )


def _body_of(mesh: CollisionMesh, bodies: NDArray[np.intp], paths: BodyPaths, row: int) -> str:
    """What a message calls the body of a row, of those of one world after another."""
    world, k = divmod(row, len(bodies))
    where = f" in world {world}" if len(paths) > len(bodies) else ""
    return f"{body_label(int(bodies[k]), mesh.names)}{where}"
