"""Whether and where two primitives intersect, decided in integers.

A float64 is an integer times a power of two, so all coordinates become integers by one scale, however large. Every test
takes points as triples of integers, and returns the parameters of a common point, or None if there is none; those of a
pair that overlaps in a segment are of the middle of that segment. A quotient of two integers is rounded correctly.
"""

from collections.abc import Callable, Sequence
from itertools import starmap

import numpy as np
from numpy.typing import NDArray

Point = tuple[int, int, int]
# (u, v), and the parameter on the edge that meets a face, or 0.
Parameters = tuple[float, float, float]
_MANTISSA = 53


def integer_points(x: NDArray[np.float64], vertices: NDArray[np.int32]) -> dict[int, Point]:
    """The positions of vertices as integers of one unit, by vertex."""
    used_vertices = np.unique(vertices)
    mantissa, exponent = np.frexp(x[used_vertices])
    integer = np.ldexp(mantissa, _MANTISSA).astype(np.int64)
    least = int(exponent[integer != 0].min(initial=exponent.max(initial=0)))
    shift = np.where(integer != 0, exponent - least, 0)
    rows = ([m << s for m, s in zip(*row, strict=True)] for row in zip(integer.tolist(), shift.tolist(), strict=True))
    return {v: (a, b, c) for v, (a, b, c) in zip(used_vertices.tolist(), rows, strict=True)}


def _minus(a: Point, b: Point) -> Point:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _cross(a: Point, b: Point) -> Point:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _dot(a: Point, b: Point) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _longest_axis(n: Point) -> int:
    return max(range(3), key=lambda k: abs(n[k]))


def edge_through_face(p: Point, q: Point, a: Point, b: Point, c: Point) -> Parameters | None:
    """The inside of an edge from one side of a face to the other through the inside of the face."""
    ab, ac = _minus(b, a), _minus(c, a)
    n = _cross(ab, ac)
    p_side, q_side = _dot(n, _minus(p, a)), _dot(n, _minus(q, a))
    if p_side * q_side >= 0:
        return None
    d, pa, pb, pc = _minus(q, p), _minus(a, p), _minus(b, p), _minus(c, p)
    at_c, at_a, at_b = _dot(d, _cross(pa, pb)), _dot(d, _cross(pb, pc)), _dot(d, _cross(pc, pa))
    if not (at_a > 0 and at_b > 0 and at_c > 0) and not (at_a < 0 and at_b < 0 and at_c < 0):
        return None
    total = at_a + at_b + at_c
    return at_b / total, at_c / total, p_side / (p_side - q_side)


def vertex_in_face(v: Point, a: Point, b: Point, c: Point) -> Parameters | None:
    """A vertex in a closed face; a face without area is the segments between its vertices."""
    ab, ac, av = _minus(b, a), _minus(c, a), _minus(v, a)
    n = _cross(ab, ac)
    if _dot(n, av) != 0:
        return None
    k = _longest_axis(n)
    if n[k] == 0:
        sides: tuple[tuple[Point, Point, Callable[[float], Parameters]], ...] = (
            (a, b, lambda t: (t, 0.0, 0.0)),
            (a, c, lambda t: (0.0, t, 0.0)),
            (b, c, lambda t: (1.0 - t, t, 0.0)),
        )
        for low, high, parameters in sides:
            on_side = point_on_segment(v, low, high)
            if on_side is not None:
                return parameters(on_side[0])
        return None
    area, along_ab, along_ac = n[k], _cross(av, ac)[k], _cross(ab, av)[k]
    if area < 0:
        area, along_ab, along_ac = -area, -along_ab, -along_ac
    if along_ab < 0 or along_ac < 0 or along_ab + along_ac > area:
        return None
    return along_ab / area, along_ac / area, 0.0


def point_on_segment(p: Point, a: Point, b: Point) -> Parameters | None:
    """A point on a closed segment, which may have no length."""
    d, w = _minus(b, a), _minus(p, a)
    if any(_cross(d, w)):
        return None
    length, along = _dot(d, d), _dot(w, d)
    if length == 0:
        return None if any(w) else (0.0, 0.0, 0.0)
    return (along / length, 0.0, 0.0) if 0 <= along <= length else None


def edges_meet(p: Point, q: Point, r: Point, s: Point) -> Parameters | None:
    """Two closed edges that have a common point."""
    d, e, w = _minus(q, p), _minus(s, r), _minus(r, p)
    n = _cross(d, e)
    if _dot(n, w) != 0:
        return None
    k = _longest_axis(n)
    if n[k] == 0:
        return _parallel_edges_meet(p, q, r, s)
    size, along_d, along_e = n[k], _cross(w, e)[k], _cross(w, d)[k]
    if size < 0:
        size, along_d, along_e = -size, -along_d, -along_e
    if not (0 <= along_d <= size and 0 <= along_e <= size):
        return None
    return along_d / size, along_e / size, 0.0


def _parallel_edges_meet(p: Point, q: Point, r: Point, s: Point) -> Parameters | None:
    """The middle of the segment in which two parallel edges, or edges without length, overlap; its ends are theirs."""
    ends = [
        (place[0], v) if of_first else (v, place[0])
        for of_first, v, place in (
            (True, 0.0, point_on_segment(r, p, q)),
            (True, 1.0, point_on_segment(s, p, q)),
            (False, 0.0, point_on_segment(p, r, s)),
            (False, 1.0, point_on_segment(q, r, s)),
        )
        if place is not None
    ]
    if not ends:
        return None
    (u0, v0), (u1, v1) = min(ends), max(ends)
    return 0.5 * (u0 + u1), 0.5 * (v0 + v1), 0.0


def edges_cross_in_plane(p: Point, q: Point, r: Point, s: Point) -> Parameters | None:
    """The insides of two edges in the plane z = 0 that cross each other in one point."""
    d, e, w = _minus(q, p), _minus(s, r), _minus(r, p)
    size, along_d, along_e = _cross(d, e)[2], _cross(w, e)[2], _cross(w, d)[2]
    if size < 0:
        size, along_d, along_e = -size, -along_d, -along_e
    if not (0 < along_d < size and 0 < along_e < size):
        return None
    return along_d / size, along_e / size, 0.0


def points_equal(p: Point, q: Point) -> Parameters | None:
    """Two points in one place."""
    return (0.0, 0.0, 0.0) if p == q else None


def decide(
    test: Callable[..., Parameters | None], x: NDArray[np.float64], corners: NDArray[np.int32]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Apply a test to pairs with these vertices, [n, k]: whether each passes, and its parameters, shape [n, 3]."""
    points = integer_points(x, corners)
    of_pairs: list[Sequence[Point]] = [[points[v] for v in row] for row in corners.tolist()]
    rows = list(starmap(test, of_pairs))
    passes = np.array([row is not None for row in rows], dtype=bool)
    parameters = np.zeros((len(rows), 3))
    parameters[passes] = np.array([row for row in rows if row is not None], dtype=np.float64).reshape(-1, 3)
    return passes, parameters
