"""Launches on a tape of their own, for functions that other libraries differentiate."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from typing import Any

import warp as wp

from ccd_warp._results.device_results import LaunchResult
from ccd_warp._runtime.status import LaunchFlag


def launched(launch: Callable[..., LaunchResult], arrays: Sequence[wp.array]) -> tuple[Any, LaunchResult]:
    """A tape on which a launch with these arrays is recorded, None where none requires a gradient, and its result.

    Raises:
        ValueError: If coordinates are not finite, or static bodies move.
        RuntimeError: If a capacity was too small for the result, or for its gradient.
    """
    tape = wp.Tape() if any(x.requires_grad for x in arrays) else None
    with nullcontext() if tape is None else tape:
        result = launch(*arrays)
    device = result.toi.device
    assert device is not None
    if device.is_cuda and device.is_capturing:
        return tape, result
    flags = LaunchFlag(int(result.flags.numpy()[0]))
    if flags & LaunchFlag.INVALID_INPUT:
        raise ValueError("vertices_t0 or vertices_t1 hold coordinates that are not finite")
    if flags & LaunchFlag.STATIC_MOVED:
        raise ValueError("vertices_t1 moves vertices of static bodies; expected them where they are in vertices_t0")
    needed = LaunchFlag.PAIRS_OVERFLOW
    if tape is not None:
        needed |= LaunchFlag.CONTACTS_OVERFLOW
    if flags & needed:
        pairs, contacts = int(result.num_pairs.numpy().max()), result.to_host().num_contacts
        raise RuntimeError(
            f"the launch has {flags & needed!r}, with {pairs:,} pairs of a kind and {contacts:,} contacts; expected "
            f"capacities of twice as many, by pipeline.reserve(max_pairs=..., max_contacts=...)"
        )
    return tape, result


def play_back(tape: Any, arrays: Sequence[wp.array], result: wp.array, gradient: wp.array) -> None:
    """Give the arrays of a launch the gradients that follow from that of its result, in new arrays."""
    for array in arrays:
        if array.requires_grad:
            array.grad = wp.zeros_like(array, requires_grad=False)
    result.grad = gradient
    tape.backward()
