"""Which of the pairs that a search finds the mesh excludes: by its rules, and in a search with lists by those."""

import warp as wp

from ..boxes.box_tree import WIDTH, box_corners
from ..boxes.lanes import lowest_bit
from ..parameters import with_lists
from .collision_filter import are_bodies_listed, is_excluded, is_listed, may_groups_meet
from .search_types import Search, is_turned

_NONE = wp.constant(wp.uint32(0))
_ONE = wp.constant(wp.uint32(1))


@wp.func
def groups_of(search: Search, first: int, is_block: int) -> wp.vec2i:
    """The lowest and the highest group of the bodies of a query, or of the block that begins with it."""
    groups = wp.vec2i()
    if search.tree_pair.prunes != 0:
        if is_block != 0:
            groups = search.query.groups[first / WIDTH]
        else:
            group = search.collision_filter.vertex_group[box_corners(search.query, first)[0]]
            groups = wp.vec2i(group, group)
    return groups


@wp.func
def has_partners(search: Search, groups: wp.vec2i, box: int) -> bool:
    """Whether a box, by its number among those of inner levels, holds a body which one of some groups may meet."""
    if search.tree_pair.prunes != 0:
        return may_groups_meet(groups, search.target.groups[box], search.collision_filter)
    return True


@wp.func
def with_partners(search: Search, groups: wp.vec2i, block: int, lanes: wp.uint32) -> wp.uint32:
    """Those boxes of an inner block in a mask that hold a body which one of some groups may meet."""
    mask = wp.uint32(lanes)
    if search.tree_pair.prunes != 0:
        left = wp.uint32(lanes)
        first = (block - search.target.block_begin[1]) * WIDTH
        while left != _NONE:
            lane = lowest_bit(left)
            left = left & (left - _ONE)
            if not has_partners(search, groups, first + lane):
                mask = mask & ~(_ONE << wp.uint32(lane))
    return mask


@wp.func
def is_pair_listed(search: Search, q: int, p: int, a: wp.vec3i, b: wp.vec3i) -> bool:
    """Whether the mesh lists the pair of a query and a target, or of their bodies."""
    body_a = search.collision_filter.vertex_body[a[0]]
    body_b = search.collision_filter.vertex_body[b[0]]
    if are_bodies_listed(body_a, body_b, search.collision_filter):
        return True
    if search.collision_filter.by_listed_pair != 0:
        i = search.query.primitive[q]
        j = search.target.primitive[p]
        if is_turned(search.tree_pair, i, j):
            return is_listed(search.tree_pair.kind, j, i, search.collision_filter)
        return is_listed(search.tree_pair.kind, i, j, search.collision_filter)
    return False


@wp.func
def is_left_out(search: Search, q: int, p: int, a: wp.vec3i, b: wp.vec3i) -> bool:
    """Whether the mesh excludes a query and a target that share no vertex, given by their places and vertices."""
    if is_excluded(a, b, search.collision_filter):
        return True
    if wp.static(with_lists):
        return is_pair_listed(search, q, p, a, b)
    return False
