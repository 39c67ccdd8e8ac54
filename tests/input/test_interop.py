"""Arrays of other libraries in and out, in the same memory: the pointers say that nothing was copied.

What a library is asked for while a stream is captured is tested by a stand-in for its array, which keeps the rules of
``__dlpack__`` as the three libraries have them (PyTorch ``torch/_tensor.py``, CuPy ``cupy/_core/core.pyx``, JAX
``jaxlib/dlpack.cc``): a stream that is not the library's own waits for an event of the library's stream, and CUDA ends
a capture on a stream that is told to wait for an event from outside it.
"""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from every_call import CALLS

import ccd_warp as ccd
from ccd_warp._input.interop import as_warp

WALL = np.array([[1.0, -1, -1], [1, 1, -1], [1, 0, 1]])
BULLET = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
START = np.concatenate([BULLET, WALL])
END = np.concatenate([BULLET + [2.0, 0, 0], WALL])
MESH = ccd.CollisionMesh.from_arrays([(BULLET, [[0, 1, 2]]), (WALL, [[0, 1, 2]])])
PAIR = [np.stack([x[[0, 3, 4, 5]]]) for x in (START, END)]


@pytest.fixture
def pipeline():
    return ccd.CollisionPipeline(MESH, length_scale=1.0, device="cpu")  # where these arrays are


class Library:
    """NumPy, or a library beside it: how to make an array, to find where it is, and to read an array of Warp."""

    def __init__(self, name):
        self.name = name
        self.module = np if name == "numpy" else pytest.importorskip(name)
        if name == "jax":
            self.module.config.update("jax_enable_x64", True)

    def array(self, values):
        if self.name == "torch":
            return self.module.from_numpy(np.array(values))
        return np.array(values) if self.name == "numpy" else self.module.numpy.array(values)

    def pointer(self, array):
        if self.name == "numpy":
            return array.ctypes.data
        return array.data_ptr() if self.name == "torch" else array.unsafe_buffer_pointer()

    def from_warp(self, array):
        return (self.module.dlpack if self.name == "jax" else self.module).from_dlpack(array)


@pytest.fixture(params=["numpy", "torch", "jax"])
def library(request):
    return Library(request.param)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_launch_reads_where_it_is_and_results_go_out_where_they_are(library, dtype, pipeline):
    start, end = library.array(START.astype(dtype)), library.array(END.astype(dtype))
    result = pipeline.launch(start, end)
    expected = ccd.mesh_ccd(MESH, START.astype(dtype), END.astype(dtype), length_scale=1.0)
    assert ccd.mesh_ccd(MESH, start, end, length_scale=1.0).toi == expected.toi < np.inf
    np.testing.assert_array_equal(MESH.frames(start, end)[1], END.astype(dtype))
    np.testing.assert_array_equal(result.vertex_toi.numpy(), expected.vertex_toi)
    for name in ("toi", "vertex_toi", "body_toi", "world_toi", "flags"):
        array = getattr(result, name)
        theirs = library.from_warp(array)
        assert library.pointer(theirs) == array.ptr
        np.testing.assert_array_equal(np.asarray(theirs), array.numpy())
    assert np.asarray(library.from_warp(result.contacts.normal)).shape == (len(result.contacts.kind), 3)
    if library.name != "jax":  # whose arrays do not change
        points = result.contacts.points.numpy()[: len(expected.contacts)].copy()
        for array in (start, end):
            array[:] += 1.0
        is_copied = library.name == "numpy" or dtype is np.float32  # so few positions, or converted by the kernel
        moved = result.contacts.points.numpy()[: len(points)] - points
        np.testing.assert_allclose(moved, 0.0 if is_copied else 1.0, atol=1e-6)


def test_pairs_are_read_where_they_are(library, monkeypatch):
    seen, launch = [], ccd._pair_ccd.Execution.launch

    def watched(execution, kernel, count, inputs, outputs, **options):
        seen.append([outputs[0].points_t0.ptr, outputs[0].points_t1.ptr])
        launch(execution, kernel, count, inputs, outputs, **options)

    monkeypatch.setattr(ccd._pair_ccd.Execution, "launch", watched)
    # more than the few of NumPy that are copied to where a launch has been recorded
    frames = [library.array(np.repeat(points, 600, axis=0)) for points in PAIR]
    toi = ccd.vertex_face_ccd(*frames, device="cpu").toi
    assert seen == [[library.pointer(x) for x in frames]]
    assert isinstance(toi, np.ndarray) or library.pointer(library.from_warp(toi)) == toi.ptr
    assert np.asarray(toi)[0] == pytest.approx(0.5, abs=1e-12)


def test_warp_arrays_are_read_on_the_host(pipeline):
    start, end = (wp.array(x, dtype=wp.vec3d, device="cpu") for x in (START, END))
    assert ccd.mesh_ccd(MESH, start, end, length_scale=1.0).toi == pipeline.mesh_ccd(START, END).toi
    assert MESH.frames(start, end)[0].ctypes.data == start.ptr


def test_line_search_writes_where_it_is(library, pipeline):
    start, wished = library.array(START), library.array(END)
    if library.name == "jax":
        with pytest.raises(ValueError, match="vertices_t1 is an array of JAX, which does not change"):
            pipeline.launch_line_search(start, wished)
        return
    pipeline.launch_line_search(start, wished, safety=0.9)
    assert np.asarray(wished)[:3, 0].max() == pytest.approx(0.1 + 0.9 * 0.9)
    if library.name == "numpy":
        wished.flags.writeable = False
        with pytest.raises(ValueError, match="vertices_t1 is read-only; expected an array that can be written to"):
            pipeline.launch_line_search(start, wished)


def test_a_loop_in_torch_on_one_graph(pipeline):
    torch = pytest.importorskip("torch")
    start, end = torch.from_numpy(START.copy()), torch.from_numpy(END.copy())
    toi = torch.from_dlpack(pipeline.launch(start, end).toi)
    with wp.ScopedCapture(device="cpu") as capture:
        pipeline.launch(start, end)
    for distance in (2.0, 4.0, 0.5):
        end[:3] = start[:3] + torch.tensor([distance, 0.0, 0.0])
        wp.capture_launch(capture.graph)
        assert toi.item() == pipeline.mesh_ccd(start, end).toi <= (1.0 / distance if distance >= 1 else np.inf)


# ---- What cannot be read ---------------------------------------------------------------------------------------------


def foreign(name, device=(1, 0), **members):
    """An array of six positions that cannot be shared, on a device or one that it does not tell."""

    def refuse(*_, **__):
        raise BufferError("not now")

    def where(_):
        if isinstance(device, Exception):
            raise device
        return device

    return type(name, (), {"shape": (6, 3), "__dlpack__": refuse, "__dlpack_device__": where} | members)()


def _grad(*_, **__):
    raise RuntimeError("Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy() instead.")


def test_an_array_that_cannot_be_shared_is_named(pipeline):
    of_grad, silent = foreign("Grad", __array__=_grad, __dlpack__=_grad), foreign("Silent", TypeError("deleted"))
    far, cannot = foreign("Far", (2, 99)), "is a Grad that cannot be shared: .*detach.*; expected one that can"
    for call, message in (
        (lambda: ccd.mesh_ccd(MESH, START, far), "vertices_t1 is a Far on a GPU; expected an array on the host"),
        (lambda: pipeline.launch(far, END), "vertices_t0 is a Far on cuda:99; expected it on one of cpu"),
        (lambda: pipeline.launch(silent, END), "vertices_t0 is a Silent that cannot be shared: deleted"),
        (lambda: ccd.mesh_ccd(MESH, silent, END), "vertices_t0 is a Silent that cannot be shared: deleted"),
        (lambda: pipeline.launch(START, of_grad), f"vertices_t1 {cannot}"),
        (lambda: ccd.mesh_ccd(MESH, START, of_grad), f"vertices_t1 {cannot}"),
        (lambda: ccd.CollisionMesh.from_arrays([(of_grad, [[0, 1, 2]])]), f"vertices {cannot}"),
    ):
        with pytest.raises(ValueError, match=message):
            call()


@pytest.mark.parametrize("name", ["torch", "jax"])
def test_bad_arrays_of_other_libraries_are_named(name, pipeline):
    library = Library(name)
    good, single = library.array(START), [library.array(points.astype(np.float32)) for points in PAIR]
    calls = [
        (lambda: pipeline.launch(good, library.array(START.astype(np.int64))), "vertices_t1 has dtype int64 and shape"),
        (lambda: pipeline.launch(library.array(BULLET), good), "vertices_t0 has 3 rows; expected 6, one a vertex"),
        (lambda: ccd.vertex_face_ccd(*single), r"points_t0 has dtype float32 and shape \(1, 4, 3\); expected vec3d"),
        (lambda: ccd.vertex_face_ccd(library.array(PAIR[0]), PAIR[1]), "points_t1 is a ndarray; expected a"),
    ]
    if name == "torch":
        torch, with_gradient = library.module, good.clone().requires_grad_()
        strided, cannot = torch.zeros(6, 6, dtype=torch.float64)[:, :3], "vertices_t0 is a Tensor that cannot be shared"
        calls += [
            (lambda: pipeline.launch(good, strided), r"vertices_t1 has strides \(48, 8\); expected a contiguous array"),
            (lambda: pipeline.launch(with_gradient, good), f"{cannot}: .*gradient"),
            (lambda: ccd.mesh_ccd(MESH, with_gradient, good), f"{cannot}: .*grad"),
            (lambda: ccd.mesh_ccd(MESH, good.to(torch.bfloat16), good), f"{cannot}: .*BFloat16"),
        ]
    for call, message in calls:
        with pytest.raises(ValueError, match=message):
            call()


# ---- While a stream is captured --------------------------------------------------------------------------------------

STREAM, CUDA, PINNED, MANAGED = 7, 2, 3, 13


class CaptureLost(RuntimeError):
    """CUDA's error 905: a dependency on work outside the capture."""


class Array:
    """An array of another library on a GPU, whose memory is that of the host, so that Warp can read it here."""

    def __init__(self, values, device, kind=CUDA):
        self.values, self.device, self.kind, self.shape, self.asked = values, device, kind, values.shape, []

    def __dlpack_device__(self):
        return self.kind, 0

    def __dlpack__(self, *, stream=None):
        self.asked.append(stream)
        self.synchronize(stream)
        return self.values.__dlpack__()

    def synchronize(self, stream):
        """As PyTorch and CuPy do: -1 says to do nothing, and no stream at all is the default stream."""
        if self.kind == PINNED:
            assert stream is None or stream == -1, "stream should be None on cpu."  # in PyTorch's words
        elif stream != -1 and self.device.is_capturing:
            raise CaptureLost("operation would create a dependency on work outside the capture")


class ArrayOfJax(Array):
    """As JAX does: any number is the address of a stream, and without one the host waits."""

    def synchronize(self, stream):
        if stream is not None and (stream != STREAM or self.device.is_capturing):
            raise CaptureLost(f"there is no stream at {stream}, or it is captured")


ArrayOfJax.__module__ = "jaxlib._jax"


@pytest.fixture
def gpu(monkeypatch):
    """A CUDA device as far as arrays ask for it."""
    device = SimpleNamespace(is_capturing=False, stream=SimpleNamespace(cuda_stream=STREAM))
    monkeypatch.setattr(wp, "get_cuda_device_count", lambda: 1)
    monkeypatch.setattr(wp, "get_cuda_device", lambda index=None: device)
    return device


@pytest.mark.parametrize(
    ("make", "kind", "is_capturing", "asked"),
    [
        *((Array, kind, True, -1) for kind in (CUDA, MANAGED)),
        *((ArrayOfJax, kind, True, None) for kind in (CUDA, MANAGED)),
        *((make, CUDA, False, STREAM) for make in (Array, ArrayOfJax)),
        *((Array, PINNED, is_capturing, None) for is_capturing in (False, True)),  # has no stream
    ],
)
def test_a_capture_does_not_wait_for_another_library_and_the_stream_of_warp_does(gpu, make, kind, is_capturing, asked):
    theirs = make(np.arange(12.0).reshape(4, 3), gpu, kind)
    gpu.is_capturing = is_capturing
    assert as_warp(theirs, "vertices_t0").ptr == theirs.values.ctypes.data and theirs.asked == [asked]


def test_a_launch_and_pairs_take_arrays_of_a_library_in_a_capture(gpu, pipeline):
    gpu.is_capturing = True
    assert pipeline.launch(Array(START, gpu), Array(END, gpu)).toi.numpy()[0] == pipeline.mesh_ccd(START, END).toi
    pairs = ccd.vertex_face_ccd(*(Array(x, gpu) for x in PAIR), device="cpu")
    assert pairs.toi.numpy()[0] == ccd.vertex_face_ccd(*PAIR).toi[0]


@pytest.mark.parametrize("name", ["vertex_face_ccd", "edge_edge_ccd", "point_segment_ccd", "point_point_ccd"])
def test_pairs_of_numpy_in_a_capture_are_refused(name):
    """A graph would hold the values that they have now; once the capture is over they are answered."""
    call, arguments = CALLS[name]
    points = [np.repeat(arguments[end], 100, axis=0) for end in ("points_t0", "points_t1")]
    with pytest.raises(RuntimeError, match=r"(?i)captur.*(warp|device)"), wp.ScopedCapture(device="cpu"):
        call(*points, device="cpu")
    dtype = wp.vec3d if points[0].shape[2] == 3 else wp.vec2d
    on_device = call(*(wp.array(x, dtype=dtype, device="cpu") for x in points))
    for field, value in vars(call(*points, device="cpu")).items():
        np.testing.assert_array_equal(value, getattr(on_device, field).numpy(), err_msg=field)
