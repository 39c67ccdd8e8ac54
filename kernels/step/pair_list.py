"""The pairs of primitives of a mesh that a search has found, of one kind, and a round of the narrow phase over them."""

import warp as wp

from ..pair_key import pair_of
from .minima import FOUND


@wp.struct
class PairList:
    """Pairs of primitives of one kind by their keys, and where their vertices are in a step."""

    kind: int
    counts: wp.array2d[wp.int64]  # of the pairs of each kind; the columns are those of `minima`
    keys: wp.array[wp.int64]  # that of a pair that the first round has left open is its complement
    first_corners: wp.array[wp.vec3i]
    second_corners: wp.array[wp.vec3i]
    vertices_t0: wp.array[wp.vec3d]
    vertices_t1: wp.array[wp.vec3d]


@wp.struct
class PairVertices:
    """A pair of primitives, and the vertices of each, of which some repeat."""

    pair: wp.vec2i
    first: wp.vec3i
    second: wp.vec3i


@wp.struct
class Round:
    """A round of the narrow phase, and what becomes of contacts in it."""

    is_second: int  # 1: the second round, of the pairs that the first has marked as open
    only_moving: int  # 1: a stationary pair is not solved, so it may touch
    gaps_moved: wp.float64  # above 0: a toi near 0 is raised to the time in which the pair moves by this many gaps


@wp.struct
class LeastToi:
    """The least toi, where no contacts are kept."""

    bits: wp.array[wp.int64]  # as integers, the bits of two non-negative numbers compare as the numbers do
    open_toi: wp.array[wp.float64]  # beside each key of a pair that the first round leaves open: its toi so far


@wp.func
def num_found(pairs: PairList) -> wp.int64:
    """The number of pairs in the list; the search may have found more."""
    return wp.min(pairs.counts[pairs.kind, FOUND], wp.int64(pairs.keys.shape[0]))


@wp.func
def vertices_of_pair(pairs: PairList, k: int) -> PairVertices:
    """The vertices of a pair, given by its place in the list."""
    key = pairs.keys[k]
    r = PairVertices()
    r.pair = pair_of(wp.where(key < wp.int64(0), ~key, key))
    r.first = pairs.first_corners[r.pair[0]]
    r.second = pairs.second_corners[r.pair[1]]
    return r
