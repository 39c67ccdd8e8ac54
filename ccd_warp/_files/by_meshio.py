"""Read Gmsh, Medit and Abaqus files by meshio, and check that all came that they announce: meshio passes over the rest."""

import contextlib
import io
import re
import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp._files.cells import Grid, grid_of_meshio, load_meshio
from ccd_warp._files.opened import read_file
from ccd_warp._files.text import CUT
from ccd_warp._scene.input.messages import InputError

# Keywords of Abaqus that make or move nodes and elements, which meshio passes over, or reads from elsewhere.
_REFUSED = ("INCLUDE", "IMPORT", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM")


def read_with_meshio(path: Path) -> Grid:
    """Points and cells of a file.

    Raises:
        InputError: If it is damaged, or does not hold as much as announced.
    """
    meshio, data = load_meshio(), read_file(path)
    with quiet_meshio():
        match path.suffix.lower():
            case ".inp":
                mesh = meshio.abaqus._abaqus.read_buffer(io.StringIO(_cleaned(data)))
            case ".mesh":
                mesh = _read_medit(meshio, path, data)
            case _:
                mesh = meshio.gmsh.read(path)
                _check_gmsh(data, mesh)
    return grid_of_meshio(mesh)


@contextlib.contextmanager
def quiet_meshio() -> Any:
    """Refuse texts that NumPy reads in part, and keep what meshio prints from the terminal."""
    with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
        warnings.filterwarnings("error", message="string or file could not be read", category=DeprecationWarning)
        yield


def _read_medit(meshio: Any, path: Path, data: bytes) -> Any:
    if not re.search(rb"\n\s*End\s*$", data):
        raise InputError(f"does not end with 'End'; {CUT}")
    text = re.sub(rb"(MeshVersionFormatted\s+)[01]\b", rb"\g<1>2", data)  # decimals in full
    if text == data:
        return meshio.medit.read(path)
    with tempfile.TemporaryDirectory() as folder:  # NumPy reads numbers of text from files alone
        (copy := Path(folder, "copy.mesh")).write_bytes(text)
        return meshio.medit.read(copy)


def _cleaned(data: bytes) -> str:
    """An Abaqus file without the comments at which meshio ends a list, in capitals as its types are."""
    if not data[-1:].isspace():
        raise InputError(f"its last number may have lost digits, because no line end follows; {CUT}")
    lines = [line for line in data.decode("utf-8", "replace").upper().splitlines() if not line.startswith("**")]
    words = [re.split(r"\s*,\s*", line[1:].strip()) for line in lines if line.startswith("*")]
    keywords = [line[0] for line in words]
    bad = [keyword for keyword in keywords if keyword in _REFUSED]
    bad += [" ".join(line) for line in words if line[0] == "NODE" and any("SYSTEM" in word for word in line)]
    after = dict(zip(lines, lines[1:], strict=False))
    bad += [line for line in lines if line.startswith("*INSTANCE") and not after.get(line, "*").startswith("*")]
    if bad:
        raise InputError(
            f"holds *{bad[0].lstrip('*')}, which makes, moves or takes nodes from elsewhere; write them all"
        )
    if keywords.count("NODE") != 1 or keywords.count("INSTANCE") > 1:
        raise InputError(
            f"has {keywords.count('NODE')} lists of nodes and {keywords.count('INSTANCE')} instances; expected one of both"
        )
    return "\n".join([*lines, ""])


def _check_gmsh(data: bytes, mesh: Any) -> None:
    """Refuse a file in which a section is not closed, or holds more or less than announced."""
    head = re.search(rb"\$MeshFormat\s+(\d)(\S*)\s+([01])\s+(\d+)", data)
    sections = {
        name: re.search(rb"\$%s\r?\n(.*)\$End%s\s" % (name, name), data, re.S) for name in (b"Nodes", b"Elements")
    }
    if not head or None in sections.values() or not data.rstrip().rpartition(b"\n")[2].startswith(b"$End"):
        raise InputError(f"has sections $MeshFormat, $Nodes and $Elements that are not there, or not closed; {CUT}")
    is_41, is_new, is_text = head[2] not in (b".0",), int(head[1]) >= 4, head[3] == b"0"
    num_nodes, num_cells = len(mesh.points), sum(len(block.data) for block in mesh.cells)
    num_corners = sum(block.data.size for block in mesh.cells)
    for name, section, found in zip(("nodes", "elements"), sections.values(), (num_nodes, num_cells), strict=True):
        content = section[1]
        if not is_new:
            stated, size = [int(content.split(None, 1)[0])], None
        elif is_text:
            stated = list(map(int, content.split(None, 4 if is_41 else 2)[: 4 if is_41 else 2]))
            size, tag, position, block = len(content.split()) - len(stated), 1, 3, 4
        else:
            stated = np.frombuffer(content, f"u{head[4].decode()}", 4 if is_41 else 2).tolist()
            size, tag = len(content.rstrip(b"\r\n")) - 8 * len(stated), 8 if is_41 else 4
            position, block = 24, 20
        total = stated[1 if is_new else 0]
        if total != found:
            raise InputError(f"announces {total} {name}, and {found} can be read; {CUT}")
        if is_new and size is not None:
            expected = block * stated[0] + total * tag + (total * position if name == "nodes" else num_corners * tag)
            if abs(size - expected) > (0 if is_text else 2):
                raise InputError(f"its section of {name} is of {size} numbers or bytes; expected {expected}: {CUT}")
