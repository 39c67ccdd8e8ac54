"""The parameters of the common points of pairs that are known to intersect, in float64 where that is accurate.

Each is a quotient of two determinants. Where the denominator exceeds 2⁻²¹ of its permanent, the error of either, at
most 16 · 2⁻⁵³ of it as in ``kernels/at_one_time/intersections.py``, changes the quotient by less than 2⁻²⁵; otherwise
the exact test gives it.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

_WELL_ABOVE = 2.0**-21
# Permanents between which no product over- or underflows.
_SMALLEST, _LARGEST = 2.0**-900, 2.0**900
Array = NDArray[np.float64]
# Parameters of pairs, shape [n, 3], and whether they are accurate, shape [n].
Approximate = tuple[Array, NDArray[np.bool_]]
_NEXT, _LAST = [1, 2, 0], [2, 0, 1]


def _cross(a: Array, b: Array) -> tuple[Array, Array]:
    """Cross products, and the sums of magnitudes of the products in each component."""
    left, right = a[:, _NEXT] * b[:, _LAST], a[:, _LAST] * b[:, _NEXT]
    return left - right, np.abs(left) + np.abs(right)


def _volume(a: Array, b: Array, c: Array) -> tuple[Array, Array]:
    """det(a, b, c), and its permanent."""
    n, size = _cross(b, c)
    return (a * n).sum(axis=1), (np.abs(a) * size).sum(axis=1)


def _is_large(value: Array, permanent: Array) -> NDArray[np.bool_]:
    in_range = (permanent > _SMALLEST) & (permanent < _LARGEST)
    large: NDArray[np.bool_] = in_range & (np.abs(value) > _WELL_ABOVE * permanent)
    return large


def _component(values: Array, axis: NDArray[np.intp]) -> Array:
    return np.take_along_axis(values, axis[:, None], axis=1)[:, 0]


def through_face(p: Array, q: Array, a: Array, b: Array, c: Array) -> Approximate:
    """Of edges through faces."""
    ab, ac, d, pa, pb, pc = b - a, c - a, q - p, a - p, b - p, c - p
    (p_side, p_size), (q_side, q_size) = _volume(p - a, ab, ac), _volume(q - a, ab, ac)
    at_a, at_b, at_c = _volume(d, pb, pc), _volume(d, pc, pa), _volume(d, pa, pb)
    total = at_a[0] + at_b[0] + at_c[0]
    is_accurate = _is_large(p_side - q_side, p_size + q_size) & _is_large(total, at_a[1] + at_b[1] + at_c[1])
    return np.stack([at_b[0] / total, at_c[0] / total, p_side / (p_side - q_side)], axis=1), is_accurate


def in_face(v: Array, a: Array, b: Array, c: Array) -> Approximate:
    """Of vertices in faces."""
    ab, ac, av = b - a, c - a, v - a
    n, size = _cross(ab, ac)
    axis = np.argmax(np.abs(n), axis=1)
    area = _component(n, axis)
    along_ab, along_ac = _cross(av, ac), _cross(ab, av)
    permanent = _component(size + along_ab[1] + along_ac[1], axis)
    u, w = (_component(along[0], axis) / area for along in (along_ab, along_ac))
    return np.stack([u, w, np.zeros(len(u))], axis=1), _is_large(area, permanent)


def of_edges(p: Array, q: Array, r: Array, s: Array) -> Approximate:
    """Of edges that meet and are not parallel."""
    d, e, w = q - p, s - r, r - p
    n, size = _cross(d, e)
    axis = np.argmax(np.abs(n), axis=1)
    area = _component(n, axis)
    along_d, along_e = _cross(w, e), _cross(w, d)
    permanent = _component(size + along_d[1] + along_e[1], axis)
    u, v = (_component(along[0], axis) / area for along in (along_d, along_e))
    return np.stack([u, v, np.zeros(len(u))], axis=1), _is_large(area, permanent)


def on_segment(p: Array, a: Array, b: Array) -> Approximate:
    """Of points on segments."""
    d = b - a
    length = (d * d).sum(axis=1)
    u = ((p - a) * d).sum(axis=1) / length
    zero = np.zeros(len(u))
    return np.stack([u, zero, zero], axis=1), (length > _SMALLEST) & (length < _LARGEST)


def of_points(p: Array, q: Array) -> Approximate:
    """Of points in one place."""
    return np.zeros((len(p), 3)), np.ones(len(p), dtype=bool)


def approximate(function: Callable[..., Approximate], x: Array, corners: NDArray[np.int32]) -> Approximate:
    """The parameters of pairs with these vertices, within [0, 1]."""
    with np.errstate(all="ignore"):
        parameters, is_accurate = function(*(x[column] for column in corners.T))
    return np.clip(parameters, 0.0, 1.0), is_accurate
