"""The options of a query in the form that the kernels take."""

import warp as wp

from ..parameters import real
from .turns import Turns

# Codes of the option ``method``.
CLIPPING = wp.constant(0)
BISECTION = wp.constant(1)


@wp.struct
class Options:
    """Options of a query."""

    tolerance: wp.float64
    minimum_separation: wp.float64  # a length; a multiple of that of a pair if it is a box and there is no length scale
    start_gap_fraction: wp.float64  # 0: the minimum separation applies to every pair
    length_scale: wp.float64  # 0: the length scale of each pair itself
    t_max: wp.float64
    t_end: real  # t_max rounded up
    first_iterations: int  # limit for a pair in the first round of a step
    max_iterations: int
    max_work: wp.int64  # iterations of all pairs of a kind that the first round leaves open
    method: int
    stop: wp.array[wp.int32]  # set when the host wants the kernel to end
    radius: wp.array[wp.float64]  # of each vertex of a mesh; empty without (`thickness`)
    start_distance: wp.array[wp.float64]  # how near each vertex was to anything, as share and length; or empty
    margin: wp.float64  # of a pair that keeps its start distance: by what it is reduced, a share of its size
    sagitta: wp.vec3d  # of a pair on arcs: how far its points may be from their chords, per axis
    turns: Turns  # empty where nothing turns


@wp.func
def share_of_work(options: Options, num_open: wp.int64) -> int:
    """Iterations of each pair that the first round left open; ``Options.share_of_work`` on the host is the same."""
    share = wp.max(options.max_work / num_open, wp.int64(options.first_iterations))
    return wp.int32(wp.min(share, wp.int64(options.max_iterations)))
