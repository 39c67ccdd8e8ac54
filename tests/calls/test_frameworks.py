"""PyTorch and JAX: their functions are launches, with the gradients of these, and say what they do not take."""

import gc
import importlib
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from laws.calls import EVERY_PER
from scenes import FACE, TETRAHEDRON, TRIANGLE

import ccd_warp as ccd

FALL = np.array([[0.0, 0, 0]] * 3 + [[0.0, 0, 1]] * 3)


@pytest.fixture(scope="module")
def torch(device):
    module = pytest.importorskip("torch")
    if device != "cpu" and not module.cuda.is_available():
        pytest.skip(f"this PyTorch has nothing on {device}")
    return module


@pytest.fixture(scope="module")
def jax(device):
    module = pytest.importorskip("jax")
    module.config.update("jax_enable_x64", True)
    try:
        place = module.devices("cpu" if device == "cpu" else "gpu")[0]
    except RuntimeError:
        pytest.skip(f"this JAX has nothing on {device}")
    with module.default_device(place):
        yield module


@pytest.fixture(params=["torch", "jax"])
def library(request, device):
    """A library's functions, its arrays of NumPy's, and a check of gradients against differences of tois."""
    module = request.getfixturevalue(request.param)
    ours = importlib.import_module(f"ccd_warp.{request.param}")
    if request.param == "torch":

        def check(function, *ends):  # differences of tois in float64 have some eight digits
            assert module.autograd.gradcheck(function, ends, eps=1e-7, atol=1e-6, rtol=1e-5)

        def make(x):
            return module.tensor(np.array(x), device=device, requires_grad=x.dtype.kind == "f")

        return ours, make, lambda x: x.detach().cpu().numpy(), module.where, check
    check_grads = importlib.import_module("jax.test_util").check_grads

    def check(function, *ends):
        check_grads(module.jit(function), ends, order=1, modes=["rev"], eps=1e-6, atol=1e-6, rtol=1e-5)

    return ours, module.numpy.array, np.array, module.numpy.where, check


def thrown():
    """Tetrahedra that are thrown into each other and deform: a pipeline, and both ends."""
    rng = np.random.default_rng(1)
    corners, faces = TETRAHEDRON
    places = 1.5 * rng.standard_normal((5, 3))
    bodies = [(corners + 0.2 * rng.standard_normal((4, 3)) + place, faces) for place in places]
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=False)
    throws = -0.8 * places + 0.3 * rng.standard_normal((5, 3))
    end = mesh.vertices + throws[mesh.vertex_body] + 0.1 * rng.standard_normal(mesh.vertices.shape)
    return ccd.CollisionPipeline(mesh, tolerance=1e-12, minimum_distance=0.02), mesh.vertices.copy(), end


def worlds():
    """A pipeline of three worlds in each of which a triangle is above another, and its positions by world."""
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (TRIANGLE + [0, 0, 1.0], FACE)]).replicate(3)
    return ccd.CollisionPipeline(mesh), mesh.vertices.reshape(3, 6, 3)


def test_results_are_those_of_launches_and_pass_the_check_of_gradients(library):
    ours, make, numbers, where, check = library
    pipeline, *given = thrown()
    ends, on_device = [make(x) for x in given], [wp.array(x) for x in given]
    result = pipeline.launch(*on_device).to_host()
    tois = {"scene": result.toi, "world": [result.toi], "body": result.body_toi, "vertex": result.vertex_toi}
    for per in EVERY_PER:
        found = numbers(ours.toi(pipeline, *ends, per=per))
        np.testing.assert_array_equal(found, tois[per])
        np.testing.assert_array_equal(numbers(ours.toi_is_regular(pipeline, *ends, per=per)), np.isfinite(found))
        is_finite = make(np.isfinite(found)) if found.shape else make(np.array(True))
        check(lambda *x, f=is_finite, p=per: where(f, ours.toi(pipeline, *x, per=p), 0.0), *ends)
        check(lambda *x, p=per: ours.line_search(pipeline, *x, per=p), *ends)
    assert numbers(ours.collision_free_step(pipeline, *ends)) == result.toi
    assert numbers(ours.collision_free_step(pipeline, ends[0], ends[0])) == 1.0
    shortened = numbers(ours.line_search(pipeline, *ends, per="body", safety=0.8))
    assert numbers(ours.line_search_is_regular(pipeline, *ends, per="body", safety=0.8)).all()
    assert all(np.array_equal(numbers(x), y) for x, y in zip(ends, given, strict=True))
    pipeline.launch_line_search(*on_device, per="body", safety=0.8)
    np.testing.assert_array_equal(shortened, on_device[1].numpy())
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (TRIANGLE + [0, 0, 0.05], FACE)])
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=0.1)  # within it at the start
    ends = make(mesh.vertices), make(mesh.vertices - FALL)
    assert not numbers(ours.line_search_is_regular(pipeline, *ends)).any()
    assert not numbers(ours.toi_is_regular(pipeline, *ends, per="body")).any()


def test_worlds_in_one_array(library):
    ours, make, numbers, *_ = library
    pipeline, start = worlds()
    end = start - FALL * np.array([2.0, 4.0, 0.5])[:, None, None]
    for dtype, tolerance in (("float64", 1e-9), ("float32", 1e-6)):
        found = ours.toi(pipeline, *(make(x.astype(dtype)) for x in (start, end)), per="world")
        np.testing.assert_allclose(numbers(found), [0.5, 0.25, np.inf], rtol=tolerance)


def test_bad_use_is_told(library):
    ours, make, numbers, *_ = library
    pipeline, *given = thrown()
    start, end = map(make, given)
    for call, message in (
        (lambda: ours.toi(pipeline, *(make(x.astype(int)) for x in given)), "vertices_t0 has dtype int"),
        (lambda: ours.toi(pipeline, start, end, per="edge"), "per is 'edge'"),
        (lambda: ours.toi(pipeline.mesh, start, end), "pipeline is"),
        (lambda: ours.line_search(pipeline, start[1:], end[1:]), "vertices_t0 has "),
        (lambda: numbers(ours.line_search(pipeline, start, end * np.nan)), "not finite"),
    ):
        with pytest.raises((ValueError, RuntimeError), match=message):
            call()


def test_pairs_and_contacts_without_a_place_are_an_error(library):
    """With a gradient and without, of tois and of shortened positions; never a gradient of 0 without a word."""
    ours, make, numbers, *_ = library
    pipeline, *given = thrown()
    ends = [make(x) for x in given]
    for capacities, flag in (({"max_pairs": 1}, "PAIRS"), ({"max_pairs": 1000, "max_contacts": 1}, "CONTACTS")):
        pipeline.reserve(**capacities)
        for call in (
            lambda: ours.toi_is_regular(pipeline, *ends),
            lambda: ours.line_search_is_regular(pipeline, *ends),
        ):
            with pytest.raises(RuntimeError, match=rf"{flag}_OVERFLOW[\s\S]*reserve"):
                numbers(call())
    pipeline.reserve(max_pairs=1)
    for call in (ours.toi, ours.collision_free_step, ours.line_search):
        with pytest.raises(RuntimeError, match=r"PAIRS_OVERFLOW[\s\S]*reserve"):
            numbers(call(pipeline, *ends))


# ---- Poses of bodies that turn ---------------------------------------------------------------------------------------

PIVOTS = np.array([[0.1, 0.2, 0.3], [0.0, 0.0, 0.1]])


def turning():
    """A pipeline of two tetrahedra; by world their poses at both ends, of quaternions of any length, and twists."""
    rng = np.random.default_rng(0)
    body = TETRAHEDRON[0] - 0.25, TETRAHEDRON[1]
    mesh = ccd.CollisionMesh.from_arrays([body, body], rigid=[0, 1])
    start, end, twist = (rng.normal(size=(5, 2, count)) for count in (7, 7, 6))
    start[..., :3], end[..., :3] = [[0.0, 0, 0], [3, 0, 0]], [[0.0, 0, 0.1], [0.3, 0.2, 0.1]]
    twist[..., :3] = [[0.1, 0, 0], [-3.0, 0.2, 0.1]]
    start[4, 1, 0] = end[4, 1, 0] = 20.0  # far away, so that nothing touches
    return ccd.CollisionPipeline(mesh, tolerance=1e-13, minimum_distance=0.05), start, end, twist


def test_tois_by_poses_are_those_of_a_motion_and_pass_the_check_of_gradients(library):
    ours, make, numbers, where, check = library
    pipeline, start, end, twist = turning()
    x = pipeline.mesh.vertices
    for pivot in (None, PIVOTS):
        for step in ({"poses_t1": end}, {"twist": twist}):
            ((name, last),) = step.items()
            motion = ccd.RigidMotion(start, pivot=pivot, **step)
            expected = pipeline.mesh_ccd(x, x, motion=motion).world_toi
            is_finite = make(np.isfinite(expected))
            assert np.isfinite(expected).sum() == 4

            def toi(a, b, worlds=is_finite, name=name, pivot=pivot):
                return where(worlds, ours.rigid_toi(pipeline, a, **{name: b}, pivot=pivot), 0.0)

            found = numbers(ours.rigid_toi(pipeline, make(start), **{name: make(last)}, pivot=pivot))
            np.testing.assert_array_equal(found, expected)
            check(toi, make(start), make(last))
            one = ours.rigid_toi(pipeline, make(start[2]), **{name: make(last[2])}, pivot=pivot)
            assert one.shape == () and numbers(one) == expected[2]
            check(lambda a, b, toi=toi: toi(a, b, make(np.array(True))), make(start[2]), make(last[2]))
    by_axes = numbers(ours.rigid_toi(pipeline, make(start[:4].reshape(2, 2, 2, 7)), make(end[:4].reshape(2, 2, 2, 7))))
    assert np.array_equal(by_axes.ravel(), numbers(ours.rigid_toi(pipeline, make(start[:4]), make(end[:4]))))
    copies = ccd.CollisionPipeline(pipeline.mesh.replicate(5), tolerance=1e-13, minimum_distance=0.05)
    of_copies = numbers(ours.rigid_toi(copies, make(start), twist=make(twist)))
    np.testing.assert_array_equal(of_copies, numbers(ours.rigid_toi(pipeline, make(start), twist=make(twist))))
    of_scene = ours.rigid_toi(copies, *(make(x.reshape(-1, 7)) for x in (start, end)))
    assert of_scene.shape == () and numbers(of_scene) == by_axes.min()


def test_bad_poses_are_told(library):
    ours, make, numbers, *_ = library
    pipeline, start, end, twist = turning()
    wrong, three = start.copy(), ccd.CollisionPipeline(pipeline.mesh.replicate(4))
    wrong[1, 1, 3:] = 0.0
    for call, message in (
        (lambda: ours.rigid_toi(pipeline, make(start)), "neither of poses_t1 and twist"),
        (lambda: ours.rigid_toi(pipeline, make(start), make(end), twist=make(twist)), "both of poses_t1 and twist"),
        (lambda: ours.rigid_toi(pipeline, make(start.astype(int)), make(end)), "poses_t0 has dtype .*int"),
        (lambda: ours.rigid_toi(pipeline, make(start), make(end[1:])), r"poses_t1 has .* expected .*\(5, 2, 7\)"),
        (lambda: ours.rigid_toi(pipeline, make(start), twist=make(end)), r"twist has .* expected .*\(5, 2, 6\)"),
        (lambda: ours.rigid_toi(pipeline, make(start[0, 0]), make(end[0, 0])), "poses_t0 has shape|poses_t0 has dtype"),
        (lambda: ours.rigid_toi(pipeline.mesh, make(start), make(end)), "pipeline is"),
        (lambda: numbers(ours.rigid_toi(pipeline, make(wrong), make(end))), "length 0 for body 1 of world 1"),
        (lambda: numbers(ours.rigid_toi(pipeline, make(start[:, :1]), make(end[:, :1]))), "expected one a body"),
        (
            lambda: numbers(ours.rigid_toi(three, make(start[:2, [0, 1, 0, 1]]), make(end[:2, [0, 1, 0, 1]]))),
            "2 worlds",
        ),
    ):
        with pytest.raises((ValueError, RuntimeError), match=message):
            call()


def test_torch_gives_tensors_of_poses_their_own_gradients(torch):
    ours, (pipeline, start, end, twist) = importlib.import_module("ccd_warp.torch"), turning()
    start, end, twist = map(torch.tensor, (start, end, twist))
    for dtype in (torch.float64, torch.float32):
        first, last = start.to(dtype, copy=True).requires_grad_(), end.to(dtype)
        toi = ours.rigid_toi(pipeline, first, last)
        ((toi - 0.5) ** 2).sum().backward()  # whose gradient by the toi of the last world is inf
        assert first.grad.dtype == dtype and last.grad is None and toi.dtype == torch.float64
        assert not first.grad[4].any() and first.grad[:4].any(dim=(1, 2)).all() and first.grad.isfinite().all()
        along = (first.grad[..., 3:] * first[..., 3:]).sum(dim=-1)
        assert (along.abs() <= 8.0 * torch.finfo(dtype).eps * first.grad[..., 3:].norm(dim=-1)).all()
    assert not ours.rigid_toi(pipeline, start, end).requires_grad
    touching = start.clone()
    touching[:, 1, :3] = 0.1
    touching.requires_grad_()
    toi = ours.rigid_toi(pipeline, touching, twist=twist)
    toi.sum().backward()
    assert not toi.any() and not touching.grad.any()
    for call, message in (
        (lambda: ours.rigid_toi(pipeline, start.numpy(), end), "poses_t0 is a ndarray; expected a tensor"),
        (lambda: ours.rigid_toi(pipeline, start, end, pivot=torch.zeros(3, requires_grad=True)), "pivot requires"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    on_pivot = ours.rigid_toi(pipeline, start, end, pivot=torch.tensor(PIVOTS))
    assert torch.equal(on_pivot, ours.rigid_toi(pipeline, start, end, pivot=PIVOTS))


def test_jax_maps_poses_in_one_call(jax, monkeypatch):
    ours, (pipeline, start, end, twist) = importlib.import_module("ccd_warp.jax"), turning()
    rigid_tois, calls = importlib.import_module("ccd_warp._calls.rigid_tois"), []
    of_host = rigid_tois._first_contacts
    monkeypatch.setattr(rigid_tois, "_first_contacts", lambda *given: calls.append(given) or of_host(*given))

    def of_world(a, b):
        return jax.numpy.minimum(ours.rigid_toi(pipeline, a, twist=b), 1.0)

    of_all = jax.grad(lambda a, b: of_world(a, b).sum(), (0, 1))(start, twist)
    for function in (jax.vmap(jax.grad(of_world, (0, 1))), jax.jit(jax.vmap(jax.grad(of_world, (0, 1))))):
        calls.clear()
        for x, y in zip(function(start, twist), of_all, strict=True):
            np.testing.assert_array_equal(x, y)
        assert len(calls) == 1
    of_one = jax.vmap(jax.grad(of_world), (None, 0))(start[0], twist)  # of which one is mapped
    for world in range(5):
        np.testing.assert_allclose(of_one[world], jax.grad(of_world)(start[0], twist[world]), rtol=1e-9, atol=1e-12)
    single = jax.grad(lambda a: of_world(a, twist.astype("float32")).sum())(start.astype("float32"))
    np.testing.assert_allclose(single, of_all[0], rtol=1e-4, atol=1e-4)
    assert single.dtype == "float32" and not single[4].any()
    with pytest.raises(jax.errors.TracerArrayConversionError):
        jax.grad(lambda c: ours.rigid_toi(pipeline, start[0], end[0], pivot=c))(PIVOTS)


@pytest.mark.parametrize("name", ["torch", "jax"])
def test_without_a_library_the_extra_is_named(name, monkeypatch):
    monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.delitem(sys.modules, f"ccd_warp.{name}", raising=False)
    with pytest.raises(ImportError, match=r"pip install 'ccd-warp\[interop\]'"):
        importlib.import_module(f"ccd_warp.{name}")


def test_torch_shares_memory_keeps_what_it_needs_and_compiles(torch, device):
    ours, (pipeline, *given) = importlib.import_module("ccd_warp.torch"), thrown()
    start, end = (torch.tensor(x, device=device, requires_grad=True) for x in given)
    found = ours.toi(pipeline, start, end, per="vertex")
    function = found.grad_fn
    assert [x.ptr for x in function.arrays] == [start.data_ptr(), end.data_ptr()]
    assert (function.toi.ptr == found.data_ptr()) == (device == "cpu")
    values, weights = found.detach().clone(), torch.isfinite(found).double()
    first, second = (torch.autograd.grad(found, start, weights * factor, retain_graph=True)[0] for factor in (1.0, 2.0))
    kept = first.clone()
    del function
    ours.toi(pipeline, end, start)  # a later launch
    gc.collect()
    assert torch.equal(found, values) and torch.equal(first, kept)
    torch.testing.assert_close(second, 2.0 * first)

    def squared(x, y):
        return (ours.collision_free_step(pipeline, x * 1.0, y) * 3.0) ** 2

    functions = squared, torch.compile(squared, backend="eager")
    both = [torch.autograd.grad(f(start, end), (start, end)) for f in functions]
    assert all(torch.equal(x, y) and x.any() for x, y in zip(*both, strict=True))
    for call, message in (
        (lambda: ours.toi(pipeline, start, given[1]), "vertices_t1 is a ndarray; expected a tensor"),
        (lambda: ours.line_search_is_regular(pipeline, start, given[1]), "vertices_t1 is a ndarray"),
        (lambda: ours.toi(pipeline, start.detach().T.contiguous().T, end), "vertices_t0 has strides"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    pipeline.reserve(max_pairs=1000, max_contacts=1)
    with pytest.raises(RuntimeError, match=r"CONTACTS_OVERFLOW.*reserve"):
        ours.toi(pipeline, start, end)
    assert np.isfinite(ours.toi(pipeline, start.detach(), end.detach()).item())  # which needs no list


def test_jax_maps_worlds(jax, monkeypatch, capfd):
    ours, (pipeline, start) = importlib.import_module("ccd_warp.jax"), worlds()
    start, speed, expected = jax.numpy.array(start), jax.numpy.array([2.0, 4.0, 0.5]), [0.5, 0.25, np.inf]

    def of_world(speed, start, per="scene"):
        return ours.toi(pipeline, start, start - FALL * speed, per=per)

    def height(speed, start):
        return ours.line_search(pipeline, start, start - FALL * speed, per="world")[3, 2]

    of_bodies = jax.vmap(lambda *x: of_world(*x, per="body"))(speed, start)
    for found, values in (
        (jax.vmap(of_world)(speed, start), expected),
        (of_bodies, np.transpose([expected, expected])),
        (jax.jit(jax.vmap(jax.grad(of_world)))(speed, start), [-0.25, -0.0625, 0.0]),
        (jax.vmap(height)(speed, start), [0.1, 0.1, 0.5]),  # 1 - 0.9 of the gap
        (jax.vmap(jax.grad(height))(speed, start), [0.0, 0.0, -1.0]),
        (jax.vmap(lambda v, x: ours.toi_is_regular(pipeline, x, x - FALL * v))(speed, start), [1, 1, 0]),
    ):
        np.testing.assert_allclose(found, values, rtol=1e-6, atol=1e-9)
    with pytest.raises(jax.errors.JaxRuntimeError, match="expected 18, one a vertex"):
        jax.vmap(lambda x: ours.toi(pipeline, x, x))(start[:2]).block_until_ready()
    assert not wp.get_module(ours.calls.__name__).execs, "Warp would say that it loads a module without kernels"
    capfd.readouterr()  # Warp prints what its bridge passes on
    monkeypatch.setattr(jax.numpy, "zeros", lambda count: SimpleNamespace(dtype="float32"))
    with pytest.raises(ValueError, match="jax_enable_x64"):
        ours.toi(pipeline, start, start)


# ---- Streams and graphs of CUDA --------------------------------------------------------------------------------------

_BUSY = 40_000_000  # cycles, some 20 ms, in which what does not wait reads what is not there yet


@pytest.fixture
def on_gpu(torch, device):
    """Our functions of PyTorch, a pipeline on the GPU, and both ends on the host."""
    if device == "cpu":
        pytest.skip("the CPU has no streams; with a GPU: pytest --device cuda:0")
    return importlib.import_module("ccd_warp.torch"), *thrown()


def every_answer(torch, ours, pipeline, start, end):
    """Tois, a line search, and gradients of both by tensors that are dropped at once."""
    x, y = start.detach().clone().requires_grad_(), end.detach().clone().requires_grad_()
    tois, shortened = ours.toi(pipeline, x, y, per="vertex"), ours.line_search(pipeline, x, y, per="body")
    total = torch.where(torch.isfinite(tois), tois, 0.0).sum() + (shortened * shortened).sum()
    return [ours.toi(pipeline, start, end), tois.detach(), shortened.detach(), *torch.autograd.grad(total, (x, y))]


def on_cpu(torch, ours, given):
    """The same answers on the CPU, which are those of CUDA in every bit."""
    with wp.ScopedDevice("cpu"):
        pipeline, *_ = thrown()
    return every_answer(torch, ours, pipeline, *map(torch.from_numpy, given))


def check_equal(torch, found, expected):
    for x, y in zip(found, expected, strict=True):
        torch.testing.assert_close(x.cpu(), y, rtol=0.0, atol=0.0)


@pytest.mark.parametrize("kind", ["default", "side", "of PyTorch and of Warp"])
def test_torch_answers_are_in_the_order_of_its_stream(on_gpu, torch, device, kind):
    ours, pipeline, *given = on_gpu
    expected = on_cpu(torch, ours, given)
    for _ in range(3):
        stream = torch.cuda.default_stream() if kind == "default" else torch.cuda.Stream()
        shared = wp.stream_from_torch(stream) if "Warp" in kind else None
        with torch.cuda.stream(stream), wp.ScopedStream(shared):
            torch.cuda._sleep(_BUSY)
            start, end = (torch.tensor(x).pin_memory().to(device, non_blocking=True) for x in given)
            found = every_answer(torch, ours, pipeline, start, end)
            del start, end
            for _ in range(4):  # which takes what was freed, of either library
                torch.full(given[0].shape, 9e9, dtype=torch.float64, device=device)
                wp.full(given[0].size, 9e9, dtype=wp.float64, device=device)
            check_equal(torch, found, expected)


@pytest.mark.parametrize("broad_phase", ["tree", "hash"])
def test_torch_graph_is_replayed_on_other_positions(on_gpu, torch, device, broad_phase, capfd):
    ours, pipeline, *given = on_gpu
    pipeline = ccd.CollisionPipeline(pipeline.mesh, tolerance=1e-12, minimum_distance=0.02, broad_phase=broad_phase)
    start, end = (torch.tensor(x, device=device) for x in given)
    every_answer(torch, ours, pipeline, start, end)  # a first call, outside of the capture
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        found = every_answer(torch, ours, pipeline, start, end)
    for scale in (1.0, 0.0, 0.7):
        end.copy_(start + scale * torch.tensor(given[1] - given[0], device=device))
        graph.replay()
        check_equal(torch, found, on_cpu(torch, ours, [given[0], end.cpu().numpy()]))
        assert torch.isfinite(found[0]) or not scale
    check_equal(torch, every_answer(torch, ours, pipeline, start, end), [x.cpu() for x in found])
    assert "Warp" not in capfd.readouterr().err  # where it prints what CUDA refuses


def test_torch_stream_of_the_user_stays_one_of_warp(on_gpu, torch, device):
    ours, pipeline, *given = on_gpu
    expected, side = on_cpu(torch, ours, given), torch.cuda.Stream()
    start, end = (torch.tensor(x, device=device) for x in given)
    mine = wp.stream_from_torch(side)
    for _ in range(2):
        with torch.cuda.stream(side):
            check_equal(torch, every_answer(torch, ours, pipeline, start, end), expected)
        with torch.cuda.graph(graph := torch.cuda.CUDAGraph(), stream=side):
            tois = ours.toi(pipeline, start, end, per="vertex")
        graph.replay()
        check_equal(torch, [tois], expected[1:2])
        gc.collect()
        mine = mine or wp.stream_from_torch(side)
        with wp.ScopedStream(mine):
            with wp.ScopedCapture(device) as capture:  # of a stream that Warp must know
                result = pipeline.launch(start, end)
                with pytest.raises(RuntimeError, match="Warp captures a graph, of which the current stream"):
                    ours.toi(pipeline, start, end)
            wp.capture_launch(capture.graph)
            np.testing.assert_array_equal(result.vertex_toi.numpy(), expected[1].numpy())
        mine = None  # whose destructor tells Warp that the stream is gone
        gc.collect()


def test_jax_answers_come_after_what_warp_has_queued(jax, device):
    if device == "cpu":
        pytest.skip("the CPU has no streams; with a GPU: pytest --device cuda:0")
    ours, (pipeline, *given) = importlib.import_module("ccd_warp.jax"), thrown()
    with wp.ScopedDevice("cpu"):
        expected = thrown()[0].launch(*map(wp.array, given)).to_host()
    ends, heavy = [jax.numpy.array(x) for x in given], wp.empty(1 << 26, dtype=wp.float64, device=device)
    for _ in range(3):
        for _ in range(80):  # some 15 ms
            heavy.fill_(1.0)
        pipeline.reserve(vertices=given[0])
        np.testing.assert_array_equal(np.array(ours.toi(pipeline, *ends, per="vertex")), expected.vertex_toi)
