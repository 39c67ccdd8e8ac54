"""The kernel that takes the place of the narrow phase at one time: it measures pairs, and a sink takes what is found.

With the sink `NEAR` the pairs within the distance are listed, and with `DISPLACEMENT` the bounds of the vertices of all
are lowered (`proximity`); with `HOLD` the holds of the vertices of those within the distance (`pair.hold`), which are
all that is asked for in the maximum norm.
"""

import warp as wp

from ..atomics import atomic_min_int64
from ..boxes.thickness import distance_of
from ..interrupts import is_stopped
from ..narrow_phase.sinks import DISPLACEMENT, HOLD, NEAR
from ..pair.norm import is_ball
from ..pair.single_points import points_of
from ..pair_key import pair_of
from ..pair_kind import EDGE_EDGE, POINT_POINT
from ..parameters import norm
from ..step.minima import FOUND, Minima
from .box_distance import box_distance
from .pair_distance import PairDistance, measured
from .proximity import ProximityList, Reach, bound_pair, record_proximity

_ZERO = wp.constant(wp.float64(0.0))

is_euclidean = is_ball(norm)
module = wp.get_module(f"ccd_warp.measure_pairs.{'ball' if is_euclidean else 'box'}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)


@wp.func
def lower_hold(corners: wp.vec3i, bits: wp.int64, minima: Minima):
    """Lower the holds of the vertices of a primitive."""
    for k in range(3):
        atomic_min_int64(minima.vertex, corners[k], bits)


@wp.func
def hold_pair(kind: int, a: wp.vec3i, b: wp.vec3i, least: wp.float64, minima: Minima):
    """Lower the holds of a pair that is at least ``least`` apart; a coordinate that is not finite holds at 0."""
    bits = wp.int64(0)
    if least > _ZERO:
        bits = wp.cast(least, wp.int64)
    lower_hold(a, bits, minima)
    if kind == EDGE_EDGE or kind == POINT_POINT:
        lower_hold(b, bits, minima)


@wp.kernel(module=module)
def measure_pairs(
    begin: int,
    # in
    num_solvers: int,
    chunk: int,
    sink: int,
    kind: int,
    counts: wp.array2d[wp.int64],
    pairs: wp.array[wp.int64],
    first_corners: wp.array[wp.vec3i],
    second_corners: wp.array[wp.vec3i],
    x: wp.array[wp.vec3d],
    reach: Reach,
    body_static: wp.array[wp.int32],  # for `DISPLACEMENT`
    # out
    minima: Minima,
    proximities: ProximityList,  # for `NEAR`
):
    """Measure the pairs of a solver, which are every ``num_solvers``-th chunk."""
    count = wp.int32(wp.min(counts[kind, FOUND], wp.int64(pairs.shape[0])))
    first = (begin + wp.tid()) * chunk
    while first < count:
        if is_stopped(reach.stop):
            return
        for k in range(first, wp.min(first + chunk, count)):
            pair = pair_of(pairs[k])
            a = first_corners[pair[0]]
            b = second_corners[pair[1]]
            p = points_of(kind, a, b, x)
            found = PairDistance()
            if wp.static(is_euclidean):
                found = measured(kind, p, sink != NEAR)
            else:
                found.least = box_distance(kind, p)
            least = found.least
            if sink == DISPLACEMENT:
                if not (least >= _ZERO):
                    least = _ZERO  # a coordinate that is not finite
                bound_pair(a, b, least, distance_of(reach.kept, reach.radius, a, b), body_static, minima)
            else:
                distance = distance_of(reach.distance, reach.radius, a, b)
                if sink == HOLD and not (least > distance):
                    hold_pair(kind, a, b, least, minima)
                if sink == NEAR and least <= distance:  # a NaN is not
                    record_proximity(kind, pair, a[0], found, minima, proximities)
        if first > 2147483647 - num_solvers * chunk:
            return
        first += num_solvers * chunk
