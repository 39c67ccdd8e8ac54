"""Meshes of parts of a mesh of one world: of those that may touch in a step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._rigid.parts.overlap import BodyParts
from ccd_warp._rigid.parts.trees import ranges
from ccd_warp._scene.half_space import Planes
from ccd_warp._scene.input.excluded_pairs import ExcludedPairs
from ccd_warp._scene.mesh import CollisionMesh


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
    """Some primitives of a mesh of one world.

    Attributes:
        mesh: The mesh; its bodies are those that have a primitive, in their order, and the half-spaces.
        vertex: The vertex of the one world that each vertex is, shape [V].
        face: The face of the one world that each face is.
        is_used: Which rigid bodies are bodies of the mesh, bool, shape [B].
        rank: The first row in which each vertex is: primitives in this order are near each other, shape [V].
        body: The bodies with primitives, ascending.
    """

    mesh: CollisionMesh
    vertex: NDArray[np.intp]
    face: NDArray[np.intp]
    is_used: NDArray[np.bool_]
    rank: NDArray[np.intp]
    body: NDArray[np.intp]

    @classmethod
    def of(cls, parts: BodyParts, part: NDArray[np.intp]) -> PartMesh:
        """The mesh of the primitives of some parts, ascending."""
        one, first = parts.mesh, parts.begins
        corners, kind, number = parts.primitives(ranges(first[part], np.diff(first)[part]))
        vertex, first, of_rows = np.unique(corners, return_index=True, return_inverse=True)
        corners = of_rows.reshape(corners.shape)
        of_parts, sizes = np.unique(one.vertex_body[vertex], return_counts=True)
        planes = one.planes  # their bodies come last
        body, sizes = np.append(of_parts, planes.bodies), np.append(sizes, np.zeros(len(planes), dtype=sizes.dtype))
        planes = replace(planes, bodies=(len(of_parts) + np.arange(len(planes))).astype(np.int32))
        rigid = one.rigid[body]
        is_used = np.zeros(int(one.rigid.sum()), dtype=bool)
        is_used[parts.row_of[body[rigid]]] = True
        faces = kind == 0
        mesh = _mesh(
            one.vertices[vertex], corners[faces], corners[kind == 1][:, :2], sizes, one.static[body], rigid,
            np.ones(len(body), dtype=bool), None if one.body_pairs is None else one.body_pairs[np.ix_(body, body)],
            np.zeros(len(vertex)), [one.names[b] for b in body.tolist()],
            None if one.radius is None else one.radius[vertex], planes,
        )  # fmt: skip
        return cls(mesh, vertex, number[faces], is_used, first // 3, body[: len(body) - len(planes)].astype(np.intp))
