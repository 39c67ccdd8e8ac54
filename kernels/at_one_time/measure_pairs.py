"""The kernel that takes the place of the narrow phase at one time: it measures pairs, and a sink takes what is found.

With the sink `NEAR` the pairs within the distance are listed, and with `DISPLACEMENT` the bounds of the vertices of all
are lowered (`proximity`); with `START_DISTANCE` the start distances of the vertices of pairs within the distance
(`pair.start_distance`), which are all that is asked for in the maximum norm.

Euclidean distances are measured in lanes, a pair in each; what follows is done pair by pair.
"""

import warp as wp

from ..atomics import atomic_min_int64, claim_int
from ..boxes.lanes import lowest_bit, number_of_bits
from ..boxes.thickness import add_rounded_up, distance_of, radius_of
from ..interrupts import is_stopped
from ..narrow_phase.lane_rows import points_of_vertices, rows_from, vertices_of_pairs
from ..narrow_phase.sinks import DISPLACEMENT, NEAR, START_DISTANCE
from ..pair.norm import is_ball
from ..pair.simd import build_options, fingerprint
from ..pair.single_points import points_of
from ..pair.start_distance import share_of
from ..pair_kind import EDGE_EDGE, POINT_POINT
from ..parameters import norm, width
from ..step.minima import Minima
from ..step.pair_list import PairList, num_found, vertices_of_pair
from ..template import specialised
from .box_distance import box_distance
from .pair_distance import PairDistance, measured
from .proximity import Proximity, ProximityList, Reach, bound_pair, record_proximity

_ZERO = wp.constant(wp.float64(0.0))
_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))

is_euclidean = is_ball(norm)
simd = specialised("pair.simd", width=width)
lanes = wp.constant(width)
of_width = f".{width}.{fingerprint()}" if is_euclidean else ""
module = wp.get_module(f"ccd_warp.measure_pairs.{'ball' if is_euclidean else 'box'}{of_width}")
options = {"enable_backward": False, "fuse_fp": False, "max_unroll": 1, "extra_build_options": build_options}
wp.set_module_options(options, module=module)


@wp.func
def lower_start_distances(
    kind: int, a: wp.vec3i, b: wp.vec3i, least: wp.float64, distance: wp.float64, start_distances: wp.array[wp.int64]
):
    """Lower those of the vertices of a pair at least ``least`` apart; to 0 by a coordinate that is not finite."""
    share = wp.int64(0)
    length = wp.int64(0)
    if least >= _ZERO:
        share = wp.cast(share_of(least, distance), wp.int64)
        length = wp.cast(wp.abs(least), wp.int64)
    is_of_edges = kind == EDGE_EDGE or kind == POINT_POINT
    for k in range(3):
        if k > 0 and not is_of_edges:
            return  # a vertex, which repeats
        atomic_min_int64(start_distances, 2 * a[k], share)
        atomic_min_int64(start_distances, 2 * a[k] + 1, length)
        if is_of_edges:
            atomic_min_int64(start_distances, 2 * b[k], share)
            atomic_min_int64(start_distances, 2 * b[k] + 1, length)


@wp.func
def of_lane(distances: PairDistance, lane: int) -> Proximity:
    """What is listed of the pair in a lane."""
    r = Proximity()
    r.parameters = wp.vec2d(simd.lane_of(distances.u, lane), simd.lane_of(distances.v, lane))
    r.distance = simd.lane_of(distances.distance, lane)
    d = distances.direction
    r.direction = wp.vec3d(simd.lane_of(d.x, lane), simd.lane_of(d.y, lane), simd.lane_of(d.z, lane))
    r.features = wp.int32(simd.lane_of(distances.features, lane))
    return r


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
    start_distances: wp.array[wp.int64],  # for `START_DISTANCE`: the bits of share and length of each vertex
):
    """Measure the pairs of a solver, which are every ``num_solvers``-th chunk, at the start."""
    kind = pairs.kind
    count = wp.int32(num_found(pairs))
    first = (begin + wp.tid()) * chunk
    while first < count:
        if is_stopped(reach.stop):
            return
        end = wp.min(first + chunk, count)
        block = wp.int32(first)
        while block < end:
            num = wp.min(lanes, end - block)
            distances = PairDistance()
            place = int(0)  # in the list
            if wp.static(is_euclidean):
                i = vertices_of_pairs(pairs, rows_from(block, num))
                distances = measured(kind, points_of_vertices(pairs.vertices_t0, i.i0, i.i1, i.i2, i.i3), sink != NEAR)
            left = (_ONE << wp.uint32(num)) - _ONE
            if wp.static(is_euclidean):
                # of pairs without radii those beyond the distance are left out at once, in the list a NaN as well
                if sink == NEAR and reach.radius.shape[0] == 0:
                    left = left & simd.bits_of(simd.is_at_most(distances.least, reach.distance))
                    if left != _NONE:
                        place = claim_int(proximities.count, 0, number_of_bits(left))
                elif sink == START_DISTANCE and reach.radius.shape[0] == 0:
                    left = left & ~simd.bits_of(simd.is_less(reach.distance, distances.least))
            while left != _NONE:
                lane = lowest_bit(left)
                left = left & (left - _ONE)
                vertices = vertices_of_pair(pairs, block + lane)
                a = vertices.first
                b = vertices.second
                least = _ZERO
                if wp.static(is_euclidean):
                    least = simd.lane_of(distances.least, lane)
                else:
                    least = box_distance(kind, points_of(kind, a, b, pairs.vertices_t0))
                if sink == DISPLACEMENT:
                    if not (least >= _ZERO):
                        least = _ZERO  # a coordinate that is not finite
                    bound_pair(a, b, least, distance_of(reach.kept, reach.radius, a, b), body_static, minima)
                elif sink == START_DISTANCE:
                    thickness = add_rounded_up(radius_of(reach.radius, a), radius_of(reach.radius, b))
                    if not (least > add_rounded_up(reach.distance, thickness)):
                        kept = add_rounded_up(reach.kept, thickness)
                        lower_start_distances(kind, a, b, least, kept, start_distances)
                else:
                    if reach.radius.shape[0] > 0:
                        if not (least <= distance_of(reach.distance, reach.radius, a, b)):
                            continue
                        place = claim_int(proximities.count, 0, 1)
                    record_proximity(place, kind, vertices.pair, a[0], of_lane(distances, lane), minima, proximities)
                    place += 1
            block += lanes
        if first > 2147483647 - num_solvers * chunk:
            return
        first += num_solvers * chunk
