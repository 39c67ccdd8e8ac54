"""Catalogue of hard cases: seeded families of queries, each with why it is hard and which method fails there.

A family is called as `FAMILIES[name](kind, n, rng, dimension=3)` and returns points_t0 and points_t1, float64, of shape
[n, points of the kind, dimension]. Every family supports every kind, although a few are of little interest for point
pairs. The oracle decides the truth of a query. Families that need an exact contact build it on a lattice
(`_results/contacts.py`).

The failures were measured against the exact oracle, on 200 vertex-face and 200 edge-edge queries of each family:
- the ends and the univariate method: `univariate.py`, tolerance 1e-6 and the test by distance unless it says otherwise;
- Tight-Inclusion: `ipctk.tight_inclusion`, on 40 of them, tolerance 1e-6 of the size and at most 100,000 iterations,
  where it gives up after some 30 ms; it takes 20 to 300 µs a query of the plain families;
- additive CCD: `ipctk.AdditiveCCD`, at most 10,000 iterations.

In general, the ends miss every collision that shows at neither end of the step. A root in floating point is late by
rounding for up to half of the contacts. Additive CCD stops at a tenth of the gap at the start, so that it is early and
has phantoms everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from hard_contacts import (
    POINTS,
    Points,
    as_points,
    colliding,
    first_of_pair,
    half_and_half,
    lattice_contact,
    passing_through,
    touching,
    unit,
)

__all__ = ["FAMILIES", "POINTS", "HardCase"]


@dataclass(frozen=True)
class HardCase:
    """A family of hard queries, called like its generator.

    Attributes:
        name: Key in `FAMILIES`.
        why: Why the queries are hard, one line.
        fails: Which methods fail there and how, one line.
        generate: The generator.
        minimum_separation: Separation at which the queries are hard, as a multiple of `length_scale`.
        length_scale: Length that the separation refers to, in the unit of the points.
    """

    name: str
    why: str
    fails: str
    generate: Callable[..., Points]
    minimum_separation: float = 0.0
    length_scale: float = 1.0

    def __call__(self, kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
        return self.generate(kind, n, rng, dimension)


FAMILIES: dict[str, HardCase] = {}


def _family(fails: str, **options: float) -> Callable[[Callable[..., Points]], HardCase]:
    """Enter a generator into the catalogue; the first line of its docstring says why it is hard."""

    def enter(generate: Callable[..., Points]) -> HardCase:
        name = generate.__name__
        FAMILIES[name] = HardCase(name, generate.__doc__.splitlines()[0], fails, generate, **options)
        return FAMILIES[name]

    return enter


# ---- General position ------------------------------------------------------------------------------------------------


@_family(fails="none; the plain case")
def random(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """General position, mostly without contact: the plain case that all others are compared with."""
    shape = (n, POINTS[kind], dimension)
    return as_points(rng.uniform(-1, 1, shape), rng.uniform(-1, 1, shape))


@_family(fails="none but the ends")
def random_colliding(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """A contact in general position in every query: each one is a chance to miss."""
    return colliding(kind, n, rng, dimension)


@_family(fails="none but the ends")
def cloth_like(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Thin gaps and small relative motion under a common motion, as in cloth: signal a thousandth of the input."""
    points_t0 = touching(kind, n, rng, dimension)
    points_t0[:, first_of_pair(kind)] += 1e-3 * rng.normal(size=(n, 1, dimension))
    common = 0.1 * rng.normal(size=(n, 1, dimension))
    return as_points(points_t0, points_t0 + common + 3e-3 * rng.normal(size=points_t0.shape))


@_family(fails="none but the ends")
def static_partner(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """One side never moves: its terms cancel in the polynomials and lower their degree."""
    points_t0, points_t1 = colliding(kind, n, rng, dimension)
    still = np.zeros(points_t0.shape[1], dtype=bool)
    still[first_of_pair(kind)] = True
    still = np.where(rng.random((n, 1)) < 0.5, still, ~still)
    return as_points(points_t0, np.where(still[:, :, None], points_t0, points_t1))


# ---- Exact degeneracies ----------------------------------------------------------------------------------------------


@_family(fails="univariate by barycentric coordinates: misses on faces without area")
def lattice(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Coordinates in {0, 1, 2, 3}: repeated points, parallels, common planes and touching starts by the dozen."""
    shape = (n, POINTS[kind], dimension)
    return as_points(rng.integers(0, 4, shape), rng.integers(0, 4, shape))


@_family(fails="univariate: the cubic is zero, misses a third to a half; Tight-Inclusion: over 10 ms for half")
def one_plane(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Everything stays in one plane, flat or tilted: the coplanarity cubic vanishes and says nothing."""
    basis = rng.integers(-3, 4, (n, 2, dimension))
    axis = rng.integers(0, dimension, n)
    flat = np.stack([np.eye(dimension)[axis], np.eye(dimension)[(axis + 1) % dimension]], axis=1)
    basis = np.where(rng.random((n, 1, 1)) < 0.5, flat, basis)
    origin = rng.integers(-3, 4, (n, 1, dimension))
    coordinates = rng.integers(-4, 5, (2, n, POINTS[kind], 2))
    return as_points(*(origin + np.einsum("npk,nkd->npd", c, basis) for c in coordinates))


@_family(fails="univariate: the cubic is zero, sees the ends alone; Tight-Inclusion: over 10 ms for nine in ten")
def collinear(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Everything stays on one line: every normal vanishes, and only order along the line decides."""
    direction = rng.integers(-3, 4, (n, 1, dimension))
    origin = rng.integers(-3, 4, (n, 1, dimension))
    coordinates = rng.integers(-9, 10, (2, n, POINTS[kind], 1))
    return as_points(*(origin + c * direction for c in coordinates))


@_family(fails="univariate: the cubic is zero, misses a quarter of the edges; Tight-Inclusion: over 10 ms for a third")
def parallel_edges(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Edges stay parallel, and approach, overlap or slide along one line: their common normal vanishes."""
    direction = rng.integers(-3, 4, (n, 1, dimension))
    along = rng.integers(-4, 5, (2, n, POINTS[kind], 1))
    # Offsets of the two sides from the line; zero at both ends slides along it, of opposite sign passes through it.
    side = rng.integers(-2, 3, (n, 1, dimension))
    offset = rng.integers(-1, 2, (2, n, 1, 1)) * side
    points = along * direction
    points[:, :, first_of_pair(kind)] += offset
    if kind == "vertex-face":
        points[:, :, 3] += rng.integers(-3, 4, (n, dimension))
    return as_points(points[0], points[1])


@_family(fails="univariate: misses one in twenty; additive CCD: toi is nan for a quarter of the faces")
def zero_size_primitives(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Faces without area and edges without length, some for the whole step, some at one end of it."""
    points_t0, points_t1 = half_and_half(lattice_contact(kind, n, rng, dimension), lattice(kind, n, rng, dimension))
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
    return as_points(points_t0, points_t1)


@_family(fails="additive CCD: misses half of the vertices, at a distance that is not zero after rounding")
def no_motion(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Nothing moves, touching or not: every polynomial in t is constant."""
    points_t0, _ = half_and_half(
        lattice_contact(kind, n, rng, dimension, eighths=(0, 0)), lattice(kind, n, rng, dimension)
    )
    return as_points(points_t0, points_t0)


@_family(fails="additive CCD: misses one vertex in eight, at a distance that is not zero after rounding")
def touching_at_start(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Contact exactly at t = 0, often leaving at once: the toi is 0 and nothing may exceed it."""
    return lattice_contact(kind, n, rng, dimension, eighths=(0, 0), u=(0, 4), v=(0, 4))


@_family(fails="univariate by barycentric coordinates: misses on faces without area")
def contact_exactly_at_end(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Contact exactly at t = 1, the closed end of the step."""
    return lattice_contact(kind, n, rng, dimension, eighths=(8, 8), u=(0, 4), v=(0, 4))


@_family(fails="none but the ends; any search for a change of sign alone, for there is none")
def double_root(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Touches at one instant and parts on the same side: the cubic has a double root and never changes sign."""
    if kind == "point-point":
        return lattice_contact(kind, n, rng, dimension)
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
    return as_points(*points)


@_family(fails="univariate: the cubic is zero, misses a tenth to a third; Tight-Inclusion: over 10 ms for a quarter")
def sliding_in_plane_rotating(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """All points slide in a common plane that itself turns: coplanar for all t, yet with no fixed normal."""
    coordinates = rng.integers(-4, 5, (n, POINTS[kind], 2))
    slide = rng.integers(-4, 5, (n, POINTS[kind], 1))
    axis, start, end = (rng.integers(-3, 4, (n, 1, dimension)) for _ in range(3))
    # The plane at t is spanned by the fixed axis and (1 - t) start + t end; points slide along the axis only.
    points_t0 = coordinates[:, :, :1] * axis + coordinates[:, :, 1:] * start
    points_t1 = (coordinates[:, :, :1] + slide) * axis + coordinates[:, :, 1:] * end
    return as_points(points_t0, points_t1)


@_family(fails="univariate: misses 1 of 200 at 1e-9, where rounding splits a double root")
def grazing_vertex(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """A corner of one meets a corner of the other for one instant: both parameters sit at the ends of their range."""
    return lattice_contact(kind, n, rng, dimension, u=(0, 0), v=(0, 0))


@_family(fails="univariate by barycentric coordinates: misses on faces without area")
def edge_through_vertex(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """An edge passes exactly through a vertex or along the rim of a face: one parameter at the end of its range."""
    return lattice_contact(kind, n, rng, dimension, u=(1, 7), v=(0, 0))


@_family(fails="univariate: misses 1 of 140; all: phantoms, for one ulp is within any tolerance")
def one_ulp_neighbours(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """An exact contact at a boundary with one coordinate moved by one ulp: hit or miss by 1e-16, or by 5e-324."""
    boundary = lattice_contact(kind, n, rng, dimension, u=(0, 8), v=(0, 0))
    at_end = lattice_contact(kind, n, rng, dimension, eighths=(0, 8), u=(0, 4), v=(0, 4))
    points_t0, points_t1 = half_and_half(boundary, at_end)
    points = np.stack([points_t0, points_t1], axis=1)
    flat = points.reshape(n, -1)
    query, coordinate = np.arange(n), rng.integers(0, flat.shape[1], n)
    towards = rng.choice([-np.inf, np.inf], n)
    flat[query, coordinate] = np.nextafter(flat[query, coordinate], towards)
    return as_points(points[:, 0], points[:, 1])


@_family(
    fails=(
        "univariate: a double root, misses a tenth at 1e-9, most faces by barycentric coordinates; "
        "Tight-Inclusion: over 10 ms for all"
    )
)
def simultaneous_contacts(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Edges fall into one line and overlap, a face closes on the vertex: contact all along a line at one instant."""
    q = rng.integers(-3, 4, (n, dimension))
    r = rng.choice([-2, -1, 1, 2], (n, 1)) * q
    if kind == "point-segment":
        # Half of the segments shrink to a point when they meet the other one.
        q = q * rng.integers(0, 2, (n, 1))
    return lattice_contact(kind, n, rng, dimension, u=(0, 4), v=(0, 4), q=q, r=r)


@_family(fails="univariate: the cubic is zero or noise, misses half; Tight-Inclusion: over 10 ms for two thirds")
def infinite_roots(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Collisions inside a common tilted plane, by sliding or turning: every time is a root of the coplanarity cubic."""
    # In the plane: a corner that meets an edge of the other side, or a side that turns by a quarter or a half.
    meeting = lattice_contact(kind, n, rng, 2, u=(0, 0), v=(1, 7))
    start, center = rng.integers(-4, 5, (n, POINTS[kind], 2)), rng.integers(-4, 5, (n, 1, 2))
    arm = start - center
    end = center + np.where(rng.random((n, 1, 1)) < 0.5, arm[:, :, ::-1] * [-1, 1], -arm)
    end[:, first_of_pair(kind)] = start[:, first_of_pair(kind)]
    points = half_and_half(meeting, (start, end))
    # Slopes of small integers leave the cubic exactly zero; the products of large ones are rounded to noise.
    slope = np.concatenate([np.tile(np.eye(2, dtype=int), (n, 1, 1)), rng.integers(-3, 4, (n, 2, 1))], axis=2)
    steep = rng.integers(-(2**25), 2**25, (n, 2, dimension))
    basis = np.where(rng.random((n, 1, 1)) < 0.5, slope[:, :, :dimension], steep)
    return as_points(*(np.einsum("npk,nkd->npd", p, basis) for p in points))


@_family(
    fails="ends, univariate: know no separation; Tight-Inclusion: over 10 ms for seven in ten", minimum_separation=0.25
)
def separation_exactly_the_gap(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Comes as near as the minimum separation along an axis, exactly, and no nearer, for an instant or throughout."""
    # Across that axis the two meet at the start, in between, or at the end; along it they leave, keep or close the gap.
    across = [lattice_contact(kind, n, rng, dimension - 1, eighths=k) for k in ((0, 0), (1, 7), (8, 8))]
    rise = rng.integers(1, 4, n)
    rises = np.array([[0 * rise, rise], [0 * rise, 0 * rise], [rise, 0 * rise]])
    which, side, drift = rng.integers(0, 3, n), rng.choice([-1, 1], n), rng.integers(-3, 4, (2, n))
    order = rng.permuted(np.tile(np.arange(dimension), (n, 1)), axis=1)[:, None]
    frames = []
    for k in range(2):
        along = np.tile(drift[k, :, None, None].astype(float), (1, POINTS[kind], 1))
        along[:, first_of_pair(kind)] += (side * (0.25 + rises[which, k, np.arange(n)]))[:, None, None]
        points = np.stack([a[k] for a in across])[which, np.arange(n)]
        frames.append(np.take_along_axis(np.concatenate([points, along], axis=2), order, axis=2))
    return as_points(*frames)


# ---- Scale -----------------------------------------------------------------------------------------------------------


@_family(fails="none but the ends")
def offset_1e6(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Far from the origin: an error bound that scales with the coordinates is a million times too wide."""
    points_t0, points_t1 = colliding(kind, n, rng, dimension)
    return as_points(points_t0 + 1e6, points_t1 + 1e6)


def _scaled(kind: str, n: int, rng: np.random.Generator, dimension: int, scale: float) -> Points:
    points = half_and_half(colliding(kind, n, rng, dimension), lattice(kind, n, rng, dimension))
    return as_points(scale * points[0], scale * points[1])


@_family(fails="additive CCD: toi is nan for three quarters of the edges")
def scaled_2_pow_200(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Coordinates near 1e60: squares and triple products overflow in float32 and strain float64."""
    return _scaled(kind, n, rng, dimension, 2.0**200)


@_family(fails="additive CCD: misses two thirds of the vertices, a fifth of the edges, below its absolute epsilon")
def scaled_2_pow_minus_200(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Coordinates near 1e-60: any absolute epsilon swallows the whole scene, and products of six underflow."""
    return _scaled(kind, n, rng, dimension, 2.0**-200)


@_family(fails="univariate: misses three quarters at 1e-9, and 1 of 200 at 1e-6")
def mixed_axis_scales(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Axes of scale 1e-7, 1 and 1e5: one bound for all axes hides the smallest of them."""
    points_t0, points_t1 = colliding(kind, n, rng, dimension)
    scale = rng.permuted(np.tile([1e-7, 1.0, 1e5], (n, 1)), axis=1)[:, None, :dimension]
    return as_points(scale * points_t0, scale * points_t1)


@_family(fails="none but the ends; a closed form for all roots, without deflation, misses a tenth")
def mixed_sizes(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """One edge a hundred thousandth to a billionth of the other, moving as one: a target that is easily overlooked."""
    scale = 10.0 ** rng.uniform(-9, -5, (n, 1))
    contact = touching(kind, n, rng, dimension, q=scale * rng.uniform(-1, 1, (n, dimension)))
    motion = scale[:, None] * rng.uniform(-1, 1, contact.shape)
    motion[:, first_of_pair(kind)] += rng.uniform(-1, 1, (n, 1, dimension))
    return passing_through(contact, motion, rng)


@_family(
    fails=(
        "univariate: misses half at 1e-9, a quarter of the faces at 1e-6 by barycentric coordinates; "
        "Tight-Inclusion: over 10 ms for all"
    )
)
def slivers(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Needle triangles and nearly parallel edges, in space and so in parameters: normals lose all their digits."""
    q = rng.uniform(-1, 1, (n, dimension))
    width = 10.0 ** rng.uniform(-12, -3, (n, 1))
    r = rng.uniform(0.2, 1, (n, 1)) * q + width * rng.uniform(-1, 1, (n, dimension))
    contact = touching(kind, n, rng, dimension, q, r)
    return passing_through(contact, rng.uniform(-1, 1, contact.shape), rng)


@_family(
    fails=(
        "univariate: misses nearly a fifth at 1e-9, half of the faces at 1e-6 by barycentric coordinates; additive "
        "CCD: misses one in twenty; Tight-Inclusion: over 10 ms for nearly all"
    )
)
def needle_against_needle(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Needles of aspect 1e-6 to 1e-10 that slide along one another and cross, exactly: contact moves by its width."""
    axis = rng.integers(-3, 4, (n, dimension))
    axis[~axis.any(axis=1)] = 1
    length = 2 ** rng.integers(20, 34, (n, 1)) * axis
    r = rng.choice([-2, -1, 1, 2], (n, 1)) * length + rng.integers(-3, 4, (n, dimension))
    glide = (rng.integers(-3, 4, (n, 1)) * length)[:, None]
    return lattice_contact(kind, n, rng, dimension, q=length, r=r, glide=glide)


@_family(fails="Tight-Inclusion: toi is 0, as all of the motion is below its tolerance")
def tiny_motion(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Motion of 1e-9 beside edges of 1: the toi is set by the last third of the digits."""
    contact = touching(kind, n, rng, dimension)
    return passing_through(contact, 1e-9 * rng.normal(size=contact.shape), rng)


# ---- Large motion ----------------------------------------------------------------------------------------------------


@_family(fails="univariate: half of the near misses are phantoms; Tight-Inclusion: over 10 ms for four in five")
def rotation_like(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Ends of a large rotation joined by straight lines: a small gap shrinks and turns, half the time to a contact."""
    points_t0 = touching(kind, n, rng, dimension)
    gap = 10.0 ** rng.uniform(-9, -2, (n, 1, 1)) * unit(rng.normal(size=(n, 1, dimension)))
    points_t0[:, first_of_pair(kind)] += gap
    angle = rng.uniform(1.0, 3.1, (n, 1, 1))
    plane = np.linalg.qr(rng.normal(size=(n, dimension, 2)))[0].transpose(0, 2, 1)
    first, second = plane[:, :1], plane[:, 1:]
    x, y = (np.sum(points_t0 * axis, axis=2, keepdims=True) for axis in (first, second))
    points_t1 = points_t0 + (np.cos(angle) - 1) * (x * first + y * second) + np.sin(angle) * (x * second - y * first)
    # The chord of a rotation below pi is an invertible map at each t, so without this the gap never closes.
    turned = points_t1[:, first_of_pair(kind)]
    approach = np.where(rng.random((n, 1, 1)) < 0.5, 0.0, rng.uniform(0, 10, (n, 1, 1)))
    turned -= approach * np.linalg.norm(gap, axis=2, keepdims=True) * unit(rng.normal(size=(n, 1, dimension)))
    return as_points(points_t0, points_t1)


@_family(fails="none but the ends")
def fast_and_thin(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Motion a thousand times the size of the primitives: no overlap at either end, and a toi of few digits."""
    contact = touching(kind, n, rng, dimension)
    motion = rng.uniform(-1, 1, contact.shape)
    motion[:, first_of_pair(kind)] += 1e3 * rng.normal(size=(n, 1, dimension))
    return passing_through(contact, motion, rng)


@_family(fails="univariate: most near misses are phantoms; Tight-Inclusion: near half of them")
def huge_motion(kind: str, n: int, rng: np.random.Generator, dimension: int = 3) -> Points:
    """Motion of 1e6 to 1e9 times the size: a tolerance relative to all of it is larger than the primitives."""
    contact = touching(kind, n, rng, dimension)
    # Half of them pass by at a few sizes.
    contact[::2, first_of_pair(kind)] += 3.0 * unit(rng.normal(size=(n, 1, dimension)))[::2]
    motion = rng.uniform(-1, 1, contact.shape)
    motion[:, first_of_pair(kind)] += 10.0 ** rng.uniform(6, 9, (n, 1, 1)) * unit(rng.normal(size=(n, 1, dimension)))
    return passing_through(contact, motion, rng)
