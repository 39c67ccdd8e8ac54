"""Bodies of long thin parts side by side, whose own pairs are searched in a frame along these parts."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ccd_warp._engine.mesh.samples import uneven_samples

if TYPE_CHECKING:
    from ccd_warp._scene.mesh import CollisionMesh

# Pairs of edges of a body with boxes that overlap in any frame, from which on a search of its own is worth its cost,
# and of how many of them there may be one in the frame of the body.
_MANY_PAIRS, _LEAST_GAIN = 1 << 20, 8
# Edges from which both are estimated, and which of them, from the longest on, may give the direction of the frame.
_SAMPLES, _TRIED = 128, (0, 16, 32, 64)
# Turns the first axis to the diagonal of a cube, so that what is long along it is long along all axes.
_OBLIQUE = np.array([[1.0, 1.0, 0.0], [1.0, -0.5, np.sqrt(0.75)], [1.0, -0.5, -np.sqrt(0.75)]]) * np.sqrt(
    [1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0]
)


class SlenderBodies(NamedTuple):
    """Slender bodies of a mesh; which they are depends on its vertices alone, not on a step.

    Attributes:
        bodies: Their indices, ascending, shape [n].
        edge: The vertices of an edge of each along which its frame lies, int32, shape [n, 2].
        size: How far a vertex of each is from the first one of its edge along an axis, float64, shape [n].
    """

    bodies: NDArray[np.intp]
    edge: NDArray[np.int32]
    size: NDArray[np.float64]


def slender_bodies(mesh: "CollisionMesh") -> SlenderBodies | None:
    """The bodies that collide with themselves and have far fewer overlapping boxes in a frame of their own, if any."""
    count = np.bincount(mesh.edge_body, minlength=mesh.num_bodies)
    many = np.flatnonzero(mesh._is_free & mesh.self_collision & (count.astype(np.float64) ** 2 > 2.0 * _MANY_PAIRS))
    if len(many) == 0:
        return None
    order = np.argsort(mesh.edge_body, kind="stable")
    first = np.cumsum(count) - count
    edges = {}
    for body in many.tolist():
        sampled = mesh.edges[order[first[body] + uneven_samples(int(count[body]), _SAMPLES)]]
        along = _edge_along(mesh._vertices_in_space[sampled], int(count[body]))
        if along is not None:
            edges[body] = sampled[along]
    if not edges:
        return None
    bodies, edge = np.array(list(edges)), np.array(list(edges.values()), dtype=np.int32)
    size = [_size_of(mesh, body, int(origin)) for body, origin in zip(bodies.tolist(), edge[:, 0], strict=True)]
    return SlenderBodies(bodies, edge, np.array(size))


def _size_of(mesh: "CollisionMesh", body: int, origin: int) -> float:
    """How far a vertex of a body is from another one along an axis, a finite number."""
    begin, end = mesh.body_vertex_range[body : body + 2]
    with np.errstate(over="ignore"):
        distance = np.abs(mesh._vertices_in_space[begin:end] - mesh._vertices_in_space[origin]).max()
    return float(min(distance, np.finfo(np.float64).max))


def _edge_along(points: NDArray[np.float64], count: int) -> int | None:
    """Along which of the sampled edges, shape [n, 2, 3], far fewer of all ``count`` edges overlap, if there is one."""
    with np.errstate(all="ignore"):
        points = points / np.abs(points).max()
        points = points - points.mean(axis=(0, 1))
        along = points[:, 1] - points[:, 0]
        length = np.linalg.norm(along, axis=1)
        longest = np.argsort(-length, kind="stable")[list(_TRIED)]
        in_any = _share_of_overlaps(points @ _axes(along[longest[0]]).T @ _OBLIQUE.T)
        if not in_any * count**2 > 2.0 * _MANY_PAIRS:
            return None
        shares = [_share_of_overlaps(points @ _axes(along[k]).T) for k in longest]
    least = int(np.argmin(shares))
    return int(longest[least]) if shares[least] * _LEAST_GAIN <= in_any else None


def _axes(first: NDArray[np.float64]) -> NDArray[np.float64]:
    """Three perpendicular unit vectors, the first of which is parallel to the given one."""
    axes: NDArray[np.float64] = np.linalg.qr(np.column_stack([first, np.eye(3)]))[0].T
    return axes


def _share_of_overlaps(points: NDArray[np.float64]) -> float:
    """The share of the pairs of these edges whose boxes overlap."""
    lower, upper = points.min(axis=1), points.max(axis=1)
    overlaps = lower[:, None, 0] <= upper[:, 0]
    for k in (1, 2):
        overlaps &= lower[:, None, k] <= upper[:, k]
    overlaps = overlaps & overlaps.T
    num = len(points)
    return float((overlaps.sum() - num) / (num * (num - 1)))
