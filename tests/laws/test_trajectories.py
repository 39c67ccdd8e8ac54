"""The oracle of trajectories, against times known by analysis, rational arithmetic, and matrix exponentials."""

import math
from itertools import product

import numpy as np
import pytest
from flint import arb, arb_poly, ctx
from trimesh.transformations import quaternion_matrix, quaternion_multiply, rotation_matrix

from laws.trajectories import BITS, Parts, first_contact, search, short, sine_and_cosine, straight
from laws.truth import first_times
from laws.turning import AT_REST, COUNTS, quaternion, turning

WALL = np.array([[0.0, -9, -9], [0, 9, -9], [0, 0, 9]])  # in the plane x = 0
GROUND = np.array([[-9.0, -9, 0], [9, -9, 0], [0, 9, 0]])
HAND, BAR, TIP = np.array([[0.5, 0, 0], [2, 0, 0]]), np.array([[0.0, 1, -1], [0, 1, 1]]), [[1, 0, 0]]
FACE, EDGE = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0]]), np.array([[-1.0, 0, 0], [1, 0, 0]])
UP = np.array([0, 0, 1.0])


def stays(*x):
    return straight(*2 * [np.reshape(x, (-1, 3))])


def spins(x, turn, *velocity, axis=UP, **names):
    """Points that turn about an axis through the origin, which moves by a velocity."""
    twist = [*(velocity or [0, 0, 0]), *(turn * np.asarray(axis, dtype=float))]
    return turning(np.reshape(x, (-1, 3)), AT_REST, twist=twist, **names)


def goes(x, end, **names):
    """Points of a body that is at rest at first, to a place and a rotation vector."""
    return turning(np.reshape(x, (-1, 3)), AT_REST, [*end[:3], *quaternion(np.array(end[3:], dtype=float))], **names)


def near(angle):  # by which a radius of 1 comes to within 0.5 of (-1, 0)
    return math.pi - 2 * math.asin(0.25) - angle


def ways():
    """A point or an edge that comes straight to a face or an edge from beyond each of their sides and ends: at 1/2."""
    sides = ([0, 0], [-1, -1]), ([4, 0], [1, -0.2]), ([0, 3], [-0.2, 1]), ([2, 0], [0, -1]), ([0, 1], [-1, 0])
    cases = [("vertex-face", np.array([[*place, 0.0]]), np.array([*way, 0]), FACE) for place, way in sides]
    across, askew = np.array([[0.0, 0, 0], [0, 2, 0]]), np.array([[1.0, 0, 0], [3, 0.5, 0.3]])
    shift = np.array([1.0, 0, 0])
    edges = (
        (across, [0, 1, 0], EDGE),
        (EDGE, [0, -1, 0], across),
        (askew, shift, EDGE),
        (EDGE - shift, -shift, EDGE + shift),
    )
    for kind, x, way, y in cases + [("edge-edge", x, np.array(way), y) for x, way, y in edges]:
        way = way / np.linalg.norm(way)
        yield kind, x + 5.5 * way, -10 * np.array([way]), y


KNOWN = [  # kind, both sides, distance, and the time; None where they never touch
    *(("vertex-face", spins([2, 0, 1], turn), stays(WALL), 0, math.pi / 2 / turn) for turn in (2.0, 3.0, 6.5, 100.0)),
    ("vertex-face", spins([2, 0, 1], 1.5), stays(WALL), 0, None),
    ("vertex-face", spins([2, 0, 50], 50.0), stays(WALL), 0, None),
    ("vertex-face", goes([2, 0, 1], [0, 0, 0, 0, 0, 2.5]), stays(WALL), 0, math.pi / 2 / 2.5),
    ("vertex-face", goes([2, 0, 1], [0, 0, 0, 0, 0, 5.0]), stays(WALL), 0, None),  # 1.28 rad the other way
    # the tip is 3 from the pivot at (3, 0, 0), and at x = 0.5 where the cosine is -2.5/3
    ("vertex-face", turning([[4, 0, 0]], [2, *AT_REST[1:]], pivot=(1, 0, 0), twist=[0, 0, 0, 0, 0, 3.0]),
     stays(WALL + [0.5, 0, 0]), 0, math.acos(-2.5 / 3) / 3),
    ("edge-edge", spins(HAND, 2.0), stays(BAR), 0, math.pi / 4),
    ("edge-edge", spins(HAND, 2.0), straight(BAR - 3 * UP, BAR), 0, math.pi / 4),  # it reaches from -1.6 to 0.4
    ("edge-edge", spins(HAND, 2.0), stays(BAR + 1.5 * UP), 0, None),
    # a point at the top of a wheel comes down to half the radius after a third of a turn, wherever it has rolled
    ("vertex-face", turning([UP], [0, 0, 1, 0, 0, 0, 1], twist=[0, 5.0, 0, -5.0, 0, 0]),
     stays(99 * GROUND + 0.5 * UP), 0, 2 * math.pi / 3 / 5),
    # a nut turns by 2 rad and sinks by 1; a screw leads the origin along an arc, as a chord does not
    ("vertex-face", turning([[0, 1, 0]], [1, *AT_REST[1:]], [math.cos(2), math.sin(2), -1, *quaternion(2 * UP)],
     "screw"), stays(GROUND - 0.75 * UP), 0, 0.75),
    ("vertex-face", turning([[0, 0, 0]], [1, *AT_REST[1:]], twist=[0, 2, 0, 0, 0, 2], path="screw"), stays(WALL), 0,
     math.pi / 4),
    *(("point-point", spins(TIP, turn), stays([-1, 0, 0]), 0.5, near(0) / turn) for turn in (3.2, 30.0)),
    ("point-segment", spins(TIP, 3.2), stays([[-1, 0, 2], [-1, 0, -3]]), 0.5, near(0) / 3.2),
    ("point-point", spins(TIP, 4.0), stays([-1, 0, 0.6]), 0.5, None),
    ("vertex-face", spins([2, 0, 1], 2.0), stays(WALL), 1.0, math.acos(0.5) / 2),
    ("edge-edge", spins(HAND, 2.0), stays(BAR), 0.25, (math.pi / 2 - math.asin(0.25)) / 2),  # |cos| from (0, 1)
    *(("vertex-plane", spins([1.0, 0, 0], 2.0, axis=[0, 1, 0]), stays([0, 0, -0.75], [0, 0, 3.0]), d,
       math.asin(0.75 - d) / 2) for d in (0.0, 0.25)),
    *(("vertex-face", spins([0, 0, 1], 3.0, *v, axis=UP), stays(WALL), 0, 0.0) for v in ((), (1.0, 0, 0))),
    ("vertex-face", spins(TIP, 2.0), stays([[0, 0.5, 0], [0, 3, 0], [-3, 1, 0]]), 0, math.pi / 4),  # in one plane
    *((kind, straight(x, x + v), stays(y), 0.5, 0.5) for kind, x, v, y in ways()),
    ("edge-edge", stays(EDGE), straight(EDGE + [5, 0, 0], EDGE + [3, 0, 0]), 0, None),  # on one line
    *(("vertex-face", spins(TIP, turn, 0, 0, -1, axis=[0, 1, 0]), stays(GROUND - 0.5 * UP), 0, 0.5 / (1 + turn))
      for turn in (1e-300, 1e-160, 1e-12, 1e-8, 3e-8)),
]  # fmt: skip


@pytest.mark.parametrize("case", KNOWN)
def test_times_that_are_known(case):
    *sides, expected = case
    lo, hi, _ = first_contact(*sides)
    if expected is None:
        assert lo is hi is None
    else:  # to the rounding of what is expected, and second order of the tiny turns
        assert lo <= hi and hi - lo <= 1e-20 and abs(float(lo) - expected) <= 1e-15


@pytest.mark.parametrize("margin", [1e-3, 1e-9, 1e-15, 0.0, -1e-15, -1e-9, -1e-3])
def test_a_grazing_circle(margin):
    """Of radius 1 + margin about z and the plane x = 1: what touches in one time is undecided, and never guessed."""
    ends = [[0, 0, 0, 0, 0, sign, 2] for sign in (-1, 1)]  # quaternions that are not unit, and symmetric
    lo, hi, _ = first_contact("vertex-face", turning([[1 + margin, 0, 0]], *ends), stays(WALL + [1, 0, 0]))
    assert (lo is None) == (margin < 0) and (hi is None) == (margin <= 0)
    if margin >= 0:
        half = 2 * math.atan(0.5)
        assert -1e-8 < float(lo) - 0.5 * (1 - math.acos(1 / (1 + margin)) / half) < 1e-12 + 1e-8 * (margin > 0)


def test_what_comes_after_a_doubt_is_found():
    """A function that touches zero at 1/3, which no interval tells from missing it, and is positive after 3/4."""

    def feature(a, _):
        t = a[0][0]
        yield 1, (t - arb(1) / 3) * (t - arb(1) / 3) * (t - arb(0.75))

    with ctx.workprec(BITS):
        found = search(feature, 2 * [lambda t: [[t, t, t]]], arb(0))
        assert 0.333 < found.lo < arb(1) / 3 and 0.75 <= found.hi and found.hi - 0.75 < 1e-20


@pytest.mark.parametrize("gap", [1e-3, 1e-9])
def test_parallel_edges_that_spin_together_are_apart_in_few_looks(gap):
    sides = [spins(EDGE + [0, 1, 0] + x, 1.0, axis=[1.0, 2, 5]) for x in (np.zeros(3), np.array([0.25, 0, gap]))]
    lo, _, looks = first_contact("edge-edge", *sides)
    assert lo is None and looks < 50


def test_straight_pairs_touch_when_rational_arithmetic_says_so():
    """All kinds and both distances, of which some touch and some do not."""
    for kind, distance in product(COUNTS, (0.0, 0.3)):
        rng = np.random.default_rng(len(kind))
        start, end = rng.standard_normal((2, 80, sum(COUNTS[kind]), 3))
        end[:, 0] = -start[:, 0]
        truth = first_times(kind, start, end, np.full(80, distance), True, 1.0)
        assert 2 < sum(x.hit for x in truth) < 78 or (distance == 0 and kind.startswith("point"))
        first = COUNTS[kind][0]
        for x, y, expected in zip(start, end, truth, strict=True):
            lo, hi, _ = first_contact(kind, straight(x[:first], y[:first]), straight(x[first:], y[first:]), distance)
            assert (hi is not None) == (lo is not None) == expected.hit
            if expected.hit:
                with ctx.workprec(BITS):
                    below, above = (arb(bound.p) / arb(bound.q) for bound in expected.refine(100))
                assert lo <= above and below <= hi and hi - lo < 1e-21


@pytest.mark.parametrize("path", ["linear", "screw"])
def test_bodies_are_where_products_of_many_small_motions_lead(path):
    """A screw is a power of one matrix; on a linear path the pivot goes straight and the body turns about it."""
    rng = np.random.default_rng(1)
    for by_twist, turn in product((False, True), (1e-9, 0.5, 3.0)):
        start, omega = rng.standard_normal(7), turn * rng.standard_normal(3) / 2
        velocity, pivot, x = rng.standard_normal((3, 3))
        pivot *= path == "linear"
        theta, first = np.linalg.norm(omega), quaternion_matrix(np.roll(start[3:], 1))
        first[:3, 3] = start[:3]
        if path == "screw":  # about the axis through centre, with ω × (origin − centre) + along = velocity
            centre, along = start[:3] + np.cross(omega, velocity) / theta**2, omega * (omega @ velocity) / theta**2
        else:
            centre, along = first[:3, :3] @ pivot + start[:3], velocity

        def at(t, omega=omega, theta=theta, first=first, centre=centre, along=along):
            turned = rotation_matrix(theta * t, omega, centre)
            turned[:3, 3] += t * along
            return turned @ first

        orientation = quaternion_multiply(np.roll(quaternion(omega), 1), np.roll(start[3:], 1))  # at the end
        names = {"twist": [*velocity, *omega]} if by_twist else {"end": [*at(1.0)[:3, 3], *np.roll(orientation, -1)]}
        points = turning([x], start, path=path, pivot=pivot, **names)
        for t in (0.0, 0.3, 1.0):
            with ctx.workprec(BITS):
                found = [float(arb_poly(v)[0]) for v in points(arb_poly([arb(t)]))[0]]
            error = 1e-12 + (1e-15 / theta if path == "screw" else 0.0)  # an axis far away costs digits here
            np.testing.assert_allclose(found, (at(t) @ [*x, 1.0])[:3], rtol=0, atol=error)


def test_enclosures_hold_sines_cosines_and_what_is_cut_off():
    rng = np.random.default_rng(0)
    with ctx.workprec(BITS):
        for k in range(50):  # of every other one no power is cut off, and what is left out is the rest of the series
            size = [300, *0.5 ** np.arange(2, 6)] * (np.arange(5) < (2 if k % 2 else 5))
            angle = arb_poly([arb(float(x)) for x in rng.standard_normal(5) * size])
            sine, cosine = sine_and_cosine(angle)
            cube = short(angle * angle * angle * angle)
            for s in map(arb, np.linspace(-1, 1, 9).tolist()):
                exact = angle(s)
                for p, value in ((sine, exact.sin()), (cosine, exact.cos()), (cube, exact**4)):
                    assert p(s).contains(value.mid()) and p(s).rad() < 1e-6 * 300**4


def test_what_a_slope_within_bounds_proves_of_an_interval():
    """Nothing where it outweighs the value; of 1/2 to 3/2 that -1/10 is made good by 1/5; a root beyond 1 is none."""
    doubtful, rising, falling, beyond = (Parts() for _ in range(4))
    doubtful.not_negative(arb_poly([arb(0.1), arb(0, 0.5)]))
    assert doubtful.may == [-1, 1] and doubtful.contact() is None
    for parts, sign in ((rising, 1), (falling, -1)):
        parts.not_negative(arb_poly([arb(-0.1), sign * arb(1, 0.5)]))
    assert rising.does[0] > 0.19 and falling.does[1] < -0.19
    beyond.zero(arb_poly([-2, 1]))
    assert beyond.root is None
