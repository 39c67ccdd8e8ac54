"""The cull of single candidates, and its kernel on CUDA: one candidate in each thread.

In the walk of a search few threads of a warp find a candidate at the same time, and the others would wait while it is
culled. On CUDA a search therefore writes candidates to a list, which then fills all threads. What the cull leaves open
is the same in every order.
"""

import warp as wp

from ..atomics import claim
from ..boxes.thickness import distance_of
from ..narrow_phase.whole_warp import claim_for, number_in_warp, threads_where
from ..pair.single_points import corners, points_of
from ..pair_key import pair_of
from ..parameters import is_thick
from ..step.minima import ANY_UNLISTED, CANDIDATES, FOUND
from ..step.step import Step
from ..template import specialised
from .search_types import Candidates, SearchOptions, write_pair

_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))


cull = specialised("search.cull", is_thick=is_thick)
module = wp.get_module(f"ccd_warp.candidate_cull{'.thick' if is_thick else ''}")
# 156 registers: twelve warps fit on a multiprocessor (sixteen with 128, which spill 64 bytes), and small blocks bring
# few candidates to all of them
wp.set_module_options({"enable_backward": False, "fuse_fp": False, "block_dim": 64}, module=module)


@wp.func
def is_discarded(
    kind: int,
    a: wp.vec3i,  # vertices of the first primitive
    b: wp.vec3i,
    step: Step,
    options: SearchOptions,
) -> bool:
    """Whether a test of the cull proves that a candidate does not touch in the step."""
    if cull.has_volume(kind):
        c0 = corners(kind, points_of(kind, a, b, step.vertices_t0))
        c1 = corners(kind, points_of(kind, a, b, step.vertices_t1))
        if wp.static(is_thick):
            distance = distance_of(options.separation, options.radius, a, b)
            return cull.free_lanes(kind, c0, c1, distance, options.is_euclidean, options.t_end, _ONE) != _NONE
        return cull.free_lanes(kind, c0, c1, options.separation, options.is_euclidean, options.t_end, _ONE) != _NONE
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
        pair = wp.vec2i()
        a = wp.vec3i()
        b = wp.vec3i()
        is_open = n < count
        if is_open:
            pair = pair_of(of.candidates[n])
            a = of.first_corners[pair[0]]
            b = of.second_corners[pair[1]]
            is_open = not is_discarded(kind, a, b, step, options)
        threads = threads_where(is_open)
        if threads != _NONE:
            place = claim_for(threads, step.counts, kind, FOUND)
            if is_open:
                write_pair(pair[0], pair[1], a, b, place, of.part, of.keys, step.minima)


@wp.kernel(module=module, grid_stride=False)
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
