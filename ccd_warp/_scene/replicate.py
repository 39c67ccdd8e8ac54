"""Copies of all bodies of a mesh, in worlds of their own."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._scene.input.arguments import check_count
from ccd_warp._scene.input.excluded_pairs import ExcludedPairs
from ccd_warp._scene.input.names import distinct_names

_MOST_INDICES = np.iinfo(np.int32).max
# Largest number of entries of ``body_pairs``, one byte each, for which a mesh is replicated.
_MOST_BODY_PAIRS = 1 << 30


def replicated(mesh: Any, count: int) -> dict[str, Any]:
    """The arguments of `CollisionMesh._of_parts` for ``count`` copies of a mesh.

    Raises:
        ValueError: If ``count`` is not a positive integer, or the copies have more primitives than int32 can index.
    """
    count = check_count("count", count, _MOST_INDICES)
    needed = max(mesh.num_vertices, 3 * mesh.num_faces + len(mesh.codimensional_edges), mesh.num_bodies, 1)
    if count * needed > _MOST_INDICES:
        most = _MOST_INDICES // needed
        raise ValueError(f"count is {count}; expected at most {most} copies, whose primitives int32 can index")
    num_pairs = (count * mesh.num_bodies) ** 2
    if mesh.body_pairs is not None and num_pairs > _MOST_BODY_PAIRS:
        raise ValueError(
            f"count is {count}; expected at most {int(_MOST_BODY_PAIRS**0.5) // mesh.num_bodies} copies of a mesh "
            f"with body_pairs, which holds a flag for each pair of bodies"
        )
    copies = np.arange(count, dtype=np.int64)
    is_shared = mesh.planes.vertices < 0
    num_moving = len(mesh.planes) - int(is_shared.sum())  # half-spaces that are kinematic have copies, as bodies have
    if num_moving * count * count * mesh.num_bodies > _MOST_BODY_PAIRS:
        most = int((_MOST_BODY_PAIRS / num_moving / mesh.num_bodies) ** 0.5)
        raise ValueError(
            f"count is {count}; expected at most {most} copies of a mesh with kinematic half-spaces, which hold a "
            f"flag for each body"
        )
    of_planes = np.append(np.tile(np.flatnonzero(~is_shared), count), np.flatnonzero(is_shared))
    copied, planes = copied_bodies(mesh)
    bodies = bodies_of_copies(mesh, count)
    first = (copies * mesh.num_vertices)[:, None, None]
    with_points, with_inner = np.zeros((2, mesh.num_bodies), dtype=bool)
    with_points[mesh.vertex_body[mesh.codimensional_points]] = True
    with_inner[mesh.vertex_body[mesh.inner_vertices]] = True
    return dict(
        vertices=np.tile(mesh.vertices, (count, 1)),
        faces=(mesh.faces + first).reshape(-1, 3).astype(np.int32),
        body_vertex_range=np.append(0, np.cumsum(np.diff(mesh.body_vertex_range)[bodies])).astype(np.int32),
        static=mesh.static[bodies],
        kinematic=mesh.kinematic[bodies],
        rigid=mesh.rigid[bodies],
        self_collision=mesh.self_collision[bodies],
        listed_edges=(mesh.edges[mesh.codimensional_edges] + first).reshape(-1, 2).astype(np.int32),
        with_codimensional_points=with_points[bodies],
        with_inner_vertices=with_inner[bodies],
        body_pairs=None if mesh.body_pairs is None else mesh.body_pairs[np.ix_(bodies, bodies)],
        exclusion_rings=mesh.exclusion_rings,
        vertex_world=(mesh.vertex_world + (copies * mesh.num_worlds)[:, None]).ravel().astype(np.int32),
        exclude_pairs=ExcludedPairs({k: _copied(k, pairs, mesh, copies) for k, pairs in mesh.exclude_pairs.items()}),
        radius=None if mesh.radius is None else np.tile(mesh.radius, count),
        names=_names(mesh.names, copied.tolist(), planes.tolist(), count),
        planes=_copied_planes(mesh, copies, of_planes, len(copied)),
    )


def bodies_of_copies(mesh: Any, count: int) -> NDArray[np.int64]:
    """The body of a mesh that each body of its copies is one of; half-spaces that stand are last, and once."""
    copied, planes = copied_bodies(mesh)
    return np.append(np.tile(copied, count), planes)


def copied_bodies(mesh: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The bodies of which each copy has its own, and those that all copies share, which come last there."""
    planes = mesh.planes.bodies[mesh.planes.vertices < 0].astype(np.int64)
    return np.setdiff1d(np.arange(mesh.num_bodies), planes), planes


def _names(names: tuple[str, ...], copied: list[int], planes: list[int], count: int) -> tuple[str, ...]:
    """The names of all copies, with the number of the copy, and those of half-spaces as they are."""
    of_copies = [f"{names[body]}[{w}]" for w in range(count) for body in copied]
    return (*of_copies, *distinct_names([*of_copies, *(names[body] for body in planes)])[len(of_copies) :])


def _copied(key: str, pairs: NDArray[np.int32], mesh: Any, copies: NDArray[np.int64]) -> NDArray[np.int64]:
    """The excluded pairs of every copy. The primitives of a copy follow those of the one before, the edges too."""
    if key == "bodies" and len(mesh.planes):
        is_shared = np.isin(np.arange(mesh.num_bodies), mesh.planes.bodies[mesh.planes.vertices < 0])
        return _numbers_of_copies(pairs, is_shared, copies)
    sizes = {"body": mesh.num_bodies, "vertex": mesh.num_vertices, "edge": mesh.num_edges, "face": mesh.num_faces}
    columns = {
        "bodies": ("body", "body"),
        "vertex_face": ("vertex", "face"),
        "edge_edge": ("edge", "edge"),
        "point_segment": ("vertex", "edge"),
    }.get(key, ("vertex", "vertex"))
    if key == "vertex_plane":
        vertices = pairs[:, :1] + (copies * mesh.num_vertices)[:, None, None]
        of_planes = _numbers_of_copies(pairs[:, 1:], mesh.planes.vertices < 0, copies)
        return np.hstack([vertices.reshape(-1, 1), of_planes.reshape(-1, 1)])
    shift = copies[:, None] * [sizes[column] for column in columns]
    shifted: NDArray[np.int64] = (pairs + shift[:, None]).reshape(-1, 2)
    return shifted


def _numbers_of_copies(
    values: NDArray[np.int32], is_shared: NDArray[np.bool_], copies: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Rows of numbers of bodies or planes in every copy, where those that all copies share follow the copies."""
    num_copied = int((~is_shared).sum())
    number = np.where(is_shared, len(copies) * num_copied + np.cumsum(is_shared) - 1, np.cumsum(~is_shared) - 1)
    shift = np.where(is_shared[values], 0, num_copied)
    copied: NDArray[np.int64] = (number[values] + copies[:, None, None] * shift).reshape(-1, values.shape[1])
    return copied


def _copied_planes(mesh: Any, copies: NDArray[np.int64], of_planes: NDArray[np.intp], num_copied: int) -> Any:
    """The planes of all copies, each one of ``of_planes``; ``num_copied`` bodies of the mesh have copies."""
    planes = mesh.planes
    is_shared = np.isin(np.arange(mesh.num_bodies), planes.bodies[planes.vertices < 0])
    moving = np.flatnonzero(planes.vertices >= 0)
    bodies = _numbers_of_copies(planes.bodies[moving][:, None], is_shared, copies).ravel()
    shared = len(copies) * num_copied + np.arange(int(is_shared.sum()))
    vertices = (planes.vertices[moving] + (copies * mesh.num_vertices)[:, None]).ravel()
    return replace(
        planes,
        points=planes.points[of_planes],
        normals=planes.normals[of_planes],
        bodies=np.append(bodies, shared).astype(np.int32),
        vertices=np.append(vertices, np.full(len(shared), -1)).astype(np.int32),
    )
