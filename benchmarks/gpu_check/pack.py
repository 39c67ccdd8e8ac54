"""What a machine without Warp and without a network needs, in parts that can be carried: ``gpu_check pack --out DIR``.

Two archives: the packages that others made, which stay the same, and the check itself: this package, its tests and
examples, cubins, and the CPU's answers. ``DIR/parts`` holds them with ``unpack.py``, which needs Python alone.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.metadata
import lzma
import os
import platform
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import ccd_warp.benchmarks
import ccd_warp.kernels
from ccd_warp.benchmarks.gpu_check import bits, precompile, unpack
from ccd_warp.benchmarks.gpu_check.journal import read_json, write_json

import ccd_warp

# What package and check require and a machine with a GPU may lack; NumPy is there wherever PyTorch, JAX or CuPy is.
PYTEST = ("pytest", "iniconfig", "packaging", "pluggy", "pygments")
PACKAGES = ("warp-lang", "trimesh", *PYTEST)
_NEEDS = ("numpy",)
_LEAST = 1 << 16  # bytes of a part
_BLOCK = 32 << 20  # bytes that a thread compresses at a time
_PRESET = 6  # of xz
_UNITS = {"K": 1 << 10, "M": 1 << 20, "G": 1 << 30}
_SCRIPT = """#!/bin/sh
# Runs the check from what lies beside this file; further options are those of gpu_check.
here=$(cd "$(dirname "$0")" && pwd)
for name in tests examples; do
    [ -d "$here/$name" ] && set -- "--$name" "$here/$name" "$@"
done
PYTHONPATH="$here/site${PYTHONPATH:+:$PYTHONPATH}" exec "${PYTHON:-python3}" -P -m ccd_warp.benchmarks.gpu_check \\
    --precompiled "$here/cubins" --answers "$here/answers.json" "$@"
"""

Files = list[tuple[str, Path]]


def size_of(text: str) -> int:
    """Bytes, as 56M or 1000000.

    Raises:
        ValueError: If it is no size, or too small for a part.
    """
    number, unit = (text[:-1], text[-1]) if text[-1:].upper() in _UNITS else (text, "")
    if not number.isdigit() or int(number) * _UNITS.get(unit.upper(), 1) < _LEAST:
        raise ValueError(f"limit is {text!r}; expected a number of bytes of at least {_LEAST}, as 56M")
    return int(number) * _UNITS.get(unit.upper(), 1)


def files_in(folder: Path, name: str) -> Files:
    """The files of a folder, with the names that they get below ``name``, in order."""
    found = (path for path in sorted(folder.rglob("*")) if path.is_file() and "__pycache__" not in path.parts)
    return [(f"{name}/{path.relative_to(folder).as_posix()}", path) for path in found]


def files_of_package(name: str) -> Files:
    """The files of an installed package.

    Raises:
        ValueError: If it is not installed.
    """
    try:
        listed = importlib.metadata.files(name) or []
    except importlib.metadata.PackageNotFoundError:
        raise ValueError(f"packages holds {name!r}, which is not installed; expected a package that is") from None
    found = ((each.as_posix(), Path(str(each.locate()))) for each in listed)
    return sorted((f"site/{n}", p) for n, p in found if not n.startswith("..") and p.is_file() and p.suffix != ".pyc")


def files_of_check(folder: Path, tests: Path | None, examples: Path | None) -> Files:
    """This package, as it is when it is installed, with what the check uses, some of which lies in a folder."""
    files: Files = []
    for package in (ccd_warp, ccd_warp.kernels, ccd_warp.benchmarks):
        files += files_in(Path(package.__path__[0]), "site/" + package.__name__.replace(".", "/"))
    for name, place in (("tests", tests), ("examples", examples)):
        files += [] if place is None else files_in(place, name)
    cubins = folder / "cubins"  # where those of older code may be, too
    for module in {Path(file).parent for file in read_json(cubins / precompile.MANIFEST)["files"]}:
        files += files_in(cubins / module, f"cubins/{module.as_posix()}")
    files.append((f"cubins/{precompile.MANIFEST}", cubins / precompile.MANIFEST))
    files = [(name, path) for name, path in files if "/results/" not in name]  # of benchmarks, which it does not read
    return [*dict(files).items(), ("answers.json", folder / "answers.json"), ("gpu_check.sh", folder / "gpu_check.sh")]


def compressed(files: Files) -> Iterator[bytes]:
    """An archive of files, as streams of xz, one for each block, which several threads make at a time."""
    reading, writing = os.pipe()

    def write() -> None:
        with os.fdopen(writing, "wb") as pipe, tarfile.open(fileobj=pipe, mode="w|") as archive:
            for name, path in files:
                archive.add(path, name)

    workers = os.cpu_count() or 1
    with ThreadPoolExecutor(workers + 1) as pool, os.fdopen(reading, "rb") as pipe:
        written = pool.submit(write)
        pending = []
        while block := pipe.read(_BLOCK):
            pending.append(pool.submit(lzma.compress, block, preset=_PRESET))
            if len(pending) > workers:
                yield pending.pop(0).result()
        yield from (each.result() for each in pending)
        written.result()


def divide(streams: Iterable[bytes], folder: Path, name: str, limit: int) -> list[dict]:
    """Write streams into files of at most a number of bytes, and return what the manifest says of them."""
    for old in folder.glob(f"{name}.*"):
        old.unlink()
    parts: list[dict] = []
    rest = b""

    def put(data: bytes) -> None:
        path = folder / f"{name}.{len(parts):02d}"
        path.write_bytes(data)
        parts.append({"name": path.name, "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()})

    for stream in streams:
        rest += stream
        while len(rest) > limit:
            put(rest[:limit])
            rest = rest[limit:]
    put(rest)
    return parts


def pack(
    folder: Path, limit: int, packages: Iterable[str], tests: Path | None, examples: Path | None
) -> dict[str, list[dict]]:
    """Write the parts; the folder has cubins and answers. Returns the manifest's archives."""
    (folder / "gpu_check.sh").write_text(_SCRIPT, encoding="utf-8")
    parts = folder / "parts"
    parts.mkdir(exist_ok=True)
    others = {name: importlib.metadata.version(name) for name in packages}
    before = read_json(parts / unpack.MANIFEST) or {}
    kept = [parts / each["name"] for each in before.get("archives", {}).get("packages", [])]
    if before.get("packages") == others and all(path.is_file() for path in kept):  # compressing Warp takes minutes
        streams: Iterable[bytes] = [path.read_bytes() for path in kept]
    else:
        streams = compressed([file for name in packages for file in files_of_package(name)])
    archives = {"packages": divide(streams, parts, "packages", limit)}
    archives["check"] = divide(compressed(files_of_check(folder, tests, examples)), parts, "check", limit)
    manifest = {"machine": platform.machine(), "needs": _NEEDS, "packages": others, "archives": archives}
    write_json(parts / unpack.MANIFEST, manifest)
    shutil.copyfile(unpack.__file__, parts / "unpack.py")
    return archives


def main(arguments: list[str]) -> int:
    """The command ``pack``; returns its exit status."""
    parser = argparse.ArgumentParser(prog="python -m ccd_warp.benchmarks.gpu_check pack", description=__doc__)
    root = Path.cwd()
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder; what it has already is kept")
    parser.add_argument("--limit", metavar="BYTES", default="56M", help="of a part (56M)")
    parser.add_argument("--arch", metavar="N", type=int, nargs="+", default=[90], help="GPUs of the cubins (90)")
    parser.add_argument("--packages", metavar="NAME", nargs="+", default=PACKAGES, help=f"({' '.join(PACKAGES)})")
    parser.add_argument("--tests", metavar="DIR", type=Path, default=root / "tests", help="folder of the tests")
    parser.add_argument("--examples", metavar="DIR", type=Path, default=root / "examples", help="of the examples")
    given = parser.parse_args(arguments)
    try:
        limit = size_of(given.limit)
        for name in given.packages:
            files_of_package(name)
        folders = [place if place.is_dir() else None for place in (given.tests, given.examples)]
        given.out.mkdir(parents=True, exist_ok=True)
        command = [
            sys.executable,
            "-P",
            "-m",
            "ccd_warp.benchmarks.gpu_check",
            "--precompile",
            str(given.out / "cubins"),
        ]
        subprocess.run([*command, "--arch", *map(str, given.arch)], check=True)
        answers = given.out / "answers.json"
        try:
            bits.read_answers(answers)
        except ValueError:
            bits.write_answers(answers)
        print(f"{len(bits.read_answers(answers))} answers of the CPU in {answers}", flush=True)
        archives = pack(given.out, limit, given.packages, *folders)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for part in (part for parts in archives.values() for part in parts):
        print(f"{part['name']}: {part['bytes'] / 2**20:.1f} MiB")
    print(
        f"in {given.out / 'parts'}; there, with {unpack.MANIFEST}: python3 unpack.py --into DIR, "
        f"--collect where the parts come one by one"
    )
    return 0
