"""The CUDA source of a Warp module, with an entry point for each of its kernels that the host can call."""

import re
import tempfile
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any
from unittest import mock

import warp as wp
from warp._src import build as warp_build

# Sizes of a block for which a kernel has an entry point.
BLOCK_DIMS = (32, 64, 128, 256, 512, 1024)
# What a block is at most where no kernel depends on it: a few hundred items are several blocks then, for both threads.
_SMALL_BLOCK_DIM = 64

_KERNEL = re.compile(
    r'extern "C" __global__ void (?:\w+\([^)]*\)\s*)*'
    r"(\w+)_cuda_kernel_forward\(\s*(wp::launch_bounds_t<\d>) dim(.*?)\)\s*\{",
    re.DOTALL,
)
# Calls of a warp or of a block, which threads make together.
_COLLECTIVE = re.compile(r"__\w+_sync\s*\(|__sync(warp|threads)\s*\(")
_BLOCK = re.compile(r"__shared__|__syncthreads\s*\(")
_TILE = re.compile(r"wp::tile_(?!shared_storage_t)")
_WRITING = Lock()


def entry_point(kernel: str, block_dim: int) -> str:
    """Name of the function that launches a kernel, which has a mangled name, in blocks of a size."""
    return f"{kernel}_in_blocks_of_{block_dim}"


@cache
def _own_source() -> str:
    return Path(__file__).read_text(encoding="utf-8")


def name_of(module: Any) -> str:
    """What tells the emulated source of a module from all others.

    Not the source itself, in which the order of functions depends on what the process has built before, and which takes
    longer to write than Warp's hash of what it is written from.
    """
    module_hash = module.get_module_hash(module.options["block_dim"]).hex()
    return f"{module.name} {module_hash} {_own_source()}"


def cuda_source(module: Any) -> str:
    """The source that Warp hands to the compiler of CUDA, which is not called; written by one thread at a time."""

    def write_nothing(_source_path: str, _arch: int, output_path: str, **_options: Any) -> None:
        Path(output_path).touch()

    with _WRITING, tempfile.TemporaryDirectory() as folder, mock.patch.object(warp_build, "build_cuda", write_nothing):
        wp.compile_aot_module(module, device=None, arch=90, module_dir=folder, use_ptx=True)
        (path,) = Path(folder).glob("*.cu")
        return path.read_text(encoding="utf-8")


def emulated_source(source: str) -> str:
    """A C++ program: the device, the CUDA source, and functions with the arguments of Warp's kernels for the CPU.

    Raises:
        NotImplementedError: If a kernel uses Warp's tiles.
    """
    if _TILE.search(source):
        raise NotImplementedError("a kernel uses tiles of Warp; expected none, as they are not emulated")
    parts = ['#include "device.h"', source]
    togetherness, most = "WARPS" if _COLLECTIVE.search(source) else "ALONE", _SMALL_BLOCK_DIM
    if _BLOCK.search(source):
        togetherness, most = "BLOCKS", max(BLOCK_DIMS)
    for match in _KERNEL.finditer(source):
        kernel, bounds, declared = match.groups()
        fields = [field.strip() for field in declared.split(",\n") if field.strip()]
        values = ", ".join(["*launch.bounds", *(f"launch.given->{field.split()[-1]}" for field in fields)])
        parts += [
            f"struct {kernel}_arguments {{ {' '.join(field + ';' for field in fields)} }};",
            f"struct {kernel}_launch {{ {bounds}* bounds; {kernel}_arguments* given; }};",
            f"static void {kernel}_thread(void* argument)",
            f"{{ const auto& launch = *({kernel}_launch*)argument; {kernel}_cuda_kernel_forward({values}); }}",
        ]
        parts += [
            f'extern "C" int {entry_point(kernel, block_dim)}({bounds}* bounds, {kernel}_arguments* given)\n'
            f"{{ {kernel}_launch launch {{ bounds, given }}; "
            f"return run_grid(bounds->size, {min(block_dim, most)}, {togetherness}, {kernel}_thread, &launch); }}"
            for block_dim in BLOCK_DIMS
        ]
    return "\n".join(parts)
