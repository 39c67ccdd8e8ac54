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
        if item.fspath == request.fspath and hasattr(item, "callspec")
    ]
    folder = tmp_path_factory.mktemp("ptx")
    count = min(os.cpu_count() or 1, 8)
    command = [sys.executable, __file__, "--compile", str(folder)]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    processes = [subprocess.Popen([*command, *names], **options) for k in range(count) if (names := wanted[k::count])]
    return folder, "".join(process.communicate()[0] for process in processes)


@pytest.mark.parametrize("name", cuda_modules())
def test_compiles_to_ptx(name, compiled):
    folder, output = compiled
    paths = list((folder / name).glob("*.ptx"))
    assert len(paths) == 1, output
    ptx = paths[0].read_text()
    for kernel in cuda_modules()[name].kernels.values():
        assert kernel.key.split(".")[-1].split("__")[-1] in ptx
    # fuse_fp is off: no bound relies on it, but contraction would make CPU and CUDA differ. Where it is on, the
    # compiler fuses, or leaves operations without a rounding of their own for the driver to fuse.
    assert not re.search(r"\b(fma\.rn|(add|sub|mul))\.f(32|64)", ptx)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--compile", nargs="+", metavar=("FOLDER", "NAME"), required=True)
    folder, *names = parser.parse_args().compile
    wp.config.log_level = wp.LOG_ERROR
    # takes half as long as the default, 3, and answers the same questions
    wp.config.optimization_level = 1
    modules = cuda_modules()
    for name in names or modules:
        wp.compile_aot_module(modules[name], device=None, arch=80, module_dir=str(Path(folder, name)), use_ptx=True)


if __name__ == "__main__":
    main()
