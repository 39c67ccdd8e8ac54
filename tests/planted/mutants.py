"""Mechanical mutants, for a night: `python tests/planted/mutants.py [COUNT [SEED]]` says which no test finds, by file.

One operator, constant, bound or condition of the kernels, the engine, the rings above it or the calls is changed in a
copy. A mutant that survives need not be a fault: a bound may be wider than it need be, and a search may take longer.
Each has to be read: for a fault a law is widened, a feature is added to the drawn scenes, or a row to a table.
"""

import ast
import random
import sys
import tempfile
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])

from planted.planting import ROOT, Copy  # noqa: E402

SHARES = {"kernels/**/*.py": 0.4, "ccd_warp/_engine/**/*.py": 0.4}
_RINGS = ("at_one_time", "calls", "gradients", "results", "rigid")
SHARES |= {f"ccd_warp/_{folder}/**/*.py": 0.2 / len(_RINGS) for folder in _RINGS}
_SWAPS = {ast.Lt: ast.LtE, ast.Gt: ast.GtE, ast.Eq: ast.NotEq, ast.Add: ast.Sub, ast.Mult: ast.Div, ast.And: ast.Or}
_SWAPS |= {new: old for old, new in _SWAPS.items()}
_NAMES = {"min": "max", "minimum": "maximum", "any": "all"}
_NAMES |= {new: old for old, new in _NAMES.items()}
# The tests of a mutant, in this order: laws that most faults break, the folder that is named as its own, all laws.
_FIRST, _LAST = ["laws/test_searches.py", "laws/test_truth.py"], ["laws", "calls", "engine", "input"]
# After which a mutant counts as one that survives.
_MOST_SECONDS = 300.0


def change(node: ast.AST) -> bool:
    """Change a node in its place; whether there is something to change."""
    if isinstance(node, (ast.BinOp, ast.BoolOp)) and type(node.op) in _SWAPS:
        node.op = _SWAPS[type(node.op)]()
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in _SWAPS:
        node.ops[0] = _SWAPS[type(node.ops[0])]()
    elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
        node.test = ast.UnaryOp(ast.Not(), node.test)
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        node.value = node.value + 1 if type(node.value) is int else 2.0 * node.value + 1e-3
    elif isinstance(node, ast.Attribute) and node.attr in _NAMES:
        node.attr = _NAMES[node.attr]
    else:
        return False
    return True


def mutants(count: int, seed: int = 0) -> list[tuple[str, int, str]]:
    """Mutants of all files, the same ones for a seed: file, line, and the source with the change."""
    rng, chosen = random.Random(seed), []
    for pattern, share in SHARES.items():
        places = []
        for file in sorted(str(path.relative_to(ROOT)) for path in ROOT.glob(pattern)):
            tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
            notes = [getattr(node, name, None) for node in ast.walk(tree) for name in ("annotation", "returns")]
            unneeded = {id(part) for note in notes if note is not None for part in ast.walk(note)}
            places += [(file, k) for k, node in enumerate(ast.walk(tree)) if id(node) not in unneeded and change(node)]
        for file, k in rng.sample(places, round(share * count)):
            tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
            node = list(ast.walk(tree))[k]
            change(node)
            chosen.append((file, getattr(node, "lineno", 0), ast.unparse(tree)))
    return chosen


def tests_of(file: str) -> list[str]:
    """The tests that may find a mutant of a file."""
    folder = Path(file).parent.as_posix()
    return [*_FIRST, *([folder] if (ROOT / "tests" / folder).is_dir() else []), *_LAST]


def main(count: int = 200, seed: int = 0) -> None:
    """Plant each mutant, and print its line and the test that finds it; at the end those that survive."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        # without optimization a module is compiled sooner, and its bits are the same
        (copy.folder / "package" / "sitecustomize.py").write_text("import warp\n\nwarp.config.optimization_level = 0\n")
        chosen, survivors = mutants(count, seed), []
        if failed := copy.failing_test(sorted({test for file, *_ in chosen for test in tests_of(file)})):
            sys.exit(f"without a mutant: {failed}")
        copy.is_planted = True
        for file, line, source in chosen:
            path, original = copy.path_of(file), (ROOT / file).read_text(encoding="utf-8")
            path.write_text(source, encoding="utf-8")
            try:
                found = copy.failing_test(tests_of(file), _MOST_SECONDS)
            except RuntimeError as error:  # the tests could not be run
                found = str(error).splitlines()[0]
            path.write_text(original, encoding="utf-8")
            print(f"{file}:{line}: {found or 'SURVIVES'}", flush=True)
            survivors += [] if found else [f"{file}:{line}"]
    print(f"{len(chosen) - len(survivors)} of {len(chosen)} found; survive:", *sorted(survivors), sep="\n")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
