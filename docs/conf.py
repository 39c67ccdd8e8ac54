"""How Sphinx makes the documentation site: `sphinx-build -W -n -c docs . build/site`, with the extra `docs`.

The pages are those of the repository, README.md first, so that every link is the same there and on the site. `-W` makes
every warning an error and `-n` warns of each name that leads nowhere: a broken link stops the build.
"""

import re
import sys
import tomllib
from pathlib import Path

_ROOT = Path(__file__).resolve().parent.parent
# `python -m sphinx` at the root would find ./ccd_warp, which lacks the kernels there, before an installed package.
sys.path[:] = [entry for entry in sys.path if Path(entry or ".").resolve() != _ROOT]
_PROJECT = tomllib.loads((_ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = "ccd_warp"
author = _PROJECT["authors"][0]["name"]
copyright = author
version = release = _PROJECT["version"]

root_doc = "README"
_NOTES = "benchmarks/NOTES"
_TASKS = [
    "keep_my_cloth_from_passing",
    "first_contact_of_two_files",
    "thousands_of_worlds",
    "bodies_that_turn",
    "differentiate",
    "many_machines",
]
# The table of contents. A page of docs/ that no list has follows the guides.
_NAVIGATION = {
    "Start": ["docs/examples", "docs/command_line", "docs/explore", "docs/glossary"],
    "By task": [f"docs/tasks/{name}" for name in _TASKS],
    "Guides": [
        "docs/solver",
        "docs/on_device",
        "docs/bodies",
        "docs/at_one_time",
        "docs/choosing",
        "docs/rigid",
        "docs/gradients",
        "docs/distributed",
        "docs/cuda",
        "docs/newton",
        "docs/coming_from_ipc_toolkit",
        "docs/coming_from_engines",
        "docs/beside_other_libraries",
    ],
    "Mathematics": ["docs/method", "docs/architecture"],
    "Reference": ["docs/reference"],
    "Project": ["docs/how_it_is_tested", "docs/benchmarks", "docs/about", _NOTES, "CONTRIBUTING", "CHANGELOG"],
}
_LISTED = {page for pages in _NAVIGATION.values() for page in pages}
_NAVIGATION["Guides"] += sorted({f"docs/{path.stem}" for path in Path(__file__).parent.glob("*.md")} - _LISTED)
include_patterns = ["*.md", "docs/**/*.md", "benchmarks/*.md", "benchmarks/notes/*.md"]
exclude_patterns = ["**/.*", "build", "dist", "ccd_warp", "kernels", "benchmarks/results", "tests", "**/node_modules"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 4  # links to headings are checked, too
html_theme = "furo"
html_title = f"ccd_warp {release}"
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["site.css"]

autodoc_typehints = "description"  # long unions would fill a screen of every signature
autodoc_typehints_format = "short"
napoleon_use_ivar = True
# Names of other projects, whose own pages need not be reached while this site is built.
nitpick_ignore_regex = [
    ("py:.*", r"NDArray|ArrayLike|(np|numpy|trimesh|warp|wp|pathlib|collections|dataclasses|pyvista)\..*"),
]


def _faults():
    """The table of planted faults, from the list that `nox -s faults` plants."""
    sys.path.insert(0, str(_ROOT / "tests"))
    try:
        from planted.table import table
    finally:
        del sys.path[0]
    return table()


def _with_contents(app, docname, source):
    """Add the tables of contents, which a forge would show as code, and let folders be names alone."""
    folder = (_ROOT / docname).parent
    source[0] = re.sub(
        r"(?<!!)\[([^]]+)\]\(((?!https?:|#)[^)#]+)\)",
        lambda link: link[1] if (folder / link[2]).is_dir() else link[0],
        source[0],
    )
    if docname == "docs/how_it_is_tested":
        source[0] = re.sub(r"(<!-- planted faults: begin -->\n).*?(?=<!-- )", rf"\1\n{_faults()}\n", source[0], flags=re.S)
    if docname == _NOTES:
        source[0] += "\n```{toctree}\n:hidden:\n:glob:\n\nnotes/*\n```\n"
    if docname == root_doc:
        for caption, pages in _NAVIGATION.items():
            source[0] += "\n".join(["", "```{toctree}", ":hidden:", f":caption: {caption}", "", *pages, "```", ""])


def _write_index(app, error):
    """Let the folder of the site open at its first page."""
    if error is None:
        page = f'<!doctype html><meta http-equiv="refresh" content="0; url={root_doc}.html"><title>{project}</title>\n'
        Path(app.outdir, "index.html").write_text(page, encoding="utf-8")


def setup(app):
    """Connect the two functions above."""
    app.connect("source-read", _with_contents)
    app.connect("build-finished", _write_index)
