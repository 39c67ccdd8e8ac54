"""The level of x86-64 for which kernels are compiled, on processors of several kinds and with a user's own flags."""

import pytest
import warp as wp
from ccd_warp.kernels.boxes import rest_order

from ccd_warp._runtime import target
from ccd_warp._runtime.kernel_cache import load_or_repair
from ccd_warp._runtime.lanes import cpu_lanes

V4 = " ".join(sorted(target._V4))


@pytest.mark.parametrize(
    ("lanes", "flags", "asked", "level"),
    [
        (8, V4, "", "x86-64-v4"),
        (4, V4, "", "x86-64-v3"),
        (1, V4 + " sse2", "", "x86-64"),
        (8, V4.replace("avx512vl", ""), "", "native"),  # as Knights Landing: eight lanes, and not all of v4
        (4, "avx2 fma", "", "native"),
        (1, "", "", "native"),  # no x86-64
        (8, V4, "native", "native"),
    ],
)
def test_level_by_lanes_and_processor(lanes, flags, asked, level, monkeypatch):
    monkeypatch.setattr(target, "cpu_lanes", lambda: lanes)
    monkeypatch.setattr(target, "_flags_of_processor", lambda: frozenset(flags.split()))
    monkeypatch.setenv("CCD_WARP_TARGET", asked)
    assert target.cpu_target.__wrapped__() == level
    monkeypatch.setenv("CCD_WARP_TARGET", "x86-64-v2")
    with pytest.raises(ValueError, match="CCD_WARP_TARGET must be native or absent; found 'x86-64-v2'"):
        target.cpu_target.__wrapped__()


def test_flags_of_a_level_are_those_of_warp_but_for_the_processor_and_those_of_a_user_stay(monkeypatch):
    others = wp.config.cpu_compiler_flags.replace("-march=native", "").split()
    assert target.compiler_flags("x86-64-v3").split() == ["-target-cpu", "x86-64-v3", *others]
    assert target.compiler_flags("x86-64-v4").split()[:3] == "-target-cpu x86-64-v4 -mprefer-vector-width=512".split()
    assert target.compiler_flags("native") is None
    monkeypatch.setattr(wp.config, "cpu_compiler_flags", None)  # as Warp takes it: for this processor, without more
    assert target.compiler_flags("x86-64") == "-target-cpu x86-64"
    for flags in ("", "-target-cpu haswell", "-march=native-not"):
        monkeypatch.setattr(wp.config, "cpu_compiler_flags", flags)
        assert target.compiler_flags("x86-64-v4") is None


def test_a_kernel_is_compiled_for_the_level_and_is_called_on_cuda_as_on_every_other_machine():
    if target.cpu_target() == "native":
        pytest.skip("this processor has no level")
    kernel = rest_order.fill_centres
    load_or_repair(kernel, wp.get_device("cpu"), None)
    flags = kernel.module.resolved_options[1]["cpu_compiler_flags"]
    assert f"-target-cpu {target.LEVELS[cpu_lanes()]} " in flags
    kernel.module.options["cpu_compiler_flags"] = None  # as a load on CUDA leaves it
    assert "-march=native" in kernel.module.resolve_options(wp.config)["cpu_compiler_flags"]
    assert kernel.module.resolved_options[1]["cpu_compiler_flags"] == flags
