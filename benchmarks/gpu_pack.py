"""The tests and all that they need, in parts that can be carried to a machine with a GPU and without a network.

    python benchmarks/gpu_pack.py --out packed [--arch 90] [--limit 56] [--packages newton ...]

and there, with Python of the same version and processor: ``python3 packed/unpack.py check && sh check/run.sh``. Packed
are this checkout, the wheels of what the tests use, and every kernel compiled for the GPU, which takes none.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import warp as wp

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests" / "helpers"))
from cuda_modules import cuda_modules  # noqa: E402

PACKAGES = (f"warp-lang=={wp.config.version}", "trimesh", "numpy", "pytest", "pytest-xdist", "hypothesis")
RUN = """#!/bin/sh
# The tests on the GPU; further options are those of pytest, or: sh run.sh times [OPTION …]
cd "$(dirname "$0")" && export PYTHONPATH="$PWD/site:$PWD" CCD_WARP_CUBINS="$PWD/cubins"
if [ "$1" = times ]; then shift && exec "${PYTHON:-python3}" benchmarks/gpu_times.py "$@"; fi
exec "${PYTHON:-python3}" -m pytest --device cuda:0 -n 4 --junitxml=gpu.xml -o faulthandler_timeout=120 "$@"
"""
UNPACK = '''"""Puts together the parts that lie beside this file: python3 unpack.py DIR."""
import hashlib, json, platform, sys, zipfile
from pathlib import Path

here, into = Path(__file__).resolve().parent, Path(sys.argv[1])
said = json.loads((here / "parts.json").read_text())
if [platform.machine(), *sys.version_info[:2]] != said["of"]:
    sys.exit(f"error: this is {platform.machine()}, Python {platform.python_version()}; expected {said['of']}")
into.mkdir(parents=True, exist_ok=True)
with (into / "all.zip").open("wb") as file:
    for name, digest in said["parts"].items():
        data = (here / name).read_bytes() if (here / name).is_file() else b""
        if hashlib.sha256(data).hexdigest() != digest:
            sys.exit(f"error: {name} is {'damaged' if data else 'missing'}; expected it in {here}")
        file.write(data)
with zipfile.ZipFile(into / "all.zip") as archive:
    archive.extractall(into)
(into / "all.zip").unlink()
print(f"unpacked; sh {into / 'run.sh'} runs the tests on the GPU, sh {into / 'run.sh'} times measures it")
'''


def compile_for(archs: list[int], folder: Path) -> None:
    """Compile every module for GPUs, as cubins under the names that Warp looks for; what is there is kept."""
    wp.config.kernel_cache_dir, wp.config.cuda_output = str(folder), "cubin"
    wp.init()

    def compile_one(arch: int, name: str, module: object) -> None:
        block_dim = module.options["block_dim"]
        module.get_module_hash(block_dim)
        options = module.resolve_options(wp.config, block_dim=block_dim)
        if module._compile(None, output_arch=arch, use_ptx=False, options=options):
            print(f"{name}, sm_{arch}", flush=True)

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        modules = cuda_modules(with_distances=True).items()
        orders = [pool.submit(compile_one, arch, *each) for arch in archs for each in modules]
    for order in orders:
        order.result()


def pack(out: Path, packages: list[str], limit: int) -> list[str]:
    """Write the parts, each of at most so many bytes; returns their names."""
    shutil.rmtree(out / "wheels", ignore_errors=True)
    command = [sys.executable, "-m", "pip", "download", "--only-binary", ":all:", "--dest", str(out / "wheels")]
    subprocess.run([*command, *packages], check=True)
    with zipfile.ZipFile(out / "all.zip", "w", zipfile.ZIP_LZMA) as archive:
        for wheel in sorted((out / "wheels").glob("*.whl")):
            with zipfile.ZipFile(wheel) as inside:
                for name in inside.namelist():
                    archive.writestr(f"site/{name}", inside.read(name))
        tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in tracked.splitlines():
            archive.write(ROOT / name, name)
        for path in sorted((out / "cubins").rglob("*.*")):
            if path.is_file() and path.suffix != ".cu":
                archive.write(path, path.relative_to(out))
        archive.writestr("run.sh", RUN)
    parts = {}
    with (out / "all.zip").open("rb") as file:
        while data := file.read(limit):
            name = f"part.{len(parts):02d}"
            (out / name).write_bytes(data)
            parts[name] = hashlib.sha256(data).hexdigest()
    (out / "all.zip").unlink()
    of = [platform.machine(), *sys.version_info[:2]]
    (out / "parts.json").write_text(json.dumps({"of": of, "parts": parts}))
    (out / "unpack.py").write_text(UNPACK)
    return list(parts)


def main() -> None:
    """Compile, download and pack."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder; what is compiled there already is kept")
    parser.add_argument("--arch", type=int, nargs="*", default=[90], help="GPUs of the kernels (90); none without")
    parser.add_argument("--packages", nargs="+", default=[], help="beside those of the tests, as newton or torch")
    parser.add_argument("--limit", type=float, default=56.0, help="MiB of a part (56)")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    compile_for(given.arch, given.out / "cubins")
    print(*pack(given.out, [*PACKAGES, *given.packages], int(given.limit * 2**20)), f"in {given.out}")


if __name__ == "__main__":
    main()
