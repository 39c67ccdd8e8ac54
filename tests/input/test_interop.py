"""Arrays of other libraries in and out, in the same memory: the pointers say that nothing was copied.

A stand-in keeps the rules of ``__dlpack__`` as PyTorch, CuPy and JAX have them: a stream that is not the library's own
waits for an event of the library's stream, and CUDA ends a capture on a stream that is told to wait for such an event.
"""

from contextlib import contextmanager, nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

import ccd_warp as ccd
from ccd_warp._calls import pipeline as pipeline_calls
from ccd_warp._calls.small_batch import CAPACITY
from ccd_warp._engine.host.contact_step import ContactStep
from ccd_warp._runtime import streams
from ccd_warp._runtime.launch import Execution, leaves_out_launches
from ccd_warp._scene.input.interop import as_warp

WALL = np.array([[1.0, -1, -1], [1, 1, -1], [1, 0, 1]])
BULLET = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
START = np.concatenate([BULLET, WALL])
END = np.concatenate([BULLET + [2.0, 0, 0], WALL])
MESH = ccd.CollisionMesh.from_arrays([(BULLET, [[0, 1, 2]]), (WALL, [[0, 1, 2]])])
PAIR = [np.stack([x[[0, 3, 4, 5]]]) for x in (START, END)]
ON_CPU = ccd.CollisionPipeline(MESH, length_scale=1.0, device="cpu")  # where these arrays are


@pytest.fixture(params=["numpy", "torch", "jax"])
def library(request):
    """NumPy, or a library beside it: how to make an array, to find where it is, and to read an array of Warp."""
    name = request.param
    module = np if name == "numpy" else pytest.importorskip(name)
    on_cpu = nullcontext()
    if name == "jax":
        module.config.update("jax_enable_x64", True)
        on_cpu = module.default_device(module.devices("cpu")[0])
    array, pointer, read = {
        "numpy": lambda: (np.array, lambda x: x.ctypes.data, np.from_dlpack),
        "torch": lambda: (lambda x: module.from_numpy(np.array(x)), lambda x: x.data_ptr(), module.from_dlpack),
        "jax": lambda: (module.numpy.array, lambda x: x.unsafe_buffer_pointer(), module.dlpack.from_dlpack),
    }[name]()
    with on_cpu:
        yield SimpleNamespace(name=name, array=array, pointer=pointer, from_warp=read)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_launch_reads_where_it_is_and_results_go_out_where_they_are(library, dtype):
    start, end = library.array(START.astype(dtype)), library.array(END.astype(dtype))
    result = ON_CPU.launch(start, end)
    expected = ccd.mesh_ccd(MESH, START.astype(dtype), END.astype(dtype), length_scale=1.0)
    assert ccd.mesh_ccd(MESH, start, end, length_scale=1.0).toi == expected.toi < np.inf
    np.testing.assert_array_equal(MESH.frames(start, end)[1], END.astype(dtype))
    of_warp = wp.array(START, dtype=wp.vec3d, device="cpu")
    assert MESH.frames(of_warp, of_warp)[0].ctypes.data == of_warp.ptr
    np.testing.assert_array_equal(result.vertex_toi.numpy(), expected.vertex_toi)
    for array in (result.toi, result.vertex_toi, result.body_toi, result.world_toi, result.flags):
        theirs = library.from_warp(array)
        assert library.pointer(theirs) == array.ptr
        np.testing.assert_array_equal(np.asarray(theirs), array.numpy())
    assert np.asarray(library.from_warp(result.contacts.normal)).shape == (len(result.contacts.kind), 3)
    if library.name != "jax":  # whose arrays do not change
        points = result.contacts.points.numpy()[: len(expected.contacts)].copy()
        start[:], end[:] = start + 1.0, end + 1.0
        is_copied = library.name == "numpy" or dtype is np.float32  # so few positions, or converted by the kernel
        moved = result.contacts.points.numpy()[: len(points)] - points
        np.testing.assert_allclose(moved, 0.0 if is_copied else 1.0, atol=1e-6)


def test_pairs_are_read_where_they_are(library, monkeypatch):
    seen, launch = [], Execution.launch

    def watched(execution, kernel, count, inputs, outputs, **options):
        seen.append([outputs[0].points_t0.ptr, outputs[0].points_t1.ptr])
        launch(execution, kernel, count, inputs, outputs, **options)

    monkeypatch.setattr(Execution, "launch", watched)
    # more than the few that are copied to where a launch has been recorded
    frames = [library.array(np.repeat(points, CAPACITY + 1, axis=0)) for points in PAIR]
    toi = ccd.vertex_face_ccd(*frames, device="cpu").toi
    assert seen == [[library.pointer(x) for x in frames]]
    assert isinstance(toi, np.ndarray) or library.pointer(library.from_warp(toi)) == toi.ptr
    assert np.asarray(toi)[0] == pytest.approx(0.5, abs=1e-12)


def test_line_search_writes_where_it_is(library):
    start, wished, is_numpy = library.array(START), library.array(END), library.name == "numpy"
    if library.name != "jax":
        ON_CPU.launch_line_search(start, wished, safety=0.9)
        assert np.asarray(wished)[:3, 0].max() == pytest.approx(0.1 + 0.9 * 0.9)
    if is_numpy:
        wished.flags.writeable = False
    if library.name != "torch":
        message = (
            "read-only; expected an array that can be written to" if is_numpy else "an array of JAX, which does not"
        )
        with pytest.raises(ValueError, match=f"vertices_t1 is {message}"):
            ON_CPU.launch_line_search(start, wished)


@pytest.mark.parametrize("name", ["torch", "jax", "cupy"])
def test_a_launch_on_cuda_waits_for_the_library_whose_arrays_it_reads(name, device):
    if device == "cpu":
        pytest.skip("the CPU has no streams; with a GPU: pytest --device cuda:0")
    module, pipeline = pytest.importorskip(name), ccd.CollisionPipeline(MESH, length_scale=1.0, device=device)
    places = {"torch": lambda: module.cuda.device_count(), "jax": lambda: module.default_backend() == "gpu"}
    if not places.get(name, lambda: True)():
        pytest.skip(f"this {name} has nothing on {device}")
    stream = nullcontext()
    if name == "torch":
        stream = module.cuda.stream(module.cuda.Stream())
        array, from_warp = lambda x: module.tensor(x).pin_memory().to(device, non_blocking=True), module.from_dlpack
    elif name == "cupy":
        stream, array, from_warp = module.cuda.Stream(non_blocking=True), module.asarray, module.from_dlpack
    else:
        module.config.update("jax_enable_x64", True)
        array, from_warp = (lambda x: module.numpy.array(x) + 0.0), module.dlpack.from_dlpack
    expected = ON_CPU.launch(START, END).vertex_toi.numpy()
    for _ in range(3):
        with stream:
            if name == "torch":
                module.cuda._sleep(40_000_000)  # cycles, some 20 ms
            found = from_warp(pipeline.launch(array(START), array(END)).vertex_toi)
            assert np.array_equal(found.tolist(), expected)


# ---- What cannot be read ---------------------------------------------------------------------------------------------


def foreign(name, device=(1, 0), error=None, **members):
    """An array of six positions that cannot be shared, on a device or one that it does not tell."""

    def refuse(*_, **__):
        raise error or BufferError("not now")

    def where(_):
        return refuse() if device is None else device

    of_array = {"shape": (6, 3), "__dlpack__": refuse, "__dlpack_device__": where}
    return type(name, (), of_array | dict.fromkeys(members, refuse))()


NO_NUMPY = "Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy() instead."
OF_GRAD = foreign("Grad", error=RuntimeError(NO_NUMPY), __array__=True)
SILENT, FAR = foreign("Silent", None, TypeError("deleted")), foreign("Far", (2, 99))
CANNOT, DELETED = "is a Grad that cannot be shared: .*detach.*; expected one that can", "cannot be shared: deleted"


of_step, of_launch = ON_CPU.mesh_ccd, ON_CPU.launch
REFUSED = [
    (of_step, (START, FAR), "vertices_t1 is a Far on a GPU; expected an array on the host"),
    (of_launch, (FAR, END), "vertices_t0 is a Far on cuda:99; expected it on one of cpu"),
    *((call, (SILENT, END), f"vertices_t0 is a Silent that {DELETED}") for call in (of_step, of_launch)),
    *((call, (START, OF_GRAD), f"vertices_t1 {CANNOT}") for call in (of_step, of_launch)),
    (lambda x: ccd.CollisionMesh.from_arrays([(x, [[0, 1, 2]])]), (OF_GRAD,), f"vertices of body 0 {CANNOT}"),
]


@pytest.mark.parametrize(("call", "arrays", "message"), REFUSED)
def test_an_array_that_cannot_be_shared_is_named(call, arrays, message):
    with pytest.raises(ValueError, match=message):
        call(*arrays)


def test_a_single_row_or_world_with_odd_strides_is_bound_in_place():
    """Such as the first of every eight: along an axis of one entry no stride matters."""
    wall = ccd.CollisionMesh.from_arrays([(BULLET[:1], []), (WALL, [[0, 1, 2]])], static=[1])
    moved, worlds = np.tile([2.0, 0, 0], (8, 1)), np.tile(END, (8, 1, 1))
    rows = [moved[::8], wp.array(moved, dtype=wp.float64, device="cpu")[::8]]
    rows += [wp.array(moved, dtype=wp.vec3d, device="cpu")[::8]]
    of_worlds = [worlds[::8], wp.array(worlds, dtype=wp.float64, device="cpu")[::8]]
    for mesh, start, ends in ((wall, START[[0]], rows), (MESH, START, of_worlds)):
        pipeline, begin = ccd.CollisionPipeline(mesh, device="cpu"), wp.array(start, dtype=wp.vec3d, device="cpu")
        whole = np.concatenate([ends[0].reshape(-1, 3), WALL])[: len(mesh.vertices)]
        expected = ccd.mesh_ccd(mesh, mesh.vertices, whole).toi
        pipeline.launch(mesh.vertices, mesh.vertices)
        for end in ends:
            assert pipeline.launch(begin, end).toi.numpy()[0] == expected < 1
    assert ccd.vertex_face_ccd(*(as_warp(np.tile(x, (8, 1, 1))[::8], "x") for x in PAIR)).toi.numpy()[0] < 1


def test_tensors_that_cannot_be_read_are_named():
    torch = pytest.importorskip("torch")
    good, strided = torch.zeros(6, 3, dtype=torch.float64), torch.zeros(6, 6, dtype=torch.float64)[:, :3]
    cannot, with_gradient = "vertices_t0 is a Tensor that cannot be shared", good.clone().requires_grad_()
    for call, arrays, message in (
        (of_launch, (good, strided), r"vertices_t1 has strides \(48, 8\); expected a contiguous array"),
        (of_launch, (with_gradient, good), f"{cannot}: .*gradient"),
        (of_step, (with_gradient, good), f"{cannot}: .*grad"),
        (of_step, (good.to(torch.bfloat16), good), f"{cannot}: .*BFloat16"),
        (ccd.vertex_face_ccd, (torch.zeros(1, 4, 3),) * 2, r"points_t0 has dtype float32 and shape \(1, 4, 3\); exp"),
    ):
        with pytest.raises(ValueError, match=message):
            call(*arrays)


# ---- While a stream is captured --------------------------------------------------------------------------------------

STREAM, CUDA, PINNED, MANAGED = 7, 2, 3, 13
LOST = "operation would create a dependency on work outside the capture"  # CUDA's error 905


class Array:
    """An array of another library on a GPU, whose memory is that of the host, so that Warp can read it here."""

    def __init__(self, values, device, kind=CUDA):
        self.values, self.device, self.kind, self.shape, self.asked = values, device, kind, values.shape, []

    def __dlpack_device__(self):
        return self.kind, 0

    def __dlpack__(self, *, stream=None):
        self.asked.append(stream)
        assert self.may_wait(stream), LOST
        return self.values.__dlpack__()

    def may_wait(self, stream):
        """As PyTorch and CuPy do: -1 says to do nothing, and no stream at all is the default stream."""
        return stream in (None, -1) if self.kind == PINNED else stream == -1 or not self.device.is_capturing


class ArrayOfJax(Array):
    """As JAX does: any number is the address of a stream, and without one the host waits."""

    __module__ = "jaxlib._jax"

    def may_wait(self, stream):
        return stream is None or (stream == STREAM and not self.device.is_capturing)


@pytest.fixture
def gpu(monkeypatch):
    """A CUDA device as far as arrays ask for it."""
    device = SimpleNamespace(is_capturing=False, stream=SimpleNamespace(cuda_stream=STREAM))
    monkeypatch.setattr(wp, "get_cuda_device_count", lambda: 1)
    monkeypatch.setattr(wp, "get_cuda_device", lambda index=None: device)
    return device


# The array, its memory, whether a stream is captured, and the stream that it is asked for.
ASKED = [(make, kind, True, asked) for make, asked in ((Array, -1), (ArrayOfJax, None)) for kind in (CUDA, MANAGED)]
ASKED += [(make, CUDA, False, STREAM) for make in (Array, ArrayOfJax)]
ASKED += [(Array, PINNED, is_capturing, None) for is_capturing in (False, True)]  # has no stream


@pytest.mark.parametrize(("make", "kind", "is_capturing", "asked"), ASKED)
def test_a_capture_does_not_wait_for_another_library_and_the_stream_of_warp_does(gpu, make, kind, is_capturing, asked):
    theirs = make(np.arange(12.0).reshape(4, 3), gpu, kind)
    gpu.is_capturing = is_capturing
    assert as_warp(theirs, "vertices_t0").ptr == theirs.values.ctypes.data and theirs.asked == [asked]


def test_a_launch_and_pairs_take_arrays_of_a_library_in_a_capture(gpu):
    gpu.is_capturing = True
    assert ON_CPU.launch(Array(START, gpu), Array(END, gpu)).toi.numpy()[0] == ON_CPU.mesh_ccd(START, END).toi
    pairs = ccd.vertex_face_ccd(*(Array(x, gpu) for x in PAIR), device="cpu")
    assert pairs.toi.numpy()[0] == ccd.vertex_face_ccd(*PAIR).toi[0]


# ---- Beside the stream of another library ----------------------------------------------------------------------------


class Stream:
    """A stream as far as it is asked: its device notes what it waits for."""

    def __init__(self, device, cuda_stream, *, is_blocking=False):
        self.device, self.cuda_stream, self.is_blocking = device, cuda_stream, is_blocking
        device.made.append(self)

    @property
    def is_capturing(self):
        return self.cuda_stream in self.device.captured

    def wait_stream(self, other):
        assert not self.is_capturing, LOST
        self.device.waits.add((self.cuda_stream, other.cuda_stream))


@pytest.fixture
def many_streams(monkeypatch):
    """A CUDA device with a stream of Warp: its objects for streams, and which of them waits for which."""

    class Device(SimpleNamespace):
        is_capturing = property(lambda self: self.captures or self.stream.is_capturing)

    device = Device(ordinal=0, is_cpu=False, made=[], waits=set(), captured=set(), captures={}, is_known=True)
    device.null_stream, device.stream = Stream(device, None, is_blocking=True), Stream(device, 1, is_blocking=True)

    @contextmanager
    def scoped(stream, sync_enter=True):
        assert not sync_enter
        before, device.stream = device.stream, stream
        yield
        device.stream = before

    def begin(stream, external):
        if not device.is_known:
            device.is_known = True
            raise RuntimeError("Warp error: unknown stream")
        device.captures[stream] = external

    monkeypatch.setattr(wp, "Stream", Stream)
    monkeypatch.setattr(wp, "ScopedStream", scoped)
    monkeypatch.setattr(wp, "capture_begin", begin)
    monkeypatch.setattr(wp, "capture_end", lambda stream: device.captures.pop(stream))
    monkeypatch.setattr(wp, "is_conditional_graph_supported", lambda: True)
    monkeypatch.setattr(streams, "_streams", {})
    return device


# Warp's current stream, that of the library, and the one on which launches are; those of Warp, 1 and None, block.
@pytest.mark.parametrize(("current", "theirs", "own"), [(1, 7, 1), (1, 0, 1), (1, 1, 1), (7, 7, None), (8, 7, None)])
def test_launches_are_on_a_stream_that_blocks_and_streams_wait_on_both_sides(many_streams, current, theirs, own):
    device, others = many_streams, {current, theirs or None} - {own}
    if current != 1:
        device.stream = Stream(device, current)
    for _ in range(2):
        with streams.in_order_of_library(device, theirs):
            assert device.stream.cuda_stream == own and device.waits == {(own, other) for other in others}
            device.waits.clear()
        assert device.stream.cuda_stream == current and device.waits == {(other, own) for other in others}
        device.waits.clear()
    assert len(device.made) - 2 == len({current, theirs} - {0, 1})  # one object a stream, which is kept


def test_a_call_of_the_host_is_in_order_with_a_current_stream_that_does_not_block(many_streams, monkeypatch):
    device, calls = many_streams, []
    device.stream = Stream(device, 7)
    monkeypatch.setattr(
        pipeline_calls, "in_current_order", lambda on: calls.append(on) or streams.in_current_order(device)
    )
    monkeypatch.setattr(ContactStep, "contacts", lambda *_, **__: calls.append(device.stream.cuda_stream))
    ON_CPU.mesh_ccd(START, END)
    assert calls == [ON_CPU._topology.device, None] and device.waits == {(None, 7), (7, None)}
    device.stream, device.waits = Stream(device, 1, is_blocking=True), set()
    ON_CPU.mesh_ccd(START, END)
    assert calls[-1] == 1 and not device.waits


@pytest.mark.parametrize("is_known", [True, False])
def test_launches_of_a_capture_by_a_library_are_on_its_stream_without_branches(many_streams, is_known):
    device = many_streams
    device.is_known, device.captured = is_known, {7}
    for _ in range(2):
        with streams.in_order_of_library(device, 7):
            assert device.stream.cuda_stream == 7 and device.captures == {device.stream: True}
            assert not leaves_out_launches(device)
        assert not device.captures and device.stream.cuda_stream == 1
    # where the user has dropped an object for the stream, Warp is told of it by another, which alone is used again
    assert [stream.cuda_stream for stream in device.made[2:]] == ([7] if is_known else [None, 7])
    assert not device.waits


def test_a_capture_by_warp_is_not_left_for_the_stream_of_a_library(many_streams):
    device = many_streams
    device.captured, device.captures[device.stream] = {1}, False
    with streams.in_order_of_library(device, 1):
        assert device.stream.cuda_stream == 1 and leaves_out_launches(device)
    for handle in (0, 7):
        with pytest.raises(RuntimeError, match="Warp captures a graph, of which the current stream of the library"):
            streams.in_order_of_library(device, handle)
    assert not device.waits
