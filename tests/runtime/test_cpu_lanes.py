"""The width of the lanes that a device is given, on processors of several kinds."""

import importlib
from types import SimpleNamespace

import pytest

from ccd_warp._runtime import lanes


@pytest.mark.parametrize(
    ("features", "width"),
    [
        ({"AVX", "AVX2", "AVX512F"}, 8),
        ({"X86_V2", "X86_V3", "X86_V4"}, 8),
        ({"fpu", "avx", "avx2", "avx512f"}, 8),
        ({"fpu", "avx", "avx2"}, 4),
        ({"fpu", "avx"}, 1),
        ({"NEON", "ASIMD"}, 1),
        (set(), 1),
    ],
)
def test_width_by_processor(features, width, monkeypatch):
    monkeypatch.setattr(lanes, "cpu_features", lambda: features)
    monkeypatch.setattr(lanes, "cpu_lanes", lanes.cpu_lanes.__wrapped__)
    monkeypatch.delenv("CCD_WARP_LANES", raising=False)
    assert [lanes.lanes_of(SimpleNamespace(is_cuda=is_cuda)) for is_cuda in (False, True)] == [width, 1]
    monkeypatch.setenv("CCD_WARP_LANES", "3")
    with pytest.raises(ValueError, match="CCD_WARP_LANES must be 1, 4 or 8; found '3'"):
        lanes.cpu_lanes()


@pytest.mark.parametrize(
    ("text", "features"),
    [
        ("processor\t: 0\nflags\t\t: fpu avx avx2\nbugs\t: none\nflags\t\t: fpu\n", {"fpu", "avx", "avx2"}),
        ("Features\t: fp asimd\n", set()),  # a processor of another family
        (None, set()),  # not Linux
    ],
)
def test_linux_tells_where_numpy_does_not(text, features, tmp_path, monkeypatch):
    def refuse(name):
        raise ImportError(name)

    by_numpy = lanes.lanes_with(lanes.cpu_features())
    monkeypatch.setattr(importlib, "import_module", refuse)
    assert lanes.lanes_with(lanes.cpu_features()) in (by_numpy, 1)  # 1 where there is no list of the processor's flags
    path = tmp_path / "cpuinfo"
    if text is not None:
        path.write_text(text)
    monkeypatch.setattr(lanes, "_CPU_INFO", path)
    assert lanes.cpu_features() == features
