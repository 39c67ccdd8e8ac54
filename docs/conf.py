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
_GUIDES = [
    "docs/solver",
    "docs/on_device",
    "docs/bodies",
    "docs/at_one_time",
    "docs/command_line",
    "docs/choosing",
    "docs/rigid",
    "docs/gradients",
    "docs/coming_from_ipc_toolkit",
    "docs/coming_from_engines",
    "docs/cuda",
    "docs/newton",
    "docs/distributed",
    "docs/examples",
]
_NOTES = "benchmarks/NOTES"
_REFERENCE = ["docs/reference", "docs/method", "docs/architecture", "docs/benchmarks", _NOTES]
_ABOUT = ["CONTRIBUTING", "CHANGELOG"]
_GUIDES += sorted({f"docs/{path.stem}" for path in Path(__file__).parent.glob("*.md")} - {*_GUIDES, *_REFERENCE})
include_patterns = ["*.md", "docs/*.md", "benchmarks/*.md", "benchmarks/notes/*.md"]
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


def _with_contents(app, docname, source):
    """Add the tables of contents, which a forge would show as code, and let folders be names alone."""
    folder = (_ROOT / docname).parent
    source[0] = re.sub(
        r"(?<!!)\[([^]]+)\]\(((?!https?:|#)[^)#]+)\)",
        lambda link: link[1] if (folder / link[2]).is_dir() else link[0],
        source[0],
    )
    if docname == _NOTES:
        source[0] += "\n```{toctree}\n:hidden:\n:glob:\n\nnotes/*\n```\n"
    if docname == root_doc:
        for caption, pages in (("Guides", _GUIDES), ("Reference", _REFERENCE), ("Project", _ABOUT)):
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
