"""What is near the planes of half-spaces at one time, and how far vertices may move beside them.

The distance of a vertex is f/|n| with the value f of `planes`, negative in the solid, and its lower bound (f - E)/|n|
with the bound E of the error of f and a length of the normal that is rounded up: a difference, a quotient and a product
round by less than 8u, by which the bound is lowered.
"""

import warp as wp

from ..atomics import atomic_min_int64, claim, claim_int
from ..boxes.thickness import add_rounded_up, radius_of
from ..narrow_phase.meet_planes import is_pair_excluded
from ..narrow_phase.planes import Planes, end_of_planes, first_plane, is_finite, nth_plane, point_of, scale_of, value_of
from ..narrow_phase.sinks import NEAR
from ..pair.rounding import RELATIVE, UNIT_ROUNDOFF
from ..pair_kind import VERTEX_PLANE
from ..step.minima import FOUND, Minima, world_of
from .pair_distance import UNDERFLOW
from .proximity import Proximity, ProximityList, Reach, record_proximity

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_HALF = wp.constant(wp.float64(0.5))
_DOWN = wp.constant(wp.float64(1.0 - RELATIVE * UNIT_ROUNDOFF[wp.float64]))
# The length of a normal is rounded up by this.
_LENGTH_UP = wp.constant(wp.float64(1.0 + RELATIVE * UNIT_ROUNDOFF[wp.float64]))
_LARGEST_FINITE = wp.constant(wp.float64(1.7976931348623157e308))


@wp.func
def plane_distance(x: wp.vec3d, p: wp.vec3d, planes: Planes, k: int):
    """Distance of a point and a half-space with its plane at p, and a bound: no solid is closer than that."""
    s = scale_of(wp.max(wp.max(wp.abs(x)), wp.max(wp.abs(p))))
    lost = planes.lost[k]
    value = value_of(s * x, s * p, planes.normal[k], s >= _ONE and lost == _ZERO, lost)
    r = Proximity()
    r.distance = value.f / planes.length[k] * _LENGTH_UP / s
    least = _ZERO
    if value.f > value.error:
        least = (value.f - value.error) / planes.length[k] * _DOWN / s
        least = wp.max(wp.min(least, _LARGEST_FINITE) - UNDERFLOW, _ZERO)
    r.direction = planes.unit[k]
    r.features = 1
    return r, least


@wp.func
def distance_with(distance: wp.float64, v: int, box_radius: wp.array[wp.float64]) -> wp.float64:
    """A distance plus the radius of the thickest primitive around a vertex, rounded up."""
    return add_rounded_up(distance, radius_of(box_radius, wp.vec3i(v, v, v)))


@wp.kernel
def measure_planes(
    begin: int,
    # in
    sink: int,
    vertices: wp.array[wp.int32],
    vertex_body: wp.array[wp.int32],
    planes: Planes,
    box_radius: wp.array[wp.float64],  # the largest of the primitives around each vertex; empty: there are none
    x: wp.array[wp.vec3d],
    reach: Reach,
    # out
    counts: wp.array2d[wp.int64],
    minima: Minima,
    proximities: ProximityList,
):
    """Take the planes within the distance of a vertex that moves; none of one whose position is not finite.

    With the sink `NEAR` list them; with `DISPLACEMENT` lower the bound of the vertex to what is between them and it,
    less what is to be kept.
    """
    v = vertices[begin + wp.tid()]
    if not is_finite(x[v]):
        return
    world = world_of(minima, v)
    for i in range(first_plane(planes, world), end_of_planes(planes, world)):
        k = nth_plane(planes, i)
        p = point_of(planes, k, x)
        if planes.meets[k, vertex_body[v]] != wp.uint8(0) and is_finite(p):
            proximity, least = plane_distance(x[v], p, planes, k)
            if least <= distance_with(reach.distance, v, box_radius):
                if not is_pair_excluded(v, k, planes.excluded):
                    claim(counts, VERTEX_PLANE, FOUND, 1)
                    if sink == NEAR:
                        n = claim_int(proximities.count, 0, 1)
                        record_proximity(n, VERTEX_PLANE, wp.vec2i(v, k), v, proximity, minima, proximities)
                        continue
                    gap = (least - distance_with(reach.kept, v, box_radius)) * _DOWN - UNDERFLOW
                    if not gap > _ZERO:
                        gap = _ZERO
                    if planes.vertex.shape[0] > 0:
                        point = planes.vertex[k]
                        if point >= 0:  # the plane may move as well: each takes a half
                            gap = wp.max(_HALF * gap - UNDERFLOW, _ZERO)
                            atomic_min_int64(minima.vertex, point, wp.cast(gap, wp.int64))
                    atomic_min_int64(minima.vertex, v, wp.cast(gap, wp.int64))
