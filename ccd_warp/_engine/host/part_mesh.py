"""Meshes of parts of one world, each slice in which they may touch a world of its own; one world of many alike."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._contact_place import ContactPlace
from ccd_warp._contacts import Contacts
from ccd_warp._engine.host.near_parts import NearParts
from ccd_warp._half_space import Planes
from ccd_warp._input.excluded_pairs import ExcludedPairs
from ccd_warp._mesh import CollisionMesh
from ccd_warp._status import PairKind, primitives_of

# Bodies of a mesh of parts at most, or one world's: pairs of them that may collide take a byte each.
MOST_BODIES = 1 << 13
_BYTES_OF_A_ROW = 1024  # of a primitive with its boxes and pairs, about


def rows_within(memory_limit: int | None, most: int) -> int:
    """How many primitives a mesh may have, and no more than that."""
    return most if memory_limit is None else min(most, memory_limit // _BYTES_OF_A_ROW)


def world_alone(mesh: CollisionMesh, positions: NDArray[np.float64]) -> CollisionMesh | None:
    """The world that all worlds of a mesh, and their vertices at these positions, are copies of; None where none is.

    None also where a mesh has more than rigid bodies that move and bodies that stand, whose pairs are excluded by body.
    A particle that is no codimensional point meets faces and half-spaces as others do, and is in no part.
    """
    count, moves = mesh.num_worlds, ~mesh.static
    if (mesh.planes.vertices >= 0).any() or _has_lone_vertices(mesh):
        return None
    if (moves & ~mesh.rigid).any() or mesh.kinematic.any() or {*mesh.exclude_pairs} - {"bodies"}:
        return None
    if count == 1 and positions is mesh.vertices and not mesh.exclude_pairs:
        return mesh
    # all worlds share the half-spaces, whose bodies come last where there are several
    bodies = mesh.num_bodies - (len(mesh.planes) if count > 1 else 0)
    if bodies % count or (count > 1 and (mesh.planes.bodies < bodies).any()):
        return None
    each = bodies // count
    arrays: list[NDArray[Any]] = [
        positions,
        mesh.faces,
        mesh.edges[mesh.codimensional_edges],
        np.diff(mesh.body_vertex_range)[:bodies],
        mesh.static[:bodies],
        mesh.rigid[:bodies],
    ]
    arrays += [mesh.codimensional_points, mesh.vertex_world]
    arrays += [] if mesh.radius is None else [mesh.radius]
    if any(len(x) % count for x in arrays):
        return None
    copies = [x.reshape(count, len(x) // count, *x.shape[1:]) for x in arrays]
    first = np.arange(count)
    of_vertices = first * (mesh.num_vertices // count)
    for k, shift in ((1, of_vertices), (2, of_vertices), (6, of_vertices), (7, first)):
        copies[k] = copies[k] - shift.reshape(count, *[1] * (copies[k].ndim - 1))
    pairs = _allowed(mesh)
    if pairs is not None:
        blocks = pairs[:bodies, :bodies].reshape(count, each, count, each).diagonal(axis1=0, axis2=2)
        shared = pairs[:bodies, bodies:].reshape(count, each, -1)
        if (blocks != blocks[..., :1]).any() or (shared != shared[:1]).any():
            return None
        none = np.zeros((shared.shape[2],) * 2, dtype=bool)  # half-spaces do not meet each other
        pairs = np.block([[blocks[..., 0], shared[0]], [shared[0].T, none]])
    if any((x != x[:1]).any() for x in copies) or (copies[7] != 0).any():
        return None
    vertices, faces, edges, sizes, static, rigid, points = (x[0] for x in copies[:7])
    others = mesh.num_bodies - bodies
    sizes, static, rigid = (
        np.append(x, np.full(others, value, dtype=x.dtype)) for x, value in ((sizes, 0), (static, True), (rigid, False))
    )
    has_points = np.zeros(len(static), dtype=bool)
    has_points[mesh.vertex_body[points]] = True
    names = (*mesh.names[:each], *mesh.names[bodies:])
    planes = mesh.planes if count == 1 else replace(mesh.planes, bodies=mesh.planes.bodies - np.int32(bodies - each))
    return _mesh(
        vertices, faces, edges, sizes, static, rigid, has_points, pairs, np.zeros(len(vertices), np.int32),
        names, None if mesh.radius is None else copies[8][0], planes,
    )  # fmt: skip


def _has_lone_vertices(mesh: CollisionMesh) -> bool:
    """Whether a vertex that may collide is of no primitive."""
    is_used = np.zeros(mesh.num_vertices, dtype=bool)
    is_used[mesh.unused_vertices] = True
    is_used[mesh.faces] = is_used[mesh.edges] = True
    is_used[mesh.codimensional_points] = True
    return not is_used.all()


def _allowed(mesh: CollisionMesh) -> NDArray[np.bool_] | None:
    """Which pairs of bodies may collide; None if all may."""
    if "bodies" not in mesh.exclude_pairs:
        return mesh.body_pairs
    count = mesh.num_bodies
    allowed = np.ones((count, count), dtype=bool) if mesh.body_pairs is None else mesh.body_pairs.copy()
    a, b = mesh.exclude_pairs["bodies"].T
    allowed[a, b] = allowed[b, a] = False
    return allowed


def _mesh(
    vertices: Any, faces: Any, edges: Any, sizes: Any, static: Any, rigid: Any, has_points: Any, pairs: Any,
    world: Any, names: Any, radius: Any, planes: Planes,
) -> CollisionMesh:  # fmt: skip
    none = np.zeros(len(static), dtype=bool)
    return CollisionMesh(
        vertices=np.array(vertices, dtype=np.float64),
        faces=np.array(faces, dtype=np.int32).reshape(-1, 3),
        body_vertex_range=np.append(0, np.cumsum(sizes)).astype(np.int32),
        static=np.array(static),
        kinematic=none.copy(),
        rigid=np.array(rigid),
        self_collision=none.copy(),
        given_edges=np.array(edges, dtype=np.int32).reshape(-1, 2),
        with_codimensional_points=has_points,
        with_inner_vertices=none.copy(),
        body_pairs=pairs,
        exclusion_rings=1,
        vertex_world=np.array(world, dtype=np.int32),
        names=tuple(names),
        exclude_pairs=ExcludedPairs(),
        radius=None if radius is None else np.array(radius),
        planes=planes,
    )


@dataclass(frozen=True, eq=False)
class PartMesh:
    """Some primitives of one world in slices of the step, each slice a world of a mesh.

    Attributes:
        mesh: The mesh; its rigid bodies are links in some slice, those of a slice in their order.
        slice_of_row: The slice of each primitive, ascending, shape [n].
        row: The primitive, as ``NearParts.primitives`` has them, shape [n].
        corners: Its vertices in the mesh, shape [n, 3].
        vertex: The vertex of the one world that each vertex is, shape [V].
        face: The face of the one world that each face is.
        is_used: Which links of each slice are bodies of the mesh, bool, shape [S, L].
        rank: The first row in which each vertex is: primitives in this order are near each other, shape [V].
    """

    mesh: CollisionMesh
    slice_of_row: NDArray[np.intp]
    row: NDArray[np.intp]
    corners: NDArray[np.intp]
    vertex: NDArray[np.intp]
    face: NDArray[np.intp]
    is_used: NDArray[np.bool_]
    rank: NDArray[np.intp]

    @classmethod
    def of(cls, parts: NearParts, count: int, slice_of_row: NDArray[np.intp], row: NDArray[np.intp]) -> PartMesh:
        """The mesh of primitives in so many slices."""
        world = parts.mesh
        size = world.num_vertices
        corners, kind, number = parts.primitives(row)
        keys = slice_of_row[:, None] * size + corners
        unique, first, corners = np.unique(keys, return_index=True, return_inverse=True)
        corners = corners.reshape(keys.shape)
        of_slice, vertex = np.divmod(unique, size)
        body = world.vertex_body[vertex]
        body_keys, sizes = np.unique(of_slice * world.num_bodies + body, return_counts=True)
        slice_of_body, body = np.divmod(body_keys, world.num_bodies)
        planes = world.planes  # their bodies come last
        num_own = len(body)
        body, sizes = np.append(body, planes.bodies), np.append(sizes, np.zeros(len(planes), dtype=sizes.dtype))
        slice_of_body = np.append(slice_of_body, np.zeros(len(planes), dtype=slice_of_body.dtype))
        planes = replace(planes, bodies=(num_own + np.arange(len(planes))).astype(np.int32))
        rigid = world.rigid[body]
        is_used = np.zeros((count, int(world.rigid.sum())), dtype=bool)
        is_used[slice_of_body[rigid], parts.link_of[body[rigid]]] = True
        faces = kind == 0
        mesh = _mesh(
            world.vertices[vertex], corners[faces], corners[kind == 1][:, :2], sizes, world.static[body], rigid,
            np.ones(len(body), dtype=bool), None if world.body_pairs is None else world.body_pairs[np.ix_(body, body)],
            of_slice, [world.names[b] for b in body.tolist()], None if world.radius is None else world.radius[vertex],
            planes,
        )  # fmt: skip
        return cls(mesh, slice_of_row, row, corners, vertex, number[faces], is_used, first // 3)

    def rows_of(self, contacts: Contacts, chosen: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The primitives with a vertex of a contact, in chosen slices: their slices and rows."""
        touched = np.zeros(len(self.vertex), dtype=bool)
        touched[contacts.vertices] = True
        kept = touched[self.corners].any(axis=1) & chosen[self.slice_of_row]
        return self.slice_of_row[kept], self.row[kept]

    def in_worlds(
        self, contacts: Contacts, mesh: CollisionMesh, world: CollisionMesh, of_slice: NDArray[np.intp], **placed: Any
    ) -> Contacts:
        """Contacts as those of a mesh of copies of the one world, or of that itself, given the world of each slice.

        What else is known of their places is ``placed``.
        """
        if len(contacts) == 0:
            return contacts
        copies = of_slice[contacts.world]
        shifts = copies if mesh.num_worlds > 1 else np.zeros_like(copies)
        primitives = contacts.primitives.astype(np.int64)
        for kind in PairKind:
            rows = np.flatnonzero(contacts.kind == int(kind))
            for column, name in enumerate(primitives_of(kind) if len(rows) else ()):
                own = primitives[rows, column]
                number, count = {
                    "vertex": lambda own=own: (self.vertex[own], world.num_vertices),
                    "face": lambda own=own: (self.face[own], world.num_faces),
                    "plane": lambda own=own: (own, 0),
                    "edge": lambda own=own: (_edges(world, self.vertex[self.mesh.edges[own]]), world.num_edges),
                }[name]()
                primitives[rows, column] = number + shifts[rows] * count
        place = ContactPlace(mesh, world=copies.astype(np.int32), **placed)
        return replace(contacts, primitives=primitives.astype(np.int32))._of(place)


def _edges(world: CollisionMesh, ends: NDArray[np.intp]) -> NDArray[np.intp]:
    """The edges of a mesh, which are in the order of (max, min), with these vertices, shape [n, 2]."""
    keys = world.edges[:, 1].astype(np.int64) * world.num_vertices + world.edges[:, 0]
    return np.searchsorted(keys, ends[:, 1] * world.num_vertices + ends[:, 0])
