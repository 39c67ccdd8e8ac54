"""The pages' examples run as they stand, and print what the pages say; the site can be made."""

import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

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
    assert targets or page.name == "reference.md"
    for target in targets:
        assert (page.parent / target).exists(), target


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The documentation site, made by the command of CONTRIBUTING.md: a link that leads nowhere would stop it."""
    pytest.importorskip("sphinx", reason="the extra docs is not installed")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-n", "-c", "docs", ".", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def test_the_site_holds_every_page_with_its_figures_and_a_search(site):
    assert "sphinx-build -W -n -c docs . build/site" in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    index = (site / "searchindex.js").read_text(encoding="utf-8")
    for page in PAGES:
        name = page.relative_to(ROOT).with_suffix("").as_posix()
        assert f'"{name}"' in index, name
        html = (site / f"{name}.html").read_text(encoding="utf-8")
        for figure in re.findall(r"!\[[^]]*\]\((?:docs/)?figures/([^)]+)\)", page.read_text(encoding="utf-8")):
            assert f"_images/{figure}" in html and (site / "_images" / figure).is_file(), figure
    assert "url=README.html" in (site / "index.html").read_text(encoding="utf-8")


def test_the_reference_names_every_public_function(site):
    import ccd_warp as ccd
    from ccd_warp import viz

    page = (site / "docs" / "reference.html").read_text(encoding="utf-8")
    names = [f"ccd_warp.{name}" for name in ccd.__all__ if not isinstance(getattr(ccd, name), (str, ModuleType))]
    names += [f"ccd_warp.datasets.{name}" for name in ccd.datasets.__all__]
    names += [f"ccd_warp.viz.{name}" for name in viz.__all__]
    for name in names:
        assert f'id="{name}"' in page, name
