"""The hashes of modules that were compiled before, so that Warp need not read all functions of kernels to compute them.

They come with the package, or lie in Warp's cache with the objects. One serves as long as the files of kernels, their
code as Python ran it, the version of Warp and its options are the same, and names only what is there: what is compiled,
Warp names by itself. The code is not that of its file where the bytecode is stale: Python takes it for that of a file
of its time and size.
"""

import hashlib
import json
import marshal
import os
import sys
import threading
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from types import CodeType
from typing import Any
from weakref import WeakKeyDictionary

import warp as wp

from ccd_warp import kernels
from ccd_warp.kernels.kept_code import codes
from ccd_warp.kernels.later import sources

# What Warp learns of a kernel only where it looks for what that refers to, which it does for its hash.
_OF_HASHING = ("kernel_dim", "tid_extent_limit_candidate")
_FOLDER = "wp_ccd_warp.hashes"  # in Warp's cache, which `warp.clear_kernel_cache` empties of what begins with "wp_"
_digested: dict[str, bytes] = {}
_digest = ""
_compiled: dict[str, Any] = {}
_as_written: set[str] = set()  # files whose code has been compared


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


def digest_of_sources() -> str:
    """That of all files of kernels and their names, with the version of Warp: as they were when they were executed."""
    global _digested, _digest
    if not _digest or any(_digested.get(path) != content for path, content in [*sources.items()]):
        folder = Path(kernels.__path__[0])
        _digested = {str(path): path.read_bytes() for path in sorted(folder.rglob("*.py"))} | sources
        digest = hashlib.sha256(wp.config.version.encode())
        for path, content in _digested.items():
            digest.update(f" {_relative(path)} {len(content)} ".encode() + content)
        _digest = digest.hexdigest()
    return _digest


def code_of_sources() -> dict[str, str]:
    """Digests of what this Python compiles each file of kernels to, by their names."""
    if _compiled.get("sources") != digest_of_sources():
        code = {_relative(path): _digest_of_code(path, _compile(path)) for path in _digested}
        _compiled.update(sources=digest_of_sources(), code=code)
    return dict(_compiled["code"])


def runs_as_written(known: dict[str, str]) -> bool:
    """Whether the code of kernels that has run is that of the sources, and not of stale bytecode.

    Args:
        known: `code_of_sources` of any Python. What is other code is compiled to be compared, a millisecond a file.
    """
    for path in codes.keys() - _as_written:
        digest = _digest_of_code(path, codes[path])
        if digest != known.get(_relative(path)) and digest != _digest_of_code(path, _compile(path)):
            return False
        _as_written.add(path)
    return True


def hashes_of(module: wp.Module, block_dim: int | None) -> dict[str, list[Any]]:
    """The hash of a module, and for each kernel its own, whether it strides and its dimension, by name and options."""
    module_hash, live = module.get_module_hash(block_dim), list(module._get_live_kernels())
    of_kernels = {
        kernel.key: [kernel.hash.hex(), kernel.grid_stride, *(getattr(kernel.adj, name) for name in _OF_HASHING)]
        for kernel in live
    }
    is_known = len(of_kernels) == len(live) and not module.has_unresolved_static_expressions
    return {_key(module, block_dim): [module_hash.hex(), of_kernels]} if is_known else {}


def recall(module: wp.Module, block_dim: int | None, index: dict[str, Any]) -> None:
    """Give Warp the hash that an index has for a module, where it is for these sources and options, and its code."""
    if block_dim in module.hashers or index.get("sources") != digest_of_sources():
        return
    if not runs_as_written(index.get("code", {})):
        return
    module_hash, of_kernels = index["hashes"].get(_key(module, block_dim), ("", {}))
    live = list(module._get_live_kernels())
    if module.has_unresolved_static_expressions or sorted(kernel.key for kernel in live) != sorted(of_kernels):
        return
    hashes = {}
    for kernel in live:
        of_kernel, kernel.grid_stride, *others = of_kernels[kernel.key]
        for name, value in zip(_OF_HASHING, others, strict=True):
            setattr(kernel.adj, name, value)
        kernel.hash = hashes[kernel] = bytes.fromhex(of_kernel)
    module.hashers[block_dim] = _KeptHasher(bytes.fromhex(module_hash), hashes)
    module.resolved_options[block_dim] = module.resolve_options(wp.config, block_dim=block_dim)


def recall_from_cache(module: wp.Module, block_dim: int | None) -> None:
    """Give Warp the hash that is kept in its cache."""
    if _is_ours(module):
        with suppress(OSError, ValueError, TypeError, LookupError):  # there is none, or half of one
            recall(module, block_dim, dict(json.loads(_path(module, block_dim).read_bytes())))


def keep_in_cache(module: wp.Module, block_dim: int | None) -> None:
    """Keep a hash that Warp has computed, of the sources."""
    if not _is_ours(module) or isinstance(module.hashers.get(block_dim), _KeptHasher):
        return
    if not runs_as_written(code := code_of_sources()):
        return
    path = _path(module, block_dim)
    own = path.with_suffix(f".{os.getpid()}.{threading.get_ident()}")  # another process may write the same
    index = {"sources": digest_of_sources(), "code": code, "hashes": hashes_of(module, block_dim)}
    with suppress(OSError):  # a cache that cannot be written
        path.parent.mkdir(exist_ok=True)
        own.write_text(json.dumps(index), encoding="utf-8")
        own.replace(path)


def _is_ours(module: wp.Module) -> bool:
    """Whether the digest is that of all that a module may contain."""
    files = {kernel.func.__code__.co_filename for kernel in module._get_live_kernels()}
    return bool(files) and files <= sources.keys()


def _relative(path: str) -> str:
    return Path(path).relative_to(kernels.__path__[0]).as_posix()


def _compile(path: str) -> CodeType:
    return compile(_digested[path], path, "exec", dont_inherit=True)


def _digest_of_code(path: str, code: CodeType) -> str:
    """That of all that a code object says, but for the place of its file."""
    name = path.encode()  # version 2 of the format does not depend on what else a process holds
    return hashlib.sha256(marshal.dumps(code, 2).replace(len(name).to_bytes(4, "little") + name, b"")).hexdigest()[:16]


def _path(module: wp.Module, block_dim: int | None) -> Path:
    python = f"{sys.implementation.cache_tag} {sys.flags.optimize}"
    name = hashlib.sha256(f"{digest_of_sources()} {_key(module, block_dim)} {python}".encode()).hexdigest()
    return Path(str(wp.config.kernel_cache_dir), _FOLDER, f"{name}.json")


def _key(module: wp.Module, block_dim: int | None) -> str:
    options = sorted(module.resolve_options(wp.config, block_dim=block_dim).items())
    files = sorted({kernel.func.__module__ for kernel in module._get_live_kernels()})
    return f"{module.name} {hashlib.sha256(repr((files, options)).encode()).hexdigest()}"
