"""When a vertex on an arc meets the plane of a half-space: `planes`, on the chords of `windows`.

What is added to the distance is the sagitta along the normal n: the acceleration along it is at most |V|·|ω×n|. So a
body that turns about the normal, as what spins on the ground does, has straight motion toward the plane.

With ``keeps_start_distance`` a vertex that starts within its distance keeps what it had, as on straight paths, but
slice by slice: what it has at the begin of a slice is no less than what it kept before. In the solid it may leave, and
go no deeper.
"""

import warp as wp

from ..pair.arcs import bend, point_at
from ..pair.rounding import ARC_MOTION, ARC_POINTS, EIGHTH_UP, SQUARE_UNDERFLOW, START_DISTANCE_ERRORS, UNIT_ROUNDOFF
from ..pair.turns import Turns
from ..pair.windows import Window, in_step, next_window, reached
from .planes import PlaneMeeting, PlaneQuery, Planes, largest_coordinate, length_of_normal, meeting_of

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# Windows of a vertex; where they do not suffice, it counts as touching at the time that it has reached.
_MOST_WINDOWS = wp.constant(1000)
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
_EIGHTH_UP = wp.constant(wp.float64(EIGHTH_UP))
_SHARE_UP = wp.constant(wp.float64(1.0 + 8.0 * UNIT_ROUNDOFF[wp.float64]))
# Of a coordinate, on all axes together: five roundings, 8.7u; what is above 8u is far below the slack.
_ERROR = wp.constant(wp.float64(2.0 * ARC_POINTS * UNIT_ROUNDOFF[wp.float64]))
_MOTION_ERROR = wp.constant(wp.float64(2.0 * ARC_MOTION * UNIT_ROUNDOFF[wp.float64]))
# The unit normal is rounded, by less than this; so a product with it may be off by as much of the whole vector.
_UNIT = wp.constant(wp.float64(16.0 * UNIT_ROUNDOFF[wp.float64]))
# A start distance is less by these multiples of its own rounding, and of that of the arc.
_START_DISTANCE_VALUE = wp.constant(wp.float64(64.0 * UNIT_ROUNDOFF[wp.float64]))
_START_DISTANCE_ERRORS = wp.constant(wp.float64(START_DISTANCE_ERRORS))
_SQUARE = wp.constant(wp.float64(SQUARE_UNDERFLOW[wp.float64]))


@wp.func
def start_distance(
    x: wp.vec3d, p: wp.vec3d, radius: wp.float64, error: wp.float64, planes: Planes, k: int, query: PlaneQuery
) -> wp.float64:
    """What a vertex keeps that starts the slice within its distance, and parts and slides; below 0 in the solid.

    It is its distance there, less what rounding may take; a slide does not lose it. Of other vertices it is all of the
    distance that is asked for.
    """
    d = x - p
    n = planes.normal[k]
    size = length_of_normal(planes, k, query)
    a = n[0] * d[0]
    b = n[1] * d[1]
    c = n[2] * d[2]
    margin = _START_DISTANCE_VALUE * (wp.abs(a) + wp.abs(b) + wp.abs(c)) + _START_DISTANCE_ERRORS * error * size
    kept = (a + b + c - margin) / size
    if kept < query.distance + radius:
        return kept
    return query.distance + radius


@wp.func
def meeting_on_arc(
    v: int,
    x0: wp.vec3d,
    x1: wp.vec3d,
    p0: wp.vec3d,
    p1: wp.vec3d,
    radius: wp.float64,
    planes: Planes,
    k: int,
    query: PlaneQuery,
    turns: Turns,
) -> PlaneMeeting:
    """`meeting_of` for a vertex that turns with its body in a slice, at a time of the step."""
    body = turns.vertex_body[v]
    t_begin = turns.t_begin[body]
    t_length = turns.t_end[body] - t_begin
    spin = t_length * turns.omega[body]
    velocity = turns.velocity[v]
    size = largest_coordinate(x0, x1, p0, p1)
    motion = wp.max(wp.max(wp.abs(x1 - x0)), wp.max(wp.max(wp.abs(p1 - p0)), wp.max(wp.abs(velocity))))
    error = turns.slack[v] + (_ERROR * size + _MOTION_ERROR * motion)
    excess = turns.excess[body]
    if planes.vertex.shape[0] > 0 and planes.vertex[k] >= 0:  # the point of one that moves is rounded between slices
        error += turns.slack[planes.vertex[k]]
        excess += turns.excess[planes.body[k]]
    along = wp.length(wp.cross(spin, planes.unit[k])) + _UNIT * wp.length(spin)
    amplitude = wp.sqrt(wp.dot(velocity, velocity) + _SQUARE) * along
    if not along > _ZERO:
        amplitude = _ZERO
    share = _ONE  # of a length along the normal in one of the norm of the distance
    if query.is_euclidean == 0:
        share = planes.length[k] / length_of_normal(planes, k, query) * _SHARE_UP
    is_inside = bool(False)
    if query.keeps_start_distance != 0:
        at_start = start_distance(x0, p0, radius, error + excess, planes, k, query)
        if at_start < query.distance + radius:
            is_inside = at_start < _ZERO
            query.distance = at_start
            radius = _ZERO
    query.t_max = _ONE
    query.keeps_start_distance = 0
    query.start_gap_fraction = _ZERO
    window = Window()
    window.h = _ONE
    meeting = PlaneMeeting()
    windows = int(0)
    is_open = bool(True)
    while is_open:
        end = wp.min(window.begin + window.h, _ONE)
        window.h = end - window.begin
        a = point_at(x0, x1, velocity, spin, bend(spin, window.begin), window.begin)
        b = point_at(x0, x1, velocity, spin, bend(spin, end), end)
        bulge = _EIGHTH_UP * window.h * window.h * amplitude
        p_a = p0 + window.begin * (p1 - p0)
        p_b = p0 + end * (p1 - p0)
        off = bulge + (error + excess)
        meeting = meeting_of(a, b, p_a, p_b, radius + share * off, planes, k, query)
        windows += 1
        is_free = meeting.toi > _ONE
        t = reached(window, end, is_free, wp.where(is_free, _ONE, meeting.toi))
        is_open = wp.where(is_free, end < _ONE, bulge > error) and windows < _MOST_WINDOWS
        if not is_open and (not is_free or end < _ONE):
            meeting.toi = wp.where(is_inside, t_begin, in_step(t, t_begin, t_length))
            meeting.gap += _TWO * off
        window = next_window(window, t, is_free)
    return meeting
