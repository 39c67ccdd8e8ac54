"""The narrow phase on CUDA: three kernels, with a queue between them for the pairs that each leaves open.

A thread takes one pair, and a warp waits for the slowest of its pairs. So the first kernel makes only the first rounds,
which settle most pairs that do not touch; the second the later rounds of `lane_solver`, which settle most contacts; and
the last one, for few pairs, runs the solver for single pairs. Each is small: the registers and the stack of the rare
ways do not burden the common ones. A pair gets the answer, in every bit, that the kernels of `narrow_phase` give on the
CPU: it goes through the same functions in the same order.

The second kernel takes the queue as it is, without gaps. It leaves open pairs in their places and marks the others as
settled; these are so many that the last kernel mostly finds a pair or none in each warp. Of a pair of points in contact
within a separation the second kernel finds a point and not the closest one, so the last one completes it.

In the last kernel a warp works on one pair (`whole_warp`), so that a pair far from settled holds up the launch less,
and no other pair at all.
"""

import warp as wp

from ..atomics import atomic_min_int64, claim
from ..pair.norm import MAXIMUM_NORM, OWN_BOX_NORM, has_arcs, is_by_pair
from ..pair.query import CLIPPING, Options
from ..pair.simd import fingerprint
from ..pair.single_points import is_stationary, row_points
from ..pair.status import STATUS_INITIAL_CONTACT, STATUS_ITERATION_LIMIT, STATUS_NO_COLLISION
from ..pair.turns import turns_anywhere
from ..pair_key import pair_of
from ..parameters import norm, real
from ..step.minima import ANY_OPEN, FOUND, OPEN, QUEUED, Minima
from ..step.step import ContactList
from ..template import specialised
from .sinks import BOUND, CONTACTS, TABLE, Table
from .whole_warp import WARP, agreed, is_first, item_of_warp

# The kernels of a narrow phase, in their order.
STAGES = ("first", "later", "last")
# Most registers of a thread: sixteen warps a multiprocessor for the pairs that come as they are, where the compiler by
# itself takes up to 216. The other kernels have fewer pairs, and as many registers as there are.
MAX_REGISTERS = {"first": 128, "later": 255, "last": 255}
# Threads of a block: one warp, so that a few thousand pairs reach all multiprocessors. With more than 64 registers a
# thread no more than 32 warps fit on one, as many as it can hold blocks.
BLOCK_DIM = 32
# Most threads of each kernel: about what 132 multiprocessors run at once with these registers; more pairs take turns.
MOST_SOLVERS = {"first": 1 << 16, "later": 1 << 15, "last": 1 << 15}
_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))
_SETTLED = wp.constant(-1)
_LANES = wp.constant(WARP)

vec3d = wp.vec3d


@wp.struct
class Queue:
    """Pairs that are open, each free on [0, t), in any order; their number is in the counts."""

    rows: wp.array[wp.int32]  # of its points, or of its key; then `_SETTLED`, or `_SETTLED` - 1 - a row to complete
    t: wp.array[wp.float64]
    used: wp.array[wp.int8]  # iterations so far


@wp.func
def enqueue(queue: Queue, counts: wp.array2d[wp.int64], kind: int, column: int, row: int, t: wp.float64, used: int):
    """Append an open pair; there is capacity for all pairs.

    So no bound is needed: the count is 0 before a round, and a thread has each of its pairs appended once at most. A
    place beyond the queue would therefore be that of a count that was not reset, which makes all of the queue wrong;
    the emulated device ends such a launch.
    """
    n = claim(counts, kind, column, 1)
    queue.rows[n] = row
    queue.t[n] = t
    queue.used[n] = wp.int8(used)


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

    So few items are spread over all multiprocessors. The boxes of the bisection cannot be shared.
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


has_own = is_by_pair(norm)
on_arcs = has_arcs(norm)
if on_arcs:
    lane_windows = specialised("pair.lane_windows", norm=norm, real=real)
    arcs_of_pairs = specialised("narrow_phase.lane_rows", norm=norm).arcs_of_pairs
    options_of_pair = specialised("pair.pair_options", real=real, norm=norm).options_of_pair
options_of_rows = specialised("pair.pair_options", real=real, norm=norm).options_of_rows
Outcome = specialised("pair.solver", norm=norm, real=real, on_warp=True).Outcome
pair_outcome = specialised("narrow_phase.pair_outcome", norm=norm, real=real, on_warp=True)
lane_solver = specialised("pair.lane_solver", norm=norm, real=real)
points_of_pairs = specialised("narrow_phase.lane_rows").points_of_pairs
unbounded = wp.constant(wp.float64(float("inf")))


def own_module(name: str, stage: str):
    """A Warp module for each kernel, so that each has its own registers and stack."""
    of_norm = "" if norm == MAXIMUM_NORM else f".{norm}"
    module = wp.get_module(f"ccd_warp.{name}.{stage}.{real.__name__}{of_norm}.{fingerprint()}")
    options = {"enable_backward": False, "fuse_fp": False, "max_unroll": 1, "block_dim": BLOCK_DIM}
    wp.set_module_options(options, module=module)
    return module


def make_solve_pairs(name: str, sink: int, stage: str):
    is_initial, is_last = stage == "first", stage == "last"
    is_table, is_listed, is_bound = sink == TABLE, sink == CONTACTS, sink == BOUND

    @wp.kernel(module=own_module(name, stage), cuda_max_registers=MAX_REGISTERS[stage])
    def solve_pairs(
        begin: int,
        # in
        num_solvers: int,
        kind: int,
        counts: wp.array2d[wp.int64],
        pairs: wp.array[wp.int64],
        first_corners: wp.array[wp.vec3i],
        second_corners: wp.array[wp.vec3i],
        vertices_t0: wp.array[vec3d],
        vertices_t1: wp.array[vec3d],
        options: Options,
        is_second: int,
        only_moving: int,
        gaps_moved: wp.float64,
        num_rows: int,
        queue: Queue,
        # out
        table: Table,
        minima: Minima,
        contacts: ContactList,
        least_bits: wp.array[wp.int64],
        open_toi: wp.array[wp.float64],
    ):
        """A stage of ``solve_pairs`` of `narrow_phase` for a sink; the queue of a table is counted in the first row."""
        cap = options.max_iterations
        last = num_rows
        row = kind
        if wp.static(is_table):
            row = 0
        else:
            cap = pair_outcome.cap_of_round(options, is_second, counts[kind, OPEN])
            if cap == 0:
                return
            last = wp.int32(wp.min(counts[kind, FOUND], wp.int64(pairs.shape[0])))
        skips_first = pair_outcome.skips_first_rounds(options)
        if wp.static(not is_initial):
            last = wp.int32(counts[row, QUEUED + is_second])
        items = items_of(begin + wp.tid(), num_solvers, last, wp.static(is_last) and options.method == CLIPPING)
        following = items.first
        while following < last:
            n = following
            following += items.stride
            k = n
            t = wp.float64(0.0)
            used = int(0)
            if wp.static(is_initial):
                if wp.static(not is_table):
                    if is_second != 0 and pairs[k] >= wp.int64(0):
                        continue  # the second round is of the pairs that the first has left open
                if skips_first:
                    enqueue(queue, counts, row, QUEUED + is_second, k, t, used)
                    continue
            else:
                k = queue.rows[n]
                t = queue.t[n]
                used = wp.int32(queue.used[n])
                is_done = k == _SETTLED
                if wp.static(is_bound):
                    # a pair that is free up to the least toi cannot lower it
                    is_done = is_done or wp.cast(t, wp.int64) >= least_bits[0]
                    if items.are_shared:
                        is_done = agreed(is_done)
                if is_done:
                    continue
                if wp.static(is_table and is_last):
                    if k < 0:
                        k = _SETTLED - 1 - k
                        a = row_points(table.points_t0, k)
                        b = row_points(table.points_t1, k)
                        if items.writes:
                            table.parameters[k] = pair_outcome.parameters_at(kind, table.toi[k], a, b, options)
                        continue
            if wp.static(is_table):
                a = row_points(table.points_t0, k)
                b = row_points(table.points_t1, k)
            else:
                a, b = points_of_pairs(kind, pairs, k, first_corners, second_corners, vertices_t0, vertices_t1)
            is_needed = bool(True)
            if wp.static(is_listed):
                is_needed = only_moving == 0 or not is_stationary(a, b)
                if wp.static(on_arcs):
                    if not is_needed:
                        staying = pair_of(wp.where(pairs[k] < wp.int64(0), ~pairs[k], pairs[k]))
                        is_needed = turns_anywhere(first_corners[staying[0]], options.turns) or turns_anywhere(
                            second_corners[staying[1]], options.turns
                        )
            outcome = Outcome()
            if wp.static(is_last):
                if wp.static(is_table):
                    outcome = pair_outcome.finished(kind, t, used, False, a, b, options, cap)
                else:
                    own = options_of_rows(options, pairs, k, first_corners, second_corners)
                    if wp.static(on_arcs):
                        key = pairs[k]
                        pair = pair_of(wp.where(key < wp.int64(0), ~key, key))
                        first = first_corners[pair[0]]
                        second = second_corners[pair[1]]
                        if is_needed:
                            of_pair = options_of_pair(options, first, second)
                            outcome = pair_outcome.solve_on_arcs(kind, first, second, t, used, a, b, of_pair, cap)
                    elif wp.static(is_bound):
                        outcome = pair_outcome.finished(kind, t, used, False, a, b, own, cap)
                    elif is_needed:
                        outcome = pair_outcome.finished(kind, t, used, False, a, b, own, cap)
            else:
                least = unbounded
                if wp.static(is_bound):
                    least = wp.cast(least_bits[0], wp.float64)
                answer = lane_solver.LaneAnswer()
                if wp.static(on_arcs):
                    own = options_of_rows(options, pairs, k, first_corners, second_corners)
                    own.arcs = arcs_of_pairs(kind, pairs, k, first_corners, second_corners, options.turns)
                    if wp.static(is_initial):
                        answer = lane_windows.first_window(kind, a, b, own, options, t, cap, least)
                    else:
                        later = wp.float64(used)
                        answer = lane_windows.later_windows(kind, a, b, own, options, _ONE, t, later, cap, least)
                elif wp.static(is_initial and has_own):
                    pass  # all pairs have skipped the first rounds
                elif wp.static(is_initial):
                    answer = lane_solver.first_rounds(kind, a, b, options, cap, least)
                elif wp.static(is_table):
                    answer = lane_solver.later_rounds(kind, a, b, options, _ONE, t, wp.float64(used), cap, least)
                else:
                    own = options_of_rows(options, pairs, k, first_corners, second_corners)
                    answer = lane_solver.later_rounds(kind, a, b, own, _ONE, t, wp.float64(used), cap, least)
                is_open = is_needed and answer.free | answer.contact == _NONE
                if wp.static(is_bound):
                    is_open = is_open and answer.t < least
                if is_open:
                    used = wp.int32(answer.iterations)
                    if wp.static(is_initial):
                        enqueue(queue, counts, row, QUEUED + is_second, k, answer.t, used)
                    else:
                        queue.t[n] = answer.t
                        queue.used[n] = wp.int8(used)
                    continue
                if wp.static(not is_listed) or (is_needed and answer.contact != _NONE):
                    outcome = pair_outcome.outcome_of(answer, 0, options)
                if wp.static(not is_initial):
                    queue.rows[n] = _SETTLED
                    if wp.static(is_table):
                        if outcome.status != STATUS_NO_COLLISION and skips_first:
                            queue.rows[n] = _SETTLED - 1 - k
            if not items.writes:
                continue
            if wp.static(is_table):
                table.toi[k] = outcome.toi
                table.status[k] = outcome.status
                if outcome.status == STATUS_INITIAL_CONTACT:
                    table.status[k] = pair_outcome.status_at_start(kind, outcome.gap, a, options)
                table.parameters[k] = outcome.parameters
                table.gap[k] = outcome.gap
                table.width[k] = outcome.width
                table.iterations[k] = outcome.iterations
            elif outcome.status != STATUS_NO_COLLISION:
                if wp.static(is_last):
                    if outcome.status == STATUS_ITERATION_LIMIT and is_second == 0 and cap < options.max_iterations:
                        pairs[k] = ~pairs[k]
                        if wp.static(is_bound):
                            open_toi[k] = outcome.toi
                        claim(counts, kind, OPEN, 1)
                        claim(counts, 0, ANY_OPEN, 1)
                        continue
                if wp.static(is_bound):
                    atomic_min_int64(least_bits, 0, wp.cast(outcome.toi, wp.int64))
                else:
                    key = pairs[k]
                    if is_second != 0:
                        key = ~key
                    pair = pair_of(key)
                    first = first_corners[pair[0]]
                    second = second_corners[pair[1]]
                    pair_outcome.record_contact(
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

    return solve_pairs


points_toi = (
    [] if norm == OWN_BOX_NORM or on_arcs else [make_solve_pairs("points_toi", TABLE, stage) for stage in STAGES]
)
solve_pairs = [make_solve_pairs("solve_pairs", CONTACTS, stage) for stage in STAGES]
pairs_bound = [make_solve_pairs("pairs_bound", BOUND, stage) for stage in STAGES]
by_sink = {TABLE: points_toi, CONTACTS: solve_pairs, BOUND: pairs_bound}
