"""The steps of `kernels/pair/rounding.py`, counted on the kernels' own files: what each loses, of what its constant allows.

Every function is executed on numbers that count their roundings (`counted`); its formula is compared with the definition
on the way. The table at the end of the docstring of `rounding` has to say what comes out.
"""

import re
from fractions import Fraction
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from ccd_warp.kernels.pair import rounding
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

REALS = ("float64", "float32")
SECOND_ORDER = 1.001  # what products of roundings add
CORNERS = ("w00", "w01", "w10", "w11")
ONES = Vector(*[numeral(1)] * 3)
# the corners and sides of a pair, from the definition of its kind
OF_KIND = {0: "01 02 03 03 12 13", 1: "02 03 12 13 23 10"}


def over(x):
    """A computed number is less than its exact terms by this much, to the first order: what rounding may take."""
    return scaled(first_order(x.exact), -1)


def at_least(x):
    """What is taken of the factors by which a number is raised."""
    return share(x.total(), first_order(x.exact))


def at_most(x):
    """What is taken of those by which it is lowered."""
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


def sample(seed=1):
    """A value for each atom of the input."""
    rng = np.random.default_rng(seed)

    class Values(dict):
        def __missing__(self, name):
            self[name] = Fraction(int(rng.integers(1, 99)), 128) * (
                1 if name in ("t", "x", "c0") else int(rng.choice([-1, 1]))
            )
            return self[name]

    return Values()


def is_same(a, b, at=None):
    """Whether two numbers are one in exact arithmetic, but for the absolute terms of step 5."""
    at = sample() if at is None else at
    x, y = (value(plain(c.exact), at) if isinstance(c, Number) else c for c in (a, b))
    return abs(x - y) < 2**-60


# ---- The steps: what is lost, and what is allowed ----


def step_1(real):
    """Differences."""
    p = Pair(real)
    f64 = p.house.types["float64"]
    points = [vector(f"p{k}.", unit=p.unit) for k in range(4)]
    most = 0
    for kind, pairs in OF_KIND.items():
        of = SimpleNamespace(**{f"p{k}": points[k] for k in range(4)})
        corners = p.load("pair.points", real=f64).corners(kind, of)
        for name, (i, j) in zip((*CORNERS, "q", "r"), pairs.split(), strict=True):
            for k in range(3):
                x = getattr(corners, name)[k]
                assert plain(x.exact) == plain((points[int(i)][k] - points[int(j)][k]).exact) and not x.lost
                most = max(most, x.common / p.unit)
    return {"difference": (most, 1)}


def step_2(real):
    """Normalisation."""
    p = Pair(real)
    corners = p.in_precision.normalised(p.corners64[0], Vector(*[p.house._power(0) for _ in range(3)]))
    return {"corner": (max(x.common for name in CORNERS for x in getattr(corners, name).of), 1)}


def step_3(real):
    """Corners of a sub-patch."""
    p, at = Pair(real), sample()
    for name, (i, j) in zip(CORNERS, product("01", "01"), strict=True):
        u, v = at[f"u{i}"], at[f"v{j}"]
        weights = [(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v]
        exact = sum(w * at[f"{c}.0x"] for w, c in zip(weights, CORNERS, strict=True))
        assert is_same(getattr(p.sub_t0, name).x, exact, at)
    most = max(share(x.total(), p.size.x.size) for x in (p.sub_t0.w00.x, p.sub_t0.w11.x, p.sub_t1.w10.x))
    return {"corner": (most, 5)}


def step_4(real):
    """Projection."""
    p, rows = Pair(real), {}
    for name, ends, error in (("ROOT", (p.t0, p.t1), p.error), ("PATCH", (p.sub_t0, p.sub_t1), p.sub_error)):
        off = p.inclusion.offset(p.d, error)
        calls = recorded(p.inclusion, "clip_corner", lambda *_: numeral(2))
        list(paths(lambda ends=ends, off=off: p.inclusion.clip_beyond(p.d, off, p.t, *ends, False), lambda *_: True))
        assert len(calls) == 4
        for corner, (a, b, *_) in zip(CORNERS, calls, strict=True):
            assert all(is_same(x, dot(p.d, getattr(c, corner))) for x, c in zip((a, b), ends, strict=True))
        most = max(share(x.total(), first_order(off.exact)) for a, b, *_ in calls for x in (a, b))
        allowed = getattr(rounding, f"PROJECTION_{name}")
        rows[name.lower()] = (most * allowed, allowed)
    return rows


def step_6(real):
    """Offset."""
    p, most = Pair(real), 0
    given_margin = [vector(name, unit=p.own, positive=True) for name in ("E", "M")]
    exact = dot(p.d.each(abs), given_margin[0] + given_margin[1])
    p.ball = Pair(real, "euclidean").ball
    for off in (
        p.inclusion.offset(p.d, given_margin[0] + given_margin[1]),
        p.facets.offset(p.d, *given_margin),
    ):
        assert is_same(off, exact)
        most = max(most, at_least(off) * rounding.RELATIVE)
    off = p.ball.offset(p.d, given_margin[0], Vector(*[given_margin[1].x] * 3))
    most = max(most, at_least(off) * rounding.RELATIVE)
    return {"offset": (most, rounding.RELATIVE)}


def step_7(real):
    """Time."""
    p = Pair(real)
    a, b, off, t = p.symbols("a", "b", "off", "t")
    most = 0
    for conditions, s in paths(lambda: p.inclusion.clip_corner(a, b, off, t)):
        holds = {(str(x.exact), str(y.exact)): outcome for _, x, y, outcome in conditions}
        first, last = (holds[str(off.exact), str(c.exact)] for c in (a, b))
        entered = next(x for _, x, y, _ in conditions if y.exact == t.exact)
        exact = (a - off) / (a - b)
        assert is_same(entered, exact)
        most = max(most, at_least(entered))
        stays = last and (first or holds[str(entered.exact), str(t.exact)])
        if stays or not first:
            assert plain(s.exact) == {(): 2 if stays else -1}
        elif not s.is_constant():
            assert is_same(s, exact)
            most = max(most, at_most(s))
    return {"quotient": (most * rounding.RELATIVE, rounding.RELATIVE)}


def step_8(real):
    """Corners at a time."""
    p, rows = Pair(real), {}
    for name, ends, most in (("root", (p.t0, p.t1), 4), ("patch", (p.sub_t0, p.sub_t1), 8)):
        at, c = sample(), p.patch.corners_at(*ends, p.t)
        for corner in CORNERS:
            a, b = (value(plain(getattr(x, corner).y.exact), at) for x in ends)
            assert is_same(getattr(c, corner).y, (1 - at["t"]) * a + at["t"] * b, at)
        lost = max(share(x.total(), p.size[k].size) for n in CORNERS for k, x in enumerate(getattr(c, n).of))
        rows[name] = (lost, most)
    return rows


def determinant(p, q, r):
    return sum(x * y for x, y in zip(p, cross(Vector(*q), Vector(*r)).of, strict=True))


def beyond_separation(p, has_separation, is_local, norm):
    """Control points of the volume beyond the separation, for both signs; their formula is that of the definition."""
    f = p.in_precision.volume_between(*p.corners64, ONES, p.t0, p.t1, p.separation, has_separation)

    def hull():
        h = p.volume.beyond_bound(f, p.t, p.x)
        if not has_separation:
            return h
        if is_local:
            return p.volume.lowered(h, p.volume.separation_offset(f, p.separation, p.t, p.x))
        return p.volume.lowered(h, p.volume.restrict(p.volume.reach_of(f, p.separation), p.t, p.x))

    at = sample()
    for conditions, h in paths(hull, lambda *_: is_local if has_separation else None):
        sign = -1 if conditions[0][3] else 1

        def side(name, s):
            return [(1 - s) * at[f"{name}.0{k}"] + s * at[f"{name}.1{k}"] for k in "xyz"]

        b = [value(plain(c.exact), at) for c in (h.c0, h.c1, h.c2, h.c3)]
        for share_ in (Fraction(0), Fraction(1, 3), Fraction(1)):
            s = (1 - share_) * at["t"] + share_ * at["x"]
            exact = sign * determinant(*(side(name, s) for name in ("w00", "q", "r")))
            if has_separation:
                exact -= support_at(at, s, share_, is_local, norm)
            weights = ((1 - share_) ** 3, 3 * (1 - share_) ** 2 * share_, 3 * (1 - share_) * share_**2, share_**3)
            assert abs(sum(w * c for w, c in zip(weights, b, strict=True)) - exact) < 2**-30
        yield from (h.c0, h.c1, h.c2, h.c3)


def support_at(at, s, share_, is_local, norm):
    """The cubic above the support of the separation at a time, as it is defined."""
    ends = [[[at[f"{n}.{e}{k}"] for k in "xyz"] for n in ("q", "r")] for e in (0, 1)]

    def polar(a, b):
        (q0, r0), (q1, r1) = (
            [[(1 - y) * u + y * v for u, v in zip(*w, strict=True)] for w in zip(*ends, strict=True)] for y in (a, b)
        )
        n = [cross(Vector(*q), Vector(*r)).of for q, r in ((q0, r1), (q1, r0))]
        return [(u + v) / 2 for u, v in zip(*n, strict=True)]

    def length(n):
        if norm != "maximum":
            return at["Sx"] * Fraction(float(sum(x * x for x in n)) ** 0.5)
        return sum(at[f"S{k}"] * abs(x) for k, x in zip("xyz", n, strict=True))

    t, x = at["t"], at["x"]
    a, b, c = (length(polar(*y)) for y in (((t, t), (t, x), (x, x)) if is_local else ((0, 0), (0, 1), (1, 1))))
    y = share_ if is_local else s
    w = ((1 - y) ** 3, 3 * (1 - y) ** 2 * y, 3 * (1 - y) * y**2, y**3)
    return w[0] * a + w[1] * (a + 2 * b) / 3 + w[2] * (2 * b + c) / 3 + w[3] * c


def step_9(real):
    """Volume."""
    rows, most, allowed = {}, 0, rounding.VOLUME if real == "float64" else rounding.RESTRICTION
    for norm, has_separation, is_local in (
        ("maximum", False, False),
        *product(("maximum", "euclidean"), [True], [False, True]),
    ):
        p = Pair(real, norm)
        most = max(most, *(share(c.lost, over(c)) for c in beyond_separation(p, has_separation, is_local, norm)))
    rows["volume" if real == "float64" else "restriction"] = (most * allowed, allowed)
    rows["crossing"] = clipped(p, 3)
    return rows


def clipped(p, degree):
    """The end of a clip whose control points are rounded once, and of which any decides, on either side of 0."""
    c0, m = *p.symbols("c0", positive=True, roundings=1), *p.symbols("m", positive=True)
    clip = p.moving_clip.clip_along(None, lambda *_: p.d, p.facets.offset)
    p.moving_clip.least = lambda a, b: a
    most, found = 0, 0
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
                most, found = max(most, at_most(s)), found + 1
    assert found >= 2 * degree
    return (rounding.CROSSING + rounding.RELATIVE) * most, rounding.CROSSING + rounding.RELATIVE


def step_10(real):
    """Moving facets."""
    p, rows = Pair(real), {}
    rows["crossing"] = clipped(p, 2)
    d = [vector(f"d{name}.", unit=p.own) for name in "tx"]
    for name, ends, error in (("root", (p.t0, p.t1), p.error), ("patch", (p.sub_t0, p.sub_t1), p.sub_error)):
        p, most = Pair(real), 0
        directions = iter(d * 2)
        clip = p.moving_clip.clip_along(None, lambda *_, directions=directions: next(directions), p.facets.offset)
        calls = recorded(p.moving_clip, "crossing", lambda *_: number("fraction", unit=p.own))
        list(
            paths(
                lambda: clip(*ends, p.separation, error, None, p.t, p.x, 1), lambda _, a, b: plain(a.exact) != {(): 1}
            )
        )  # noqa: B023
        at = sample()
        for corner, h in zip(CORNERS, calls, strict=True):
            w = [
                [value(plain(c.exact), at) for c in getattr(p.patch.corners_at(*ends, s), corner).of]
                for s in (p.t, p.x)
            ]
            a, b = ([at[f"d{name}.{k}"] for k in "xyz"] for name in "tx")
            off = [sum(abs(x) * at[f"S{k}"] for k, x in zip("xyz", y, strict=True)) for y in (a, b)]
            inner = [[sum(x * y for x, y in zip(u, v, strict=True)) for v in w] for u in (a, b)]
            exact = [-inner[0][0] - off[0], -(inner[0][1] + inner[1][0] + sum(off)) / 2, -inner[1][1] - off[1]]
            assert all(is_same(x, y, at) for x, y in zip(h, exact, strict=True))
            most = max(most, *(share(x.lost, over(x)) for x in h))
        allowed = rounding.MOVING * {"root": rounding.PROJECTION_ROOT, "patch": rounding.PROJECTION_PATCH}[name]
        rows[name] = (most * allowed, allowed)
    return rows


def proofs(call, at):
    """Of comparisons with a bound what both sides lose, what the bound has for it, and whether a sample comes there."""
    for conditions, is_free in paths(call, lambda _, a, b: None if b.is_constant() and not plain(b.exact) else True):
        signs = [(value(plain(a.exact), at) < 0) == outcome for _, a, b, outcome in conditions if not b.exact]
        for relation, bound, found, _ in conditions if is_free else ():
            if relation == "<" and first_order(bound.exact) and not found.is_constant():
                yield joined(bound.total(), found.total()), first_order(bound.exact), found, all(signs)


def step_11(real):
    """Sides in the cull, and the volume there, with the separation in both norms."""
    p, rows = Pair("float64", cuts={("search.cull", "is_free_along"): ()}), {}
    cull, separation = p.load("search.cull"), number("S", unit=1, positive=True)
    c0, c1 = p.corners64
    size = p.simd.greatest(*map(p.points.largest, (c0, c1)))
    most, at = 0, sample()
    for is_euclidean in (0, 1):

        def free(e=is_euclidean):
            return cull.is_free_along(p.d, False, c0, c1, size, separation, e, p.end)

        for lost, bound, found, is_real in proofs(free, at):
            most = max(most, share(lost, bound))
            w = [[[at[f"d{k}"] * at[f"{c}.{end}{k}"] for k in "xyz"] for c in CORNERS] for end in "01"]
            sign = 1 if sum(w[0][0]) > 0 else -1
            exact = [sign * ((1 - e) * sum(x) + e * sum(y)) for x, y in zip(*w, strict=True) for e in (0, at["end"])]
            assert not is_real or any(is_same(found, x, at) for x in exact)
    rows["sides"] = (most * rounding.SIDES, rounding.SIDES)
    most = 0
    for lost, bound, found, is_real in proofs(lambda: cull.is_free_by_volume(c0, c1, separation, 0, p.end), at):
        most = max(most, share(lost, bound))
    rows["volume"] = (most * (rounding.VOLUME + 1), rounding.VOLUME + 1)
    return rows


def step_12(real):
    """End of a shorter step."""
    p = Pair("float64")
    a, b = vector("a", unit=1), vector("b", unit=1)
    box = p.load("boxes.boxes").end_box(a, b, p.t)
    at, most = sample(), 0
    for k in range(3):
        lower, upper = (next(iter(x.exact))[0].of[0] for x in (box.lower[k], box.upper[k]))
        exact = (1 - at["t"]) * at["a" + "xyz"[k]] + at["t"] * at["b" + "xyz"[k]]
        assert is_same(lower, exact, at) and is_same(upper, exact, at)
        most = max(most, at_most(lower), at_least(upper))
    return {"point": (most * rounding.INTERPOLATION, rounding.INTERPOLATION)}


def step_13(real):
    """Euclidean distances."""
    p, rows = Pair(real, "euclidean"), {}
    rows["separation"] = (at_least(p.separation.x) * rounding.SLACK, rounding.SLACK - 13)
    support = p.load("pair.support")
    rows["length"] = (support.length(p.d).common / p.own, 3.1)
    rows["support"] = (at_least(support.support(p.separation, p.d)) * rounding.SLACK, rounding.SLACK - 8)
    p = Pair("float64", "euclidean", cuts={("search.cull", "is_free_by_volume"): ("n0", "n1", "nm")})
    cull, separation = p.load("search.cull"), number("S", unit=1, positive=True)
    q, r = (p.simd.greatest(*(c.each(abs) for c in (getattr(x, n) for x in p.corners64))) for n in "qr")
    permanent = (q.y * r.z + q.z * r.y).size
    most = 0
    for lost, bound, *_ in proofs(lambda: cull.is_free_by_volume(*p.corners64, separation, 1, numeral(1)), sample()):
        of_root = {m: c for m, c in lost.items() if "root" in str(m)}
        rows["cull"] = (32 * share(of_root, bound), 32)
    for name, x in p.house.cut.items():
        most = max(most, share(x.x.total(), permanent) / (2 if name == "nm" else 1))
    rows["normal"] = (most, rounding.NORMAL)
    return rows


def step_14(real):
    """Thickness: sums of numbers of eleven bits."""
    thickness = House(dtype=np.float16).load("boxes.thickness")
    thickness.next_below = lambda x: np.nextafter(x, np.float16(-np.inf))
    short = [np.float16(m * 2.0**e) for m in (0, 1, 1.5, 1 + 2.0**-10, 2 - 2.0**-10) for e in range(-14, 4)]
    for a, b in product(np.arange(1, 2, 2.0**-10, dtype=np.float16), short):
        for s in (thickness.add_rounded_up(a, b), thickness.add_rounded_up(b, a)):
            assert float(np.nextafter(s, np.float16(-np.inf))) < float(a) + float(b) <= float(s)
    return {}


def step_15(real):
    """Distance at one time."""
    p = Pair("float64", cuts={("at_one_time.pair_distance", "measured"): ("n", "along")})
    distance = p.load("at_one_time.pair_distance")
    points = SimpleNamespace(**{f"p{k}": vector(f"p{k}.", unit=1) for k in range(4)})
    corners = p.points.corners(1, points)
    size = p.points.largest(corners)
    distance.largest = lambda _: size
    rows, found = {}, []

    def least():
        return distance.measured(1, points, True).least

    distance.closest_of_edges = lambda w00, *_: SimpleNamespace(d=w00, u=numeral(0), v=numeral(0), features=numeral(0))
    for _, x in paths(least, lambda _, a, b: a.is_constant() or (b.is_constant() and bool(b.exact))):
        found.append(x)
    along = p.house.cut["along"]
    allowed = rounding.PROJECTION_ROOT
    rows["projection"] = (share(along.lost, over(along)) * allowed, allowed)
    rows["quotient"] = (float(along.common) + at_most(found[0]) * rounding.RELATIVE, rounding.RELATIVE)
    w = [vector(f"{c}.0", 1, unit=1) for c in CORNERS]
    m = p.points.largest(SimpleNamespace(**dict(zip(CORNERS, w, strict=True))))
    p = Pair("float64", cuts={("at_one_time.box_distance", "bound_along"): ("along",)})
    n, norm = vector("n", unit=1), number("norm", 2, unit=1, positive=True)
    ((_, x),) = paths(lambda: p.load("at_one_time.box_distance").bound_along(n, *w, m, norm), lambda *_: False)
    along = p.house.cut["along"]
    rows["projection"] = (max(rows["projection"][0], share(along.lost, over(along)) * allowed), allowed)
    rows["quotient"] = (
        max(rows["quotient"][0], float(along.common) + at_most(x) * rounding.RELATIVE),
        rounding.RELATIVE,
    )
    return rows


def step_16(real):
    """Bounds of displacements."""
    p = Pair("float64")
    proximity = p.load("at_one_time.proximity")
    minima = SimpleNamespace(vertex_body=[0, 1])
    least, kept = number("least", unit=1), number("kept", unit=1)
    most, at = 0, sample()
    for is_static in ((0, 0), (0, 1)):
        calls = recorded(proximity, "lower_bounds", lambda *_: None)
        list(paths(lambda s=is_static: proximity.bound_pair([0], [1], least, kept, s, minima), lambda *_: True))
        assert len(calls) == 2 - sum(is_static)
        for _, bits, _ in calls:
            assert is_same(bits, (at["least"] - at["kept"]) / len(calls), at) and bits.exact[()] <= -(2.0**-1070)
            most = max(most, at_most(bits))
    return {"difference": (most * rounding.RELATIVE, rounding.RELATIVE)}


def at_largest_turn(a, **more):
    """A polynomial in magnitudes for a turn of 1/3, at the end of a slice."""
    at = {"t": Fraction(1), "h": Fraction(1), "z": Fraction(1, 9), **more}
    return float(value({tuple(x for x in m if x.name != "t"): abs(c) for m, c in a.items()}, at))


def step_17(real):
    """Points on arcs."""
    p, rows = Pair("float64"), {}
    arcs, windows = p.load("pair.arcs"), p.load("pair.windows")
    simd, t = p.load("pair.simd"), number("t", unit=1, positive=True)
    a, b, v, spin = (vector(name, unit=1) for name in ("a", "b", "v", "s"))
    squared = simd.dot(spin, spin).relative()
    z = number("z", squared, unit=1, positive=True)
    product_ = number("C", 2, unit=1, positive=True)  # of ω and V, which is less than both lengths
    simd.dot, plain_cross = (lambda *_: z), simd.cross
    bent = arcs.bend(spin, t)
    rows["f1"] = (9 * at_largest_turn(bent.f1.total()), 3)
    rows["f2"] = (at_largest_turn(bent.f2.total()), 2.2)
    simd.cross = lambda *_: Vector(*[product_] * 3)
    of_f1, of_f2 = (number(name, unit=1, positive=True) for name in ("f1", "f2"))
    of_f1.lost, of_f2.lost = ({(): Fraction(rows[name][0]) / k} for name, k in (("f1", 9), ("f2", 1)))
    x = arcs.point_at(a, b, v, spin, SimpleNamespace(f1=of_f1, f2=of_f2), t).x
    sizes = {"f1": Fraction(1, 9 * 15), "f2": Fraction(1, 8), "C": Fraction(1, 3), "vx": Fraction(1)}
    turning = {m: c for m, c in x.total().items() if {y.name for y in m} & {"vx", "C"}}
    rows["turning"] = (3 * at_largest_turn(turning, **sizes), 3.8)
    motion = max(c for m, c in x.lost.items() if m not in turning)
    points = [SimpleNamespace(**{f"p{k}": vector(f"{e}{k}.", unit=1) for k in range(4)}) for e in "ab"]
    error = arcs.error_of(*points, number("slack", unit=1), Vector(*[number("A", unit=1, positive=True)] * 3))
    assert sorted({float(c) for c in first_order(error.exact).values()}) == [rounding.ARC_POINTS, rounding.ARC_MOTION]
    rows["points"] = (2 * x.common, rounding.ARC_POINTS)
    rows["motion"] = (2 * motion, rounding.ARC_MOTION)
    rows["turns"] = (1.5 * rows["turning"][0], rounding.ARC_MOTION)
    corotating = p.load("pair.corotating")
    x = corotating.turned(vector("x", 1, unit=1), spin, t).x
    rows["frame"] = (3**0.5 * at_largest_turn(x.total(), xx=Fraction(1), C=Fraction(1, 3)), rounding.FRAME)
    rows["sagitta"] = (0, rounding.SAGITTA)
    for norm in ("arc_box", "arc_ball"):
        p = Pair("float64", norm)
        arcs = p.load("pair.arcs")
        arcs.turns_anywhere = lambda _: True
        turns = SimpleNamespace(**{f"v{k}": vector(f"v{k}.", unit=1) for k in range(4)}, spin_a=spin, spin_b=v)
        for kind in OF_KIND:
            sagitta = arcs.sagitta(arcs.amplitude(kind, turns), number("h", unit=1, positive=True))
            rows["sagitta"] = (
                max(rows["sagitta"][0], *(at_least(y) * rounding.SAGITTA for y in sagitta.of)),
                rounding.SAGITTA,
            )
    begin, length = number("begin", unit=1, positive=True), number("length", 1, unit=1, positive=True)
    ((_, since),) = paths(lambda: windows.in_slice(t, begin, length), lambda *_: True)
    rows["slice"] = (8 * at_most(since), 8)
    rows["step"] = (4 * at_most(windows.in_step(t, begin, length)), 4)
    window = SimpleNamespace(begin=begin, h=number("h", unit=1, positive=True))
    ((_, end),) = paths(lambda: windows.reached(window, length, False, t), lambda _, a, b: "length" in str(b.exact))
    rows["window"] = (12 * at_most(end), 12)
    return rows


def step_19(real):
    """Off a chord by a parabola."""
    p, rows = Pair(real, cuts={("pair.arc_rounds", "clip_corner"): ("fall",)}), {}
    rounds = p.load("pair.arc_rounds", norm="arc_box")
    x, y, bow, root, t = (
        number(n, k, unit=p.own, positive=n != "y")
        for n, k in zip(("x", "y", "bow", "root", "t"), (1, 1, 0, 1, 0), strict=True)
    )
    calls = recorded(rounds, "square_root", lambda _: root)
    most = dict.fromkeys(("fall", "root", "quotient"), 0)
    for conditions, s in paths(lambda: rounds.clip_corner(x, y, numeral(0), bow, True, t), lambda _, a, b: None):
        fall = p.house.cut["fall"]
        first, last = (x, y) if conditions[0][3] else (y, x)
        assert is_same(fall, first - last + bow)
        if first is x:  # the other way by symmetry
            most["fall"] = max(most["fall"], at_least(fall))
            rest = next((a, b) for _, a, b, _ in conditions if "fall" in str(a.exact) and "fall" in str(b.exact))
            bound = joined(first_order(rest[0].exact), over(rest[1]))
            at = sample()
            square = value(plain((first - last + bow).exact), at) ** 2
            assert is_same(rest[0], square - 4 * at["x"] * at["bow"], at)
            assert plain(rest[1].exact) == {}
            most["root"] = max(most["root"], share(joined(rest[0].total(), rest[1].total()), bound))
            of_root = calls[-1][0]
            if len(of_root.exact) > 2:
                assert is_same(of_root, rest[0])
                most["root"] = max(most["root"], at_least(of_root))
            if not s.is_constant():
                of_fall = value(plain(fall.exact), at)
                assert any(is_same(s, 2 * at["x"] / (of_fall + r), at) for r in (at["root"], of_fall))
                most["quotient"] = max(most["quotient"], at_most(s))
    rows = {name: (x * rounding.RELATIVE, rounding.RELATIVE) for name, x in most.items()}
    f = SimpleNamespace(**{f"normal_{n}": vector(f"n{n}.", unit=p.own) for n in ("t0", "mid", "t1")})
    reach = rounds.bow_reach(f, p.separation, vector("bow", unit=p.own, positive=True))
    of_bow = [
        share({m: c for m, c in b.total().items() if not any(x.name[0] == "S" for x in m)}, first_order(b.exact))
        for b in (reach.b1, reach.b2)
    ]
    rows["volume"] = (max(of_bow) * rounding.RELATIVE, rounding.RELATIVE)
    return rows


STEPS = {name[5:]: step for name, step in globals().items() if name.startswith("step_")}
ROWS = re.findall(r"^\| (\d+) \| counted[^|]*\| (.*) \|$", rounding.__doc__, re.MULTILINE)
TABLE = {name: "; ".join(text for step, text in ROWS if step == name) for name, _ in ROWS}


@pytest.mark.parametrize("name", STEPS)
def test_constants_cover_what_the_source_of_a_step_loses_as_the_table_of_steps_says(name):
    rows: dict = {}
    for real in REALS:
        for row, (lost, allowed) in STEPS[name](real).items():
            rows[row] = max(float(lost), rows[row][0] if row in rows else 0.0), allowed
    for row, (lost, allowed) in rows.items():
        # what a step says is a whole number, and a constant has to cover the products of roundings as well
        assert lost <= allowed * (SECOND_ORDER if isinstance(allowed, int) else 1 / SECOND_ORDER), row
    found = [f"{row} {round(lost, 2):g} of {allowed:g}" for row, (lost, allowed) in rows.items()]
    assert "; ".join(found) == TABLE.get(name, "")
