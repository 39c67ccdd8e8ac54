"""How often a call on the host waits for a CUDA device to read from it: once for all kinds of pairs."""

import sys
from functools import partial
from unittest import mock

import pytest
import warp as wp

import ccd_warp as ccd
from emulated.build import compiler
from emulated.comparison import shared
from emulated.device import emulation
from emulated.steps import STEPS

pytestmark = pytest.mark.skipif(compiler() is None, reason="no C++ compiler found: apt-get install g++, or set CXX")


def reads_of(call):
    """The functions of the library that read arrays of the device in a call, in order."""
    readers, numpy = [], wp.array.numpy

    def counted(array):
        caller = sys._getframe(1)
        if caller.f_globals.get("__name__", "").startswith("ccd_warp"):
            readers.append(caller.f_code.co_qualname)
        return numpy(array)

    with mock.patch.object(wp.array, "numpy", counted):
        call()
    return readers


@pytest.mark.parametrize(
    ("step", "most"), [("every kind of pair", (3, 2)), ("bodies far apart", (4, 3)), ("half-spaces", (4, 3))]
)
def test_counters_of_all_kinds_are_read_at_once(step, most):
    """Counts after the search, those after the narrow phase with every toi, the contacts; bodies or planes before."""
    case = STEPS[step]
    with emulation(shared().emulated):
        mesh, start, end = case.make()
        pipeline = ccd.CollisionPipeline(mesh, **case.options)
        for name, expected in zip(("mesh_ccd", "collision_free_step"), most, strict=True):
            call = partial(getattr(pipeline, name), start, end)
            call()  # the first one enlarges what is too small, and looks again
            readers = reads_of(call)
            assert 0 < len(readers) <= expected, readers
