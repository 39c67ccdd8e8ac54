"""A spatial hash of boxes: a hierarchy of grids whose cells are the buckets of one table.

**Levels.** The cells of level m are cubes of side s·2ᵐ in quantized coordinates; the last level is a single cell. A box
belongs to the finest level whose cells are at least as large as its longest side and of which it covers at most two
along each axis. So a giant face among small ones is alone on its level. Of the two endpoint AABBs of a primitive the
union counts.

**One place for each box.** A box stands in the cell of its lower corner only, and its upper corner lies in that cell or
the next along each axis. For a query with the corners p ≤ q, the boxes of level m that it overlaps therefore stand in
the cells from cell(p) - 1 to cell(q): a box [a, b] with a <= q and p <= b has cell(a) <= cell(q), and
cell(a) >= cell(b) - 1 >= cell(p) - 1. This needs nothing of cell() but that it is monotone, and the level of a box is
found with cell() itself. Rounding, infinite coordinates and the ends of the grid, where all that lies outside falls
into the last cells, can therefore cost time but no pair. As many places as boxes always suffice.

**Each pair once.** A query looks up only levels that are no finer than its own, where it covers few cells. Two boxes of
different levels are found by the finer one; of one level and two sets, by those of one set; of one level and one set,
by the one that comes first.

**Buckets.** The cells of a row along x are consecutive buckets, from a bucket that the level and the row determine
through a hash function; the last bucket is followed by the first. The boxes are sorted by bucket and stand in blocks of
sixteen, as in `box_tree`. The cells that a query looks up in a row are one run of places, however many they are, so a
cell is divided into four parts along x, and the run is shorter. Rows may share buckets: what a run holds counts only if
it stands in one of the cells looked up.

References: Eitz and Lixu 2007, "Hierarchical spatial hashing for real-time collision detection"; Teschner et al. 2003,
"Optimized spatial hashing for collision detection of deformable objects"; Ericson 2005, "Real-time collision
detection", section 7.2 (one cell for each object); Knuth 1998, "The art of computer programming 3", section 5.2.
"""

import warp as wp

from ..atomics import set_bits
from .box_groups import groups_of_block
from .box_tree import BLOCK_CORNERS, WIDTH, BoxTree, is_needed, unite
from .lanes import united_vertex_aabbs, write_leaves

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

# The level of the single cell.
LAST_LEVEL = wp.constant(15)
CELL_BITS = 19
PART_BITS = 2  # of the number of a part of a cell along x
LEAST_CELL = 2.0 ** (1 - CELL_BITS)  # with it the cells of the finest level fill [-1/4, 1/4]

_LEVEL_SHIFT = wp.constant(wp.uint64(3 * CELL_BITS + PART_BITS))
_COLUMN_SHIFT = wp.constant(wp.uint64(CELL_BITS))
_ROW_SHIFT = wp.constant(wp.uint64(CELL_BITS + PART_BITS))
_COLUMN = wp.constant(wp.uint64(2**CELL_BITS - 1))
_IN_ROW = wp.constant(wp.uint64(2 ** (CELL_BITS + PART_BITS) - 1))
PARTS = wp.constant(2**PART_BITS)
# The cells of a level are numbered from 1, so that there is one before each, and none is the last number.
_MIDDLE = wp.constant(2 ** (CELL_BITS - 1))
_FARTHEST = wp.constant(wp.float32(2 ** (CELL_BITS - 1) - 2))
_GOLDEN = wp.constant(wp.uint64(0x9E3779B97F4A7C15))  # 2⁶⁴ divided by the golden ratio
NO_CELL = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))  # of an empty box
_ONE = wp.constant(wp.float32(1.0))
_HALF = wp.constant(wp.float32(0.5))


@wp.struct
class HashGrid:
    """The cells and the buckets of one set of boxes, which stand in the blocks of a `BoxTree` of two levels."""

    cells_per_unit: wp.float32  # 1/s
    bucket_bits: int  # there are 2 to this power
    bucket_begin: wp.array[wp.int32]  # first place of each bucket, and the end of the last
    cells: wp.array[wp.uint64]  # cell of the box at each place
    levels: wp.array[wp.int32]  # a mask of the levels that have boxes, shape [1]


@wp.struct
class Extent:
    """The lower and the upper corner of a box in quantized coordinates."""

    lower: wp.vec3f
    upper: wp.vec3f


@wp.func
def cell_along(x: wp.float32, density: wp.float32, parts: int) -> int:
    """Number of the cell of a coordinate along one axis, or of the part of a cell, monotone in x."""
    number = wp.min(wp.max(x * density, -_FARTHEST), _FARTHEST)
    return wp.int32(wp.floor(number * wp.float32(parts))) + _MIDDLE * parts


@wp.func
def density_of(level: int, cells_per_unit: wp.float32) -> wp.float32:
    """Cells of a level for a unit of length."""
    density = wp.float32(cells_per_unit)
    for _k in range(level):
        density = density * _HALF
    return density


@wp.func
def cell_at(x: wp.vec3f, level: int, density: wp.float32) -> wp.vec3i:
    """Numbers of the cell of a point along the axes, along x those of its parts; the last level has one cell."""
    if level == LAST_LEVEL:
        return wp.vec3i(PARTS, 1, 1)
    return wp.vec3i(cell_along(x[0], density, PARTS), cell_along(x[1], density, 1), cell_along(x[2], density, 1))


@wp.func
def level_of(box: Extent, cells_per_unit: wp.float32) -> int:
    """The finest level whose cells are large enough for a box, of which it covers at most two along each axis."""
    side = box.upper - box.lower
    longest = wp.max(wp.max(side[0], side[1]), side[2])
    density = wp.float32(cells_per_unit)
    level = int(0)
    while level < LAST_LEVEL:
        # a box at infinity has a side that is not a number, and this is false
        if longest * density <= _ONE:
            covered = cell_at(box.upper, level, density) - cell_at(box.lower, level, density)
            if covered[0] <= PARTS and covered[1] <= 1 and covered[2] <= 1:
                break
        level += 1
        density = density * _HALF
    return level


@wp.func
def cell_key(level: int, x: int, y: int, z: int) -> wp.uint64:
    """A cell as one number, of which x is the lowest part."""
    row = ((wp.uint64(level) << _COLUMN_SHIFT) | wp.uint64(z)) << _COLUMN_SHIFT | wp.uint64(y)
    return (row << _ROW_SHIFT) | wp.uint64(x)


@wp.func
def level_of_cell(key: wp.uint64) -> int:
    """Level of a cell."""
    return wp.int32(key >> _LEVEL_SHIFT)


@wp.func
def is_at_an_end(key: wp.uint64) -> bool:
    """Whether a row of cells is at an end of the grid, where all stand that lie outside, however far apart."""
    row = key >> _ROW_SHIFT
    for _k in range(2):
        number = wp.int32(row & _COLUMN)
        if number <= _MIDDLE - wp.int32(_FARTHEST) or number >= _MIDDLE + wp.int32(_FARTHEST):
            return True
        row = row >> _COLUMN_SHIFT
    return False


@wp.func
def first_of_row(key: wp.uint64) -> wp.uint64:
    """The least number of a cell in the row of a cell."""
    return key & ~_IN_ROW


@wp.func
def last_of_row(key: wp.uint64) -> wp.uint64:
    """The largest number of a cell in the row of a cell."""
    return key | _IN_ROW


@wp.func
def bucket_of(key: wp.uint64, bucket_bits: int) -> int:
    """Bucket of a cell: that of its row by Fibonacci hashing, and from there on one for each cell before it."""
    row = ((key >> _ROW_SHIFT) * _GOLDEN) >> wp.uint64(64 - bucket_bits)
    return wp.int32(row + (key & _IN_ROW)) & ((1 << bucket_bits) - 1)


@wp.kernel
def fill_cells(
    begin: int,
    # in
    only_if: wp.array[wp.int32],
    corners: wp.array[wp.vec3i],
    vertex_aabbs: wp.array[wp.float32],
    num_aabbs: int,
    # out
    grid: HashGrid,
    cells: wp.array[wp.uint64],
    buckets: wp.array[wp.int32],
    order: wp.array[wp.int32],
):
    """Compute the cell and the bucket of each primitive; an empty box comes after the last bucket."""
    i = begin + wp.tid()
    if not is_needed(only_if):
        return
    if i == 0:
        grid.levels[0] = 0
    c = corners[i] * num_aabbs
    # lower corner and negated upper corner, four numbers each
    r = united_vertex_aabbs(vertex_aabbs, c[0], c[1], c[2])
    if num_aabbs == 2:
        ends = united_vertex_aabbs(vertex_aabbs, c[0] + 1, c[1] + 1, c[2] + 1)
        for k in range(8):
            r[k] = wp.min(r[k], ends[k])
    box = Extent()
    box.lower = wp.vec3f(r[0], r[1], r[2])
    box.upper = -wp.vec3f(r[4], r[5], r[6])
    key = NO_CELL
    bucket = 1 << grid.bucket_bits
    if box.lower[0] <= box.upper[0] and box.lower[1] <= box.upper[1] and box.lower[2] <= box.upper[2]:
        level = level_of(box, grid.cells_per_unit)
        cell = cell_at(box.lower, level, density_of(level, grid.cells_per_unit))
        key = cell_key(level, cell[0], cell[1], cell[2])
        bucket = bucket_of(key, grid.bucket_bits)
    cells[i] = key
    buckets[i] = bucket
    order[i] = i


@wp.kernel
def sort_range(
    begin: int,
    # in
    buckets: wp.array[wp.int32],
    num_boxes: int,
    num_ranges: int,
    # out
    grid: HashGrid,
    order: wp.array[wp.int32],
):
    """Sort the boxes of a range of buckets by counting; a thread of the CPU for each range reads all buckets.

    Boxes of one bucket keep their order, so the result does not depend on the number of ranges.
    """
    n = begin + wp.tid()
    num_buckets = 1 << grid.bucket_bits
    first = wp.int32(wp.int64(num_buckets) * wp.int64(n) / wp.int64(num_ranges))
    last = wp.int32(wp.int64(num_buckets) * wp.int64(n + 1) / wp.int64(num_ranges))
    if n == num_ranges - 1:
        last = num_buckets + 1  # with the empty boxes
    for b in range(first, last):
        grid.bucket_begin[b] = 0
    place = int(0)
    for i in range(num_boxes):
        b = buckets[i]
        if b < first:
            place += 1
        elif b < last:
            grid.bucket_begin[b] = grid.bucket_begin[b] + 1
    first_place = place
    for b in range(first, last):
        count = grid.bucket_begin[b]
        grid.bucket_begin[b] = place
        place += count
    for i in range(num_boxes):
        b = buckets[i]
        if b >= first and b < last:
            place = grid.bucket_begin[b]
            order[place] = i
            grid.bucket_begin[b] = place + 1
    # each has become the end of its bucket, where the next one begins
    for k in range(last - first - 1):
        b = last - 1 - k
        grid.bucket_begin[b] = grid.bucket_begin[b - 1]
    grid.bucket_begin[first] = first_place


@wp.kernel
def find_buckets(
    begin: int,
    # in
    only_if: wp.array[wp.int32],
    buckets: wp.array[wp.int32],  # ascending
    num_boxes: int,
    # out
    grid: HashGrid,
):
    """Find the first place of each bucket among sorted ones by bisection."""
    b = begin + wp.tid()
    if not is_needed(only_if):
        return
    low = int(0)
    high = wp.int32(num_boxes)
    while low < high:
        middle = low + (high - low) / 2
        if buckets[middle] < b:
            low = middle + 1
        else:
            high = middle
    grid.bucket_begin[b] = low


@wp.func
def place_box(
    place: int,
    order: wp.array[wp.int32],
    cells: wp.array[wp.uint64],
    ids: wp.array[wp.int32],
    corners: wp.array[wp.vec3i],
    boxes: BoxTree,
    grid: HashGrid,
) -> int:
    """Fill a place of a block with the primitive that the order puts there, and its cell; returns its level's bit."""
    level = int(0)
    c = wp.vec3i(-1, -1, -1)
    if place < boxes.num_boxes:
        i = order[place]
        c = corners[i]
        boxes.primitive[place] = ids[i]
        key = cells[i]
        grid.cells[place] = key
        if key != NO_CELL:
            level = 1 << level_of_cell(key)
    for k in range(3):
        boxes.corners[place / WIDTH * BLOCK_CORNERS + place % WIDTH + k * WIDTH] = c[k]
    return level


@wp.kernel
def fill_grid(
    begin: int,
    # in
    order: wp.array[wp.int32],
    cells: wp.array[wp.uint64],
    ids: wp.array[wp.int32],
    corners: wp.array[wp.vec3i],
    num_corners: int,
    vertex_aabbs: wp.array[wp.float32],
    vertex_group: wp.array[wp.int32],
    # out
    boxes: BoxTree,
    grid: HashGrid,
):
    """Fill a block with the primitives that the order puts there, their boxes and cells, and unite the boxes."""
    b = begin + wp.tid()
    levels = int(0)
    for lane in range(WIDTH):
        levels = levels | place_box(b * WIDTH + lane, order, cells, ids, corners, boxes, grid)
    set_bits(grid.levels, 0, levels)
    if vertex_group.shape[0] > 0:
        boxes.groups[b] = groups_of_block(boxes.corners, vertex_group, b)
    write_leaves(vertex_aabbs, boxes.num_aabbs, boxes.corners, num_corners, boxes.nodes, b, boxes.num_boxes - b * WIDTH)
    unite(boxes, 1, b, (boxes.num_boxes + WIDTH - 1) / WIDTH)


@wp.kernel
def fill_places(
    begin: int,
    # in
    only_if: wp.array[wp.int32],
    order: wp.array[wp.int32],
    cells: wp.array[wp.uint64],
    ids: wp.array[wp.int32],
    corners: wp.array[wp.vec3i],
    # out
    boxes: BoxTree,
    grid: HashGrid,
):
    """Fill a place of a block with the primitive that the order puts there, and its cell, on CUDA."""
    place = begin + wp.tid()
    if is_needed(only_if):
        set_bits(grid.levels, 0, place_box(place, order, cells, ids, corners, boxes, grid))
