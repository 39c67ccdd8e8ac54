"""Functions of PyTorch: their gradients against differences, memory that is shared, and bad use."""

import gc
import importlib
import sys

import numpy as np
import pytest
from scenes import FACE, TRIANGLE
from toi_scenes import random_scene

import ccd_warp as ccd


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch")


@pytest.fixture(scope="module")
def ccd_torch(torch):
    return importlib.import_module("ccd_warp.torch")


@pytest.fixture
def thrown(torch):
    """Tetrahedra that are thrown into each other: a pipeline, and both ends, which require gradients."""
    mesh, start, end, options = random_scene(1)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", tolerance=1e-12, **options)
    return pipeline, *(torch.from_numpy(x).requires_grad_() for x in (start, end))


def gradcheck(torch, function, *tensors):
    # differences of tois in float64 have some eight digits
    assert torch.autograd.gradcheck(function, tensors, eps=1e-7, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("per", ["scene", "world", "body", "vertex"])
def test_tois_pass_the_check_of_gradients(torch, ccd_torch, thrown, per):
    pipeline, *ends = thrown
    is_finite = torch.isfinite(ccd_torch.toi(*thrown, per=per))
    assert is_finite.any()
    gradcheck(torch, lambda *x: torch.where(is_finite, ccd_torch.toi(pipeline, *x, per=per), 0.0), *ends)


@pytest.mark.parametrize("per", ["scene", "body", "vertex"])
def test_line_searches_pass_the_check_of_gradients(torch, ccd_torch, thrown, per):
    pipeline, *ends = thrown
    gradcheck(torch, lambda *x: ccd_torch.line_search(pipeline, *x, per=per), *ends)


def test_results_are_those_of_launches(torch, ccd_torch, thrown):
    pipeline, start, end = thrown
    given = [x.detach().numpy().copy() for x in (start, end)]
    tois = {per: ccd_torch.toi(*thrown, per=per) for per in ("scene", "body", "vertex")}
    step = ccd_torch.collision_free_step(*thrown)
    result = pipeline.launch(*given).to_host()
    assert tois["scene"].item() == step.item() == result.toi and tois["scene"].shape == ()
    for name, values in (("body", result.body_toi), ("vertex", result.vertex_toi)):
        np.testing.assert_array_equal(tois[name].detach().numpy(), values)
    shortened = ccd_torch.line_search(*thrown, per="body", safety=0.8).detach().numpy()
    np.testing.assert_array_equal(end.detach().numpy(), given[1])
    pipeline.launch_line_search(*given, per="body", safety=0.8)
    np.testing.assert_array_equal(shortened, given[1])
    apart = ccd_torch.collision_free_step(pipeline, start, start)
    apart.backward()
    assert apart.item() == 1.0 and not start.grad.any()


def test_flags_say_which_results_have_a_derivative(torch, ccd_torch, thrown):
    found = ccd_torch.toi(*thrown, per="vertex")
    assert torch.equal(ccd_torch.toi_is_regular(*thrown, per="vertex"), torch.isfinite(found))
    assert ccd_torch.toi_is_regular(*thrown).item() is True
    given = [x.detach().clone() for x in thrown[1:]]
    assert ccd_torch.line_search_is_regular(*thrown, per="vertex", safety=0.8).all()
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (TRIANGLE + [0, 0, 0.05], FACE)])
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=0.1, device="cpu")  # within it at the start
    start = torch.tensor(mesh.vertices)
    end = start - torch.tensor([[0, 0, 0.0]] * 3 + [[0, 0, 1.0]] * 3)
    assert not ccd_torch.line_search_is_regular(pipeline, start, end).any()
    assert not ccd_torch.toi_is_regular(pipeline, start, end, per="body").any()
    assert all(torch.equal(x, y) for x, y in zip(thrown[1:], given, strict=True))
    with pytest.raises(ValueError, match="vertices_t1 is a ndarray; expected a tensor"):
        ccd_torch.line_search_is_regular(pipeline, start, end.numpy())


def test_nothing_is_copied_and_everything_is_kept(torch, ccd_torch, thrown):
    _, start, end = thrown
    found = ccd_torch.toi(*thrown, per="vertex")
    function = found.grad_fn
    assert [x.ptr for x in function.arrays] == [start.data_ptr(), end.data_ptr()]
    assert function.toi.ptr == found.data_ptr()
    values, weights = found.detach().clone(), torch.arange(len(found), dtype=torch.float64)
    weights[torch.isinf(found)] = 0.0
    first, second = (torch.autograd.grad(found, start, weights * factor, retain_graph=True)[0] for factor in (1.0, 2.0))
    kept = first.clone()
    del function
    ccd_torch.toi(thrown[0], end, start)  # a later launch
    gc.collect()
    assert torch.equal(found, values) and torch.equal(first, kept)
    torch.testing.assert_close(second, 2.0 * first)


def test_worlds_in_one_tensor(torch, ccd_torch):
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (TRIANGLE + [0, 0, 1.0], FACE)]).replicate(3)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    for dtype in (torch.float32, torch.float64):
        start = torch.tensor(mesh.vertices.reshape(3, 6, 3), dtype=dtype, requires_grad=True)
        speed = torch.tensor([2.0, 4.0, 0.5], dtype=dtype, requires_grad=True)
        end = start - torch.tensor([[0, 0, 0.0]] * 3 + [[0, 0, 1.0]] * 3, dtype=dtype) * speed[:, None, None]
        found = ccd_torch.toi(pipeline, start, end, per="world")
        torch.testing.assert_close(found, torch.tensor([0.5, 0.25, torch.inf], dtype=torch.float64), rtol=1e-6, atol=0)
        (gradient,) = torch.autograd.grad(found[:2].sum(), speed)
        torch.testing.assert_close(gradient, torch.tensor([-0.25, -0.0625, 0.0], dtype=dtype), rtol=1e-5, atol=0)


def test_torch_compile_calls_them_as_they_are(torch, ccd_torch, thrown):
    pipeline, start, end = thrown

    def squared(x, y):
        return (ccd_torch.collision_free_step(pipeline, x * 1.0, y) * 3.0) ** 2

    found = [
        torch.autograd.grad(f(start, end), (start, end)) for f in (squared, torch.compile(squared, backend="eager"))
    ]
    for x, y in zip(*found, strict=True):
        assert torch.equal(x, y) and x.any()


def test_bad_use_is_told(torch, ccd_torch, thrown):
    pipeline, start, end = thrown
    with pytest.raises(ValueError, match="vertices_t0 has dtype int"):
        ccd_torch.toi(pipeline, start.detach().long(), end.detach().long())
    with pytest.raises(ValueError, match="vertices_t1 is a ndarray; expected a tensor"):
        ccd_torch.toi(pipeline, start, end.detach().numpy())
    with pytest.raises(ValueError, match="vertices_t0 has strides"):
        ccd_torch.toi(pipeline, start.detach().T.contiguous().T, end)
    with pytest.raises(ValueError, match="not finite"):
        ccd_torch.line_search(pipeline, start, end * torch.nan)
    with pytest.raises(ValueError, match="per is 'edge'"):
        ccd_torch.toi(pipeline, start, end, per="edge")
    with pytest.raises(ValueError, match="pipeline is"):
        ccd_torch.collision_free_step(pipeline.mesh, start, end)
    pipeline.reserve(max_pairs=1000, max_contacts=1)
    with pytest.raises(RuntimeError, match=r"CONTACTS_OVERFLOW.*reserve"):
        ccd_torch.toi(pipeline, start, end)
    assert np.isfinite(ccd_torch.toi(pipeline, start.detach(), end.detach()).item())  # which needs no list


def test_without_pytorch_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "ccd_warp.torch", raising=False)
    with pytest.raises(ImportError, match=r"pip install 'ccd-warp\[interop\]'"):
        importlib.import_module("ccd_warp.torch")
