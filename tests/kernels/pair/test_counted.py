"""The steps of `kernels/pair/rounding.py`, counted on the kernels' own files: how much of what is allowed each loses.

Every function is executed on numbers that count their roundings (`counted`), and its formula is compared with the
definition on the way. The table at the end of the docstring of `rounding` has to say what comes out.
"""

import re
from fractions import Fraction
from functools import partial
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from ccd_warp.kernels.pair import rounding
from ccd_warp.kernels.pair_kind import POINT_POINT, POINT_SEGMENT
from counted import (
    House,
    Number,
    Vector,
    cross,
    dot,
    first_order,
    given,
    joined,
    number,
    numeral,
    parameter,
    paths,
    plain,
    scaled,
    share,
    times,
    value,
    vector,
)

from ccd_warp._at_one_time.proximities import largest_bound

REALS = ("float64", "float32")
SECOND_ORDER = 1.001  # what products of roundings add
CORNERS = ("w00", "w01", "w10", "w11")
ONES = Vector(*[numeral(1)] * 3)
# the corners and sides of a pair, from the definition of its kind
OF_KIND = {0: "01 02 03 03 12 13", 1: "02 03 12 13 23 10"}
OF_KIND |= {POINT_SEGMENT: "01 02 01 02 12", POINT_POINT: "01 01 01 01"}


def over(x):
    """By how much a number is below its plain terms, to the first order: what rounding may take."""
    return scaled(first_order(x.exact), -1)


def at_least(x):
    """The share that is taken of what a number is raised by."""
    return share(x.total(), first_order(x.exact))


def at_most(x):
    """The share that is taken of what it is lowered by."""
    return share(x.total(), over(x))


class Pair:
    """The files for a precision and a norm, and a pair in normalised units."""

    def __init__(self, real, norm="maximum", **more):
        self.house = House(real, **more)
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
        narrowed = self.in_precision.narrowed
        lane = self.lane_pair.with_bounds(self.lane_pair.LanePair(), *map(narrowed, (size, separation, ONES)))
        self.size, self.error, self.separation = narrowed(size), lane.error, lane.separation
        self.sub_error = self.solver.patch_bound * self.size
        self.d = vector("d", unit=self.own)
        self.t, self.x, self.end = (parameter(name) for name in ("t", "x", "end"))
        u = [[parameter(f"{name}{k}", is_dyadic=True) for k in range(2)] for name in "uv"]
        self.sub_t0, self.sub_t1 = (self.sub_patch.sub_corners(c, *u[0], *u[1]) for c in (self.t0, self.t1))
        if norm != "maximum":
            self.separation = Vector(*[self.separation.x] * 3)
            self.volume.support = of_given(self.volume.support)

    def symbols(self, *names, **more):
        return [number(name, unit=self.own, **more) for name in names]


def of_given(support):
    """The support along a vector that has been computed: a length changes by no more than the vector does."""

    def supported(separation, d):
        r = support(separation, d.each(given))
        lost = joined(joined(d.x.total(), d.y.total()), d.z.total())
        r.lost = joined(r.lost, times(separation.x.size, lost))
        for atom in (x for m in r.exact for x in m if x.name.startswith("root")):
            atom.size = joined(joined(d.x.size, d.y.size), d.z.size)
        return r

    return supported


def recorded(module, name, result):
    """The arguments of all calls of a function in a module, which is replaced."""
    calls = []
    setattr(module, name, lambda *args: (calls.append(args), result(*args))[1])
    return calls


def executed(function, *args):
    """The one result of a function where all comparisons hold."""
    ((_, x),) = paths(lambda: function(*args), lambda *_: True)
    return x


class Sample(dict):
    """A value for each atom of the input."""

    def __missing__(self, name):
        rng = np.random.default_rng([*name.encode()])
        sign = 1 if name in ("t", "x", "end", "c0") else int(rng.choice([-1, 1]))
        return self.setdefault(name, sign * Fraction(int(rng.integers(1, 99)), 128))


AT = Sample()


def exact_of(x):
    return value(x.exact, AT) if isinstance(x, Number) else x


def is_same(a, b):
    """Whether two numbers are one in exact arithmetic, but for the absolute terms of step 5 and roots of floats."""
    return abs(exact_of(a) - exact_of(b)) < 2**-40


# ---- The steps: for each row of the table the share that is taken, and what is allowed ----


def step_1(real):
    """Differences."""
    p = Pair(real)
    f64 = p.house.types["float64"]
    points = [vector(f"p{k}.", unit=p.unit) for k in range(4)]
    of = SimpleNamespace(**{f"p{k}": x for k, x in enumerate(points)})
    for kind, pairs in OF_KIND.items():
        corners = p.load("pair.points", real=f64).corners(kind, of)
        for (name, (i, j)), k in product(zip((*CORNERS, "q", "r"), pairs.split(), strict=False), range(3)):
            x = getattr(corners, name)[k]
            assert is_same(x, points[int(i)][k] - points[int(j)][k]) and not x.lost
            yield "difference", x.common / p.unit, 1


def step_2(real):
    """Normalisation."""
    p = Pair(real)
    corners = p.in_precision.normalised(p.corners64[0], Vector(*(p.house.power(0) for _ in range(3))))
    yield "corner", max(x.common for name in CORNERS for x in getattr(corners, name).of), 1


def step_3(real):
    """Corners of a sub-patch."""
    p = Pair(real)
    for name, (i, j) in zip(CORNERS, product("01", "01"), strict=True):
        u, v = AT[f"u{i}"], AT[f"v{j}"]
        weights = ((1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v)
        x = getattr(p.sub_t0, name).x
        assert is_same(x, sum(w * AT[f"{c}.0x"] for w, c in zip(weights, CORNERS, strict=True)))
        yield "corner", share(x.total(), p.size.x.size) / 5, 5


def step_4(real):
    """Projection."""
    p = Pair(real)
    for name, ends, error in (("ROOT", (p.t0, p.t1), p.error), ("PATCH", (p.sub_t0, p.sub_t1), p.sub_error)):
        off = p.inclusion.offset(p.d, error)
        calls = recorded(p.inclusion, "clip_corner", lambda *_: numeral(2))
        executed(p.inclusion.clip_beyond, p.d, off, p.t, *ends, False)
        for (corner, (a, b, *_)), k in product(zip(CORNERS, calls, strict=True), (0, 1)):
            assert is_same((a, b)[k], dot(p.d, getattr(ends[k], corner)))
            yield (
                name.lower(),
                share((a, b)[k].total(), first_order(off.exact)),
                getattr(rounding, f"PROJECTION_{name}"),
            )


def step_6(real):
    """Offset."""
    p = Pair(real)
    margin = [vector(name, unit=p.own, positive=True) for name in ("E", "M")]
    of_box = {"direction": p.inclusion.offset(p.d, margin[0] + margin[1]), "facet": p.facets.offset(p.d, *margin)}
    for name, off in of_box.items():
        assert is_same(off, dot(p.d.each(abs), margin[0] + margin[1]))
        yield name, at_least(off), rounding.RELATIVE
    off = Pair(real, "euclidean").ball.offset(p.d, margin[0], Vector(*[margin[1].x] * 3))
    of_ball = exact_of(margin[1].x) * Fraction(float(exact_of(dot(p.d, p.d))) ** 0.5)
    assert is_same(off, exact_of(dot(p.d.each(abs), margin[0])) + of_ball)
    yield "ball", at_least(off), rounding.RELATIVE


def step_7(real):
    """Time."""
    p = Pair(real)
    a, b, off, t = p.symbols("a", "b", "off", "t")
    exact = (a - off) / (a - b)
    for conditions, s in paths(lambda: p.inclusion.clip_corner(a, b, off, t)):
        holds = {(str(x.exact), str(y.exact)): outcome for _, x, y, outcome in conditions}
        first, last = (holds[str(off.exact), str(c.exact)] for c in (a, b))
        entered = next(x for _, x, y, _ in conditions if y.exact == t.exact)
        assert is_same(entered, exact)
        yield "entered", at_least(entered), rounding.RELATIVE
        stays = last and (first or holds[str(entered.exact), str(t.exact)])
        if stays or not first:
            assert s.exact == {(): 2 if stays else -1}
        elif not s.is_constant():
            assert is_same(s, exact)
            yield "left", at_most(s), rounding.RELATIVE


def step_8(real):
    """Corners at a time."""
    p = Pair(real)
    for name, ends, most in (("root", (p.t0, p.t1), 4), ("patch", (p.sub_t0, p.sub_t1), 8)):
        for corner, k in product(CORNERS, range(3)):
            a, b = (exact_of(getattr(x, corner)[k]) for x in ends)
            x = getattr(p.patch.corners_at(*ends, p.t), corner)[k]
            assert is_same(x, (1 - AT["t"]) * a + AT["t"] * b)
            yield name, share(x.total(), p.size[k].size) / most, most


SHARES = (Fraction(0), Fraction(1, 4), Fraction(2, 3), Fraction(1))


def cubic(b, y):
    """A cubic from its Bernstein coefficients."""
    return (1 - y) ** 3 * b[0] + 3 * (1 - y) ** 2 * y * b[1] + 3 * (1 - y) * y**2 * b[2] + y**3 * b[3]


def sides_at(s):
    """P, Q and R at a time."""
    return [Vector(*((1 - s) * AT[f"{n}.0{k}"] + s * AT[f"{n}.1{k}"] for k in "xyz")) for n in ("w00", "q", "r")]


def determinant(s):
    p, q, r = sides_at(s)
    return dot(p, cross(q, r))


def support_at(s, y, is_local, norm):
    """The cubic above the support of the separation at a time s, at a share y of [t, x], as it is defined."""

    def along(a, b):
        (_, q0, r0), (_, q1, r1) = sides_at(a), sides_at(b)
        n = [x / 2 for x in (cross(q0, r1) + cross(q1, r0)).of]
        if norm != "maximum":
            return AT["Sx"] * Fraction(float(sum(x * x for x in n)) ** 0.5)
        return sum(AT[f"S{k}"] * abs(x) for k, x in zip("xyz", n, strict=True))

    t, x = (AT["t"], AT["x"]) if is_local else (0, 1)
    a, b, c = along(t, t), along(t, x), along(x, x)
    return cubic((a, (a + 2 * b) / 3, (2 * b + c) / 3, c), y if is_local else s)


def beyond_separation(p, has_separation, is_local, norm):
    """Control points of the volume beyond the separation; their formula is that of the definition."""
    f = p.in_precision.volume_between(*p.corners64, ONES, p.t0, p.t1, p.separation, has_separation)

    def hull():
        h = p.volume.beyond_bound(f, p.t, p.x)
        if not has_separation:
            return h
        local = p.volume.separation_offset(f, p.separation, p.t, p.x) if is_local else None
        return p.volume.lowered(h, local or p.volume.restrict(p.volume.reach_of(f, p.separation), p.t, p.x))

    for conditions, h in paths(hull, lambda *_: is_local if has_separation else None):
        b = [h.c0, h.c1, h.c2, h.c3]
        for y in SHARES:
            s = (1 - y) * AT["t"] + y * AT["x"]
            exact = determinant(s) * (-1 if conditions[0][3] else 1)
            exact -= support_at(s, y, is_local, norm) if has_separation else 0
            assert is_same(cubic([exact_of(c) for c in b], y), exact)
        yield from b


def step_9(real):
    """Volume."""
    name = "volume" if real == "float64" else "restriction"
    yield from clipped(Pair(real), 3)
    of_norms = [("maximum", False, False), *product(("maximum", "euclidean"), [True], [False, True])]
    for norm, has_separation, is_local in of_norms:
        for c in beyond_separation(Pair(real, norm), has_separation, is_local, norm):
            yield name + " of a separation" * has_separation, share(c.lost, over(c)), getattr(rounding, name.upper())


def clipped(p, degree):
    """The end of a clip whose control points are rounded once, and of which any decides, on either side of 0."""
    c0, m = *p.symbols("c0", positive=True, roundings=1), *p.symbols("m", positive=True)
    clip = p.moving_clip.clip_along(None, lambda *_: p.d, p.facets.offset)
    p.moving_clip.least = lambda a, b: a
    found = 0
    for j, is_positive in product(range(1, degree + 1), (False, True)):
        # where it decides it is at most so much of c0
        left = (1 - Fraction(j, degree)) * is_positive
        exact = joined(scaled(c0.exact, left), scaled(m.exact, -1))
        c = [c0, *[Number(exact, scaled(c0.exact, left) if is_positive else None, None, 1, p.own)] * degree]
        theta = c0 / (numeral(Fraction(degree, j)) * (c0 - c[j]))

        def known(_, a, b, c=c):
            if {"t", "x"} & {x.name for y in (a, b) for k in y.exact for x in k}:
                return True
            if a.is_constant():
                return not (b.exact == c[1].exact or plain(a.exact) == {(): 1})
            return None if "c0" in str(a.exact) else True

        def end(c=c):
            if degree == 2:
                p.moving_clip.corner_crossing = lambda *_: p.moving_clip.crossing(*c)
                return clip(p.t0, p.t1, p.separation, p.error, None, p.t, p.x, 1)
            h = p.volume.Hull()
            h.c0, h.c1, h.c2, h.c3 = c
            return p.volume.clip_hull(h, p.t, p.x, p.x)[0]

        for _, s in paths(end, known):
            if is_same(s, p.t + (p.x - p.t) * theta):
                found += 1
                yield "crossing", at_most(s), rounding.CROSSING + rounding.RELATIVE
    assert found >= 2 * degree


def step_10(real):
    """Moving facets."""
    yield from clipped(Pair(real), 2)
    p = Pair(real)
    d = [vector(f"d{name}.", unit=p.own) for name in "tx"]
    for name, ends, error in (("ROOT", (p.t0, p.t1), p.error), ("PATCH", (p.sub_t0, p.sub_t1), p.sub_error)):
        clip = p.moving_clip.clip_along(None, lambda which, _: next(which), p.facets.offset)
        calls = recorded(p.moving_clip, "crossing", lambda *_: numeral(2))
        executed(clip, *ends, p.separation, error, iter(d * 2), p.t, p.x, 1)
        off = [exact_of(dot(y.each(abs), p.separation)) for y in d]
        for corner, h in zip(CORNERS, calls, strict=True):
            w = [getattr(p.patch.corners_at(*ends, s), corner) for s in (p.t, p.x)]
            (a, b), (c, e) = ([exact_of(dot(y, x)) for x in w] for y in d)
            for x, y in zip(h, (-a - off[0], -(b + c + sum(off)) / 2, -e - off[1]), strict=True):
                assert is_same(x, y)
                allowed = rounding.MOVING * getattr(rounding, f"PROJECTION_{name}")
                yield name.lower(), share(x.lost, over(x)), allowed


def proofs(call):
    """Of comparisons with a bound what both sides lose, what it has for that, and whether the sample comes there."""
    for conditions, is_free in paths(call, lambda _, a, b: None if b.is_constant() and not b.exact else True):
        signs = [(exact_of(a) < 0) == outcome for _, a, b, outcome in conditions if not b.exact]
        for relation, bound, found, _ in conditions if is_free else ():
            if relation == "<" and first_order(bound.exact) and not found.is_constant():
                yield joined(bound.total(), found.total()), first_order(bound.exact), found, all(signs)


def step_11(real):
    """Sides and the volume in the cull."""
    p = Pair("float64")
    cull, separation = p.load("search.cull"), number("S", positive=True)
    c0, c1 = p.corners64
    size = p.simd.greatest(*map(p.points.largest, (c0, c1)))
    w = [[exact_of(dot(p.d, getattr(c, name))) for c in (c0, c1)] for name in CORNERS]
    for is_ball in (0, 1):
        free = partial(cull.is_free_along, p.d, False, c0, c1, size, separation, is_ball, p.end)
        for lost, bound, found, is_real in proofs(free):
            sign = 1 if w[0][0] > 0 else -1
            exact = [sign * ((1 - e) * a + e * b) for a, b in w for e in (0, AT["end"])]
            assert not is_real or any(is_same(found, x) for x in exact)
            yield "sides", share(lost, bound), rounding.SIDES
    b = []
    for lost, bound, found, is_real in proofs(partial(cull.is_free_by_volume, c0, c1, separation, 0, p.end)):
        b += [exact_of(found)] * is_real
        yield "volume", share(lost, bound), rounding.VOLUME + 1
    sign = 1 if determinant(0) > 0 else -1
    assert all(is_same(cubic(b, y), sign * determinant(y * AT["end"])) for y in SHARES)


def step_12(real):
    """End of a shorter step."""
    p = Pair("float64")
    a, b = vector("a"), vector("b")
    box = p.load("boxes.boxes").end_box(a, b, p.t)
    for k in range(3):
        exact = (1 - AT["t"]) * exact_of(a[k]) + AT["t"] * exact_of(b[k])
        for name, side, of in (("lower", box.lower, at_most), ("upper", box.upper, at_least)):
            x = next(iter(side[k].exact))[0].of[0]
            assert is_same(x, exact)
            yield name, of(x), rounding.INTERPOLATION


def step_13(real):
    """Euclidean distances."""
    p = Pair(real, "euclidean")
    support, left = p.load("pair.support"), rounding.SLACK / (rounding.SLACK - 13)
    yield "separation", at_least(p.separation.x) * left, rounding.SLACK - 13
    yield "length", support.length(p.d).common / p.own / 4, 4
    yield "support", at_least(support.support(p.separation, p.d)) * 2, rounding.SLACK - 8
    p = Pair("float64", "euclidean", cuts={("search.cull", "is_free_by_volume"): ("n0", "n1", "nm")})
    cull, separation = p.load("search.cull"), number("S", positive=True)
    for lost, bound, *_ in proofs(partial(cull.is_free_by_volume, *p.corners64, separation, 1, numeral(1))):
        yield "cull", share({m: c for m, c in lost.items() if "root" in str(m)}, bound), 32
    q, r = (p.simd.greatest(*(c.each(abs) for c in (getattr(x, n) for x in p.corners64))) for n in "qr")
    for name, x in p.house.cut.items():
        of_twice = 2 if name == "nm" else 1
        yield "normal", share(x.x.total(), (q.y * r.z + q.z * r.y).size) / of_twice / rounding.NORMAL, rounding.NORMAL


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

    def rows(cuts, bound, known):
        p = Pair("float64", cuts={cuts: ("n", "along") if "measured" in cuts else ("along",)})
        ((_, x),) = paths(partial(bound, p), known)
        along = p.house.cut["along"]
        yield "projection", share(along.lost, over(along)), rounding.PROJECTION_ROOT
        yield "quotient", float(along.common) / rounding.RELATIVE + at_most(x), rounding.RELATIVE

    def least(p):
        distance = p.load("at_one_time.pair_distance")
        closest = partial(SimpleNamespace, u=numeral(0), v=numeral(0), features=numeral(0))
        distance.closest_of_edges = lambda w00, *_: closest(d=w00)
        distance.largest = lambda _: size
        return distance.measured(1, points, True).least

    def bound_along(p):
        n, norm = vector("n"), number("norm", 2, positive=True)
        return p.load("at_one_time.box_distance").bound_along(n, *w, m, norm)

    of = Pair("float64").points
    points = SimpleNamespace(**{f"p{k}": vector(f"p{k}.") for k in range(4)})
    size, w = of.largest(of.corners(1, points)), [vector(f"{c}.0", 1) for c in CORNERS]
    m = of.largest(SimpleNamespace(**dict(zip(CORNERS, w, strict=True))))
    is_said = lambda _, a, b: a.is_constant() or (b.is_constant() and bool(b.exact))  # noqa: E731
    yield from rows(("at_one_time.pair_distance", "measured"), least, is_said)
    yield from rows(("at_one_time.box_distance", "bound_along"), bound_along, lambda *_: False)


def step_16(real):
    """Bounds of displacements."""
    proximity, minima = Pair("float64").load("at_one_time.proximity"), SimpleNamespace(vertex_body=[0, 1])
    assert Fraction(largest_bound(3 * 2.0**-1074, False)) <= Fraction(3, 2) * Fraction(2) ** -1074
    for is_static in ((0, 0), (0, 1)):
        calls = recorded(proximity, "lower_bounds", lambda *_: None)
        executed(proximity.bound_pair, [0], [1], number("least"), number("kept"), is_static, minima)
        for _, bits, _ in calls:
            assert is_same(bits, (AT["least"] - AT["kept"]) / (2 - sum(is_static))) and bits.exact[()] <= -(2.0**-1070)
            yield "alone" if sum(is_static) else "shared", at_most(bits), rounding.RELATIVE


def at_largest_turn(a, **more):
    """A polynomial in magnitudes for a turn of 1/3, at the end of a slice."""
    at = {"t": Fraction(1), "h": Fraction(1), "z": Fraction(1, 9), **more}
    return float(value({tuple(x for x in m if x.name != "t"): abs(c) for m, c in a.items()}, at))


def step_17(real):
    """Points on arcs."""
    p = Pair("float64")
    arcs, windows, simd = (p.load(f"pair.{name}") for name in ("arcs", "windows", "simd"))
    positive = partial(number, positive=True)
    t, a, b, v, spin = positive("t"), *map(vector, ("a", "b", "v", "s"))
    z = positive("z", simd.dot(spin, spin).relative())
    simd.dot = lambda *_: z
    bent = arcs.bend(spin, t)
    f1, f2 = 9 * at_largest_turn(bent.f1.total()), at_largest_turn(bent.f2.total())
    yield "f1", f1 / 3, 3
    yield "f2", f2 / 2.2, 2.2
    simd.cross = lambda *_: Vector(*[positive("C", 2)] * 3)  # of ω and V, less than both lengths
    of_f1, of_f2 = positive("f1"), positive("f2")
    of_f1.lost, of_f2.lost = {(): Fraction(f1) / 9}, {(): Fraction(f2)}
    x = arcs.point_at(a, b, v, spin, SimpleNamespace(f1=of_f1, f2=of_f2), t).x
    sizes = {"f1": Fraction(1, 9 * 15), "f2": Fraction(1, 8), "C": Fraction(1, 3), "vx": Fraction(1)}
    turning = {m: c for m, c in x.total().items() if {y.name for y in m} & {"vx", "C"}}
    of_turns = 3 * at_largest_turn(turning, **sizes)
    points = [SimpleNamespace(**{f"p{k}": vector(f"{e}{k}.") for k in range(4)}) for e in "ab"]
    error = first_order(arcs.error_of(*points, number("slack"), Vector(*[positive("A")] * 3)).exact)
    of_points, of_motion = sorted(set(map(float, error.values())))
    assert (of_points, of_motion) == (rounding.ARC_POINTS, rounding.ARC_MOTION)
    yield "points", 2 * x.common / of_points, of_points
    yield "motion", 2 * max(c for m, c in x.lost.items() if m not in turning) / of_motion, of_motion
    yield "turns", 1.5 * of_turns / of_motion, of_motion
    x = p.load("pair.corotating").turned(vector("x", 1), spin, t).x
    length = 3**0.5 * at_largest_turn(x.total(), xx=Fraction(1), C=Fraction(1, 3))
    yield "frame", length / rounding.FRAME, rounding.FRAME
    for norm, kind in product(("arc_box", "arc_ball"), (0, 1)):
        arcs = Pair("float64", norm).load("pair.arcs")
        arcs.turns_anywhere = lambda _: True
        turns = SimpleNamespace(**{f"v{k}": vector(f"v{k}.") for k in range(4)}, spin_a=spin, spin_b=v)
        for y in arcs.sagitta(arcs.amplitude(kind, turns), positive("h")).of:
            yield "sagitta", at_least(y), rounding.SAGITTA
    begin, length = positive("begin"), positive("length", 1)
    yield "slice", at_most(executed(windows.in_slice, t, begin, length)), 8
    yield "step", at_most(windows.in_step(t, begin, length)), 4
    reached = partial(windows.reached, SimpleNamespace(begin=begin, h=positive("h")), length, False, t)
    ((_, end),) = paths(reached, lambda _, a, b: "length" in str(b.exact))
    yield "window", at_most(end), 12


def step_19(real):
    """Off a chord by a parabola."""
    p = Pair(real, cuts={("pair.arc_rounds", "clip_corner"): ("fall",)})
    rounds, relative = p.load("pair.arc_rounds", norm="arc_box"), rounding.RELATIVE
    (x, root), (bow,) = p.symbols("x", "root", roundings=1, positive=True), p.symbols("bow", positive=True)
    (y,), (t,) = p.symbols("y", roundings=1), p.symbols("t")
    calls = recorded(rounds, "square_root", lambda _: root)
    for conditions, s in paths(lambda: rounds.clip_corner(x, y, numeral(0), bow, True, t)):
        fall = p.house.cut["fall"]
        if not conditions[0][3]:  # the other way by symmetry
            assert is_same(fall, y - x + bow)
            continue
        assert is_same(fall, x - y + bow)
        yield "fall", at_least(fall), relative
        rest, below = next((a, b) for _, a, b, _ in conditions if "fall" in str(a.exact) and "fall" in str(b.exact))
        square = exact_of(fall) ** 2 - 4 * AT["x"] * AT["bow"]
        assert is_same(rest, square) and not plain(below.exact)
        yield (
            "no root",
            share(joined(rest.total(), below.total()), joined(first_order(rest.exact), over(below))),
            relative,
        )
        if len(calls[-1][0].exact) > 2:
            assert is_same(calls[-1][0], square)
            yield "root", at_least(calls[-1][0]), relative
        if not s.is_constant():
            assert any(is_same(s, 2 * AT["x"] / (exact_of(fall) + r)) for r in (AT["root"], exact_of(fall)))
            yield "quotient", at_most(s), relative
    f = SimpleNamespace(**{f"normal_{n}": vector(f"n{n}.", unit=p.own) for n in ("t0", "mid", "t1")})
    reach = rounds.bow_reach(f, p.separation, vector("bow", unit=p.own, positive=True))
    for b in (reach.b1, reach.b2):
        of_bow = {m: c for m, c in b.total().items() if not any(x.name[0] == "S" for x in m)}
        yield "volume", share(of_bow, first_order(b.exact)), relative


STEPS = {name[5:]: step for name, step in globals().items() if name.startswith("step_")}
ROWS = re.findall(r"^\| (\d+) \| counted[^|]*\| (.*) \|$", rounding.__doc__, re.MULTILINE)


@pytest.mark.parametrize("name", STEPS)
def test_constants_cover_what_the_source_of_a_step_loses(name):
    rows: dict = {}
    for row, taken, allowed in (found for real in REALS for found in STEPS[name](real)):
        # what a step says is a whole number; a constant has to cover the products of roundings as well
        assert taken <= (SECOND_ORDER if isinstance(allowed, int) else 1 / SECOND_ORDER), row
        rows[row] = max(float(taken * allowed), rows.get(row, (0, 0))[0]), allowed
    found = "; ".join(f"{row} {round(lost, 2):g} of {allowed:g}" for row, (lost, allowed) in rows.items())
    assert found == "; ".join(text for step, text in ROWS if step == name)
