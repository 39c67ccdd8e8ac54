"""Narrow phase: the kernel that finds the earliest time of impact of many pairs.

Pairs are taken up ``width`` at a time, one in each lane (`lane_solver`), a thread one after another; the few that the
lanes leave open go on to the solver for single pairs (`solver`) at the time that they have reached. Where the
pairs come from and where the outcomes go (`sinks`) is an argument, so that the solver is compiled once for all calls.
"""

import warp as wp

from ..atomics import atomic_min_int64, claim
from ..boxes.lanes import lowest_bit
from ..interrupts import is_stopped
from ..pair.lane_solver import LaneAnswer, first_rounds, later_rounds
from ..pair.norm import MAXIMUM_NORM, has_arcs, is_by_pair
from ..pair.pair_options import options_of_pair, options_of_rows, row_in
from ..pair.points import Points
from ..pair.query import Options
from ..pair.simd import fingerprint
from ..pair.single_points import is_stationary, points_of, row_points
from ..pair.status import STATUS_COLLISION, STATUS_INITIAL_CONTACT, STATUS_ITERATION_LIMIT, STATUS_NO_COLLISION
from ..pair.turns import turns_anywhere
from ..pair_key import pair_of
from ..parameters import norm, real, width
from ..step.minima import ANY_OPEN, FOUND, OPEN, Minima
from ..step.step import ContactList
from ..template import specialised
from . import lane_rows
from .lane_rows import Index, numbers_of, points_of_pairs, points_of_rows, put, put_vec2, rows_from, rows_of
from .pair_outcome import (
    cap_of_round,
    finished,
    finished_lanes,
    is_set,
    outcome_of,
    record_contact,
    rest_of,
    skips_first_rounds,
    solve_on_arcs,
)
from .sinks import BOUND, TABLE, Table

# Pairs of a table that are taken as one, where there are several lanes.
PAIRS_OF_AN_ITEM = 64
_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))

vec3d = wp.vec3d


has_own = is_by_pair(norm)
on_arcs = has_arcs(norm)
if on_arcs:
    from ..pair.lane_windows import first_window, later_windows
    from .lane_rows import arcs_of_pairs
unbounded = wp.constant(wp.float64(float("inf")))
Outcome = specialised("pair.solver", real=real, norm=norm).Outcome
simd64 = specialised("pair.simd", width=width)
none = wp.constant(wp.float64(int(STATUS_NO_COLLISION)))
within = wp.constant(wp.float64(int(STATUS_COLLISION)))
at_start = wp.constant(wp.float64(int(STATUS_INITIAL_CONTACT)))
lanes = wp.constant(width)
chunk_of_table = PAIRS_OF_AN_ITEM if width > 1 else 1


@wp.struct
class Pending:
    """Pairs that the first rounds have left open, until there are enough of them for all lanes."""

    count: int
    rows: lane_rows.Rows
    t: lane_rows.Numbers  # they are free on [0, t)
    used: lane_rows.Numbers  # iterations so far


@wp.func
def first_lanes(count: int) -> wp.uint32:
    """Bits of the first ``count`` lanes."""
    return (_ONE << wp.uint32(count)) - _ONE


@simd64.func
def write(rows: Index, count: int, answer: LaneAnswer, t_max: wp.float64, table: Table):
    """Write `outcome_of` of the first lanes, all at once."""
    nothing = simd64.spread(wp.float64(0.0))
    hit = simd64.mask_of(answer.contact) & simd64.is_at_most(answer.t, t_max)
    how = simd64.select(simd64.is_at_most(answer.t, nothing), simd64.spread(at_start), simd64.spread(within))
    put(table.toi, rows, simd64.select(hit, answer.t, unbounded), count)
    put(table.status, rows, simd64.select(hit, how, none), count)
    u = simd64.select(hit, answer.u, nothing)
    put_vec2(table.parameters, rows, u, simd64.select(hit, answer.v, nothing), count)
    put(table.gap, rows, simd64.select(hit, answer.gap, nothing), count)
    put(table.width, rows, nothing, count)
    put(table.iterations, rows, answer.iterations, count)


@wp.func
def write_row(i: int, outcome: Outcome, table: Table):
    """Write the result of a pair."""
    table.toi[i] = outcome.toi
    table.status[i] = outcome.status
    table.parameters[i] = outcome.parameters
    table.gap[i] = outcome.gap
    table.width[i] = outcome.width
    table.iterations[i] = outcome.iterations


@wp.func
def next_block(k: wp.int64, chunk: int, num_solvers: int) -> wp.int64:
    """The block that a solver takes after that of pair k: the next of its chunk, or the first of its next chunk.

    A chunk is one pair or a multiple of the lanes.
    """
    following = k + wp.int64(wp.min(lanes, chunk))
    if following % wp.int64(chunk) == wp.int64(0):
        following += wp.int64(num_solvers - 1) * wp.int64(chunk)
    return following


# a Warp module for each precision, number of lanes and norm
of_norm = "" if norm == MAXIMUM_NORM else f".{norm}"
module = wp.get_module(f"ccd_warp.solve_pairs.{real.__name__}.{width}{of_norm}.{fingerprint()}")
wp.set_module_options({"enable_backward": False, "fuse_fp": False, "max_unroll": 1}, module=module)


@wp.kernel(module=module)
def solve_pairs(
    begin: int,
    # in
    num_solvers: int,
    chunk: int,
    kind: int,
    sink: int,
    counts: wp.array2d[wp.int64],
    pairs: wp.array[wp.int64],
    first_corners: wp.array[wp.vec3i],
    second_corners: wp.array[wp.vec3i],
    vertices_t0: wp.array[vec3d],
    vertices_t1: wp.array[vec3d],
    options: Options,
    is_second: int,  # 1: the second round, of the pairs that the first has marked as open
    only_moving: int,  # 1: a stationary pair is not solved, so it may touch
    gaps_moved: wp.float64,  # above 0: a toi near 0 is raised to the time in which the pair moves by this many gaps
    num_rows: int,  # of the table
    # out
    table: Table,
    minima: Minima,
    contacts: ContactList,
    least_bits: wp.array[wp.int64],
    open_toi: wp.array[wp.float64],
):
    """Solve the pairs of a solver, which are every ``num_solvers``-th chunk.

    With the sink `TABLE` these are the rows of the table, and the result of each is written there. With `CONTACTS` they
    are keys; the minima are lowered, the contacts listed. The first round marks each pair that it leaves open by the
    complement of its key.

    With `BOUND` the least toi alone is lowered; that of a pair left open is written beside its key. A pair is left out
    as soon as it is free up to the least toi found so far, which it then cannot lower; so the least toi does not depend
    on the order of the pairs. As integers, the bits of two non-negative numbers compare as the numbers do.
    """
    count = wp.int64(num_rows)
    cap = options.max_iterations
    if sink != TABLE:
        count = wp.min(counts[kind, FOUND], wp.int64(pairs.shape[0]))
        cap = cap_of_round(options, is_second, counts[kind, OPEN])
        if cap == 0:
            return
    following = wp.int64(begin + wp.tid()) * wp.int64(chunk)
    skips_first = skips_first_rounds(options)
    pending = Pending()
    while following < count or pending.count > 0:
        if is_stopped(options.stop):
            return
        is_packed = pending.count >= lanes or following >= count
        block = wp.min(wp.min(lanes, chunk), wp.int32(count - following))
        rows = rows_from(wp.int32(following), block)
        if is_packed:
            block = wp.min(lanes, pending.count)
            pending.count -= block
            rows = rows_of(pending.rows, pending.count, block)
        else:
            k = wp.int32(following)
            following = next_block(following, chunk, num_solvers)
            if is_second != 0:
                if pairs[k] >= wp.int64(0):
                    continue  # in the second round a block is one pair, and this one is not open
        least = unbounded
        if sink == BOUND:
            if least_bits[0] == wp.int64(0):
                return  # no toi is less
            least = wp.cast(least_bits[0], wp.float64)
        points_a = Points()
        points_b = Points()
        if sink == TABLE:
            points_a = points_of_rows(table.points_t0, rows)
            points_b = points_of_rows(table.points_t1, rows)
        else:
            points_a, points_b = points_of_pairs(
                kind, pairs, rows, first_corners, second_corners, vertices_t0, vertices_t1
            )
        answer = LaneAnswer()
        is_later = is_packed or skips_first
        if is_later:
            t = simd64.spread(wp.float64(0.0))
            used = t
            if is_packed:
                t = numbers_of(pending.t, pending.count, block)
                used = numbers_of(pending.used, pending.count, block)
            open = first_lanes(block)
            own = options_of_rows(options, pairs, rows, first_corners, second_corners)
            if wp.static(on_arcs):
                own.arcs = arcs_of_pairs(kind, pairs, rows, first_corners, second_corners, options.turns)
                answer = later_windows(kind, points_a, points_b, own, options, open, t, used, cap, least)
            else:
                answer = later_rounds(kind, points_a, points_b, own, open, t, used, cap, least)
        elif wp.static(on_arcs):
            own = options_of_rows(options, pairs, rows, first_corners, second_corners)
            own.arcs = arcs_of_pairs(kind, pairs, rows, first_corners, second_corners, options.turns)
            t = simd64.spread(options.turns.t_begin)
            answer = first_window(kind, points_a, points_b, own, options, t, cap, least)
        elif wp.static(not has_own):
            answer = first_rounds(kind, points_a, points_b, options, cap, least)
        settled = answer.free
        if sink == TABLE:
            # what is written of the lanes that are left is overwritten
            write(rows, block, answer, options.t_max, table)
            settled = finished_lanes(answer, options)
        left = first_lanes(block) & ~settled
        while left != _NONE:
            lane = lowest_bit(left)
            left = left & (left - _ONE)
            t_reached = simd64.lane_of(answer.t, lane)
            if sink == BOUND:
                # a pair that is free up to the least toi cannot lower it
                if wp.cast(t_reached, wp.int64) >= least_bits[0]:
                    continue
            k = row_in(rows, lane)
            is_contact = is_set(answer.contact, lane)
            if not is_later and not is_contact:
                pending.rows[pending.count] = k
                pending.t[pending.count] = t_reached
                pending.used[pending.count] = simd64.lane_of(answer.iterations, lane)
                pending.count += 1
                continue
            outcome = outcome_of(answer, lane, options)
            if sink == TABLE:
                a = row_points(table.points_t0, k)
                b = row_points(table.points_t1, k)
                write_row(k, rest_of(outcome, answer, lane, kind, a, b, options, cap), table)
                continue
            key = pairs[k]
            if is_second != 0:
                key = ~key
            pair = pair_of(key)
            first = first_corners[pair[0]]
            second = second_corners[pair[1]]
            if not is_contact or only_moving != 0:
                a = points_of(kind, first, second, vertices_t0)
                b = points_of(kind, first, second, vertices_t1)
                if only_moving != 0:
                    stays = is_stationary(a, b)
                    if wp.static(on_arcs):
                        stays = stays and not (
                            turns_anywhere(first, options.turns) or turns_anywhere(second, options.turns)
                        )
                    if stays:
                        continue
                if not is_contact:
                    so_far = wp.int32(simd64.lane_of(answer.iterations, lane))
                    own_options = options_of_pair(options, first, second)
                    if wp.static(on_arcs):
                        outcome = solve_on_arcs(kind, first, second, t_reached, so_far, a, b, own_options, cap)
                    else:
                        outcome = finished(kind, t_reached, so_far, False, a, b, own_options, cap)
            if outcome.status == STATUS_ITERATION_LIMIT and is_second == 0 and cap < options.max_iterations:
                pairs[k] = ~key
                claim(counts, kind, OPEN, 1)
                claim(counts, 0, ANY_OPEN, 1)
                if sink == BOUND:
                    open_toi[k] = outcome.toi
            elif sink == BOUND:
                atomic_min_int64(least_bits, 0, wp.cast(outcome.toi, wp.int64))
            elif outcome.status != STATUS_NO_COLLISION:
                record_contact(
                    kind,
                    pair,
                    first,
                    second,
                    outcome,
                    vertices_t0,
                    vertices_t1,
                    options,
                    only_moving,
                    gaps_moved,
                    minima,
                    contacts,
                )
