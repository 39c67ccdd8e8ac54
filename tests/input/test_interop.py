"""Arrays of other libraries in and out, in the same memory: the pointers say that nothing was copied."""

import numpy as np
import pytest
import warp as wp

import ccd_warp as ccd

WALL = np.array([[1.0, -1, -1], [1, 1, -1], [1, 0, 1]])
BULLET = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
START = np.concatenate([BULLET, WALL])
END = np.concatenate([BULLET + [2.0, 0, 0], WALL])
MESH = ccd.CollisionMesh.from_arrays([(BULLET, [[0, 1, 2]]), (WALL, [[0, 1, 2]])])
PAIR = np.concatenate([BULLET[:1], WALL])[None], np.concatenate([BULLET[:1] + [2.0, 0, 0], WALL])[None]
EXPECTED = ccd.mesh_ccd(MESH, START, END, length_scale=1.0, device="cpu")


class Library:
    """NumPy, or a library beside it: how to make an array, to find where it is, and to read an array of Warp."""

    def __init__(self, name):
        self.name = name
        self.module = np if name == "numpy" else pytest.importorskip(name)
        if name == "jax":
            self.module.config.update("jax_enable_x64", True)

    def array(self, values):
        if self.name == "numpy":
            return np.array(values)
        return self.module.from_numpy(np.array(values)) if self.name == "torch" else self.module.numpy.array(values)

    def pointer(self, array):
        if self.name == "numpy":
            return array.ctypes.data
        return array.data_ptr() if self.name == "torch" else array.unsafe_buffer_pointer()

    def from_warp(self, array):
        return {
            "numpy": np.from_dlpack,
            "torch": lambda a: self.module.from_dlpack(a),
            "jax": lambda a: self.module.dlpack.from_dlpack(a),
        }[self.name](array)


@pytest.fixture(params=["numpy", "torch", "jax"])
def library(request):
    return Library(request.param)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_launch_reads_where_it_is(library, dtype):
    start, end = library.array(START.astype(dtype)), library.array(END.astype(dtype))
    pipeline = ccd.CollisionPipeline(MESH, length_scale=1.0, device="cpu")
    result = pipeline.launch(start, end)
    expected = ccd.mesh_ccd(MESH, START.astype(dtype), END.astype(dtype), length_scale=1.0, device="cpu")
    assert np.isfinite(expected.toi)
    np.testing.assert_array_equal(result.vertex_toi.numpy(), expected.vertex_toi)
    if library.name != "jax":  # whose arrays do not change
        points = result.contacts.points.numpy()[: len(expected.contacts)].copy()
        for array in (start, end):
            array[:] += 1.0
        is_copied = library.name == "numpy" or dtype is np.float32  # so few positions, or converted by the kernel
        moved = result.contacts.points.numpy()[: len(points)] - points
        np.testing.assert_allclose(moved, 0.0 if is_copied else 1.0, atol=1e-6)


def test_results_go_out_where_they_are(library):
    pipeline = ccd.CollisionPipeline(MESH, length_scale=1.0, device="cpu")
    result = pipeline.launch(START, END)
    for name in ("toi", "vertex_toi", "body_toi", "world_toi", "flags"):
        array = getattr(result, name)
        theirs = library.from_warp(array)
        assert library.pointer(theirs) == array.ptr
        np.testing.assert_array_equal(np.asarray(theirs), array.numpy())
    assert np.asarray(library.from_warp(result.contacts.normal)).shape == (len(result.contacts.kind), 3)


def test_pairs_are_read_where_they_are(library, monkeypatch):
    seen = []
    launch = ccd._pair_ccd.Execution.launch

    def watched(execution, kernel, count, inputs, outputs, **options):
        seen.append([outputs[0].points_t0, outputs[0].points_t1])
        launch(execution, kernel, count, inputs, outputs, **options)

    monkeypatch.setattr(ccd._pair_ccd.Execution, "launch", watched)
    # more than the few of NumPy that are copied to where a launch has been recorded
    start, end = (library.array(np.repeat(points, 600, axis=0)) for points in PAIR)
    result = ccd.vertex_face_ccd(start, end, device="cpu")
    assert [x.ptr for x in seen[0]] == [library.pointer(start), library.pointer(end)]
    if library.name == "numpy":
        assert isinstance(result.toi, np.ndarray)
    else:
        theirs = library.from_warp(result.toi)
        assert library.pointer(theirs) == result.toi.ptr
    assert np.asarray(result.toi if library.name == "numpy" else theirs)[0] == pytest.approx(0.5, abs=1e-12)


def test_calls_on_the_host_take_their_arrays(library):
    result = ccd.mesh_ccd(MESH, library.array(START), library.array(END), length_scale=1.0, device="cpu")
    assert result.toi == EXPECTED.toi
    frames = MESH.frames(library.array(START), library.array(END))
    np.testing.assert_array_equal(frames[1], END)


def test_calls_on_the_host_take_warp_arrays():
    start, end = (wp.array(x, dtype=wp.vec3d, device="cpu") for x in (START, END))
    assert ccd.mesh_ccd(MESH, start, end, length_scale=1.0, device="cpu").toi == EXPECTED.toi
    assert MESH.frames(start, end)[0].ctypes.data == start.ptr


class OnAnotherDevice:
    """An array that says it is on a GPU."""

    shape = (6, 3)

    def __dlpack_device__(self):
        return (2, 99)

    def __dlpack__(self, **_):
        raise BufferError("no such device here")


def test_array_on_a_gpu_is_named():
    with pytest.raises(ValueError, match="vertices_t1 is a OnAnotherDevice on a GPU; expected an array on the host"):
        ccd.mesh_ccd(MESH, START, OnAnotherDevice())
    with pytest.raises(ValueError, match="vertices_t0 is a OnAnotherDevice on cuda:99; expected it on one of cpu"):
        ccd.CollisionPipeline(MESH, device="cpu").launch(OnAnotherDevice(), END)


class WithoutADevice:
    """An array that does not say where it is."""

    shape = (6, 3)

    def __dlpack__(self, **_):
        raise BufferError("not now")

    def __dlpack_device__(self):
        raise TypeError("deleted")


def test_array_that_does_not_say_where_it_is_is_named():
    with pytest.raises(ValueError, match="vertices_t0 is a WithoutADevice that cannot be shared: deleted"):
        ccd.CollisionPipeline(MESH, device="cpu").launch(WithoutADevice(), END)
    with pytest.raises(ValueError, match="vertices_t0 is a WithoutADevice that cannot be shared: deleted"):
        ccd.mesh_ccd(MESH, WithoutADevice(), END)


class WithAGradient:
    """What NumPy cannot read as it is: a tensor of torch that requires a gradient, or one of bfloat16."""

    shape = (6, 3)

    def __dlpack__(self, **_):
        raise BufferError("Can't export tensors that require gradient, use tensor.detach()")

    def __array__(self, *_, **__):
        raise RuntimeError("Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy() instead.")

    def __dlpack_device__(self):
        return (1, 0)


def test_array_that_numpy_cannot_read_is_named_by_every_call():
    sentence = "is a WithAGradient that cannot be shared: .*detach.*; expected one that can"
    with pytest.raises(ValueError, match=f"vertices_t1 {sentence}"):
        ccd.CollisionPipeline(MESH, device="cpu").launch(START, WithAGradient())
    with pytest.raises(ValueError, match=f"vertices_t1 {sentence}"):
        ccd.mesh_ccd(MESH, START, WithAGradient())
    with pytest.raises(ValueError, match=f"vertices of body 0 {sentence}|vertices {sentence}"):
        ccd.CollisionMesh.from_arrays([(WithAGradient(), [[0, 1, 2]])])


@pytest.mark.parametrize("name", ["torch", "jax"])
def test_bad_arrays_of_other_libraries_are_named(name):
    library = Library(name)
    pipeline = ccd.CollisionPipeline(MESH, device="cpu")
    good = library.array(START)
    with pytest.raises(ValueError, match="vertices_t1 has dtype int64 and shape"):
        pipeline.launch(good, library.array(START.astype(np.int64)))
    with pytest.raises(ValueError, match="vertices_t0 has 3 rows; expected 6, one a vertex"):
        pipeline.launch(library.array(BULLET), good)
    with pytest.raises(ValueError, match=r"points_t0 has dtype float32 and shape \(1, 4, 3\); expected vec3d and"):
        ccd.vertex_face_ccd(*(library.array(points.astype(np.float32)) for points in PAIR))
    with pytest.raises(ValueError, match="points_t1 is a ndarray; expected a"):
        ccd.vertex_face_ccd(library.array(PAIR[0]), PAIR[1])


def test_tensor_that_is_not_contiguous_or_requires_a_gradient_is_named():
    torch = pytest.importorskip("torch")
    pipeline = ccd.CollisionPipeline(MESH, device="cpu")
    good = torch.from_numpy(START.copy())
    with pytest.raises(ValueError, match=r"vertices_t1 has strides \(48, 8\); expected a contiguous array"):
        pipeline.launch(good, torch.zeros(6, 6, dtype=torch.float64)[:, :3])
    with pytest.raises(ValueError, match=r"vertices_t0 is a Tensor that cannot be shared: .*gradient"):
        pipeline.launch(good.clone().requires_grad_(), good)
    with pytest.raises(ValueError, match=r"vertices_t0 is a Tensor that cannot be shared: .*grad"):
        ccd.mesh_ccd(MESH, good.clone().requires_grad_(), good)
    with pytest.raises(ValueError, match=r"vertices_t0 is a Tensor that cannot be shared: .*BFloat16"):
        ccd.mesh_ccd(MESH, good.to(torch.bfloat16), good)


def test_line_search_writes_where_it_is(library):
    pipeline = ccd.CollisionPipeline(MESH, length_scale=1.0, device="cpu")
    start, wished = library.array(START), library.array(END)
    if library.name == "jax":
        with pytest.raises(ValueError, match="vertices_t1 is an array of JAX, which does not change"):
            pipeline.launch_line_search(start, wished)
        return
    pipeline.launch_line_search(start, wished, safety=0.9)
    assert np.asarray(wished)[:3, 0].max() == pytest.approx(0.1 + 0.9 * 0.9)


def test_line_search_into_a_read_only_array_is_named():
    wished = END.copy()
    wished.flags.writeable = False
    with pytest.raises(ValueError, match="vertices_t1 is read-only; expected an array that can be written to"):
        ccd.CollisionPipeline(MESH, device="cpu").launch_line_search(START, wished)


def test_a_loop_in_torch_on_one_graph():
    torch = pytest.importorskip("torch")
    start, end = torch.from_numpy(START.copy()), torch.from_numpy(END.copy())
    pipeline = ccd.CollisionPipeline(MESH, length_scale=1.0, device="cpu")
    result = pipeline.launch(start, end)
    with wp.ScopedCapture(device="cpu") as capture:
        pipeline.launch(start, end)
    toi = torch.from_dlpack(result.toi)
    for distance in (2.0, 4.0, 0.5):
        end[:3] = start[:3] + torch.tensor([distance, 0.0, 0.0])
        wp.capture_launch(capture.graph)
        expected = 1.0 / distance if distance >= 1 else np.inf
        assert toi.item() == pytest.approx(ccd.mesh_ccd(MESH, start, end, length_scale=1.0, device="cpu").toi, abs=0)
        assert toi.item() <= expected
