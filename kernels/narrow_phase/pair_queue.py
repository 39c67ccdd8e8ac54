"""The queue between the kernels of the narrow phase on CUDA: pairs that are open, and contacts that are not listed."""

import warp as wp

from ..atomics import claim

# In place of the row of a pair: it is settled. Less by 1 and its row: a pair to complete, or a contact to list.
SETTLED = wp.constant(-1)


@wp.struct
class QueuedPair:
    """A pair of the queue, free on [0, t)."""

    row: int  # number of the pair, or what stands in its place
    used: int  # iterations so far; of a contact its status
    t: wp.float64


@wp.struct
class Queue:
    """Pairs in any order; their number is in the counts."""

    pairs: wp.array[QueuedPair]
    contact: wp.array[wp.vec4d]  # of a contact its parameters, its gap and the width of its time; empty without a list


@wp.func
def enqueue(queue: Queue, counts: wp.array2d[wp.int64], kind: int, column: int, pair: QueuedPair) -> int:
    """Append a pair, and return its place; there is capacity for all pairs.

    So no bound is needed: the count is 0 before a round, and a thread has each of its pairs appended once at most. A
    place beyond the queue would therefore be that of a count that was not reset, which makes all of the queue wrong;
    the emulated device ends such a launch.
    """
    n = wp.int32(claim(counts, kind, column, 1))
    queue.pairs[n] = pair
    return n
