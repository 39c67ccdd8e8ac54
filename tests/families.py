"""Seeded generators of hard queries: every way known to us to make a continuous collision test fail.

Each family is called as `FAMILIES[name](kind, n, rng, dimension=3)` and returns points_t0 and points_t1, float64, of
shape [n, points of the kind, dimension]; the docstring of a family says in one line why it is hard. Every family serves
every kind, though a few say little about a point pair. The truth of a query is the oracle's business.

Families that need an exact contact build it on the lattice: positions at the contact are integers with integer
parameters, motions are multiples of eight, and the contact is at an eighth of the step, so that nothing is rounded.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Points = tuple[np.ndarray, np.ndarray]
Family = Callable[..., Points]

POINTS = {"vertex-face": 4, "edge-edge": 4, "point-segment": 3, "point-point": 2}
FAMILIES: dict[str, Family] = {}


def _family(function: Family) -> Family:
    FAMILIES[function.__name__] = function
    return function


def _result(points_t0: np.ndarray, points_t1: np.ndarray) -> Points:
    return np.ascontiguousarray(points_t0, dtype=np.float64), np.ascontiguousarray(points_t1, dtype=np.float64)


def _first_of_pair(kind: str) -> slice:
    """Rows of the first primitive of the pair."""
    return slice(0, 2 if kind == "edge-edge" else 1)


def _assemble(kind: str, origin: np.ndarray, q: np.ndarray, r: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Points with the second primitive at `origin`, spanned by q and r, and the first at parameters (u, v) of it."""
    if kind == "vertex-face":
        return np.stack([origin + u * q + v * r, origin, origin + q, origin + r], axis=1)
    if kind == "edge-edge":
        start = origin + v * r - u * q
        return np.stack([start, start + q, origin, origin + r], axis=1)
    if kind == "point-segment":
        return np.stack([origin + u * q, origin, origin + q], axis=1)
    return np.stack([origin, origin], axis=1)


def _lattice_contact(
    kind: str,
    n: int,
    rng: np.random.Generator,
    dimension: int,
    eighths: tuple[int, int] = (1, 7),
    u: tuple[int, int] = (1, 3),
    v: tuple[int, int] = (1, 3),
    reach: int = 3,
) -> Points:
    """Integer queries with contact at t = k / 8 and parameters (i / 8, j / 8), for k, i, j in the given ranges."""
    origin, q, r = (rng.integers(-reach, reach + 1, (n, dimension)) for _ in range(3))
    i, j = (rng.integers(low, high, (n, 1), endpoint=True) for low, high in (u, v))
    # Edges are eight times a lattice vector, so that eighths of them are lattice points.
    contact = _assemble(kind, 8 * origin, 8 * q, 8 * r, i / 8, j / 8)
    k = rng.integers(*eighths, (n, 1, 1), endpoint=True)
    motion = rng.integers(-reach, reach + 1, contact.shape)
    return _result(contact - k * motion, contact + (8 - k) * motion)


def _touching(
    kind: str,
    n: int,
    rng: np.random.Generator,
    dimension: int,
    q: np.ndarray | None = None,
    r: np.ndarray | None = None,
) -> np.ndarray:
    """Random float positions that touch, up to rounding, inside both primitives; q and r are their edges."""
    origin = rng.uniform(-1, 1, (n, dimension))
    q = rng.uniform(-1, 1, (n, dimension)) if q is None else q
    r = rng.uniform(-1, 1, (n, dimension)) if r is None else r
    return _assemble(kind, origin, q, r, rng.uniform(0, 0.5, (n, 1)), rng.uniform(0, 0.5, (n, 1)))


def _contact(contact: np.ndarray, motion: np.ndarray, rng: np.random.Generator) -> Points:
    """Queries that pass through the positions `contact` at a random time, moving by `motion` over the step."""
    t = rng.uniform(0, 1, (len(contact), 1, 1))
    return _result(contact - t * motion, contact + (1 - t) * motion)


def _colliding(kind: str, n: int, rng: np.random.Generator, dimension: int) -> Points:
    contact = _touching(kind, n, rng, dimension)
    return _contact(contact, rng.uniform(-1, 1, contact.shape), rng)


def _half_and_half(first: Points, second: Points) -> Points:
    """Queries of the two in turn; both have n of them, and n come back."""
    take = (np.arange(len(first[0])) % 2 == 0)[:, None, None]
    return _result(*(np.where(take, a, b) for a, b in zip(first, second, strict=True)))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


# ---- General position ------------------------------------------------------------------------------------------------


@_family
def random(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """General position, mostly without contact: the plain case that all others are compared with."""
    shape = (n, POINTS[kind], dimension)
    return _result(rng.uniform(-1, 1, shape), rng.uniform(-1, 1, shape))


@_family
def random_colliding(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """A contact in general position in every query: each one is a chance to miss."""
    return _colliding(kind, n, rng, dimension)


@_family
def cloth_like(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Thin gaps and small relative motion under a common motion, as in cloth: signal a thousandth of the input."""
    points_t0 = _touching(kind, n, rng, dimension)
    points_t0[:, _first_of_pair(kind)] += 1e-3 * rng.normal(size=(n, 1, dimension))
    common = 0.1 * rng.normal(size=(n, 1, dimension))
    return _result(points_t0, points_t0 + common + 3e-3 * rng.normal(size=points_t0.shape))


@_family
def static_partner(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """One side never moves: its terms cancel in the polynomials and lower their degree."""
    points_t0, points_t1 = _colliding(kind, n, rng, dimension)
    still = np.zeros(points_t0.shape[1], dtype=bool)
    still[_first_of_pair(kind)] = True
    still = np.where(rng.random((n, 1)) < 0.5, still, ~still)
    return _result(points_t0, np.where(still[:, :, None], points_t0, points_t1))


# ---- Exact degeneracies ----------------------------------------------------------------------------------------------


@_family
def lattice(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Coordinates in {0, 1, 2, 3}: repeated points, parallels, common planes and touching starts by the dozen."""
    shape = (n, POINTS[kind], dimension)
    return _result(rng.integers(0, 4, shape), rng.integers(0, 4, shape))


@_family
def one_plane(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Everything stays in one plane, flat or tilted: the coplanarity cubic vanishes and says nothing."""
    basis = rng.integers(-3, 4, (n, 2, dimension))
    axis = rng.integers(0, dimension, n)
    flat = np.stack([np.eye(dimension)[axis], np.eye(dimension)[(axis + 1) % dimension]], axis=1)
    basis = np.where(rng.random((n, 1, 1)) < 0.5, flat, basis)
    origin = rng.integers(-3, 4, (n, 1, dimension))
    coordinates = rng.integers(-4, 5, (2, n, POINTS[kind], 2))
    return _result(*(origin + np.einsum("npk,nkd->npd", c, basis) for c in coordinates))


@_family
def collinear(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Everything stays on one line: every normal vanishes, and only order along the line decides."""
    direction = rng.integers(-3, 4, (n, 1, dimension))
    origin = rng.integers(-3, 4, (n, 1, dimension))
    coordinates = rng.integers(-9, 10, (2, n, POINTS[kind], 1))
    return _result(*(origin + c * direction for c in coordinates))


@_family
def parallel_edges(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Edges stay parallel, and approach, overlap or slide along one line: their common normal vanishes."""
    direction = rng.integers(-3, 4, (n, 1, dimension))
    along = rng.integers(-4, 5, (2, n, POINTS[kind], 1))
    # Offsets of the two sides from the line; zero at both ends slides along it, of opposite sign passes through it.
    side = rng.integers(-2, 3, (n, 1, dimension))
    offset = rng.integers(-1, 2, (2, n, 1, 1)) * side
    points = along * direction
    points[:, :, _first_of_pair(kind)] += offset
    if kind == "vertex-face":
        points[:, :, 3] += rng.integers(-3, 4, (n, dimension))
    return _result(points[0], points[1])


@_family
def zero_size_primitives(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Faces without area and edges without length, some for the whole step, some at one end of it."""
    points_t0, points_t1 = _half_and_half(_lattice_contact(kind, n, rng, dimension), lattice(kind, n, rng, dimension))
    count = POINTS[kind]
    merged = rng.integers(1, count, n)
    partner = merged - 1
    if kind != "point-point":
        partner = np.where((merged == 1) & (kind != "edge-edge"), 2, partner)
        partner = np.where(kind == "edge-edge", merged // 2 * 2, partner)
        merged = np.where(kind == "edge-edge", partner + 1, merged)
    query = np.arange(n)
    start, end = rng.random(n) < 0.8, rng.random(n) < 0.8
    for points, chosen in ((points_t0, start), (points_t1, end)):
        points[query[chosen], merged[chosen]] = points[query[chosen], partner[chosen]]
    if kind == "vertex-face":
        # A quarter of the faces shrink to one point.
        point = rng.random(n) < 0.25
        for points in (points_t0, points_t1):
            points[point, 2:] = points[point, 1:2]
    return _result(points_t0, points_t1)


@_family
def no_motion(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Nothing moves, touching or not: every polynomial in t is constant."""
    points_t0, _ = _half_and_half(
        _lattice_contact(kind, n, rng, dimension, eighths=(0, 0)), lattice(kind, n, rng, dimension)
    )
    return _result(points_t0, points_t0)


@_family
def touching_at_start(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Contact exactly at t = 0, often leaving at once: the toi is 0 and nothing may exceed it."""
    return _lattice_contact(kind, n, rng, dimension, eighths=(0, 0), u=(0, 4), v=(0, 4))


@_family
def contact_exactly_at_end(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Contact exactly at t = 1, the closed end of the step."""
    return _lattice_contact(kind, n, rng, dimension, eighths=(8, 8), u=(0, 4), v=(0, 4))


@_family
def double_root(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Touches at one instant and parts on the same side: the cubic has a double root and never changes sign."""
    if kind == "point-point":
        return _lattice_contact(kind, n, rng, dimension)
    c = rng.integers(1, 8, n) / 8
    x0, y0 = (-rng.integers(1, 4, n) / 8 for _ in range(2))
    bend = rng.integers(1, 9, n) * rng.choice([-1, 1], n) / 2
    zero = np.zeros(n)
    frames = []
    for tau in (-c, 1 - c):
        # With R = (0, 1, 0), P . (Q x R) = bend (t - c)^2.
        p = [x0 - bend * tau, y0, tau * x0]
        q = [zero + 1, zero, tau]
        r = [zero, zero + 1, zero]
        if dimension == 2 or kind == "point-segment":
            p, q = ([x[0], x[2], zero][:dimension] for x in (p, q))
            r = [zero] * dimension
        frames.append(tuple(np.stack(x, axis=1) for x in (p, q, r)))
    offset = rng.integers(-3, 4, (2, n, dimension))
    order = rng.permutation(dimension)
    points = []
    for (p, q, r), base in zip(frames, offset, strict=True):
        if kind == "vertex-face":
            frame = [base + p, base, base - q, base - r]
        elif kind == "edge-edge":
            frame = [base + p, base + p + q, base, base - r]
        else:
            frame = [base + p, base, base - q]
        points.append(np.stack(frame, axis=1)[:, :, order])
    return _result(*points)


@_family
def sliding_in_plane_rotating(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """All points slide in a common plane that itself turns: coplanar for all t, yet with no fixed normal."""
    coordinates = rng.integers(-4, 5, (n, POINTS[kind], 2))
    slide = rng.integers(-4, 5, (n, POINTS[kind], 1))
    axis, start, end = (rng.integers(-3, 4, (n, 1, dimension)) for _ in range(3))
    # The plane at t is spanned by the fixed axis and (1 - t) start + t end; points slide along the axis only.
    points_t0 = coordinates[:, :, :1] * axis + coordinates[:, :, 1:] * start
    points_t1 = (coordinates[:, :, :1] + slide) * axis + coordinates[:, :, 1:] * end
    return _result(points_t0, points_t1)


@_family
def grazing_vertex(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """A corner of one meets a corner of the other for one instant: both parameters sit at the ends of their range."""
    return _lattice_contact(kind, n, rng, dimension, u=(0, 0), v=(0, 0))


@_family
def edge_through_vertex(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """An edge passes exactly through a vertex or along the rim of a face: one parameter at the end of its range."""
    return _lattice_contact(kind, n, rng, dimension, u=(1, 7), v=(0, 0))


@_family
def one_ulp_neighbours(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """An exact contact at a boundary with one coordinate moved by one ulp: hit or miss by 1e-16, or by 5e-324."""
    boundary = _lattice_contact(kind, n, rng, dimension, u=(0, 8), v=(0, 0))
    at_end = _lattice_contact(kind, n, rng, dimension, eighths=(0, 8), u=(0, 4), v=(0, 4))
    points_t0, points_t1 = _half_and_half(boundary, at_end)
    points = np.stack([points_t0, points_t1], axis=1)
    flat = points.reshape(n, -1)
    query, coordinate = np.arange(n), rng.integers(0, flat.shape[1], n)
    towards = rng.choice([-np.inf, np.inf], n)
    flat[query, coordinate] = np.nextafter(flat[query, coordinate], towards)
    return _result(points[:, 0], points[:, 1])


# ---- Scale -----------------------------------------------------------------------------------------------------------


@_family
def offset_1e6(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Far from the origin: an error bound that scales with the coordinates is a million times too wide."""
    points_t0, points_t1 = _colliding(kind, n, rng, dimension)
    return _result(points_t0 + 1e6, points_t1 + 1e6)


def _scaled(kind: str, n: int, rng: np.random.Generator, dimension: int, scale: float) -> Points:
    points = _half_and_half(_colliding(kind, n, rng, dimension), lattice(kind, n, rng, dimension))
    return _result(scale * points[0], scale * points[1])


@_family
def scaled_2_pow_200(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Coordinates near 1e60: squares and triple products overflow in float32 and strain float64."""
    return _scaled(kind, n, rng, dimension, 2.0**200)


@_family
def scaled_2_pow_minus_200(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Coordinates near 1e-60: any absolute epsilon swallows the whole scene, and products of six underflow."""
    return _scaled(kind, n, rng, dimension, 2.0**-200)


@_family
def mixed_axis_scales(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Axes of scale 1e-7, 1 and 1e5: one bound for all axes hides the smallest of them."""
    points_t0, points_t1 = _colliding(kind, n, rng, dimension)
    scale = rng.permuted(np.tile([1e-7, 1.0, 1e5], (n, 1)), axis=1)[:, None, :dimension]
    return _result(scale * points_t0, scale * points_t1)


@_family
def slivers(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Needle triangles and nearly parallel edges, in space and so in parameters: normals lose all their digits."""
    q = rng.uniform(-1, 1, (n, dimension))
    width = 10.0 ** rng.uniform(-12, -3, (n, 1))
    r = rng.uniform(0.2, 1, (n, 1)) * q + width * rng.uniform(-1, 1, (n, dimension))
    contact = _touching(kind, n, rng, dimension, q, r)
    return _contact(contact, rng.uniform(-1, 1, contact.shape), rng)


@_family
def tiny_motion(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Motion of 1e-9 beside edges of 1: the toi is set by the last third of the digits."""
    contact = _touching(kind, n, rng, dimension)
    return _contact(contact, 1e-9 * rng.normal(size=contact.shape), rng)


# ---- Large motion ----------------------------------------------------------------------------------------------------


@_family
def rotation_like(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Ends of a large rotation joined by straight lines: a small gap shrinks and turns, half the time to a contact."""
    points_t0 = _touching(kind, n, rng, dimension)
    gap = 10.0 ** rng.uniform(-9, -2, (n, 1, 1)) * _unit(rng.normal(size=(n, 1, dimension)))
    points_t0[:, _first_of_pair(kind)] += gap
    angle = rng.uniform(1.0, 3.1, (n, 1, 1))
    plane = np.linalg.qr(rng.normal(size=(n, dimension, 2)))[0].transpose(0, 2, 1)
    first, second = plane[:, :1], plane[:, 1:]
    x, y = (np.sum(points_t0 * axis, axis=2, keepdims=True) for axis in (first, second))
    points_t1 = points_t0 + (np.cos(angle) - 1) * (x * first + y * second) + np.sin(angle) * (x * second - y * first)
    # The chord of a rotation below pi is an invertible map at each t, so without this the gap never closes.
    turned = points_t1[:, _first_of_pair(kind)]
    approach = np.where(rng.random((n, 1, 1)) < 0.5, 0.0, rng.uniform(0, 10, (n, 1, 1)))
    turned -= approach * np.linalg.norm(gap, axis=2, keepdims=True) * _unit(rng.normal(size=(n, 1, dimension)))
    return _result(points_t0, points_t1)


@_family
def fast_and_thin(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Motion a thousand times the size of the primitives: no overlap at either end, and a toi of few digits."""
    contact = _touching(kind, n, rng, dimension)
    motion = rng.uniform(-1, 1, contact.shape)
    motion[:, _first_of_pair(kind)] += 1e3 * rng.normal(size=(n, 1, dimension))
    return _contact(contact, motion, rng)
