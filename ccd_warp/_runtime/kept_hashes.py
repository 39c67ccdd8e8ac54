"""The hashes of modules that come with the package, so that Warp need not read all kernels for them once more.

They are kept with the digest of the files of kernels, and serve as long as these, and Warp's options, are the same.
"""

import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import warp as wp

from ccd_warp import kernels


class _KeptHasher:
    """What Warp asks the hasher of a module for, which goes through all functions that its kernels call."""

    def __init__(self, module_hash: bytes, hashes: dict[Any, bytes]) -> None:
        self.hash = module_hash
        self.kernel_hashes = WeakKeyDictionary(hashes)
        self.unique_kernels = {
            kernel_hash: kernel for kernel, kernel_hash in sorted(hashes.items(), key=lambda k: k[1])
        }

    def get_hash(self) -> bytes:
        return self.hash

    def get_unique_kernels(self) -> Iterable[Any]:
        return self.unique_kernels.values()


@cache
def digest_of_sources() -> str:
    """That of all files of kernels and their names."""
    digest, folder = hashlib.sha256(), Path(kernels.__path__[0])
    for path in sorted(folder.rglob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()} {len(content)} ".encode() + content)
    return digest.hexdigest()


def hashes_of(module: Any, block_dim: int) -> dict[str, list[Any]]:
    """The hash of a module, and for each kernel its own and whether it strides, by the name and the options."""
    module_hash, live = module.get_module_hash(block_dim), list(module._get_live_kernels())
    of_kernels = {kernel.key: [kernel.hash.hex(), kernel.grid_stride] for kernel in live}
    is_known = len(of_kernels) == len(live) and not module.has_unresolved_static_expressions
    return {_key(module, block_dim): [module_hash.hex(), of_kernels]} if is_known else {}


def recall(module: Any, block_dim: int | None, index: dict[str, Any]) -> None:
    """Give Warp the hash that an index has for a module, where it is for these sources and options."""
    if block_dim in module.hashers or index.get("sources") != digest_of_sources():
        return
    module_hash, of_kernels = index["hashes"].get(_key(module, block_dim), ("", {}))
    live = list(module._get_live_kernels())
    if module.has_unresolved_static_expressions or sorted(kernel.key for kernel in live) != sorted(of_kernels):
        return
    hashes = {}
    for kernel in live:
        kernel.adj.get_references()  # finds the dimension of its launches, too; what takes long is all that it calls
        of_kernel, kernel.grid_stride = of_kernels[kernel.key]
        kernel.hash = hashes[kernel] = bytes.fromhex(of_kernel)
    module.hashers[block_dim] = _KeptHasher(bytes.fromhex(module_hash), hashes)
    module.resolved_options[block_dim] = module.resolve_options(wp.config, block_dim=block_dim)


def _key(module: Any, block_dim: int | None) -> str:
    options = sorted(module.resolve_options(wp.config, block_dim=block_dim).items())
    return f"{module.name} {hashlib.sha256(repr(options).encode()).hexdigest()}"
