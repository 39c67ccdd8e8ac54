"""The pages' examples run as they stand, and print what the pages say; the reference can be made."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parent.parent / "docs"


def test_the_loop_of_the_solver_page_prints_what_it_says(tmp_path):
    text = (DOCS / "solver.md").read_text(encoding="utf-8")
    (code,), (output,) = (re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL) for language in ("python", "text"))
    quiet = "import warp; warp.config.log_level = warp.LOG_WARNING\n"  # Warp's banner is not the example's output
    done = subprocess.run(
        [sys.executable, "-c", quiet + code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == output


def test_links_lead_somewhere():
    for page in DOCS.glob("*.md"):
        for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_reference_names_every_public_function(tmp_path):
    pytest.importorskip("pdoc", reason="the extra docs is not installed")
    import ccd_warp as ccd

    command = [sys.executable, "-m", "pdoc", "--docformat", "google", "--output-directory", str(tmp_path), "ccd_warp"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "ccd_warp.html").read_text(encoding="utf-8")
    for name in ccd.__all__:
        if name not in ("__version__", "datasets"):
            assert f'id="{name}"' in page, name
