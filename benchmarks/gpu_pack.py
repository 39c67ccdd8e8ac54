"""What a machine with a GPU and without a network lacks for the tests, in parts that can be carried there.

    python benchmarks/gpu_pack.py --out packed [--arch 90] [--limit 45] [--python 3.12] [--packages newton ...]

Packed are every kernel compiled for the GPU, which takes none, and packages; not the checkout. There, in the root of a
checkout, with all files of the folder: ``python3 packed/unpack.py /tmp/day && sh /tmp/day/run.sh``. It needs ``xz``.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import math
import platform
import struct
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import warp as wp

from ccd_warp._runtime.beforehand import compile_modules
from ccd_warp._runtime.every_module import every_module

PACKAGES = (f"warp-lang=={wp.config.version}", "trimesh", "python-flint")  # beside NumPy, pytest, xdist, hypothesis
LEFT_OUT = ("warp/tests/", "warp/examples/", "trimesh/resources/models/")
RUN = """# In the root of a checkout: tests on the GPU, counters, times; with files in the folder $OUT.
# `tests`, `races`, `counters` or `times` as the first argument: one of these, and the other arguments are its options.
here="$(cd "$(dirname "$0")" && pwd)" what="${1:-all}" python="${PYTHON:-python3}" out="${OUT:-.}" status=0
[ $# = 0 ] || shift
export PYTHONPATH="$here/site:$PWD" WARP_CACHE_PATH="$here/cache" CCD_WARP_CUBINS="$here/cache"
export XLA_PYTHON_CLIENT_PREALLOCATE=false
chosen() { [ "$what" = all ] || [ "$what" = "$1" ]; }
has() { command -v "$1" > /dev/null || { echo "$1 is not here, and is left out"; false; }; }
# Not the tests of the checkout itself, of programs and of pages, nor those that end processes.
chosen tests && { timeout -s INT -k 20 270 "$python" -m pytest --device cuda:0 -n 12 -q --tb=short \\
    -o faulthandler_timeout=60 --junitxml="$out/gpu.xml" --ignore=tests/laws/test_again_after_failure.py \\
    tests/laws tests/engine tests/kernels tests/calls tests/input "$@" || status=1; }
chosen races && has compute-sanitizer && for tool in racecheck synccheck; do
    timeout -k 5 35 compute-sanitizer --error-exitcode 9 --tool $tool "$python" -m pytest --device cuda:0 \\
        -p no:xdist -q --tb=short tests/laws -k kinds "$@" > "$out/$tool.txt" 2>&1 || status=1
    tail -3 "$out/$tool.txt"
done
[ ! -d "$here/published" ] || published="--published $here/published"
chosen counters && has ncu && { timeout -k 5 90 ncu --clock-control none --profile-from-start off --csv \\
    --log-file "$out/ncu.csv" --metrics METRICS \\
    "$python" benchmarks/gpu_times.py --only counters --output "$out/counted.json" "$@" || status=1; }
chosen times && { timeout -k 5 200 "$python" benchmarks/gpu_times.py $published --minutes 3 \\
    --output "$out/gpu_times.json" "$@" || status=1; }
exit $status
"""
# What is asked of Nsight Compute: time, occupancy, instructions, bytes, why warps wait; `max` over `avg` of the cycles
# is the tail of a launch, and `no_instruction` the fetch of code.
_STALLS = [f"stalled_{reason}" for reason in ("long_scoreboard", "no_instruction", "wait", "math_pipe_throttle")]
METRICS = (
    *("gpu__time_duration.sum", "launch__registers_per_thread", "sm__cycles_active.avg", "sm__cycles_active.max"),
    *("sm__warps_active.avg.pct_of_peak_sustained_active", "smsp__issue_active.avg.pct_of_peak_sustained_active"),
    *("smsp__inst_executed.sum", "sm__inst_executed_pipe_fp64.avg.pct_of_peak_sustained_active"),
    *("dram__bytes.sum", "lts__t_bytes.sum"),
    *(f"smsp__average_warps_issue_{reason}_per_issue_active.ratio" for reason in _STALLS),
)
UNPACK = """# Puts together the parts that lie beside this file: python3 unpack.py DIR
import hashlib, io, lzma, platform, sys, tarfile
from pathlib import Path

here, into, data = Path(__file__).resolve().parent, Path(sys.argv[1]), b""
if [platform.machine(), *sys.version_info[:2]] != OF:
    sys.exit(f"error: this is {platform.machine()}, Python {platform.python_version()}; expected {OF}")
for name, digest in PARTS.items():
    part = (here / name).read_bytes() if (here / name).is_file() else b""
    if hashlib.sha256(part).hexdigest() != digest:
        sys.exit(f"error: {name} is {'damaged' if part else 'missing'}; expected it in {here}")
    data += part
with lzma.open(io.BytesIO(data)) as xz, tarfile.open(fileobj=xz, mode="r|", ignore_zeros=True) as archive:
    archive.extractall(into, filter="data")
print(f"unpacked; sh {into / 'run.sh'} in the root of a checkout runs the tests on the GPU, and measures it")
"""


def compile_for(archs: list[int], folder: Path) -> list[Path]:
    """The folders of all modules, compiled under the names and hashes that Warp looks for; what is there is kept."""
    wp.init()
    wp.config.kernel_cache_dir, wp.config.cuda_output = str(folder / wp.config.version), "cubin"
    return sorted({path.parent for arch in archs for path in compile_modules(every_module(None), arch).values()})


def code_for_gpus(library: bytes) -> Iterator[tuple[int, int, slice]]:
    """Kind (2 is code, 1 PTX), architecture and place of all that a library of ELF has for GPUs.

    Its section .nv_fatbin is a row of containers (magic, version, size of the header and of the rest), each a row of
    entries (kind, version, sizes of header and data, and from byte 28 on the architecture).
    """
    (table,), (size, count, of_names) = struct.unpack_from("<Q", library, 40), struct.unpack_from("<3H", library, 58)
    sections = [struct.unpack_from("<IIQQQQ", library, table + k * size) for k in range(count)]
    for name, _, _, _, position, length in sections:
        end = position + length if library.startswith(b".nv_fatbin\0", sections[of_names][4] + name) else 0
        while position < end:
            magic, _, header, length = struct.unpack_from("<IHHQ", library, position)
            if magic != 0xBA55ED50:  # of what fills up to a multiple of 8
                position += 8
                continue
            entry, position = position + header, position + header + length
            while entry < position:
                kind, _, header, length, arch = struct.unpack_from("<HHIQ12xI", library, entry)
                yield kind, arch, slice(entry + header, entry + header + length)
                entry += header + length


def for_these_gpus(library: bytes, archs: list[int]) -> bytes:
    """The library with zeros for what runs on other GPUs alone; as it is if it has no code for one of these."""
    data, wanted, code = bytearray(library), {arch // 10 for arch in archs}, list(code_for_gpus(library))
    if wanted <= {arch // 10 for kind, arch, _ in code if kind == 2}:
        for kind, arch, place in code:
            if kind != 2 or arch // 10 not in wanted:
                data[place] = bytes(place.stop - place.start)
    return bytes(data)


def of_packages(packages: list[str], archs: list[int], python: str, folder: Path) -> Iterator[tuple[str, bytes]]:
    """Names and bytes of what wheels of packages hold, without those that they need."""
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary", ":all:"]
    subprocess.run([*command, "--python-version", python, "--dest", str(folder), *packages], check=True)
    for path in sorted(folder.glob("*.whl")):
        with zipfile.ZipFile(path) as wheel:
            for name in wheel.namelist():
                if not name.startswith(LEFT_OUT) and not name.endswith("/"):
                    data = wheel.read(name)
                    yield f"site/{name}", for_these_gpus(data, archs) if name == "warp/bin/warp.so" else data


def of_caches(compiled: list[Path], kept: Path | None, published: Path | None) -> Iterator[tuple[str, bytes]]:
    """Names and bytes of the script, of published steps, of what is compiled, and of what a cache has for the CPU."""
    yield "run.sh", RUN.replace("METRICS", ",".join(METRICS)).encode()
    for path in sorted(published.rglob("frames/*.ply")) if published else ():
        yield f"published/{path.relative_to(published)}", path.read_bytes()
    for path in sorted(path for folder in compiled for path in folder.iterdir() if path.suffix != ".cu"):
        yield f"cache/{path.relative_to(path.parents[2])}", path.read_bytes()
    for path in sorted(kept.rglob("*")) if kept else ():
        of_cpu = path.suffix in (".o", ".meta") and path.parent.name.startswith("wp_ccd_warp")
        if of_cpu or path.parent.name == "ccd_warp_answers":
            yield f"cache/{path.relative_to(kept)}", path.read_bytes()


def compress(path: Path, files: Iterator[tuple[str, bytes]]) -> None:
    """Write an archive, which is there when it is complete."""
    options = ("--format=xz", "--x86", "--lzma2=preset=6,dict=64MiB", "--threads=0", "--block-size=128MiB")
    with path.with_suffix(".new").open("wb") as out, subprocess.Popen(["xz", *options], stdin=-1, stdout=out) as xz:
        with tarfile.open(fileobj=xz.stdin, mode="w|") as archive:
            for name, data in files:
                about = tarfile.TarInfo(name)
                about.size = len(data)
                archive.addfile(about, io.BytesIO(data))
        xz.communicate()
    if xz.returncode:
        raise OSError(f"xz ended with {xz.returncode}")
    path.with_suffix(".new").rename(path)


def main() -> None:
    """Compile, download and pack."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder; what was made there before is kept")
    parser.add_argument("--arch", type=int, nargs="+", default=[90], help="GPUs of the kernels (90)")
    parser.add_argument("--python", default="3.12", help="Python of that machine (3.12)")
    parser.add_argument(
        "--packages", nargs="+", default=[], help="beside those of the tests; what they need is not added"
    )
    parser.add_argument("--limit", type=float, default=45.0, help="MiB of a part (45)")
    parser.add_argument("--kept", type=Path, help="a kernel cache: with what is compiled for the CPU and kept there")
    parser.add_argument("--published", type=Path, help="folder of steps in the public formats")
    given = parser.parse_args()
    out = given.out.resolve()
    compiled = compile_for(given.arch, out / "cubins")
    packages = ([*PACKAGES, *given.packages], given.arch, given.python)
    named = out / hashlib.sha256(str(packages).encode()).hexdigest()[:8]
    if not (site := named.with_suffix(".xz")).exists():
        compress(site, of_packages(*packages, named))
    compress(out / "caches.xz", of_caches(compiled, given.kept, given.published))
    data, parts = site.read_bytes() + (out / "caches.xz").read_bytes(), {}
    size = math.ceil(len(data) / math.ceil(len(data) / (given.limit * 2**20)))
    for old in out.glob("part.*"):
        old.unlink()
    for begin in range(0, len(data), size):
        name, part = f"part.{len(parts)}", data[begin : begin + size]
        (out / name).write_bytes(part)
        parts[name] = hashlib.sha256(part).hexdigest()
    of = [platform.machine(), *map(int, given.python.split("."))]
    (out / "unpack.py").write_text(f"OF, PARTS = {of}, {parts}\n{UNPACK}")
    print(*parts, f"and unpack.py in {given.out}: {len(data) / 2**20:.1f} MiB")


if __name__ == "__main__":
    main()
