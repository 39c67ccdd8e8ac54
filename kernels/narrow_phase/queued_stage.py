"""A kernel of the narrow phase on CUDA: that of a stage and of a sink (`queued_pairs`)."""

import warp as wp

from ..boxes.lanes import lowest_bit
from ..pair.points import Points
from ..pair.query import Options
from ..pair.single_points import row_points
from ..pair.status import STATUS_INITIAL_CONTACT, STATUS_NO_COLLISION
from ..parameters import norm, only_method, real, sink, stage
from ..step.minima import QUEUED, Minima
from ..step.pair_list import LeastToi, PairList, Round
from ..step.step import ContactList
from ..template import specialised
from . import pair_contacts, pair_outcome
from .lane_answers import LaneAnswer, answer_of
from .pair_queue import SETTLED, Queue, QueuedPair, enqueue, enqueue_contact, num_open
from .queued_launch import MAX_REGISTERS, items_of, module_of
from .sinks import BOUND, CONTACTS, TABLE, Table
from .whole_warp import WARP, agreed, is_first, number_in_warp, threads_where

_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))
_LANES = wp.constant(WARP)
_NAMES = {TABLE: "points_toi", CONTACTS: "solve_pairs", BOUND: "pairs_bound"}

is_initial, is_shared, is_last = stage == "first", stage == "last", stage in ("last", "bisection")
is_table, is_listed, is_bound = sink == TABLE, sink == CONTACTS, sink == BOUND
Outcome = pair_contacts.Outcome
points_of_pairs = specialised("narrow_phase.lane_rows").points_of_pairs
unbounded = wp.constant(wp.float64(float("inf")))
module = module_of(f"{_NAMES[sink]}.{stage}", real, norm, only_method)


@wp.func
def is_done(pair: QueuedPair, least: LeastToi) -> bool:
    """Whether a pair of the queue is settled."""
    done = pair.row == SETTLED
    if wp.static(is_listed or not is_last):
        done = pair.row < 0
    if wp.static(is_bound):
        done = done or pair_outcome.is_beyond(pair.t, least)
    return done


@wp.func
def next_of_warp(first: int, stride: int, count: int, queue: Queue, least: LeastToi) -> int:
    """The first pair of a warp, from a place on, that is not settled; the number of places if there is none."""
    for place in range(first, count, _LANES * stride):
        of_thread = place + number_in_warp() * stride
        is_found = bool(False)
        if of_thread < count:
            is_found = not is_done(queue.pairs[of_thread], least)
        threads = threads_where(is_found)
        if threads != _NONE:
            return place + lowest_bit(threads) * stride
    return count


@wp.func
def keep(n: int, pair: QueuedPair, queue: Queue, counts: wp.array2d[wp.int64], kind: int, column: int):
    """Append a pair to the queue, of which the later stages leave each in its place."""
    if wp.static(is_initial):
        enqueue(queue, counts, kind, column, pair)
    else:
        queue.pairs[n] = pair


@wp.func
def points_at(pairs: PairList, k: int, table: Table):
    """The points of a pair at both ends."""
    if wp.static(is_table):
        return row_points(table.points_t0, k), row_points(table.points_t1, k)
    else:
        return points_of_pairs(pairs, k)


@wp.func
def is_open(answer: LaneAnswer, bound: wp.float64) -> bool:
    """Whether the rounds have not settled a pair, which may be free up to a bound."""
    open = answer.free | answer.contact == _NONE
    if wp.static(is_bound):
        open = open and answer.t < bound
    return open


@wp.func
def solved_alone(
    pairs: PairList, k: int, pair: QueuedPair, is_contact: bool, a: Points, b: Points, options: Options, cap: int
) -> Outcome:
    """The result of a pair by the solver for single pairs."""
    if wp.static(is_table):
        return pair_outcome.finished(pairs.kind, pair.t, pair.used, is_contact, a, b, options, cap)
    else:
        return pair_outcome.finished_of_list(pairs, k, pair.t, pair.used, a, b, options, cap)


@wp.func
def write_result(kind: int, k: int, outcome: Outcome, is_contact: bool, a: Points, options: Options, table: Table):
    """Write the row of a pair; of a contact that an earlier stage has found the closest points alone."""
    if is_contact:
        table.parameters[k] = outcome.parameters
    else:
        if outcome.status == STATUS_INITIAL_CONTACT:
            most = pair_outcome.most_gap(options)
            outcome.status = pair_outcome.status_at_start(kind, outcome.gap, most, a, options.minimum_separation)
        pair_outcome.write_row(k, outcome, table)


@wp.func
def queue_contact(
    n: int, row: int, outcome: Outcome, queue: Queue, counts: wp.array2d[wp.int64], kind: int, column: int
):
    """Put a contact into the queue, for `place_contacts`."""
    pair = QueuedPair()
    pair.row = SETTLED - 1 - row
    pair.t = outcome.toi
    pair.used = outcome.status
    place = n
    if wp.static(is_initial):
        place = enqueue_contact(queue, counts, kind, column, pair)
    else:
        queue.pairs[n] = pair
    uv = outcome.parameters
    queue.contact[place] = wp.vec4d(uv[0], uv[1], outcome.gap, outcome.width)


@wp.kernel(module=module, cuda_max_registers=MAX_REGISTERS[stage])
def solve_pairs(
    begin: int,
    # in
    num_solvers: int,
    pairs: PairList,
    options: Options,
    round: Round,
    num_rows: int,
    others: PairList,  # of the second kind
    queue: Queue,
    # out
    table: Table,
    minima: Minima,
    contacts: ContactList,
    least: LeastToi,
):
    """A stage of ``solve_pairs`` of `narrow_phase` for a sink.

    A list of contacts is of the pairs of two kinds, and the rows of the second follow those of the first.
    """
    column = QUEUED + round.is_second
    of_first = num_rows
    if wp.static(not is_table):
        of_first = pair_outcome.num_pairs(pairs, options, round)
    count = of_first
    if wp.static(is_listed):
        count += pair_outcome.num_pairs(others, options, round)
    if count == 0:
        return
    if wp.static(not is_initial):
        count = num_open(pairs.counts[pairs.kind, column])
    skips_first = pair_outcome.skips_first_rounds(options)
    solver = begin + wp.tid()
    items = items_of(solver, num_solvers, count, wp.static(is_shared))
    following = items.first
    while following < count:
        n = following
        following += items.stride
        pair = QueuedPair()
        if wp.static(is_initial):
            pair.row = n
        else:
            pair = queue.pairs[n]
            done = is_done(pair, least)
            if wp.static(is_shared):
                done = agreed(done)
                if done:
                    following = next_of_warp(following, items.stride, count, queue, least)
            if done:
                continue
        row = pair.row
        k = row
        of_kind = pairs
        if wp.static(is_listed):
            if k >= of_first:
                k -= of_first
                # what both lists share stays that of one: CUDA would not know in what memory a chosen array is
                of_kind.kind = others.kind
                of_kind.keys = others.keys
                of_kind.first_corners = others.first_corners
                of_kind.second_corners = others.second_corners
        cap = options.max_iterations
        if wp.static(not is_table):
            cap = pair_outcome.cap_of_round(options, round, of_kind)
            if wp.static(is_initial):
                if round.is_second != 0 and of_kind.keys[k] >= wp.int64(0):
                    continue  # the second round is of the pairs that the first has left open
        if wp.static(is_initial):
            if skips_first:
                enqueue(queue, pairs.counts, pairs.kind, column, pair)
                continue
        is_contact = bool(False)  # within a separation: the rounds have found any point of it, not the closest one
        if wp.static(is_table and is_last):
            if k < 0:
                is_contact = True
                k = SETTLED - 1 - k
                pair.t = table.toi[k]
        a, b = points_at(of_kind, k, table)
        if wp.static(is_listed):
            if round.only_moving != 0 and pair_contacts.stays_in_place(of_kind, k, a, b, options):
                continue
        outcome = Outcome()
        if wp.static(is_last):
            outcome = solved_alone(of_kind, k, pair, is_contact, a, b, options, cap)
        else:
            bound = unbounded
            if wp.static(is_bound):
                bound = wp.cast(least.bits[0], wp.float64)
            used = wp.float64(pair.used)
            answer = answer_of(of_kind, k, a, b, options, wp.static(is_initial), _ONE, pair.t, used, cap, bound)
            if is_open(answer, bound):
                pair.t = answer.t
                pair.used = wp.int32(answer.iterations)
                keep(n, pair, queue, pairs.counts, pairs.kind, column)
                continue
            outcome = pair_outcome.outcome_of(answer, 0, options)
            pair.row = SETTLED
            if wp.static(is_table):
                if outcome.status != STATUS_NO_COLLISION and answer.closest == _NONE:
                    pair.row = SETTLED - 1 - row
            if wp.static(not is_initial) or pair.row != SETTLED:
                keep(n, pair, queue, pairs.counts, pairs.kind, column)
        if wp.static(is_shared):
            if not is_first(solver):
                continue
        if wp.static(is_table):
            write_result(pairs.kind, k, outcome, is_contact, a, options, table)
        elif wp.static(is_bound):
            pair_contacts.settle_least(pairs, k, outcome, options, round, cap, least, contacts)
        elif pair_contacts.is_left_open(outcome, round, options, cap):
            pair_contacts.leave_open(of_kind, k)
        elif outcome.status != STATUS_NO_COLLISION:
            queue_contact(n, row, outcome, queue, pairs.counts, pairs.kind, column)
