"""A tree of boxes without pointers: boxes along a space-filling curve, sixteen to a block, sixteen blocks to a node.

**Frames.** A box is kept for each frame: one, the box swept over the whole step, where boxes are what is asked for; or
two, the boxes at both ends of the step, where contacts are. A point of a primitive moves on a line, so between the ends
it lies in the box interpolated between theirs, and two primitives whose boxes are on the same sides of each other along
one axis at both ends are so all the while. Things that move together have large swept boxes, and do not meet by this
test.

Boxes are sorted by a key (size class, Morton code of the centre), so neighbours in the list are neighbours in space.
Sixteen boxes that follow each other are a **block**, kept as six rows of sixteen float32 numbers a frame. Level 0 is
the boxes themselves; box n of level k + 1 is the union of block n of level k, up to a level of a single block, level 1
or above. Nothing else is stored: which boxes lie under which follows from their places. The order decides on speed
alone.

**float32 without rounding outward.** A coordinate x becomes f(x) = float32((x/2 - origin/2) · 2 scale), with a scale
that is a power of two. The difference, the product and both roundings are monotone, so a <= b implies f(a) <= f(b), for
any finite input: boxes that overlap in float64 overlap in the image, and nothing is missed. And f(a) < f(b) implies
a < b: a pair whose images overlap strictly on every side overlaps for certain. Only where two images are equal does the
exact float64 test of the two boxes decide. And since f(min(a, b)) = min(f(a), f(b)), the image of a primitive's box is
the union of the images of its vertices' boxes, which are made once a step: the **vertex_aabbs**.

**Worlds.** Scenes that know nothing of each other may lie in one place. Each is moved, in the image, to a cell of its
own of a lattice: one more rounded sum that is monotone within a world, so nothing is missed there, and the filter of
the mesh leaves out what still meets across.

**Sizes.** One giant box would make every ancestor giant. Boxes are classed by extent in factors of eight above the
typical one, and the class is the most significant part of the key, so that the large ones keep to themselves.

References: Karras 2012, "Maximizing parallelism in the construction of BVHs, octrees, and k-d trees" (Morton order);
Wald et al. 2008, "Getting rid of packets" (one ray against a wide node).
"""

import warp as wp

from .boxes import end_box, inflated, point_box, united
from .lanes import united_vertex_aabbs, vec8f, write_leaves, write_union

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

WIDTH = wp.constant(16)  # boxes of a block
BLOCK_FLOATS = wp.constant(96)
BLOCK_CORNERS = wp.constant(48)
VERTEX_AABB_FLOATS = wp.constant(8)  # floats of a record
CLASS_BITS = 3

_HALF = wp.constant(wp.float64(0.5))
_LARGEST_CLASS = wp.constant(2**CLASS_BITS - 1)
_INFINITY = wp.constant(wp.float32(wp.inf))

vec8i = wp.types.vector(length=8, dtype=wp.int32)
vec3ul = wp.types.vector(length=3, dtype=wp.uint64)


@wp.struct
class BoxTree:
    """Boxes of one set of primitives, in the order of the tree."""

    num_boxes: int
    num_levels: int
    num_aabbs: int
    block_begin: vec8i  # first block of each level
    # a block, a frame: lower x, y, z, upper x, y, z of sixteen boxes; inf and -inf where there is none
    nodes: wp.array[wp.float32]
    primitive: wp.array[wp.int32]
    corners: wp.array[wp.int32]  # a block: three vertices of sixteen primitives


@wp.func
def box_corners(tree: BoxTree, place: int) -> wp.vec3i:
    """Vertices of the primitive at a place of the tree."""
    first = (place / WIDTH) * BLOCK_CORNERS + place % WIDTH
    return wp.vec3i(tree.corners[first], tree.corners[first + WIDTH], tree.corners[first + 2 * WIDTH])


@wp.struct
class Quantization:
    """The map f, and what the keys are made from."""

    origin: wp.vec3d
    scale: wp.float64  # a power of two: most of the scene maps to [-1/2, 1/2]
    typical_extent: wp.float32  # of a primitive, in the image


@wp.func
def quantized(x: wp.vec3d, quantization: Quantization) -> wp.vec3f:
    """f: monotone in every component; halves, so that the difference of two finite numbers is finite."""
    y = (_HALF * x - _HALF * quantization.origin) * (quantization.scale + quantization.scale)
    return wp.vec3f(wp.float32(y[0]), wp.float32(y[1]), wp.float32(y[2]))


@wp.func
def vertex_aabb(
    v: int,
    vertex_world: wp.array[wp.int32],
    world_shift: wp.array[wp.vec3f],
    vertices_t0: wp.vec3d,
    vertices_t1: wp.vec3d,
    t_end: wp.float64,
    inflation: wp.float64,
    quantization: Quantization,
    num_aabbs: int,
    n: int,
) -> vec8f:
    """The record of a vertex for frame n; empty where a coordinate is no number."""
    box = point_box(vertices_t0)
    if num_aabbs == 1:
        box = united(box, end_box(vertices_t0, vertices_t1, t_end))
    elif n == 1:
        box = end_box(vertices_t0, vertices_t1, t_end)
    box = inflated(box, inflation)
    shift = wp.vec3f()
    if world_shift.shape[0] > 0:
        shift = world_shift[vertex_world[v]]
    lower = quantized(box.lower, quantization) + shift
    upper = quantized(box.upper, quantization) + shift
    if not (lower[0] <= upper[0] and lower[1] <= upper[1] and lower[2] <= upper[2]):
        lower = wp.vec3f(_INFINITY, _INFINITY, _INFINITY)
        upper = -lower
    zero = wp.float32(0.0)
    return vec8f(lower[0], lower[1], lower[2], zero, -upper[0], -upper[1], -upper[2], zero)


@wp.func
def write_vertex_aabb(vertex_aabbs: wp.array[wp.float32], place: int, aabb: vec8f):
    """Put a record in its place."""
    for k in range(VERTEX_AABB_FLOATS):
        vertex_aabbs[place * VERTEX_AABB_FLOATS + k] = aabb[k]


@wp.kernel
def fill_vertex_aabbs(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    vertex_body: wp.array[wp.int32],
    body_active: wp.array[wp.int32],
    vertex_world: wp.array[wp.int32],
    world_shift: wp.array[wp.vec3f],
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    t_end: wp.float64,
    inflation: wp.float64,
    quantization: Quantization,
    num_aabbs: int,
    # out
    vertex_aabbs: wp.array[wp.float32],
):
    """The image of each vertex's box, (lower, 0, -upper, 0) a frame: a union is a minimum. Empty if inactive."""
    v = vertices[begin + wp.tid()]
    for n in range(num_aabbs):
        aabb = vec8f(_INFINITY)
        if body_active[vertex_body[v]] != 0:
            aabb = vertex_aabb(
                v,
                vertex_world,
                world_shift,
                vertices_t0[v],
                vertices_t1[v],
                t_end,
                inflation,
                quantization,
                num_aabbs,
                n,
            )
        write_vertex_aabb(vertex_aabbs, v * num_aabbs + n, aabb)


@wp.func
def node_place(tree: BoxTree, level: int, n: int, end: int) -> int:
    """Where the numbers of box n of a level begin."""
    return ((tree.block_begin[level] + n / WIDTH) * tree.num_aabbs + end) * BLOCK_FLOATS + n % WIDTH


@wp.func
def write_nothing(tree: BoxTree, level: int, n: int):
    """Leave box n of a level empty: it overlaps none but an infinite one."""
    for f in range(tree.num_aabbs):
        at = node_place(tree, level, n, f)
        for k in range(3):
            tree.nodes[at + k * WIDTH] = _INFINITY
            tree.nodes[at + (k + 3) * WIDTH] = -_INFINITY


@wp.func
def unite(tree: BoxTree, level: int, n: int, count: int):
    """Write box n of the ``count`` boxes of a level; after the last of them nothing, up to the end of its block."""
    for f in range(tree.num_aabbs):
        block = (tree.block_begin[level - 1] + n) * tree.num_aabbs + f
        write_union(tree.nodes, block, node_place(tree, level, n, f))
    if n == count - 1:
        for m in range(count, (count + WIDTH - 1) / WIDTH * WIDTH):
            write_nothing(tree, level, m)


@wp.func
def spread_bits(x: wp.uint64) -> wp.uint64:
    """Put two zeros between the lowest 21 bits."""
    x = (x | (x << wp.uint64(32))) & wp.uint64(0x1F00000000FFFF)
    x = (x | (x << wp.uint64(16))) & wp.uint64(0x1F0000FF0000FF)
    x = (x | (x << wp.uint64(8))) & wp.uint64(0x100F00F00F00F00F)
    x = (x | (x << wp.uint64(4))) & wp.uint64(0x10C30C30C30C30C3)
    return (x | (x << wp.uint64(2))) & wp.uint64(0x1249249249249249)


@wp.kernel
def sort_keys(
    begin: int,
    # in
    corners: wp.array[wp.vec3i],
    vertex_aabbs: wp.array[wp.float32],
    num_aabbs: int,
    quantization: Quantization,
    morton_bits: int,
    index_bits: int,
    # out
    keys: wp.array[wp.int64],
):
    """Key of each primitive: size class, Morton code, index. Rounded anyhow: the order is free."""
    i = begin + wp.tid()
    c = corners[i] * num_aabbs
    r = united_vertex_aabbs(vertex_aabbs, c[0], c[1], c[2])
    if num_aabbs == 2:
        ends = united_vertex_aabbs(vertex_aabbs, c[0] + 1, c[1] + 1, c[2] + 1)
        for k in range(8):
            r[k] = wp.min(r[k], ends[k])
    largest = wp.float32((wp.int32(1) << morton_bits) - 1)
    places = vec3ul()
    longest = wp.float32(0.0)
    for k in range(3):
        place = (wp.float32(0.5) * (r[k] - r[k + 4]) + wp.float32(0.5)) * largest
        place = wp.where(place > wp.float32(0.0), wp.where(place < largest, place, largest), wp.float32(0.0))
        places[k] = spread_bits(wp.uint64(wp.uint32(place)))
        longest = wp.max(longest, -r[k] - r[k + 4])
    code = places[0] | (places[1] << wp.uint64(1)) | (places[2] << wp.uint64(2))
    size = wp.int32(0)
    limit = wp.float32(8.0) * quantization.typical_extent
    while size < _LARGEST_CLASS and longest > limit:
        longest = longest * wp.float32(0.125)
        size += 1
    key = (wp.uint64(size) << wp.uint64(3 * morton_bits)) | code
    keys[i] = wp.int64((key << wp.uint64(index_bits)) | wp.uint64(i))


@wp.kernel
def apply_order(
    begin: int,
    # in
    order: wp.array[wp.int64],
    index_mask: wp.int64,
    ids: wp.array[wp.int32],
    corners: wp.array[wp.vec3i],
    # out
    primitive: wp.array[wp.int32],
    block_corners: wp.array[wp.int32],
):
    """Lay a block of primitives out in the order of their keys, or of their plain indices."""
    b = begin + wp.tid()
    for lane in range(WIDTH):
        place = b * WIDTH + lane
        c = wp.vec3i(-1, -1, -1)
        if place < ids.shape[0]:
            i = wp.int32(order[place] & index_mask)
            c = corners[i]
            primitive[place] = ids[i]
        for k in range(3):
            block_corners[b * BLOCK_CORNERS + lane + k * WIDTH] = c[k]


@wp.func
def fill_block(vertex_aabbs: wp.array[wp.float32], num_corners: int, tree: BoxTree, b: int):
    """Fill block b of level 0 from the vertex_aabbs of its vertices, and its union on level 1."""
    write_leaves(vertex_aabbs, tree.num_aabbs, tree.corners, num_corners, tree.nodes, b, tree.num_boxes - b * WIDTH)
    unite(tree, 1, b, (tree.num_boxes + WIDTH - 1) / WIDTH)


@wp.func
def unite_from(tree: BoxTree, first_level: int, count: int):
    """All levels from one of so many boxes on."""
    n = wp.int32(count)
    for level in range(first_level, tree.num_levels):
        for k in range(n):
            unite(tree, level, k, n)
        n = (n + WIDTH - 1) / WIDTH


@wp.kernel
def fill_blocks(
    begin: int,
    # in
    vertex_aabbs: wp.array[wp.float32],
    num_corners: int,
    # out
    tree: BoxTree,
):
    """`fill_block` for every block."""
    fill_block(vertex_aabbs, num_corners, tree, begin + wp.tid())


@wp.kernel
def unite_blocks(
    begin: int,
    # in
    level: int,
    count: int,
    # out
    tree: BoxTree,
):
    """Box n of a level from block n of the level below."""
    unite(tree, level, begin + wp.tid(), count)


@wp.kernel
def unite_levels(
    begin: int,  # a single item
    # in
    first_level: int,
    count: int,
    # out
    tree: BoxTree,
):
    """All levels from one on in a single thread: there is little left of them, and a launch costs more."""
    unite_from(tree, first_level, count)
