"""The rounds that the narrow phase makes of the pairs in its lanes, on straight paths or on arcs, on any device.

The pairs are those of a list, or of a table: then the list has their kind alone, and all pairs have the same options.
"""

import warp as wp

from ..pair.lane_solver import LaneAnswer, first_rounds, later_rounds
from ..pair.norm import has_arcs
from ..pair.pair_options import options_of_rows
from ..pair.points import Points
from ..pair.query import Options
from ..parameters import norm, width
from ..step.pair_list import PairList
from ..template import specialised
from .lane_rows import Index

on_arcs = has_arcs(norm)
if on_arcs:
    from ..pair.lane_windows import first_windows, later_windows
    from .lane_rows import arcs_of_pairs
simd64 = specialised("pair.simd", width=width)


@wp.func
def first_answer(
    pairs: PairList, rows: Index, a: Points, b: Points, options: Options, cap: int, least: wp.float64
) -> LaneAnswer:
    """Make the first rounds of the pairs in all lanes, of which none skips them."""
    lane_options = options_of_rows(options, pairs, rows)
    if wp.static(on_arcs):
        lane_options.arcs = arcs_of_pairs(pairs, rows, options.turns)
        return first_windows(pairs.kind, a, b, lane_options, options, cap, least)
    else:
        return first_rounds(pairs.kind, a, b, lane_options, cap, least)


@wp.func
def later_answer(
    pairs: PairList,
    rows: Index,
    a: Points,
    b: Points,
    options: Options,
    open: wp.uint32,
    t: simd64.Lanes,
    used: simd64.Lanes,
    cap: int,
    least: wp.float64,
) -> LaneAnswer:
    """Make the later rounds of the open lanes, from the times that they have reached after ``used`` iterations each."""
    lane_options = options_of_rows(options, pairs, rows)
    if wp.static(on_arcs):
        lane_options.arcs = arcs_of_pairs(pairs, rows, options.turns)
        return later_windows(pairs.kind, a, b, lane_options, options, open, t, used, cap, least)
    else:
        return later_rounds(pairs.kind, a, b, lane_options, open, t, used, cap, least)
