"""The rounds that the narrow phase makes of the pairs in its lanes, on straight paths or on arcs, on any device.

The pairs are those of a list, or of a table: then the list has their kind alone, and all pairs have the same options.
"""

import warp as wp

from ..pair.lane_solver import LaneAnswer, first_rounds, later_rounds
from ..pair.pair_options import options_of_rows
from ..pair.points import Points
from ..pair.query import Options
from ..parameters import norm, width
from ..step.pair_list import PairList
from ..template import specialised
from .lane_rows import Index

on_arcs = norm.has_arcs
if on_arcs:
    from ..pair.lane_windows import advance_to_meeting
    from .lane_rows import arcs_of_pairs
simd64 = specialised("pair.simd", width=width)


@wp.func
def answer_of(
    pairs: PairList,
    rows: Index,
    a: Points,
    b: Points,
    options: Options,
    is_first: bool,
    lanes: wp.uint32,
    t: simd64.Lanes,
    used: simd64.Lanes,
    cap: int,
    least: wp.float64,
) -> LaneAnswer:
    """Make the first rounds of the pairs in all lanes, or the later ones of those given.

    The later rounds go on from the times that the pairs have reached after ``used`` iterations each.
    """
    lane_options = options_of_rows(options, pairs, rows)
    if wp.static(on_arcs):
        lane_options.arcs = arcs_of_pairs(pairs, rows, options.turns)
        return advance_to_meeting(pairs.kind, a, b, lane_options, lanes, t, used, is_first, cap, least)
    else:
        if is_first:
            return first_rounds(pairs.kind, a, b, lane_options, cap, least)
        return later_rounds(pairs.kind, a, b, lane_options, lanes, t, used, cap, least)
