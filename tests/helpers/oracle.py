"""Exact oracle of the tests: the earliest time of impact in rational and real algebraic arithmetic.

It shares no code and no idea with the kernels. In integers (`oracle_corners`), the time of impact is a root of one of
finitely many polynomials of degree at most three, and every decision is the sign of such a polynomial at such a root
(`oracle_contact`, `algebraic`).

Two primitives touch at t iff 0 lies in K(t) = conv{V_i(t)}, whose corners are linear in t:

    vertex-face    V_i = v - f_i, a triangle           edge-edge     V = a_i - b_j, a parallelogram
    point-segment  V = p - a, p - b, a segment         point-point   V = p - q, a point
"""

from __future__ import annotations

import math
import sys
from fractions import Fraction

import numpy as np
from exact_toi import ExactToi
from flint import fmpq
from oracle_contact import contact, facet_normals, separated_contact
from oracle_corners import CORNERS, POINTS, integer_rows, moving_corners, validated


def certainly_apart(kind: str, p0: np.ndarray, p1: np.ndarray, separation: float) -> np.ndarray:
    """Queries that a fixed direction separates over the whole step, with a rigorous bound of the rounding, [n].

    Any direction may be tried, so how it was computed does not matter; only the products with it are bounded.
    """
    pairs = np.array(CORNERS[kind])
    points = np.stack([p0, p1], axis=1)
    apart = np.zeros(len(p0), dtype=bool)
    with np.errstate(all="ignore"):
        corners = points[:, :, pairs[:, 0]] - points[:, :, pairs[:, 1]]  # [n, 2, corners, dim], each rounded once
        start, end = corners[:, 0], corners[:, 1]
        middle = 0.5 * (start + end)
        dim = p0.shape[2]
        directions = [np.broadcast_to(np.eye(dim)[k], (len(p0), dim)) for k in range(dim)]
        directions += [start.mean(axis=1), end.mean(axis=1), middle.mean(axis=1)]
        if dim == 3 and len(pairs) > 1:
            motion = (end - start).mean(axis=1)
            for shape in (start, middle, end):
                edges = [shape[:, 1] - shape[:, 0], shape[:, -1] - shape[:, 0], shape[:, -1] - shape[:, 1]]
                directions.append(np.cross(edges[0], edges[1]))
                directions += [np.cross(edge, motion) for edge in edges]
        elif dim == 2 and len(pairs) > 1:
            for shape in (start, middle, end):
                edge = shape[:, 1] - shape[:, 0]
                directions.append(np.stack([-edge[:, 1], edge[:, 0]], axis=1))
        for direction in directions:
            # The largest component becomes about one, so that neither the products nor their sum can overflow unless
            # the corners do; nan (a zero direction) separates nothing.
            n = (direction / np.abs(direction).max(axis=1, keepdims=True))[:, None, None, :]
            products = (n * corners).sum(axis=3)
            # Each corner and each product is rounded once, the sum of three twice more, and this bound and the
            # comparison add at most six: 16 units cover them. 2**-1060 covers products that underflow.
            bound = 2.0**-49 * (np.abs(n) * np.abs(corners)).sum(axis=3) + 2.0**-1060
            bound = bound + separation * np.abs(n).sum(axis=3) * (1 + 2.0**-49)
            apart |= (products > bound).all(axis=(1, 2)) | (products < -bound).all(axis=(1, 2))
    return apart


def exact_tois(
    kind: str,
    points_t0: np.ndarray,
    points_t1: np.ndarray,
    separation: float = 0.0,
    t_max: float = 1.0,
    progress: bool = False,
) -> list[ExactToi]:
    """Exact earliest times of impact of many queries.

    Args:
        kind: "vertex-face", "edge-edge", "point-segment" or "point-point".
        points_t0: Positions at t = 0, float64, shape [n, 4, 3] ([n, 3, 2 or 3] and [n, 2, 2 or 3] for the last two).
        points_t1: Positions at t = 1, same shape.
        separation: L-infinity distance that counts as contact, in the unit of the points; its float64 value is exact.
        t_max: End of the step; its float64 value is exact.
        progress: Whether to print a count to stderr now and then.

    Returns:
        One result for each query.
    """
    p0, p1 = validated(kind, points_t0, points_t1)
    if not (separation >= 0.0 and math.isfinite(separation)):
        raise ValueError(f"separation is {separation}; expected a finite number >= 0")
    if not 0.0 <= t_max <= 1.0:
        raise ValueError(f"t_max is {t_max}; expected a number in [0, 1]")
    separation, t_max = float(separation), float(t_max)
    dimension = p0.shape[2]
    none = ExactToi(None, t_max)
    results = [none] * len(p0)
    # The cull checks the whole of [0, 1], which contains [0, t_max].
    open_queries = np.flatnonzero(~certainly_apart(kind, p0, p1, separation))
    flat = np.concatenate(
        [
            p0.reshape(len(p0), POINTS[kind] * dimension)[open_queries],
            p1.reshape(len(p1), POINTS[kind] * dimension)[open_queries],
            np.full((len(open_queries), 1), separation),
        ],
        axis=1,
    )
    ratio = t_max.as_integer_ratio()
    for done, (index, row) in enumerate(zip(open_queries.tolist(), integer_rows(flat), strict=True)):
        corners = moving_corners(kind, row, dimension, ratio)
        if separation > 0.0:
            root = separated_contact(corners, row[-1] * ratio[1], dimension)
        else:
            root = contact(kind, corners)
        if root is not None:
            results[index] = ExactToi(root, t_max)
        if progress and done % 1000 == 0:
            print(f"exact_tois: {done} of {len(open_queries)} open queries", file=sys.stderr)
    return results


def exact_toi(
    kind: str, points_t0: np.ndarray, points_t1: np.ndarray, separation: float = 0.0, t_max: float = 1.0
) -> ExactToi:
    """Exact earliest time of impact of one query; points of shape [4, 3], [3, 2 or 3] or [2, 2 or 3]."""
    return exact_tois(kind, np.asarray(points_t0)[None], np.asarray(points_t1)[None], separation, t_max)[0]


def exact_gap(kind: str, points_t0: np.ndarray, points_t1: np.ndarray, t: float | Fraction | fmpq) -> float:
    """L-infinity distance of the two primitives at the rational time t, exact and then rounded once.

    K is within d of the origin iff no facet normal n of K + cube separates them, that is iff min_i n.V_i <= d |n|_1 and
    max_i n.V_i >= -d |n|_1 for all n; the distance is the largest d that one of them requires.
    """
    p0, p1 = validated(kind, np.asarray(points_t0)[None], np.asarray(points_t1)[None])
    p, q = (int(t.p), int(t.q)) if isinstance(t, fmpq) else t.as_integer_ratio()
    dimension = p0.shape[2]
    # One additional value carries the scale of the integers.
    row = integer_rows(np.concatenate([p0.ravel(), p1.ravel(), [1.0]])[None])[0]
    lines = moving_corners(kind, row, dimension, (1, 1))
    corners = [(tuple(q * a + p * b for a, b in zip(*line, strict=True)), (0, 0, 0)) for line in lines]
    best = Fraction(0)
    for normal, ends in facet_normals(corners, dimension):
        n = [c[0] for c in normal]
        length = sum(abs(c) for c in n)
        if length:
            products = [sum(n[k] * corners[i][0][k] for k in range(3)) for i in ends]
            best = max(best, Fraction(min(products), length), Fraction(-max(products), length))
    distance = best / (q * row[-1])
    return distance.numerator / distance.denominator
