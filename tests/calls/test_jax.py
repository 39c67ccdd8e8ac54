"""Functions of JAX: their gradients against differences, within jit and vmap, and bad use."""

import importlib
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import FACE, TRIANGLE
from toi_scenes import random_scene

import ccd_warp as ccd

FALL = np.array([[0.0, 0, 0]] * 3 + [[0.0, 0, 1]] * 3)


@pytest.fixture(scope="module")
def jax():
    module = pytest.importorskip("jax")
    module.config.update("jax_enable_x64", True)
    return module


@pytest.fixture(scope="module")
def ccd_jax(jax):
    return importlib.import_module("ccd_warp.jax")


@pytest.fixture
def thrown(jax):
    """Tetrahedra that are thrown into each other: a pipeline, and both ends."""
    mesh, start, end, options = random_scene(1)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", tolerance=1e-12, **options)
    return pipeline, jax.numpy.array(start), jax.numpy.array(end)


@pytest.fixture
def worlds(jax):
    """A pipeline of three worlds in each of which a triangle is above another, and its positions by world."""
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (TRIANGLE + [0, 0, 1.0], FACE)]).replicate(3)
    return ccd.CollisionPipeline(mesh, device="cpu"), jax.numpy.array(mesh.vertices.reshape(3, 6, 3))


def check(jax, function, *arrays):
    test_util = importlib.import_module("jax.test_util")
    # differences of tois in float64 have some eight digits
    test_util.check_grads(jax.jit(function), arrays, order=1, modes=["rev"], eps=1e-6, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("per", ["scene", "body", "vertex"])
def test_gradients_agree_with_differences(jax, ccd_jax, thrown, per):
    pipeline, *ends = thrown
    is_finite = jax.numpy.isfinite(ccd_jax.toi(*thrown, per=per))
    check(jax, lambda *x: jax.numpy.where(is_finite, ccd_jax.toi(pipeline, *x, per=per), 0.0), *ends)
    check(jax, lambda *x: ccd_jax.line_search(pipeline, *x, per=per), *ends)


def test_results_are_those_of_launches(ccd_jax, thrown):
    pipeline, start, end = thrown
    given = [np.array(x) for x in (start, end)]
    result = pipeline.launch(*given).to_host()
    assert ccd_jax.toi(*thrown) == ccd_jax.collision_free_step(*thrown) == result.toi
    np.testing.assert_array_equal(ccd_jax.toi(*thrown, per="vertex"), result.vertex_toi)
    shortened = ccd_jax.line_search(*thrown, per="body", safety=0.8)
    pipeline.launch_line_search(*given, per="body", safety=0.8)
    np.testing.assert_array_equal(shortened, given[1])
    assert ccd_jax.collision_free_step(pipeline, start, start) == 1.0


def test_flags_say_which_results_have_a_derivative(jax, ccd_jax, thrown, worlds):
    found = ccd_jax.toi(*thrown, per="vertex")
    np.testing.assert_array_equal(ccd_jax.toi_is_regular(*thrown, per="vertex"), np.isfinite(found))
    assert ccd_jax.toi_is_regular(*thrown) and ccd_jax.line_search_is_regular(*thrown, per="body").all()
    pipeline, start = worlds
    speed = jax.numpy.array([2.0, 4.0, 0.5])
    ends = start, start - FALL * speed[:, None, None]
    mapped = jax.vmap(lambda x, y: ccd_jax.toi_is_regular(pipeline, x, y))(*ends)
    np.testing.assert_array_equal(mapped, [True, True, False])  # the third does not touch
    start = start.at[2, 3:, 2].set(0.0)  # touches from the start
    flags = jax.vmap(lambda x, y: ccd_jax.line_search_is_regular(pipeline, x, y, per="world"))(start, ends[1])
    np.testing.assert_array_equal(flags, [[True] * 6, [True] * 6, [False] * 6])


def test_worlds_are_mapped(jax, ccd_jax, worlds):
    pipeline, start = worlds
    speed = jax.numpy.array([2.0, 4.0, 0.5])

    def of_world(speed, start, per="scene"):
        return ccd_jax.toi(pipeline, start, start - FALL * speed, per=per)

    expected = [0.5, 0.25, np.inf]
    np.testing.assert_allclose(jax.vmap(of_world)(speed, start), expected, rtol=1e-9)
    of_bodies = jax.vmap(lambda *x: of_world(*x, per="body"))(speed, start)
    np.testing.assert_allclose(of_bodies, np.transpose([expected, expected]), rtol=1e-9)
    gradient = jax.jit(jax.vmap(jax.grad(of_world)))(speed, start)
    np.testing.assert_allclose(gradient, [-0.25, -0.0625, 0.0], rtol=1e-9)
    # all worlds in one array, and in float32
    for dtype, tolerance in (("float64", 1e-9), ("float32", 1e-6)):
        x = start.astype(dtype)
        found = ccd_jax.toi(pipeline, x, x - (FALL * speed[:, None, None]).astype(dtype), per="world")
        np.testing.assert_allclose(found, expected, rtol=tolerance)

    def height(speed, start):
        return ccd_jax.line_search(pipeline, start, start - FALL * speed, per="world")[3, 2]

    np.testing.assert_allclose(jax.vmap(height)(speed, start), [0.1, 0.1, 0.5], rtol=1e-6)  # 1 - 0.9 of the gap
    np.testing.assert_allclose(jax.vmap(jax.grad(height))(speed, start), [0.0, 0.0, -1.0], atol=1e-9)


def test_bad_use_is_told(jax, ccd_jax, thrown, worlds, monkeypatch, capfd):
    pipeline, start, end = thrown
    with pytest.raises(ValueError, match="vertices_t0 has dtype int"):
        ccd_jax.toi(pipeline, start.astype(int), end)
    with pytest.raises(ValueError, match=r"vertices_t1 has dtype float64 and shape \(19, 3\)"):
        ccd_jax.toi(pipeline, start, end[1:])
    with pytest.raises(ValueError, match="vertices_t0 has 19 rows"):
        ccd_jax.line_search(pipeline, start[1:], end[1:])
    with pytest.raises(ValueError, match="per is 'edge'"):
        ccd_jax.toi(pipeline, start, end, per="edge")
    with pytest.raises(ValueError, match="pipeline is"):
        ccd_jax.toi(pipeline.mesh, start, end)
    with pytest.raises(jax.errors.JaxRuntimeError, match="not finite"):
        ccd_jax.toi(pipeline, start, end * np.nan).block_until_ready()
    pipeline, start = worlds
    with pytest.raises(jax.errors.JaxRuntimeError, match="expected 18, one a vertex"):
        jax.vmap(lambda x: ccd_jax.toi(pipeline, x, x))(start[:2]).block_until_ready()
    capfd.readouterr()  # Warp prints what its bridge passes on
    monkeypatch.setattr(jax.numpy, "zeros", lambda count: SimpleNamespace(dtype="float32"))
    with pytest.raises(ValueError, match="jax_enable_x64"):
        ccd_jax.toi(pipeline, start, start)


def test_without_jax_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    monkeypatch.delitem(sys.modules, "ccd_warp.jax", raising=False)
    with pytest.raises(ImportError, match=r"pip install 'ccd-warp\[interop\]'"):
        importlib.import_module("ccd_warp.jax")
