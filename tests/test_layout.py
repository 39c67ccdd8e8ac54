"""The modules as layers: no import circle, and the kernels know nothing of the package above them."""

import ast
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import warp as wp
from planted import table
from warp._src import context

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
# Folders in the tree, and what they are called once installed.
PACKAGES = {"ccd_warp": "ccd_warp", "kernels": "ccd_warp.kernels"}
# The folders from the bottom; those of one line know nothing of each other, but that gradients know bodies that turn.
RINGS = [
    {"kernels"},
    {"_runtime"},
    {"_scene"},
    {"_results"},
    {"_engine"},
    {"_at_one_time", "_rigid", "viz", "_files"},
    {"_gradients"},
    {"_calls"},
    {"", "jax", "torch", "_cli", "distributed"},  # the public names, and who uses the calls
    {"__main__"},
]

# Tests that are there for no fault of the package: what holds of whatever is drawn, of pages and programs, of oracles
# and planted faults themselves, of the emulated device, of the layout, of runs of the tests and of data that they read.
WITHOUT_A_FAULT = ("laws/", "docs/", "examples/", "oracle/", "planted/", "emulated/", "test_layout.py")
WITHOUT_A_FAULT += ("test_package.py", "runtime/test_runs.py", "files/test_public_data.py")


def sources() -> dict[str, tuple[str, bool]]:
    """The source of every module of the packages by its installed name, and whether it is a package."""
    found = {}
    for folder, package in PACKAGES.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            name = ".".join([package, *(part for part in parts if part != "__init__")])
            found[name] = (path.read_text("utf-8"), path.name == "__init__.py")
    return found


def imported_names(module: str, source: str, is_package: bool) -> set[str]:
    """All that a module imports, at its top, within functions and for type checkers: `from a import b` as a.b."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = module.split(".")[: len(module.split(".")) - node.level + is_package] if node.level else []
            names |= {".".join([*above, *filter(None, [node.module]), alias.name]) for alias in node.names}
    return names


def import_graph(modules: dict[str, tuple[str, bool]]) -> dict[str, set[str]]:
    """For each module those of ours that it imports, or of which it imports a name."""

    def target_of(name: str) -> str | None:
        while name not in modules and "." in name:
            name = name.rpartition(".")[0]
        return name if name in modules else None

    found = {m: {target_of(name) for name in imported_names(m, *modules[m])} for m in modules}
    return {module: targets - {None, module} for module, targets in found.items()}


def folder_of(module: str) -> str:
    """The folder of a module within the package, or its name where it stands at the top."""
    return f"{module}.".split(".")[1]


def test_imports_make_no_circle_and_go_from_a_ring_to_those_below_it():
    graph = import_graph(sources())
    TopologicalSorter(graph).prepare()  # an error that names the modules of a circle
    ring = {folder: k for k, folders in enumerate(RINGS) for folder in folders}
    pairs = {(folder_of(m), folder_of(t)): set() for m, targets in graph.items() for t in targets}
    for module, targets in graph.items():
        for target in targets:
            pairs[folder_of(module), folder_of(target)].add(target.rpartition(".")[2])
    assert {folder for pair in pairs for folder in pair} == set(ring)
    wrong = {(a, b): names for (a, b), names in pairs.items() if a != b and ring[a] <= ring[b]}
    assert not wrong


def test_kernels_import_nothing_of_the_package_above_them():
    for module, (source, is_package) in sources().items():
        if f"{module}.".startswith("ccd_warp.kernels."):
            ours = {name for name in imported_names(module, source, is_package) if f"{name}.".startswith("ccd_warp.")}
            assert all(name.startswith("ccd_warp.kernels.") for name in ours), f"{module} imports {sorted(ours)}"


def test_three_modules_use_private_names_of_warp_which_this_version_has():
    using = {name for name, (source, _) in sources().items() if re.search(r"\b(?:wp|warp)\._src\b", source)}
    assert using == {f"ccd_warp._runtime.{name}" for name in ("quiet", "shared_header", "tape")}
    wp.init()
    assert hasattr(context.runtime, "get_clang_pch_dir") and hasattr(context.runtime, "tape")
    assert hasattr(context, "_get_cpu_toolchain_version")


def test_benchmarks_find_what_they_take_of_the_tests():
    """With the folders of `benchmarks/checkout.py` alone, and without the packages that they need themselves."""
    text = "\n".join(path.read_text("utf-8") for path in (ROOT / "benchmarks").glob("*.py"))
    own = {path.stem for path in (ROOT / "benchmarks").glob("*.py")}
    taken = {name for name in re.findall(r"^(?:from|import) (\w+)", text, re.M)} - own
    taken &= {path.stem for path in (TESTS / "helpers").glob("*.py")}
    program = f"import sys; sys.path[:0] = [{str(ROOT / 'benchmarks')!r}]; import checkout, {', '.join(sorted(taken))}"
    done = subprocess.run([sys.executable, "-P", "-c", program], capture_output=True, text=True)
    assert len(taken) > 3 and not done.stderr, done.stderr


def test_no_property_that_stays_has_a_lock():
    """That of `functools.cached_property` of Python 3.11 stays locked in a process forked meanwhile."""
    using = {name for name, (source, _) in sources().items() if "import cached_property" in source}
    assert not using


def test_no_test_imports_another():
    """What two of them need stands in a module of its own: scenes, oracles, launches, and the like."""
    for path in TESTS.rglob("*.py"):
        names = imported_names(path.stem, path.read_text("utf-8"), False)
        assert not [name for name in names if re.search(r"(^|\.)test_\w+", name)], path.name


def test_every_file_of_tests_has_to_find_a_planted_fault():
    """A new one names a fault, in `planted`, that no law finds, or stands among those that are there for none."""
    files = {path.relative_to(TESTS).as_posix() for path in TESTS.rglob("test_*.py")}
    finders = {test.partition("::")[0] for fault in table.PLANTED for test in table.tests_of(fault)}
    assert not {file for file in files - finders if not file.startswith(WITHOUT_A_FAULT)}
    assert not {name for name in WITHOUT_A_FAULT if not any(file.startswith(name) for file in files)}
