"""Copies of all bodies of a mesh, in worlds of their own."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._input.arguments import check_count
from ccd_warp._input.names import distinct_names

_MOST_INDICES = np.iinfo(np.int32).max
# Largest number of entries of ``body_pairs``, one byte each, for which a mesh is replicated.
_MOST_BODY_PAIRS = 1 << 30


def replicated(mesh: Any, count: int) -> dict[str, Any]:
    """The arguments of the constructor of :class:`ccd_warp.CollisionMesh` for ``count`` copies of a mesh.

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
    planes = mesh.planes.bodies.astype(np.int64)
    copied = np.setdiff1d(np.arange(mesh.num_bodies), planes)
    bodies = np.append(np.tile(copied, count), planes)  # the body that each body of the copies is one of
    first = (copies * mesh.num_vertices)[:, None, None]
    with_points = np.zeros(mesh.num_bodies, dtype=bool)
    with_points[mesh.vertex_body[mesh.codimensional_points]] = True
    return dict(
        vertices=np.tile(mesh.vertices, (count, 1)),
        faces=(mesh.faces + first).reshape(-1, 3).astype(np.int32),
        body_vertex_range=np.append(0, np.cumsum(np.diff(mesh.body_vertex_range)[bodies])).astype(np.int32),
        static=mesh.static[bodies],
        self_collision=mesh.self_collision[bodies],
        given_edges=(mesh.edges[mesh.codimensional_edges] + first).reshape(-1, 2).astype(np.int32),
        with_codimensional_points=with_points[bodies],
        body_pairs=None if mesh.body_pairs is None else mesh.body_pairs[np.ix_(bodies, bodies)],
        exclusion_rings=mesh.exclusion_rings,
        vertex_world=(mesh.vertex_world + (copies * mesh.num_worlds)[:, None]).ravel().astype(np.int32),
        exclude_pairs={key: _copied(key, pairs, mesh, copies) for key, pairs in mesh.exclude_pairs.items()},
        radius=None if mesh.radius is None else np.tile(mesh.radius, count),
        names=_names(mesh.names, copied.tolist(), planes.tolist(), count),
        planes=replace(mesh.planes, bodies=(count * len(copied) + np.arange(len(planes))).astype(np.int32)),
    )


def _names(names: tuple[str, ...], copied: list[int], planes: list[int], count: int) -> tuple[str, ...]:
    """The names of all copies, with the number of the copy, and those of half-spaces as they are."""
    of_copies = [f"{names[body]}[{w}]" for w in range(count) for body in copied]
    return (*of_copies, *distinct_names([*of_copies, *(names[body] for body in planes)])[len(of_copies) :])


def _copied(key: str, pairs: NDArray[np.int32], mesh: Any, copies: NDArray[np.int64]) -> NDArray[np.int64]:
    """The excluded pairs of every copy. The primitives of a copy follow those of the one before, the edges too."""
    if key == "bodies" and len(mesh.planes):
        return _copied_bodies(pairs, mesh, copies)
    sizes = {"body": mesh.num_bodies, "vertex": mesh.num_vertices, "edge": mesh.num_edges, "face": mesh.num_faces}
    sizes["plane"] = 0  # all copies share the half-spaces
    columns = {
        "bodies": ("body", "body"),
        "vertex_face": ("vertex", "face"),
        "edge_edge": ("edge", "edge"),
        "point_segment": ("vertex", "edge"),
        "vertex_plane": ("vertex", "plane"),
    }.get(key, ("vertex", "vertex"))
    shift = copies[:, None] * [sizes[column] for column in columns]
    shifted: NDArray[np.int64] = (pairs + shift[:, None]).reshape(-1, 2)
    return shifted


def _copied_bodies(pairs: NDArray[np.int32], mesh: Any, copies: NDArray[np.int64]) -> NDArray[np.int64]:
    """The excluded pairs of bodies of every copy, where some bodies are half-spaces, which follow all copies."""
    num_copied = mesh.num_bodies - len(mesh.planes)
    is_plane = np.isin(np.arange(mesh.num_bodies), mesh.planes.bodies)
    number = np.where(is_plane, len(copies) * num_copied + np.cumsum(is_plane) - 1, np.cumsum(~is_plane) - 1)
    shift = np.where(is_plane[pairs], 0, num_copied)
    copied: NDArray[np.int64] = (number[pairs] + copies[:, None, None] * shift).reshape(-1, 2)
    return copied
