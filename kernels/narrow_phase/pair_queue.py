"""The queue between the kernels of the narrow phase on CUDA: pairs that are open, and contacts that are not listed."""

import warp as wp

from ..atomics import claim

# In place of the row of a pair: it is settled. Less by 1 and its row: a pair to complete, or a contact to list.
SETTLED = wp.constant(-1)


@wp.struct
class Queue:
    """Pairs, each free on [0, t), in any order; their number is in the counts."""

    rows: wp.array[wp.int32]  # numbers of pairs, or what stands in their place
    t: wp.array[wp.float64]
    used: wp.array[wp.int8]  # iterations so far; of a contact its status
    contact: wp.array[wp.vec4d]  # of a contact its parameters, its gap and the width of its time; empty without a list


@wp.struct
class QueuedPair:
    """A pair of the queue."""

    row: int
    t: wp.float64
    used: int


@wp.func
def enqueue(
    queue: Queue, counts: wp.array2d[wp.int64], kind: int, column: int, row: int, t: wp.float64, used: int
) -> int:
    """Append a pair, and return its place; there is capacity for all pairs.

    So no bound is needed: the count is 0 before a round, and a thread has each of its pairs appended once at most. A
    place beyond the queue would therefore be that of a count that was not reset, which makes all of the queue wrong;
    the emulated device ends such a launch.
    """
    n = wp.int32(claim(counts, kind, column, 1))
    keep(queue, n, row, t, used)
    return n


@wp.func
def keep(queue: Queue, n: int, row: int, t: wp.float64, used: int):
    """Write a pair to a place of the queue."""
    queue.rows[n] = row
    queue.t[n] = t
    queue.used[n] = wp.int8(used)


@wp.func
def queued(queue: Queue, n: int) -> QueuedPair:
    """The pair at a place of the queue."""
    pair = QueuedPair()
    pair.row = queue.rows[n]
    pair.t = queue.t[n]
    pair.used = wp.int32(queue.used[n])
    return pair
