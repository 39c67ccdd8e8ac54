"""Compile the C++ program of an emulated module with the compiler of the machine, once for each source."""

import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import warp as wp

_FOLDER = Path(__file__).resolve().parent
_NATIVE = Path(wp.__file__).resolve().parent / "native"
_FLAGS = [
    # fuse_fp is off, so that a product and a sum are rounded one after the other
    *("-std=c++17", "-w", "-fPIC", "-pthread", "-ffp-contract=off"),
    # fmin and fmax are those of the device
    *("-fno-builtin-fmin", "-fno-builtin-fmax", "-fno-builtin-fminf", "-fno-builtin-fmaxf"),
]
_LINKED = ["-shared", "-Wl,-Bsymbolic-functions"]
_OPTIMIZED = ["-O1"]
# a call before every access to memory, which the device answers: the library of the sanitizer is not linked
_WATCHED = ["-fsanitize=thread", "--param", "tsan-instrument-func-entry-exit=0"]
# not optimized, which would take three times as long to compile
_SANITIZED = [
    "-O0",
    "-fsanitize=address,alignment",
    "-fno-sanitize-recover=alignment",
    "-fno-omit-frame-pointer",
    "-g1",
]


@cache
def compiler() -> str | None:
    """The C++ compiler: that of the environment variable CXX, or g++; None without one."""
    return shutil.which(os.environ.get("CXX") or "g++")


def sanitizer_library() -> str:
    """The library that a process has to load first if programs are compiled with AddressSanitizer."""
    command = [str(compiler()), "-print-file-name=libasan.so"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def cache_folder() -> Path:
    """Where programs and headers stay from one run to the next."""
    return Path(wp.config.kernel_cache_dir, "ccd_warp_emulated")


def flags_for(is_sanitized: bool) -> list[str]:
    """Options of the compiler."""
    return _FLAGS + (_SANITIZED if is_sanitized else _OPTIMIZED)


def _hash_of(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:16]


@cache
def _version() -> str:
    return subprocess.run([str(compiler()), "--version"], capture_output=True, text=True, check=True).stdout


@cache
def device_folder(is_sanitized: bool = False) -> Path:
    """A folder with the compiled device, `device.so`, and the headers of it and of Warp, parsed once.

    Warp's are links, but for copies: of `builtin.h`, in which the branches for CUDA (of atomics, fmin, block_dim) are
    those of EMULATED_CUDA_ARCH, and of `crt.h` without the system's `assert`, which would end the process.
    """
    own = sorted([*_FOLDER.glob("*.h"), *_FOLDER.glob("*.cpp")])
    builtin = (_NATIVE / "builtin.h").read_text(encoding="utf-8").replace("__CUDA_ARCH__", "EMULATED_CUDA_ARCH")
    # the atomic sum of float64: a function of CUDA, not an instruction
    builtin = builtin.replace("#elif defined(__clang__)  // CUDA compiled by Clang", "#elif 1")
    copies = {"builtin.h": builtin}
    copies["crt.h"] = (_NATIVE / "crt.h").read_text(encoding="utf-8").replace("#include <assert.h>", "")
    flags = flags_for(is_sanitized)
    texts = [*copies.values(), *(path.read_text() for path in own)]
    name = _hash_of(*texts, wp.__version__, str(_NATIVE), _version(), *flags)
    folder = cache_folder() / f"device_{name}"
    if folder.exists():
        return folder
    cache_folder().mkdir(parents=True, exist_ok=True)
    made = Path(tempfile.mkdtemp(dir=cache_folder()))
    for path in _NATIVE.iterdir():
        if path.name not in copies:
            (made / path.name).symlink_to(path)
    for copied, text in copies.items():
        (made / copied).write_text(text, encoding="utf-8")
    for path in own:
        shutil.copy(path, made)
    (made / "device.h.gch").mkdir()  # of its headers the compiler takes the one with its own options
    for parsed, watched in (("plain", []), ("watched", [] if is_sanitized else _WATCHED)):
        parse = [*flags, *watched, "-x", "c++-header", "device.h", "-o", f"device.h.gch/{parsed}"]
        _run([str(compiler()), *parse], made)
    # switches stacks, of which the sanitizer is told, and is not instrumented itself
    told = ["-DEMULATED_IS_SANITIZED"] if is_sanitized else []
    fast = ["-O2", "-ftls-model=initial-exec"]  # as accesses are answered there
    _run([str(compiler()), *_FLAGS, *_LINKED, *fast, *told, "grid.cpp", "-o", "device.so"], made)
    _move(made, folder)
    return folder


def build(source: str, is_sanitized: bool = False, is_watched: bool = False) -> Path:
    """The library of a C++ program that includes the device, which finds races of a program that it watches.

    Raises:
        RuntimeError: If it does not compile.
    """
    device = device_folder(is_sanitized)
    watched = _WATCHED if is_watched and not is_sanitized else []
    library = cache_folder() / f"{_hash_of(source, device.name, *watched)}.so"
    if not library.exists():
        made = Path(tempfile.mkdtemp(dir=cache_folder()))
        (made / "program.cpp").write_text(source, encoding="utf-8")
        _run([str(compiler()), *flags_for(is_sanitized), *watched, "-I", str(device), "-c", "program.cpp"], made)
        of_link = [*_LINKED, *(_SANITIZED if is_sanitized else [])]
        _run([str(compiler()), *_FLAGS, *of_link, "program.o", str(device / "device.so"), "-o", "program.so"], made)
        _move(made / "program.so", library)
        shutil.rmtree(made)
    return library


def _run(command: list[str], folder: Path) -> None:
    """Run the compiler in a folder; it takes twice as long with the sanitizer that the process itself has loaded."""
    environment = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment)
    if result.returncode:
        raise RuntimeError(f"{' '.join(command)} failed in {folder}:\n{result.stderr[:4000]}")


def _move(made: Path, final: Path) -> None:
    """Put what was made in its place, unless another process was faster."""
    try:
        made.rename(final)
    except OSError:
        shutil.rmtree(made, ignore_errors=True)
