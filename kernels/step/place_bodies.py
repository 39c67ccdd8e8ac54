"""Where bodies that turn are at both ends of a slice of the step, and how their vertices turn in it.

A body turns by ω in the whole step, R at its start, about a point c of its own frame, which is at p then and moves on
by v; u is what turns with the body of the velocity of that point (of a screw, whose axis is elsewhere):

    x(t) = p + v·t + σ1(t)·u + σ2(t)·ω×u + Rot(tω)·R·(X − c),   σ1(t) = sin(θt)/θ,   σ2(t) = (1 − cos(θt))/θ².

With s = sin(θt/2)/θ these are σ1 = 2s·cos(θt/2) and σ2 = 2s². The rounding is step 18 of `rounding`.
"""

import warp as wp

from ..pair.rounding import INTERPOLATION, PLACE, PLACE_POSITION, RELATIVE, SAGITTA, UNIT_ROUNDOFF

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

vec3d = wp.vec3d
_ZERO = wp.constant(wp.float64(0.0))
_HALF = wp.constant(wp.float64(0.5))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
# A turn whose square may underflow, as far as sine and cosine go none.
_NO_TURN = wp.constant(wp.float64(1.0e-100))
# The sagitta of the whole slice is an eighth of |ω|·|V|.
_EIGHTH_UP = wp.constant(wp.float64(0.125 * (1.0 + SAGITTA * UNIT_ROUNDOFF[wp.float64])))
_SUM_UP = wp.constant(wp.float64(1.0 + RELATIVE * UNIT_ROUNDOFF[wp.float64]))
_PLACE_POSITION = wp.constant(wp.float64(PLACE_POSITION * UNIT_ROUNDOFF[wp.float64]))
_PLACE = wp.constant(wp.float64(PLACE * UNIT_ROUNDOFF[wp.float64]))
# Of the length of a vector: of each of its coordinates, on three axes.
_INTERPOLATION = wp.constant(wp.float64(2.0 * INTERPOLATION * UNIT_ROUNDOFF[wp.float64]))
_SQUARE_UNDERFLOW = wp.constant(wp.float64(2.0**-1000))


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
class Place:
    """A body at one time."""

    rotation: wp.vec4d
    position: vec3d  # of its pivot
    turning: vec3d


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
def place_at(paths: BodyPaths, body: int, t: wp.float64) -> Place:
    """Where a body is at a time of the step."""
    omega = paths.omega[body]
    turning = paths.turning[body]
    angle = wp.length(omega)
    s = _HALF * t
    c = _ONE
    if angle > _NO_TURN:
        s = wp.sin(_HALF * t * angle) / angle
        c = wp.cos(_HALF * t * angle)
    turn = wp.vec4d(s * omega[0], s * omega[1], s * omega[2], c)
    place = Place()
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
    return _PLACE_POSITION * far + _PLACE * (_ONE + _HALF * wp.length(paths.omega[body])) * reach


@wp.kernel
def place_vertices(
    begin: int,
    # in
    t_begin: wp.float64,
    t_end: wp.float64,
    vertex_body: wp.array[wp.int32],
    paths: BodyPaths,
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
    x = vertices_t0[i]
    a = x
    b = vertices_t1[i]
    v = vec3d()
    bulge = _ZERO
    error = _ZERO
    if paths.is_rigid[body] != 0:
        first = place_at(paths, body, t_begin)
        last = place_at(paths, body, t_end)
        arm = x - paths.pivot[body]
        from_pivot = rotated(first.rotation, arm)
        a = first.position + from_pivot
        b = last.position + rotated(last.rotation, arm)
        length = t_end - t_begin
        omega = length * paths.omega[body]
        v = wp.cross(omega, from_pivot) + length * first.turning
        bulge = _EIGHTH_UP * wp.length(omega) * wp.sqrt(wp.dot(v, v) + _SQUARE_UNDERFLOW)
        error = slack_of(paths, body, arm, x) + paths.excess[body]
    else:
        error = _INTERPOLATION * wp.max(wp.max(wp.abs(x)), wp.max(wp.abs(b)))
        if t_begin > _ZERO:
            a = (_ONE - t_begin) * x + t_begin * vertices_t1[i]
        if t_end < _ONE:
            b = (_ONE - t_end) * x + t_end * vertices_t1[i]
    bulge += error
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
