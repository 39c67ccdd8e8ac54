"""The CUDA side of every kernel compiles to PTX without a GPU, and holds no fused multiply-add."""

import importlib
import pkgutil
import re

import ccd_warp.kernels
import pytest
import warp as wp
from ccd_warp.kernels.device_step import make_input
from ccd_warp.kernels.narrow_phase import make_narrow_phase
from ccd_warp.kernels.pair_search import BOXES, CULL, HELD, make_pair_search

# Explicit, so that a kernel module that is added without a place here fails the test below.
PLAIN_MODULES = ["contacts", "boxes", "box_tree", "device_step", "rest_order", "body_boxes"]


def warp_modules():
    """Every Warp module with kernels: those of the files, and those that a factory makes for a precision."""
    modules = {}
    for name in PLAIN_MODULES:
        module = importlib.import_module(f"ccd_warp.kernels.{name}")
        modules[name] = wp.get_module(module.__name__)
    for real in (wp.float64, wp.float32):
        modules[f"device_step input {real.__name__}"] = make_input(real).read_moving.module
        for kernel in ("points_toi", "pairs_contacts", "pairs_bound", "pairs_minima"):
            modules[f"narrow_phase {kernel} {real.__name__}"] = getattr(make_narrow_phase(real), kernel).module
    for end in (BOXES, CULL, HELD):
        modules[f"pair_search {end}"] = make_pair_search(end).search_pairs.module
    return {name: module for name, module in modules.items() if module.kernels}


def test_every_file_with_kernels_is_covered():
    covered = {name.split()[0] for name in warp_modules()}
    for info in pkgutil.iter_modules(ccd_warp.kernels.__path__):
        module = importlib.import_module(f"ccd_warp.kernels.{info.name}")
        source = open(module.__file__, encoding="utf-8").read()
        if "@wp.kernel" in source:
            assert info.name in covered


@pytest.mark.parametrize("name", warp_modules())
def test_compiles_to_ptx(name, tmp_path):
    module = warp_modules()[name]
    wp.compile_aot_module(module, device=None, arch=80, module_dir=str(tmp_path), use_ptx=True)
    (path,) = tmp_path.glob("*.ptx")
    ptx = path.read_text()
    for kernel in module.kernels.values():
        assert kernel.key.split(".")[-1].split("__")[-1] in ptx
    # fuse_fp is off: no bound relies on it, but contraction would make CPU and CUDA differ
    assert not re.search(r"\bfma\.rn\.f(32|64)", ptx)
