"""The queue between the kernels of the narrow phase on CUDA: its arrays, and the launches that work it off."""

from collections.abc import Sequence
from typing import Any

import warp as wp

# Bytes of a place in the queue: its row, the time reached and the iterations so far.
QUEUE_BYTES = 4 + 8 + 1


def queue_of(rows: wp.array, t: wp.array, used: wp.array) -> Any:
    """A queue in the given arrays: int32, float64 and int8."""
    from ccd_warp.kernels.narrow_phase.queued_pairs import Queue  # not before a step needs it

    queue = Queue()
    queue.rows, queue.t, queue.used = rows, t, used
    return queue


def new_queue(count: int, device: Any) -> Any:
    """A queue with a place for each of ``count`` pairs."""
    return queue_of(*(wp.empty(count, dtype=dtype, device=device) for dtype in (wp.int32, wp.float64, wp.int8)))


def launch_queued(launcher: Any, kernels: Sequence[Any], most_pairs: int, inputs: list, outputs: list) -> None:
    """Launch, or record, the kernels of a round: all pairs, the first in the queue, and what these leave open.

    Args:
        launcher: An ``Execution`` or a ``Recording``.
        kernels: The kernels of one name of ``queued_pairs``.
        most_pairs: Number of pairs, or the most that there can be.
        inputs: Inputs of the kernels after the number of threads.
        outputs: Their outputs.
    """
    from ccd_warp.kernels.narrow_phase.queued_pairs import MOST_SOLVERS, WARP

    for kernel, most in zip(kernels, MOST_SOLVERS.values(), strict=True):
        solvers = min(most, most_pairs * WARP)
        launcher.launch(kernel, solvers, inputs=[solvers, *inputs], outputs=outputs, grain=1)
