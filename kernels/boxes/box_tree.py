"""A tree of boxes without pointers: boxes sorted along a space-filling curve, sixteen to a block at every level.

**Swept AABB or endpoint AABBs.** A search for overlapping boxes keeps one axis-aligned bounding box (AABB) for each
primitive: the AABB swept over the whole step. A search for contacts keeps two: the AABBs at both ends of the step. A
point of a primitive moves on a line, so between the ends it lies in the box interpolated between the endpoint AABBs. If
the AABBs of two primitives are separated along one axis, in the same order at both ends, the primitives are therefore
separated along it throughout the step. Primitives that move together may have large swept AABBs that overlap although
this test separates them.

Boxes are sorted by a key (size class, Morton code of the centre), so neighbours in the list are neighbours in space.
Sixteen consecutive boxes are a **block**, stored as six rows of sixteen float32 numbers for each AABB. Level 0 consists
of the boxes themselves; box n of level k + 1 is the union of block n of level k, up to a level of a single block, which
is level 1 or above. Nothing else is stored: the place of a box determines its children. The order affects speed only.

**float32 without rounding outward.** A coordinate x is quantized to f(x) = float32((x/2 - origin/2) · 2 scale), with a
scale that is a power of two. The difference, the product and both roundings are monotone, so a <= b implies
f(a) <= f(b) for any finite input: boxes that overlap in float64 overlap in quantized coordinates, and no pair is
missed. Conversely f(a) < f(b) implies a < b: two boxes that overlap strictly on every side in quantized coordinates
certainly overlap. Only where two quantized coordinates are equal is the exact float64 test of the two boxes needed.
Since f(min(a, b)) = min(f(a), f(b)), the quantized box of a primitive is the union of the quantized boxes of its
vertices. These are computed once a step: the **vertex AABBs**.

**Worlds.** Several independent scenes, called worlds, may occupy the same region of space. Each has its own cell of a
lattice in quantized coordinates, an origin and a unit of length. f is taken from this origin and in this unit, pressed
into the cell where it is large (`in_cell`), and shifted there. Within a world all of this is monotone, so no pair of a
world is missed; and no box of a world overlaps one of another, however far what moves in a world has gone.

**Sizes.** One giant box would make all its ancestors giant. Boxes are therefore classified by extent, in factors of
eight above the typical extent, and the class is the most significant part of the key, so that large boxes share blocks
with each other.

References: Karras 2012, "Maximizing parallelism in the construction of BVHs, octrees, and k-d trees" (Morton order);
Wald et al. 2008, "Getting rid of packets" (one ray against a wide node).
"""

import warp as wp

from .boxes import end_box, inflated, point_box, united
from .lanes import united_vertex_aabbs, vec8f, write_leaves, write_union

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

WIDTH = wp.constant(16)  # boxes in a block
BLOCK_FLOATS = wp.constant(96)
BLOCK_CORNERS = wp.constant(48)
VERTEX_AABB_FLOATS = wp.constant(8)  # floats of a vertex AABB
CLASS_BITS = 3

_HALF = wp.constant(wp.float64(0.5))
_LARGEST_CLASS = wp.constant(2**CLASS_BITS - 1)
_INFINITY = wp.constant(wp.float32(wp.inf))
_BITS_OF_ONE = wp.constant(wp.int32(0x3F800000))
_DOUBLING = wp.constant(wp.float32(2.0**-23))
# What a doubling beyond ``inner`` takes of it: 128 of them end an eighth of ``inner`` before the border of the cell.
_OUTER = wp.constant(wp.float32(0.875 / 128.0))

vec8i = wp.types.vector(length=8, dtype=wp.int32)
vec8u = wp.types.vector(length=8, dtype=wp.uint32)
vec3ul = wp.types.vector(length=3, dtype=wp.uint64)


@wp.struct
class BoxTree:
    """Boxes of one set of primitives, in the order of the tree."""

    num_boxes: int
    num_levels: int
    num_aabbs: int  # of a primitive: 1, the swept AABB; 2, the endpoint AABBs
    block_begin: vec8i  # first block of each level
    # for each block and AABB: lower x, y, z, upper x, y, z of sixteen boxes; inf and -inf where there is none
    nodes: wp.array[wp.float32]
    primitive: wp.array[wp.int32]
    corners: wp.array[wp.int32]  # for each block: three vertices of sixteen primitives
    # lowest and highest group of the bodies below each box, from level 1 on (`collision_filter`); empty without groups
    groups: wp.array[wp.vec2i]


@wp.func
def box_corners(tree: BoxTree, place: int) -> wp.vec3i:
    """Vertices of the primitive at a place of the tree."""
    first = (place / WIDTH) * BLOCK_CORNERS + place % WIDTH
    return wp.vec3i(tree.corners[first], tree.corners[first + WIDTH], tree.corners[first + 2 * WIDTH])


@wp.struct
class Quantization:
    """The map f to quantized coordinates."""

    origin: wp.vec3d
    scale: wp.float64  # a power of two: most of the scene maps to [-1/2, 1/2]


@wp.struct
class Worlds:
    """The cells of worlds in quantized coordinates; empty arrays for a mesh of a single world."""

    of_vertex: wp.array[wp.int32]
    cell: wp.array[wp.vec4f]  # middle of each world's cell, and its unit: by which power of two the scale is larger
    anchor: wp.array[
        wp.int32
    ]  # three vertices of each world, whose start positions count; empty: the origin is that of f
    origin: wp.array[wp.vec3d]  # of the world from each of them; the middle one of the three counts, along each axis
    inner: wp.float32  # half of half a cell, a power of two: up to there coordinates are only shifted


@wp.struct
class BodyFrames:
    """The frames of slender bodies (`body_frames`), each with a cell of a lattice in quantized coordinates."""

    of_vertex: wp.array[wp.int32]  # whose frame each vertex is seen in
    edge: wp.array[wp.vec2i]  # its vertices: the origin, and where the first axis points to
    cell: wp.array[wp.vec4f]  # the middle of each cell; the fourth number is not used
    scale: wp.array[wp.float64]  # of quarters of coordinates, a power of two: most of the body maps to its cell
    inner: wp.float32  # half of half a cell


@wp.func
def quantized(x: wp.vec3d, origin: wp.vec3d, scale: wp.float64) -> wp.vec3f:
    """f: monotone in every component; with halves, so that the difference of two finite numbers is finite."""
    y = (_HALF * x - _HALF * origin) * (scale + scale)
    return wp.vec3f(wp.float32(y[0]), wp.float32(y[1]), wp.float32(y[2]))


@wp.func
def in_cell(y: wp.vec3f, cell: wp.vec4f, inner: wp.float32) -> wp.vec3f:
    """Quantized coordinates in a cell: monotone, and the same but for the shift as long as they are within ``inner``.

    Beyond that every doubling takes the same length, of which there are 128 up to infinity. The bits of a positive
    number are its logarithm, interpolated between powers of two, and 2²³ of them are a doubling.
    """
    r = wp.vec3f()
    for k in range(3):
        distance = wp.abs(y[k])
        if distance > inner:
            doublings = wp.float32(wp.cast(distance / inner, wp.int32) - _BITS_OF_ONE) * _DOUBLING
            distance = inner + doublings * (_OUTER * inner)
        r[k] = wp.where(y[k] < wp.float32(0.0), -distance, distance) + cell[k]
    return r


@wp.func
def vertex_aabb(
    v: int,
    worlds: Worlds,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    t_end: wp.float64,
    inflation: wp.float64,
    box_radius: wp.array[wp.float64],
    quantization: Quantization,
    num_aabbs: int,
    n: int,
) -> vec8f:
    """AABB n of a vertex (swept, or at end n of the step) in quantized coordinates; empty if a coordinate is NaN.

    It grows by the radius of the vertex (`thickness`) where there are radii, rounded outward once more.
    """
    p_t0 = vertices_t0[v]
    p_t1 = vertices_t1[v]
    box = point_box(p_t0)
    if num_aabbs == 1:
        box = united(box, end_box(p_t0, p_t1, t_end))
    elif n == 1:
        box = end_box(p_t0, p_t1, t_end)
    box = inflated(box, inflation)
    if box_radius.shape[0] > 0:
        box = inflated(box, box_radius[v])
    origin = quantization.origin
    scale = quantization.scale
    cell = wp.vec4f()
    has_worlds = worlds.cell.shape[0] > 0
    if has_worlds:
        w = worlds.of_vertex[v]
        cell = worlds.cell[w]
        if worlds.anchor.shape[0] > 0:
            a = worlds.origin[3 * w] + vertices_t0[worlds.anchor[3 * w]]
            b = worlds.origin[3 * w + 1] + vertices_t0[worlds.anchor[3 * w + 1]]
            c = worlds.origin[3 * w + 2] + vertices_t0[worlds.anchor[3 * w + 2]]
            origin = wp.max(wp.min(a, b), wp.min(wp.max(a, b), c))
        scale = scale * wp.float64(cell[3])
    lower = quantized(box.lower, origin, scale)
    upper = quantized(box.upper, origin, scale)
    if not (lower[0] <= upper[0] and lower[1] <= upper[1] and lower[2] <= upper[2]):
        lower = wp.vec3f(_INFINITY, _INFINITY, _INFINITY)
        upper = -lower
    elif has_worlds:
        lower = in_cell(lower, cell, worlds.inner)
        upper = in_cell(upper, cell, worlds.inner)
    zero = wp.float32(0.0)
    return vec8f(lower[0], lower[1], lower[2], zero, -upper[0], -upper[1], -upper[2], zero)


@wp.func_native(
    """
    struct alignas(16) Four { float x, y, z, w; };
    Four* p = (Four*)vertex_aabbs.data + 2LL * place;
    p[0] = {aabb[0], aabb[1], aabb[2], aabb[3]};
    p[1] = {aabb[4], aabb[5], aabb[6], aabb[7]};
"""
)
def write_vertex_aabb(vertex_aabbs: wp.array[wp.float32], place: int, aabb: vec8f):
    """Write a vertex AABB to its place, a multiple of 32 bytes, in two stores of four numbers."""
    ...


@wp.kernel
def fill_vertex_aabbs(
    begin: int,
    # in
    vertices: wp.array[wp.int32],
    vertex_body: wp.array[wp.int32],
    body_active: wp.array[wp.int32],
    worlds: Worlds,
    vertices_t0: wp.array[wp.vec3d],
    vertices_t1: wp.array[wp.vec3d],
    t_end: wp.float64,
    inflation: wp.float64,
    box_radius: wp.array[wp.float64],
    quantization: Quantization,
    num_aabbs: int,
    # out
    vertex_aabbs: wp.array[wp.float32],
):
    """Write the AABBs of each vertex in quantized coordinates; those of an inactive body are empty.

    An AABB is stored as (lower, 0, -upper, 0), so that a union is a minimum.
    """
    v = vertices[begin + wp.tid()]
    for n in range(num_aabbs):
        aabb = vec8f(_INFINITY)
        if body_active[vertex_body[v]] != 0:
            aabb = vertex_aabb(
                v,
                worlds,
                vertices_t0,
                vertices_t1,
                t_end,
                inflation,
                box_radius,
                quantization,
                num_aabbs,
                n,
            )
        write_vertex_aabb(vertex_aabbs, v * num_aabbs + n, aabb)


@wp.func
def node_place(tree: BoxTree, level: int, n: int, aabb: int) -> int:
    """Place of the first number of an AABB of box n of a level; the others follow at distances of WIDTH."""
    return ((tree.block_begin[level] + n / WIDTH) * tree.num_aabbs + aabb) * BLOCK_FLOATS + n % WIDTH


@wp.func
def write_nothing(tree: BoxTree, level: int, n: int):
    """Make box n of a level empty: it overlaps no box but an infinite one."""
    for f in range(tree.num_aabbs):
        at = node_place(tree, level, n, f)
        for k in range(3):
            tree.nodes[at + k * WIDTH] = _INFINITY
            tree.nodes[at + (k + 3) * WIDTH] = -_INFINITY


@wp.func
def unite(tree: BoxTree, level: int, n: int, count: int):
    """Write box n of the ``count`` boxes of a level; after the last one, fill its block with empty boxes."""
    for f in range(tree.num_aabbs):
        block = (tree.block_begin[level - 1] + n) * tree.num_aabbs + f
        write_union(tree.nodes, block, node_place(tree, level, n, f))
    if n == count - 1:
        for m in range(count, (count + WIDTH - 1) / WIDTH * WIDTH):
            write_nothing(tree, level, m)


@wp.func
def is_needed(only_if: wp.array[wp.int32]) -> bool:
    """Whether there is no flag, or it is set."""
    if only_if.shape[0] > 0:
        return only_if[0] != 0
    return True


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
    vertex_body: wp.array[wp.int32],
    body_group: wp.array[wp.int32],  # empty where groups do not count
    vertex_aabbs: wp.array[wp.float32],
    num_aabbs: int,
    typical_extent: wp.float32,  # of a primitive, in quantized coordinates
    morton_bits: int,
    index_bits: int,
    # out
    keys: wp.array[wp.int64],
):
    """Key of each primitive: group, size class, Morton code, index. Rounding does not matter: any order is correct."""
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
    limit = wp.float32(8.0) * typical_extent
    while size < _LARGEST_CLASS and longest > limit:
        longest = longest * wp.float32(0.125)
        size += 1
    key = wp.uint64(size)
    if body_group.shape[0] > 0:
        key = key | (wp.uint64(body_group[vertex_body[corners[i][0]]]) << wp.uint64(CLASS_BITS))
    key = (key << wp.uint64(3 * morton_bits)) | code
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
    """Write a block of primitives in the order of their keys, or of their plain indices."""
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


@wp.kernel
def fill_blocks(
    begin: int,
    # in
    vertex_aabbs: wp.array[wp.float32],
    num_corners: int,
    # out
    tree: BoxTree,
):
    """Fill a block of level 0 from the AABBs of its vertices, and write its union to level 1."""
    b = begin + wp.tid()
    write_leaves(vertex_aabbs, tree.num_aabbs, tree.corners, num_corners, tree.nodes, b, tree.num_boxes - b * WIDTH)
    unite(tree, 1, b, (tree.num_boxes + WIDTH - 1) / WIDTH)


@wp.kernel
def unite_blocks(
    begin: int,
    # in
    level: int,
    count: int,
    # out
    tree: BoxTree,
):
    """Compute box n of a level from block n of the level below."""
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
    """Fill all levels from one on in a single thread: they are small, and a launch for each would cost more."""
    n = wp.int32(count)
    for level in range(first_level, tree.num_levels):
        for k in range(n):
            unite(tree, level, k, n)
        n = (n + WIDTH - 1) / WIDTH
