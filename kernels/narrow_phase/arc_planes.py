"""When a vertex on an arc meets the plane of a half-space: `planes`, on the chords of `windows`.

What is added to the distance is the sagitta along the normal n: the acceleration along it is at most |V|·|ω×n|. So a
body that turns about the normal, as what spins on the ground does, has straight motion toward the plane.
"""

import warp as wp

from ..pair.arcs import bend, point_at
from ..pair.rounding import ARC_MOTION, ARC_POINTS, SAGITTA, SQUARE_UNDERFLOW, UNIT_ROUNDOFF
from ..pair.turns import Turns
from ..pair.windows import Window, in_step, next_window, reached
from .planes import Meeting, PlaneQuery, Planes, meeting_of

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# Windows of a vertex; where they do not suffice, it counts as touching at the time that it has reached.
_MOST_WINDOWS = wp.constant(1000)
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
_EIGHTH_UP = wp.constant(wp.float64(0.125 * (1.0 + SAGITTA * UNIT_ROUNDOFF[wp.float64])))
# Of a coordinate, on all axes together.
_ERROR = wp.constant(wp.float64(2.0 * ARC_POINTS * UNIT_ROUNDOFF[wp.float64]))
_MOTION_ERROR = wp.constant(wp.float64(2.0 * ARC_MOTION * UNIT_ROUNDOFF[wp.float64]))
# The unit normal is rounded, by less than this; so a product with it may be off by as much of the whole vector.
_UNIT = wp.constant(wp.float64(16.0 * UNIT_ROUNDOFF[wp.float64]))
_SQUARE = wp.constant(wp.float64(SQUARE_UNDERFLOW[wp.float64]))


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
) -> Meeting:
    """`meeting_of` for a vertex that turns with its body in a slice, at a time of the step."""
    spin = turns.t_length * turns.omega[turns.vertex_body[v]]
    velocity = turns.velocity[v]
    size = wp.max(wp.max(wp.abs(x0)), wp.max(wp.abs(x1)))
    size = wp.max(size, wp.max(wp.max(wp.abs(p0)), wp.max(wp.abs(p1))))
    motion = wp.max(wp.max(wp.abs(x1 - x0)), wp.max(wp.max(wp.abs(p1 - p0)), wp.max(wp.abs(velocity))))
    error = turns.slack[v] + (_ERROR * size + _MOTION_ERROR * motion)
    if planes.vertex.shape[0] > 0 and planes.vertex[k] >= 0:  # the point of one that moves is rounded between slices
        error += turns.slack[planes.vertex[k]]
    along = wp.length(wp.cross(spin, planes.unit[k])) + _UNIT * wp.length(spin)
    amplitude = wp.sqrt(wp.dot(velocity, velocity) + _SQUARE) * along
    if not along > _ZERO:
        amplitude = _ZERO
    query.t_max = _ONE
    query.holds = 0
    query.start_gap_fraction = _ZERO
    window = Window()
    window.h = _ONE
    meeting = Meeting()
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
        meeting = meeting_of(a, b, p_a, p_b, radius + (bulge + error), planes, k, query)
        windows += 1
        is_free = meeting.toi > _ONE
        t = reached(window, end, is_free, wp.where(is_free, _ONE, meeting.toi))
        is_open = wp.where(is_free, end < _ONE, bulge > error) and windows < _MOST_WINDOWS
        if not is_open and (not is_free or end < _ONE):
            meeting.toi = in_step(t, turns)
            meeting.gap += _TWO * (bulge + error)
        window = next_window(window, t, is_free)
    return meeting
