"""Classical continuous collision detection, the baseline: roots of the coplanarity cubic, then a test at each root.

The four points of a pair lie in one plane where f(t) = P · (Q × R) vanishes, so that a contact is at one of at most
three roots. These are found in floating point, and a root counts if the two primitives are within a tolerance of each
other there. Nothing bounds the rounding of the root, and where f vanishes for all t there is no root to test: the
method misses collisions. `ends_ccd` is the discrete test, which checks the two ends of the step alone.

This is NumPy over whole batches, for comparison of the answers; a compiled loop over the same formulas is faster.

References:
    Press et al., "Numerical Recipes", section 5.6 (the closed form of the roots).
    Provot, "Collision and self-collision handling in cloth model dedicated to design garments", 1997.
    Bridson, Fedkiw and Anderson, "Robust treatment of collisions, contact and friction for cloth animation", 2002.
    Brochu, Edwards and Bridson, "Efficient geometrically exact continuous collision detection", 2012 (which names the
        method; El Topo, by the same authors, has the form with a distance in place of barycentric bounds).
"""

from __future__ import annotations

from functools import partial

import numpy as np

CHUNK = 100_000  # queries at a time, which limits the memory to about 200 MB

# A leading coefficient below this multiple of the largest one is dropped before the closed form, which loses as many
# digits as it is smaller; the polish afterwards is on the whole cubic.
_NEGLIGIBLE = 1e-8
# Rounding makes a complex pair of a double root: its discriminant is negative, its imaginary part the square root.
_DOUBLE = 1e-12
# A root this far outside the step is taken for its end, as in El Topo.
_SLACK = 1e-8

# ---- Roots of cubics -------------------------------------------------------------------------------------------------


def _value(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Cubics [n, 4] at the times [n, k]."""
    c, b, a, lead = coefficients.T[..., None]
    return ((lead * t + a) * t + b) * t + c


def _slope(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    _, b, a, lead = coefficients.T[..., None]
    return (3.0 * lead * t + 2.0 * a) * t + b


def _quadratic_roots(c: np.ndarray, b: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Roots of a t² + b t + c without cancellation, [n, 2]; what is not a root is inf or nan. Serves a = 0 as well."""
    discriminant = b * b - 4.0 * a * c
    # One that is negative by rounding alone belongs to a double root.
    rounding = _DOUBLE * (b * b + np.abs(4.0 * a * c))
    discriminant = np.where(discriminant >= -rounding, np.maximum(discriminant, 0.0), np.nan)
    w = -0.5 * (b + np.copysign(np.sqrt(discriminant), b))
    return np.stack([w / a, c / w], axis=1)


def _polished(coefficients: np.ndarray, roots: np.ndarray) -> np.ndarray:
    """Roots [n, k] after two Newton steps, each of them taken only if it helps."""
    for _ in range(2):
        better = roots - _value(coefficients, roots) / _slope(coefficients, roots)
        improves = np.abs(_value(coefficients, better)) < np.abs(_value(coefficients, roots))
        roots = np.where(improves, better, roots)
    return roots


def _cardano(c: np.ndarray, b: np.ndarray, a: np.ndarray) -> np.ndarray:
    """One real root in closed form, the largest where there are three, and the others from what is left.

    The formulas for the smaller ones lose half of the digits, and more where one root is far larger.
    """
    q = (a * a - 3.0 * b) / 9.0
    r = (2.0 * a * a * a - 9.0 * a * b + 27.0 * c) / 54.0
    # Three real roots: by angles. One: the sum of two cube roots of like sign, the second from the first.
    angle = np.arccos(np.clip(r / np.sqrt(q * q * q), -1.0, 1.0))
    turn = 2.0 * np.pi * np.array([-1.0, 0.0, 1.0])
    three = -2.0 * np.sqrt(q)[:, None] * np.cos((angle[:, None] + turn) / 3.0) - a[:, None] / 3.0
    largest = np.take_along_axis(three, np.argmax(np.abs(three), axis=1)[:, None], axis=1)[:, 0]
    first = -np.copysign(np.cbrt(np.abs(r) + np.sqrt(r * r - q * q * q)), r)
    one = first + np.where(first == 0.0, 0.0, q / first) - a / 3.0
    x = np.where(r * r < q * q * q, largest, one)
    monic = np.stack([c, b, a, np.ones_like(a)], axis=1)
    x = _polished(monic, x[:, None])[:, 0]
    # t² + s t + p is left; from below for a small root, from above for a large one, neither of which cancels.
    large = np.abs(x * x * x) > np.abs(c)
    p = np.where(large, -c / x, b + (a + x) * x)
    s = np.where(large, (p - b) / x, a + x)
    return np.concatenate([x[:, None], _quadratic_roots(p, s, np.ones_like(s))], axis=1)


def cubic_roots(coefficients: np.ndarray) -> np.ndarray:
    """Roots in [0, 1] by Cardano's formula or its trigonometric form, and the quadratic that remains.

    Args:
        coefficients: Cubics, lowest degree first, of any degree up to three, float64, shape [n, 4].

    Returns:
        Roots in increasing order, inf where there are fewer, float64, shape [n, 3]; none for a cubic that is zero.
    """
    exponent = np.frexp(np.abs(coefficients).max(axis=1))[1]
    coefficients = np.ldexp(coefficients, -exponent[:, None])  # so that no product of them overflows
    roots = np.full((len(coefficients), 3), np.nan)
    with np.errstate(all="ignore"):
        cubic = np.abs(coefficients[:, 3]) > _NEGLIGIBLE * np.abs(coefficients).max(axis=1)
        c, b, a, lead = coefficients[cubic].T
        roots[cubic] = _cardano(c / lead, b / lead, a / lead)
        roots[~cubic, :2] = _quadratic_roots(*coefficients[~cubic, :3].T)
        roots = _polished(coefficients, roots)
    inside = (roots >= -_SLACK) & (roots <= 1.0 + _SLACK)
    return np.sort(np.where(inside, np.clip(roots, 0.0, 1.0), np.inf), axis=1)


# ---- Geometry --------------------------------------------------------------------------------------------------------
# Vectors are stored by component, [3, n], so that every operation runs along contiguous memory.


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _gap_vectors(kind: str, points: np.ndarray) -> np.ndarray:
    """P, Q and R of P + u Q + v R, [3, 3, n]."""
    a, b, c, d = np.moveaxis(points, 0, -1)
    if kind == "vertex-face":
        return np.stack([a - b, b - c, b - d])
    return np.stack([a - c, b - a, c - d])


def _scaled(
    kind: str, points_t0: np.ndarray, points_t1: np.ndarray, length_scale: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """P, Q, R at both ends, [2, 3, 3, n], and the length scale, [n]; by default the longest side of the motion's box.

    Everything is times a power of two that brings the size to about one: neither huge nor tiny input leaves the range.
    """
    points = np.stack([points_t0, points_t1], axis=1).astype(np.float64, copy=False)
    # First the coordinates, whose differences could overflow, then the differences, which may be far smaller.
    first = np.frexp(np.abs(points).max(axis=(1, 2, 3)))[1]
    points = np.ldexp(points, -first[:, None, None, None])
    size = np.ptp(points, axis=(1, 2)).max(axis=1)
    exponent = np.frexp(size)[1]
    frames = np.stack([_gap_vectors(kind, points[:, 0]), _gap_vectors(kind, points[:, 1])])
    unit = size if length_scale is None else np.ldexp(length_scale, -first)
    return np.ldexp(frames, -exponent), np.ldexp(unit, -exponent)


def _cubic(frames: np.ndarray) -> np.ndarray:
    (p0, q0, r0), (p1, q1, r1) = frames[0], frames[1] - frames[0]
    normals = _cross(q0, r0), _cross(q0, r1) + _cross(q1, r0), _cross(q1, r1)
    return np.stack(
        [
            _dot(p0, normals[0]),
            _dot(p0, normals[1]) + _dot(p1, normals[0]),
            _dot(p0, normals[2]) + _dot(p1, normals[1]),
            _dot(p1, normals[2]),
        ],
        axis=1,
    )


def _distance(kind: str, p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Euclidean distance of the primitives, [n]: the least of |P + u Q + v R| over the domain.

    It is taken at points of the domain, by the normal equations inside it and by projection on each of its sides, so
    that rounding can only enlarge it.
    """
    qq, qr, rr, pq, pr = _dot(q, q), _dot(q, r), _dot(r, r), _dot(p, q), _dot(p, r)
    determinant = qq * rr - qr * qr
    u, v = (qr * pr - rr * pq) / determinant, (qr * pq - qq * pr) / determinant
    inside = (u >= 0.0) & (v >= 0.0)
    inside &= (u + v <= 1.0) if kind == "vertex-face" else (u <= 1.0) & (v <= 1.0)
    nearest = p + np.where(inside, u, 0.0) * q + np.where(inside, v, 0.0) * r
    best = _dot(nearest, nearest)
    far = (p + r, q) if kind == "edge-edge" else (p + q, r - q)
    for corner, side in ((p, q), (p, r), far, *([(p + q, r)] if kind == "edge-edge" else [])):
        length = _dot(side, side)
        s = np.where(length > 0.0, np.clip(-_dot(corner, side) / length, 0.0, 1.0), 0.0)
        nearest = corner + s * side
        best = np.fmin(best, _dot(nearest, nearest))
    return np.sqrt(best)


def _within(kind: str, frame: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Whether the primitives are within reach of each other, [n]."""
    return _distance(kind, *frame) <= reach


def _earliest(kind: str, frames: np.ndarray, times: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Earliest of the times [n, k] at which the primitives are within reach [n], or inf."""
    times = times.copy()
    query, slot = np.nonzero(np.isfinite(times))
    t = times[query, slot]
    start, end = frames[..., query]
    apart = ~_within(kind, (1.0 - t) * start + t * end, reach[query])
    times[query[apart], slot[apart]] = np.inf
    return times.min(axis=1)


# ---- Queries ---------------------------------------------------------------------------------------------------------


def univariate_ccd(
    kind: str,
    points_t0: np.ndarray,
    points_t1: np.ndarray,
    *,
    tolerance: float = 1e-6,
    length_scale: float | None = None,
    has_roots: bool = True,
) -> np.ndarray:
    """Times of impact by the univariate method; not conservative.

    Differs from Bridson et al. 2002, in its favour, in
    1. the scale: everything is normalised by a power of two, so that no product of six lengths leaves the range;
    2. the tolerance: a multiple of a length scale, by default of each query's size;
    3. the test of a face at a root: its distance, as in El Topo, in place of that of its plane and bounds of the
       barycentric coordinates, which fails on needles and faces without area;
    4. the ends: the same test is made at t = 0 and at t = 1, and the result includes them.

    Args:
        kind: "vertex-face" or "edge-edge".
        points_t0: Positions at t = 0, float64, finite, shape [n, 4, 3].
        points_t1: Positions at t = 1, same shape.
        tolerance: Distance that counts as contact, as a multiple of the length scale.
        length_scale: Unit of the tolerance, a length; None: the longest side of the box around each query's motion.
        has_roots: Whether roots are tested, and not the two ends alone.

    Returns:
        Time of the first root or end with contact, inf where none was found, float64, shape [n].
    """
    toi = np.full(len(points_t0), np.inf)
    for first in range(0, len(toi), CHUNK):
        chunk = slice(first, first + CHUNK)
        with np.errstate(all="ignore"):
            frames, scale = _scaled(kind, points_t0[chunk], points_t1[chunk], length_scale)
            times = np.full((len(scale), 2), [0.0, 1.0])
            if has_roots:
                times = np.concatenate([cubic_roots(_cubic(frames)), times], axis=1)
            toi[chunk] = _earliest(kind, frames, times, tolerance * scale)
    return toi


ends_ccd = partial(univariate_ccd, has_roots=False)
