"""Every version of the functions on sixteen lanes, against NumPy: plain, vectors of the compiler, AVX-512."""

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes import lanes, pair_lanes

WIDTH, BITS = 16, 1 << np.arange(16, dtype=np.uint32)
Floats, Ints, Bits = wp.array[wp.float32], wp.array[wp.int32], wp.array2d[wp.uint32]


def make(sources, version):
    """A function of a version; this processor, and Warp's compiler for it, have to run it."""
    if version == "avx512":

        @wp.func_native(f"#if {lanes._AVX512}\n    return 1;\n#else\n    return 0;\n#endif\n")
        def has_avx512() -> int: ...

        @wp.kernel(module="unique", enable_backward=False)
        def probe(out: Ints):
            out[0] = has_avx512()

        result = wp.zeros(1, dtype=wp.int32, device="cpu")
        wp.launch(probe, dim=1, inputs=[result], device="cpu")
        if not result.numpy()[0]:
            pytest.skip("this processor has no AVX-512")
    return wp.func_native(sources[version])


def on_cpu(array, dtype=wp.int32):
    return wp.array(np.ascontiguousarray(array).reshape(-1), dtype=dtype, device="cpu")


def run(kernel, inputs, shape=(64, 20)):
    out = wp.zeros(shape, dtype=wp.uint32, device="cpu")
    wp.launch(kernel, dim=shape, inputs=inputs, outputs=[out], device="cpu")
    return out.numpy()


def blocks(rng, count, num_aabbs):
    """Boxes on a coarse lattice, so that ties abound, some infinite and some empty; [count, num_aabbs, 6, 16]."""
    lower = rng.integers(-4, 4, (count, num_aabbs, 3, WIDTH)).astype(np.float32)
    upper = lower + rng.integers(0, 4, lower.shape).astype(np.float32)
    lower[rng.random(lower.shape) < 0.02], upper[rng.random(upper.shape) < 0.02] = -np.inf, np.inf
    empty = np.broadcast_to(rng.random((count, 1, 1, WIDTH)) < 0.1, lower.shape)
    return np.concatenate([np.where(empty, np.inf, lower), np.where(empty, -np.inf, upper)], axis=2).astype(np.float32)


@pytest.mark.parametrize("name", ["OVERLAP", "MOVING_OVERLAP"])
@pytest.mark.parametrize("version", lanes.OVERLAP)
def test_overlap(name, version):
    def overlap(
        nodes: Floats,
        block: int,
        query_nodes: Floats,
        query_block: int,
        query_lane: int,
        with_open: int,
        num_aabbs: int,
    ) -> wp.uint32: ...

    test = make(getattr(lanes, name), version)(overlap)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(nodes: Floats, queries: Floats, with_open: int, num_aabbs: int, out: Bits):
        i, j = wp.tid()
        out[i, j] = test(nodes, j, queries, i / 16, i % 16, with_open, num_aabbs)

    rng = np.random.default_rng(1)
    for num_aabbs in (1,) if name == "OVERLAP" else (1, 2):
        boxes, queries = blocks(rng, 20, num_aabbs), blocks(rng, 4, num_aabbs)
        b = boxes.transpose(1, 2, 0, 3).reshape(num_aabbs, 6, 1, -1)
        q = queries.transpose(1, 2, 0, 3).reshape(num_aabbs, 6, -1, 1)
        # apart on an axis: in the same order in all AABBs
        closed = ((b[:, :3] <= q[:, 3:]).any(axis=0) & (b[:, 3:] >= q[:, :3]).any(axis=0)).all(axis=0)
        opened = closed & ((b[:, :3] < q[:, 3:]).any(axis=0) & (b[:, 3:] > q[:, :3]).any(axis=0)).all(axis=0)
        for with_open in (0, 1) if name == "OVERLAP" else (0,):
            found = run(kernel, [on_cpu(boxes, wp.float32), on_cpu(queries, wp.float32), with_open, num_aabbs])
            expected = (closed.reshape(64, 20, WIDTH) * BITS).sum(axis=2)
            expected = expected + with_open * (opened.reshape(64, 20, WIDTH) * (BITS << 16)).sum(axis=2)
            assert np.array_equal(found, expected) and 0 < opened.sum() <= closed.sum() < closed.size


@pytest.mark.parametrize("version", lanes.SHARED_VERTEX)
def test_shared_vertex(version):
    def shared(
        corners: Ints,
        block: int,
        num_corners: int,
        query_corners: Ints,
        query_block: int,
        query_lane: int,
        num_query_corners: int,
    ) -> wp.uint32: ...

    test = make(lanes.SHARED_VERTEX, version)(shared)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(a: Ints, n: int, q: Ints, m: int, out: Bits):
        i, j = wp.tid()
        out[i, j] = test(a, j, n, q, i / 16, i % 16, m)

    rng = np.random.default_rng(2)
    targets, queries = rng.integers(0, 30, (20, 3, WIDTH)), rng.integers(0, 30, (4, 3, WIDTH))
    for n, m in ((3, 1), (2, 2), (1, 3)):
        t = targets[:, :n].transpose(1, 0, 2).reshape(1, n, 1, -1)
        q = queries[:, :m].transpose(1, 0, 2).reshape(m, 1, -1, 1)
        expected = ((t == q).any(axis=(0, 1)).reshape(64, 20, WIDTH) * BITS).sum(axis=2)
        assert np.array_equal(run(kernel, [on_cpu(targets), n, on_cpu(queries), m]), expected)


@pytest.mark.parametrize("version", lanes.LEAVES)
@pytest.mark.parametrize("num_corners", [1, 2, 3])
@pytest.mark.parametrize("num_aabbs", [1, 2])
def test_leaves_vertex_aabbs_and_unions(version, num_corners, num_aabbs):
    def leaves(
        vertex_aabbs: Floats, num_aabbs: int, corners: Ints, num_corners: int, nodes: Floats, block: int, count: int
    ): ...
    def union(nodes: Floats, block: int, at: int): ...
    def united(vertex_aabbs: Floats, v0: int, v1: int, v2: int) -> lanes.vec8f: ...

    fill, unite = make(lanes.LEAVES, version)(leaves), make(lanes.UNION, version)(union)
    of_three = make(lanes.UNITED_VERTEX_AABBS, version)(united)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(aabbs: Floats, num_aabbs: int, corners: Ints, n: int, count: int, nodes: Floats, out: Floats):
        b = wp.tid()
        fill(aabbs, num_aabbs, corners, n, nodes, b, count - 16 * b)
        for f in range(num_aabbs):
            unite(nodes, b * num_aabbs + f, (4 * num_aabbs + f) * 96 + b)
        c = 48 * b
        r = of_three(aabbs, corners[c] * num_aabbs, corners[c + 16] * num_aabbs, corners[c + 32] * num_aabbs)
        for k in range(8):
            out[8 * b + k] = r[k]

    rng, count = np.random.default_rng(3), 53
    aabbs, corners = rng.standard_normal((40, num_aabbs, 8)).astype(np.float32), rng.integers(0, 40, (4, 3, WIDTH))
    nodes, out = (wp.zeros(n, dtype=wp.float32, device="cpu") for n in (5 * num_aabbs * 96, 32))
    inputs = [on_cpu(aabbs, wp.float32), num_aabbs, on_cpu(corners), num_corners, count]
    wp.launch(kernel, dim=4, inputs=inputs, outputs=[nodes, out], device="cpu")
    least = aabbs[corners[:, :num_corners]].min(axis=1)  # [block, lane, aabb, 8]
    least[np.arange(64).reshape(4, WIDTH) >= count] = np.inf
    expected = np.concatenate([least[..., :3], -least[..., 4:7]], axis=-1).transpose(0, 2, 3, 1)
    found = nodes.numpy().reshape(5, num_aabbs, 6, WIDTH)
    assert np.array_equal(found[:4], expected)
    assert np.array_equal(found[4, :, :3, :4], expected[:, :, :3].min(axis=3).transpose(1, 2, 0))
    assert np.array_equal(found[4, :, 3:, :4], expected[:, :, 3:].max(axis=3).transpose(1, 2, 0))
    assert np.array_equal(out.numpy().reshape(4, 8), aabbs[corners[:, :, 0], 0].min(axis=1))


@pytest.mark.parametrize("version", pair_lanes.SEPARATED)
def test_boxes_that_are_apart_in_float64(version):
    """Vertices on a coarse lattice and next to it, so that boxes touch exactly, or miss by one rounding."""
    X = wp.array[wp.vec3d]

    def separated(
        vertices_t0: X,
        vertices_t1: X,
        inflation: wp.float64,
        corners: Ints,
        block: int,
        num_corners: int,
        query_corners: Ints,
        query_block: int,
        query_lane: int,
        num_query_corners: int,
        tied: wp.uint32,
    ) -> wp.uint32: ...

    test = make(pair_lanes.SEPARATED, version)(separated)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(x: X, y: X, inflation: wp.float64, a: Ints, n: int, q: Ints, m: int, tied: wp.uint32, out: Bits):
        i, j = wp.tid()
        out[i, j] = test(x, y, inflation, a, j, n, q, i / 16, i % 16, m, tied)

    rng, tied = np.random.default_rng(3), 0xBEEF
    frames = 0.25 * rng.integers(-5, 5, (2, 40, 3))
    frames = np.where(rng.random(frames.shape) < 0.3, np.nextafter(frames, np.inf), frames)
    blocks = rng.integers(0, 40, (2, 12, 3, WIDTH))
    for counts in ((1, 3), (2, 2), (3, 1)):
        for inflation in (0.0, 0.25, 5e-324):
            boxes = []
            for corners, count in zip(blocks, counts, strict=True):
                x = frames[:, corners[:, :count].transpose(0, 2, 1).reshape(-1, count)]
                x = x.transpose(1, 0, 2, 3).reshape(-1, 2 * count, 3)
                low, high = x.min(axis=1), x.max(axis=1)
                grown = np.nextafter(low - inflation, -np.inf), np.nextafter(high + inflation, np.inf)
                boxes.append(grown if inflation > 0 else (low, high))
            (low, high), (query_low, query_high) = boxes
            apart = (low > query_high[:, None]).any(axis=2) | (query_low[:, None] > high).any(axis=2)
            sides = [value for c, n in zip(blocks, counts, strict=True) for value in (on_cpu(c), n)]
            ends = [wp.array(frame, dtype=wp.vec3d, device="cpu") for frame in frames]
            found = run(kernel, [*ends, inflation, *sides, tied], (12 * WIDTH, 12))
            assert np.array_equal(found, (apart.reshape(-1, 12, WIDTH) * BITS).sum(axis=2) & tied)
            assert 0 < apart.sum() < apart.size
