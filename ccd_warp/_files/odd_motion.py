"""What is odd about the motion between two frames of files, where they hardly mean what they say."""

import numpy as np
from numpy.typing import NDArray

from ccd_warp._runtime.display import listed
from ccd_warp._scene.mesh import CollisionMesh

# Frames whose sizes differ by this factor are hardly in the same unit.
_OTHER_UNIT = 100.0
# An edge of which less than this share is left within the step is hardly meant to move on straight lines.
_SHRUNK = 0.1


def motion_warnings(
    mesh: CollisionMesh, vertices_t0: NDArray[np.float64], vertices_t1: NDArray[np.float64], t_max: float = 1.0
) -> list[str]:
    """What is odd about a motion, a sentence each; of frames in different units nothing else is said."""
    vertices = mesh._surface_vertices
    moving = vertices[~mesh.static[mesh.vertex_body[vertices]]]
    if not len(moving):
        return []
    with np.errstate(all="ignore"):
        sizes = [float(np.ptp(frame[moving], axis=0).max()) for frame in (vertices_t0, vertices_t1)]
        small, large = sorted(sizes)
        if large > 0.0 and small * _OTHER_UNIT <= large:
            return [
                f"the bodies that move are {sizes[0]:.6g} long at the start and {sizes[1]:.6g} at the end of the step; "
                "are both frames in the same unit?"
            ]
        shrunk = _shrunk_edges(mesh, vertices_t0, vertices_t1, t_max)
    return _renumbered(mesh, moving, vertices_t0, vertices_t1) + shrunk


def _renumbered(
    mesh: CollisionMesh,
    moving: NDArray[np.int32],
    vertices_t0: NDArray[np.float64],
    vertices_t1: NDArray[np.float64],
) -> list[str]:
    """A sentence on vertices that end where others of them start, those of a body or of all that move."""
    bodies = mesh.vertex_body[moving]
    first = np.flatnonzero(np.append(True, bodies[1:] != bodies[:-1]))
    names = [mesh.names[body] for body in bodies[first]]
    odd = [
        name
        for name, vertices in zip(names, np.split(moving, first[1:]), strict=True)
        if _is_permuted(vertices_t0[vertices], vertices_t1[vertices])
    ]
    if not odd and _is_permuted(vertices_t0[moving], vertices_t1[moving]):
        odd = ["all bodies that move"]
    return [
        f"the vertices of {listed(odd)} are at the same places at the start and at the end of the step, in another "
        "order; were they renumbered between the frames? Both need the same vertices in the same order"
    ][: len(odd)]


def _is_permuted(start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
    """Whether the rows are the same in another order."""
    if any((f(start, axis=0) != f(end, axis=0)).any() for f in (np.min, np.max)) or np.array_equal(start, end):
        return False
    return np.array_equal(start[np.lexsort(start.T)], end[np.lexsort(end.T)])


def _shrunk_edges(
    mesh: CollisionMesh, vertices_t0: NDArray[np.float64], vertices_t1: NDArray[np.float64], t_max: float
) -> list[str]:
    edges = mesh.edges[~mesh.static[mesh.edge_body]]
    unit = float(np.abs(vertices_t0[edges]).max(initial=0.0)) or 1.0
    start, end = ((frame[edges[:, 1]] - frame[edges[:, 0]]) / unit for frame in (vertices_t0, vertices_t1))
    change = end - start
    # The square of the length is a parabola in t.
    squared = np.einsum("ij,ij->i", change, change)
    t = np.clip(-np.einsum("ij,ij->i", start, change) / np.where(squared > 0.0, squared, 1.0), 0.0, t_max)
    share = np.linalg.norm(start + t[:, None] * change, axis=1) / np.linalg.norm(start, axis=1)
    shrunk = np.flatnonzero(share <= _SHRUNK)  # not those without a length, whose share is not a number
    if not len(shrunk):
        return []
    k = shrunk[np.argmin(share[shrunk])]
    body = mesh.vertex_body[edges[k, 0]]
    a, b = (edges[k] - mesh.body_vertex_range[body]).tolist()
    return [
        f"{len(shrunk):,} of {len(edges):,} edges shrink to a tenth or less within the step, edge {a}-{b} of "
        f"{mesh.names[body]} to {share[k]:.2g} of its length at t = {t[k]:.2g}; vertices move on straight lines, and a "
        "rotation is replaced by its chords: take smaller steps"
    ]
