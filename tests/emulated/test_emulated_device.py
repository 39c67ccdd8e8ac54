"""The emulated device itself: threads that wait for each other, and the faults that it finds."""

import numpy as np
import pytest
import warp as wp

from emulated import MARKS
from emulated.device import emulation

pytestmark = MARKS


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


def launch(kernel, dim, *inputs, **options):
    with emulation():
        wp.launch(kernel, dim, inputs=list(inputs), device="cpu", **options)


def zeros(count, dtype=int):
    return wp.zeros(count, dtype=dtype, device="cpu")


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


def test_afterwards_the_cpu_is_the_cpu():
    device = wp.get_device("cpu")
    before = type(device).is_cuda, wp.array.numpy, wp.Event
    with emulation():
        assert type(device).is_cuda is not before[0] and device.is_cpu  # for Warp and for tests
    assert (type(device).is_cuda, wp.array.numpy, wp.Event) == before
    assert not hasattr(type(device), "captures")
