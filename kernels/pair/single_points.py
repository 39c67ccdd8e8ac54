"""The points of single pairs in float64: read from arrays, and how they move."""

import warp as wp

from ..pair_kind import EDGE_EDGE
from .points import Points, corners, largest, scaled, total

__all__ = [
    "Points",
    "corners",
    "is_stationary",
    "largest",
    "points_of",
    "relative_motion",
    "row_points",
    "scaled",
    "total",
]

vec3d = wp.vec3d


@wp.func
def points_of(kind: int, first: wp.vec3i, second: wp.vec3i, x: wp.array[vec3d]) -> Points:
    """Points of a pair of primitives of a mesh, from the vertices of each."""
    p = Points()
    p.p0 = x[first[0]]
    if kind == EDGE_EDGE:
        p.p1 = x[first[1]]
        p.p2 = x[second[0]]
        p.p3 = x[second[1]]
    else:
        p.p1 = x[second[0]]
        p.p2 = x[second[1]]
        p.p3 = x[second[2]]
    return p


@wp.func
def is_stationary(a: Points, b: Points) -> bool:
    """Whether no point of a pair moves between two times."""
    return a.p0 == b.p0 and a.p1 == b.p1 and a.p2 == b.p2 and a.p3 == b.p3


@wp.func
def relative_motion(a: Points, b: Points) -> wp.float64:
    """Largest relative displacement (L∞) of any two points of a pair between two times."""
    low = vec3d()
    high = vec3d()
    for k in range(3):
        d0 = b.p0[k] - a.p0[k]
        d1 = b.p1[k] - a.p1[k]
        d2 = b.p2[k] - a.p2[k]
        d3 = b.p3[k] - a.p3[k]
        low[k] = wp.min(wp.min(d0, d1), wp.min(d2, d3))
        high[k] = wp.max(wp.max(d0, d1), wp.max(d2, d3))
    d = high - low
    return wp.max(wp.max(d[0], d[1]), d[2])


@wp.func
def row_points(x: wp.array2d[vec3d], i: int) -> Points:
    """Points of a row; missing points repeat the last one, so that they enlarge no box."""
    p = Points()
    p.p0 = x[i, 0]
    p.p1 = x[i, 1]
    p.p2 = x[i, wp.min(2, x.shape[1] - 1)]
    p.p3 = x[i, wp.min(3, x.shape[1] - 1)]
    return p
