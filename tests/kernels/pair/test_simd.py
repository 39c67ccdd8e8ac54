"""Lanes that begin where lines of the cache do: nothing that the host lays out holds one."""

import pytest
import warp as wp
from ccd_warp.kernels.step.pair_list import PairList

from ccd_warp._runtime.every_module import every_module

CPP = {wp.float64: "double", wp.float32: "float", wp.int64: "long long", wp.int32: "int"}


def types_in(of):
    """The types of what an argument of a kernel holds, those of arrays and of the fields of structs included."""
    yield of
    if hasattr(of, "ndim"):  # an array
        yield from types_in(of.dtype)
    elif isinstance(of, type(PairList)):
        for field in of.vars.values():
            yield from types_in(field.type)


@pytest.mark.parametrize("width", [4, 8])
def test_no_argument_of_a_kernel_holds_vectors_that_are_aligned_otherwise_than_by_warp(width):
    options = {name: (m, m.options["extra_build_options"]) for name, m in every_module(width).items()}
    aligned = {name: m for name, (m, build) in options.items() if build and build.extra_cpu_preamble}
    assert {"measure_pairs ball", "narrow_phase float32", "narrow_phase float64 euclidean"} <= aligned.keys()
    for name, module in aligned.items():
        preamble = options[name][1].extra_cpu_preamble
        types = [t for k in module.kernels.values() for a in k.adj.args for t in types_in(a.type)]
        vectors = {t for t in types if hasattr(t, "_wp_scalar_type_")}
        vectors = {f"vec_t<{t._length_}, {CPP.get(t._wp_scalar_type_)}>" for t in vectors}
        assert len(vectors) > 1 and not any(vector in preamble for vector in vectors), name
