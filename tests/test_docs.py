"""The pages' examples run as they stand, and print what the pages say; the reference can be made."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize(
    "page", [p for p in PAGES if "```python" in p.read_text(encoding="utf-8")], ids=lambda page: page.name
)
def test_the_examples_print_what_the_page_says(page, tmp_path):
    """All of a page's code is one program, because one block goes on from another; each prints what follows it."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```\n+It prints:\n+^```text\n(.*?)^```$", text, re.DOTALL | re.M)
    assert len(blocks) == len(re.findall(r"^```python$", text, re.M)) > 0
    quiet = "import warp; warp.config.log_level = warp.LOG_WARNING\n"  # Warp's banner is not the example's output
    script = tmp_path / "page.py"  # a file, because Warp reads the source of kernels
    script.write_text(quiet + "".join(code for code, _ in blocks), encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "".join(output for _, output in blocks)


def test_the_ten_lines_are_of_the_program():
    text = (ROOT / "docs" / "solver.md").read_text(encoding="utf-8")
    (excerpt,) = re.findall(r"^```py\n(.*?)^```$", text, re.DOTALL | re.M)
    program = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.M)[0].splitlines()
    assert len(excerpt.splitlines()) == 10
    assert set(excerpt.splitlines()) <= set(program)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    targets = re.findall(r"\]\((?!https?:)([^)#]+)\)", page.read_text(encoding="utf-8"))
    assert targets or page.name == "solver.md"
    for target in targets:
        assert (page.parent / target).exists(), target


def test_the_reference_names_every_public_function(tmp_path):
    pytest.importorskip("pdoc", reason="the extra docs is not installed")
    import ccd_warp as ccd

    command = [sys.executable, "-m", "pdoc", "--docformat", "google", "--output-directory", str(tmp_path), "ccd_warp"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "ccd_warp.html").read_text(encoding="utf-8")
    for name in ccd.__all__:
        if name not in ("__version__", "datasets", "viz"):
            assert f'id="{name}"' in page, name
    for part in (ccd.datasets, ccd.viz):
        name = part.__name__.partition(".")[2]
        page_of_part = (tmp_path / "ccd_warp" / f"{name}.html").read_text(encoding="utf-8")
        assert f'href="ccd_warp/{name}.html"' in page
        for function in part.__all__:
            assert f'id="{function}"' in page_of_part, function
