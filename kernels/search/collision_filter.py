"""The collision filter of a mesh: which pairs of primitives are excluded from the search."""

import warp as wp

from ..pair_key import pair_key

wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class CollisionFilter:
    """The pairs that the mesh excludes, in addition to those that share a vertex."""

    applies: int  # 1: some of what follows applies
    by_body: int  # 1: the next two arrays apply
    vertex_body: wp.array[wp.int32]
    self_collision: wp.array[wp.int32]  # per body
    by_pair: int  # 1: the next array applies
    body_pairs: wp.array2d[wp.uint8]
    by_world: int  # 1: the next array applies
    vertex_world: wp.array[wp.int32]
    by_ring: int  # 1: the next two arrays apply
    ring_begin: wp.array[wp.int32]  # per vertex, and one more at the end
    ring: wp.array[wp.int32]  # the vertices in the rings around each vertex, or paired with it, ascending
    by_listed_body: int  # 1: pairs of bodies are listed
    by_listed_pair: int  # 1: pairs of primitives are listed
    listed_begin: wp.array[wp.int32]  # first key of each pair kind, then of the bodies, and the end
    listed: wp.array[wp.int64]  # keys of the listed pairs, ascending for each kind
    # Groups of bodies that may meet the same bodies; empty arrays where all may meet.
    vertex_group: wp.array[wp.int32]
    meets_itself: wp.array[wp.int32]  # per group
    groups_below: wp.array2d[wp.int32]  # pairs of groups that may meet, of lower numbers than a row and a column
    group_shift: int  # bits by which the number of a group is shifted to that of a row


# In place of a pair kind: pairs of bodies.
BODIES = wp.constant(4)


@wp.func
def is_listed(kind: int, first: int, second: int, collision_filter: CollisionFilter) -> bool:
    """Whether a pair is among the listed ones of its kind, by binary search; of one kind the lower index is first."""
    key = pair_key(first, second)
    low = collision_filter.listed_begin[kind]
    high = collision_filter.listed_begin[kind + 1]
    end = high
    while low < high:
        middle = low + (high - low) / 2
        if collision_filter.listed[middle] < key:
            low = middle + 1
        else:
            high = middle
    if low < end:
        return collision_filter.listed[low] == key
    return False


@wp.func
def are_bodies_listed(a: int, b: int, collision_filter: CollisionFilter) -> bool:
    """Whether a pair of bodies is listed."""
    if collision_filter.by_listed_body != 0:
        return is_listed(BODIES, wp.min(a, b), wp.max(a, b), collision_filter)
    return False


@wp.func
def are_bodies_excluded(a: int, b: int, collision_filter: CollisionFilter) -> bool:
    """Whether the mesh excludes all pairs of primitives of two different bodies."""
    if collision_filter.by_pair != 0:
        if collision_filter.body_pairs[a, b] == wp.uint8(0):
            return True
    return are_bodies_listed(a, b, collision_filter)


@wp.func
def may_groups_meet(a: wp.vec2i, b: wp.vec2i, collision_filter: CollisionFilter) -> bool:
    """Whether bodies of two ranges of groups, each given by its ends, may meet; an empty one ends with -1."""
    if a[0] == a[1] and b[0] == a[0] and b[1] == a[0]:
        return collision_filter.meets_itself[a[0]] != 0
    if collision_filter.groups_below.shape[0] == 0:
        return True
    shift = collision_filter.group_shift
    row = a[0] >> shift
    column = b[0] >> shift
    row_end = (a[1] >> shift) + 1
    column_end = (b[1] >> shift) + 1
    upper = collision_filter.groups_below[row_end, column_end] - collision_filter.groups_below[row_end, column]
    return upper > collision_filter.groups_below[row, column_end] - collision_filter.groups_below[row, column]


@wp.func
def is_near(v: int, c: wp.vec3i, rings: CollisionFilter) -> bool:
    """Whether a vertex of a primitive is in the rings around v, by binary search."""
    for k in range(3):
        low = rings.ring_begin[v]
        high = rings.ring_begin[v + 1]
        while low < high:
            middle = (low + high) / 2
            if rings.ring[middle] < c[k]:
                low = middle + 1
            else:
                high = middle
        if low < rings.ring_begin[v + 1]:
            if rings.ring[low] == c[k]:
                return True
    return False


@wp.func
def is_excluded(a: wp.vec3i, b: wp.vec3i, collision_filter: CollisionFilter) -> bool:
    """Whether the mesh excludes a pair of primitives that share no vertex, for another reason than a list of pairs."""
    if collision_filter.by_world != 0:
        if collision_filter.vertex_world[a[0]] != collision_filter.vertex_world[b[0]]:
            return True
    if collision_filter.by_body != 0:
        body_a = collision_filter.vertex_body[a[0]]
        body_b = collision_filter.vertex_body[b[0]]
        if body_a == body_b:
            if collision_filter.self_collision[body_a] == 0:
                return True
        elif collision_filter.by_pair != 0:
            if collision_filter.body_pairs[body_a, body_b] == wp.uint8(0):
                return True
    if collision_filter.by_ring != 0:
        return (
            is_near(a[0], b, collision_filter)
            or is_near(a[1], b, collision_filter)
            or is_near(a[2], b, collision_filter)
        )
    return False
