"""How Sphinx makes the documentation site: `sphinx-build -W -n -c docs . build/site`, with the extra `docs`.

The pages are those of the repository, README.md first, so that every link is the same there and on the site. `-W` makes
every warning an error and `-n` warns of each name that leads nowhere: a broken link stops the build.
"""

import ast
import re
import shutil
import sys
import tomllib
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from numpy.typing import ArrayLike
from sphinx import addnodes
from sphinx.domains.python import PyObject
from sphinx.util.typing import stringify_annotation

_ROOT = Path(__file__).resolve().parent.parent
_PROJECT = tomllib.loads((_ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = "ccd_warp"
author = _PROJECT["authors"][0]["name"]
copyright = author
version = release = _PROJECT["version"]

root_doc = "README"


_REFERENCE = re.findall(
    r"\((reference/\w+)\.md\)", Path(__file__).with_name("reference.md").read_text(encoding="utf-8")
)
# The table of contents. A page of docs/ that no list has follows the guides.
_NAVIGATION = {
    "Start": ["docs/installing", "docs/tasks", "docs/examples", "docs/command_line", "docs/explore", "docs/glossary"],
    "Guides": [
        "docs/solver",
        "docs/on_device",
        "docs/bodies",
        "docs/at_one_time",
        "docs/choosing",
        "Bodies that turn, in full <docs/rigid>",
        "docs/gradients",
        "docs/distributed",
        "docs/cuda",
        "docs/newton",
        "docs/coming_from_ipc_toolkit",
        "docs/beside_other_libraries",
    ],
    "Mathematics": ["docs/method", "docs/architecture", "docs/extending"],
    "Reference": ["docs/calls", "Every name <docs/reference>", *(f"docs/{page}" for page in _REFERENCE)],
    "Project": ["docs/how_it_is_tested", "docs/benchmarks", "docs/about", "CONTRIBUTING", "CHANGELOG"],
}
_LISTED = {page.rpartition("<")[2].rstrip(">") for pages in _NAVIGATION.values() for page in pages}
_NAVIGATION["Guides"] += sorted({f"docs/{path.stem}" for path in Path(__file__).parent.glob("*.md")} - _LISTED)
_FIGURES = Path(__file__).with_name("figures")
include_patterns = ["*.md", "docs/*.md", "docs/**/*.md", "examples/*.py"]
source_suffix = {".md": "markdown", ".py": "markdown"}  # a program becomes a page of Markdown, see _page_of_program
exclude_patterns = ["**/.*", "build", "dist", "ccd_warp", "kernels", "benchmarks", "tests", "**/node_modules"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]
myst_heading_anchors = 4  # links to headings are checked, too
myst_enable_extensions = ["dollarmath"]  # $…$ and $$…$$, which forges set as well
html_math_renderer = "mathml"  # what browsers set by themselves: nothing is loaded from anywhere, nor installed
html_theme = "furo"
html_title = f"ccd_warp {release}"
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["site.css"]

autosummary_generate = False  # a table of names that stand on the same page
autodoc_member_order = "bysource"  # members in the order of use, enums in that of their values
autodoc_mock_imports = ["jax", "torch"]  # the functions are shown without either
autodoc_type_aliases = {"ArrayLike": "ArrayLike", "DeviceArray": "DeviceArray"}  # written out, unions of many words
python_maximum_signature_line_length = 90
napoleon_use_ivar = True
# Of any shape, as NumPy 2 and NumPy 1 have it.
_ANY = r"(?:tuple\[~?(?:typing\.)?Any, \.\.\.\]|~?(?:typing\.)?Any)"
# What a signature says in other words, which docs/reference.md explains.
_WORDS = [
    (r"TypeAliasForwardRef\('(\w+)'\)", r"\1"),
    (r"\b(vertices_t[01]|positions|points_t[01]|displacements): (?:ArrayLike|DeviceArray)", r"\1: Positions"),
    (rf"~numpy\.ndarray\[{_ANY}, ~numpy\.dtype\[(~?[\w.]+?)_?\]\]", r"NDArray[\1]"),
    (r"~?ccd_warp\._scene\.input\.excluded_pairs\.PairsFound", "~ccd_warp.Contacts | ~ccd_warp.Proximities"),
    (r"~?ccd_warp\._results\.contact_place\.BodyMotion", "~ccd_warp.RigidMotion"),
    (r"~typing\.Unpack\[([^]]+)\]", r"\1"),
    (r"~typing\.Literal\['scene', 'world', 'body', 'vertex'\]", "Per"),
]
# What stands for long types of attributes.
_TYPES = {
    "ArrayLike": re.escape(stringify_annotation(ArrayLike, "fully-qualified-except-typing")),
    r"NDArray[\1]": rf"numpy\.ndarray\[{_ANY}, numpy\.dtype\[(?:numpy\.)?([\w.]+?)_?\]\]",
    "": r"(?<![\w.])(?:collections\.abc|pathlib|typing)\.(?=\w)",
    r"~\1": r"(?<![\w.~])(ccd_warp\.[\w.]+)",
}
# Classes that a user calls; all others are made by calls, and their signatures say nothing.
_CALLED = {
    *("CollisionPipeline", "HalfSpace", "RigidMotion"),
    *("DistributedMesh", "DistributedPipeline", "Queries", "SimulationStep"),
}
# Names of other projects, whose own pages need not be reached while this site is built, and words of signatures that
# docs/reference.md explains.
nitpick_ignore_regex = [
    ("py:.*", r"(np|numpy|trimesh|warp|wp|torch|jax|pathlib|collections|dataclasses|pyvista)\..*"),
    ("py:.*", "NDArray|ArrayLike|Colour|Positions|Motion|Per|bool_|u?int(8|32|64)|float64"),
    ("py:.*", "Any|Callable|Iterable|Literal|Mapping|Path|Sequence|DeviceArray"),
]


def _faults():
    """The table of planted faults, from the list that `nox -s faults` plants."""
    sys.path.insert(0, str(_ROOT / "tests"))
    try:
        from planted.table import table
    finally:
        del sys.path[0]
    return table()


def _described(fence):
    """A block `names MODULE` of a page of the reference: a table of its names, and each with its docstring.

    Names with a dot, as methods, and those of modules that another block of the page describes, are in the table alone.
    """
    module, names = fence[1], fence[2].split()
    lines = [f".. automodule:: {module}", ""] if module != "ccd_warp" else []
    lines += [
        f".. currentmodule:: {module}",
        "",
        ".. autosummary::",
        "   :nosignatures:",
        "",
        *(f"   {n}" for n in names),
        "",
    ]
    for name in names:
        if "." in name:
            continue
        lines += [f".. auto{'class' if name[0].isupper() else 'function'}:: {module}.{name}"]
        if name[0].isupper():
            lines += [
                "   :members:",
                "   :inherited-members: dict, int",
                *["   :undoc-members:"] * (name == "PairKind"),
            ]
    return "\n".join(["```{eval-rst}", *lines, "```"])


def _page_of_program(docname, code):
    """A page that says what a program is about, shows its picture where it has one, and its code."""
    name = docname.rpartition("/")[2]
    about, _, more = (ast.get_docstring(ast.parse(code)) or "").partition("\n\n")
    picture = f"![What it draws](../docs/figures/{name}.png)\n\n" if (_FIGURES / f"{name}.png").is_file() else ""
    return f"# {name}.py\n\n{about}\n\n{picture}{more}\n\n`````python\n{code}`````\n"


def _with_contents(app, docname, source):
    """Add the tables of contents, which a forge would show as code, and let folders be names alone."""
    if docname.startswith("examples/"):
        source[0] = _page_of_program(docname, source[0])
        return
    folder = (_ROOT / docname).parent

    def followed(link):
        """A link that the site can follow: code is a file, but for the examples; folders and notes are names alone."""
        label, target = link.groups()
        path = (folder / target).resolve()
        if path.suffix == ".html":
            return f'<a href="{target}">{label}</a>'
        if path.is_dir() or (_ROOT / "benchmarks" in path.parents and path.suffix != ".py"):
            return label
        is_code = path.suffix == ".py" and path.parent.name != "examples"
        return f"[{label}](path:{target})" if is_code else link[0]

    source[0] = re.sub(r"(?<!!)\[([^]]+)\]\(((?!https?:|#)[^)#]+)\)", followed, source[0])
    if docname == "docs/how_it_is_tested":
        before, begin, shown = source[0].partition("<!-- planted faults: begin -->")
        source[0] = f"{before}{begin}\n\n{_faults()}\n{shown[shown.index('<!-- planted faults: end') :]}"
    source[0] = re.sub(r"^```\{names\} (\S+)\n(.*?)^```$", _described, source[0], flags=re.DOTALL | re.MULTILINE)
    if docname == "docs/examples":
        source[0] += "\n```{toctree}\n:hidden:\n:glob:\n\n/examples/*\n```\n"
    if docname == root_doc:
        for caption, pages in _NAVIGATION.items():
            source[0] += "\n".join(["", "```{toctree}", ":hidden:", f":caption: {caption}", "", *pages, "```", ""])


def _readable(app, what, name, thing, options, signature, result):
    """A signature in words that a reader knows, or none where nobody calls it."""
    if what == "class" and name.rpartition(".")[2] not in _CALLED:
        return ("", None) if signature else None
    for pattern, word in _WORDS:
        signature, result = (re.sub(pattern, word, text) if text else text for text in (signature, result))
    return signature, result


def _readable_text(app, what, name, thing, options, lines):
    """Short types of attributes, and names in first lines that hold in a table, where no class or module is at hand."""
    if what in ("method", "function"):
        owner = name.rpartition(".")[0]
        lines[:] = [re.sub(r":(meth|func):`(\w+)`", rf":\1:`\2 <{owner}.\2>`", line) for line in lines]
    for k, line in enumerate(lines):
        if line.startswith(":vartype "):
            for word, pattern in _TYPES.items():
                line = re.sub(pattern, word, line)
            lines[k] = line


def _readable_property(app, domain, objtype, content):
    """The short type of a property, whose signature no event of autodoc changes."""
    for note in content.parent.findall(addnodes.desc_annotation):
        text = note.astext()
        short = re.sub(rf"ndarray\[{_ANY}, dtype\[(\w+?)_?\]\]", r"NDArray[\1]", text)
        if short != text:
            note.clear()
            note += nodes.Text(short)


def _mathml(node, **options):
    """A formula in MathML; bars are delimiters, around which no operator's space is left."""
    return re.sub(r"<mo[^>]*>\|</mo>", '<mo lspace="0" rspace="0">|</mo>', tex2mathml(node.astext().strip(), **options))


def _inline_formula(writer, node):
    """A formula in a line."""
    writer.body.append(_mathml(node))
    raise nodes.SkipNode


def _displayed_formula(writer, node):
    """A formula on lines of its own."""
    writer.body.append(f'<div class="math">{_mathml(node, as_block=True)}</div>')
    raise nodes.SkipNode


def _add_files(app, error):
    """Let the folder of the site open at its first page, and copy the page that docs/explore.md opens."""
    if error is None:
        shutil.copytree(_ROOT / "docs" / "explore", Path(app.outdir, "docs", "explore"), dirs_exist_ok=True)
        page = f'<!doctype html><meta http-equiv="refresh" content="0; url={root_doc}.html"><title>{project}</title>\n'
        Path(app.outdir, "index.html").write_text(page, encoding="utf-8")


def setup(app):
    """Connect the functions above."""
    for field in PyObject.doc_field_types:
        if field.name == "variable":
            field.label = "Attributes"
    app.add_html_math_renderer("mathml", (_inline_formula, None), (_displayed_formula, None))
    app.connect("autodoc-process-signature", _readable)
    app.connect("autodoc-process-docstring", _readable_text)
    app.connect("object-description-transform", _readable_property)
    app.connect("source-read", _with_contents)
    app.connect("build-finished", _add_files)
