"""The page of ``ccd-warp explore``: one HTML file that computes everything itself and needs nothing else."""

from importlib.resources import files
from pathlib import Path

from ccd_warp._cli.replacing import replacing
from ccd_warp._files.frames import InputError
from ccd_warp._version import __version__

PAGE_SUFFIXES = (".html", ".htm")

# In the order in which they need each other.
_SCRIPTS = (
    "pair.js",
    "bisection.js",
    "facets.js",
    "rounds.js",
    "clipping.js",
    "page.js",
    "bullet.js",
    "plots.js",
    "explorer.js",
    "controls.js",
)

_POINTS = {"p": "point p", "a": "end a of the segment", "b": "end b of the segment"}
_ENDS = ("start", "end")

_HANDLE = """\
<g id="{name}-{end}" class="handle {end}" tabindex="0" role="slider" aria-valuemin="0" aria-valuemax="1"
 aria-label="{point}, {end} of the step; arrow keys move it"><circle class="area" r="5"/><circle class="dot" r="1.9"/>\
<text x="2.4" y="-2.4">{label}</text></g>"""
_INPUT = """\
<td><input id="{name}-{end}-{axis}" type="number" min="0" max="1" step="0.01"
 aria-label="{axis} of {name}, {end}"></td>"""


def make_page() -> str:
    """The page: its text, with the styles and scripts of the folder ``page`` written into it."""
    folder = files("ccd_warp._cli") / "page"
    handles = [
        _HANDLE.format(name=name, end=end, point=point, label=name if end == "start" else f"{name}′")
        for end in reversed(_ENDS)  # those at the start come last, and lie above the others
        for name, point in _POINTS.items()
    ]
    rows = [
        f'<tr><th scope="row">{name}</th>'
        + "".join(_INPUT.format(name=name, end=end, axis=axis) for end in _ENDS for axis in "xy")
        + "</tr>"
        for name in _POINTS
    ]
    parts = {
        "style.css": (folder / "style.css").read_text(encoding="utf-8"),
        "handles": "\n".join(handles),
        "coordinates": "\n".join(rows),
        "scripts": "\n".join((folder / name).read_text(encoding="utf-8") for name in _SCRIPTS),
        "version": __version__,
    }
    page = (folder / "index.html").read_text(encoding="utf-8")
    for name, text in parts.items():
        page = page.replace("{{" + name + "}}", text)
    return page


def write_page(path: Path) -> Path:
    """Write the page, over a file that is there already, as the other commands do.

    Args:
        path: An ``.html`` file in a folder that exists.

    Returns:
        The path.

    Raises:
        InputError: If the name has another suffix, or the file cannot be written.
    """
    if path.suffix.lower() not in PAGE_SUFFIXES:
        raise InputError(f"--output {path}: the name must end in {', '.join(PAGE_SUFFIXES)}")
    if not path.parent.is_dir():
        raise InputError(f"--output {path}: the folder {path.parent} does not exist; create it first")
    with replacing(path) as beside:
        beside.write_text(make_page(), encoding="utf-8")
    return path
