"""The steps of `kernels/pair/rounding.py`, counted on the kernels' own files: how much of what is allowed each loses.

Every function is executed on numbers that count their roundings (`counted`), and what it gives is compared with the
definition on the way. The table at the end of the docstring of `rounding` has to say what comes out.
"""

import re
from fractions import Fraction
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from ccd_warp.kernels.pair import rounding
from ccd_warp.kernels.pair_kind import POINT_POINT, POINT_SEGMENT
from counted import House, Number, Vector, comparisons, dot, given, number, numeral, parameter, vector

from ccd_warp._at_one_time.proximities import largest_bound

REALS = ("float64", "float32")
SECOND_ORDER = 1.001  # what products of roundings add
CORNERS = ("w00", "w01", "w10", "w11")
ONES = Vector(*[numeral(1)] * 3)
# the corners and sides of a pair, from the definition of its kind
OF_KIND = {0: "01 02 03 03 12 13", 1: "02 03 12 13 23 10"}
OF_KIND |= {POINT_SEGMENT: "01 02 01 02 12", POINT_POINT: "01 01 01 01"}


def share(lost, allowed, where=True):
    """The largest part of what is allowed that is taken at any of some inputs; all of it where nothing is."""
    lost, allowed, where = np.broadcast_arrays(lost, allowed, where)
    assert where.sum() > 100
    with np.errstate(all="ignore"):
        taken = np.where(lost == 0, 0, np.where(allowed > 0, lost / allowed, np.inf))
    assert not np.isnan(taken[where]).any()
    return taken[where].max()


def at_least(x, where=True):
    """The share that is taken of what a number is raised by."""
    return share(x.lost, x.shift, where)


def at_most(x, where=True):
    """The share that is taken of what it is lowered by."""
    return share(x.lost, -x.shift, where)


def before_last(x):
    """The share of what a number is lowered by that is taken before its last rounding."""
    return share(x.lost - x.last, -x.shift)


def is_same(x, exact, where=True):
    """Whether a number is what the definition says, but for the double precision of both."""
    difference = np.abs(np.subtract(x.value if isinstance(x, Number) else x, exact))
    return (np.broadcast_to(difference, np.shape(where) or np.shape(difference))[where] < 1e-12).all()


def values(v):
    """The values of a vector, as an array."""
    return np.array([x.value for x in v.of])


class Pair:
    """The files for a precision and a norm, and a pair in normalised units."""

    def __init__(self, real, norm="maximum"):
        self.house = House(real)
        self.unit, self.own = self.house.units["float64"], self.house.units[real]
        self.load = lambda name, **p: self.house.load(name, **{"norm": norm, **p})
        names = "points in_precision lane_pair sub_patch patch inclusion solver moving_clip facets volume simd ball"
        for name in names.split():
            setattr(self, name, self.load(f"pair.{name}"))
        f64 = {"real": self.house.types["float64"]}
        self.corners64 = [self.load("pair.patch", **f64).Corners() for _ in range(2)]
        for end, corners in enumerate(self.corners64):
            for name in (*CORNERS, "q", "r"):
                setattr(corners, name, vector(f"{name}.{end}", self.unit, unit=self.unit))
        self.t0, self.t1 = (self.in_precision.normalised(c, ONES) for c in self.corners64)
        size = self.load("pair.simd", **f64).greatest(*map(self.points.largest, self.corners64))
        separation = vector("S", unit=self.unit, positive=True)
        if norm != "maximum":
            separation = Vector(*[separation.x] * 3)
        narrowed = self.in_precision.narrowed
        lane = self.lane_pair.with_bounds(self.lane_pair.LanePair(), *map(narrowed, (size, separation, ONES)))
        self.size, self.error, self.separation = narrowed(size), lane.error, lane.separation
        self.sub_error = self.solver.patch_bound * self.size
        self.d = self.vector("d.")
        self.t, self.x, self.end = (self.typed(parameter(name)) for name in ("t", "x", "end"))
        u = [[self.typed(parameter(f"{name}{k}", is_dyadic=True)) for k in range(2)] for name in "uv"]
        self.sub_t0, self.sub_t1 = (self.sub_patch.sub_corners(c, *u[0], *u[1]) for c in (self.t0, self.t1))
        self.u, self.v = ([x.value for x in y] for y in u)
        # whole patches, and sub-patches, with the constant of what a projection loses
        self.patches = {
            "root": (rounding.PROJECTION_ROOT, (self.t0, self.t1), self.error),
            "patch": (rounding.PROJECTION_PATCH, (self.sub_t0, self.sub_t1), self.sub_error),
        }

    def typed(self, x):
        x.unit = self.own
        return x

    def vector(self, name, **more):
        return vector(name, unit=self.own, **more)

    def numbers(self, *names, **more):
        return [number(name, unit=self.own, **more) for name in names]


def recorded(module, name, result):
    """The arguments of all calls of a function in a module, which is replaced."""
    calls = []
    setattr(module, name, lambda *args: (calls.append(args), result(*args))[1])
    return calls


# ---- The steps: for each row of the table the share that is taken, and what is allowed ----


def step_1(real):
    """Differences."""
    p = Pair(real)
    points = [vector(f"p{k}.", unit=p.unit) for k in range(4)]
    of = SimpleNamespace(**{f"p{k}": x for k, x in enumerate(points)})
    for kind, pairs in OF_KIND.items():
        corners = p.load("pair.points", real=p.house.types["float64"]).corners(kind, of)
        for (name, (i, j)), k in product(zip((*CORNERS, "q", "r"), pairs.split(), strict=False), range(3)):
            x = getattr(corners, name)[k]
            assert is_same(x, points[int(i)][k].value - points[int(j)][k].value)
            yield "difference", share(x.lost, np.abs(x.value)) / p.unit, 1


def step_2(real):
    """Normalisation."""
    p = Pair(real)
    scale = Vector(*(p.house.power(x) for x in vector("scale").each(abs).of))
    corners = p.in_precision.normalised(p.corners64[0], scale)
    for name, k in product(CORNERS, range(3)):
        x = getattr(corners, name)[k]
        assert is_same(x, getattr(p.corners64[0], name)[k].value * scale[k].value)
        yield "corner", share(x.lost, np.abs(x.value)), 1


def step_3(real):
    """Corners of a sub-patch."""
    p = Pair(real)
    for (name, (i, j)), k in product(zip(CORNERS, product((0, 1), (0, 1)), strict=True), range(3)):
        u, v = p.u[i], p.v[j]
        weights = ((1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v)
        x = getattr(p.sub_t0, name)[k]
        assert is_same(x, sum(w * getattr(p.t0, c)[k].value for w, c in zip(weights, CORNERS, strict=True)))
        yield "corner", share(x.lost, p.size[k].value) / 5, 5


def step_4(real):
    """Projection."""
    p = Pair(real)
    for name, (allowed, ends, error) in p.patches.items():
        off = p.inclusion.offset(p.d, error)
        calls = recorded(p.inclusion, "clip_corner", lambda *_: numeral(2))
        p.inclusion.clip_beyond(p.d, off, p.t, *ends, False)
        for (corner, (a, b, *_)), k in product(zip(CORNERS, calls, strict=True), (0, 1)):
            assert is_same((a, b)[k], dot(values(p.d), values(getattr(ends[k], corner))))
            yield name, share((a, b)[k].lost, off.shift), allowed


def step_6(real):
    """Offset."""
    p = Pair(real)
    e, m = p.vector("E", positive=True), p.vector("M", positive=True)
    d = np.abs(values(p.d))
    ball = Pair(real, "euclidean").ball.offset(p.d, e, Vector(*[m.x] * 3))
    for name, off, of_separation in (
        ("direction", p.inclusion.offset(p.d, e + m), dot(d, values(m))),
        ("facet", p.facets.offset(p.d, e, m), dot(d, values(m))),
        ("ball", ball, m.x.value * np.sqrt(dot(d, d))),
    ):
        assert is_same(off, dot(d, values(e)) + of_separation)
        yield name, at_least(off), rounding.RELATIVE


def step_7(real):
    """Time."""
    p = Pair(real)
    numbers = a, b, off, t = p.numbers("a", "b", "off", "t")
    s, compared = comparisons(p.inclusion.clip_corner, *numbers)
    first, last = (off.value < x.value for x in (a, b))
    entered = next(x for x, y in compared if y is t)
    exact = (a.value - off.value) / (a.value - b.value)
    assert is_same(entered, exact, last & ~first)
    yield "entered", at_least(entered, last & ~first), rounding.RELATIVE
    stays = last & (first | (exact < t.value))
    assert is_same(s, np.where(stays, 2, np.where(first, exact, -1)))
    yield "left", at_most(s, first & ~last), rounding.RELATIVE


def step_8(real):
    """Corners at a time."""
    p = Pair(real)
    for (name, (_, ends, _)), corner, k in product(p.patches.items(), CORNERS, range(3)):
        a, b = (getattr(x, corner)[k].value for x in ends)
        x = getattr(p.patch.corners_at(*ends, p.t), corner)[k]
        assert is_same(x, (1 - p.t.value) * a + p.t.value * b)
        most = {"root": 4, "patch": 8}[name]
        yield name, share(x.lost, p.size[k].value) / most, most


def cubic(b, y):
    """A cubic from its Bernstein coefficients."""
    return (1 - y) ** 3 * b[0] + 3 * (1 - y) ** 2 * y * b[1] + 3 * (1 - y) * y**2 * b[2] + y**3 * b[3]


def volume_at(p, s):
    """P·(Q×R) at a time."""
    w, q, r = ((1 - s) * values(getattr(p.t0, n)) + s * values(getattr(p.t1, n)) for n in ("w00", "q", "r"))
    return np.einsum("kn,kn->n", w, np.cross(q, r, axis=0))


def support_at(p, s, y, is_local, norm):
    """The cubic above the support of the separation at a time s, at a share y of [t, x], as it is defined."""

    def along(a, b):
        (q0, r0), (q1, r1) = (
            [(1 - e) * values(getattr(p.t0, n)) + e * values(getattr(p.t1, n)) for n in "qr"] for e in (a, b)
        )
        n = (np.cross(q0, r1, axis=0) + np.cross(q1, r0, axis=0)) / 2
        of_norm = np.linalg.norm(n, axis=0) if norm != "maximum" else 0
        return p.separation.x.value * of_norm if norm != "maximum" else dot(values(p.separation), np.abs(n))

    t, x = (p.t.value, p.x.value) if is_local else (0, 1)
    a, b, c = along(t, t), along(t, x), along(x, x)
    return cubic((a, (a + 2 * b) / 3, (2 * b + c) / 3, c), y if is_local else s)


def step_9(real):
    """Volume."""
    name = "volume" if real == "float64" else "restriction"
    yield from clipped(Pair(real), 3)
    of_norms = [("maximum", False, False), *product(("maximum", "euclidean"), [True], [False, True])]
    for norm, has_separation, is_local in of_norms:
        p = Pair(real, norm)
        f = p.in_precision.volume_between(*p.corners64, ONES, p.t0, p.t1, p.separation, has_separation)
        h = p.volume.beyond_bound(f, p.t, p.x)
        if has_separation:
            local = p.volume.separation_offset(f, p.separation, p.t, p.x) if is_local else None
            h = p.volume.lowered(h, local or p.volume.restrict(p.volume.reach_of(f, p.separation), p.t, p.x))
        b, t, x = [h.c0, h.c1, h.c2, h.c3], p.t.value, p.x.value
        sign = np.where(volume_at(p, t) < 0, -1, 1)
        for y in (0, 0.25, 2 / 3, 1):
            s = (1 - y) * t + y * x
            of_separation = support_at(p, s, y, is_local, norm) if has_separation else 0
            # where the volume vanishes its sign is one of rounding
            decided = np.abs(volume_at(p, t)) > 1e-14
            assert is_same(cubic([c.value for c in b], y), sign * volume_at(p, s) - of_separation, decided)
        for c in b:
            yield name + " of a separation" * has_separation, before_last(c), getattr(rounding, name.upper())


def clipped(p, degree):
    """The end of a clip whose control points are rounded once, and of which any decides, on either side of 0."""
    rng = np.random.default_rng(degree)
    (c0,) = p.numbers("c0", positive=True, roundings=p.own)
    n, lines = len(c0.value), [Fraction(degree - j, degree) for j in range(1, degree + 1)]
    c = [c0]
    for left in lines:
        # at most so much of the first where it decides: often nearly that, or around zero
        of_first = np.where(rng.random(n) < 0.4, float(left) - rng.choice([1e-9, 1e-3], n), rng.uniform(-1, 1, n))
        x = c0.value * np.where(rng.random(n) < 0.2, rng.choice([-1e-9, 1e-9], n), of_first)
        c.append(Number(x, 0.0, p.own * np.abs(x), p.own * np.abs(x), p.own))
    steepest = [(1 - x.value / c0.value) * degree / j for j, x in enumerate(c[1:], 1)]
    theta = 1 / np.max(steepest, axis=0)
    if degree == 2:
        clip = p.moving_clip.clip_along(None, lambda *_: p.d, p.facets.offset)
        p.moving_clip.corner_crossing = lambda *_: p.moving_clip.crossing(*c)
        s = clip(p.t0, p.t1, p.separation, p.error, None, p.t, p.x, 1)
    else:
        h = p.volume.Hull()
        h.c0, h.c1, h.c2, h.c3 = c
        s = p.volume.clip_hull(h, p.t, p.x, p.x)[0]
    t, x = p.t.value, p.x.value
    ends = (np.min([y.value for y in c[1:]], axis=0) <= 0) & (t < x)
    exact = t + (x - t) * theta
    gains = ends & (exact > t + 1e-9)
    assert is_same(s, exact, gains)
    for j, is_positive in product(range(degree), (False, True)):
        decides = gains & (np.argmax(steepest, axis=0) == j) & ((c[j + 1].value > 0) == is_positive)
        if j < degree - 1 or not is_positive:
            yield "crossing", at_most(s, decides), rounding.CROSSING + rounding.RELATIVE


def step_10(real):
    """Moving facets."""
    yield from clipped(Pair(real), 2)
    p = Pair(real)
    d = [p.vector("d.0"), p.vector("d.1")]
    for name, (allowed, ends, error) in p.patches.items():
        clip = p.moving_clip.clip_along(None, lambda which, _: next(which), p.facets.offset)
        calls = recorded(p.moving_clip, "crossing", lambda *_: numeral(2))
        clip(*ends, p.separation, error, iter(d * 2), p.t, p.x, 1)
        off = [dot(np.abs(values(y)), values(p.separation)) for y in d]
        at = [p.patch.corners_at(*ends, s) for s in (p.t, p.x)]
        sign = np.where(dot(values(d[0]), values(at[0].w00)) < 0, -1, 1)
        for corner, h in zip(CORNERS, calls, strict=True):
            (a, b), (c, e) = ([sign * dot(values(y), values(getattr(w, corner))) for w in at] for y in d)
            for x, y in zip(h, (a - off[0], (b + c - sum(off)) / 2, e - off[1]), strict=True):
                assert is_same(x, y)
                yield name, before_last(x), rounding.MOVING * allowed


def proofs(call, *args):
    """The numbers that are compared with a bound that covers what rounding takes, and the bound."""
    _, compared = comparisons(call, *args)
    return [(bound, found) for bound, found in compared if np.any(bound.shift) and found.unit]


def step_11(real):
    """Sides and the volume in the cull."""
    p = Pair("float64")
    cull, separation = p.load("search.cull"), number("S", positive=True)
    c0, c1 = p.corners64
    size = p.simd.greatest(*map(p.points.largest, (c0, c1)))
    d, e = values(p.d), p.end.value
    sign = np.where(dot(d, values(c0.w00)) < 0, -1, 1)
    exact = []
    for name in CORNERS:
        a, b = (sign * dot(d, values(getattr(c, name))) for c in (c0, c1))
        exact += [a, (1 - e) * a + e * b]
    for is_ball in (0, 1):
        found = proofs(cull.is_free_along, p.d, False, c0, c1, size, separation, is_ball, p.end)
        assert len(found) == 8
        for (bound, x), y in zip(found, exact, strict=True):
            length = np.sqrt(dot(d, d)) if is_ball else np.abs(d).sum(axis=0)
            assert is_same(x, y) and is_same(bound, separation.value * length)
            yield "sides", share(bound.lost + x.lost, bound.shift), rounding.SIDES
    found = proofs(cull.is_free_by_volume, c0, c1, separation, 0, p.end)
    assert len(found) == 4
    sign = np.where(volume_at(p, 0) < 0, -1, 1)
    for y in (0, 0.25, 2 / 3, 1):
        b, decided = [x.value for _, x in found], np.abs(volume_at(p, 0)) > 1e-14
        assert is_same(cubic(b, y), sign * volume_at(p, y * e), decided)
    for bound, x in found:
        yield "volume", share(bound.lost + x.lost, bound.shift), rounding.VOLUME + 1


def step_12(real):
    """End of a shorter step."""
    p = Pair("float64")
    a, b, t = vector("a.0"), vector("a.1"), p.t.value
    box = p.load("boxes.boxes").end_box(a, b, p.t)
    for k, (name, side, of) in product(range(3), (("lower", box.lower, at_most), ("upper", box.upper, at_least))):
        assert is_same(side[k], (1 - t) * a[k].value + t * b[k].value)
        moves = np.abs(a[k].value - b[k].value) > 0  # else it is at either end
        yield name, of(side[k], moves), rounding.INTERPOLATION


def step_13(real):
    """Euclidean distances."""
    p = Pair(real, "euclidean")
    support, left = p.load("pair.support"), rounding.SLACK / (rounding.SLACK - 13)
    d = values(p.d)
    length, along = support.length(p.d), support.support(p.separation, p.d)
    assert is_same(length, np.sqrt(dot(d, d))) and is_same(along, p.separation.x.value * length.value)
    yield "separation", at_least(p.separation.x) * left, rounding.SLACK - 13
    yield "length", share(length.lost, length.value) / p.own / 4, 4
    yield "support", at_least(along) * 2, rounding.SLACK - 8
    p = Pair("float64", "euclidean")
    (c0, c1), separation = p.corners64, number("S", positive=True)
    cull = p.load("search.cull")
    q, r = ([values(getattr(c, n)) for c in (c0, c1)] for n in "qr")
    normals = [np.cross(q[i], r[i], axis=0) for i in (0, 1)]
    normals.append((np.cross(q[0], r[1], axis=0) + np.cross(q[1], r[0], axis=0)) / 2)
    longest = np.max([np.linalg.norm(n, axis=0) for n in normals], axis=0)
    for bound, x in proofs(cull.is_free_by_volume, c0, c1, separation, 1, numeral(1)):
        assert is_same(bound, separation.value * longest)
        yield "cull", share(bound.lost + x.lost, bound.shift), rounding.NORMAL


def step_14(real):
    """Thickness: sums of numbers of eleven bits."""
    thickness = House(dtype=np.float16).load("boxes.thickness")
    thickness.next_below = lambda x: np.nextafter(x, np.float16(-np.inf))
    short = [np.float16(m * 2.0**e) for m in (0, 1, 1.5, 1 + 2.0**-10, 2 - 2.0**-10) for e in range(-14, 4)]
    for a, b in product(np.arange(1, 2, 2.0**-10, dtype=np.float16), short):
        for s in (thickness.add_rounded_up(a, b), thickness.add_rounded_up(b, a)):
            assert float(np.nextafter(s, np.float16(-np.inf))) < float(a) + float(b) <= float(s)
    yield from ()


def step_15(real):
    """Distance at one time."""
    p = Pair("float64")
    distance, box = p.load("at_one_time.pair_distance"), p.load("at_one_time.box_distance")
    points = SimpleNamespace(**{f"p{k}": vector(f"p{k}.") for k in range(4)})
    c = p.points.corners(1, points)
    size = p.points.largest(c)
    s = p.house.power(p.simd.greatest_of(size))
    w = [s * getattr(c, name) for name in CORNERS]
    # a direction is what it is, whatever was lost on the way to it
    to_unit_size, directions = distance.to_unit_size, []
    distance.to_unit_size = lambda d: directions.append(given(to_unit_size(d))) or directions[-1]
    r, compared = comparisons(distance.measured, 1, points, True)
    (along,) = (y for x, y in compared if x.is_zero() and np.any(y.shift))
    lowest, length = (
        [f(values(n)) for n in (directions[0], directions[-1])]
        for f in (lambda n: np.min([dot(n, values(x)) for x in w], axis=0), lambda n: np.sqrt(dot(n, n)))
    )
    is_second = np.abs(along.value - lowest[0]) > 1e-12
    found = [(along, r.least, np.where(is_second, *lowest[::-1]), np.where(is_second, *length[::-1]) * s.value)]
    # and of a direction in the norm of a box
    n, norm = vector("n"), number("norm", 2, positive=True)
    given_w = [vector(f"{c}.0", 1) for c in CORNERS]
    projected = recorded(box, "lowest", box.lowest)
    m = p.points.largest(SimpleNamespace(**dict(zip(CORNERS, given_w, strict=True))))
    x = box.bound_along(n, *given_w, m, norm)
    along = box.lowest(*projected[0])[1] - (box._PROJECTION * dot(n.each(abs), m) + box._TINY)
    found.append((along, x, np.min([dot(values(n), values(y)) for y in given_w], axis=0), norm.value))
    for along, x, exact, divisor in found:
        assert is_same(along, exact)
        yield "projection", before_last(along), rounding.PROJECTION_ROOT
        is_far = along.value > 1e-9
        assert is_same(x.value * divisor, exact, is_far)
        before = (along.lost - along.last) / divisor
        yield "quotient", share(x.lost - before, along.shift / divisor - x.shift, is_far), rounding.RELATIVE


def step_16(real):
    """Bounds of displacements."""
    minima, a, b = SimpleNamespace(vertex_body=[0, 1]), number("least", positive=True), number("kept", positive=True)
    a.value = a.value + 1  # the distance is above what is kept
    subnormal = [Fraction(k) * Fraction(2) ** -1074 for k in (0, 1, 3, 15, 16, 17, 31, 32, 33, 35, 63, 65, 2**20 + 1)]
    assert all(Fraction(largest_bound(float(2 * x), False)) <= x for x in subnormal)
    for is_static, of_float in product(((0, 0), (0, 1)), (False, True)):
        house = House(dtype=np.float64) if of_float else House()
        proximity = house.load("at_one_time.proximity")
        calls = recorded(proximity, "lower_bounds", lambda *_: None)
        for x in subnormal if of_float else ():
            proximity.bound_pair([0], [1], np.float64(float(x)), np.float64(0), is_static, minima)
            assert calls and Fraction(float(calls[-1][1])) <= x / (2 - sum(is_static))
        if not of_float:
            proximity.bound_pair([0], [1], a, b, is_static, minima)
            for _, bits, _ in calls:
                assert is_same(bits, (a.value - b.value) / (2 - sum(is_static)))
                yield "alone" if sum(is_static) else "shared", at_most(bits), rounding.RELATIVE


STEPS = {name[5:]: step for name, step in globals().items() if name.startswith("step_")}
ROWS = re.findall(r"^\| (\d+) \| counted[^|]*\| (.*) \|$", rounding.__doc__, re.MULTILINE)


@pytest.mark.parametrize("name", STEPS)
def test_constants_cover_what_the_source_of_a_step_loses(name):
    assert {step for step, _ in ROWS} == STEPS.keys() - {"14"}
    rows: dict = {}
    for row, taken, allowed in (found for real in REALS for found in STEPS[name](real)):
        # what a step says is a whole number; a constant has to cover the products of roundings as well
        assert taken <= (SECOND_ORDER if isinstance(allowed, int) else 1 / SECOND_ORDER), row
        rows[row] = max(float(taken * allowed), rows.get(row, (0, 0))[0]), allowed
    found = "; ".join(f"{row} {round(lost, 2):g} of {allowed:g}" for row, (lost, allowed) in rows.items())
    assert found == "; ".join(text for step, text in ROWS if step == name)
