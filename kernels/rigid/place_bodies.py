"""Where bodies that turn are at both ends of a slice of the step, and how their vertices turn in it.

A body turns by ω in the whole step, R at its start, about a point c of its own frame, which is at p then and moves on
by v; u is what turns with the body of the velocity of that point (of a screw, whose axis is elsewhere):

    x(t) = p + v·t + σ1(t)·u + σ2(t)·ω×u + Rot(tω)·R·(X − c),   σ1(t) = sin(θt)/θ,   σ2(t) = (1 − cos(θt))/θ².

With s = sin(θt/2)/θ these are σ1 = 2s·cos(θt/2) and σ2 = 2s². The rounding is step 18 of `rounding`.
"""

import warp as wp

from ..pair.rounding import EIGHTH_UP, INTERPOLATION, PLACE, PLACE_POSITION, RELATIVE, UNIT_ROUNDOFF

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

vec3d = wp.vec3d
_ZERO = wp.constant(wp.float64(0.0))
_HALF = wp.constant(wp.float64(0.5))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
_FOUR = wp.constant(wp.float64(4.0))
# 2/π, and π/2 in parts of 33 bits (fdlibm, `e_rem_pio2.c`), so that products with whole numbers below 2^20 are exact.
_QUARTERS = wp.constant(wp.float64(0.63661977236758134308))
_QUARTER_1 = wp.constant(wp.float64(1.57079632673412561417))
_QUARTER_2 = wp.constant(wp.float64(6.07710050630396597660e-11))
_QUARTER_3 = wp.constant(wp.float64(2.02226624879595063154e-21))
# Coefficients of the power series of sine and cosine in the square.
_SINE_1 = wp.constant(wp.float64(-1.0 / 6.0))
_SINE_2 = wp.constant(wp.float64(1.0 / 120.0))
_SINE_3 = wp.constant(wp.float64(-1.0 / 5040.0))
_SINE_4 = wp.constant(wp.float64(1.0 / 362880.0))
_SINE_5 = wp.constant(wp.float64(-1.0 / 39916800.0))
_SINE_6 = wp.constant(wp.float64(1.0 / 6227020800.0))
_SINE_7 = wp.constant(wp.float64(-1.0 / 1307674368000.0))
_SINE_8 = wp.constant(wp.float64(1.0 / 355687428096000.0))
_COSINE_1 = wp.constant(wp.float64(-1.0 / 2.0))
_COSINE_2 = wp.constant(wp.float64(1.0 / 24.0))
_COSINE_3 = wp.constant(wp.float64(-1.0 / 720.0))
_COSINE_4 = wp.constant(wp.float64(1.0 / 40320.0))
_COSINE_5 = wp.constant(wp.float64(-1.0 / 3628800.0))
_COSINE_6 = wp.constant(wp.float64(1.0 / 479001600.0))
_COSINE_7 = wp.constant(wp.float64(-1.0 / 87178291200.0))
_COSINE_8 = wp.constant(wp.float64(1.0 / 20922789888000.0))
# A turn whose square may underflow, as far as sine and cosine go none.
_NO_TURN = wp.constant(wp.float64(1.0e-100))
# The sagitta of the whole slice is an eighth of |ω|·|V|.
_EIGHTH_UP = wp.constant(wp.float64(EIGHTH_UP))
_SUM_UP = wp.constant(wp.float64(1.0 + RELATIVE * UNIT_ROUNDOFF[wp.float64]))
_PLACE_POSITION = wp.constant(wp.float64(PLACE_POSITION * UNIT_ROUNDOFF[wp.float64]))
_PLACE = wp.constant(wp.float64(PLACE * UNIT_ROUNDOFF[wp.float64]))
# Of the length of a vector: of each of its coordinates, on three axes.
_INTERPOLATION = wp.constant(wp.float64(2.0 * INTERPOLATION * UNIT_ROUNDOFF[wp.float64]))
_SQUARE_UNDERFLOW = wp.constant(wp.float64(2.0**-1000))
# More than all products of a vertex lose by underflow.
_UNDERFLOW = wp.constant(wp.float64(2.0**-1068))


@wp.struct
class BodyPaths:
    """The paths of all bodies in the whole step."""

    is_rigid: wp.array[wp.int32]  # the others are not placed
    rotation: wp.array[wp.vec4d]  # R, as a quaternion x y z w
    omega: wp.array[vec3d]
    pivot: wp.array[vec3d]  # c
    start: wp.array[vec3d]  # p
    velocity: wp.array[vec3d]  # v
    turning: wp.array[vec3d]  # u
    excess: wp.array[wp.float64]  # how far its vertices may be from this path, a length


@wp.struct
class BodyPlace:
    """A body at one time."""

    rotation: wp.vec4d
    position: vec3d  # of its pivot
    turning: vec3d


@wp.struct
class BodyEnds:
    """All bodies at both ends of a slice."""

    rotation: wp.array[wp.vec4d]
    position: wp.array[vec3d]
    turning: wp.array[vec3d]
    last_rotation: wp.array[wp.vec4d]
    last_position: wp.array[vec3d]


@wp.func
def rotated(q: wp.vec4d, v: vec3d) -> vec3d:
    """A vector, turned by a unit quaternion."""
    u = vec3d(q[0], q[1], q[2])
    w = wp.cross(u, v)
    return v + _TWO * (q[3] * w + wp.cross(u, w))


@wp.func
def product(p: wp.vec4d, q: wp.vec4d) -> wp.vec4d:
    """The product of two quaternions: the turn by q and then by p."""
    a = vec3d(p[0], p[1], p[2])
    b = vec3d(q[0], q[1], q[2])
    v = p[3] * b + q[3] * a + wp.cross(a, b)
    return wp.vec4d(v[0], v[1], v[2], p[3] * q[3] - wp.dot(a, b))


@wp.func
def sine_and_cosine(a: wp.float64) -> wp.vec2d:
    """sin a and cos a, of the same bits on all devices, within 4u for 0 <= a below 10^6.

    The angle is reduced by quarters of a turn, of which the first part is subtracted exactly.
    """
    n = wp.floor(a * _QUARTERS + _HALF)
    x = ((a - n * _QUARTER_1) - n * _QUARTER_2) - n * _QUARTER_3
    w = x * x
    p = _SINE_5 + w * (_SINE_6 + w * (_SINE_7 + w * _SINE_8))
    p = w * (_SINE_1 + w * (_SINE_2 + w * (_SINE_3 + w * (_SINE_4 + w * p))))
    q = _COSINE_5 + w * (_COSINE_6 + w * (_COSINE_7 + w * _COSINE_8))
    q = w * (_COSINE_1 + w * (_COSINE_2 + w * (_COSINE_3 + w * (_COSINE_4 + w * q))))
    s = x + x * p
    c = _ONE + q
    quarter = wp.int32(n - _FOUR * wp.floor(n / _FOUR))
    if quarter == 1:
        return wp.vec2d(c, -s)
    if quarter == 2:
        return wp.vec2d(-s, -c)
    if quarter == 3:
        return wp.vec2d(-c, s)
    return wp.vec2d(s, c)


@wp.func
def place_at(paths: BodyPaths, body: int, t: wp.float64) -> BodyPlace:
    """Where a body is at a time of the step."""
    omega = paths.omega[body]
    turning = paths.turning[body]
    angle = wp.length(omega)
    s = _HALF * t
    c = _ONE
    if angle > _NO_TURN:
        of_half = sine_and_cosine(_HALF * t * angle)
        s = of_half[0] / angle
        c = of_half[1]
    turn = wp.vec4d(s * omega[0], s * omega[1], s * omega[2], c)
    place = BodyPlace()
    place.rotation = product(turn, paths.rotation[body])
    moved = paths.start[body] + t * paths.velocity[body]
    place.position = moved + (_TWO * s * c) * turning + (_TWO * s * s) * wp.cross(omega, turning)
    place.turning = rotated(turn, turning)
    return place


@wp.func
def slack_of(paths: BodyPaths, body: int, arm: vec3d, x: vec3d) -> wp.float64:
    """By how much rounding may move a vertex (rounding, step 18)."""
    start = paths.start[body]
    far = wp.max(wp.max(wp.abs(start)), wp.max(wp.abs(start + paths.velocity[body])))
    reach = wp.length(arm) + wp.length(paths.pivot[body]) + wp.length(paths.turning[body]) + wp.max(wp.abs(x))
    reach += wp.length(paths.velocity[body])  # of a screw it has the error of the direction of its axis
    return _PLACE_POSITION * far + _PLACE * (_ONE + _HALF * wp.length(paths.omega[body])) * reach


@wp.kernel
def place_bodies(
    begin: int,
    # in
    t_begin: wp.array[wp.float64],  # of each body
    t_end: wp.array[wp.float64],
    paths: BodyPaths,
    # out
    ends: BodyEnds,
):
    """Place the bodies at both ends of a slice."""
    body = begin + wp.tid()
    if paths.is_rigid[body] == 0:
        return
    first = place_at(paths, body, t_begin[body])
    last = place_at(paths, body, t_end[body])
    ends.rotation[body] = first.rotation
    ends.position[body] = first.position
    ends.turning[body] = first.turning
    ends.last_rotation[body] = last.rotation
    ends.last_position[body] = last.position


@wp.kernel
def place_vertices(
    begin: int,
    # in
    t_begin: wp.array[wp.float64],  # of each body
    t_end: wp.array[wp.float64],
    vertex_body: wp.array[wp.int32],
    paths: BodyPaths,
    of_bodies: BodyEnds,
    vertices_t0: wp.array[vec3d],  # of a body on a path in its own frame
    vertices_t1: wp.array[vec3d],
    radius: wp.array[wp.float64],  # empty where there is none
    box_radius: wp.array[wp.float64],
    # out
    at_begin: wp.array[vec3d],
    at_end: wp.array[vec3d],
    velocity: wp.array[vec3d],
    slack: wp.array[wp.float64],
    grown_radius: wp.array[wp.float64],
    grown_box_radius: wp.array[wp.float64],
):
    """Place the vertices at both ends of a slice, with the velocity that turns and radii that hold their arcs."""
    i = begin + wp.tid()
    body = vertex_body[i]
    begins = t_begin[body]
    ends = t_end[body]
    x = vertices_t0[i]
    a = x
    b = vertices_t1[i]
    v = vec3d()
    bulge = _ZERO
    error = _ZERO
    excess = _ZERO
    if paths.is_rigid[body] != 0:
        arm = x - paths.pivot[body]
        from_pivot = rotated(of_bodies.rotation[body], arm)
        a = of_bodies.position[body] + from_pivot
        b = of_bodies.last_position[body] + rotated(of_bodies.last_rotation[body], arm)
        length = ends - begins
        omega = length * paths.omega[body]
        v = wp.cross(omega, from_pivot) + length * of_bodies.turning[body]
        bulge = _EIGHTH_UP * wp.length(omega) * wp.sqrt(wp.dot(v, v) + _SQUARE_UNDERFLOW)
        error = slack_of(paths, body, arm, x)
        excess = paths.excess[body]
    else:
        error = _INTERPOLATION * wp.max(wp.max(wp.abs(x)), wp.max(wp.abs(b)))
        if not (x == b):  # what stays is not moved by rounding
            if begins > _ZERO:
                a = (_ONE - begins) * x + begins * vertices_t1[i]
            if ends < _ONE:
                b = (_ONE - ends) * x + ends * vertices_t1[i]
    error += _UNDERFLOW
    bulge += error + excess
    slack[i] = error
    at_begin[i] = a
    at_end[i] = b
    velocity[i] = v
    r = bulge
    box_r = bulge
    if radius.shape[0] > 0:
        r += radius[i]
        box_r += box_radius[i]
    grown_radius[i] = _SUM_UP * r
    grown_box_radius[i] = _SUM_UP * box_r
