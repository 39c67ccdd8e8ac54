"""What the CUDA compiler makes of every kernel: registers, stack, instructions, and how often a step launches it.

    python benchmarks/cuda_code.py [--arch 90] [--modules WORD ...] [--compare OLD.csv] [--output cuda_code.csv]

It needs no GPU: modules are compiled to the code that runs there (that of gpu_pack.py is used), `cuobjdump` and
`nvdisasm` read it (`pip install -e '.[test,cuda-tools]'`), and launches are counted on the emulated device. Stack
is what the driver reserves for each thread that could be resident: docs/cuda.md says how much that is.
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import shutil
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pandas as pd
import raw
import warp as wp
from checkout import RESULTS, ROOT
from gpu_pack import compile_for
from texts import table_of

sys.path.append(str(ROOT / "tests"))  # where the emulated device is
from scenes import cloth_over_sphere

import ccd_warp as ccd
from ccd_warp._runtime.every_module import every_module

REGISTERS = 65_536  # of a multiprocessor; a warp of 32 threads takes them by eights a thread, and 64 warps fit


def tool(name: str) -> str:
    """A program of the CUDA toolkit, of the PATH or of the packages of this Python."""
    packages = importlib.util.find_spec("nvidia")
    folders = packages.submodule_search_locations or [] if packages else []
    found = [shutil.which(name), *(str(path) for folder in folders for path in Path(folder).glob(f"*/bin/{name}"))]
    if not any(found):
        raise SystemExit(f"error: {name} was not found; pip install -e '.[cuda-tools]'")
    return next(filter(None, found))


def code_of(name: str, cubin: Path) -> list[dict]:
    """A row for each kernel of a module; instructions include those of functions that it calls."""
    used, code = (
        subprocess.run([tool(program), option, cubin], capture_output=True, text=True, check=True).stdout
        for program, option in (("cuobjdump", "-res-usage"), ("nvdisasm", "-c"))
    )
    sections = dict(re.findall(r"^//-+ \.text\.(\S+) -+$(.*?)(?=^//-{10}|\Z)", code, flags=re.MULTILINE | re.DOTALL))
    rows = []
    for kernel, registers, stack, shared in re.findall(r"Function (\S+):\s+REG:(\d+) STACK:(\d+) SHARED:(\d+)", used):
        short, code_hash = re.fullmatch(r"(?:.*__)?(\w+)_([0-9a-f]{8})_cuda_kernel_forward", kernel).groups()
        row: dict = {"module": name, "kernel": short, "hash": code_hash}
        row |= {"registers": int(registers), "stack": int(stack), "shared": int(shared)}
        row["instructions"] = len(re.findall(r"^\s+/\*[0-9a-f]{4,}\*/", sections[kernel], flags=re.MULTILINE))
        row["warps"] = min(64, REGISTERS // (32 * 8 * -(-int(registers) // 8)))
        rows.append(row)
    return rows


def launches(broad_phase: str) -> Counter[tuple[str, str]]:
    """How often a launch of a scene starts each kernel, by the names of its module and its own."""
    from emulated.device import SHARED, emulation

    scene = cloth_over_sphere(400)
    with emulation():
        pipeline = ccd.CollisionPipeline(scene.mesh(ccd), broad_phase=broad_phase)
        ends = [wp.array(x, dtype=wp.vec3d) for x in (scene.vertices_t0, scene.vertices_t1)]
        pipeline.launch(*ends)
        SHARED.launches.clear()
        pipeline.launch(*ends)
    found: Counter[tuple[str, str]] = Counter()
    for (module, key), count in SHARED.launches.items():
        found[module, key.split("__")[-1]] += count
    return found


def main() -> None:
    """Count, compile, read, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arch", type=int, default=90, help="GPU (90)")
    parser.add_argument("--cubins", type=Path, default=Path("packed"), help="folder of gpu_pack.py (packed)")
    parser.add_argument("--modules", nargs="+", default=[""], help="only those with one of these words in their names")
    parser.add_argument("--compare", type=Path, help="an earlier output: figures that differ stand as before → now")
    parser.add_argument("--output", type=Path, default=Path("cuda_code.csv"))
    given = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    launched = {name: launches(name) for name in ("tree", "hash")}  # before compile_for() takes another cache
    compile_for([given.arch], given.cubins.resolve() / "cubins")
    chosen = {name: m for name, m in every_module(None).items() if any(w in name for w in given.modules)}
    folder = Path(wp.config.kernel_cache_dir)
    cubins = {
        name: next(folder.glob(f"{m.get_module_identifier(m.options['block_dim'])}/*sm{given.arch}.cubin"))
        for name, m in chosen.items()
    }
    with ThreadPoolExecutor() as pool:
        rows = [row for part in pool.map(code_of, cubins, cubins.values()) for row in part]
    for row in rows:
        row |= {f"launches, {way}": of[chosen[row["module"]].name, row["kernel"]] for way, of in launched.items()}
    table = pd.DataFrame(rows).sort_values(["stack", "registers", "module"], ascending=False)
    table.to_csv(given.output, index=False)
    if given.output.parent.resolve() == RESULTS:
        raw.note(RESULTS, "cuda_code")
    shown = table.drop(columns="hash").astype(str)
    if given.compare:
        keys = ["module", "kernel"]
        earlier = pd.read_csv(given.compare, dtype=str)[shown.columns]
        before = shown[keys].merge(earlier, how="left", on=keys).fillna("–").set_index(shown.index)
        shown = before.where(shown == before, before + " → " + shown)
    print("\n".join(table_of(shown)))
    print("launches: " + ", ".join(f"{sum(of.values())} with a {way}" for way, of in launched.items()))


if __name__ == "__main__":
    main()
