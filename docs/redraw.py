"""Draw the figures and write the tables of the pages again, or say which are stale.

    python docs/redraw.py                    draw all but the figures of examples
    python docs/redraw.py --check            draw them elsewhere, and name those that differ; exit status 1 if any does
    python docs/redraw.py --list             what there is, by which command it is made, and how long that took
    python docs/redraw.py NAME ...           some makers alone: method, benchmark, rotor, ...

Nothing is measured: benchmarks are drawn from the raw figures in benchmarks/results. Each run prints what it took. A
figure of an example takes the example's whole run, so ``--check`` does not draw it: it is stale where the program has
changed, but for its comments, since its figure was drawn, or where the figure is another than the one then drawn.
``--record NAME ...`` notes that an example's own command has just drawn its figure. It needs
``pip install -e '.[benchmarks,docs,viz]'``.
"""

import argparse
import ast
import difflib
import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
# Of the examples, by name of the figure: hashes of program and figure when it was drawn, and the seconds that it took.
RECORDS = Path("docs", "figures", "examples.json")
# A colour that differs by less is that of another version of what draws; and pixels whose colour may differ by more.
_ALIKE, _MOST_UNLIKE = 0.2, 8


@dataclass(frozen=True)
class Maker:
    """What makes some figures, and tables of some pages.

    Attributes:
        name: Its name.
        command: Its command, after ``python``; ``{root}`` is the folder of the pages that it writes.
        figures: Names of its figures, in docs/figures.
        pages: Pages whose tables it writes.
        is_example: Whether it is a program that runs for itself, and not only draws.
    """

    name: str
    command: str
    figures: tuple[str, ...] = ()
    pages: tuple[str, ...] = ()
    is_example: bool = False

    @property
    def outputs(self) -> list[Path]:
        """What it makes, as paths within the checkout."""
        return [*(Path("docs", "figures", f"{name}.png") for name in self.figures), *map(Path, self.pages)]

    def run(self, root: Path) -> float:
        """Make all in a folder; the seconds that it took."""
        begin = time.monotonic()
        command = [part.format(root=root) for part in self.command.split()]
        done = subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            sys.exit(f"{self.name}: python {' '.join(command)} failed\n{done.stdout}{done.stderr}")
        return time.monotonic() - begin


MAKERS = [
    Maker("method", "docs/make_figures.py {root}/docs/figures", ("simple", "grazing", "in_plane")),
    Maker("rigid", "docs/make_rigid_figure.py {root}/docs/figures", ("arcs",)),
    Maker("readme", "docs/make_pictures.py {root}/docs/figures", ("demo_cloth", "readme_bullet")),
    Maker(
        "benchmark",
        "benchmarks/report.py --docs {root}",
        (*(f"bench_{name}" for name in ("speed_error", "steps")),),
        ("README.md", *(path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "docs").glob("*.md")))),
    ),
]


def examples(root: Path = ROOT) -> list[Maker]:
    """The examples whose figure is on a page: each has the name of its figure, and draws it into a folder."""
    names = sorted(path.stem for path in (root / "docs" / "figures").glob("*.png"))
    return [
        Maker(name, f"examples/{name}.py --output {{root}}/{name}", (name,), is_example=True)
        for name in names
        if (root / "examples" / f"{name}.py").is_file()
    ]


def copy_pages(to: Path) -> None:
    """Copy the pages, which makers write, without what they draw."""
    (to / "docs" / "figures").mkdir(parents=True)
    for page in ("README.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))):
        shutil.copy(ROOT / page, to / page)


def make(maker: Maker, to: Path) -> float:
    """Make what a maker makes in a copy of the pages; the seconds that it took."""
    seconds = maker.run(to)
    if maker.is_example:
        (name,) = maker.figures
        shutil.copy(to / name / f"{name}.png", to / "docs" / "figures")
    return seconds


def difference(path: Path, made: Path) -> str:
    """How a figure or a page differs from what was made just now; empty if it does not."""
    if not path.is_file():
        return "is missing"
    if path.suffix != ".png":
        lines = [each.read_text(encoding="utf-8").splitlines() for each in (path, made)]
        changed = [line for line in difflib.unified_diff(*lines, lineterm="", n=0) if line[0] in "+-"][2:]
        return f"differs in {len(changed)} lines, as {changed[0][:100]}" if changed else ""
    import matplotlib.image

    # what is transparent has no colour
    pixels, others = (matplotlib.image.imread(each)[..., :3] for each in (path, made))
    if pixels.shape != others.shape:
        return f"has {pixels.shape[1]} x {pixels.shape[0]} pixels, not {others.shape[1]} x {others.shape[0]}"
    unlike = int((np.abs(pixels - others).max(axis=-1) > _ALIKE).sum())
    return f"differs in {unlike:,} pixels" if unlike > _MOST_UNLIKE else ""


def hashes(maker: Maker, root: Path = ROOT) -> dict[str, str]:
    """Of an example's program, with the modules beside it but without comments, and of its figure."""
    program = root / "examples" / f"{maker.name}.py"
    sources, pending, seen = [], [program], {program}
    while pending:
        tree = ast.parse(pending.pop().read_text(encoding="utf-8"))
        sources.append(ast.dump(tree))
        names = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
        names += [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        beside = {program.parent / f"{name}.py" for name in names} - seen
        pending += sorted(path for path in beside if path.is_file())
        seen |= beside
    texts = {"program": "".join(sources).encode(), "figure": (root / maker.outputs[0]).read_bytes()}
    return {name: hashlib.sha256(text).hexdigest() for name, text in texts.items()}


def read_records(root: Path = ROOT) -> dict[str, dict]:
    """What is known of the figures of the examples."""
    path = root / RECORDS
    records: dict[str, dict] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return records


def record(makers: list[Maker], seconds: dict[str, float], root: Path = ROOT) -> None:
    """Note that the figures of some examples are those that their programs draw."""
    records = read_records(root)
    for maker in makers:
        took = seconds.get(maker.name, records.get(maker.name, {}).get("seconds"))
        records[maker.name] = {**hashes(maker, root), "seconds": None if took is None else round(took)}
    text = json.dumps(dict(sorted(records.items())), indent=1)
    (root / RECORDS).write_text(f"{text}\n", encoding="utf-8")


def stale_example(maker: Maker, root: Path = ROOT) -> str:
    """Why the figure of an example is stale; empty if it is not."""
    known = read_records(root).get(maker.name)
    if known is None:
        return "was never recorded as drawn by its program"
    now = hashes(maker, root)
    if now["program"] != known["program"]:
        return f"was drawn before {maker.command.split()[0]} was changed"
    return "is another than the one that its program drew" if now["figure"] != known["figure"] else ""


def stale_of(maker: Maker, root: Path = ROOT) -> dict[Path, str]:
    """What a maker would make otherwise, and how, drawn in a folder of its own and compared with that of a checkout."""
    with tempfile.TemporaryDirectory() as folder:
        to = Path(folder)
        copy_pages(to)
        make(maker, to)
        found = {path: difference(root / path, to / path) for path in maker.outputs}
    return {path: text for path, text in found.items() if text}


def check(makers: list[Maker]) -> int:
    """Say what is stale; 1 if anything is."""
    count = 0
    for maker in makers:
        begin = time.monotonic()
        found = {maker.outputs[0]: stale_example(maker)} if maker.is_example else stale_of(maker)
        stale = {path: text for path, text in found.items() if text}
        print(f"{maker.name:16} {'stale' if stale else 'as drawn':9} {time.monotonic() - begin:6.1f} s", flush=True)
        for path, text in stale.items():
            print(f"    {path} {text}")
        count += len(stale)
    print(f"{count} stale" + ("; drawn again by: python docs/redraw.py NAME ..." if count else ""))
    return int(count > 0)


def draw(makers: list[Maker]) -> None:
    """Make all, and put it into the checkout: a maker finds the pages as the one before has left them."""
    seconds: dict[str, float] = {}
    for maker in makers:
        with tempfile.TemporaryDirectory() as folder:
            to = Path(folder)
            copy_pages(to)
            seconds[maker.name] = make(maker, to)
            for path in maker.outputs:
                if difference(ROOT / path, to / path):
                    shutil.copy(to / path, ROOT / path)
                    print(f"    {path} is another")
        print(f"{maker.name:16} {seconds[maker.name]:6.1f} s", flush=True)
    record([maker for maker in makers if maker.is_example], seconds)
    print(f"{sum(seconds.values()):.0f} s")


def listed(makers: list[Maker]) -> list[str]:
    """A line for each maker on what it makes, and one with its command in a checkout."""
    lines = []
    for maker in makers:
        took = read_records().get(maker.name, {}).get("seconds")
        makes = ", ".join(maker.figures)
        lines.append(f"{maker.name}: {makes}" + ("" if took is None else f" ({took} s)"))
        lines.append(f"    python {maker.command.replace('{root}/', '').replace('{root}', '.')}")
    return lines


def main() -> int:
    """Draw, check, list or record.

    Returns:
        1 where ``--check`` has found something stale, else 0.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", metavar="NAME", nargs="*", help="makers, `examples` for all of these, or `stale` ones")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--check", action="store_true", help="name what is stale")
    what.add_argument("--list", action="store_true", help="name figures, tables and their commands")
    what.add_argument("--record", action="store_true", help="note that examples have just drawn their figures")
    options = parser.parse_args()
    of_examples = examples()
    by_name = {maker.name: maker for maker in [*MAKERS, *of_examples]}
    groups = {"examples": [maker.name for maker in of_examples]}
    groups["stale"] = [maker.name for maker in of_examples if "stale" in options.names and stale_example(maker)]
    names = [each for name in options.names for each in groups.get(name, [name])]
    if unknown := [name for name in names if name not in by_name]:
        parser.error(f"{', '.join(unknown)}; expected some of {', '.join(by_name)}, or examples")
    if options.record and not (names and all(by_name[name].is_example for name in names)):
        parser.error(f"--record needs examples: {', '.join(maker.name for maker in of_examples)}")
    everything = list(by_name.values()) if options.check or options.list else MAKERS
    chosen = [by_name[name] for name in names] or everything
    if options.list:
        print("\n".join(listed(chosen)))
    elif options.check:
        return check(chosen)
    elif options.record:
        record(chosen, {})
    else:
        draw(chosen)
    return 0


if __name__ == "__main__":
    sys.exit(main())
