"""The width of the lanes that a device is given, on processors of several kinds."""

from types import SimpleNamespace

import pytest

from ccd_warp._runtime import lanes

WIDE = [({"AVX", "AVX2", "AVX512F"}, 8), ({"X86_V2", "X86_V3", "X86_V4"}, 8), ({"AVX", "AVX2"}, 4)]
NARROW = [({"AVX"}, 1), ({"NEON", "ASIMD"}, 1), (set(), 1)]


@pytest.mark.parametrize(("features", "width"), WIDE + NARROW)
def test_width_by_processor(features, width, monkeypatch):
    monkeypatch.setattr(lanes, "cpu_features", lambda: features)
    monkeypatch.setattr(lanes, "cpu_lanes", lanes.cpu_lanes.__wrapped__)
    monkeypatch.delenv("CCD_WARP_LANES", raising=False)
    assert [lanes.lanes_of(SimpleNamespace(is_cuda=is_cuda)) for is_cuda in (False, True)] == [width, 1]
    monkeypatch.setenv("CCD_WARP_LANES", "3")
    with pytest.raises(ValueError, match="CCD_WARP_LANES must be 1, 4 or 8; found '3'"):
        lanes.cpu_lanes()


@pytest.mark.parametrize(
    ("config", "width"),
    [
        ({"SIMD Extensions": {"baseline": ["SSE2"], "found": ["AVX2", "AVX512F"], "not found": ["AVX512_SPR"]}}, 8),
        ({"SIMD Extensions": {"baseline": ["X86_V2", "X86_V3"], "not found": ["X86_V4"]}}, 4),
        ({}, 1),
        (TypeError("mode"), 1),  # NumPy 1.26 built by setuptools
    ],
)
def test_numpy_says_what_the_processor_has(config, width, monkeypatch):
    def show_config(mode):
        if isinstance(config, Exception):
            raise config
        return config

    monkeypatch.setattr(lanes.np, "show_config", show_config)
    assert lanes.lanes_with(lanes.cpu_features()) == width
