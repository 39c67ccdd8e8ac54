"""Sequences of frames of moving bodies: mesh files in natural order, series of ParaView and XDMF."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ccd_warp._files.cells import reading
from ccd_warp._files.content import Mesh
from ccd_warp._files.mesh import CELL_SUFFIXES, MESH_SUFFIXES, XDMF_SUFFIXES, read_mesh
from ccd_warp._files.natural import grouped_frames, natural_key, series_name
from ccd_warp._files.opened import read_file
from ccd_warp._files.xdmf import Xdmf
from ccd_warp._scene.input.messages import InputError

_ADVICE = "give mesh files, a folder of them, a .pvd or an .xdmf"


class FileSeries:
    """A mesh file for each frame; ``options`` are those of :func:`read_mesh`."""

    def __init__(self, name: str, files: list[Path], times: list[float] | None = None, **options: Any) -> None:
        self.name, self.files, self.times, self.options = name, files, times, options
        self.labels = [path.name for path in files]

    def read(self, k: int) -> Mesh:
        """The mesh of file ``k``."""
        return read_mesh(self.files[k], **self.options)


# The frames of one file or of several, which move together: what to call them, the name of each, their times where the
# files say these, and each frame, read completely or not at all.
Series = FileSeries | Xdmf


def find_series(paths: Sequence[Path], **options: Any) -> list[Series]:
    """The frames that files and folders hold, one series for each that moves.

    Args:
        paths: Mesh files, which are grouped by their names as in :func:`grouped_frames`; folders, each as if its files
            had been given; and files of all frames: ``.pvd``, ``.xdmf``.
        options: As of :func:`read_mesh`.

    Raises:
        InputError: If a path is missing or not known, or they differ in the number of frames, or hold fewer than two.
    """
    groups: list[list[Path]] = [[]]
    for path in paths:
        if path.is_dir():
            groups += [_files_of(path), []]
        elif path.exists():
            groups[-1].append(path)
        else:
            raise InputError(f"{path}: no such file or folder; {_ADVICE}")
    series = [frames for files in groups for frames in _series_of(files, **options)]
    first, times = series[0], [frames.times for frames in series if frames.times is not None]
    for other in series:
        if len(other.labels) != len(first.labels):
            raise InputError(
                f"{other.name} has {len(other.labels)} frames, and {first.name} has {len(first.labels)}; "
                "expected the same number for all that move, and --static for what does not"
            )
    if any(other != times[0] for other in times):
        raise InputError("the times of the bodies differ; expected the same time for all in each frame")
    if len(first.labels) < 2:
        raise InputError(f"{first.name} has {len(first.labels)} frame; expected two or more")
    return series


def _series_of(files: list[Path], **options: Any) -> list[Series]:
    """The series of files of all frames, then those of files of one frame."""
    frames: list[Path] = []
    series: list[Series] = []
    for path in files:
        suffix = path.suffix.lower()
        if suffix == ".pvd":
            series += _pvd_series(path, **options)
        elif suffix in XDMF_SUFFIXES and (xdmf := Xdmf(path, **options)).is_series:
            series.append(xdmf)
        else:
            frames.append(path)
    groups = grouped_frames(frames) if frames else []
    return series + [FileSeries(series_name(group), group, **options) for group in groups]


def _files_of(folder: Path) -> list[Path]:
    """The frames in a folder, or the files of all frames, in natural order; other files are passed over."""
    paths = [
        path
        for path in sorted(folder.iterdir(), key=lambda path: natural_key(path.name))
        if not path.is_dir() and not path.name.startswith(".")
    ]
    series = [path for path in paths if path.suffix.lower() == ".pvd"]
    frames = [path for path in paths if path.suffix.lower() in (*MESH_SUFFIXES, *CELL_SUFFIXES)]
    if series and frames:
        raise InputError(f"{folder}: holds {frames[0].name} as well as {series[0].name}; give what you mean by name")
    if not series and not frames:
        raise InputError(f"{folder}: holds no frames; {_ADVICE}")
    return series or frames


def _pvd_series(path: Path, **options: Any) -> list[Series]:
    """The series of a collection of ParaView: a body for each part, with a file for each time."""
    parts: dict[tuple[str, str], list[tuple[float, Path]]] = {}
    with reading(path):
        root = ET.fromstring(read_file(path))
        for entry in root.iter("DataSet"):
            part = (entry.get("group", ""), entry.get("part", "0"))
            place = path.parent / entry.attrib["file"]
            parts.setdefault(part, []).append((float(entry.get("timestep", "0")), place))
        if root.get("type") != "Collection" or not parts:
            raise InputError(f"is no collection of ParaView with a DataSet for each frame; {_ADVICE}")
    series: list[Series] = []
    for entries in parts.values():
        entries.sort(key=lambda entry: entry[0])
        times, files = [time for time, _ in entries], [file for _, file in entries]
        series.append(FileSeries(path.name if len(parts) == 1 else series_name(files), files, times, **options))
    return series
