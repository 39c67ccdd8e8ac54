"""Compile the C++ program of an emulated module with the compiler of the machine, once for each source."""

import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import warp as wp

_HEADERS = Path(__file__).resolve().parent
_NATIVE = Path(wp.__file__).resolve().parent / "native"
_FLAGS = [
    # fuse_fp is off, so that a product and a sum are rounded one after the other
    *("-std=c++17", "-O1", "-w", "-fPIC", "-shared", "-pthread", "-ffp-contract=off"),
    # fmin and fmax are those of the device
    *("-fno-builtin-fmin", "-fno-builtin-fmax", "-fno-builtin-fminf", "-fno-builtin-fmaxf", "-Wl,-Bsymbolic-functions"),
]
_SANITIZERS = ["-fsanitize=address,alignment", "-fno-sanitize-recover=alignment", "-fno-omit-frame-pointer", "-g1"]


@cache
def compiler() -> str | None:
    """The C++ compiler: that of the environment variable CXX, or g++; None without one."""
    return shutil.which(os.environ.get("CXX") or "g++")


def cache_folder() -> Path:
    """Where programs and headers stay from one run to the next."""
    return Path(wp.config.kernel_cache_dir, "ccd_warp_emulated")


def flags_for(is_sanitized: bool) -> list[str]:
    """Options of the compiler."""
    return _FLAGS + (_SANITIZERS if is_sanitized else [])


def _hash_of(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:16]


@cache
def _version() -> str:
    return subprocess.run([str(compiler()), "--version"], capture_output=True, text=True, check=True).stdout


@cache
def header_folder(is_sanitized: bool = False) -> Path:
    """A folder with the headers of the device and of Warp, parsed once.

    Warp's are links, but for a copy of `builtin.h` in which the branches for CUDA (of atomics, fmin, block_dim) are those
    of EMULATED_CUDA_ARCH.
    """
    own = sorted(_HEADERS.glob("*.h"))
    builtin = (_NATIVE / "builtin.h").read_text(encoding="utf-8").replace("__CUDA_ARCH__", "EMULATED_CUDA_ARCH")
    # the atomic sum of float64: a function of CUDA, not an instruction
    builtin = builtin.replace("#elif defined(__clang__)  // CUDA compiled by Clang", "#elif 1")
    flags = flags_for(is_sanitized)
    name = _hash_of(builtin, wp.__version__, str(_NATIVE), _version(), *flags, *(path.read_text() for path in own))
    folder = cache_folder() / f"headers_{name}"
    if folder.exists():
        return folder
    cache_folder().mkdir(parents=True, exist_ok=True)
    made = Path(tempfile.mkdtemp(dir=cache_folder()))
    for path in _NATIVE.iterdir():
        if path.name != "builtin.h":
            (made / path.name).symlink_to(path)
    (made / "builtin.h").write_text(builtin, encoding="utf-8")
    for path in own:
        shutil.copy(path, made)
    _run([str(compiler()), *flags, "-x", "c++-header", "device.h", "-o", "device.h.gch"], made)
    _move(made, folder)
    return folder


def build(source: str, is_sanitized: bool = False) -> Path:
    """The library of a C++ program that includes the device.

    Raises:
        RuntimeError: If it does not compile.
    """
    headers = header_folder(is_sanitized)
    library = cache_folder() / f"{_hash_of(source, headers.name)}.so"
    if not library.exists():
        made = Path(tempfile.mkdtemp(dir=cache_folder()))
        (made / "program.cpp").write_text(source, encoding="utf-8")
        command = [str(compiler()), *flags_for(is_sanitized), "-I", str(headers), "program.cpp", "-o", "program.so"]
        _run(command, made)
        _move(made / "program.so", library)
        shutil.rmtree(made)
    return library


def _run(command: list[str], folder: Path) -> None:
    """Run the compiler in a folder."""
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if result.returncode:
        raise RuntimeError(f"{' '.join(command)} failed in {folder}:\n{result.stderr[:4000]}")


def _move(made: Path, final: Path) -> None:
    """Put what was made in its place, unless another process was faster."""
    try:
        made.rename(final)
    except OSError:
        shutil.rmtree(made, ignore_errors=True)
