"""The CUDA side of every kernel compiles to PTX without a GPU, and holds no fused multiply-add.

The modules are compiled by processes of their own, one a core: `python tests/test_cuda.py --compile FOLDER NAME …`.
"""

import argparse
import importlib
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import ccd_warp.kernels
import pytest
import warp as wp
from ccd_warp.benchmarks.cuda_modules import cuda_modules

# Files whose kernels have other versions for CUDA.
CPU_ONLY = ["pair_search", "grid_search"]


def test_every_file_with_kernels_is_covered():
    covered = {name.split()[0] for name in cuda_modules()} | {"narrow_phase"}  # which only the CPU launches
    for info in pkgutil.iter_modules(ccd_warp.kernels.__path__):
        module = importlib.import_module(f"ccd_warp.kernels.{info.name}")
        source = open(module.__file__, encoding="utf-8").read()
        if "@wp.kernel" in source:
            assert (info.name in covered) != (info.name in CPU_ONLY)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory, request):
    """The folder of the PTX of every module asked for, and what the processes that compiled it said."""
    wanted = [
        item.callspec.params["name"]
        for item in request.session.items
        if item.fspath == request.fspath and hasattr(item, "callspec") and "name" in item.callspec.params
    ]
    folder = tmp_path_factory.mktemp("ptx")
    count = min(os.cpu_count() or 1, 8)
    command = [sys.executable, __file__, "--compile", str(folder)]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    processes = [subprocess.Popen([*command, *names], **options) for k in range(count) if (names := wanted[k::count])]
    return folder, "".join(process.communicate()[0] for process in processes)


# Of the kernels for radii, which all run emulated, those that take the distances of pairs each in another way.
_OF_RADII = ["queued_pairs solve_pairs later float64 thick", "candidate_cull thick", "half_warp_search boxes thick"]
NAMES = [name for name in cuda_modules(with_distances=True) if not name.endswith("thick") or name in _OF_RADII]


@pytest.mark.parametrize("name", NAMES)
def test_compiles_to_ptx(name, compiled):
    folder, output = compiled
    paths = list((folder / name).glob("*.ptx"))
    assert len(paths) == 1, output
    ptx = paths[0].read_text()
    for kernel in cuda_modules(with_distances=True)[name].kernels.values():
        assert kernel.key.split(".")[-1].split("__")[-1] in ptx
    # fuse_fp is off: no bound relies on it, but contraction would make CPU and CUDA differ. Where it is on, the
    # compiler fuses, or leaves operations without a rounding of their own for the driver to fuse.
    assert not re.search(r"\b(fma\.rn|(add|sub|mul))\.f(32|64)", ptx)


@pytest.fixture(scope="module")
def optimized(tmp_path_factory):
    """A function that gives the PTX of a module as it is compiled for a user."""
    names = ["half_warp_search list False", "half_warp_search boxes False", "half_warp_tree"]
    folder = tmp_path_factory.mktemp("optimized")
    command = [sys.executable, __file__, "--optimization-level", "3", "--compile", str(folder), *names]
    subprocess.run(command, check=True, capture_output=True)
    return lambda name: next((folder / name).glob("*.ptx")).read_text()


@pytest.mark.parametrize(("end", "number"), [("list", 12), ("boxes", 6)])
def test_a_search_loads_a_box_without_a_branch_and_keeps_its_way_in_registers(end, number, optimized):
    """All numbers of a box are on their way before the first is needed: at the top, at inner blocks, at leaves."""
    ptx = optimized(f"half_warp_search {end} False")
    stretches = re.split(r"\bbra\b|^\$L", ptx, flags=re.MULTILINE)
    assert sum(len(re.findall(r"\bld\.global\S*32\b", stretch)) >= number for stretch in stretches) >= 3
    assert ".local" not in ptx
    assert "vote.sync.ballot" in ptx and "shfl.sync.idx" in ptx


def test_boxes_are_loaded_four_numbers_at_a_time(optimized):
    assert len(re.findall(r"\bld\.global\S*\.v4\.", optimized("half_warp_tree"))) >= 6


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--compile", nargs="+", metavar=("FOLDER", "NAME"), required=True)
    # 1 takes half as long as Warp's own 3, and answers most questions as well
    parser.add_argument("--optimization-level", type=int, default=1)
    given = parser.parse_args()
    folder, *names = given.compile
    wp.config.log_level = wp.LOG_ERROR
    wp.config.optimization_level = given.optimization_level
    modules = cuda_modules(with_distances=True)
    for name in names or modules:
        wp.compile_aot_module(modules[name], device=None, arch=80, module_dir=str(Path(folder, name)), use_ptx=True)


if __name__ == "__main__":
    main()
