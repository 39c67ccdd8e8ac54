"""What a search for pairs of boxes is given: the boxes, the options of the step, a range of items, and its outputs.

And how it writes a pair.
"""

import warp as wp

from ..boxes.box_tree import BoxTree
from ..pair_key import pair_key
from ..step.minima import Minima, mark_overflow
from ..step.step import Step
from .collision_filter import CollisionFilter

# The stage at which a search ends.
BOXES = "boxes"  # it reports every pair whose boxes overlap
CULL = "cull"  # it reports the pairs that the cull leaves open
LIST = "list"  # it lists the candidates of a kernel that culls them afterwards


@wp.struct
class TreePair:
    """The pair kind of a search between a query tree and a target tree."""

    kind: int
    within: int  # 1: query and target are the same set
    symmetric: int  # 1: both primitives are of one kind, and the lower index comes first
    swapped: int  # 1: the query is the second primitive of a pair
    num_query_corners: int
    num_target_corners: int
    prunes: int  # 1: some of the bodies may not meet, so that boxes may hold no partner of a query
    rise: int  # of spatial hashes: the least number of levels by which the targets are above the query


@wp.struct
class SearchOptions:
    """Options of a search that are the same in all its launches."""

    t_end: wp.float64
    inflation: wp.float64  # of each box on every side
    separation: wp.float64  # minimum separation or distance, a length
    is_euclidean: int  # 1: a distance
    stop: wp.array[wp.int32]  # set when the host wants the search to end
    radius: wp.array[wp.float64]  # of each vertex, for the cull; empty without (`thickness`)
    box_radius: wp.array[wp.float64]  # by which the boxes of each vertex have grown; empty without


@wp.struct
class SearchRange:
    """The items that a launch searches, and where it counts and writes the pairs."""

    first: int  # item; on CUDA query
    stride: int  # between two items; on CUDA the number of queries of one
    level: int  # of the items in the tree of the queries: 1, blocks; 0, single boxes
    end: int  # on CUDA: the query after the last
    num_warps: int  # on CUDA: that share the items
    shares: int  # on CUDA: warps that take an item, each with its share of the blocks at the leaves
    row: int  # of the counts
    first_key: int  # of a search without the cull, which writes to a part of the keys
    capacity: int  # of that part, in keys; or of the list of candidates
    marks_overflow: int  # 1: no caller checks the count, so the toi of a pair beyond the capacity becomes 0


@wp.struct
class Search:
    """The arguments of a search, which its kernel gathers once for all functions below it."""

    part: SearchRange
    query: BoxTree
    target: BoxTree
    tree_pair: TreePair
    options: SearchOptions
    collision_filter: CollisionFilter
    step: Step
    keys: wp.array[wp.int64]  # of pairs; or of candidates, of a search that lists them


@wp.struct
class Searched:
    """What one of two searches that share a launch on CUDA has for itself; the second may have no warps."""

    part: SearchRange
    query: BoxTree
    target: BoxTree
    tree_pair: TreePair
    keys: wp.array[wp.int64]


@wp.struct
class Candidates:
    """On CUDA, the candidates of a kind, and where the keys of those go that the cull leaves."""

    part: SearchRange  # whose row is the kind
    num_threads: int  # whole warps
    candidates: wp.array[wp.int64]
    first_corners: wp.array[wp.vec3i]
    second_corners: wp.array[wp.vec3i]
    keys: wp.array[wp.int64]


@wp.func
def search_of(of: Searched, options: SearchOptions, collision_filter: CollisionFilter, step: Step) -> Search:
    """The arguments of one of two searches."""
    return Search(of.part, of.query, of.target, of.tree_pair, options, collision_filter, step, of.keys)


@wp.func
def is_turned(tree_pair: TreePair, query: int, target: int) -> bool:
    """Whether the target is the first primitive of a pair: of two of one kind, whatever is searched, the lower one."""
    if tree_pair.symmetric != 0:
        return target < query
    return tree_pair.swapped != 0


@wp.func
def write_pair(
    first: int,
    second: int,
    a: wp.vec3i,  # vertices of the first primitive
    b: wp.vec3i,
    n: wp.int64,
    part: SearchRange,
    keys: wp.array[wp.int64],
    minima: Minima,
):
    """Write the key of pair n; beyond the capacity lower its toi where no caller checks the count."""
    if n < wp.int64(keys.shape[0]):
        keys[n] = pair_key(first, second)
    elif part.marks_overflow != 0:
        mark_overflow(minima, a, b)
