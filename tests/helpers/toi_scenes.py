"""What gradients of times of impact are asked of: arrays on a tape."""

import warp as wp


def array(values, dtype=wp.vec3d, requires_grad=True):
    """An array that requires a gradient."""
    return wp.array(values, dtype=dtype, requires_grad=requires_grad)


def taped(call):
    """A tape on which a call is recorded, and what it returns."""
    tape = wp.Tape()
    with tape:
        result = call()
    return tape, result
