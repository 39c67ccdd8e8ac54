"""The narrow phase on CUDA: three kernels, with a queue between them for the pairs that each leaves open, and one more.

A thread takes one pair, and a warp waits for the slowest of its pairs. So the first kernel makes only the first rounds,
which settle most pairs that do not touch; the second the later rounds of `lane_solver`, which settle most contacts; and
the last one, for few pairs, runs the solver for single pairs. Each is small: the registers and the stack of the rare
ways do not burden the common ones. A pair gets the answer, in every bit, that the kernels of `narrow_phase` give on the
CPU: it goes through the same functions in the same order.

The second kernel takes the open pairs of the queue, which are without gaps. It leaves those that stay open in their
places and marks the others as settled; these are so many that the last kernel mostly finds a pair or none for each
warp. Of a pair of points in contact within a separation the second kernel finds a point and not the closest one, so the
last one completes it.

In the last kernel a warp works on one pair (`whole_warp`), so that a pair far from settled holds up the launch less,
and no other pair at all; its threads look for its next pair, each in another place. The boxes of the bisection cannot
be shared: it has a last kernel of its own, in which a thread solves a pair, so that nothing else reserves memory for
its stack.

Where contacts are kept, these kernels take the pairs of two kinds, and put what they find of a contact into the queue.
A fourth one, in which all threads of a warp have a contact, lowers the minima and lists it (`pair_contacts`).
"""

from typing import Any

import warp as wp

from ..boxes.lanes import lowest_bit
from ..pair.query import Options
from ..pair.simd import fingerprint
from ..pair.single_points import row_points
from ..pair.status import STATUS_INITIAL_CONTACT, STATUS_NO_COLLISION
from ..parameters import norm, real
from ..step.minima import QUEUED, Minima
from ..step.pair_list import LeastToi, PairList, Round, num_found
from ..step.step import ContactList
from ..template import specialised
from .pair_queue import SETTLED, Queue, QueuedPair, enqueue, enqueue_contact, num_open, num_taken, place_of
from .sinks import BOUND, CONTACTS, TABLE, Table
from .whole_warp import WARP, agreed, is_first, item_of_warp, number_in_warp, threads_where

# The kernels of a narrow phase, in their order.
STAGES = ("first", "later", "last", "bisection")
# Most registers of a thread: sixteen warps a multiprocessor for the pairs that come as they are, where the compiler by
# itself takes up to 216. The other kernels have fewer pairs, and as many registers as there are.
MAX_REGISTERS = {"first": 128, "later": 255, "last": 255, "bisection": 255, "placed": 128}
# Threads of a block: one warp, so that a few thousand pairs reach all multiprocessors. With more than 64 registers a
# thread no more than 32 warps fit on one, as many as it can hold blocks.
BLOCK_DIM = 32
# Most threads of each kernel: about what 132 multiprocessors run at once with these registers; more pairs take turns.
MOST_SOLVERS = {"first": 1 << 16, "later": 1 << 15, "last": 1 << 15, "bisection": 1 << 15, "placed": 1 << 16}
_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))
_LANES = wp.constant(WARP)


@wp.struct
class Items:
    """Which items a thread takes."""

    first: int  # the number of items if there is none
    stride: int
    are_shared: bool  # with all threads of its warp
    writes: bool  # whether it writes the result


@wp.func
def items_of(solver: int, num_solvers: int, count: int, are_shared: bool) -> Items:
    """The items of a thread: those of its warp, or its own, by which as few lanes of a warp are used as it takes.

    So few items are spread over all multiprocessors.
    """
    num_warps = num_solvers / _LANES
    items = Items()
    items.are_shared = are_shared
    if are_shared:
        items.first = item_of_warp(solver, count)
        items.stride = num_warps
        items.writes = is_first(solver)
    else:
        lanes = wp.min(_LANES, (count + num_warps - 1) / num_warps)
        lane = solver % _LANES
        items.first = wp.where(lane < lanes, (solver / _LANES) * lanes + lane, count)
        items.stride = num_warps * lanes
        items.writes = True
    return items


on_arcs = norm.has_arcs
templates = {"norm": norm, "real": real}
cap_of_round = specialised("narrow_phase.pair_outcome", **templates, only_method="clipping").cap_of_round
placed = specialised("narrow_phase.pair_contacts", **templates, only_method="clipping")
lane_answers = specialised("narrow_phase.lane_answers", **templates)
LaneAnswer = specialised("pair.lane_solver", **templates).LaneAnswer
points_of_pairs = specialised("narrow_phase.lane_rows").points_of_pairs
unbounded = wp.constant(wp.float64(float("inf")))


def module_of(name: str, stage: str):
    """A Warp module for each kernel, so that each has its own registers and stack."""
    module = wp.get_module(f"ccd_warp.{name}.{stage}.{real.__name__}{norm.suffix}.{fingerprint()}")
    options = {"enable_backward": False, "fuse_fp": False, "max_unroll": 1, "block_dim": BLOCK_DIM}
    wp.set_module_options(options, module=module)
    return module


@wp.func
def num_pairs(pairs: PairList, options: Options, round: Round) -> int:
    """Number of pairs of a kind that a round takes: none in the second round if the first has left none open."""
    if cap_of_round(options, round, pairs) == 0:
        return 0
    return wp.int32(num_found(pairs))


def make_solve_pairs(name: str, sink: int, stage: str):
    is_initial, is_shared, is_last = stage == "first", stage == "last", stage in ("last", "bisection")
    is_table, is_listed, is_bound = sink == TABLE, sink == CONTACTS, sink == BOUND
    only_method = "bisection" if stage == "bisection" else "clipping"
    pair_outcome = specialised("narrow_phase.pair_outcome", **templates, only_method=only_method)
    pair_contacts = specialised("narrow_phase.pair_contacts", **templates, only_method=only_method)
    Outcome = pair_contacts.Outcome

    @wp.func
    def is_done(pair: QueuedPair, least: LeastToi, are_shared: bool) -> bool:
        """Whether a pair of the queue is settled; the threads of a warp that share it find the same."""
        done = pair.row == SETTLED
        if wp.static(is_listed or not is_last):
            done = pair.row < 0
        if wp.static(is_bound):
            done = done or pair_outcome.is_beyond(pair.t, least)
        if are_shared:
            done = agreed(done)
        return done

    @wp.func
    def next_of_warp(first: int, stride: int, count: int, queue: Queue, least: LeastToi) -> int:
        """The first pair of a warp, from a place on, that is not settled; the number of places if there is none."""
        for place in range(first, count, _LANES * stride):
            of_thread = place + number_in_warp() * stride
            is_found = bool(False)
            if of_thread < count:
                is_found = not is_done(queue.pairs[of_thread], least, False)
            threads = threads_where(is_found)
            if threads != _NONE:
                return place + lowest_bit(threads) * stride
        return count

    @wp.func
    def is_open(answer: LaneAnswer, bound: wp.float64) -> bool:
        """Whether the rounds have not settled a pair, which may be free up to a bound."""
        open = answer.free | answer.contact == _NONE
        if wp.static(is_bound):
            open = open and answer.t < bound
        return open

    @wp.kernel(module=module_of(name, stage), cuda_max_registers=MAX_REGISTERS[stage])
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
        """A stage of ``solve_pairs`` of `narrow_phase` for a sink; the queue of a table is counted in the first row.

        A list of contacts is of the pairs of two kinds, and the rows of the second follow those of the first.
        """
        cap = options.max_iterations
        count = num_rows
        of_first = num_rows
        kind = int(0)
        column = QUEUED + round.is_second
        if wp.static(not is_table):
            kind = pairs.kind
            count = num_pairs(pairs, options, round)
            of_first = count
            if wp.static(is_listed):
                count += num_pairs(others, options, round)
            if count == 0:
                return
        skips_first = pair_outcome.skips_first_rounds(options)
        if wp.static(not is_initial):
            count = num_open(pairs.counts[kind, column])
        items = items_of(begin + wp.tid(), num_solvers, count, wp.static(is_shared))
        following = items.first
        while following < count:
            n = following
            if wp.static(is_shared):
                n = next_of_warp(n, items.stride, count, queue, least)
                if n == count:
                    return
            following = n + items.stride
            pair = QueuedPair()
            if wp.static(is_initial):
                pair.row = n
            else:
                pair = queue.pairs[n]
                if is_done(pair, least, items.are_shared):
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
            if wp.static(not is_table):
                cap = cap_of_round(options, round, of_kind)
            if wp.static(is_initial):
                if wp.static(not is_table):
                    if round.is_second != 0 and of_kind.keys[k] >= wp.int64(0):
                        continue  # the second round is of the pairs that the first has left open
                if skips_first:
                    enqueue(queue, pairs.counts, kind, column, pair)
                    continue
            is_contact = bool(False)  # within a separation: the rounds have found any point of it, not the closest one
            if wp.static(is_table and is_last):
                if k < 0:
                    is_contact = True
                    k = SETTLED - 1 - k
                    pair.t = table.toi[k]
            if wp.static(is_table):
                a = row_points(table.points_t0, k)
                b = row_points(table.points_t1, k)
            else:
                a, b = points_of_pairs(of_kind, k)
            is_needed = bool(True)
            if wp.static(is_listed):
                is_needed = round.only_moving == 0 or not pair_contacts.stays_in_place(of_kind, k, a, b, options)
            outcome = Outcome()
            if wp.static(is_last):
                if wp.static(is_table):
                    outcome = pair_outcome.finished(pairs.kind, pair.t, pair.used, is_contact, a, b, options, cap)
                elif is_needed:
                    outcome = pair_outcome.finished_of_list(of_kind, k, pair.t, pair.used, a, b, options, cap)
            else:
                bound = unbounded
                if wp.static(is_bound):
                    bound = wp.cast(least.bits[0], wp.float64)
                used = wp.float64(pair.used)
                answer = lane_answers.answer_of(
                    of_kind, k, a, b, options, wp.static(is_initial), _ONE, pair.t, used, cap, bound
                )
                if is_needed and is_open(answer, bound):
                    pair.t = answer.t
                    pair.used = wp.int32(answer.iterations)
                    if wp.static(is_initial):
                        enqueue(queue, pairs.counts, kind, column, pair)
                    else:
                        queue.pairs[n] = pair
                    continue
                if is_needed:
                    outcome = pair_outcome.outcome_of(answer, 0, options)
                is_complete = bool(True)
                if wp.static(is_table):
                    is_complete = outcome.status == STATUS_NO_COLLISION or answer.closest != _NONE
                pair.row = wp.where(is_complete, SETTLED, SETTLED - 1 - row)
                if wp.static(not is_initial):
                    queue.pairs[n] = pair
                elif wp.static(is_table):
                    if not is_complete:
                        enqueue(queue, pairs.counts, kind, column, pair)
            if not items.writes:
                continue
            if wp.static(is_table):
                if is_contact:
                    table.parameters[k] = outcome.parameters
                    continue
                if outcome.status == STATUS_INITIAL_CONTACT:
                    most = pair_outcome.most_gap(options)
                    outcome.status = pair_outcome.status_at_start(
                        pairs.kind, outcome.gap, most, a, options.minimum_separation
                    )
                pair_outcome.write_row(k, outcome, table)
            elif wp.static(is_bound):
                pair_contacts.settle_least(pairs, k, outcome, options, round, cap, least, contacts)
            elif pair_contacts.is_left_open(outcome, round, options, cap):
                pair_contacts.leave_open(of_kind, k)
            elif outcome.status != STATUS_NO_COLLISION:
                pair.row = SETTLED - 1 - row
                pair.t = outcome.toi
                pair.used = outcome.status
                if wp.static(is_initial):
                    n = enqueue_contact(queue, pairs.counts, kind, column, pair)
                else:
                    queue.pairs[n] = pair
                uv = outcome.parameters
                queue.contact[n] = wp.vec4d(uv[0], uv[1], outcome.gap, outcome.width)

    return solve_pairs


@wp.kernel(module=module_of("solve_pairs", "placed"), cuda_max_registers=MAX_REGISTERS["placed"])
def place_contacts(
    begin: int,
    # in
    num_threads: int,
    pairs: PairList,
    options: Options,
    round: Round,
    num_rows: int,
    others: PairList,
    queue: Queue,
    # out
    table: Table,
    minima: Minima,
    contacts: ContactList,
    least: LeastToi,
):
    """Lower the minima by each contact that a round has put into the queue, and list it; after the stages above."""
    of_first = num_pairs(pairs, options, round)
    column = QUEUED + round.is_second
    following = begin + wp.tid()
    while following < num_taken(pairs.counts[pairs.kind, column]):
        n = place_of(following, pairs.counts[pairs.kind, column], queue)
        following += num_threads
        pair = queue.pairs[n]
        if pair.row < SETTLED:
            of_contact = queue.contact[n]
            outcome = placed.Outcome()
            outcome.toi = pair.t
            outcome.status = pair.used
            outcome.parameters = wp.vec2d(of_contact[0], of_contact[1])
            outcome.gap = of_contact[2]
            outcome.width = of_contact[3]
            k = SETTLED - 1 - pair.row
            of_kind = pairs
            if k >= of_first:
                k -= of_first
                of_kind.kind = others.kind  # as above
                of_kind.keys = others.keys
                of_kind.first_corners = others.first_corners
                of_kind.second_corners = others.second_corners
            placed.record_contact(of_kind, k, outcome, options, round, minima, contacts)


def stages_of(name: str, sink: int) -> dict[str, Any]:
    """The kernels of a sink by their stages, in the order of their launches; on arcs nothing is bisected."""
    stages = [stage for stage in STAGES if not (on_arcs and stage == "bisection")]
    return {stage: make_solve_pairs(name, sink, stage) for stage in stages}


points_toi = {} if on_arcs else stages_of("points_toi", TABLE)
solve_pairs = stages_of("solve_pairs", CONTACTS) | {"placed": place_contacts}
pairs_bound = stages_of("pairs_bound", BOUND)
by_sink = {TABLE: points_toi, CONTACTS: solve_pairs, BOUND: pairs_bound}
