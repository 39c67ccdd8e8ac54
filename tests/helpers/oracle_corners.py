"""The corners of a query as vectors of integers that are linear in time, and products of these.

Float64 coordinates are dyadic rationals, so one common power of two makes every coordinate an integer.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from algebraic import Poly

KINDS = ("vertex-face", "edge-edge", "point-segment", "point-point")
POINTS = {"vertex-face": 4, "edge-edge": 4, "point-segment": 3, "point-point": 2}

# Corners V = points[i] - points[j]. The parallelogram goes round, so that consecutive corners share an edge.
CORNERS = {
    "vertex-face": ((0, 1), (0, 2), (0, 3)),
    "edge-edge": ((0, 2), (1, 2), (1, 3), (0, 3)),
    "point-segment": ((0, 1), (0, 2)),
    "point-point": ((0, 1),),
}
# Triangles of corners that together cover K.
TRIANGLES = {"vertex-face": ((0, 1, 2),), "edge-edge": ((0, 1, 2), (0, 2, 3)), "point-segment": (), "point-point": ()}
# Pairs of corners whose segments bound those triangles; a point is the segment from itself to itself.
PAIRS = {
    "vertex-face": ((0, 1), (1, 2), (0, 2)),
    "edge-edge": ((0, 1), (1, 2), (0, 2), (2, 3), (0, 3)),
    "point-segment": ((0, 1),),
    "point-point": ((0, 0),),
}

Line = tuple[tuple[int, ...], tuple[int, ...]]  # the moving vector line[0] + t line[1], three components each


def validated(kind: str, points_t0: np.ndarray, points_t1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points of queries at both ends, float64, shape [n, points of the kind, dimension]."""
    if kind not in KINDS:
        raise ValueError(f"kind is {kind!r}; expected one of {KINDS}")
    p0 = np.asarray(points_t0, dtype=np.float64)
    p1 = np.asarray(points_t1, dtype=np.float64)
    dimensions = (3,) if POINTS[kind] == 4 else (2, 3)
    if p0.ndim != 3 or p0.shape[1] != POINTS[kind] or p0.shape[2] not in dimensions or p1.shape != p0.shape:
        raise ValueError(f"{kind} points have shapes {p0.shape} and {p1.shape}; expected [n, {POINTS[kind]}, 3] twice")
    if not (np.isfinite(p0).all() and np.isfinite(p1).all()):
        raise ValueError("points hold non-finite values")
    return p0, p1


def integer_rows(values: np.ndarray) -> list[list[int]]:
    """Each row times its own power of two, so that all entries are integers and at least one is odd."""
    mantissa, exponent = np.frexp(values)
    mantissa = np.ldexp(mantissa, 53).astype(np.int64)
    exponent = np.where(mantissa == 0, np.iinfo(np.int32).max, exponent)
    shift = np.where(mantissa == 0, 0, exponent - exponent.min(axis=1, keepdims=True, initial=2000))
    rows = []
    for row, by in zip(mantissa.tolist(), shift.tolist(), strict=True):
        integers = [m << s for m, s in zip(row, by, strict=True)]
        bits = 0
        for value in integers:
            bits |= value
        zeros = (bits & -bits).bit_length() - 1
        rows.append([value >> zeros for value in integers] if zeros > 0 else integers)
    return rows


def moving_corners(kind: str, row: list[int], dimension: int, t_max: tuple[int, int]) -> list[Line]:
    """Corners as lines in s = t / t_max, times the denominator of t_max, from the flat integers of both ends."""
    p, q = t_max
    n = POINTS[kind] * dimension
    pad = (0,) * (3 - dimension)
    corners = []
    for i, j in CORNERS[kind]:
        i, j = i * dimension, j * dimension
        start = tuple(row[i + k] - row[j + k] for k in range(dimension))
        motion = tuple(row[n + i + k] - row[n + j + k] - start[k] for k in range(dimension))
        if q != 1:
            start = tuple(q * x for x in start)
        if p != 1:
            motion = tuple(p * x for x in motion)
        corners.append((start + pad, motion + pad))
    return corners


def component(a: Line, b: Line, k: int) -> Poly:
    """Component k of the cross product of two moving vectors, degree two in t."""
    i, j = (k + 1) % 3, (k + 2) % 3
    (a0, a1), (b0, b1) = a, b
    return (
        a0[i] * b0[j] - a0[j] * b0[i],
        a0[i] * b1[j] + a1[i] * b0[j] - a0[j] * b1[i] - a1[j] * b0[i],
        a1[i] * b1[j] - a1[j] * b1[i],
    )


def dot(a: Line, b: Line) -> Poly:
    (a0, a1), (b0, b1) = a, b
    return (
        a0[0] * b0[0] + a0[1] * b0[1] + a0[2] * b0[2],
        a0[0] * b1[0] + a0[1] * b1[1] + a0[2] * b1[2] + a1[0] * b0[0] + a1[1] * b0[1] + a1[2] * b0[2],
        a1[0] * b1[0] + a1[1] * b1[1] + a1[2] * b1[2],
    )


def difference(a: Line, b: Line) -> Line:
    (a0, a1), (b0, b1) = a, b
    return (tuple(map(int.__sub__, a0, b0)), tuple(map(int.__sub__, a1, b1)))


def times_line(quadratic: Poly, line: Line, k: int) -> Poly:
    """A quadratic times component k of a moving vector, degree three in t."""
    c0, c1, c2 = quadratic
    x0, x1 = line[0][k], line[1][k]
    return (c0 * x0, c0 * x1 + c1 * x0, c1 * x1 + c2 * x0, c2 * x1)


def total(polys: Iterable[Poly]) -> Poly:
    return tuple(sum(c) for c in zip(*polys, strict=True))
