"""Compile the C++ program of an emulated module with the compiler of the machine, once for all runs."""

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import warp as wp
from helpers import clock

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

    Warp's are copies, as the folder outlives the environment in which it was made: `builtin.h` with the branches for
    CUDA (of atomics, fmin, block_dim) as those of EMULATED_CUDA_ARCH, and `crt.h` without the system's `assert`, which
    would end the process.
    """
    own = sorted([*_FOLDER.glob("*.h"), *_FOLDER.glob("*.cpp")])
    builtin = (_NATIVE / "builtin.h").read_text(encoding="utf-8").replace("__CUDA_ARCH__", "EMULATED_CUDA_ARCH")
    # the atomic sum of float64: a function of CUDA, not an instruction
    builtin = builtin.replace("#elif defined(__clang__)  // CUDA compiled by Clang", "#elif 1")
    changed = {"builtin.h": builtin}
    changed["crt.h"] = (_NATIVE / "crt.h").read_text(encoding="utf-8").replace("#include <assert.h>", "")
    flags = flags_for(is_sanitized)
    texts = [*changed.values(), *(path.read_text("utf-8") for path in own)]
    name = _hash_of(*texts, wp.__version__, _version(), *flags)
    folder = cache_folder() / f"device_{name}"
    with _made_once(folder) as made:
        if made:
            _make_device(made, own, changed, flags, is_sanitized)
    return folder


def _make_device(made: Path, own: list[Path], changed: dict[str, str], flags: list[str], is_sanitized: bool) -> None:
    """Fill the folder of the device."""
    shutil.copytree(_NATIVE, made, dirs_exist_ok=True)
    for header, text in changed.items():
        (made / header).write_text(text, encoding="utf-8")
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


@clock.stands_still
def build(name: str, write: Callable[[], str], is_sanitized: bool = False, is_watched: bool = False) -> Path:
    """The library of a C++ program that includes the device, which finds races of a program that it watches.

    Args:
        name: Stands for all that the source depends on.
        write: Returns the source; called if there is no library of that name yet.
        is_sanitized: Whether it is compiled with AddressSanitizer.
        is_watched: Whether the device is told of every access to memory.

    Raises:
        RuntimeError: If it does not compile.
    """
    device = device_folder(is_sanitized)
    watched = _WATCHED if is_watched and not is_sanitized else []
    folder = cache_folder() / _hash_of(name, device.name, *watched)
    with _made_once(folder) as made:
        if made:
            (made / "program.cpp").write_text(write(), encoding="utf-8")
            _run([str(compiler()), *flags_for(is_sanitized), *watched, "-I", str(device), "-c", "program.cpp"], made)
            of_link = [*_LINKED, *(_SANITIZED if is_sanitized else [])]
            _run([str(compiler()), *_FLAGS, *of_link, "program.o", str(device / "device.so"), "-o", "program.so"], made)
            (made / "program.o").unlink()
            (made / "program.cpp").unlink()
    return folder / "program.so"


@contextmanager
def _made_once(folder: Path) -> Iterator[Path | None]:
    """A folder to be filled in place of one that is not there, which other processes wait for; None if it is there."""
    if folder.exists():
        yield None
        return
    import fcntl

    cache_folder().mkdir(parents=True, exist_ok=True)
    with open(f"{folder}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if folder.exists():
            yield None
            return
        made = Path(tempfile.mkdtemp(dir=cache_folder()))
        yield made
        made.rename(folder)


def _run(command: list[str], folder: Path) -> None:
    """Run the compiler in a folder; it takes twice as long with the sanitizer that the process itself has loaded."""
    environment = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment)
    if result.returncode:
        raise RuntimeError(f"{' '.join(command)} failed in {folder}:\n{result.stderr[:4000]}")
