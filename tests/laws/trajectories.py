"""The first time at which two primitives touch that move on any trajectories, in interval arithmetic.

A **trajectory** is a function that takes time and returns points. Time is a polynomial t(s) = middle + half·s, and so
is what a trajectory makes of it, by sums, products and `sine_and_cosine`: it encloses the points at all s in [-1, 1],
as the constant coefficient carries the rest of a series as its radius. Numbers of float64 count as exact. It shares no
code with the kernels or the engine, and its only idea of a motion is its definition.

A primitive touches another where some functions of time vanish and others are not negative. For the distance zero a
pair has one such **feature**; what is within D > 0 of a primitive is a slab over its inside, cylinders around edges
and balls around vertices. Each function is enclosed on an interval by c0 + c1·s + [-E, E], which says where in it it
can hold, and where it certainly does. What is left is looked at again: near a contact the width falls quadratically.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import wraps
from itertools import product
from typing import NamedTuple

from flint import arb, arb_poly, ctx

BITS = 256  # 77 digits
TERMS = 14  # of a polynomial: for a turn of 1 rad in half an interval, 1/14! = 1e-11 is left out
UNIT, _ZERO, _ONE = arb(0, 1), arb(0), arb(1)
_WIDTH, _LEAST_WIDTH = arb(2) ** -72, arb(2) ** -104  # of an answer, 2e-22, and of an interval that is looked at
_LARGEST_TURN = 1.5  # rad, of half an interval
_MOST_LOOKS, _LOOKS_AFTER_DOUBT = 4000, 300  # the latter at what comes after an interval without an answer

Vector = list  # of three numbers or polynomials
Trajectory = Callable[[arb_poly], list[Vector]]


class TooLong(Exception):
    """Something turns in an interval by more than a series is good for."""


class Answer(NamedTuple):
    """No contact before `lo`, or none at all if it is None; a contact by `hi`, or none that is certain."""

    lo: arb | None
    hi: arb | None
    looks: int


def precise(function):
    """A function that computes with all digits."""

    @wraps(function)
    def with_digits(*arguments, **options):
        with ctx.workprec(BITS):
            return function(*arguments, **options)

    return with_digits


# --- vectors of numbers and of polynomials ---


def exact(values) -> Vector:
    return [arb(float(value)) for value in values]


def add(a: Vector, b: Vector) -> Vector:
    return [x + y for x, y in zip(a, b, strict=True)]


def sub(a: Vector, b: Vector) -> Vector:
    return [x - y for x, y in zip(a, b, strict=True)]


def scaled(factor, a: Vector) -> Vector:
    return [x * factor for x in a]


def dot(a: Vector, b: Vector):
    return short(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Vector, b: Vector) -> Vector:
    return [short(a[i] * b[j] - a[j] * b[i]) for i, j in ((1, 2), (2, 0), (0, 1))]


def short(p):
    """A polynomial of few terms that encloses this one for all s in [-1, 1]."""
    if not isinstance(p, arb_poly) or p.length() <= TERMS:
        return p
    return p.truncate(TERMS) + p.right_shift(TERMS)(UNIT) * UNIT


def middles(vector: Vector) -> Vector:
    """Numbers near the values of polynomials in the middle of the interval."""
    return [arb_poly(x)[0].mid() for x in vector]


def sine_and_cosine(angle: arb_poly) -> tuple[arb_poly, arb_poly]:
    """Of a polynomial, by Taylor's theorem about its value in the middle."""
    sine, cosine = angle[0].sin_cos()
    part = angle - angle[0]
    if not (most := part(UNIT).abs_upper()) <= _LARGEST_TURN:
        raise TooLong
    sines, cosines, power, size = arb_poly([sine]), arb_poly([cosine]), arb_poly([1]), _ONE
    for k in range(1, TERMS):
        power, size = short(power * part) * (_ONE / k), size * most / k
        sines += power * (sine, cosine, -sine, -cosine)[k % 4]
        cosines += power * (cosine, -sine, -cosine, sine)[k % 4]
    rest = UNIT * (size * most / TERMS)
    return sines + rest, cosines + rest


@precise
def straight(start, end) -> Trajectory:
    """Points that move straight between positions of shape [points, 3]."""
    rows = [(exact(a), sub(exact(b), exact(a))) for a, b in zip(start, end, strict=True)]
    return lambda t: [[x + v * t for x, v in zip(*row, strict=True)] for row in rows]


# --- features: what must vanish, what must not be negative, and without what that says nothing ---

ZERO, NOT_NEGATIVE, SPEAKS = range(3)
Conditions = Iterator[tuple[int, object]]
Feature = Callable[[list[Vector], list[Vector]], Conditions]


def _ball(p: Vector, q: Vector, squared: arb | None) -> Conditions:
    w = sub(p, q)
    if squared is None:
        yield from ((ZERO, x) for x in w)
    else:
        yield NOT_NEGATIVE, squared - dot(w, w)


def _on_segment(p: Vector, a: Vector, b: Vector, squared: arb | None) -> Conditions:
    w, e = sub(p, a), sub(b, a)
    area, length, along = cross(w, e), dot(e, e), dot(w, e)
    if squared is None:
        yield from ((ZERO, x) for x in area)
    else:
        yield NOT_NEGATIVE, squared * length - dot(area, area)
    yield from ((NOT_NEGATIVE, along), (NOT_NEGATIVE, length - along))
    yield SPEAKS, length  # an edge of two equal points proves no contact


def _slab(w: Vector, e1: Vector, e2: Vector, is_face: bool, squared: arb | None) -> Conditions:
    n = cross(e1, e2)
    height, area = dot(n, w), dot(n, n)
    yield (ZERO, height) if squared is None else (NOT_NEGATIVE, squared * area - short(height * height))
    u = dot(cross(w, e2), n)
    yield NOT_NEGATIVE, u
    v = dot(cross(e1, w) if is_face else cross(w, e1), n)
    yield NOT_NEGATIVE, v
    yield from [(NOT_NEGATIVE, area - u - v)] if is_face else [(NOT_NEGATIVE, area - u), (NOT_NEGATIVE, area - v)]
    yield SPEAKS, area  # nor does a normal that vanishes, as that of parallel edges


def _below(p: Vector, plane: list[Vector], distance: arb) -> Conditions:
    point, normal = plane[0], middles(plane[1])
    yield NOT_NEGATIVE, distance * dot(normal, normal).sqrt() - dot(sub(p, point), normal)


def features(kind: str, distance: arb) -> list[Feature]:
    """Those of a kind of pair."""
    squared = None if distance.is_zero() else distance * distance

    def balls(*counts: int) -> list[Feature]:
        return [lambda a, b, i=i, j=j: _ball(a[i], b[j], squared) for i, j in product(*map(range, counts))]

    def cylinders(side: int, count: int, ends) -> list[Feature]:
        places = product(range(count), ends)
        return [lambda *x, k=k, e=e: _on_segment(x[side][k], *(x[1 - side][i] for i in e), squared) for k, e in places]

    if kind == "vertex-plane":
        return [lambda a, b: _below(a[0], b, distance)]
    if kind == "point-point":
        return balls(1, 1)
    if kind == "point-segment":
        return cylinders(0, 1, [(0, 1)]) + (balls(1, 2) if squared is not None else [])
    if kind == "vertex-face":
        slab = lambda a, b: _slab(sub(a[0], b[0]), sub(b[1], b[0]), sub(b[2], b[0]), True, squared)  # noqa: E731
        around = cylinders(0, 1, [(0, 1), (1, 2), (2, 0)]) + balls(1, 3)
    else:
        slab = lambda a, b: _slab(sub(b[0], a[0]), sub(a[1], a[0]), sub(b[1], b[0]), False, squared)  # noqa: E731
        around = cylinders(0, 2, [(0, 1)]) + cylinders(1, 2, [(0, 1)]) + balls(2, 2)
    return [slab, *(around if squared is not None else [])]


# --- the search ---


class Parts:
    """Where in s ∈ [−1, 1] all conditions may hold, and where they certainly do."""

    def __init__(self):
        self.may, self.does = [-_ONE, _ONE], [-_ONE, _ONE]
        self.root, self.roots = None, 0  # of the functions that must vanish and are not zero throughout

    @staticmethod
    def _cut(which: list, low: arb, high: arb) -> None:
        which[0] = low if low > which[0] else which[0]
        which[1] = high if high < which[1] else which[1]

    def zero(self, p: arb_poly) -> None:
        c0, c1, rest = _linear(p)
        self.roots += p.length() > 0
        if c1 > 0 or c1 < 0:
            root = (-c0 + rest * UNIT) / c1
            self._cut(self.may, root.lower(), root.upper())
            self.root = (root.lower(), root.upper()) if root.lower() >= -1 and root.upper() <= 1 else self.root
        elif abs(c0).lower() > rest + c1.abs_upper():
            self._cut(self.may, _ONE, -_ONE)

    def not_negative(self, p: arb_poly) -> None:
        c0, c1, rest = _linear(p)
        for which, c in ((self.may, (c0 + rest).upper()), (self.does, (c0 - rest).lower())):
            is_inward, root = which is self.does, -c / c1
            if c1 > 0:
                self._cut(which, root.upper() if is_inward else root.lower(), _ONE)
            elif c1 < 0:
                self._cut(which, -_ONE, root.lower() if is_inward else root.upper())
            elif not c - c1.abs_upper() >= 0 if is_inward else c + c1.abs_upper() < 0:
                self._cut(which, _ONE, -_ONE)

    def contact(self) -> arb | None:
        """An s by which all conditions have certainly held at once, if there is one."""
        low, high = self.does
        if self.roots == 0:
            return low if low <= high else None
        is_one = self.roots == 1 and self.root is not None and low <= self.root[0] and self.root[1] <= high
        return self.root[1] if is_one else None


def _linear(p: arb_poly) -> tuple[arb, arb, arb]:
    """c0, c1 and E of an enclosure c0 + c1·s + [−E, E]."""
    return p[0], p[1], p.right_shift(2)(UNIT).abs_upper() if p.length() > 2 else _ZERO


def _is_positive(p: arb_poly) -> bool:
    return bool(p[0] - (p.right_shift(1)(UNIT).abs_upper() if p.length() > 1 else 0) > 0)


def _look(feature: Feature, sides, a: arb, b: arb, distance: arb) -> tuple[arb, arb, arb | None] | None:
    """What is left of an interval, and a time by which there is a contact; None if there is none in it."""
    middle = ((a + b) / 2).mid()
    right, left = (b - middle).upper(), (middle - a).upper()
    half, parts, speaks = right if right > left else left, Parts(), True
    points = [side(arb_poly([middle, half])) for side in sides]
    for what, value in feature(*points):
        if what == SPEAKS:
            speaks = _is_positive(arb_poly(value))
        else:
            (parts.zero if what == ZERO else parts.not_negative)(arb_poly(value))
            if parts.may[0] > parts.may[1]:
                return None
    low, high = (middle + half * s for s in parts.may)
    low, high = low.lower() if low.lower() > a else a, high.upper() if high.upper() < b else b
    if low > high or (not speaks and _is_separated(*points, distance)):
        return None
    found = parts.contact() if speaks else None
    if found is not None:
        found = (middle + half * found).upper()
        found = a if found < a else found if found <= b else None
    return low, high, found


def _touches_at(feature: Feature, sides, t: arb) -> bool:
    values = [(what, arb_poly(value)[0]) for what, value in feature(*(side(arb_poly([t])) for side in sides))]
    return all(x.is_zero() if what == ZERO else x >= 0 if what == NOT_NEGATIVE else x > 0 for what, x in values)


def _is_separated(a: list[Vector], b: list[Vector], distance: arb) -> bool:
    """Whether a direction that moves as the points do, or one that stays, keeps the primitives apart all the time."""
    corners = [sub(p, q) for p, q in product(a, b)]
    edges = [sub(side[k], side[0]) for side in (a, b) for k in range(1, len(side))]
    directions, best, margin = [*corners, *(cross(e, f) for k, e in enumerate(edges) for f in edges[:k])], None, _ZERO
    for e, c in product(edges, corners):
        if (length := dot(middles(e), middles(e))) > 0:
            directions.append(sub(c, scaled((dot(middles(c), middles(e)) / length).mid(), e)))
    for d in (scaled(sign, d) for d in directions for sign in (1, -1)):
        if (length := dot(middles(d), middles(d)).sqrt()) > 0:
            least = min((dot(middles(d), middles(c)) / length for c in corners), key=float).mid()
            best, margin = (d, least) if least > margin else (best, margin)
    for d in [] if best is None else [best, middles(best)]:
        values, bound = [dot(c, d) for c in corners], dot(d, d) * (distance * distance)
        values += [] if distance.is_zero() else [short(v * v) - bound for v in values]
        if all(_is_positive(arb_poly(v)) for v in values):
            return True
    return False


def search(feature: Feature, sides, distance: arb, end: arb = _ONE) -> Answer:
    """The first time at which a feature touches."""
    stack, most, looks, lo, hi = [(_ZERO, end)], _MOST_LOOKS, 0, None, None
    while stack:
        a, b = stack.pop()
        try:
            left = _look(feature, sides, a, b, distance) if looks < most else (a, b, None)
        except TooLong:
            stack += [(((a + b) / 2).mid(), b), (a, ((a + b) / 2).mid())]  # the earlier half is popped first
            continue
        looks += 1
        if left is None:
            continue
        low, high, contact = left
        if contact is not None:
            hi, high = contact, contact
            stack.clear()
        if looks > most or high - low < (_WIDTH if hi is not None else _LEAST_WIDTH):
            hi = low if hi is None and _touches_at(feature, sides, low) else hi
            lo = low if lo is None else lo
            if hi is not None or looks > most:
                break
            most = min(most, looks + _LOOKS_AFTER_DOUBT)
        else:
            middle = ((low + high) / 2).mid()
            stack += [(low, high)] if high - low < 0.6 * (b - a) else [(middle, high), (low, middle)]
    return Answer(lo, hi, looks)


@precise
def first_contact(kind: str, a: Trajectory, b: Trajectory, distance: float = 0.0) -> Answer:
    """When two primitives first come within a Euclidean distance of each other, in [0, 1].

    Args:
        kind: "vertex-face", "edge-edge", "point-segment", "point-point", or "vertex-plane".
        a, b: Of the vertex, first edge or point, and of the other primitive; of a plane a point, and the normal.
        distance: Its float64 value is exact; 0 for touching.
    """
    bound, lo, hi, looks = arb(float(distance)), None, None, 0
    for feature in features(kind, bound):
        found = search(feature, (a, b), bound, _ONE if hi is None else hi)
        looks += found.looks
        lo = found.lo if lo is None or (found.lo is not None and found.lo < lo) else lo
        hi = found.hi if hi is None or (found.hi is not None and found.hi < hi) else hi
    return Answer(lo, hi, looks)
