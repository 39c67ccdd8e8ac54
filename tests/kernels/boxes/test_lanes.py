"""Every version of the functions on sixteen lanes, against NumPy: plain, vectors of the compiler, AVX-512."""

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes import lanes, pair_lanes

WIDTH = 16
_kernels = {}


def supports(version):
    """Whether this processor, and Warp's compiler for it, can run a version."""
    if version != "avx512":
        return True
    if "probe" not in _kernels:

        @wp.func_native(f"#if {lanes._AVX512}\n    return 1;\n#else\n    return 0;\n#endif\n")
        def has_avx512() -> int: ...

        @wp.kernel(module="unique", enable_backward=False)
        def probe(out: wp.array[wp.int32]):
            out[0] = has_avx512()

        result = wp.zeros(1, dtype=wp.int32, device="cpu")
        wp.launch(probe, dim=1, inputs=[result], device="cpu")
        _kernels["probe"] = bool(result.numpy()[0])
    return _kernels["probe"]


def blocks(rng, count, num_aabbs):
    """Boxes on a coarse lattice, so that ties abound, some infinite and some empty; [count, num_aabbs, 6, 16]."""
    lower = rng.integers(-4, 4, (count, num_aabbs, 3, WIDTH)).astype(np.float32)
    upper = lower + rng.integers(0, 4, lower.shape).astype(np.float32)
    lower[rng.random(lower.shape) < 0.02] = -np.inf
    upper[rng.random(upper.shape) < 0.02] = np.inf
    empty = np.broadcast_to(rng.random((count, 1, 1, WIDTH)) < 0.1, lower.shape)
    return np.concatenate([np.where(empty, np.inf, lower), np.where(empty, -np.inf, upper)], axis=2).astype(np.float32)


def on_cpu(array, dtype):
    return wp.array(np.ascontiguousarray(array).reshape(-1), dtype=dtype, device="cpu")


def make_overlap(sources, version):
    @wp.func_native(sources[version])
    def overlap(
        nodes: wp.array[wp.float32],
        block: int,
        query_nodes: wp.array[wp.float32],
        query_block: int,
        query_lane: int,
        with_open: int,
        num_aabbs: int,
    ) -> wp.uint32: ...

    @wp.kernel(module="unique", enable_backward=False)
    def run(
        nodes: wp.array[wp.float32],
        queries: wp.array[wp.float32],
        with_open: int,
        num_aabbs: int,
        out: wp.array2d[wp.uint32],
    ):
        i, j = wp.tid()
        out[i, j] = overlap(nodes, j, queries, i / 16, i % 16, with_open, num_aabbs)

    return run


def cases(sources):
    return [(name, version) for name, versions in sources.items() for version in versions]


@pytest.mark.parametrize(
    ("name", "version", "num_aabbs"),
    [
        *((*case, 1) for case in cases({"OVERLAP": lanes.OVERLAP, "MOVING_OVERLAP": lanes.MOVING_OVERLAP})),
        *((*case, 2) for case in cases({"MOVING_OVERLAP": lanes.MOVING_OVERLAP})),
    ],
)
def test_overlap(name, version, num_aabbs):
    if not supports(version):
        pytest.skip(f"this processor has no {version}")
    rng = np.random.default_rng(1)
    boxes, queries = blocks(rng, 20, num_aabbs), blocks(rng, 4, num_aabbs)
    b = boxes.transpose(1, 2, 0, 3).reshape(num_aabbs, 6, 1, -1)
    q = queries.transpose(1, 2, 0, 3).reshape(num_aabbs, 6, -1, 1)
    if num_aabbs == 1:
        closed = (b[0, :3] <= q[0, 3:]).all(axis=0) & (b[0, 3:] >= q[0, :3]).all(axis=0)
        opened = (b[0, :3] < q[0, 3:]).all(axis=0) & (b[0, 3:] > q[0, :3]).all(axis=0)
    else:
        closed = (b[:, :3] <= q[:, 3:]).any(axis=0).all(axis=0) & (b[:, 3:] >= q[:, :3]).any(axis=0).all(axis=0)
        opened = closed
    for with_open in (0, 1) if name == "OVERLAP" else (0,):
        out = wp.zeros((64, 20), dtype=wp.uint32, device="cpu")
        inputs = [on_cpu(boxes, wp.float32), on_cpu(queries, wp.float32), with_open, num_aabbs]
        wp.launch(make_overlap(getattr(lanes, name), version), dim=(64, 20), inputs=inputs, outputs=[out], device="cpu")
        weight = 1 << np.arange(WIDTH, dtype=np.uint32)
        expected = (closed.reshape(64, 20, WIDTH) * weight).sum(axis=2)
        if with_open:
            expected = expected + ((opened & closed).reshape(64, 20, WIDTH) * (weight << 16)).sum(axis=2)
        assert np.array_equal(out.numpy(), expected)
    assert 0 < opened.sum() < closed.sum() or num_aabbs == 2


@pytest.mark.parametrize("version", lanes.SHARED_VERTEX)
@pytest.mark.parametrize("corners", [(1, 3), (2, 2), (3, 1)])
def test_shared_vertex(version, corners):
    @wp.func_native(lanes.SHARED_VERTEX[version])
    def shared(
        corners: wp.array[wp.int32],
        block: int,
        num_corners: int,
        query_corners: wp.array[wp.int32],
        query_block: int,
        query_lane: int,
        num_query_corners: int,
    ) -> wp.uint32: ...

    @wp.kernel(module="unique", enable_backward=False)
    def run(a: wp.array[wp.int32], n: int, q: wp.array[wp.int32], m: int, out: wp.array2d[wp.uint32]):
        i, j = wp.tid()
        out[i, j] = shared(a, j, n, q, i / 16, i % 16, m)

    rng = np.random.default_rng(2)
    targets, queries = rng.integers(0, 30, (10, 3, WIDTH)), rng.integers(0, 30, (4, 3, WIDTH))
    out = wp.zeros((64, 10), dtype=wp.uint32, device="cpu")
    inputs = [on_cpu(targets, wp.int32), corners[1], on_cpu(queries, wp.int32), corners[0]]
    wp.launch(run, dim=(64, 10), inputs=inputs, outputs=[out], device="cpu")
    t = targets[:, : corners[1]].transpose(1, 0, 2).reshape(1, corners[1], 1, -1)
    q = queries[:, : corners[0]].transpose(1, 0, 2).reshape(corners[0], 1, -1, 1)
    shares = (t == q).any(axis=(0, 1)).reshape(64, 10, WIDTH)
    assert np.array_equal(out.numpy(), (shares * (1 << np.arange(WIDTH))).sum(axis=2))


@pytest.mark.parametrize("version", lanes.LEAVES)
@pytest.mark.parametrize("num_corners", [1, 2, 3])
@pytest.mark.parametrize("num_aabbs", [1, 2])
def test_leaves_vertex_aabbs_and_unions(version, num_corners, num_aabbs):
    @wp.func_native(lanes.LEAVES[version])
    def leaves(
        vertex_aabbs: wp.array[wp.float32],
        num_aabbs: int,
        corners: wp.array[wp.int32],
        num_corners: int,
        nodes: wp.array[wp.float32],
        block: int,
        count: int,
    ): ...

    @wp.func_native(lanes.UNION[version])
    def union(nodes: wp.array[wp.float32], block: int, at: int): ...

    @wp.func_native(lanes.UNITED_VERTEX_AABBS[version])
    def united(vertex_aabbs: wp.array[wp.float32], v0: int, v1: int, v2: int) -> lanes.vec8f: ...

    @wp.kernel(module="unique", enable_backward=False)
    def run(
        vertex_aabbs: wp.array[wp.float32],
        num_aabbs: int,
        corners: wp.array[wp.int32],
        n: int,
        count: int,
        nodes: wp.array[wp.float32],
        out: wp.array[wp.float32],
    ):
        b = wp.tid()
        leaves(vertex_aabbs, num_aabbs, corners, n, nodes, b, count - 16 * b)
        for f in range(num_aabbs):
            union(nodes, b * num_aabbs + f, (4 * num_aabbs + f) * 96 + b)
        c = 48 * b
        r = united(vertex_aabbs, corners[c] * num_aabbs, corners[c + 16] * num_aabbs, corners[c + 32] * num_aabbs)
        for k in range(8):
            out[8 * b + k] = r[k]

    rng = np.random.default_rng(3)
    count = 53
    vertex_aabbs = rng.standard_normal((40, num_aabbs, 8)).astype(np.float32)
    corners = rng.integers(0, 40, (4, 3, WIDTH))
    nodes = wp.zeros(5 * num_aabbs * 96, dtype=wp.float32, device="cpu")
    out = wp.zeros(32, dtype=wp.float32, device="cpu")
    inputs = [on_cpu(vertex_aabbs, wp.float32), num_aabbs, on_cpu(corners, wp.int32), num_corners, count]
    wp.launch(run, dim=4, inputs=inputs, outputs=[nodes, out], device="cpu")
    least = vertex_aabbs[corners[:, :num_corners]].min(axis=1)  # [block, lane, aabb, 8]
    least[np.arange(64).reshape(4, WIDTH) >= count] = np.inf
    expected = np.concatenate([least[..., :3], -least[..., 4:7]], axis=-1).transpose(0, 2, 3, 1)
    found = nodes.numpy().reshape(5, num_aabbs, 6, WIDTH)
    assert np.array_equal(found[:4], expected)
    assert np.array_equal(found[4, :, :3, :4], expected[:, :, :3].min(axis=3).transpose(1, 2, 0))
    assert np.array_equal(found[4, :, 3:, :4], expected[:, :, 3:].max(axis=3).transpose(1, 2, 0))
    assert np.array_equal(out.numpy().reshape(4, 8), vertex_aabbs[corners[:, :, 0], 0].min(axis=1))


@pytest.mark.parametrize("inflation", [0.0, 0.25, 5e-324])
@pytest.mark.parametrize("corners", [(1, 3), (2, 2), (3, 1)])
@pytest.mark.parametrize("version", pair_lanes.SEPARATED)
def test_boxes_that_are_apart_in_float64(version, corners, inflation):
    """Vertices on a coarse lattice and next to it, so that boxes touch exactly, or miss by one rounding."""

    @wp.func_native(pair_lanes.SEPARATED[version])
    def separated(
        vertices_t0: wp.array[wp.vec3d],
        vertices_t1: wp.array[wp.vec3d],
        inflation: wp.float64,
        corners: wp.array[wp.int32],
        block: int,
        num_corners: int,
        query_corners: wp.array[wp.int32],
        query_block: int,
        query_lane: int,
        num_query_corners: int,
        tied: wp.uint32,
    ) -> wp.uint32: ...

    @wp.kernel(module="unique", enable_backward=False)
    def run(
        vertices_t0: wp.array[wp.vec3d],
        vertices_t1: wp.array[wp.vec3d],
        inflation: wp.float64,
        a: wp.array[wp.int32],
        n: int,
        q: wp.array[wp.int32],
        m: int,
        tied: wp.uint32,
        out: wp.array2d[wp.uint32],
    ):
        i, j = wp.tid()
        out[i, j] = separated(vertices_t0, vertices_t1, inflation, a, j, n, q, i / 16, i % 16, m, tied)

    rng = np.random.default_rng(3)
    frames = 0.25 * rng.integers(-5, 5, (2, 40, 3))
    frames = np.where(rng.random(frames.shape) < 0.3, np.nextafter(frames, np.inf), frames)
    targets, queries = rng.integers(0, 40, (2, 12, 3, WIDTH)).astype(np.int32)
    queries[:, corners[1] :], targets[:, corners[0] :] = -1, -1
    tied = 0xBEEF
    out = wp.zeros((12 * WIDTH, 12), dtype=wp.uint32, device="cpu")
    vertices = [wp.array(frame, dtype=wp.vec3d, device="cpu") for frame in frames]
    arrays = [on_cpu(targets, wp.int32), corners[0], on_cpu(queries, wp.int32), corners[1]]
    inputs = [*vertices, inflation, *arrays, tied]
    wp.launch(run, dim=out.shape, inputs=inputs, outputs=[out], device="cpu")

    def boxes(blocks, count):
        points = frames[:, blocks[:, :count].transpose(0, 2, 1).reshape(-1, count)].transpose(1, 0, 2, 3)
        points = points.reshape(len(points), -1, 3)
        lower, upper = points.min(axis=1), points.max(axis=1)
        if inflation > 0:
            lower, upper = np.nextafter(lower - inflation, -np.inf), np.nextafter(upper + inflation, np.inf)
        return lower, upper

    (low, high), (query_low, query_high) = boxes(targets, corners[0]), boxes(queries, corners[1])
    apart = (low > query_high[:, None]).any(axis=2) | (query_low[:, None] > high).any(axis=2)
    expected = (apart.reshape(-1, 12, WIDTH) * (1 << np.arange(WIDTH))).sum(axis=2) & tied
    assert np.array_equal(out.numpy(), expected)
    assert 0 < apart.sum() < apart.size
