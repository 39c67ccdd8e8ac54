"""A recorded launch that stays packed: its parts, other arguments, and versions of Warp that pack otherwise."""

import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.step.contacts import NO_CONTACT, reset_first

from ccd_warp._runtime.packed import PackedLaunch

RANGES = [(0, 3), (3, 5), (5, 9), (9, 10)]


def packed(ranges=RANGES):
    """A launch over so many numbers that marks each; and the numbers, all 0."""
    values = wp.zeros(ranges[-1][1], dtype=wp.int32, device="cpu")
    command = wp.launch(reset_first, dim=len(values), inputs=[0, values], device="cpu", record_cmd=True)
    return PackedLaunch(command, ranges), values


def marked(values):
    return np.flatnonzero(values.numpy() == int(NO_CONTACT)).tolist()


def test_launches_are_packed_with_this_version_of_warp():
    launch, values = packed()
    assert len(launch.parts()) == len(RANGES)
    assert marked(values) == []  # packing runs nothing


@pytest.mark.parametrize("chosen", [[0], [1], [3, 0], [2, 1]])
def test_parts_cover_their_ranges(chosen):
    launch, values = packed()
    for k in chosen:
        launch.parts()[k]()
    assert marked(values) == sorted(item for k in chosen for item in range(*RANGES[k]))


def test_parts_run_at_once():
    ranges = [(k, k + 1) for k in range(64)]
    launch, values = packed(ranges)
    with ThreadPoolExecutor(4) as pool:
        for _ in range(50):
            values.zero_()
            list(pool.map(lambda part: part(), launch.parts()))
            assert marked(values) == list(range(64))


@pytest.mark.parametrize("is_packed", [False, True])
def test_other_arguments(is_packed):
    launch, values = packed()
    if is_packed:
        launch.parts()
    others = wp.zeros_like(values)
    launch.bind(1, others)
    launch.parts()[1]()
    assert (marked(values), marked(others)) == ([], [3, 4])
    launch.launch()
    assert (marked(values), marked(others)) == ([], list(range(10)))


def test_a_launch_into_a_graph_is_whole():
    launch, values = packed()
    launch.parts()
    with wp.ScopedCapture(device="cpu") as capture:
        launch.launch()
    values.zero_()
    wp.capture_launch(capture.graph)
    assert marked(values) == list(range(10))


def test_arrays_are_freed_with_the_launch():
    launch, values = packed()
    launch.parts()[0]()
    is_alive = weakref.ref(values)
    del launch, values
    assert is_alive() is None


@pytest.mark.parametrize("error", [AttributeError, TypeError, None])
def test_a_version_of_warp_that_packs_otherwise_launches_the_whole(error, monkeypatch):
    launch, values = packed()
    real = wp.Launch.launch

    def otherwise(command):
        if hasattr(command.hooks, "backward"):
            real(command)
        elif error is not None:  # it needs more than the stand-in for the kernel has; or it does not call it
            raise error("hooks")

    monkeypatch.setattr(wp.Launch, "launch", otherwise)
    (whole,) = launch.parts()
    whole()
    assert marked(values) == list(range(10))
    others = wp.zeros_like(values)
    launch.bind(1, others)
    launch.parts()[0]()
    assert marked(others) == list(range(10))
    is_alive = weakref.ref(others)
    del launch, others, whole
    assert is_alive() is None
