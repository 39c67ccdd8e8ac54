"""The figures of the pages: their tables are those of the raw figures, and these are of commits in the history."""

import csv
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results"


def report(*options: str) -> tuple[int, str]:
    """Exit status and words of `report.py --check`; skips where nothing tells of which commits figures are."""
    program = [sys.executable, str(ROOT / "benchmarks" / "report.py"), "--check", *options]
    done = subprocess.run(program, capture_output=True, text=True, cwd=ROOT, check=False)
    if "no history here" in done.stdout:
        pytest.skip(done.stdout.strip())
    return done.returncode, done.stderr


def test_tables_are_those_of_the_raw_figures_which_are_of_the_history():
    assert report() == (0, "")


def test_a_table_that_was_changed_by_hand_is_named(tmp_path):
    (tmp_path / "docs").mkdir()
    for name in ("README.md", "docs/benchmarks.md"):
        shutil.copy(ROOT / name, tmp_path / name)
    page = tmp_path / "docs" / "benchmarks.md"
    page.write_text(
        page.read_text(encoding="utf-8").replace("<!-- pairs: begin -->\n", "<!-- pairs: begin -->\nfast\n")
    )
    assert report("--docs", str(tmp_path)) == (1, f"{page} has other tables than its figures\n")


def test_figures_of_another_commit_are_refused_with_the_command_that_measures_them(tmp_path):
    """Of a commit that is not there, of none, and of files that were not committed; no other part is refused."""
    shutil.copytree(RESULTS, tmp_path / "results")
    path = tmp_path / "results" / "runs.csv"
    with path.open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    part, code = names.index("part"), names.index("code")
    other = {"small": "0123456789ab", "pairs": "", "sweep": "-dirty"}
    for row in rows:
        if row[part] in other:
            row[code] = (row[code] if row[part] == "sweep" else "") + other[row[part]]
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([names, *rows])
    status, said = report("--results", str(tmp_path / "results"))
    lines = [f"{name} is of [^:]*: python benchmarks/run.py {name} --output {path.parent}\n" for name in sorted(other)]
    assert status == 1 and re.fullmatch("".join(lines), said)
