"""Copies of all bodies of a mesh, in worlds of their own."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._input.arguments import check_count

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
    first = (copies * mesh.num_vertices)[:, None, None]
    with_points = np.zeros(mesh.num_bodies, dtype=bool)
    with_points[mesh.vertex_body[mesh.codimensional_points]] = True
    return dict(
        vertices=np.tile(mesh.vertices, (count, 1)),
        faces=(mesh.faces + first).reshape(-1, 3).astype(np.int32),
        body_vertex_range=np.append(
            (mesh.body_vertex_range[:-1] + first[:, 0]).ravel(), count * mesh.num_vertices
        ).astype(np.int32),
        static=np.tile(mesh.static, count),
        self_collision=np.tile(mesh.self_collision, count),
        given_edges=(mesh.edges[mesh.codimensional_edges] + first).reshape(-1, 2).astype(np.int32),
        with_codimensional_points=np.tile(with_points, count),
        body_pairs=None if mesh.body_pairs is None else np.tile(mesh.body_pairs, (count, count)),
        exclusion_rings=mesh.exclusion_rings,
        vertex_world=(mesh.vertex_world + (copies * mesh.num_worlds)[:, None]).ravel().astype(np.int32),
        exclude_pairs={key: _copied(key, pairs, mesh, copies) for key, pairs in mesh.exclude_pairs.items()},
        radius=None if mesh.radius is None else np.tile(mesh.radius, count),
        names=tuple(f"{name}[{w}]" for w in range(count) for name in mesh.names),
    )


def _copied(key: str, pairs: NDArray[np.int32], mesh: Any, copies: NDArray[np.int64]) -> NDArray[np.int64]:
    """The excluded pairs of every copy. The primitives of a copy follow those of the one before, the edges too."""
    sizes = {"body": mesh.num_bodies, "vertex": mesh.num_vertices, "edge": mesh.num_edges, "face": mesh.num_faces}
    columns = {
        "bodies": ("body", "body"),
        "vertex_face": ("vertex", "face"),
        "edge_edge": ("edge", "edge"),
        "point_segment": ("vertex", "edge"),
    }.get(key, ("vertex", "vertex"))
    shift = copies[:, None] * [sizes[column] for column in columns]
    shifted: NDArray[np.int64] = (pairs + shift[:, None]).reshape(-1, 2)
    return shifted
