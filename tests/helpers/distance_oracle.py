"""Exact oracle of Euclidean distances: when two primitives first come within a distance, by signs of polynomials.

The corners V_i(t) of `oracle_corners` are linear in t, and K(t) is their hull. The distance from the origin to K(t) is
attained at a corner, inside a side or inside a triangle, and each of these comes within D where a polynomial is not
positive:

    corner    |V|² - D²                          degree 2
    side      |V_i × V_j|² - D²·|V_j - V_i|²     degree 4, if the foot of the perpendicular lies on the side
    triangle  det² - D²·|Q × R|²                 degree 6, if the foot lies in the triangle

Whether the foot lies there is again the sign of polynomials. The distance is continuous. So K is within D at the start,
or it first comes within D when the distance of one feature, with its foot on it, becomes D. Take the feature of least
dimension that holds the nearest point: its polynomial vanishes there. If it vanished identically, the foot would have
been on the feature shortly before, at the same distance, or have come in across its boundary, which is a feature of
less dimension. So the first time is 0 or a root of one of these polynomials, and every root is tested.

No code or idea is shared with the kernels.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import cmp_to_key
from typing import NamedTuple

import numpy as np
from algebraic import ZERO, Poly, Root, unit_roots
from exact_toi import ExactToi
from oracle import certainly_apart
from oracle_corners import (
    PAIRS,
    TRIANGLES,
    Line,
    component,
    difference,
    dot,
    integer_rows,
    moving_corners,
    times_line,
    total,
    validated,
)


class _Feature(NamedTuple):
    """A feature of K: it is within D where ``within`` <= 0, ``proper`` > 0 and all ``inside`` >= 0."""

    within: Poly
    proper: Poly  # squared length or area, up to a factor; positive for a corner
    inside: tuple[Poly, ...]


def _product(a: Poly, b: Poly) -> Poly:
    result = [0] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        if x:
            for j, y in enumerate(b):
                result[i + j] += x * y
    return tuple(result)


def _minus(a: Poly, b: Poly) -> Poly:
    n = max(len(a), len(b))
    a, b = a + (0,) * (n - len(a)), b + (0,) * (n - len(b))
    return tuple(map(int.__sub__, a, b))


def _times(k: int, a: Poly) -> Poly:
    return tuple(k * x for x in a)


def _cross(a: Line, b: Line) -> list[Poly]:
    return [component(a, b, k) for k in range(3)]


def _square(vector: list[Poly]) -> Poly:
    return total(_product(x, x) for x in vector)


def _dots(a: list[Poly], b: list[Poly]) -> Poly:
    return total(_product(x, y) for x, y in zip(a, b, strict=True))


def _features(kind: str, corners: list[Line], d: int) -> list[_Feature]:
    """The corners, sides and triangles of K, for a distance d."""
    squared = d * d
    features = [_Feature(_minus(dot(v, v), (squared,)), (1,), ()) for v in corners]
    for i, j in PAIRS[kind]:
        if i == j:
            continue
        a, b = corners[i], corners[j]
        side = difference(b, a)
        length = dot(side, side)
        within = _minus(_square(_cross(a, b)), _times(squared, length))
        features.append(_Feature(within, length, (_times(-1, dot(a, side)), dot(b, side))))
    for i, j, m in TRIANGLES[kind]:
        a, b, c = corners[i], corners[j], corners[m]
        normal = _cross(difference(b, a), difference(c, a))
        area = _square(normal)
        volume = total(times_line(normal[k], a, k) for k in range(3))
        within = _minus(_product(volume, volume), _times(squared, area))
        # the foot is on the inner side of the side from x to y where (x × y)·n >= 0
        inside = tuple(_dots(_cross(x, y), normal) for x, y in ((a, b), (b, c), (c, a)))
        features.append(_Feature(within, area, inside))
    return features


def _is_within(features: list[_Feature], t: Root) -> bool:
    """Whether K is within the distance at t."""
    for feature in features:
        if t.sign_of(feature.within) <= 0 and t.sign_of(feature.proper) > 0:
            if all(t.sign_of(poly) >= 0 for poly in feature.inside):
                return True
    return False


def _first_within(features: list[_Feature]) -> Root | None:
    if _is_within(features, ZERO):
        return ZERO
    roots = [root for feature in features if any(feature.within) for root in unit_roots(feature.within)]
    roots.sort(key=cmp_to_key(Root.compare))
    return next((root for root in roots if _is_within(features, root)), None)


def _lines(kind: str, p0: np.ndarray, p1: np.ndarray, distance: float, t_max: float) -> tuple[list[Line], int]:
    """Corners and the distance as integers, from the points of one query."""
    dimension = p0.shape[1]
    row = integer_rows(np.concatenate([p0.ravel(), p1.ravel(), [distance]])[None])[0]
    ratio = t_max.as_integer_ratio()
    return moving_corners(kind, row, dimension, ratio), row[-1] * ratio[1]


def exact_distance_tois(
    kind: str, points_t0: np.ndarray, points_t1: np.ndarray, distance: float | np.ndarray, t_max: float = 1.0
) -> list[ExactToi]:
    """Exact earliest times at which primitives are within a Euclidean distance.

    Args:
        kind: "vertex-face", "edge-edge", "point-segment" or "point-point".
        points_t0: Positions at t = 0, float64, shape [n, 4, 3] ([n, 3, 2 or 3] and [n, 2, 2 or 3] for the last two).
        points_t1: Positions at t = 1, same shape.
        distance: Above 0, in the unit of the points; its float64 value is exact. One, or one for each query.
        t_max: End of the step; its float64 value is exact.

    Returns:
        One result for each query.
    """
    p0, p1 = validated(kind, points_t0, points_t1)
    distances = np.broadcast_to(np.asarray(distance, dtype=np.float64), len(p0))
    if not ((distances > 0.0) & np.isfinite(distances)).all():
        raise ValueError(f"distance is {distance}; expected a finite number above 0")
    if not 0.0 <= t_max <= 1.0:
        raise ValueError(f"t_max is {t_max}; expected a number in [0, 1]")
    # the cull of the maximum norm checks the box around the ball, over the whole of [0, 1]
    apart = certainly_apart(kind, p0, p1, float(distances.max(initial=0.0)))
    results = []
    for start, end, own, is_apart in zip(p0, p1, distances.tolist(), apart.tolist(), strict=True):
        root = None
        if not is_apart:
            root = _first_within(_features(kind, *_lines(kind, start, end, own, float(t_max))))
        results.append(ExactToi(root, float(t_max)))
    return results


def is_within(kind: str, points_t0: np.ndarray, points_t1: np.ndarray, distance: float, t: float) -> bool:
    """Whether one query is within a Euclidean distance above 0 at the time t, exactly."""
    p0, p1 = validated(kind, np.asarray(points_t0)[None], np.asarray(points_t1)[None])
    corners, d = _lines(kind, p0[0], p1[0], distance, 1.0)
    return _is_within(_features(kind, corners, d), Root(*float(t).as_integer_ratio()))


def _closest(kind: str, points_t0: np.ndarray, points_t1: np.ndarray, t: float) -> tuple[list[int], int]:
    """The vector between the closest points of the two primitives at t, times an integer, and that integer."""
    p0, p1 = validated(kind, np.asarray(points_t0)[None], np.asarray(points_t1)[None])
    p, q = float(t).as_integer_ratio()
    corners, scale = _lines(kind, p0[0], p1[0], 1.0, 1.0)
    at = [[q * a + p * b for a, b in zip(*line, strict=True)] for line in corners]
    gaps = [(v, 1) for v in at]  # the nearest points of the features, as far as these hold them
    for i, j in PAIRS[kind]:
        side = _apart(at[j], at[i])
        along, to_foot = _inner(side, side), -_inner(at[i], side)
        if along and 0 <= to_foot <= along:
            gaps.append(([along * a + to_foot * s for a, s in zip(at[i], side, strict=True)], along))
    for i, j, m in TRIANGLES[kind]:
        a, b, c = at[i], at[j], at[m]
        normal = _crossed(_apart(b, a), _apart(c, a))
        if any(normal) and all(_inner(_crossed(x, y), normal) >= 0 for x, y in ((a, b), (b, c), (c, a))):
            gaps.append(([_inner(a, normal) * n for n in normal], _inner(normal, normal)))
    gap, length = min(gaps, key=lambda gap: Fraction(_inner(gap[0], gap[0]), gap[1] ** 2))
    return gap, length * scale * q


def exact_distance(kind: str, points_t0: np.ndarray, points_t1: np.ndarray, t: float) -> float:
    """Euclidean distance of one query at the time t: rational until the root, which is rounded."""
    gap, length = _closest(kind, points_t0, points_t1, t)
    square = Fraction(_inner(gap, gap), length**2)
    # the quotient of two integers with 2**200 in the numerator keeps more digits than the root needs
    bits = 2 * max(0, 200 + (square.denominator.bit_length() - square.numerator.bit_length()) // 2)
    return float(Fraction(math.isqrt((square.numerator << bits) // square.denominator), 1 << (bits // 2)))


def _inner(a: list[int], b: list[int]) -> int:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _apart(a: list[int], b: list[int]) -> list[int]:
    return [x - y for x, y in zip(a, b, strict=True)]


def _crossed(a: list[int], b: list[int]) -> list[int]:
    return [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]
