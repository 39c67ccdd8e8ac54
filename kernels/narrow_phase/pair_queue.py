"""The queue between the kernels of the narrow phase on CUDA: pairs that are open, and contacts that are not listed.

The first kernel appends open pairs from the first place on, and contacts from the last place on, so that the kernels
behind it find the open pairs without gaps. Both are counted in one number, contacts in its upper half.
"""

import warp as wp

from ..atomics import claim

# In place of the row of a pair: it is settled. Less by 1 and its row: a pair to complete, or a contact to list.
SETTLED = wp.constant(-1)
_CONTACT = wp.constant(wp.int64(1 << 32))


@wp.struct
class QueuedPair:
    """A pair of the queue, free on [0, t)."""

    row: int  # number of the pair, or what stands in its place
    used: int  # iterations so far; of a contact its status
    t: wp.float64


@wp.struct
class Queue:
    """Pairs in any order; their numbers are in the counts. Either array may be longer than the other."""

    pairs: wp.array[QueuedPair]
    contact: wp.array[wp.vec4d]  # of a contact its parameters, its gap and the width of its time; empty without a list


@wp.func
def enqueue(queue: Queue, counts: wp.array2d[wp.int64], kind: int, column: int, pair: QueuedPair) -> int:
    """Append an open pair, and return its place; there is capacity for all pairs.

    So no bound is needed: the count is 0 before a round, and a thread has each of its pairs appended once at most. A
    place beyond the queue would therefore be that of a count that was not reset, which makes all of the queue wrong;
    the emulated device ends such a launch.
    """
    n = wp.int32(claim(counts, kind, column, 1))
    queue.pairs[n] = pair
    return n


@wp.func
def last_place(queue: Queue) -> int:
    """The place of the first contact."""
    return wp.min(queue.pairs.shape[0], queue.contact.shape[0]) - 1


@wp.func
def enqueue_contact(queue: Queue, counts: wp.array2d[wp.int64], kind: int, column: int, pair: QueuedPair) -> int:
    """Put a contact before the others, and return its place."""
    n = last_place(queue) - wp.int32(claim(counts, kind, column, _CONTACT) >> wp.int64(32))
    queue.pairs[n] = pair
    return n


@wp.func
def num_open(count: wp.int64) -> int:
    """The number of places that the first kernel has given to open pairs, by the count of a queue."""
    return wp.int32(count)


@wp.func
def num_taken(count: wp.int64) -> int:
    """The number of places that are taken."""
    return wp.int32(count) + wp.int32(count >> wp.int64(32))


@wp.func
def place_of(n: int, count: wp.int64, queue: Queue) -> int:
    """The n-th place that is taken."""
    return wp.where(n < num_open(count), n, last_place(queue) - n + num_open(count))
