"""Functions and kernels that are complete when they are asked for anything, as if Warp had read them at once."""

import importlib.util
import linecache
import sys
import types

import pytest
import warp as wp
from ccd_warp.kernels import later
from ccd_warp.kernels.kept_code import KeptCode, codes

FILE = """
import warp as wp


@wp.kernel(enable_backward=False)
def fill(values: wp.array[float]):
    values[wp.tid()] = twice(1.0) + above(1)


@wp.func
def twice(x: float) -> float:
    return 2.0 * x


@wp.func
def above(x: int) -> float:
    return float(x) + 1.0


is_asked = above.key


@wp.func
def twice(x: int) -> int:
    return 2 * x


@wp.func_native("return x + y;")
def above(x: int, y: int) -> int:
    ...


@wp.kernel(enable_backward=False)
def fill_more(values: wp.array[int]):
    values[wp.tid()] = twice(1) + above(3, 4)
"""


@pytest.fixture
def module(tmp_path):
    """A file that is executed as those of kernels are."""
    name = f"later_{tmp_path.name}"
    path = tmp_path / "of_test.py"
    path.write_text(FILE)
    spec = importlib.util.spec_from_file_location(name, path, loader=KeptCode(name, str(path)))
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    later.define_functions()
    del sys.modules[name], later.sources[str(path)], codes[str(path)]


def test_overloads_and_kernels_are_those_of_warp_wherever_one_is_asked_in_between(module, tmp_path):
    assert type(module.twice) is wp.Function and type(module.fill) is later.LaterKernel
    (tmp_path / "of_test.py").write_text(f"# edited meanwhile\n{FILE}")
    linecache.clearcache()
    assert isinstance(module.fill, wp.Kernel) and {*module.fill.module.kernels} == {"fill", "fill_more"}
    assert type(module.fill) is wp.Kernel and module.fill.adj.source.startswith("@wp.kernel")
    assert len(module.twice.user_overloads) == len(module.above.user_overloads) == 2 and module.wp is wp
    filled = wp.zeros(2, dtype=float, device="cpu"), wp.zeros(2, dtype=int, device="cpu")
    for kernel, values in zip((module.fill, module.fill_more), filled, strict=True):
        wp.launch(kernel, dim=2, outputs=[values], device="cpu")
    assert [values.numpy().tolist() for values in filled] == [[4.0, 4.0], [9, 9]]


def test_a_function_that_becomes_complete_leaves_what_was_hashed_as_it_is(module):
    kernel = module.fill_more
    hasher = kernel.module.hashers[1] = object()
    later_function = types.FunctionType(module.twice.func.__code__, vars(module), "another")
    later_function.__annotations__, later_function.__module__ = {"x": int}, module.__name__
    later_function.__qualname__ = "another"
    assert type(later._Definition("func", (), {})(later_function)) is later.LaterFunction
    later.define_functions()
    assert kernel.module.hashers == {1: hasher} and len(kernel.module.functions) == 3
    kernel.module.hashers.clear()


def test_options_of_kernels_that_are_not_known_are_refused():
    with pytest.raises(TypeError):
        later._warp.func(lambda x: x, noinline=True)
    with pytest.raises(TypeError):
        later._warp.kernel(lambda x: x, fast=True)
