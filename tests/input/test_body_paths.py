"""The fields of paths of bodies, and places on them, are within their stated bounds of those of 60 digits (arb)."""

import math

import numpy as np
import pytest
from flint import arb, arb_poly, ctx
from laws.trajectories import add, cross, dot, exact, scaled, sub
from laws.turning import rotated, shortest_rotation_vector, turning

import ccd_warp as ccd
from ccd_warp._rigid.rotations import arc_factors

EPS = 2.0**-52
COUNT = 50  # of each family


@pytest.fixture(autouse=True)
def many_digits():
    """60 digits and more are left where neighbouring quaternions cancel."""
    with ctx.workprec(320):
        yield


def _neighbours(rng):
    """Quaternions of 53 bits, of which the product's vector part is 2 where its terms are of about 2**105."""
    while True:
        a, b = (int(x) for x in rng.integers(2**52, 2**53, 2))
        if math.gcd(a, b) == 1:
            c = pow(a, -1, b)
            d = (a * c - 1) // b
            return [a, b, a, b], [d, c, d, c]


def _families():
    """Quaternions at both ends, by what is special about them."""
    rng = np.random.default_rng(3)
    q = rng.normal(size=(COUNT, 4))
    other = rng.normal(size=(COUNT, 4))
    small = 10.0 ** rng.uniform(-17, 0, (COUNT, 1))
    length = 10.0 ** rng.uniform(-250, 250, (COUNT, 1))
    axis = np.hstack([rng.normal(size=(COUNT, 3)), np.zeros((COUNT, 1))])
    identity = np.tile([0.0, 0, 0, 1], (COUNT, 1))
    yield "any two", q, other
    yield "of lengths far apart", q * length, other / length
    yield "near each other", q, 3.0 * q + small * other
    yield "near opposite ones", q, -0.3 * q + small * other
    yield "in neighbouring floats", q, np.nextafter(q, 2.0 * q)
    yield "near half a turn", identity, axis + small * identity
    yield "a tiny turn", identity, identity + 10.0 ** rng.uniform(-300, -1, (COUNT, 1)) * axis
    yield "of components far apart", *(x * 10.0 ** rng.uniform(-120, 0, (COUNT, 4)) for x in (q, other))
    yield "of neighbouring fractions", *np.array([_neighbours(rng) for _ in range(COUNT)]).transpose(1, 0, 2)
    yield "the same", q, np.where(rng.integers(0, 2, (COUNT, 1)), -2.0 * q, q)


FAMILIES = {name: ends for name, *ends in _families()}


def length(vector):
    return dot(vector, vector).sqrt()


def check(found, expected, bound):
    """A vector of floats is no farther from one of arb, in Euclidean length, than a multiple of eps."""
    apart = sub(exact(found), expected)
    bound = EPS * bound + (arb(0) if bound == 0 else arb(1e-300))  # nothing is asked of what is hardly a float
    assert dot(apart, apart) <= bound**2, (found, bound)


@pytest.mark.parametrize("family", FAMILIES)
def test_fields_are_within_their_bounds(family):
    rng = np.random.default_rng(4)
    start, end = (np.hstack([np.zeros((COUNT, 3)), q]) for q in FAMILIES[family])
    start[:, :3] = rng.normal(size=(COUNT, 3)) * 10.0 ** rng.uniform(-6, 6, (COUNT, 1))
    end[:, :3] = start[:, :3] + rng.normal(size=(COUNT, 3)) * 10.0 ** rng.uniform(-9, 6, (COUNT, 1))
    pivot = rng.normal(size=(COUNT, 3)) * 10.0 ** rng.uniform(-3, 3, (COUNT, 1))
    linear = ccd.RigidMotion(start, end, pivot=pivot)._body_paths
    screw = ccd.RigidMotion(start, end, path="screw")._body_paths
    for k in range(COUNT):
        p0, p1, c = exact(start[k, :3]), exact(end[k, :3]), exact(pivot[k])
        q0, q1 = exact(start[k, 3:]), exact(end[k, 3:])
        omega, d, arm = shortest_rotation_vector(q0, q1), sub(p1, p0), rotated(q0, c)
        angle = length(omega)
        check(linear.rotation[k], scaled(1 / (dot(q0, q0) + q0[3] ** 2).sqrt(), q0), 2)
        check(linear.omega[k], omega, 4 * angle)  # exactly 0 where nothing turns
        check(linear.pivot_t0[k], add(p0, arm), length(p0) + 8 * length(c))
        way = sub(add(d, rotated(q1, c)), arm)
        check(linear.velocity[k], way, 2 * length(d) + 16 * arb.min(angle, arb(2)) * length(c))
        assert not linear.turning[k].any() and (linear.pivot[k] == pivot[k]).all() and not screw.pivot[k].any()
        np.testing.assert_array_equal(screw.pivot_t0[k], start[k, :3])
        along = scaled(dot(omega, d) / angle**2, omega) if angle > 0 else d
        check(screw.velocity[k], along, 8 * length(d))
        found, across = exact(screw.turning[k]), sub(d, along)
        if angle > 0:
            # σ1(1) and σ2(1) as they are defined; the equation for turning, which has factors of at least 2/π
            one, two = angle.sin() / angle, (1 - angle.cos()) / angle**2
            apart = sub(add(scaled(one, found), scaled(two, cross(omega, found))), across)
            check([0.0, 0.0, 0.0], apart, 8 * length(d))
        else:
            assert not screw.turning[k].any()


def test_factors_of_arcs_where_nothing_turns_are_their_limits():
    for omega in (0.0, 1e-300, 1e-170, 1e-12):
        first, second = arc_factors(np.full((1, 3), omega), np.array([0.3]))
        np.testing.assert_allclose([first[0, 0], second[0, 0]], [0.3, 0.045], rtol=4 * EPS)


@pytest.mark.parametrize("path", ["linear", "screw"])
def test_places_are_those_of_the_definition(path):
    """Poses and twists of up to 30 rad, at any time; the error of θ t grows with θ."""
    rng = np.random.default_rng(5)
    start, points = rng.normal(size=(80, 7)), rng.normal(size=(80, 3))
    twist = rng.normal(size=(80, 6)) * 10.0 ** rng.uniform(-12, 1, (80, 1))
    pivot = rng.normal(size=(80, 3)) if path == "linear" else None
    motion = ccd.RigidMotion(start, twist=twist, path=path, pivot=pivot)
    t = rng.uniform(size=80)
    found, poses = motion._body_paths.positions(points, np.arange(80), t), motion.at(t)
    for k in range(80):
        local = [points[k], [0.0, 0, 0]]
        about = {} if pivot is None else {"pivot": pivot[k]}
        place = turning(local, start[k], path=path, twist=twist[k], **about)(arb_poly([arb(float(t[k]))]))
        expected, origin = ([arb_poly(x)[0] for x in point] for point in place)
        turned = [float(v.mid()) for v in rotated(exact(poses[k, 3:]), exact(points[k]))]
        for seen, of in ((found[k], expected), (poses[k, :3], origin), (turned, sub(expected, origin))):
            check(seen, of, 60 * (1 + np.abs(twist[k]).sum()))
