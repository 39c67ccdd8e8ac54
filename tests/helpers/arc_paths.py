"""Trajectories of rigid bodies and of points that move straight, in interval arithmetic, from poses as users give them.

Numbers of float64 count as exact, and a quaternion is normalized exactly. In a step from t = 0 to 1, a point of a body
at `local` in its own frame has the trajectory

    x(t) = P + t·velocity + σ1(t)·q + σ2(t)·(omega × q),     q = omega × R0·(local − pivot) + turning,
    P = place of the pivot at t = 0 + R0·(local − pivot),    σ1(t) = sin(θt)/θ,  σ2(t) = (1 − cos θt)/θ²,  θ = |omega|,

since Rot(t·omega)·r = r + σ1·(omega × r) + σ2·(omega × (omega × r)). On an interval of time, each trajectory is a
polynomial in s = (t − middle)/half whose constant coefficient carries the rest of the series as its radius.
"""

from __future__ import annotations

from flint import arb, arb_poly

# Coefficients of a polynomial. With a turn of 1 rad in half an interval, what is left out is 1/14! = 1e-11.
TERMS = 14
# Below, sine and cosine come as series about t = 0: (1 − cos θt)/θ² would lose all digits.
_SMALL_TURN = arb(2) ** -24
_SMALL_TURN_TERMS = 6  # 2^-24 to the twelfth power is 2^-288
UNIT = arb(0, 1)

Vector = list  # of three numbers or polynomials


def vector(values) -> Vector:
    return [arb(float(value)) for value in values]


def add(a: Vector, b: Vector) -> Vector:
    return [x + y for x, y in zip(a, b, strict=True)]


def sub(a: Vector, b: Vector) -> Vector:
    return [x - y for x, y in zip(a, b, strict=True)]


def scaled(factor, a: Vector) -> Vector:
    return [x * factor for x in a]


def dot(a: Vector, b: Vector):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def short(polynomial: arb_poly) -> arb_poly:
    """A polynomial of few terms that encloses this one for all s in [-1, 1]."""
    if polynomial.length() <= TERMS:
        return polynomial
    return polynomial.truncate(TERMS) + polynomial.right_shift(TERMS)(UNIT) * UNIT


def _rotation(quaternion: Vector):
    """The rotation by a quaternion (x, y, z, w) of any length, as a function."""
    *v, w = quaternion
    factor = 2 / (dot(v, v) + w * w)

    def rotated(x: Vector) -> Vector:
        once = cross(v, x)
        return add(x, scaled(factor, add(scaled(w, once), cross(v, once))))

    return rotated


def shortest_rotation_vector(start: Vector, end: Vector) -> Vector:
    """The rotation vector of at most π that takes one orientation to another, world frame."""
    (x0, y0, z0, w0), (x1, y1, z1, w1) = start, end
    w = w1 * w0 + x1 * x0 + y1 * y0 + z1 * z0
    v = [
        x1 * w0 - w1 * x0 - y1 * z0 + z1 * y0,
        y1 * w0 - w1 * y0 - z1 * x0 + x1 * z0,
        z1 * w0 - w1 * z0 - x1 * y0 + y1 * x0,
    ]
    if w < 0:
        v, w = scaled(-1, v), -w
    if all(x.is_zero() for x in v):
        return v
    sine = dot(v, v).sqrt()
    return scaled(2 * arb.atan2(sine, w) / sine, v)


class Basis:
    """t, σ1 and σ2 of a motion as polynomials on an interval."""

    def __init__(self, theta: arb, middle: arb, half: arb):
        self.t = arb_poly([middle, half])
        if theta.is_zero():
            self.sigma1, self.sigma2 = self.t, self.t * self.t * arb(0.5)
        elif theta < _SMALL_TURN:
            self.sigma1, self.sigma2 = self._series(theta)
        else:
            self.sigma1, self.sigma2 = self._turned(theta, middle, half)

    def _series(self, theta: arb) -> tuple[arb_poly, arb_poly]:
        first, second, factor = [arb(0)], [arb(0), arb(0)], arb(1)
        for k in range(_SMALL_TURN_TERMS):
            factor = factor / (2 * k + 1) if k == 0 else -factor * theta * theta / (2 * k * (2 * k + 1))
            first += [factor, arb(0)]
            second += [factor / (2 * k + 2), arb(0)]
        rest = UNIT * theta ** (2 * _SMALL_TURN_TERMS)  # of an alternating series with t in [0, 1], by its next term
        return tuple(short(arb_poly(terms)(self.t) + rest) for terms in (first, second))

    def _turned(self, theta: arb, middle: arb, half: arb) -> tuple[arb_poly, arb_poly]:
        sine, cosine = (theta * middle).sin_cos()
        turn = theta * half
        sines, cosines, factor = [], [], arb(1)
        for k in range(TERMS):
            sines.append(factor * (sine, cosine, -sine, -cosine)[k % 4])
            cosines.append(factor * (cosine, -sine, -cosine, sine)[k % 4])
            factor = factor * turn / (k + 1)
        rest = UNIT * factor  # by Taylor's theorem, as no derivative of sine or cosine exceeds one
        return (arb_poly(sines) + rest) * (1 / theta), (1 - arb_poly(cosines) - rest) * (1 / (theta * theta))


class StraightPath:
    """Points that move straight, as those of a deformable body; at rest without an end.

    Args:
        start, end: Positions in the world, shape [points, 3].
    """

    omega = vector([0, 0, 0])
    theta = arb(0)

    def __init__(self, start, end):
        self._start = [vector(point) for point in start]
        self._velocity = [sub(vector(b), a) for a, b in zip(self._start, end, strict=True)]

    def points(self, basis: Basis) -> list[Vector]:
        """The positions as polynomials."""
        moving = zip(self._start, self._velocity, strict=True)
        return [[x + v * basis.t for x, v in zip(*both, strict=True)] for both in moving]


class RigidPath:
    """Points of a rigid body.

    Args:
        local: Points in the body's frame, shape [points, 3].
        pose_t0: Position and quaternion (x, y, z, w) at t = 0.
        pose_t1: The same at t = 1, or None where a twist is given.
        path: "linear", along which the pivot moves straight, or "screw", on which the body turns about a fixed axis,
            and moves along it.
        pivot: In the body's frame; zero for a screw.
        twist: Velocity of the pivot and rotation vector of the step, world frame.
    """

    def __init__(self, local, pose_t0, pose_t1, path="linear", pivot=(0.0, 0.0, 0.0), twist=None):
        origin, first = vector(pose_t0[:3]), vector(pose_t0[3:])
        pivot, turned = vector(pivot), _rotation(first)
        if path == "screw" and not all(x.is_zero() for x in pivot):
            raise ValueError("a screw has no pivot")
        arms = [turned(sub(vector(point), pivot)) for point in local]
        start = add(origin, turned(pivot))
        if twist is not None:
            moved, self.omega = vector(twist[:3]), vector(twist[3:])
        else:
            last = vector(pose_t1[3:])
            moved = sub(add(vector(pose_t1[:3]), _rotation(last)(pivot)), start)
            self.omega = shortest_rotation_vector(first, last)
        squared = dot(self.omega, self.omega)
        self.theta = squared.sqrt()
        velocity, turning = moved, vector([0, 0, 0])
        if path == "screw" and not self.theta.is_zero():
            velocity = scaled(dot(self.omega, moved) / squared, self.omega)
            turning = sub(moved, velocity)
            if twist is None:
                end = Basis(self.theta, arb(1), arb(0))
                s1, s2 = end.sigma1[0], end.sigma2[0]
                across = sub(scaled(s1, turning), scaled(s2, cross(self.omega, turning)))
                turning = scaled(1 / (s1 * s1 + squared * s2 * s2), across)
        self._points = []
        for arm in arms:
            q = add(cross(self.omega, arm), turning)
            self._points.append((add(start, arm), velocity, q, cross(self.omega, q)))

    def points(self, basis: Basis) -> list[Vector]:
        """The positions as polynomials."""
        t, s1, s2 = basis.t, basis.sigma1, basis.sigma2
        return [[x + v * t + q * s1 + p * s2 for x, v, q, p in zip(*row, strict=True)] for row in self._points]
