"""Read Gmsh, Medit and Abaqus files by meshio, and check that all came that they announce.

meshio passes over what it does not know, and takes what it finds for what it looks for.
"""

import contextlib
import io
import re
import sys
import tempfile
import warnings
from itertools import pairwise
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
                mesh = _read_gmsh(meshio, path, data)
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
    bad += [line for line, other in pairwise([*lines, "*"]) if line.startswith("*INSTANCE") and other[:1] != "*"]
    if bad:
        raise InputError(f"holds *{bad[0].lstrip('*')}, which makes or moves nodes, or takes them from elsewhere")
    for keyword in ("NODE", "INSTANCE"):
        if keywords.count(keyword) > 1:
            raise InputError(f"has {keywords.count(keyword)} lists *{keyword}; expected one")
    return "\n".join([*lines, ""])


def _read_gmsh(meshio: Any, path: Path, data: bytes) -> Any:
    """What meshio reads, refused where a section is not closed, or holds more or less than announced."""
    head = re.search(rb"\$MeshFormat\s+(\d)(\S*)\s+([01])\s+(\d+)", data)
    names = (b"Nodes", b"Elements")
    sections = [re.findall(rb"(?s)\$%s\r?\n(.*)\n\$End%s\s" % (name, name), data) for name in names]
    if not head or not all(sections) or b"$End" not in data[-30:]:
        raise InputError(f"expected sections $MeshFormat, $Nodes and $Elements, each closed by its $End; {CUT}")
    is_new, is_text, is_40 = int(head[1]) >= 4, head[3] == b"0", head[2] == b".0"
    num_heads = (2 if is_40 else 4) if is_new else 1
    # How many numbers of text, or bytes, are a number in the head of a section, that of a block, a tag and a position.
    of_head, of_block, of_tag, of_position = (1, 4 * is_new, 1, 3) if is_text else (8, 20, 4 if is_40 else 8, 24)
    contents = [content for (content,) in sections]
    numbers = [content.split() if is_text else content.removesuffix(b"\r") for content in contents]
    if is_text or not is_new:
        stated = [list(map(int, content.split(None, num_heads)[:num_heads])) for content in contents]
    else:
        stated = [np.frombuffer(content, f"u{head[4].decode()}", num_heads).tolist() for content in contents]

    def check(k: int, count: int, rows: int) -> None:
        expected = num_heads * of_head + stated[k][0] * of_block + count * of_tag + rows
        if stated[k][int(is_new)] != count or ((is_new or is_text) and len(numbers[k]) != expected):
            noun = f"{stated[k][int(is_new)]} {names[k].decode().lower()}"
            raise InputError(f"announces {noun}, and {count} can be read, or its section is of another length; {CUT}")

    if is_new:  # before meshio leaves a node that is announced, and in no block, as memory was
        count, at = 0, num_heads * of_head
        for _ in range(min(stated[0][0], len(numbers[0]))):
            block = numbers[0][at : at + of_block]
            of_this = int(block[3] if block[3:] else 0) if is_text else int.from_bytes(block[12:], sys.byteorder)
            count, at = count + of_this, at + of_block + of_this * (of_tag + of_position)
        check(0, count, count * of_position)
    mesh = meshio.gmsh.read(path)
    corners = sum(block.data.size for block in mesh.cells) * of_tag
    if is_text and not is_new:  # each element has a type, and a list of tags
        corners += sum([2 + int(line.split(None, 3)[2]) for line in contents[1].strip().split(b"\n")[1:]])
    check(0, len(mesh.points), len(mesh.points) * of_position)
    check(1, sum(len(block.data) for block in mesh.cells), corners)
    return mesh
