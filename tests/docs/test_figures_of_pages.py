"""The figures of the pages: their tables are those of the raw figures, and these are of commits in the history."""

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


@pytest.mark.parametrize("code", ["0123456789ab", "", "{head}-dirty"])
def test_figures_of_another_commit_are_refused_with_the_command_that_measures_them(tmp_path, code):
    shutil.copytree(RESULTS, tmp_path / "results")
    runs = tmp_path / "results" / "runs.csv"
    header, *lines = runs.read_text(encoding="utf-8").splitlines()
    (of_part,) = [line for line in lines if line.startswith("small,")]
    head = of_part.split('"')[2].split(",")[2]
    changed = of_part.replace(f",{head},", f",{code.format(head=head)},")
    runs.write_text("\n".join([header, *lines]).replace(of_part, changed))
    status, said = report("--results", str(tmp_path / "results"))
    assert changed != of_part and status == 1
    assert said.startswith("small is of ") and "run.py small --output" in said and said.count("\n") == 1
