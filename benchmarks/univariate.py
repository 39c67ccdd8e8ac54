"""Classical continuous collision detection, the baseline: roots of the coplanarity cubic, then a test at each root.

The four points of a pair lie in one plane where f(t) = P · (Q × R) vanishes, so that a contact is at one of at most
three roots. These are found in floating point, and a root counts if the two primitives are within a tolerance of each
other there. Nothing bounds the rounding of the root, and where f vanishes for all t there is no root to test: the
method misses collisions. `ends_ccd` is the discrete test, which checks the two ends of the step alone.

This is NumPy over whole batches, for comparison of the answers; a compiled loop over the same formulas is faster.

References:
    Provot, "Collision and self-collision handling in cloth model dedicated to design garments", 1997.
    Bridson, Fedkiw and Anderson, "Robust treatment of collisions, contact and friction for cloth animation", 2002.
    Brochu, Edwards and Bridson, "Efficient geometrically exact continuous collision detection", 2012 (which names the
        method; El Topo, by the same authors, has the form with a distance in place of barycentric bounds).
"""

from __future__ import annotations

from functools import partial

import numpy as np
from cubic_roots import cubic_roots

CHUNK = 100_000  # queries at a time, which limits the memory to about 200 MB

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
