"""Mechanical mutants: `python tests/planted/mutants.py [COUNT [TEST …]]` says which of them the tests do not find.

One operator, constant, bound or condition of the kernels, the engine or the calls is changed in a copy. A mutant that
survives need not be a fault: a bound may be wider than it need be, and a search may take longer.
"""

import ast
import random
import sys
import tempfile
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])

from planted.planting import ROOT, Copy  # noqa: E402

SHARES = {"kernels/**/*.py": 0.4, "ccd_warp/_engine/**/*.py": 0.4, "ccd_warp/*.py": 0.2}
_SWAPS = {ast.Lt: ast.LtE, ast.Gt: ast.GtE, ast.Eq: ast.NotEq, ast.Add: ast.Sub, ast.Mult: ast.Div, ast.And: ast.Or}
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
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        node.value = node.value + 1 if type(node.value) is int else 2.0 * node.value + 1e-3
    elif isinstance(node, ast.Attribute) and node.attr in _NAMES:
        node.attr = _NAMES[node.attr]
    else:
        return False
    return True


def mutants(count: int) -> list[tuple[str, int, str]]:
    """Mutants of all files, the same ones at each call: file, line, and the source with the change."""
    rng, chosen = random.Random(0), []
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


def main(count: int = 200, tests: tuple[str, ...] = ("laws",)) -> None:
    """Plant each mutant, and print its line and the test that finds it."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        for file, line, mutant in mutants(count):
            path, source = copy.path_of(file), (ROOT / file).read_text(encoding="utf-8")
            path.write_text(mutant, encoding="utf-8")
            copy.is_planted = True
            print(f"{file}:{line}: {copy.failing_test(list(tests)) or 'SURVIVES'}", flush=True)
            path.write_text(source, encoding="utf-8")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]), *filter(None, [tuple(sys.argv[2:])]))
