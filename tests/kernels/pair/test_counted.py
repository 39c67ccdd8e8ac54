"""The steps of `kernels/pair/rounding.py`, counted on the kernels' own files: how much of what is allowed each loses.

Every function is executed on numbers that count their roundings (`counted`), and what it gives is compared with the
definition on the way. The table at the end of the docstring of `rounding` has to say what comes out.
"""

import re
from fractions import Fraction
from functools import partial
from itertools import combinations_with_replacement, pairwise, permutations, product
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from ccd_warp.kernels.pair import rounding
from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.pair_kind import POINT_POINT, POINT_SEGMENT
from counted import House, Number, comparisons, dot, drawn, drawn_time, numeral, vector

from ccd_warp._at_one_time.proximities import largest_bound

SECOND_ORDER = 1.001  # what products of roundings add
CORNERS = ("w00", "w01", "w10", "w11")
NAMES = (*CORNERS, "q", "r")
ONES = vector(*[numeral(1)] * 3)
# the corners and sides of a pair, from the definition of its kind
OF_KIND = {0: "01 02 03 03 12 13", 1: "02 03 12 13 23 10"}
OF_KIND |= {POINT_SEGMENT: "01 02 01 02 12", POINT_POINT: "01 01 01 01"}
IN_FLOAT64 = (11, 12, 15, 16)  # steps that are taken in no other precision


def is_same(x, exact, where=True):
    """Whether numbers are what the definition says, but for the double precision of both."""
    difference, where = np.broadcast_arrays(np.abs(x - exact), where)
    return (difference[where] < 1e-12).all()


def held(row, allowed, x, most, exact=None, where=True, lost=None):
    """A row of the table, and the largest part of what is allowed that is taken at any of some inputs.

    Args:
        x: A number, which is `exact` by its definition.
        most: What rounding may take of it, or of what is `lost`; all of it where that is nothing.
    """
    assert exact is None or is_same(x.value, exact, where), row
    lost, most, where = np.broadcast_arrays(x.lost if lost is None else lost, most, where)
    assert where.sum() > 100
    with np.errstate(all="ignore"):
        taken = np.where(lost == 0, 0, np.where(most > 0, lost / most, np.inf))[where]
    assert not np.isnan(taken).any()
    return row, taken.max(), allowed


class Pair:
    """The files for a precision and a norm, and a pair in normalised units."""

    def __init__(self, real, norm=Norm.MAXIMUM):
        self.house, self.real, self.norm = House(real), real, (norm := Norm(norm))
        self.unit, self.own = (self.house.units[name] for name in ("float64", real))
        self.load, self.vector = partial(self.house.load, norm=norm), partial(drawn, axes=3, unit=self.own)
        vectors = [{n: drawn(f"{n}.{end}", 3, unit=self.unit, lost=self.unit) for n in NAMES} for end in (0, 1)]
        self.corners64 = [SimpleNamespace(**of) for of in vectors]
        self.t0, self.t1 = (self.in_precision.normalised(c, ONES) for c in self.corners64)
        size = self.points.simd.greatest(*map(self.points.largest, self.corners64))
        separation = abs(drawn("S", 3, unit=self.unit))
        separation = separation if norm == "maximum" else vector(*[separation.x] * 3)
        self.size, separation = map(self.in_precision.narrowed, (size, separation))
        lane = self.lane_pair.with_bounds(SimpleNamespace(), self.size, separation, ONES)
        self.separation, self.d = lane.separation, self.vector("d.")
        self.t, self.x, self.end = (drawn_time(name, self.own) for name in ("t", "x", "end"))
        u, v = ([drawn_time(f"{name}{k}", 0) for k in range(2)] for name in "uv")  # their differences from 1 are exact
        self.uv = [(a.value, b.value) for a, b in product(u, v)]
        subs = [self.sub_patch.sub_corners(c, *u, *v) for c in (self.t0, self.t1)]
        # whole patches, and sub-patches, with the constant of what a projection loses
        self.patches = {
            "root": (rounding.PROJECTION_ROOT, (self.t0, self.t1), lane.error),
            "patch": (rounding.PROJECTION_PATCH, subs, self.solver.patch_bound * self.size),
        }

    def __getattr__(self, name):
        return self.load(f"pair.{name}")

    def corners(self):
        """Of whole patches and sub-patches the name, what is theirs, and the name of each corner."""
        return ((name, *of, corner) for (name, of), corner in product(self.patches.items(), CORNERS))


def at(ends, name, s):
    """Where a corner is, or what a side is, at a time."""
    return (1 - s) * getattr(ends[0], name).value + s * getattr(ends[1], name).value


# ---- The steps: for each row of the table the share that is taken, and what is allowed ----


def step_1_differences(p):
    points = [drawn(f"p{k}.", 3, unit=p.unit) for k in range(4)]
    for kind, pairs in OF_KIND.items():
        corners = p.points.corners(kind, SimpleNamespace(**{f"p{k}": x for k, x in enumerate(points)}))
        for name, (i, j) in zip(NAMES, pairs.split(), strict=False):
            exact = points[int(i)].value - points[int(j)].value
            yield held("difference", 1, getattr(corners, name), p.unit * np.abs(exact), exact)


def step_2_normalisation(p):
    scale = p.house.power(abs(drawn("scale", 3)))
    corners = p.in_precision.normalised(p.corners64[0], scale)
    for name in CORNERS:
        exact = getattr(p.corners64[0], name).value * scale.value
        yield held("corner", 1, getattr(corners, name), np.abs(exact), exact)


def step_3_corners_of_a_sub_patch(p):
    w = [getattr(p.t0, name).value for name in CORNERS]
    for name, (u, v) in zip(CORNERS, p.uv, strict=True):
        exact = (1 - u) * ((1 - v) * w[0] + v * w[1]) + u * ((1 - v) * w[2] + v * w[3])
        yield held("corner", 5, getattr(p.patches["patch"][1][0], name), 5 * p.size.value, exact)


def step_4_projection(p):
    p.inclusion.clip_corner = clip = Mock(return_value=numeral(2))
    for _, ends, error in p.patches.values():
        p.inclusion.clip_beyond(p.d, p.inclusion.offset(p.d, error), p.t, *ends, False)
    for (name, allowed, ends, _, corner), call in zip(p.corners(), clip.call_args_list, strict=True):
        a, b, off, _ = call.args
        for x, end in ((a, 0), (b, 1)):
            yield held(name, allowed, x, off.shift, dot(p.d.value, at(ends, corner, end)))


def step_6_offset(p):
    e, m, d = abs(p.vector("E")), abs(p.vector("M")), np.abs(p.d.value)
    of_box, of_ball = dot(d, m.value), m.x.value * np.sqrt(dot(d, d))
    for name, off, of_separation in (
        ("direction", p.inclusion.offset(p.d, e + m), of_box),
        ("facet", p.facets.offset(p.d, e, m), of_box),
        ("ball", Pair(p.real, "euclidean").ball.offset(p.d, e, m), of_ball),
    ):
        yield held(name, rounding.RELATIVE, off, off.shift, dot(d, e.value) + of_separation)


def step_7_time(p):
    numbers = a, b, off, t = [drawn(name, unit=p.own) for name in ("a", "b", "off", "t")]
    s, compared = comparisons(p.inclusion.clip_corner, *numbers)
    first, last = (off.value < x.value for x in (a, b))
    entered = next(x for x, y in compared if y is t)
    exact = (a.value - off.value) / (a.value - b.value)
    yield held("entered", rounding.RELATIVE, entered, entered.shift, exact, last & ~first)
    stays = last & (first | (exact < t.value))
    assert is_same(s.value, np.where(stays, 2, np.where(first, exact, -1)))
    yield held("left", rounding.RELATIVE, s, -s.shift, None, first & ~last)


def step_8_corners_at_a_time(p):
    for name, _, ends, _, corner in p.corners():
        x, most = getattr(p.patch.corners_at(*ends, p.t), corner), {"root": 4, "patch": 8}[name]
        yield held(name, most, x, most * p.size.value, at(ends, corner, p.t.value))


def volume(p, *times):
    """P·(Q×R) at three times, the mean of all orders: of those at the ends of an interval a Bernstein coefficient."""
    w, q, r = ([at((p.t0, p.t1), name, s) for s in times] for name in ("w00", "q", "r"))
    return sum(dot(w[i], np.cross(q[j], r[k], axis=0)) for i, j, k in permutations(range(3))) / 6


def normals(p, t, x):
    """The Bernstein coefficients of Q×R on [t, x]."""
    sides = [[at((p.t0, p.t1), name, s) for name in "qr"] for s in (t, x)]
    pairs = combinations_with_replacement(sides, 2)
    return [(np.cross(a[0], b[1], axis=0) + np.cross(b[0], a[1], axis=0)) / 2 for a, b in pairs]


def support_above(p, t, x):
    """The coefficients of the cubic above the support of the separation on [t, x], as it is defined."""
    of_ball = [p.separation.value[0] * np.linalg.norm(n, axis=0) for n in normals(p, t, x)]
    of_box = [dot(p.separation.value, np.abs(n)) for n in normals(p, t, x)]
    a, b, c = of_ball if p.norm == "euclidean" else of_box
    return a, (a + 2 * b) / 3, (2 * b + c) / 3, c


def blossom(b, times):
    """A cubic from its Bernstein coefficients, at three times."""
    for s in times:
        b = [(1 - s) * x + s * y for x, y in pairwise(b)]
    return b[0]


def step_9_volume(p):
    yield from clipped(p, 3)
    name = "volume" if p.real == "float64" else "restriction"
    nothing = SimpleNamespace(**dict.fromkeys(("c0", "c1", "c2", "c3"), numeral(0))), [0] * 4
    for norm, has_separation in (("maximum", False), ("maximum", True), ("euclidean", True)):
        p = Pair(p.real, norm)
        f = p.in_precision.volume_between(*p.corners64, ONES, p.t0, p.t1, p.separation, has_separation)
        times = [*combinations_with_replacement((p.t.value, p.x.value), 3)]
        begin = volume(p, *times[0])
        local = p.volume.separation_offset(f, p.separation, p.t, p.x), support_above(p, p.t.value, p.x.value)
        of_step = [blossom(support_above(p, 0, 1), s) for s in times]
        of_step = p.volume.restrict(p.volume.reach_of(f, p.separation), p.t, p.x), of_step
        for by, above in (local, of_step) if has_separation else [nothing]:
            h = p.volume.lowered(p.volume.beyond_bound(f, p.t, p.x), by)
            for c, s, of_separation in zip(vars(h).values(), times, above, strict=True):
                # where the volume vanishes its sign is one of rounding
                exact, decided = np.where(begin < 0, -1, 1) * volume(p, *s) - of_separation, np.abs(begin) > 1e-14
                row, allowed = name + " of a separation" * has_separation, getattr(rounding, name.upper())
                yield held(row, allowed, c, -c.shift, exact, decided, c.before_last())


def clipped(p, degree):
    """The end of a clip whose control points are rounded once, and of which any decides, on either side of 0."""
    rng, c = np.random.default_rng(degree), [abs(drawn("c0", unit=p.own, lost=p.own))]
    n, c0 = len(c[0].value), c[0].value
    for j in range(1, degree + 1):
        # at most so much of the first where it decides: often nearly that, or around zero
        nearly = (degree - j) / degree - rng.choice([1e-9, 1e-3], n)
        x = c0 * np.where(rng.random(n) < 0.4, nearly, rng.uniform(-1, 1, n))
        x = np.where(rng.random(n) < 0.2, rng.choice([-1e-9, 1e-9], n) * c0, x)
        c.append(Number(x, 0.0, p.own * np.abs(x), p.own))
    steepest = [(1 - x.value / c0) * degree / j for j, x in enumerate(c[1:], 1)]
    if degree == 2:
        p.moving_clip.corner_crossing = lambda *_: p.moving_clip.crossing(*c)
        clip = p.moving_clip.clip_along(None, lambda *_: p.d, p.facets.offset)
        s = clip(p.t0, p.t1, p.separation, p.patches["root"][2], None, p.t, p.x, 1)
    else:
        s = p.volume.clip_hull(SimpleNamespace(**{f"c{k}": x for k, x in enumerate(c)}), p.t, p.x, p.x)[0]
    t, x = p.t.value, p.x.value
    exact = t + (x - t) / np.max(steepest, axis=0)
    gains = (np.min([y.value for y in c[1:]], axis=0) <= 0) & (t < x) & (exact > t + 1e-9)
    for j, is_positive in product(range(degree), (False, True)):
        if j < degree - 1 or not is_positive:
            where = gains & (np.argmax(steepest, axis=0) == j) & ((c[j + 1].value > 0) == is_positive)
            yield held("crossing", rounding.CROSSING + rounding.RELATIVE, s, -s.shift, exact, where)


def step_10_moving_facets(p):
    yield from clipped(Pair(p.real), 2)
    d = [p.vector("d.0"), p.vector("d.1")]
    clip = p.moving_clip.clip_along(None, lambda which, _: next(which), p.facets.offset)
    p.moving_clip.crossing = crossing = Mock(return_value=numeral(2))
    for _, ends, error in p.patches.values():
        clip(*ends, p.separation, error, iter(d * 2), p.t, p.x, 1)
    off = [dot(np.abs(y.value), p.separation.value) for y in d]
    for (name, allowed, ends, _, corner), call in zip(p.corners(), crossing.call_args_list, strict=True):
        sign = np.where(dot(d[0].value, at(ends, "w00", p.t.value)) < 0, -1, 1)
        (a, b), (c, e) = ([sign * dot(y.value, at(ends, corner, s.value)) for s in (p.t, p.x)] for y in d)
        for x, exact in zip(call.args, (a - off[0], (b + c - sum(off)) / 2, e - off[1]), strict=True):
            yield held(name, rounding.MOVING * allowed, x, -x.shift, exact, lost=x.before_last())


def proofs(row, allowed, call, *args, numbers=(None,) * 4, where=True, bound=None):
    """Rows of the numbers that are compared with a bound that covers what rounding takes."""
    compared = [(b, x) for b, x in comparisons(call, *args)[1] if np.any(b.shift) and x.unit]
    for (b, x), exact in zip(compared, numbers, strict=True):
        assert bound is None or is_same(b.value, bound)
        yield held(row, allowed, x, b.shift, exact, where, b.lost + x.lost)


def step_11_sides_and_the_volume_in_the_cull(p):
    cull, d, e, s = p.load("search.cull"), p.d.value, p.end.value, abs(drawn("S"))
    size = p.simd.greatest(*map(p.points.largest, p.corners64))
    sign = np.where(dot(d, p.t0.w00.value) < 0, -1, 1)
    exact = [sign * dot(d, at(p.corners64, name, time)) for name, time in product(CORNERS, (0, e))]
    for is_ball, length in enumerate((np.abs(d).sum(axis=0), np.sqrt(dot(d, d)))):
        args = cull.is_free_along, p.d, False, *p.corners64, size, s, is_ball, p.end
        yield from proofs("sides", rounding.SIDES, *args, numbers=exact, bound=s.value * length)
    begin = volume(p, 0, 0, 0)
    exact = [np.where(begin < 0, -1, 1) * volume(p, *times) for times in combinations_with_replacement((0, e), 3)]
    decided = np.abs(begin) > 1e-14
    args = cull.is_free_by_volume, *p.corners64, s, 0, p.end
    yield from proofs("volume", rounding.VOLUME + 1, *args, numbers=exact, where=decided)


def step_12_end_of_a_shorter_step(p):
    a, b = drawn("a.0", 3), drawn("a.1", 3)
    box = p.load("boxes.boxes").end_box(a, b, p.t)
    exact, moves = a.value + p.t.value * (b.value - a.value), a.value != b.value  # else it is at either end
    yield held("lower", rounding.INTERPOLATION, box.lower, -box.lower.shift, exact, moves)
    yield held("upper", rounding.INTERPOLATION, box.upper, box.upper.shift, exact, moves)


def step_13_euclidean_distances(p):
    p = Pair(p.real, "euclidean")
    separation, d = p.separation.x, p.d.value
    length, along, exact = p.support.length(p.d), p.support.support(p.separation, p.d), np.sqrt(dot(d, d))
    yield held("separation", rounding.SLACK - 13, separation, separation.shift * (rounding.SLACK - 13) / rounding.SLACK)
    yield held("length", 4, length, 4 * p.own * exact, exact)
    yield held("support", rounding.SLACK - 8, along, along.shift / 2, separation.value * exact)
    p, distance = Pair("float64", "euclidean"), abs(drawn("S"))
    longest = np.max([np.linalg.norm(n, axis=0) for n in normals(p, 0, 1)], axis=0)
    args = p.load("search.cull").is_free_by_volume, *p.corners64, distance, 1, numeral(1)
    yield from proofs("cull", rounding.NORMAL, *args, bound=distance.value * longest)


def step_15_distance_at_one_time(p):
    distance, box = p.load("at_one_time.pair_distance"), p.load("at_one_time.box_distance")
    points = SimpleNamespace(**{f"p{k}": drawn(f"p{k}.", 3) for k in range(4)})
    c = p.points.corners(1, points)
    s = p.house.power(p.simd.greatest_of(p.points.largest(c)))
    # a direction is what it is, whatever was lost on the way to it
    to_unit_size, directions = distance.to_unit_size, []
    distance.to_unit_size = lambda d: directions.append(Number(to_unit_size(d).value, unit=1.0)) or directions[-1]
    r, compared = comparisons(distance.measured, 1, points, True)
    (along,) = (y for x, y in compared if x.is_zero() and np.any(y.shift))
    lowest = [np.min([dot(n.value, (s * getattr(c, x)).value) for x in CORNERS], axis=0) for n in directions]
    is_second = np.abs(along.value - lowest[0]) > 1e-12
    n = np.where(is_second, directions[-1].value, directions[0].value)
    found = [(along, r.least, np.where(is_second, lowest[-1], lowest[0]), np.sqrt(dot(n, n)) * s.value)]
    # and of a direction in the norm of a box
    n, norm, w = drawn("n", 3), abs(drawn("norm", lost=2)), [drawn(f"{c}.0", 3, lost=1) for c in CORNERS]
    box.lowest = lowest = Mock(side_effect=box.lowest)
    m = p.points.largest(SimpleNamespace(**dict(zip(CORNERS, w, strict=True))))
    x = box.bound_along(n, *w, m, norm)
    along = lowest(*lowest.call_args.args)[1] - (box._PROJECTION * dot(abs(n), m) + box._TINY)
    found.append((along, x, np.min([dot(n.value, y.value) for y in w], axis=0), norm.value))
    for along, x, exact, divisor in found:
        yield held("projection", rounding.PROJECTION_ROOT, along, -along.shift, exact, lost=along.before_last())
        x, is_far = Number(x.value * divisor, x.shift * divisor, x.lost * divisor), along.value > 1e-9
        yield held("quotient", rounding.RELATIVE, x, along.shift - x.shift, exact, is_far, x.lost - along.before_last())


def step_16_bounds_of_displacements(p):
    minima, a, b = SimpleNamespace(vertex_body=[0, 1]), abs(drawn("least")), abs(drawn("kept"))
    a.value = a.value + 1  # the distance is above what is kept
    subnormal = [Fraction(k) * Fraction(2) ** -1074 for k in (0, 1, 3, 15, 16, 17, 31, 32, 33, 35, 63, 65, 2**20 + 1)]
    assert all(Fraction(largest_bound(float(2 * x), False)) <= x for x in subnormal)
    for name, is_static, sides in (("shared", (0, 0), 2), ("alone", (0, 1), 1)):
        for dtype in (np.float64, None):
            proximity = House(dtype=dtype).load("at_one_time.proximity")
            proximity.lower_bounds = lowered = Mock()
            if dtype is None:
                proximity.bound_pair([0], [1], a, b, is_static, minima)
                bits = lowered.call_args.args[1]
                yield held(name, rounding.RELATIVE, bits, -bits.shift, (a.value - b.value) / sides)
            for x in subnormal if dtype else ():
                proximity.bound_pair([0], [1], np.float64(float(x)), np.float64(0), is_static, minima)
                assert Fraction(float(lowered.call_args.args[1])) <= x / sides


STEPS = {int(name.split("_")[1]): step for name, step in globals().items() if name.startswith("step_")}
ROWS = re.findall(r"^\| (\d+) \| counted[^|]*\| (.*) \|$", rounding.__doc__, re.MULTILINE)


@pytest.mark.parametrize("number", STEPS)
def test_constants_cover_what_the_source_of_a_step_loses(number):
    assert {int(step) for step, _ in ROWS} == STEPS.keys()
    rows: dict = {}
    for real in ("float64", "float32")[: 1 if number in IN_FLOAT64 else 2]:
        for row, taken, allowed in STEPS[number](Pair(real)):
            # what a step says is a whole number; a constant has to cover the products of roundings as well
            assert taken <= (SECOND_ORDER if isinstance(allowed, int) else 1 / SECOND_ORDER), row
            rows[row] = max(float(taken * allowed), rows.get(row, (0, 0))[0]), allowed
    found = "; ".join(f"{row} {round(lost, 2):g} of {allowed:g}" for row, (lost, allowed) in rows.items())
    assert found == "; ".join(text for step, text in ROWS if int(step) == number)
