"""Mechanical mutants, for a night: `python tests/planted/mutants.py [COUNT [SEED]]` says which no test finds.

With `--under kernels _rigid` these are those of such folders, with `--part 2/3` every third of them, from the second
on. In a copy one operator, constant, bound, condition or call of any file of the package is changed. A mutant that
survives need not be a fault: a bound may be wider than it need be, and a search may take longer. Each has to be read:
for a fault a law is widened, a feature is added to the drawn scenes, or a row to a table.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])

from planted import of_each_file, of_host  # noqa: E402
from planted.planting import ROOT, Copy  # noqa: E402

# The tests of a folder of the package, after those of its file; what is not here has a folder of tests of its name.
_LAWS = ("laws/test_searches.py", "laws/test_truth.py", "laws")
_TESTS = {
    "kernels/gradients": ("laws/test_gradients.py", "calls/test_on_tape.py"),
    "kernels/rigid": ("laws/test_bodies_that_turn.py",),
    "_at_one_time": ("kernels/at_one_time", "laws/test_other_ways.py"),
    "_gradients": ("laws/test_gradients.py", "calls/test_on_tape.py", "calls/test_frameworks.py"),
    "_results": ("calls", "laws/test_searches.py"),
    "_rigid": ("calls/test_rigid.py", "input", "laws/test_bodies_that_turn.py", "calls", "engine"),
    "_runtime": ("calls/test_texts.py", "input/test_options.py", "runtime", "cli"),
    "_scene": ("input",),
    "": ("calls/test_frameworks.py", "input", "calls"),  # the public names
}
# Folders of which no law of answers knows more than their own tests.
_WITHOUT_LAWS = ("_cli", "_files", "_runtime", "viz", "distributed")
# After which a mutant is one to be read.
_MOST_SECONDS = 120.0
_MARKS = "not long and not emulated"
_SWAPS = {ast.Lt: ast.LtE, ast.Gt: ast.GtE, ast.Eq: ast.NotEq, ast.Add: ast.Sub, ast.Mult: ast.Div, ast.And: ast.Or}
_SWAPS |= {ast.Is: ast.IsNot, ast.In: ast.NotIn}
_SWAPS |= {new: old for old, new in _SWAPS.items()}
_NAMES = {"min": "max", "minimum": "maximum", "any": "all"}
_NAMES |= {new: old for old, new in _NAMES.items()}


def change(node: ast.AST) -> bool:
    """Change a node in its place; whether there is something to change."""
    if isinstance(node, (ast.BinOp, ast.BoolOp)) and type(node.op) in _SWAPS:
        node.op = _SWAPS[type(node.op)]()
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in _SWAPS:
        node.ops[0] = _SWAPS[type(node.ops[0])]()
    elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
        node.test = ast.UnaryOp(ast.Not(), node.test)
    elif isinstance(node, ast.Constant) and type(node.value) is bool:
        node.value = not node.value
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        node.value = node.value + 1 if type(node.value) is int else 2.0 * node.value + 1e-3
    elif isinstance(node, ast.Attribute) and node.attr in _NAMES:
        node.attr = _NAMES[node.attr]
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        node.value = ast.Constant(None)
    else:
        return False
    return True


def folder_of(file: str) -> str:
    """The folder of a file: that of the kernels with the one below it, or the one within the package."""
    parts = Path(file).parts[:-1]
    return "/".join(parts[:2]) if parts[0] == "kernels" else "".join(parts[1:2])


def mutants(count: int, seed: int = 0) -> list[tuple[str, int, str, str]]:
    """Mutants of all folders, by their numbers of lines: file, line, what is changed, and the whole source changed."""
    rng, lines, places = random.Random(seed), Counter(), defaultdict(list)
    for path in sorted(path for top in ("kernels", "ccd_warp") for path in (ROOT / top).rglob("*.py")):
        file, source = str(path.relative_to(ROOT)), path.read_text(encoding="utf-8")
        tree = ast.parse(source)
        notes = [getattr(node, name, None) for node in ast.walk(tree) for name in ("annotation", "returns")]
        unneeded = {id(part) for note in notes if note is not None for part in ast.walk(note)}
        nodes = enumerate(ast.walk(tree))
        places[folder_of(file)] += [(file, k) for k, node in nodes if id(node) not in unneeded and change(node)]
        lines[folder_of(file)] += source.count("\n")
    # a folder is drawn by its lines, and a place in it
    folders = rng.choices(list(lines), list(lines.values()), k=count)
    chosen = dict.fromkeys(rng.choice(places[folder]) for folder in folders)
    found = []
    for file, k in chosen:
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        node = list(ast.walk(tree))[k]
        before = ast.unparse(node).splitlines()[0]
        change(node)
        words = f"{before[:60]} -> {ast.unparse(node).splitlines()[0][:60]}"
        found.append((file, getattr(node, "lineno", 0), words, ast.unparse(tree)))
    return found


def tests_of(file: str) -> list[str]:
    """The tests that may find a mutant of a file, those first that are most likely to."""
    path, folder, tests = Path(file), folder_of(file), ROOT / "tests"
    words = {path.stem.strip("_"), f"{path.stem}s", path.parent.name.strip("_")}
    found = [str(test.relative_to(tests)) for test in sorted(tests.rglob("test_*.py")) if test.stem[5:] in words]
    of_cpu = [*of_host.PLANTED, *of_each_file.PLANTED]
    found += [finder.partition("::")[0] for fault in of_cpu if fault.file == file for finder in fault.finders]
    found += _TESTS.get(folder, (folder.strip("_"),))
    found += [] if folder in _WITHOUT_LAWS else [*_LAWS[:-1], "input", "calls", "engine", *_LAWS]
    return [test for test in dict.fromkeys(found) if (tests / test).exists() and "emulated" not in test]


def passes_without(copy: Copy, found: str, passing: set[str]) -> bool:
    """Whether a test that found a mutant passes in a copy that has none; one of each file is asked."""
    file, _, test = found.partition(" - ")[0].partition("::")
    if test and file not in passing:
        path = next((ROOT / "tests").rglob(file)).relative_to(ROOT / "tests")
        if copy.failing_test([f"{path}::{test.partition('[')[0]}"], _MARKS):
            return False
        passing.add(file)
    return True


def main(count: int, seed: int, part: str, under: list[str]) -> None:
    """Plant each mutant of the part, and print its line and the test that finds it; at the end those to be read."""
    first, every = map(int, part.split("/"))
    wanted = [mutant for mutant in mutants(count, seed) if folder_of(mutant[0]).startswith(tuple(under))]
    chosen, to_read, passing = wanted[first - 1 :: every], [], set()
    with tempfile.TemporaryDirectory() as folder:
        # what has been compiled, in a folder of its own: a mutant may damage it, or name what it keeps falsely
        compiled = os.environ.get("WARP_CACHE_PATH") or Path.home() / ".cache" / "warp"
        os.environ["WARP_CACHE_PATH"] = f"{folder}/cache"
        if Path(compiled).is_dir():
            shutil.copytree(compiled, f"{folder}/cache")
        copy = Copy(Path(folder))
        copy.is_planted = True
        for file, line, change_made, source in chosen:
            path, original = copy.path_of(file), (ROOT / file).read_text(encoding="utf-8")
            path.write_text(source, encoding="utf-8")
            try:
                found = copy.failing_test(tests_of(file), _MARKS, _MOST_SECONDS) or "SURVIVES"
            except subprocess.TimeoutExpired:
                found = f"NOT FOUND in {_MOST_SECONDS:.0f} s"
            except RuntimeError as error:  # the tests could not be run
                found = str(error).splitlines()[0]
            path.write_text(original, encoding="utf-8")
            if not passes_without(copy, found, passing):
                sys.exit(f"without a mutant: {found}")
            print(answer := f"{file}:{line}: {change_made}: {found}", flush=True)
            to_read += [answer] * found.startswith(("SURVIVES", "NOT FOUND"))
    print(f"{len(chosen) - len(to_read)} of {len(chosen)} found; to be read:", *sorted(to_read), sep="\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=200)
    parser.add_argument("seed", type=int, nargs="?", default=0)
    parser.add_argument("--under", nargs="+", default=[""], help="the begins of folders whose mutants are wanted")
    parser.add_argument("--part", default="1/1", help="K/N: every N-th of the mutants, from the K-th on")
    main(**vars(parser.parse_args()))
