"""Meshes of parts of a mesh of one world, those that may touch in a world of a motion a world of their own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._rigid.parts.overlap import BodyParts
from ccd_warp._scene.half_space import Planes
from ccd_warp._scene.input.excluded_pairs import ExcludedPairs
from ccd_warp._scene.mesh import CollisionMesh

# Bodies of a mesh of parts at most, or one world's: pairs of them that may collide take a byte each.
MOST_BODIES = 1 << 13
_BYTES_OF_A_ROW = 1024  # of a primitive with its boxes and pairs, about


def rows_within(memory_limit: int | None, most: int) -> int:
    """How many primitives a mesh may have, and no more than that."""
    return most if memory_limit is None else min(most, memory_limit // _BYTES_OF_A_ROW)


def parts_of(mesh: CollisionMesh, positions: NDArray[np.float64]) -> BodyParts | None:
    """The parts of the bodies of a mesh of one world, of rigid bodies and others that stand, at these positions.

    None where a vertex that may collide is of no primitive: it is in no part, and meets faces and half-spaces.
    """
    if _has_lone_vertices(mesh):
        return None
    # a mesh of parts knows the pairs of bodies that are excluded, and no others
    if mesh.kinematic.any() or {*mesh.exclude_pairs} - {"bodies"}:
        return BodyParts(mesh, positions, may_be_cut=False)
    if positions is not mesh.vertices or mesh.exclude_pairs:
        has_points = np.zeros(mesh.num_bodies, dtype=bool)
        has_points[mesh.vertex_body[mesh.codimensional_points]] = True
        mesh = _mesh(
            positions, mesh.faces, mesh.edges[mesh.codimensional_edges], np.diff(mesh.body_vertex_range), mesh.static,
            mesh.rigid, has_points, _allowed(mesh), mesh.vertex_world, mesh.names, mesh.radius, mesh.planes,
        )  # fmt: skip
    return BodyParts(mesh, mesh.vertices)


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
    return CollisionMesh._of_parts(
        vertices=np.array(vertices, dtype=np.float64),
        faces=np.array(faces, dtype=np.int32).reshape(-1, 3),
        body_vertex_range=np.append(0, np.cumsum(sizes)).astype(np.int32),
        static=np.array(static),
        kinematic=none.copy(),
        rigid=np.array(rigid),
        self_collision=none.copy(),
        listed_edges=np.array(edges, dtype=np.int32).reshape(-1, 2),
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
    """Some primitives of a mesh of one world in each of several worlds.

    Attributes:
        mesh: The mesh; its rigid bodies are those that have a primitive in some world, those of a world in their order.
        vertex: The vertex of the one world that each vertex is, shape [V].
        face: The face of the one world that each face is.
        is_used: Which rigid bodies of each world are bodies of the mesh, bool, shape [W, B].
        rank: The first row in which each vertex is: primitives in this order are near each other, shape [V].
        body: The numbers of the bodies with primitives, those of one world after those of another, ascending.
    """

    mesh: CollisionMesh
    vertex: NDArray[np.intp]
    face: NDArray[np.intp]
    is_used: NDArray[np.bool_]
    rank: NDArray[np.intp]
    body: NDArray[np.intp]

    @classmethod
    def of(cls, parts: BodyParts, count: int, world_of_row: NDArray[np.intp], row: NDArray[np.intp]) -> PartMesh:
        """The mesh of primitives, as ``BodyParts.primitives`` has them, in so many worlds, ascending."""
        one = parts.mesh
        size = one.num_vertices
        corners, kind, number = parts.primitives(row)
        keys = world_of_row[:, None] * size + corners
        unique, first, corners = np.unique(keys, return_index=True, return_inverse=True)
        corners = corners.reshape(keys.shape)
        world, vertex = np.divmod(unique, size)
        body = one.vertex_body[vertex]
        body_keys, sizes = np.unique(world * one.num_bodies + body, return_counts=True)
        world_of_body, body = np.divmod(body_keys, one.num_bodies)
        planes = one.planes  # their bodies come last
        first_plane = len(body)
        body, sizes = np.append(body, planes.bodies), np.append(sizes, np.zeros(len(planes), dtype=sizes.dtype))
        world_of_body = np.append(world_of_body, np.zeros(len(planes), dtype=world_of_body.dtype))
        planes = replace(planes, bodies=(first_plane + np.arange(len(planes))).astype(np.int32))
        rigid = one.rigid[body]
        is_used = np.zeros((count, int(one.rigid.sum())), dtype=bool)
        is_used[world_of_body[rigid], parts.row_of[body[rigid]]] = True
        faces = kind == 0
        mesh = _mesh(
            one.vertices[vertex], corners[faces], corners[kind == 1][:, :2], sizes, one.static[body], rigid,
            np.ones(len(body), dtype=bool), None if one.body_pairs is None else one.body_pairs[np.ix_(body, body)],
            world, [one.names[b] for b in body.tolist()], None if one.radius is None else one.radius[vertex], planes,
        )  # fmt: skip
        return cls(mesh, vertex, number[faces], is_used, first // 3, body_keys)
