"""The cull of single candidates on CUDA, and its kernel: one candidate in each thread.

In the walk of a search few threads of a warp find a candidate at the same time, and the others would wait while it is
culled. On CUDA a search therefore writes candidates to a list, which then fills all threads. What the cull leaves open
is the same in every order.
"""

import warp as wp

from ..atomics import claim
from ..boxes.thickness import distance_of
from ..narrow_phase.whole_warp import claim_for, number_in_warp, threads_where
from ..pair.simd import bits_of, cross, greatest
from ..pair.single_points import corners, largest, points_of
from ..pair_key import pair_of
from ..pair_kind import VERTEX_FACE
from ..parameters import is_thick
from ..step.minima import ANY_UNLISTED, CANDIDATES, FOUND
from ..step.step import Step
from ..template import specialised
from .search_types import Candidates, SearchOptions, write_pair

_NONE = wp.constant(wp.uint32(0))


cull = specialised("search.cull", is_thick=is_thick)
module = wp.get_module(f"ccd_warp.candidate_cull{'.thick' if is_thick else ''}")
# Small blocks bring few candidates to all multiprocessors. Sixteen warps fit on each, with 128 registers; nothing is
# spilled, as a thread reads again what it would have to keep during a test.
wp.set_module_options({"enable_backward": False, "fuse_fp": False, "block_dim": 64}, module=module)


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    asm volatile("" ::: "memory");
#endif
"""
)
def forget():
    """Let a thread read again what it has read, in place of keeping it in registers."""
    ...


@wp.func
def is_free_along(
    side: int,  # number of a side, or of the third of a face
    kind: int,
    a: wp.vec3i,  # vertices of the first primitive
    b: wp.vec3i,
    distance: wp.float64,
    step: Step,
    options: SearchOptions,
) -> bool:
    """Whether a direction across a side, in the plane of both at the start, separates a candidate (`cull`)."""
    forget()
    c0 = corners(kind, points_of(kind, a, b, step.vertices_t0))
    c1 = corners(kind, points_of(kind, a, b, step.vertices_t1))
    along = c0.q
    if side == 1:
        along = c0.r
    elif side == 2:
        along = c0.q - c0.r
    d = cross(cross(c0.q, c0.r), along)
    size = greatest(largest(c0), largest(c1))
    is_triangle = kind == VERTEX_FACE
    free = cull.is_free_along(d, is_triangle, c0, c1, size, distance, options.is_euclidean, options.t_end)
    return bits_of(free) != _NONE


@wp.func
def is_discarded(
    kind: int,
    a: wp.vec3i,  # vertices of the first primitive
    b: wp.vec3i,
    step: Step,
    options: SearchOptions,
) -> bool:
    """Whether a test of the cull proves that a candidate does not touch in the step."""
    if not cull.has_volume(kind):
        return False
    distance = options.separation
    if wp.static(is_thick):
        distance = distance_of(options.separation, options.radius, a, b)
    c0 = corners(kind, points_of(kind, a, b, step.vertices_t0))
    c1 = corners(kind, points_of(kind, a, b, step.vertices_t1))
    if bits_of(cull.is_free_by_volume(c0, c1, distance, options.is_euclidean, options.t_end)) != _NONE:
        return True
    num_sides = int(2)
    if kind == VERTEX_FACE:
        num_sides = 3
    for side in range(num_sides):
        if is_free_along(side, kind, a, b, distance, step, options):
            return True
    return False


@wp.func
def cull_kind(of: Candidates, only_if_complete: int, options: SearchOptions, step: Step, thread: int):
    """Cull the candidates of a kind: those of a thread are ``num_threads`` apart."""
    kind = of.part.row
    most_listed = wp.int64(of.candidates.shape[0])
    if only_if_complete != 0 and step.counts[kind, CANDIDATES] > most_listed:
        if thread == 0:
            claim(step.counts, 0, ANY_UNLISTED, 1)
        return
    count = wp.int32(wp.min(step.counts[kind, CANDIDATES], most_listed))
    for first_of_warp in range(thread - number_in_warp(), count, of.num_threads):
        n = first_of_warp + number_in_warp()
        is_open = n < count
        if is_open:
            candidate = pair_of(of.candidates[n])
            a = of.first_corners[candidate[0]]
            b = of.second_corners[candidate[1]]
            is_open = not is_discarded(kind, a, b, step, options)
        threads = threads_where(is_open)
        if threads != _NONE:
            place = claim_for(threads, step.counts, kind, FOUND)
            if is_open:
                pair = pair_of(of.candidates[n])
                a = of.first_corners[pair[0]]
                b = of.second_corners[pair[1]]
                write_pair(pair[0], pair[1], a, b, place, of.part, of.keys, step.minima)


@wp.kernel(module=module, grid_stride=False, cuda_max_registers=128)
def cull_candidates(
    begin: int,
    # in
    only_if_complete: int,  # 1: if the list was too short, a second search culls all candidates
    options: SearchOptions,
    a: Candidates,
    b: Candidates,
    # in and out
    step: Step,
):
    """Cull the candidates of two kinds, the second of which may have no threads."""
    thread = begin + wp.tid()
    if thread < a.num_threads:
        cull_kind(a, only_if_complete, options, step, thread)
    else:
        cull_kind(b, only_if_complete, options, step, thread - a.num_threads)
