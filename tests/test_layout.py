"""The modules as layers: no import circle, and the kernels know nothing of the package above them."""

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import warp as wp
from warp._src import context
from warp._src.logger import LoggerBasic, get_logger

ROOT = Path(__file__).resolve().parent.parent
# Folders in the tree, and what they are called once installed.
PACKAGES = {"ccd_warp": "ccd_warp", "kernels": "ccd_warp.kernels"}
# What is read, written or checked below the engine, from the bottom; a part that is not named is above them.
LAYERS = [["kernels"], ["_runtime", "_status", "_version"], ["_input"], ["_mesh", "_results"], ["_engine", "_files"]]


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


def test_imports_make_no_circle_and_go_from_a_layer_to_those_below_it():
    def layer_of(module: str) -> int:
        part = f"{module}.".split(".")[1]
        return next((k for k, parts in enumerate(LAYERS) if part in parts), len(LAYERS))

    graph = import_graph(sources())
    TopologicalSorter(graph).prepare()  # an error that names the modules of a circle
    pairs = [(module, target) for module, targets in graph.items() for target in targets]
    assert [pair for pair in pairs if layer_of(pair[0]) < layer_of(pair[1]) < len(LAYERS)] == []
    calls = ("ccd_warp._cli", "ccd_warp.distributed", "ccd_warp.viz", "ccd_warp._pipeline")
    assert [(m, t) for m, t in pairs if layer_of(m) < len(LAYERS) and (t == "ccd_warp" or t.startswith(calls))] == []
    assert {layer_of(module) for module in graph} == set(range(len(LAYERS) + 1))


def test_kernels_import_nothing_of_the_package_above_them():
    for module, (source, is_package) in sources().items():
        if f"{module}.".startswith("ccd_warp.kernels."):
            ours = {name for name in imported_names(module, source, is_package) if f"{name}.".startswith("ccd_warp.")}
            assert all(name.startswith("ccd_warp.kernels.") for name in ours), f"{module} imports {sorted(ours)}"


def test_three_modules_use_private_names_of_warp_which_this_version_has():
    using = {name for name, (source, _) in sources().items() if re.search(r"\b(?:wp|warp)\._src\b", source)}
    assert using == {f"ccd_warp.{name}" for name in ("_quiet", "_runtime.shared_header", "_runtime.tape")}
    wp.init()
    assert hasattr(context.runtime, "get_clang_pch_dir") and hasattr(context.runtime, "tape")
    assert isinstance(LoggerBasic, type) and callable(get_logger)


def test_no_test_imports_another():
    """What two of them need stands in a module of its own: scenes, oracles, launches, and the like."""
    for path in Path(__file__).parent.rglob("*.py"):
        names = re.findall(r"^\s*(?:from|import) (test_\w+)", path.read_text("utf-8"), flags=re.MULTILINE)
        assert not names, path.name
