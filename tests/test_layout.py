"""The modules as layers: no import circle, few levels, and the kernels know nothing of the package above them."""

import ast
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import warp as wp
from warp._src import context
from warp._src.logger import LoggerBasic, get_logger

ROOT = Path(__file__).resolve().parent.parent
# Folders in the tree, and what they are called once installed.
PACKAGES = {"ccd_warp": "ccd_warp", "kernels": "ccd_warp.kernels"}

# Modules in the longest chain of imports below those that only name what is public, and run it.
MOST_LEVELS, MOST_LEVELS_OF_ALL = 10, 15
SURFACE = ("ccd_warp", "ccd_warp.__main__", "ccd_warp.distributed")


def module_files() -> dict[str, Path]:
    """Every module of the packages by its installed name."""
    files = {}
    for folder, package in PACKAGES.items():
        for path in sorted((ROOT / folder).rglob("*.py")):
            parts = path.relative_to(ROOT / folder).with_suffix("").parts
            files[".".join([package, *(part for part in parts if part != "__init__")])] = path
    return files


def imported_names(module: str, source: str, is_package: bool, is_at_import: bool = False) -> set[str]:
    """All that a module imports, with full names: at its top, within functions, and for type checkers alone.

    With ``is_at_import`` what a function imports when it is called is left out.

    `from a import b` may import the module a.b or the name b of the module a, and is given as a.b.
    """
    names = set()
    tree = ast.parse(source)
    for node in tree.body if is_at_import else ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = module.split(".")[: len(module.split(".")) - node.level + is_package] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            names |= {f"{base}.{alias.name}" for alias in node.names}
    return names


def target_of(name: str, modules: set[str]) -> str | None:
    """The module of ours that an imported name is, or belongs to."""
    while name not in modules and "." in name:
        name = name.rpartition(".")[0]
    return name if name in modules else None


def import_graph(sources: dict[str, tuple[str, bool]], is_at_import: bool = False) -> dict[str, set[str]]:
    """For each module those of ours that it imports, of sources with a mark for packages."""
    modules = set(sources)
    found = {m: {target_of(name, modules) for name in imported_names(m, *sources[m], is_at_import)} for m in modules}
    return {module: targets - {None, module} for module, targets in found.items()}


@cache
def graph(is_at_import: bool = False) -> dict[str, set[str]]:
    sources = {name: (path.read_text("utf-8"), path.name == "__init__.py") for name, path in module_files().items()}
    return import_graph(sources, is_at_import)


def circle(graph: dict[str, set[str]], left_out=frozenset()) -> list[str]:
    """A circle of imports, or an empty list."""
    kept = {module: {t for t in targets if (module, t) not in left_out} for module, targets in graph.items()}
    try:
        TopologicalSorter(kept).prepare()
    except CycleError as error:
        return error.args[1][::-1]
    return []


def longest_chain(graph: dict[str, set[str]], left_out=frozenset()) -> list[str]:
    """Modules of which each imports the next, as many as there are."""
    chains: dict[str, list[str]] = {}
    kept = {module: {t for t in targets if (module, t) not in left_out} for module, targets in graph.items()}
    for module in TopologicalSorter(kept).static_order():
        chains[module] = [module, *max((chains[t] for t in sorted(kept[module])), key=len, default=[])]
    return max(chains.values(), key=len)


def test_no_circle_of_imports():
    found = circle(graph())
    assert not found, " imports ".join(found)


def test_the_longest_chain_of_imports_has_ten_levels_and_of_all_fifteen():
    left_out = {(top, target) for top in SURFACE for target in graph()[top]}
    chain = longest_chain(graph(is_at_import=True), left_out)
    assert len(chain) <= MOST_LEVELS, " imports ".join(chain)
    chain = longest_chain(graph(), left_out)  # those in functions, too
    assert len(chain) <= MOST_LEVELS_OF_ALL, " imports ".join(chain)


# From the bottom; what is not named here is above them all.
LAYERS = [
    ["kernels"],
    ["_runtime", "_status", "_version", "_display", "_quiet", "_texts", "_read_only", "_rotations"]
    + ["_placed", "_toi_gradient"],
    ["_input", "_half_space"],
    ["_mesh", "_replicate", "_results", "_contacts", "_contact_place", "_distinct", "_pairs"]
    + [
        "_intersections",
        "_proximities",
        "_device_results",
        "_device_pairs",
        "_motion",
        "_affine_motion",
        "_joint_bounds",
        "_joint_courses",
        "_joint_motion",
        "_joint_paths",
        "_joint_sweeps",
        "_joints",
        "_body_paths",
        "_body_sweeps",
        "_mesh_paths",
        "_toi_slopes",
        "_touch",
        "_turn_gradient",
    ],
    ["_engine", "_files"],
]


def layer_of(module: str) -> int:
    part = f"{module}.".split(".")[1]
    return next((k for k, parts in enumerate(LAYERS) if part in parts), len(LAYERS))


def test_no_module_imports_from_a_layer_above_it():
    found = [f"{m} imports {t}" for m, targets in graph().items() for t in targets if layer_of(t) > layer_of(m)]
    assert not found
    parts = {f"{module}.".split(".")[1] for module in graph()}
    assert {part for layer in LAYERS for part in layer} <= parts


def test_kernels_import_nothing_of_the_package_above_them():
    kernels = PACKAGES["kernels"]
    for module, path in module_files().items():
        if f"{module}.".startswith(f"{kernels}."):
            names = imported_names(module, path.read_text("utf-8"), path.name == "__init__.py")
            above = {name for name in names if f"{name}.".startswith("ccd_warp.")}
            assert all(name.startswith(f"{kernels}.") for name in above), f"{module} imports {sorted(above)}"


def test_three_modules_use_private_names_of_warp_which_this_version_has():
    files = module_files().items()
    using = {name for name, path in files if re.search(r"\b(?:wp|warp)\._src\b", path.read_text(encoding="utf-8"))}
    assert using == {f"ccd_warp.{name}" for name in ("_quiet", "_runtime.shared_header", "_runtime.tape")}
    wp.init()
    assert hasattr(context.runtime, "get_clang_pch_dir") and hasattr(context.runtime, "tape")
    assert isinstance(LoggerBasic, type) and callable(get_logger)


def test_every_form_of_import_is_seen():
    found = import_graph(
        {
            "ccd_warp": ("from ccd_warp._a import f", True),
            "ccd_warp._a": ("import numpy\nfrom ccd_warp import _b\nimport ccd_warp._f", False),
            "ccd_warp._b": ("def f():\n    from ._c import g", False),
            "ccd_warp._c": ("if TYPE_CHECKING:\n    from ccd_warp._d._e import G", False),
            "ccd_warp._d": ("from . import _e\nfrom .. import _a", True),
            "ccd_warp._d._e": ("from ccd_warp import h", False),
            "ccd_warp._f": ("", False),
        }
    )
    assert found == {
        "ccd_warp": {"ccd_warp._a"},
        "ccd_warp._a": {"ccd_warp._b", "ccd_warp._f"},
        "ccd_warp._b": {"ccd_warp._c"},
        "ccd_warp._c": {"ccd_warp._d._e"},
        "ccd_warp._d": {"ccd_warp._d._e", "ccd_warp._a"},
        "ccd_warp._d._e": {"ccd_warp"},
        "ccd_warp._f": set(),
    }
    assert circle(found) and not circle(found, {("ccd_warp._d._e", "ccd_warp"), ("ccd_warp._d", "ccd_warp._a")})
    assert len(longest_chain(found, {("ccd_warp._d._e", "ccd_warp"), ("ccd_warp._d", "ccd_warp._a")})) == 5


def test_no_test_imports_another():
    """What two of them need stands in a module of its own: scenes, oracles, launches, and the like."""
    for path in Path(__file__).parent.rglob("*.py"):
        names = imported_names(path.stem, path.read_text("utf-8"), False)
        assert not [name for name in names if name.startswith("test_")], path.name
