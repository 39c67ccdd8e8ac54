"""The earliest toi of every vertex, body and world and of the scene, lowered by each contact found, and flags."""

import warp as wp

from ..atomics import atomic_min_int64, set_bits

# Flags of a world, and of the scene.
PAIRS_OVERFLOW = wp.constant(1)
CONTACTS_OVERFLOW = wp.constant(2)
INVALID_INPUT = wp.constant(4)
STATIC_MOVED = wp.constant(8)
STRUCK = wp.constant(16)
ROUNDING_LIMIT = wp.constant(32)

# Columns of the counts of a pair kind: pairs that the search found, those of them that the first round of the narrow
# phase leaves open, and pairs whose boxes overlap. A row fills a cache line, so that rows do not share one.
FOUND = wp.constant(0)
OPEN = wp.constant(1)
CANDIDATES = wp.constant(2)
# on CUDA: pairs that wait in the queue of the first round (`pair_queue`), and in that of the second
QUEUED = wp.constant(3)
# in the first row alone: those in the column `OPEN` of all kinds
ANY_OPEN = wp.constant(5)
# in the first row alone, on CUDA: the kinds that had more candidates than their list could take
ANY_UNLISTED = wp.constant(6)
# in the second row alone: the most contacts of a pass before this one
MOST_LISTED = wp.constant(6)
# the most pairs that the search has found in a pass, or a slice, before this one
MOST_FOUND = wp.constant(7)
NUM_COUNTS = 8

_ZERO_BITS = wp.constant(wp.int64(0))


@wp.struct
class Minima:
    """The earliest toi of every part, as bits: the bits of non-negative numbers compare as the numbers do."""

    vertex_body: wp.array[wp.int32]
    vertex_world: wp.array[wp.int32]  # empty where there is one world
    body_kinematic: wp.array[wp.int32]  # empty where no body is kinematic
    vertex: wp.array[wp.int64]
    body: wp.array[wp.int64]
    world: wp.array[wp.int64]
    scene: wp.array[wp.int64]
    world_flags: wp.array[wp.int32]
    flags: wp.array[wp.int32]


@wp.func
def world_of(m: Minima, v: int) -> int:
    """World of a vertex."""
    if m.vertex_world.shape[0] > 0:
        return m.vertex_world[v]
    return 0


@wp.func
def is_kinematic(m: Minima, v: int) -> bool:
    """Whether the body of a vertex is kinematic."""
    if m.body_kinematic.shape[0] > 0:
        return m.body_kinematic[m.vertex_body[v]] != 0
    return False


@wp.func
def lower_primitive(m: Minima, c: wp.vec3i, bits: wp.int64):
    """Lower the toi of a primitive's vertices and body."""
    for k in range(3):
        atomic_min_int64(m.vertex, c[k], bits)
    atomic_min_int64(m.body, m.vertex_body[c[0]], bits)


@wp.func
def lower_pair(m: Minima, a: wp.vec3i, b: wp.vec3i, bits: wp.int64):
    """Lower the toi of the vertices, bodies and world of a pair, and of the scene."""
    lower_primitive(m, a, bits)
    lower_primitive(m, b, bits)
    atomic_min_int64(m.world, world_of(m, a[0]), bits)
    atomic_min_int64(m.scene, 0, bits)


@wp.func
def flag_world(m: Minima, v: int, flag: int):
    """Set a flag of the world of a vertex, and of the scene."""
    set_bits(m.world_flags, world_of(m, v), flag)
    set_bits(m.flags, 0, flag)


@wp.func
def mark_overflow(m: Minima, a: wp.vec3i, b: wp.vec3i):
    """Handle a pair beyond the capacity: its toi becomes 0, which is never late, and the overflow flag is set."""
    lower_pair(m, a, b, _ZERO_BITS)
    flag_world(m, a[0], PAIRS_OVERFLOW)
