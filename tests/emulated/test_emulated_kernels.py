"""What the kernels for CUDA are made of, on the emulated device: threads that meet, counts around those of a warp."""

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.atomics import atomic_min_int32, atomic_min_int64, claim, claim_int, set_bits
from ccd_warp.kernels.boxes.half_warp import least_together, united
from ccd_warp.kernels.boxes.lanes import vec8f
from ccd_warp.kernels.narrow_phase.pair_queue import (
    SETTLED,
    Queue,
    QueuedPair,
    enqueue,
    enqueue_contact,
    num_open,
    num_taken,
    place_of,
)
from ccd_warp.kernels.narrow_phase.sinks import Table
from ccd_warp.kernels.narrow_phase.whole_warp import agreed, claim_for, is_first, item_of_warp, latest, threads_where
from ccd_warp.kernels.pair_kind import EDGE_EDGE, VERTEX_FACE
from ccd_warp.kernels.search.search_types import Candidates, SearchOptions
from ccd_warp.kernels.step.minima import ANY_UNLISTED, CANDIDATES, FOUND, NUM_COUNTS, QUEUED, Minima
from ccd_warp.kernels.step.pair_list import LeastToi, PairList, Round
from ccd_warp.kernels.step.step import ContactList, Step
from ccd_warp.kernels.template import specialised
from hard_cases import FAMILIES

import ccd_warp as ccd
from ccd_warp._engine.boxes.box_sets import Layout
from ccd_warp._engine.boxes.grids import Grid
from ccd_warp._engine.boxes.trees import search_range
from ccd_warp._engine.mesh.topology import PrimitiveSet
from ccd_warp._runtime.launch import Execution
from ccd_warp._scene.input.options import Options
from emulated import MARKS
from emulated.device import emulation

pytestmark = MARKS

# Around every multiple of half a warp and of a warp.
COUNTS = [0, 1, 2, *(16 * k + d for k in (1, 2, 3, 4, 8) for d in (-1, 0, 1))]
Ints, Int64s, Floats, Rows = wp.array[wp.int32], wp.array[wp.int64], wp.array[wp.float64], wp.array2d[wp.int64]
INFINITY_BITS = np.float64(np.inf).view(np.int64)
FALL = [[0, 0, 1], [0, 0, 1], [0, 0, 0], [0, 0, 0]]  # of the first edge of two
# A count that 32 bits do not hold, and whose lowest 32 are plausible.
BEYOND = (1 << 32) + 7


def array(values, dtype):
    return wp.array(values, dtype=dtype, device="cpu")


def launch(kernel, dim, inputs, outputs=(), **options):
    with emulation():
        wp.launch(kernel, dim, inputs=inputs, outputs=list(outputs), device="cpu", **options)


@wp.kernel(enable_backward=False, module="unique")
def meet(values: Int64s, least: Int64s, least_int: Ints, flags: Ints, rows: Rows, counter: Ints, first: Int64s):
    i = wp.tid()
    atomic_min_int64(least, 1, values[i])
    atomic_min_int32(least_int, 1, wp.int32(values[i]))
    set_bits(flags, 1, 1 << (i % 31))
    first[i] = claim(rows, 1, 2, 1 + i % 3) + wp.int64(claim_int(counter, 1, 1))


def test_threads_that_meet_on_one_place_lose_nothing():
    count = 300
    values = np.random.default_rng(1).permutation(count) - 150
    least, least_int = array([7, 7, 7], wp.int64), array([7, 7, 7], wp.int32)
    flags, counter, rows = array([0, 0, 0], wp.int32), array([0, 0, 0], wp.int32), array(np.zeros((3, 4)), wp.int64)
    first = array(np.zeros(count), wp.int64)
    launch(meet, count, [array(values, wp.int64), least, least_int, flags, rows, counter, first])
    assert least.numpy().tolist() == least_int.numpy().tolist() == [7, -150, 7]
    assert flags.numpy().tolist() == [0, 2**31 - 1, 0] and counter.numpy().tolist() == [0, count, 0]
    assert rows.numpy().ravel().tolist() == [0] * 6 + [2 * count] + [0] * 5
    assert len(set(first.numpy())) == count and (np.diff(first.numpy()) < 0).mean() > 0.2  # in no order


@wp.kernel(enable_backward=False, module="unique")
def unite_lanes(is_set: wp.array2d[wp.int32], every: Ints, least: wp.array2d[wp.float32]):
    thread = wp.tid()
    lane = thread % 16
    lanes = wp.uint32(0)
    box = vec8f(wp.float32(100.0))
    if is_set[thread / 16, lane] != 0:
        lanes = wp.uint32(1) << wp.uint32(lane)
        for k in range(8):
            box[k] = wp.float32((7 * lane + 5 * k) % 16)
    if thread / 16 % 3 != 0:  # some half warps do something else
        every[thread] = wp.int32(united(lanes))
        box = least_together(box)
        for k in range(8):
            least[thread, k] = box[k]


def test_half_warps_unite_their_lanes_and_take_the_least():
    is_set = np.random.default_rng(2).random((64, 16)) < np.linspace(0, 1, 64)[:, None]
    is_set[5], is_set[6] = np.arange(16) == 15, np.arange(16) == 0
    every, least = array(np.zeros(1024), wp.int32), array(np.zeros((1024, 8)), wp.float32)
    launch(unite_lanes, 1024, [array(is_set, wp.int32), every, least], block_dim=64)
    lane, k, takes_part = np.arange(16)[:, None], np.arange(8), np.arange(64) % 3 != 0
    expected = np.where(is_set[:, :, None], (7 * lane + 5 * k) % 16, 100).min(axis=1) * takes_part[:, None]
    assert np.array_equal(every.numpy(), np.repeat(is_set @ (1 << np.arange(16)) * takes_part, 16))
    assert np.array_equal(least.numpy(), np.repeat(expected, 16, axis=0))


@wp.kernel(enable_backward=False, module="unique")
def claim_threads(is_set: Ints, rows: Rows, owner: Ints):
    thread = wp.tid()
    threads = threads_where(is_set[thread] != 0)
    if threads != wp.uint32(0):
        n = claim_for(threads, rows, 2, 1)
        if is_set[thread] != 0:
            owner[wp.int32(n)] = thread


def test_warps_claim_one_place_for_each_of_some_threads():
    is_set = np.random.default_rng(2).random(2048) < np.repeat(np.linspace(0, 1, 64), 32)
    rows, owner = array(np.zeros((4, 8)), wp.int64), array(np.zeros(is_set.sum()), wp.int32)
    launch(claim_threads, 2048, [array(is_set, wp.int32), rows, owner], block_dim=64)
    assert rows.numpy().sum() == is_set.sum() and np.array_equal(np.sort(owner.numpy()), np.flatnonzero(is_set))


@wp.kernel(enable_backward=False, module="unique")
def agree(times: Floats, of_float64: Floats, of_float32: wp.array[wp.float32], said: Ints, item: Ints):
    thread = wp.tid()
    of_float64[thread] = latest(times[thread])
    of_float32[thread] = latest(wp.float32(times[thread]))
    said[thread] = wp.where(agreed(times[thread] > wp.float64(0.5)), 1, 0)
    item[thread] = wp.where(is_first(thread), item_of_warp(thread, 9999), -1)


def test_threads_of_a_warp_take_the_latest_time_and_agree():
    times = np.random.default_rng(3).integers(0, 1 << 20, 256) / (1 << 20)
    of_float64, of_float32 = (array(np.zeros(256), dtype) for dtype in (wp.float64, wp.float32))
    said, item = (array(np.zeros(256), wp.int32) for _ in range(2))
    launch(agree, 256, [array(times, wp.float64), of_float64, of_float32, said, item], block_dim=32)
    warps = times.reshape(-1, 32)
    for found in (of_float64, of_float32):
        assert np.array_equal(found.numpy(), np.repeat(warps.max(axis=1), 32))
    assert np.array_equal(said.numpy(), np.repeat(warps[:, 0] > 0.5, 32))
    assert np.array_equal(item.numpy(), np.where(np.arange(256) % 32 == 0, np.arange(256) // 32, -1))


def hash_of(lower, upper, cell):
    """The spatial hash of boxes, one for each vertex, filled on the emulated device."""
    count = len(lower)
    aabbs = np.zeros((count, 8), dtype=np.float32)
    aabbs[:, :3], aabbs[:, 4:7] = lower, -upper
    corners = np.repeat(np.arange(count), 3).reshape(-1, 3)
    grid = Grid(PrimitiveSet("box", "moving", 1, array(np.arange(count), wp.int32), array(corners, wp.vec3i)))
    layout = Layout(
        1,
        lambda _, size, dtype: wp.empty(size, dtype=dtype, device="cpu"),
        lambda _: None,
        lambda: cell,
        array([], wp.int32),
    )
    grid.lay_out(layout)
    with emulation():
        Grid.fill([grid], array(aabbs.ravel(), wp.float32), Execution(wp.get_device("cpu"), 1))
    return grid


def test_blocks_with_boxes_of_different_sizes_unite_their_levels():
    """Sixteen boxes of one size fill a block, and there is a block of each; a level is twice as coarse as the last."""
    cell, sizes = 2.0**-6, np.arange(6)
    side = np.repeat(cell * 2.0**sizes, 16)[:, None]
    for order in (slice(None), slice(None, None, -1)):
        lower = np.zeros((96, 3)) - side[order] / 2
        grid = hash_of(lower, lower + side[order], cell)
        assert grid.cells.levels.numpy().tolist() == [(1 << len(sizes)) - 1]


def test_boxes_in_no_bucket_come_after_all_others():
    """Every third has a corner that is no number; their bucket is that after the last, which takes one bit more."""
    rng = np.random.default_rng(6)
    lower = rng.uniform(-0.4, 0.4, (300, 3))
    upper = lower + 0.01
    is_empty = np.arange(300) % 3 == 0
    lower[is_empty, rng.integers(3, size=100)] = np.nan
    grid = hash_of(lower, upper, 2.0**-6)
    order, buckets = grid.order.numpy()[:300], grid.buckets.numpy()[:300]
    assert np.array_equal(np.sort(order), np.arange(300)) and is_empty[order[200:]].all()
    assert (np.diff(buckets) >= 0).all() and (buckets[200:] == 1 << grid.cells.bucket_bits).all()
    begin = np.searchsorted(buckets, np.arange(len(grid.cells.bucket_begin)))
    assert np.array_equal(grid.cells.bucket_begin.numpy(), begin)


def minima_of(num_vertices):
    minima = Minima()
    minima.vertex_body = array(np.zeros(num_vertices), wp.int32)
    for name, count in (("vertex", num_vertices), ("body", 1), ("world", 1), ("scene", 1)):
        setattr(minima, name, array(np.full(count, INFINITY_BITS), wp.int64))
    minima.world_flags = minima.flags = array([0], wp.int32)
    return minima


def cull(num_listed, num_threads, *, capacity=300, found=0, beyond=0, only_if_complete=0):
    """Vertices above a face, of which every third does not come down: those that the cull leaves, counts and minima."""
    k = np.arange(num_listed)
    start = np.concatenate([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.stack([k * 0 + 0.3, k * 0 + 0.3, k * 0 + 1], 1)])
    end = start - np.concatenate([np.zeros((3, 3)), np.where(k % 3 == 1, 0, 2)[:, None] * [0, 0, 1]])
    counts = np.zeros((5, NUM_COUNTS), dtype=np.int64)
    counts[VERTEX_FACE, [CANDIDATES, FOUND]] = beyond or num_listed, found
    counts, keys = array(counts, wp.int64), array(np.full(capacity, -1), wp.int64)
    corners = array(np.repeat(np.arange(len(start)), 3).reshape(-1, 3), wp.vec3i)
    options, step, minima = SearchOptions(), Step(), minima_of(len(start))
    options.t_end = 1.0
    step.vertices_t0, step.vertices_t1 = array(start, wp.vec3d), array(end, wp.vec3d)
    step.counts, step.minima = counts, minima
    of_kind = Candidates()
    of_kind.part = search_range(0, int(VERTEX_FACE), range(0), marks_overflow=True)
    of_kind.num_threads, of_kind.candidates, of_kind.keys = num_threads, array((k + 3) << 32, wp.int64), keys
    of_kind.first_corners, of_kind.second_corners = corners, array([[0, 1, 2]], wp.vec3i)
    kernel = specialised("search.candidate_cull").cull_candidates
    launch(kernel, num_threads, [0, only_if_complete, options, of_kind, of_kind], [step])
    keys = keys.numpy()
    return np.sort(keys[keys >= 0]) >> 32, counts.numpy(), minima, (k + 3)[k % 3 != 1]


@pytest.mark.parametrize("num_threads", [32, 96, 128])
def test_every_listed_candidate_is_culled(num_threads):
    """The list is full, which is not to be too short."""
    for k, count in enumerate(COUNTS):
        found, counts, minima, expected = cull(count, num_threads, only_if_complete=k % 2)
        assert np.array_equal(found, expected), count
        assert counts[VERTEX_FACE, FOUND] == len(expected) and minima.flags.numpy()[0] == 0


def test_what_the_cull_leaves_beyond_the_capacity_has_toi_0():
    for count, capacity in ((33, 5), (33, 21), (33, 22), (100, 17)):
        found, counts, minima, expected = cull(count, 64, capacity=capacity)
        stopped = np.flatnonzero(minima.vertex.numpy() == 0)
        stopped = stopped[stopped >= 3]
        assert counts[VERTEX_FACE, FOUND] == len(expected) and len(found) == min(capacity, len(expected))
        assert np.array_equal(np.sort(np.concatenate([found, stopped])), expected)
        is_over = len(expected) > capacity
        assert minima.flags.numpy()[0] == ccd.LaunchFlag.PAIRS_OVERFLOW * is_over
        assert (minima.scene.numpy()[0] == 0) == is_over


def test_counts_beyond_32_bits():
    """They come from steps of billions of candidates, and here from a counter that says so."""
    found, counts, minima, expected = cull(40, 64, beyond=BEYOND)
    assert np.array_equal(found, expected) and counts[0, ANY_UNLISTED] == 0
    found, counts, _, _ = cull(40, 64, beyond=BEYOND, only_if_complete=1)
    assert len(found) == 0 and counts[0, ANY_UNLISTED] == 1
    found, counts, minima, expected = cull(40, 64, found=BEYOND)
    assert len(found) == 0 and counts[VERTEX_FACE, FOUND] == BEYOND + len(expected)
    assert (minima.vertex.numpy()[expected] == 0).all() and minima.flags.numpy()[0] == ccd.LaunchFlag.PAIRS_OVERFLOW


def test_warps_agree_while_others_lower_the_least_toi():
    """Edges that cross at 0.3, which settles needles that are free up to later; these take whole warps for long."""
    num_solvers = 16 * 32
    start, end = FAMILIES["needle_against_needle"]("edge-edge", 400, np.random.default_rng(0))
    hardest = np.argsort(-ccd.edge_edge_ccd(start, end, tolerance=1e-15, length_scale=1.0).iterations)[:56]
    crossing = np.array([[-1.0, 0, 0.3], [1, 0, 0.3], [0, -1, 0], [0, 1, 0]])
    first = np.arange(64) % 2 + np.arange(64) // 16 == 0  # of half of the warps
    x0, x1 = (np.where(first[:, None, None], x, 0.0) for x in (crossing, crossing - FALL))
    for x, needles in ((x0, start), (x1, end)):
        x[~first] = needles[hardest]
    options = Options(tolerance=1e-15).for_kernel(1.0)
    for _ in range(3):
        waiting = [(k, 3, 0.25 if first[k] else 0.31) for k in range(64)]
        assert 0.3 - 1e-6 <= least_of_open(x0, x1, waiting, options, num_solvers) <= 0.3


def least_of_open(x0, x1, waiting, options, num_solvers):
    """The least toi of edges that wait for the last kernel, given by their row, iterations and toi so far."""
    count = len(x0)
    pairs, queue, least = PairList(), Queue(), LeastToi()
    pairs.kind = int(EDGE_EDGE)
    pairs.keys = array(np.arange(count) * ((1 << 32) + 1), wp.int64)
    corners = [np.arange(count)[:, None] * 4 + [k, k + 1, k + 1] for k in (0, 2)]
    pairs.first_corners, pairs.second_corners = (array(c, wp.vec3i) for c in corners)
    pairs.vertices_t0, pairs.vertices_t1 = (array(x.reshape(-1, 3), wp.vec3d) for x in (x0, x1))
    counts = np.zeros((5, NUM_COUNTS), dtype=np.int64)
    counts[EDGE_EDGE, [FOUND, QUEUED]] = count, len(waiting)
    pairs.counts = array(counts, wp.int64)
    queue.pairs = array(np.array(waiting, dtype=QueuedPair.numpy_dtype()), QueuedPair)
    least.bits, least.open_toi = array([INFINITY_BITS], wp.int64), array(np.zeros(count), wp.float64)
    inputs = [0, num_solvers, pairs, options, Round(), 0, PairList(), queue]
    outputs = [Table(), Minima(), ContactList(), least]
    launch(specialised("narrow_phase.queued_pairs").pairs_bound["last"], num_solvers, inputs, outputs, block_dim=32)
    return least.bits.numpy().view(np.float64)[0]


def test_warps_find_the_only_pair_that_is_open():
    """It is in each place of a queue with so many more than there are warps that a warp looks at places twice."""
    x0 = np.array([[[-1.0, 0, 0.3], [1, 0, 0.3], [0, -1, 0], [0, 1, 0]]])
    options = Options().for_kernel(1.0)
    for place in (0, 1, 2, 3, 40, 62, 63, 64, 65, 150, 198, 199):
        waiting = [(0 if k == place else int(SETTLED), 3, 0.25) for k in range(200)]
        assert 0.3 - 1e-5 <= least_of_open(x0, x0 - FALL, waiting, options, 2 * 32) <= 0.3


@wp.kernel(enable_backward=False, module="unique")
def fill_queue(is_contact: Ints, counts: Rows, queue: Queue):
    pair = QueuedPair()
    pair.row = wp.tid()
    if is_contact[pair.row] != 0:
        queue.contact[enqueue_contact(queue, counts, 2, 1, pair)] = wp.vec4d(wp.float64(pair.row))
    else:
        enqueue(queue, counts, 2, 1, pair)


@wp.kernel(enable_backward=False, module="unique")
def read_queue(counts: Rows, queue: Queue, rows: Ints):
    n = wp.tid()
    if n < num_taken(counts[2, 1]):
        place = place_of(n, counts[2, 1], queue)
        rows[n] = queue.pairs[place].row
        if n >= num_open(counts[2, 1]):
            rows[n] = wp.int32(queue.contact[place][0])


def test_contacts_stand_behind_the_open_pairs_of_a_queue():
    """Of a queue that is full, and of arrays of which one is longer."""
    is_contact = np.random.default_rng(7).random(300) < 0.7
    for num_pairs, num_contacts in ((300, 300), (450, 300), (300, 450)):
        queue, counts, rows = Queue(), array(np.zeros((4, 8)), wp.int64), array(np.full(400, -1), wp.int32)
        queue.pairs = array(np.zeros(num_pairs, dtype=QueuedPair.numpy_dtype()), QueuedPair)
        queue.contact = array(np.zeros((num_contacts, 4)), wp.vec4d)
        launch(fill_queue, 300, [array(is_contact, wp.int32), counts, queue])
        launch(read_queue, 400, [counts, queue, rows])
        end, found = (~is_contact).sum(), rows.numpy()
        assert np.array_equal(np.sort(found[:end]), np.flatnonzero(~is_contact))
        assert np.array_equal(np.sort(found[end:300]), np.flatnonzero(is_contact)) and (found[300:] == -1).all()
