"""Read legacy VTK files of unstructured grids by meshio, and check that all came that they say they hold.

Of version 5, meshio passes over cells of a type that it does not know, and takes as many corners before the end of a
cell as its type has, wherever the cell before it ends.
"""

import re
import warnings
from functools import partial
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from ccd_warp._files.cells import Grid, load_meshio
from ccd_warp._files.opened import read_file
from ccd_warp._files.text import CUT
from ccd_warp._scene.input.messages import InputError

_HEAD = re.compile(rb"# vtk DataFile Version (\d)\.\d+\s*\n[^\n]*\n\s*(ASCII|BINARY)\s*\n\s*DATASET (\w+)\s*\n")


def read_vtk(path: Path) -> Grid:
    """Points, cells and fields of a file.

    Raises:
        InputError: If it is damaged, or does not hold as much as stated.
    """
    data = read_file(path)
    head = _HEAD.match(data)
    if not head:
        raise InputError(f"does not begin as a VTK file, with '# vtk DataFile Version', ASCII or BINARY; {CUT}")
    is_text, dataset = head[2] == b"ASCII", head[3].decode()
    if dataset != "UNSTRUCTURED_GRID":
        raise InputError(f"holds the dataset {dataset}; expected an UNSTRUCTURED_GRID: save it as PLY or VTU")
    if is_text and not data[-1:].isspace():
        raise InputError(f"its last number may have lost digits, because no line end follows; {CUT}")
    with warnings.catch_warnings():  # NumPy warns where a text of numbers holds something else behind some of them
        warnings.filterwarnings("error", message="string or file could not be read", category=DeprecationWarning)
        mesh = load_meshio().vtk.read(path)
    widths = np.concatenate(
        [np.zeros(0, dtype=int), *(np.full(len(cells.data), cells.data.shape[1]) for cells in mesh.cells)]
    )
    stated = [tuple(map(int, line)) for line in re.findall(rb"\nCELLS +(\d+) +(\d+)[ \r]*\n", data)]
    is_old = int(head[1]) < 5  # each cell begins with its number of corners; later there is one offset more than cells
    read_counts = len(widths) + (not is_old), int(widths.sum()) + is_old * len(widths)
    if stated != [read_counts]:
        raise InputError(f"its line CELLS says {stated}, and what is read of it makes {read_counts}; {CUT}")
    if not is_old and not np.array_equal(np.diff(_offsets(data, is_text, read_counts[0])), widths):
        raise InputError(f"its cells have other numbers of corners than their types; {CUT}")
    # blanks in names are escaped
    fields = {unquote(name): partial(np.asarray, values) for name, values in mesh.point_data.items()}
    return Grid(mesh.points, [(block.type, block.data) for block in mesh.cells], fields)


def _offsets(data: bytes, is_text: bool, count: int) -> np.ndarray:
    """Where cells begin among their corners, as a file of version 5 says."""
    line = re.search(rb"\nOFFSETS +(\w+)[ \r]*\n", data)
    assert line is not None, "meshio has read it"
    if is_text:
        return np.array(data[line.end() :].split(None, count)[:count], dtype=np.int64)
    return np.frombuffer(data, ">i4" if line[1] == b"vtktypeint32" else ">i8", count, line.end())
