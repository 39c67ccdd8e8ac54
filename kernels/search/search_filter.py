"""Which of the pairs that a search finds the mesh excludes: by its rules, and in a search with lists by those."""

import warp as wp

from ..parameters import with_lists
from .collision_filter import are_bodies_listed, is_excluded, is_listed
from .search_types import Search, is_turned


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
