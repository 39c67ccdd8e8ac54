"""The CUDA side of every kernel compiles to PTX without a GPU, holds no fused multiply-add, and has one name.

The modules are compiled by processes of their own, one a core: `python tests/kernels/test_cuda.py --compile NAME …`.
"""

import argparse
import hashlib
import os
import re
import subprocess
import sys
import tempfile
from functools import cache
from itertools import product
from pathlib import Path

sys.path += [str(Path(__file__).resolve().parents[1] / folder) for folder in ("", "helpers")]

import ccd_warp.kernels
import pytest
import warp as wp
from ccd_warp.kernels.search.search_types import BOXES, CULL, LIST
from helpers import clock
from kept import kept
from programs import begun

from ccd_warp._runtime.every_module import every_module
from ccd_warp._runtime.lanes import search_on

ARCH = 80
# Modules whose loads are looked at.
LOADING = ["search_trees list False", "search_trees boxes False", "half_warp_tree"]


def test_every_file_with_kernels_is_covered():
    modules = [module for width in (None, 1) for module in every_module(width).values()]
    covered = {kernel.func.__code__.co_filename for module in modules for kernel in module.kernels.values()}
    for path in Path(ccd_warp.kernels.__path__[0]).resolve().rglob("*.py"):
        assert "@wp.kernel" not in path.read_text(encoding="utf-8") or str(path) in covered


@pytest.mark.parametrize("walk", ["search_trees", "search_hashes"])
def test_every_search_that_a_scene_may_ask_for_is_listed(walk):
    modules = every_module(None).values()
    for end, with_lists, is_thick in product((BOXES, LIST, CULL), (False, True), (False, True)):
        assert search_on(None, walk, end, with_lists, is_cuda=True, is_thick=is_thick).module in modules


@cache
def sources():
    """Those of all kernels, of which the hashes of modules are made, slowly."""
    return [path.read_text(encoding="utf-8") for path in sorted(Path(ccd_warp.kernels.__path__[0]).rglob("*.py"))]


def _hash_of(name):
    """As it is without the flags with which this process may have loaded the module on the CPU."""
    module = every_module(None)[name]
    flags, module.options["cpu_compiler_flags"] = module.options["cpu_compiler_flags"], None
    module.mark_modified()
    try:
        return f"{module.name} {module.get_module_hash(module.options['block_dim']).hex()}"
    finally:
        module.options["cpu_compiler_flags"] = flags
        module.mark_modified()


hash_of = kept(_hash_of, sys.modules[__name__], question_of=lambda name: [name, wp.__version__, sources()])


def place_of(name):
    """The folder for the PTX of a module, which stays from one run to the next, named by all that it is made of."""
    wp.init()  # which says where kernels are kept
    made_of = f"{hash_of(name)} {ARCH} {optimization_level(name)}"
    return Path(wp.config.kernel_cache_dir, "ccd_warp_ptx", hashlib.sha256(made_of.encode()).hexdigest()[:16])


@pytest.fixture(scope="module")
@clock.stands_still
def output(request):
    """What the processes said that compiled the PTX of every module asked for."""
    chosen = [item.callspec.params for item in request.session.items if hasattr(item, "callspec")]
    asked = {*(params["name"] for params in chosen if params.get("name") in NAMES), *LOADING}
    wanted = sorted(name for name in asked if not place_of(name).exists())
    count = min(os.cpu_count() or 1, 8)
    command = [sys.executable, __file__, "--compile"]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    processes = [subprocess.Popen([*command, *names], **options) for k in range(count) if (names := wanted[k::count])]
    return "".join(process.communicate()[0] for process in processes)


# Of the searches for radii, which all run emulated, those that take the distances of pairs each in another way.
_OF_RADII = ["candidate_cull thick", "search_trees boxes False thick"]
NAMES = [name for name in every_module(None) if not name.endswith("thick") or name in _OF_RADII]


def _ptx(name, output):
    paths = list(place_of(name).glob("*.ptx"))
    assert len(paths) == 1, output
    return paths[0].read_text("utf-8")


@pytest.mark.emulated
@pytest.mark.parametrize("name", NAMES)
def test_compiles_to_ptx(name, output):
    ptx = _ptx(name, output)
    for kernel in every_module(None)[name].kernels.values():
        assert kernel.key.split(".")[-1].split("__")[-1] in ptx
    # fuse_fp is off: no bound relies on it, but contraction would make CPU and CUDA differ. Where it is on, the
    # compiler fuses, or leaves operations without a rounding of their own for the driver to fuse.
    assert not re.search(r"\b(fma\.rn|(add|sub|mul))\.f(32|64)", ptx)


@pytest.mark.emulated
@pytest.mark.parametrize(("end", "number"), [("list", 12), ("boxes", 6)])
def test_a_search_loads_a_box_without_a_branch_and_keeps_its_way_in_registers(end, number, output):
    """All numbers of a box are on their way before the first is needed: at the top, at inner blocks, at leaves."""
    ptx = _ptx(f"search_trees {end} False", output)
    stretches = re.split(r"\bbra\b|^\$L", ptx, flags=re.MULTILINE)
    assert sum(len(re.findall(r"\bld\.global\S*32\b", stretch)) >= number for stretch in stretches) >= 3
    assert ".local" not in ptx
    assert "vote.sync.ballot" in ptx and "shfl.sync.idx" in ptx


@pytest.mark.emulated
def test_boxes_are_loaded_four_numbers_at_a_time(output):
    assert len(re.findall(r"\bld\.global\S*\.v4\.", _ptx("half_warp_tree", output))) >= 6


NAMES_OF_MODULES = """
import warp as wp

wp.config.log_level = wp.LOG_ERROR
from ccd_warp._runtime.every_module import every_module

wp.init()
modules = {name: module for name, module in every_module(None).items() if "float64" in name}


def names():
    for module in modules.values():
        module.hashers.clear()
    return {name: module.get_module_identifier() for name, module in modules.items()}


before = names()
for name, module in modules.items():
    if "points_toi first" in name:
        module._run_codegen(module.resolve_options(wp.config) | {"output_arch": 90}, False)
after = names()
print(*(name for name in modules if before[name] != after[name]), sep=", ")
"""


@pytest.mark.emulated
def test_what_was_built_before_does_not_change_the_name_of_a_module(tmp_path):
    """Else a second run would compile modules again that the first has compiled under other names.

    Warp takes a local variable of a function for a constant of that name, as its own number ``e``, until it has built
    the function once.
    """
    status, shown, error = begun(tmp_path, "-P", "-c", NAMES_OF_MODULES)
    assert (status, shown.strip()) == (0, ""), error


def optimization_level(name):
    """That of a user, but for the modules that take five times as long than with one level less."""
    return 2 if name.startswith("queued_pairs") else 3


def main():
    import fcntl

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--compile", nargs="+", metavar="NAME", required=True)
    wp.config.log_level = wp.LOG_ERROR
    modules = every_module(None)
    for name in parser.parse_args().compile:
        place = place_of(name)
        place.parent.mkdir(parents=True, exist_ok=True)
        with open(f"{place}.lock", "w") as lock, tempfile.TemporaryDirectory(dir=place.parent) as made:
            fcntl.flock(lock, fcntl.LOCK_EX)  # of the processes of `pytest -n`, which all ask for it, one compiles it
            if not place.exists():
                modules[name].options["optimization_level"] = optimization_level(name)
                modules[name].mark_modified()
                wp.compile_aot_module(modules[name], device=None, arch=ARCH, module_dir=f"{made}/ptx", use_ptx=True)
                os.rename(f"{made}/ptx", place)


if __name__ == "__main__":
    main()
