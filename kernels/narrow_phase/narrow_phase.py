"""Narrow phase: the kernel that finds the earliest time of impact of many pairs.

Pairs are taken up ``width`` at a time, one in each lane (`lane_solver`), a thread one after another; the few that the
lanes leave open go on to the solver for single pairs (`solver`) at the time that they have reached. Where the
pairs come from and where the outcomes go (`sinks`) is an argument, so that the solver is compiled once for all calls.
"""

import warp as wp

from ..boxes.lanes import lowest_bit
from ..interrupts import is_stopped
from ..pair.lane_solver import LaneAnswer
from ..pair.pair_options import row_in
from ..pair.points import Points
from ..pair.query import Options
from ..pair.simd import build_options, fingerprint
from ..pair.single_points import points_of, row_points
from ..pair.status import STATUS_COLLISION, STATUS_INITIAL_CONTACT, STATUS_NO_COLLISION
from ..parameters import norm, real, width
from ..step.minima import Minima
from ..step.pair_list import LeastToi, PairList, Round, num_found, vertices_of_pair
from ..step.step import ContactList
from ..template import specialised
from . import lane_rows
from .lane_answers import answer_of
from .lane_contacts import Unrecorded, ordinary, record_lanes
from .lane_rows import (
    Index,
    fetch_ahead,
    numbers_of,
    points_of_pairs,
    points_of_rows,
    put,
    put_vec2,
    rows_from,
    rows_of,
)
from .pair_contacts import in_lanes, is_left_open, leave_open, record_contact, settle_least, stays_in_place
from .pair_outcome import (
    cap_of_round,
    finished_lanes,
    finished_of_list,
    finished_of_table,
    is_beyond,
    is_set,
    outcome_of,
    skips_first_rounds,
    write_row,
)
from .sinks import BOUND, CONTACTS, TABLE, Table

# Pairs of a table that are taken as one, where there are several lanes.
PAIRS_OF_AN_ITEM = 64
_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))

unbounded = wp.constant(wp.float64(float("inf")))
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
def next_block(k: wp.int64, chunk: int, num_solvers: int) -> wp.int64:
    """The block that a solver takes after that of pair k: the next of its chunk, or the first of its next chunk.

    A chunk is one pair or a multiple of the lanes.
    """
    following = k + wp.int64(wp.min(lanes, chunk))
    if following % wp.int64(chunk) == wp.int64(0):
        following += wp.int64(num_solvers - 1) * wp.int64(chunk)
    return following


@wp.func
def settle_pair(
    pairs: PairList,
    k: int,
    answer: LaneAnswer,
    lane: int,
    options: Options,
    round: Round,
    cap: int,
    sink: int,
    # out
    minima: Minima,
    contacts: ContactList,
    least: LeastToi,
):
    """Settle a pair of a list that is not free: its lane has found a contact, or leaves it to the solver alone."""
    outcome = outcome_of(answer, lane, options)
    is_contact = is_set(answer.contact, lane)
    if not is_contact or round.only_moving != 0:
        vertices = vertices_of_pair(pairs, k)
        a = points_of(pairs.kind, vertices.first, vertices.second, pairs.vertices_t0)
        b = points_of(pairs.kind, vertices.first, vertices.second, pairs.vertices_t1)
        if round.only_moving != 0:
            if stays_in_place(pairs, k, a, b, options):
                return
        if not is_contact:
            used = wp.int32(simd64.lane_of(answer.iterations, lane))
            outcome = finished_of_list(pairs, k, simd64.lane_of(answer.t, lane), used, a, b, options, cap)
    if sink == BOUND:
        settle_least(pairs, k, outcome, options, round, cap, least, contacts)
    elif is_left_open(outcome, round, options, cap):
        leave_open(pairs, k)
    elif outcome.status != STATUS_NO_COLLISION:
        record_contact(pairs, k, outcome, options, round, minima, contacts)


# a Warp module for each precision, number of lanes and norm
module = wp.get_module(f"ccd_warp.solve_pairs.{real.__name__}.{width}{norm.suffix}.{fingerprint()}")
options = {"enable_backward": False, "fuse_fp": False, "max_unroll": 1, "extra_build_options": build_options}
wp.set_module_options(options, module=module)


@wp.kernel(module=module)
def solve_pairs(
    begin: int,
    # in
    num_solvers: int,
    chunk: int,
    sink: int,
    pairs: PairList,  # of a table the kind alone
    options: Options,
    round: Round,
    num_rows: int,  # of the table
    # out
    table: Table,
    minima: Minima,
    contacts: ContactList,
    least: LeastToi,
):
    """Solve the pairs of a solver, which are every ``num_solvers``-th chunk.

    With the sink `TABLE` these are the rows of the table, and the result of each is written there. With `CONTACTS` they
    are keys; the minima are lowered, the contacts listed. The first round marks each pair that it leaves open by the
    complement of its key.

    With `BOUND` the least toi alone is lowered, and the earliest pairs so far are listed if there is a list; the toi of
    a pair left open is written beside its key. A pair is left out as soon as it is free up to the least toi found so
    far, which it then cannot lower; so the least toi does not depend on the order of the pairs.
    """
    count = wp.int64(num_rows)
    cap = options.max_iterations
    if sink != TABLE:
        count = num_found(pairs)
        cap = cap_of_round(options, round, pairs)
        if cap == 0:
            return
    following = wp.int64(begin + wp.tid()) * wp.int64(chunk)
    skips_first = skips_first_rounds(options)
    pending = Pending()
    unrecorded = Unrecorded()
    while following < count or pending.count > 0 or unrecorded.count > 0:
        if is_stopped(options.stop):
            return
        if wp.static(in_lanes):
            if unrecorded.count >= lanes or (following >= count and pending.count == 0):
                unrecorded.count = record_lanes(unrecorded, pairs, minima, contacts)
                continue
        is_waiting = pending.count >= lanes or following >= count
        size = wp.min(wp.min(lanes, chunk), wp.int32(count - following))
        rows = rows_from(wp.int32(following), size)
        if is_waiting:
            size = wp.min(lanes, pending.count)
            pending.count -= size
            rows = rows_of(pending.rows, pending.count, size)
        else:
            following = next_block(following, chunk, num_solvers)
            if round.is_second != 0:
                if pairs.keys[row_in(rows, 0)] >= wp.int64(0):
                    continue  # in the second round a block is one pair, and this one is not open
        bound = unbounded
        if sink == BOUND:
            bound = wp.cast(least.bits[0], wp.float64)
            if bound == wp.float64(0.0):
                return  # no toi is less
        a = Points()
        b = Points()
        if sink == TABLE:
            a = points_of_rows(table.points_t0, rows)
            b = points_of_rows(table.points_t1, rows)
        else:
            if lanes > 1:
                fetch_ahead(pairs.keys, following, count, pairs.second_corners, pairs.vertices_t0, pairs.vertices_t1)
            a, b = points_of_pairs(pairs, rows)
        left = first_lanes(size)
        is_later = is_waiting or skips_first
        t = simd64.spread(wp.float64(0.0))
        used = t
        if is_waiting:
            t = numbers_of(pending.t, pending.count, size)
            used = numbers_of(pending.used, pending.count, size)
        answer = answer_of(pairs, rows, a, b, options, not is_later, left, t, used, cap, bound)
        if sink == TABLE:
            # what is written of the lanes that are left is overwritten
            write(rows, size, answer, options.t_max, table)
            left = left & ~finished_lanes(answer, options)
        left = left & ~answer.free
        if wp.static(in_lanes):
            if sink == CONTACTS:
                contact_lanes = left & ordinary(answer, options, round)
                left = left & ~contact_lanes
                while contact_lanes != _NONE:
                    lane = lowest_bit(contact_lanes)
                    contact_lanes = contact_lanes & (contact_lanes - _ONE)
                    unrecorded.rows[unrecorded.count] = row_in(rows, lane)
                    unrecorded.t[unrecorded.count] = simd64.lane_of(answer.t, lane)
                    unrecorded.u[unrecorded.count] = simd64.lane_of(answer.u, lane)
                    unrecorded.v[unrecorded.count] = simd64.lane_of(answer.v, lane)
                    unrecorded.gap[unrecorded.count] = simd64.lane_of(answer.gap, lane)
                    unrecorded.count += 1
        while left != _NONE:
            lane = lowest_bit(left)
            left = left & (left - _ONE)
            t_reached = simd64.lane_of(answer.t, lane)
            if sink == BOUND:
                if is_beyond(t_reached, least):
                    continue
            k = row_in(rows, lane)
            if not is_later and not is_set(answer.contact, lane):
                pending.rows[pending.count] = k
                pending.t[pending.count] = t_reached
                pending.used[pending.count] = simd64.lane_of(answer.iterations, lane)
                pending.count += 1
            elif sink == TABLE:
                row_a = row_points(table.points_t0, k)
                row_b = row_points(table.points_t1, k)
                write_row(k, finished_of_table(pairs.kind, answer, lane, row_a, row_b, options, cap), table)
            else:
                settle_pair(pairs, k, answer, lane, options, round, cap, sink, minima, contacts, least)
