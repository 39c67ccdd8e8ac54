"""What the kernels of the narrow phase on CUDA share: their modules, registers and threads, and what a thread takes."""

import warp as wp

from ..pair.norm import Norm
from ..pair.simd import fingerprint
from .whole_warp import WARP, item_of_warp

# Most registers of a thread: sixteen warps a multiprocessor for the pairs that come as they are, where the compiler by
# itself takes up to 216. The other kernels have fewer pairs, and as many registers as there are.
MAX_REGISTERS = {"first": 128, "later": 255, "last": 255, "bisection": 255, "placed": 128}
# Most threads of each kernel: about what 132 multiprocessors run at once with these registers; more pairs take turns.
MOST_SOLVERS = {"first": 1 << 16, "later": 1 << 15, "last": 1 << 15, "bisection": 1 << 15, "placed": 1 << 16}
# Threads of a block: one warp, so that a few thousand pairs reach all multiprocessors. With more than 64 registers a
# thread no more than 32 warps fit on one, as many as it can hold blocks.
BLOCK_DIM = 32
_LANES = wp.constant(WARP)


def module_of(name: str, real: type, norm: Norm, only_method: str) -> wp.Module:
    """A Warp module for each kernel, so that each has its own registers and stack."""
    module = wp.get_module(f"ccd_warp.{name}.{only_method}.{real.__name__}{norm.suffix}.{fingerprint()}")
    options = {"enable_backward": False, "fuse_fp": False, "max_unroll": 1, "block_dim": BLOCK_DIM}
    wp.set_module_options(options, module=module)
    return module


@wp.struct
class Items:
    """Which items a thread takes."""

    first: int  # the number of items if there is none
    stride: int


@wp.func
def items_of(solver: int, num_solvers: int, count: int, are_shared: bool) -> Items:
    """The items of a thread: those of its warp, or its own, by which as few lanes of a warp are used as it takes.

    So few items are spread over all multiprocessors.
    """
    num_warps = num_solvers / _LANES
    lanes = wp.min(_LANES, (count + num_warps - 1) / num_warps)
    lane = solver % _LANES
    items = Items()
    items.first = wp.where(lane < lanes, (solver / _LANES) * lanes + lane, count)
    items.stride = num_warps * lanes
    if are_shared:
        items.first = item_of_warp(solver, count)
        items.stride = num_warps
    return items
