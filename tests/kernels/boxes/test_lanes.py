"""Versions of the functions on sixteen lanes: vectors of the compiler, and AVX-512, do what plain numbers do."""

import types

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes import lanes, pair_lanes

FLOATS, INTS, MASKS = wp.array[wp.float32], wp.array[wp.int32], wp.array2d[wp.uint32]
POINTS = wp.array[wp.vec3d]
kernel = wp.kernel(module="unique", enable_backward=False)


def of_boxes(f):
    def run(a: FLOATS, b: FLOATS, option: int, out: MASKS):
        i, j = wp.tid()
        out[i, j] = f(a, j, b, i / 16, i % 16, option)

    return run


def of_partners(f):
    def run(a: FLOATS, c: INTS, n: int, b: FLOATS, d: INTS, m: int, num_aabbs: int, masks: INTS, out: MASKS):
        i, j = wp.tid()
        begin = 16 * (20 * i + j)
        queries, targets = wp.uint32(0xF7FF), wp.uint32(0xFFEF)
        out[i, 17 * j] = f(a, c, j, n, b, d, i, m, queries, targets, i, num_aabbs, masks, begin)
        for k in range(16):
            out[i, 17 * j + 1 + k] = wp.uint32(masks[begin + k])

    return run


def of_moving_corners(f):
    def run(x: POINTS, y: POINTS, inflation: wp.float64, a: INTS, n: int, b: INTS, m: int, out: MASKS):
        i, j = wp.tid()
        out[i, j] = f(x, y, inflation, a, j, n, b, i / 16, i % 16, m, wp.uint32(0xBEEF))

    return run


def of_leaves(f):
    def run(aabbs: FLOATS, num_aabbs: int, corners: INTS, n: int, count: int, out: wp.array2d[wp.float32]):
        j, b = wp.tid()
        f(aabbs, num_aabbs, corners, n, out[j], b, count - 16 * b)

    return run


def of_unions(f):
    def run(nodes: FLOATS, out: wp.array2d[wp.float32]):
        _, b = wp.tid()
        f(nodes, b, 96 * out.shape[1] + b)
        for k in range(6):
            out[k, b] = nodes[96 * out.shape[1] + 16 * k + b]

    return run


def of_vertices(f):
    def run(aabbs: FLOATS, corners: wp.array[wp.vec3i], out: wp.array2d[wp.float32]):
        i, k = wp.tid()
        out[i, k] = f(aabbs, corners[i][0], corners[i][1], corners[i][2])[k]

    return run


def of_candidates(f):
    def run(ids: INTS, corners: INTS, order: int, of_first: int, collected: INTS, out: wp.array2d[wp.int32]):
        i, j = wp.tid()
        capacity = collected.shape[0] / 6
        begin = (i * 10 + j) * (capacity / 640)
        mask = wp.uint32((i * 40503 + j * 30011) & 0xFFFF)
        end = f(ids, corners, i, ids, corners, j, mask, order, of_first, begin, capacity, collected)
        for k in range(6):
            for n in range(begin, end):
                out[i, j] += collected[k * capacity + n] * (24 * k + n - begin + 1)

    return run


def blocks(rng, count, num_aabbs=1):
    """Boxes on a coarse lattice, so that ties abound, some infinite and some empty."""
    lower = rng.integers(-4, 4, (count, num_aabbs, 3, 16)).astype(np.float32)
    upper = lower + rng.integers(0, 4, lower.shape).astype(np.float32)
    lower[rng.random(lower.shape) < 0.02] = -np.inf
    upper[rng.random(upper.shape) < 0.02] = np.inf
    empty = rng.random((count, 1, 1, 16)) < 0.1
    return np.concatenate([np.where(empty, np.inf, lower), np.where(empty, -np.inf, upper)], axis=2)


def with_corners(rng, count, num_aabbs, num_corners):
    """Boxes, of which some sides are no number, vertices of their primitives, and how many these are."""
    boxes = blocks(rng, count, num_aabbs)
    boxes[rng.random(boxes.shape) < 0.02] = np.nan
    return boxes, rng.integers(0, 30, (count, 3, 16)), num_corners


def on_lattice(rng):
    """Vertices on a coarse lattice and next to it, so that boxes touch exactly, or miss by one rounding."""
    x = 0.25 * rng.integers(-5, 5, (40, 3))
    return np.where(rng.random(x.shape) < 0.3, np.nextafter(x, np.inf), x)


def are_apart(x, y, inflation, *sides):
    """The masks of boxes that are apart, by NumPy: versions share how a box is enlarged."""
    boxes = []
    for corners, count in (sides[:2], sides[2:]):
        of_boxes = corners[:, :count].transpose(0, 2, 1).reshape(-1, count)
        points = np.concatenate([x[of_boxes], y[of_boxes]], axis=1)
        lower, upper = points.min(axis=1), points.max(axis=1)
        if inflation > 0:
            lower, upper = np.nextafter(lower - inflation, -np.inf), np.nextafter(upper + inflation, np.inf)
        boxes += [lower, upper]
    low, high, query_low, query_high = boxes
    apart = (low > query_high[:, None]).any(axis=2) | (query_low[:, None] > high).any(axis=2)
    return (apart.reshape(-1, 12, 16) * (1 << np.arange(16))).sum(axis=2) & 0xBEEF


SIDES = (1, 3), (2, 2), (3, 1)
ALL_SIDES = *SIDES, (1, 1), (1, 2), (2, 3), (3, 3)
NO_MASKS = np.zeros(4 * 20 * 16, dtype=int)
# The function and its versions, a kernel, the shape of what it fills, and the inputs of each launch.
FUNCTIONS = {
    "overlap": (lanes.overlap_mask, lanes.OVERLAP, of_boxes, (64, 20), wp.uint32)
    + (lambda rng: [(blocks(rng, 20), blocks(rng, 4), with_open) for with_open in (0, 1)],),
    "moving overlap": (lanes.moving_overlap_mask, lanes.MOVING_OVERLAP, of_boxes, (64, 20), wp.uint32)
    + (lambda rng: [(blocks(rng, 20, n), blocks(rng, 4, n), n) for n in (1, 2)],),
    "partners": (lanes.partner_masks, lanes.PARTNERS, of_partners, (4, 340), wp.uint32)
    + (lambda rng: [(*with_corners(rng, 20, 1, n), *with_corners(rng, 4, 1, m), 1, NO_MASKS) for n, m in ALL_SIDES],),
    "moving partners": (lanes.moving_partner_masks, lanes.MOVING_PARTNERS, of_partners, (4, 340), wp.uint32)
    + (
        lambda rng: [
            (*with_corners(rng, 20, k, n), *with_corners(rng, 4, k, m), k, NO_MASKS)
            for n, m in ALL_SIDES
            for k in (1, 2)
        ],
    ),
    "apart": (pair_lanes.separated_mask, pair_lanes.SEPARATED, of_moving_corners, (192, 12), wp.uint32)
    + (
        lambda rng: [
            (on_lattice(rng), on_lattice(rng), inflation)
            + (rng.integers(0, 40, (12, 3, 16)), n, rng.integers(0, 40, (12, 3, 16)), m)
            for n, m in SIDES
            for inflation in (0.0, 0.25, 5e-324)
        ],
    ),
    "candidates": (pair_lanes.collect_pairs, pair_lanes.COLLECT, of_candidates, (64, 10), wp.int32)
    + (
        lambda rng: [
            (rng.permutation(160), rng.integers(0, 40, (10, 3, 16)), order, n, np.zeros(6 * 640 * 16, dtype=int))
            for order in (0, 1, 2)
            for n in (1, 2)
        ],
    ),
    "leaves": (lanes.write_leaves, lanes.LEAVES, of_leaves, (1, 4 * 2 * 96), wp.float32)
    + (
        lambda rng: [
            (rng.standard_normal((40, k, 8)).astype(np.float32), k, rng.integers(0, 40, (4, 3, 16)), n, 53)
            for n in (1, 2, 3)
            for k in (1, 2)
        ],
    ),
    "union": (lanes.write_union, lanes.UNION, of_unions, (6, 12), wp.float32)
    + (lambda rng: [(np.concatenate([blocks(rng, 12), np.zeros((1, 1, 6, 16))]),)],),
    "vertices": (lanes.united_vertex_aabbs, lanes.UNITED_VERTEX_AABBS, of_vertices, (30, 8), wp.float32)
    + (lambda rng: [(rng.standard_normal((40, 8)).astype(np.float32), rng.integers(0, 40, (30, 3)))],),
}


def on_cpu(value):
    if np.ndim(value) == 0:
        return value
    if value.shape[-1] == 3:
        return wp.array(value, dtype=wp.vec3d if value.dtype == np.float64 else wp.vec3i, device="cpu")
    dtype = wp.int32 if value.dtype.kind == "i" else wp.float32
    return wp.array(value.reshape(-1), dtype=dtype, device="cpu")


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_version_does_the_same(name):
    function, versions, make, shape, dtype, draw = FUNCTIONS[name]
    answers = []
    # where the processor has no AVX-512, the last is the vectors once more
    for source in (versions["scalar"], versions["vector"], lanes.chosen(versions)):
        plain = function.func
        version = types.FunctionType(plain.__code__, plain.__globals__, f"{plain.__name__}_{len(answers)}")
        version.__annotations__, version.__module__ = plain.__annotations__, __name__
        run = kernel(make(wp.func_native(source)(version)))
        answers.append([])
        for inputs in draw(np.random.default_rng(1)):
            out = wp.zeros(shape, dtype=dtype, device="cpu")
            dim = {of_leaves: (1, 4), of_unions: (1, 12), of_partners: (4, 20)}.get(make, shape)
            wp.launch(run, dim=dim, inputs=[*map(on_cpu, inputs)], outputs=[out], device="cpu")
            answers[-1].append(out.numpy())
    for inputs, scalar, *others in zip(draw(np.random.default_rng(1)), *answers, strict=True):
        assert name != "apart" or np.array_equal(scalar, are_apart(*inputs))
        assert len(np.unique(scalar)) > 6
        assert all(scalar.tobytes() == other.tobytes() for other in others)
