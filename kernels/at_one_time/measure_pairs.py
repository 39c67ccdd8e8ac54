"""The kernel that takes the place of the narrow phase at one time: it measures pairs, and a sink takes what is found.

With the sink `NEAR` the pairs within the distance are listed, and with `DISPLACEMENT` the bounds of the vertices of all
are lowered (`proximity`); with `START_DISTANCE` those of the vertices of pairs within the distance
(`pair.start_distance`), which are all that is asked for in the maximum norm.
"""

import warp as wp

from ..boxes.thickness import distance_of
from ..interrupts import is_stopped
from ..narrow_phase.sinks import DISPLACEMENT, NEAR, START_DISTANCE
from ..pair.norm import is_ball
from ..pair.single_points import points_of
from ..pair_kind import EDGE_EDGE, POINT_POINT
from ..parameters import norm
from ..step.minima import Minima
from ..step.pair_list import PairList, num_found, vertices_of_pair
from .box_distance import box_distance
from .pair_distance import PairDistance, measured
from .proximity import ProximityList, Reach, bound_pair, lower_bounds, record_proximity

_ZERO = wp.constant(wp.float64(0.0))

is_euclidean = is_ball(norm)
module = wp.get_module(f"ccd_warp.measure_pairs.{'ball' if is_euclidean else 'box'}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)


@wp.func
def lower_start_distances(kind: int, a: wp.vec3i, b: wp.vec3i, least: wp.float64, minima: Minima):
    """Lower those of the vertices of a pair at least ``least`` apart; to 0 by a coordinate that is not finite."""
    bits = wp.int64(0)
    if least > _ZERO:
        bits = wp.cast(least, wp.int64)
    lower_bounds(a, bits, minima)
    if kind == EDGE_EDGE or kind == POINT_POINT:
        lower_bounds(b, bits, minima)


@wp.kernel(module=module)
def measure_pairs(
    begin: int,
    # in
    num_solvers: int,
    chunk: int,
    sink: int,
    pairs: PairList,
    reach: Reach,
    body_static: wp.array[wp.int32],  # for `DISPLACEMENT`
    # out
    minima: Minima,
    proximities: ProximityList,  # for `NEAR`
):
    """Measure the pairs of a solver, which are every ``num_solvers``-th chunk, at the start."""
    kind = pairs.kind
    count = wp.int32(num_found(pairs))
    first = (begin + wp.tid()) * chunk
    while first < count:
        if is_stopped(reach.stop):
            return
        for k in range(first, wp.min(first + chunk, count)):
            vertices = vertices_of_pair(pairs, k)
            a = vertices.first
            b = vertices.second
            p = points_of(kind, a, b, pairs.vertices_t0)
            pair_distance = PairDistance()
            if wp.static(is_euclidean):
                pair_distance = measured(kind, p, sink != NEAR)
            else:
                pair_distance.least = box_distance(kind, p)
            least = pair_distance.least
            if sink == DISPLACEMENT:
                if not (least >= _ZERO):
                    least = _ZERO  # a coordinate that is not finite
                bound_pair(a, b, least, distance_of(reach.kept, reach.radius, a, b), body_static, minima)
            else:
                distance = distance_of(reach.distance, reach.radius, a, b)
                if sink == START_DISTANCE and not (least > distance):
                    lower_start_distances(kind, a, b, least, minima)
                if sink == NEAR and least <= distance:  # a NaN is not
                    record_proximity(kind, vertices.pair, a[0], pair_distance, minima, proximities)
        if first > 2147483647 - num_solvers * chunk:
            return
        first += num_solvers * chunk
