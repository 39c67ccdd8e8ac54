"""The tape of Warp on which the caller records what is to be differentiated."""

from typing import Any

import warp as wp


def active_tape() -> Any:
    """The ``wp.Tape`` whose block is entered, or None."""
    runtime: Any = wp._src.context.runtime  # Warp has no public name for it
    return runtime.tape


def wants_gradient(*arrays: Any) -> bool:
    """Whether a tape is recording and one of these is an array of Warp that requires a gradient."""
    if active_tape() is None:
        return False
    return any(isinstance(array, wp.array) and bool(array.requires_grad) for array in arrays)
