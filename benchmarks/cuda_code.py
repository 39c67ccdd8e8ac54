"""What the CUDA compilers make of every kernel, counted without a GPU.

    python -m ccd_warp.benchmarks.cuda_code --output DIR [--modules WORD ...] [--compare OLD.json]

Warp compiles each module to PTX, which takes no GPU, and ``ptxas`` assembles it. The table has, for each kernel, the
registers of a thread, its stack and spills in bytes, and the instructions of PTX and, where ``nvdisasm`` is found, of
the machine, those of the functions that it calls included. The tools are found on the PATH, or in the packages of
``pip install -e '.[cuda-tools]'``; PTX of Warp needs tools as new as its own compiler.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import warp as wp
from ccd_warp.benchmarks.cuda_figures import count
from ccd_warp.benchmarks.cuda_modules import cuda_modules
from ccd_warp.benchmarks.numbers import table

# Name of a figure, and what stands above its column.
FIGURES = {
    "registers": "registers",
    "stack": "stack, bytes",
    "spill_stores": "spill stores, bytes",
    "spill_loads": "spill loads, bytes",
    "ptx": "PTX instructions",
    "ptx_own": "without functions called",
    "sass": "SASS instructions",
    "wide_loads": "128-bit loads",
    "warps": "warps a multiprocessor",
}
_EXTRA = "pip install -e '.[cuda-tools]'"


def find_tool(name: str) -> Path | None:
    """The newest of the tools of this name: that on the PATH, and those of the CUDA packages of this Python."""
    found = [Path(path)] if (path := shutil.which(name)) else []
    packages = importlib.util.find_spec("nvidia")
    for folder in packages.submodule_search_locations or [] if packages else []:
        found += sorted(Path(folder).glob(f"*/bin/{name}"))
    return max(found, key=_release, default=None)


def _release(tool: Path) -> tuple[int, ...]:
    """The release of a tool, as it says itself."""
    said = subprocess.run([tool, "--version"], capture_output=True, text=True).stdout
    release = re.search(r"release (\d+)\.(\d+)", said)
    return tuple(map(int, release.groups())) if release else ()


def require_ptxas() -> Path:
    """The assembler.

    Raises:
        ValueError: If there is none.
    """
    tool = find_tool("ptxas")
    if tool is None:
        raise ValueError(f"ptxas was not found on the PATH or among the packages of this Python; install it: {_EXTRA}")
    return tool


def compile_to_ptx(module: Any, arch: int, folder: Path) -> str:
    """The PTX of a module; a module that has not changed since the last call with this folder is not compiled again."""
    path = next(iter(wp.compile_aot_module(module, device=None, arch=arch, module_dir=folder, use_ptx=True)))
    return Path(path).read_text().rstrip("\0")


def assemble(ptxas: Path, ptx: str, arch: int, cubin: Path) -> str:
    """Assemble PTX, and return what ``ptxas -v`` says.

    Raises:
        ValueError: If it fails, as it does where it is older than the compiler of Warp.
    """
    source = cubin.with_suffix(".ptx")
    source.write_text(ptx)
    done = subprocess.run([ptxas, "-v", f"-arch=sm_{arch}", source, "-o", cubin], capture_output=True, text=True)
    if done.returncode != 0:
        reason = " ".join(done.stderr.split("\n")[0].split())
        raise ValueError(f"{ptxas} did not assemble {source.name}: {reason}; newer tools: {_EXTRA}")
    return done.stderr


def measure(folder: Path, arch: int, words: Iterable[str] | None = None) -> dict[str, dict[str, int]]:
    """The figures of every kernel, by module and name, of the modules whose name contains one of the words."""
    ptxas, nvdisasm = require_ptxas(), find_tool("nvdisasm")
    wp.config.log_level = wp.LOG_ERROR
    modules = cuda_modules(with_distances=True)
    chosen = [name for name in modules if not words or any(word in name for word in words)]
    if not chosen:
        raise ValueError(f"--modules: no module has one of {list(words or [])} in its name; there are {list(modules)}")
    folder.mkdir(parents=True, exist_ok=True)

    def figures_of(name: str, ptx: str) -> dict[str, dict[str, int]]:
        cubin = folder / f"{name.replace(' ', '_')}.cubin"
        said = assemble(ptxas, ptx, arch, cubin)
        shown = None
        if nvdisasm is not None:
            shown = subprocess.run([nvdisasm, "-c", cubin], capture_output=True, text=True, check=True).stdout
        return {f"{name}: {kernel}": row for kernel, row in count(ptx, said, shown).items()}

    with ThreadPoolExecutor(1) as pool:  # one module is assembled while the next one is compiled
        pending = []
        for number, name in enumerate(chosen):
            print(f"\r{number + 1} of {len(chosen)}: {name:50}", end="", file=sys.stderr, flush=True)
            ptx = compile_to_ptx(modules[name], arch, folder / "modules" / name.replace(" ", "_"))
            pending.append(pool.submit(figures_of, name, ptx))
        found = [each.result() for each in pending]
    print(f"\r{'':70}\r", end="", file=sys.stderr)
    return {name: row for part in found for name, row in part.items()}


def as_table(rows: Mapping[str, Mapping[str, int]], before: Mapping[str, Mapping[str, int]] | None = None) -> str:
    """The figures as a table of Markdown, beside those from before where they differ."""

    def cell(name: str, figure: str) -> str:
        old, new = (of.get(name, {}).get(figure) for of in (before or {}, rows))
        text = "–" if new is None else f"{new:,}"
        return text if old is None or old == new else f"{old:,} → {text}"

    names = [*rows, *(name for name in before or {} if name not in rows)]
    lines = table(
        ["kernel", *FIGURES.values()], [[name, *(cell(name, figure) for figure in FIGURES)] for name in names]
    )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Count, print and write.

    Returns:
        0; 1 with a message if a tool is missing or fails.
    """
    parser = argparse.ArgumentParser(prog="python -m ccd_warp.benchmarks.cuda_code", description=__doc__)
    parser.add_argument(
        "--output", metavar="DIR", type=Path, default=Path("ccd_warp_cuda_code"), help="folder to write"
    )
    parser.add_argument("--arch", metavar="N", type=int, default=90, help="compute capability, as 80 or 90 (90)")
    parser.add_argument("--modules", metavar="WORD", nargs="+", help="only modules with one of these in their name")
    parser.add_argument("--compare", metavar="OLD.json", type=Path, help="figures to show beside the new ones")
    given = parser.parse_args(arguments)
    try:
        before = json.loads(given.compare.read_text())["kernels"] if given.compare else None
        rows = measure(given.output, given.arch, given.modules)
    except (OSError, KeyError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if before is not None and given.modules:
        before = {name: row for name, row in before.items() if any(word in name for word in given.modules)}
    text = as_table(rows, before)
    facts = {
        "arch": f"sm_{given.arch}",
        "warp": wp.config.version,
        "ptxas": ".".join(map(str, _release(require_ptxas()))),
    }
    (given.output / "cuda_code.json").write_text(json.dumps({**facts, "kernels": rows}, indent=1) + "\n")
    (given.output / "cuda_code.md").write_text(text + "\n")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
