"""Kernels that come compiled with the package, in wheels that hold them: found by their hash, checked, and loaded.

Warp loads an object from where it lies, so nothing is written, and none in a cache is touched.
"""

import hashlib
import json
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import warp as wp

from ccd_warp._runtime.kept_hashes import code_of_sources, digest_of_sources, recall, runs_as_written
from ccd_warp._runtime.target import NATIVE, cpu_target

FOLDER = Path(__file__).parents[1] / "_objects"
INDEX = "index.json"  # the version of Warp, length and checksum of each file, and hashes of modules


def load_packaged(module: wp.Module, device: wp.Device, block_dim: int | None) -> bool:
    """Load a module of the package for a device; whether there was one. A damaged one is named, and not loaded."""
    if not has_any():  # no hash is computed for nothing
        return False
    recall(module, block_dim, _index())
    meta = FOLDER / meta_name(module, block_dim)
    for name, arch in _names(module, device, block_dim):
        path = FOLDER / name
        if not is_known(name) or not is_known(meta.name):
            continue
        try:
            if not _is_whole(path) or not _is_whole(meta):
                raise ValueError("it is damaged: install ccd-warp again")
            module.load(device, block_dim, binary_path=path, meta_path=meta, output_arch=arch)
            return True
        except Exception as error:  # Warp raises whatever a driver says
            text = f"{path} of the package cannot be loaded ({error}); {module.name} is compiled instead"
            warnings.warn(text, RuntimeWarning, stacklevel=2)
            return False
    return False


def is_packaged(module: wp.Module, device: wp.Device, block_dim: int | None) -> bool:
    """Whether the package has a module for a device, and whole."""
    paths = [FOLDER / name for name, _ in _names(module, device, block_dim) if is_known(name)]
    return bool(paths) and _is_whole(paths[0]) and _is_whole(FOLDER / meta_name(module, block_dim))


def is_known(name: str) -> bool:
    """Whether the package has a file, by what it says itself."""
    return name in _files()


def has_any() -> bool:
    """Whether the package has kernels that this Warp can load."""
    return bool(_files())


def why_none(device: wp.Device) -> str:
    """Why the package has no kernels for a device at all, or an empty text where it may have some."""
    index = _index()
    if not index:
        return "this installation holds none: a checkout, or a wheel for all platforms"
    if index["warp"] != wp.config.version:
        return f"those of the package are for Warp {index['warp']}; this is {wp.config.version}"
    if device.is_cpu and cpu_target() == NATIVE:
        return "code for this very processor is asked for, or none of the levels of x86-64 fits it"
    return ""


def object_name(module: wp.Module, block_dim: int | None, ending: str) -> str:
    """The name of an object: the hash of its module, and what follows the name in Warp's cache."""
    return f"{module.get_module_hash(block_dim).hex()}{ending}"


def meta_name(module: wp.Module, block_dim: int | None) -> str:
    """The name of what Warp knows of the kernels of a module."""
    return object_name(module, block_dim, ".meta")


def write_index(folder: Path, hashes: dict[str, list[Any]]) -> None:
    """Write the index of the files in a folder, with hashes of modules.

    Raises:
        ValueError: If the hashes are of stale bytecode.
    """
    if not runs_as_written(code := code_of_sources()):
        raise ValueError("Python has run stale bytecode of kernels; remove the folders __pycache__ and begin again")
    files = {path.name: [path.stat().st_size, _digest(path)] for path in sorted(folder.iterdir()) if path.name != INDEX}
    of_hashes = {"sources": digest_of_sources(), "code": code, "hashes": hashes}
    index = {"warp": wp.config.version, "files": files, **of_hashes}
    (folder / INDEX).write_text(json.dumps(index), encoding="utf-8")


def _names(module: wp.Module, device: wp.Device, block_dim: int | None) -> list[tuple[str, int | None]]:
    """Names that an object for a device may have, the best first, and the GPU for which it was compiled."""
    if device.is_cpu:
        name = module._get_compile_output_name(device, block_dim=block_dim)
        ending = name.removeprefix(module.get_module_identifier(block_dim))
        return [(object_name(module, block_dim, ending), None)]
    # a GPU runs code for others of its generation that came before it
    archs = range(device.arch, device.arch // 10 * 10 - 1, -1)
    return [(object_name(module, block_dim, f".sm{arch}.cubin"), arch) for arch in archs]


@cache
def _index() -> dict[str, Any]:
    try:
        index: dict[str, Any] = json.loads((FOLDER / INDEX).read_text(encoding="utf-8"))
        return index if {"warp", "files"} <= index.keys() else {}
    except (OSError, ValueError):
        return {}


def _files() -> dict[str, list[Any]]:
    """Length and checksum of each file, of this Warp."""
    index = _index()
    return index["files"] if index.get("warp") == wp.config.version else {}


def _is_whole(path: Path) -> bool:
    length, digest = _files().get(path.name, (-1, ""))
    try:
        return path.stat().st_size == length and _digest(path) == digest
    except OSError:
        return False


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
