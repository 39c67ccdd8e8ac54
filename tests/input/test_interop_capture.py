"""What a library is asked for while a stream is captured into a graph: without a GPU, by a stand-in for its array.

The stand-in keeps the rules of ``__dlpack__`` as the three libraries have them (PyTorch ``torch/_tensor.py``, CuPy
``cupy/_core/core.pyx``, JAX ``jaxlib/dlpack.cc``): a stream that is not the library's own waits for an event of the
library's stream, and CUDA ends a capture on a stream that is told to wait for an event from outside it.
"""

from types import SimpleNamespace

import faults
import numpy as np
import pytest
import scenes
import warp as wp

import ccd_warp as ccd
from ccd_warp._input.interop import as_warp

STREAM = 7
CUDA, PINNED, MANAGED = 2, 3, 13


class CaptureLost(RuntimeError):
    """CUDA's error 905: a dependency on work outside the capture."""


class Array:
    """An array of another library on a GPU, whose memory is that of the host, so that Warp can read it here."""

    def __init__(self, values, device, kind=CUDA):
        self.values, self.device, self.kind = values, device, kind
        self.shape = values.shape
        self.asked = []

    def __dlpack_device__(self):
        return self.kind, 0

    def __dlpack__(self, *, stream=None):
        self.asked.append(stream)
        self.synchronize(stream)
        return self.values.__dlpack__()

    def synchronize(self, stream):
        """As PyTorch and CuPy do: -1 says to do nothing, and no stream at all is the default stream."""
        if stream != -1 and self.device.is_capturing:
            raise CaptureLost("operation would create a dependency on work outside the capture")


def array_of_jax(*arguments):
    """As JAX does: any number is the address of a stream, and without one the host waits."""

    def synchronize(self, stream):
        if stream is not None and (stream != STREAM or self.device.is_capturing):
            raise CaptureLost(f"there is no stream at {stream}, or it is captured")

    return type("Array", (Array,), {"synchronize": synchronize, "__module__": "jaxlib._jax"})(*arguments)


@pytest.fixture
def gpu(monkeypatch):
    """A CUDA device as far as arrays ask for it."""
    device = SimpleNamespace(is_capturing=False, stream=SimpleNamespace(cuda_stream=STREAM))
    monkeypatch.setattr(wp, "get_cuda_device_count", lambda: 1)
    monkeypatch.setattr(wp, "get_cuda_device", lambda index=None: device)
    return device


@pytest.mark.parametrize("make, expected", [(Array, -1), (array_of_jax, None)])
@pytest.mark.parametrize("kind", [CUDA, MANAGED])
def test_a_capture_is_not_told_to_wait_for_another_library(gpu, make, expected, kind):
    values = np.arange(12.0).reshape(4, 3)
    theirs = make(values, gpu, kind)
    gpu.is_capturing = True
    array = as_warp(theirs, "vertices_t0")
    assert array.ptr == values.ctypes.data
    assert theirs.asked == [expected]


@pytest.mark.parametrize("make", [Array, array_of_jax])
def test_outside_a_capture_the_stream_of_warp_waits_for_the_other_library(gpu, make):
    theirs = make(np.zeros((4, 3)), gpu)
    as_warp(theirs, "vertices_t0")
    assert theirs.asked == [STREAM]


@pytest.mark.parametrize("is_capturing", [False, True])
def test_a_pinned_tensor_has_no_stream(gpu, is_capturing):
    class Pinned(Array):
        def synchronize(self, stream):
            assert stream is None or stream == -1, "stream should be None on cpu."  # in PyTorch's words

    gpu.is_capturing = is_capturing
    theirs = Pinned(np.zeros((4, 3)), gpu, PINNED)
    assert as_warp(theirs, "vertices_t0").ptr == theirs.values.ctypes.data
    assert theirs.asked == [None]


def test_a_launch_and_pairs_take_arrays_of_a_library_in_a_capture(gpu):
    gpu.is_capturing = True
    start = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [1, -1, -1], [1, 1, -1], [1, 0, 1]])
    end = start + np.array([[2.0, 0, 0]] * 3 + [[0.0, 0, 0]] * 3)
    mesh = ccd.CollisionMesh.from_arrays([(start[:3], [[0, 1, 2]]), (start[3:], [[0, 1, 2]])])
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device="cpu")
    toi = pipeline.launch(Array(start, gpu), Array(end, gpu)).toi.numpy()[0]
    assert toi == ccd.mesh_ccd(mesh, start, end, length_scale=1.0, device="cpu").toi
    points = [np.stack([x[[0, 3, 4, 5]]] * 2) for x in (start, end)]
    pairs = ccd.vertex_face_ccd(*(Array(x, gpu) for x in points), device="cpu")
    assert pairs.toi.numpy()[0] == ccd.vertex_face_ccd(*points, device="cpu").toi[0]


@pytest.mark.parametrize("kind", scenes.CORNERS)
def test_pairs_of_numpy_in_a_capture_are_refused(kind):
    """A graph would hold the values that they have now; once the capture is over they are answered."""
    call = getattr(ccd, f"{kind}_ccd")
    start, end = scenes.random_pairs(kind, 100)
    with pytest.raises(RuntimeError, match=r"(?i)captur.*(warp|device)"), wp.ScopedCapture(device="cpu"):
        call(start, end, device="cpu")
    on_device = (wp.array(x, dtype=wp.vec3d, device="cpu") for x in (start, end))
    truth = faults.arrays_of(call(*on_device, device="cpu"))
    assert faults.difference(faults.arrays_of(call(start, end, device="cpu")), truth) == ""
