"""The emulated device itself: its collectives, its atomics, its order, and the faults that it finds."""

import numpy as np
import pytest
import warp as wp

from emulated import MARKS
from emulated.device import emulation

pytestmark = MARKS


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const unsigned half = 0xffffu << (threadIdx.x & 16);
    const int shift = threadIdx.x & 16;
    const unsigned voted = __ballot_sync(half, i % 3 == 0) >> shift;
    int sum = i;
    for (int distance = 8; distance > 0; distance >>= 1)
        sum += __shfl_xor_sync(half, sum, distance, 16);
    const int first = __shfl_sync(half, i, 0, 16);
    __syncwarp(half);
    if ((threadIdx.x & 15) == 0)
        atomicAdd(total.data, sum);
    values.data[4 * i] = (int)voted;
    values.data[4 * i + 1] = sum;
    values.data[4 * i + 2] = first;
    values.data[4 * i + 3] = __shfl_down_sync(half, i, 3, 16);
#endif
"""
)
def vote(i: int, values: wp.array[int], total: wp.array[int]): ...


@wp.kernel(enable_backward=False, module="unique")
def half_warps(values: wp.array[int], total: wp.array[int]):
    vote(wp.tid(), values, total)


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    __shared__ int seen[256];
    seen[threadIdx.x] = i;
    __syncthreads();
    values.data[i] = seen[blockDim.x - 1 - threadIdx.x];
#endif
"""
)
def exchange_in_block(i: int, values: wp.array[int]): ...


@wp.kernel(enable_backward=False, module="unique")
def reversed_in_blocks(values: wp.array[int]):
    exchange_in_block(wp.tid(), values)


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    if (fault == 1 && i == 77)
        return;
    if (fault == 2 && i == 77)
        __shfl_sync(0xffffffffu, i, 0);
    else if (fault == 3)
        __ballot_sync(1u, 1);
    else if (fault == 4 && i == 77)
        __trap();
    else if (fault == 5)
        __ldg((const float4*)((const char*)values.data + 4));
    else
        values.data[i] = __any_sync(0xffffffffu, i == 5);
#endif
"""
)
def fail(i: int, fault: int, values: wp.array[int]): ...


@wp.kernel(enable_backward=False, module="unique")
def faulty(fault: int, values: wp.array[int]):
    fail(wp.tid(), fault, values)


@wp.kernel(enable_backward=False, module="unique")
def count_and_order(total: wp.array[wp.int64], least: wp.array[wp.float64], place: wp.array[int], order: wp.array[int]):
    i = wp.tid()
    wp.atomic_add(total, 0, wp.int64(i))
    wp.atomic_min(least, 0, -wp.float64(i))
    order[wp.atomic_add(place, 0, 1)] = i


@wp.kernel(enable_backward=False, module="unique")
def least_and_largest(a: wp.array[wp.float64], b: wp.array[wp.float64], out: wp.array2d[wp.float64]):
    i = wp.tid()
    out[i, 0] = wp.min(a[i], b[i])
    out[i, 1] = wp.max(a[i], b[i])


def launch(kernel, dim, *inputs, **options):
    with emulation():
        wp.launch(kernel, dim, inputs=list(inputs), device="cpu", **options)


def zeros(count, dtype=int):
    return wp.zeros(count, dtype=dtype, device="cpu")


def test_half_warps_vote_and_exchange():
    values, total = zeros(4 * 512), zeros(1)
    launch(half_warps, 512, values, total)
    i = np.arange(512).reshape(-1, 16)
    voted, sums, first, below = values.numpy().reshape(-1, 16, 4).transpose(2, 0, 1)
    assert (voted == ((i % 3 == 0) << np.arange(16)).sum(axis=1)[:, None]).all()
    assert (sums == i.sum(axis=1)[:, None]).all() and total.numpy()[0] == i.sum()
    assert (first == i[:, :1]).all()
    assert (below == np.where(np.arange(16) + 3 < 16, i + 3, i)).all()


def test_threads_of_a_block_wait_for_each_other():
    values = zeros(512)
    launch(reversed_in_blocks, 512, values, block_dim=128)
    assert (values.numpy() == np.arange(512).reshape(-1, 128)[:, ::-1].ravel()).all()


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (1, "divergence: lane [0-9]+ of a warp waits at __any_sync with mask ffffffff for lane 13, which has ended"),
        (2, "divergence: lane .* for lane .*, which waits at __(any|shfl)_sync with mask ffffffff"),
        (3, "calls __ballot_sync with mask 00000001, which does not name it"),
        (4, "__trap"),
        (5, "__ldg of 16 bytes from .*, which is not aligned"),
    ],
)
def test_faults_are_errors_and_the_next_launch_works(fault, message):
    values = zeros(128)
    with pytest.raises(RuntimeError, match=message):
        launch(faulty, 128, fault, values)
    launch(faulty, 128, 0, values)
    assert (values.numpy() == (np.arange(128) < 32)).all()


def test_fault_in_the_replay_of_a_graph_is_raised_at_the_end():
    values = zeros(128)
    with pytest.raises(RuntimeError, match="__trap"), emulation():
        with wp.ScopedCapture(device="cpu") as capture:
            wp.launch(faulty, 128, inputs=[4, values], device="cpu")
        wp.capture_launch(capture.graph)


def test_two_threads_lose_no_atomic_operation_and_come_in_no_order():
    count = 200_000
    total, least, place, order = zeros(1, wp.int64), zeros(1, wp.float64), zeros(1), zeros(count)
    launch(count_and_order, count, total, least, place, order)
    assert total.numpy()[0] == count * (count - 1) // 2
    assert least.numpy()[0] == 1 - count and place.numpy()[0] == count
    order = order.numpy()
    assert (np.sort(order) == np.arange(count)).all() and (np.diff(order) < 0).mean() > 0.2


def test_zeros_have_signs_and_numbers_win_over_those_that_are_none():
    a = np.array([0.0, -0.0, np.nan, 1.0, np.nan, 2.0])
    b = np.array([-0.0, 0.0, 1.0, np.nan, np.nan, 3.0])
    out = wp.zeros((6, 2), dtype=wp.float64, device="cpu")
    launch(least_and_largest, 6, *(wp.array(x, dtype=wp.float64, device="cpu") for x in (a, b)), out)
    least, largest = out.numpy().T
    np.testing.assert_array_equal(least, [0, 0, 1, 1, np.nan, 2])
    np.testing.assert_array_equal(np.signbit(least[:2]), True)
    np.testing.assert_array_equal(np.signbit(largest[:2]), False)


def test_afterwards_the_cpu_is_the_cpu():
    device = wp.get_device("cpu")
    before = type(device).is_cuda, wp.array.numpy, wp.Event
    with emulation():
        assert type(device).is_cuda is not before[0] and device.is_cpu  # for Warp and for tests
    assert (type(device).is_cuda, wp.array.numpy, wp.Event) == before
    assert not hasattr(type(device), "captures")
