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
from ..pair.simd import build_options, fingerprint
from ..pair.single_points import points_of
from ..pair.start_distance import share_of
from ..pair_kind import EDGE_EDGE, POINT_POINT
from ..parameters import norm, width
from ..step.minima import CONTACTS_OVERFLOW, Minima, flag_world
from ..step.pair_list import PairList, num_found, vertices_of_pair
from ..template import specialised
from .box_distance import box_distance
from .pair_distance import PairDistance, measured
from .proximity import ProximityList, Reach, bound_pair

_ZERO = wp.constant(wp.float64(0.0))
_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))

is_euclidean = norm.is_ball
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


of_lane = "distances.{0}" if width == 1 else "distances.{0}[k]"
direction = ", ".join(of_lane.format(f"direction.{axis}") for axis in "xyz")
next_lane = "0; left = 0" if width == 1 else "__builtin_ctz(left); left &= left - 1"
put_snippet = f"""
    unsigned left = which;
    for (int n = place; left != 0 && n < list.kind.shape[0]; ++n) {{
        const int k = {next_lane};
        const long long written = pairs.keys.data[block + k], key = written < 0 ? ~written : written;
        list.kind.data[n] = pairs.kind;
        list.primitives.data[n] = wp::vec_t<2, wp::int32>((int)(key >> 32), (int)(key & 0xFFFFFFFFLL));
        list.parameters.data[n] = wp::vec_t<2, double>({of_lane.format("u")}, {of_lane.format("v")});
        list.distance.data[n] = {of_lane.format("distance")};
        list.direction.data[n] = {"distances.direction" if width == 1 else f"wp::vec_t<3, double>({direction})"};
        list.features.data[n] = (int){of_lane.format("features")};
    }}
"""


@wp.func_native(put_snippet)
def put(place: int, pairs: PairList, block: int, which: wp.uint32, distances: PairDistance, list: ProximityList):
    """Write the pairs of some lanes of a block from a place on, as many as the list takes."""
    ...


@wp.func
def list_lanes(
    pairs: PairList, block: int, which: wp.uint32, distances: PairDistance, minima: Minima, proximities: ProximityList
):
    """List the pairs of some lanes of a block; if the list is full, flag the worlds of those that are left out."""
    place = claim_int(proximities.count, 0, number_of_bits(which))
    put(place, pairs, block, which, distances, proximities)
    left = which
    listed = proximities.kind.shape[0] - place
    if listed < number_of_bits(which):
        while left != _NONE:
            lane = lowest_bit(left)
            left = left & (left - _ONE)
            if listed <= 0:
                flag_world(minima, vertices_of_pair(pairs, block + lane).first[0], CONTACTS_OVERFLOW)
            listed -= 1


@wp.kernel(module=module, cuda_max_registers=128)
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
            if wp.static(is_euclidean):
                i = vertices_of_pairs(pairs, rows_from(block, num))
                distances = measured(kind, points_of_vertices(pairs.vertices_t0, i.i0, i.i1, i.i2, i.i3), sink != NEAR)
            left = (_ONE << wp.uint32(num)) - _ONE
            if wp.static(is_euclidean):
                # of pairs without radii those beyond the distance are left out at once, in the list a NaN as well
                if sink == NEAR and reach.radius.shape[0] == 0:
                    left = left & simd.bits_of(simd.is_at_most(distances.least, reach.distance))
                    if left != _NONE:
                        list_lanes(pairs, block, left, distances, minima, proximities)
                        left = _NONE
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
                elif least <= distance_of(reach.distance, reach.radius, a, b):
                    list_lanes(pairs, block, _ONE << wp.uint32(lane), distances, minima, proximities)
            block += lanes
        if first > 2147483647 - num_solvers * chunk:
            return
        first += num_solvers * chunk
