"""The tape of Warp on which the caller records what is to be differentiated."""

from typing import Any

import warp as wp


def active_tape() -> Any:
    """The ``wp.Tape`` whose block is entered, or None."""
    runtime: Any = wp._src.context.runtime  # Warp has no public name for it; None before it is initialised
    return None if runtime is None else runtime.tape


def wants_gradient(*arrays: Any) -> bool:
    """Whether one of these is an array of Warp that requires a gradient, and a tape is recording."""
    return any(isinstance(x, wp.array) and bool(x.requires_grad) for x in arrays) and active_tape() is not None
