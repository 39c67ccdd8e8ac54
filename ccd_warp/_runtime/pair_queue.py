"""The queue between the kernels of the narrow phase on CUDA: its arrays, and the launches that work it off."""

from collections.abc import Mapping
from typing import Any

import warp as wp

from ccd_warp._runtime.launch import Execution, Recording
from ccd_warp._runtime.structs import dtypes_of, struct_of
from ccd_warp.kernels.narrow_phase.pair_queue import Queue


def queue_dtypes(*, keeps_contacts: bool) -> dict[str, Any]:
    """The types of the arrays of a queue by their names."""
    return {name: dtype for name, dtype in dtypes_of(Queue).items() if keeps_contacts or name != "contact"}


def queue_bytes(*, keeps_contacts: bool) -> int:
    """Bytes of a place in a queue."""
    return sum(map(wp.types.type_size_in_bytes, queue_dtypes(keeps_contacts=keeps_contacts).values()))


def new_queue(count: int, device: wp.Device, *, keeps_contacts: bool) -> Any:
    """A queue with a place for each of ``count`` pairs."""
    dtypes = queue_dtypes(keeps_contacts=keeps_contacts)
    return struct_of(Queue, {name: wp.empty(count, dtype=dtype, device=device) for name, dtype in dtypes.items()})


def launch_queued(
    launcher: Execution | Recording, kernels: Mapping[str, Any], most_pairs: int, inputs: list, outputs: list
) -> None:
    """Launch, or record, the kernels of a round: all pairs, the first in the queue, and what these leave open.

    Args:
        launcher: Where to launch, or what records it.
        kernels: Those of ``queued_kernels``.
        most_pairs: Number of pairs, or the most that there can be.
        inputs: Inputs of the kernels after the number of threads.
        outputs: Their outputs.
    """
    from ccd_warp.kernels.narrow_phase.queued_launch import MOST_SOLVERS, WARP

    for stage, kernel in kernels.items():
        solvers = min(MOST_SOLVERS[stage], most_pairs * WARP)
        launcher.launch(kernel, solvers, inputs=[solvers, *inputs], outputs=outputs, grain=1)
