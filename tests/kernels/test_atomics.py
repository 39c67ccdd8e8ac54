"""Atomics between threads of the CPU: nothing is lost, where plain reads and writes lose something now and then."""

import os

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.atomics import atomic_min_int64, claim, set_bits

from ccd_warp._runtime.launch import Execution, load

NUM_ROUNDS = 2_000
MOST_SPINS = wp.constant(1_000_000)  # about a millisecond, should one thread have to wait for a core
pytestmark = pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="two threads on one core do not meet")


@wp.func_native("return *(volatile long long*)values.data;")
def first_now(values: wp.array2d[wp.int64]) -> wp.int64:
    """values[0, 0], read anew each time."""
    ...


@wp.kernel
def in_step(
    thread: int,
    num_rounds: int,
    barrier: wp.array2d[wp.int64],
    values: wp.array2d[wp.int64],
    minima: wp.array[wp.int64],
    flags: wp.array[wp.int32],
):
    """Two threads wait for each other, and then go for the same places, in each round another first."""
    for k in range(num_rounds):
        for what in range(2):
            claim(barrier, 0, 0, 1)
            patience = wp.int32(MOST_SPINS)
            while patience > 0 and first_now(barrier) < wp.int64(2 * (2 * k + what + 1)):
                patience -= 1
            if what == 0:
                atomic_min_int64(minima, k, values[thread, k])
            else:
                set_bits(flags, k, 1 << thread)


def test_nothing_is_lost_between_threads():
    values = np.random.default_rng(0).integers(0, 2**62, (2, NUM_ROUNDS))
    minima = wp.full(NUM_ROUNDS, value=2**62, dtype=wp.int64, device="cpu")
    flags, barrier = (
        wp.zeros(shape, dtype=t, device="cpu") for shape, t in ((NUM_ROUNDS, wp.int32), ((2, 8), wp.int64))
    )
    inputs = [NUM_ROUNDS, barrier, wp.array(values, dtype=wp.int64, device="cpu"), minima, flags]
    load(in_step, wp.get_device("cpu"))
    tasks = [lambda k=k: wp.launch(in_step, dim=1, inputs=[k, *inputs], device="cpu") for k in range(2)]
    Execution(wp.get_device("cpu"), 2).run(tasks)
    assert barrier.numpy()[0, 0] == 4 * NUM_ROUNDS  # no count, either
    np.testing.assert_array_equal(minima.numpy(), values.min(axis=0))
    assert (flags.numpy() == 3).all()
