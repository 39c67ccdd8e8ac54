"""Launches that are made again with other arguments, and arrays that share a block with their gradients."""

import gc

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.step import ordered_sums

from ccd_warp._runtime.launch import Execution
from ccd_warp._runtime.parts import new_parts
from ccd_warp._runtime.repeated import RepeatedLaunches

DEVICE = "cpu"


def sums_of(launch, values, order, chunks, count):
    """What `sum_chunks` writes for the first chunks."""
    wp.init()
    given = [wp.array(x, dtype=t, device=DEVICE) for x, t in ((values, wp.float64), (order, int), (chunks, int))]
    sums = wp.full(len(chunks) - 1, value=-1.0, dtype=wp.float64, device=DEVICE)
    launch(ordered_sums.sum_chunks, count, given, [sums])
    return sums.numpy()


@pytest.mark.parametrize("num_threads", [1, 2])
def test_each_launch_has_its_own_arguments_and_items(num_threads):
    wp.init()
    repeated = RepeatedLaunches(Execution(wp.get_device(DEVICE), num_threads))
    rng = np.random.default_rng(0)
    for size, count in ((10, 10), (5, 3), (5000, 5000), (4, 0), (10, 10)):
        values, order = rng.standard_normal(2 * size), rng.permutation(2 * size)
        found = sums_of(repeated.launch, values, order, np.arange(0, 2 * size + 1, 2), count)
        expected = values[order].reshape(-1, 2).sum(axis=1)
        np.testing.assert_array_equal(found, np.where(np.arange(size) < count, expected, -1.0))


def test_a_graph_has_the_arguments_of_its_capture():
    wp.init()
    repeated = RepeatedLaunches(Execution(wp.get_device(DEVICE), 1))
    chunks, order = (wp.array(np.arange(4), dtype=int, device=DEVICE) for _ in range(2))
    arrays = [wp.array(np.full(4, x), dtype=wp.float64, device=DEVICE) for x in (1.0, 2.0)]
    sums = [wp.zeros(3, dtype=wp.float64, device=DEVICE) for _ in range(2)]
    repeated.launch(ordered_sums.sum_chunks, 3, [arrays[0], order, chunks], [sums[0]])
    with wp.ScopedCapture(device=DEVICE) as capture:
        repeated.launch(ordered_sums.sum_chunks, 3, [arrays[0], order, chunks], [sums[0]])
    repeated.launch(ordered_sums.sum_chunks, 3, [arrays[1], order, chunks], [sums[1]])
    arrays[0].fill_(5.0)
    wp.capture_launch(capture.graph)
    np.testing.assert_array_equal([x.numpy() for x in sums], [[5.0] * 3, [2.0] * 3])


def test_parts_and_their_gradients_do_not_overlap_and_stay_while_one_is_held():
    wp.init()
    parts = new_parts({"a": 3, "b": 1, "c": 4}, wp.get_device(DEVICE))
    for k, part in enumerate(parts.values()):
        assert part.requires_grad and not part.numpy().any() and not part.grad.numpy().any()
        part.fill_(k + 1.0)
        part.grad.fill_(-k - 1.0)
    last = parts["c"]
    views = [x.numpy() for x in (parts["a"], last, last.grad)]
    del parts, part
    gc.collect()
    wp.zeros(16, dtype=wp.float64, device=DEVICE)  # would take what is free
    for view, value in zip(views, (1.0, 3.0, -3.0), strict=True):
        np.testing.assert_array_equal(view, value)
