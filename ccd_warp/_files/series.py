"""Sequences of frames of moving bodies: mesh files in natural order, caches of positions, series of VTK and XDMF."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ccd_warp._files.caches import NpzSeries, XdmfSeries, open_xdmf
from ccd_warp._files.mesh import CELL_SUFFIXES, MESH_SUFFIXES, Mesh, read_mesh
from ccd_warp._files.natural import grouped_frames, natural_key, series_name
from ccd_warp._files.opened import read_file
from ccd_warp._files.parts import Split
from ccd_warp._input.messages import InputError

_ADVICE = "give mesh files, a folder of them, a .npz of positions, a .pvd or an .xdmf"


class Series(Protocol):
    """The frames of one file or of several, which move together."""

    @property
    def name(self) -> str:
        """What to call them."""

    @property
    def labels(self) -> list[str]:
        """Name of each frame."""

    @property
    def times(self) -> list[float] | None:
        """Time of each frame; None where the files do not say it."""

    @property
    def files(self) -> list[Path]:
        """The files that hold them."""

    def read(self, k: int) -> Mesh:
        """Frame ``k``, completely or not at all."""


@dataclass
class FileSeries:
    """A mesh file for each frame."""

    name: str
    files: list[Path]
    max_bytes: int
    displacement: str | None = None
    surface: bool = False
    times: list[float] | None = None
    split: Split = False

    @property
    def labels(self) -> list[str]:
        """Names of the files."""
        return [path.name for path in self.files]

    def read(self, k: int) -> Mesh:
        """The mesh of file ``k``."""
        split = self.split if k == 0 else False
        return read_mesh(self.files[k], self.max_bytes, self.displacement, self.surface, split)


def find_series(
    paths: Sequence[Path],
    *,
    max_bytes: int,
    displacement: str | None = None,
    faces: Path | None = None,
    surface: bool = False,
    split: Split = False,
) -> list[Series]:
    """The frames that files, folders and caches hold, one series for each that moves.

    Args:
        paths: Mesh files, which are grouped by their names as in :func:`grouped_frames`; folders, each as if its files
            had been given; and caches: ``.npz``, ``.pvd``, ``.xdmf``.
        max_bytes: Limit on the unpacked size of an archive.
        displacement: Field of displacements that VTK and XDMF files hold.
        faces: Mesh file whose faces a ``.npz`` without faces takes.
        surface: Whether volume cells in VTK and XDMF files stand for their boundary surface.
        split: How their cells are to be split; the first frame has the parts.

    Raises:
        InputError: If a path is missing or not known, or they differ in the number of frames, or hold fewer than two.
    """
    frames: list[Path] = []
    series: list[Series] = []

    def add(path: Path) -> None:
        suffix = path.suffix.lower()
        if suffix == ".npz":
            series.append(NpzSeries.open(path, max_bytes, faces, split))
        elif suffix == ".pvd":
            series.extend(_pvd_series(path, max_bytes, displacement, surface, split))
        elif suffix in (".xdmf", ".xmf") and (xdmf := open_xdmf(path, max_bytes)).is_series:
            series.append(XdmfSeries.open(xdmf, displacement, surface, split))
        else:
            frames.append(path)

    def add_frames() -> None:
        for group in grouped_frames(frames) if frames else ():
            series.append(FileSeries(series_name(group), group, max_bytes, displacement, surface, None, split))
        frames.clear()

    for path in paths:
        if path.is_dir():
            add_frames()
            for each in _files_of(path):
                add(each)
            add_frames()
        elif path.exists():
            add(path)
        else:
            raise InputError(f"{path}: no such file or folder; {_ADVICE}")
    add_frames()
    if not series:
        raise InputError(f"no frames are given; {_ADVICE}")
    for other in series:
        if len(other.labels) != len(series[0].labels):
            raise InputError(
                f"{other.name} has {len(other.labels)} frames, and {series[0].name} has {len(series[0].labels)}; "
                "expected the same number for all that move, and --static for what does not"
            )
    times = [each.times for each in series if each.times is not None]
    if any(other != times[0] for other in times):
        raise InputError("the times of the bodies differ; expected the same time for all in each frame")
    if len(series[0].labels) < 2:
        raise InputError(f"{series[0].name} has {len(series[0].labels)} frame; expected two or more")
    return series


def _files_of(folder: Path) -> list[Path]:
    """The frames or the caches in a folder, in natural order; other files are passed over."""
    known = [
        path
        for path in sorted(folder.iterdir(), key=lambda path: natural_key(path.name))
        if not path.is_dir() and not path.name.startswith(".")
    ]
    caches = [path for path in known if path.suffix.lower() in (".npz", ".pvd")]
    frames = [path for path in known if path.name.lower().endswith((*MESH_SUFFIXES, *CELL_SUFFIXES))]
    if caches and frames:
        raise InputError(f"{folder}: holds {frames[0].name} as well as {caches[0].name}; give what you mean by name")
    if not caches and not frames:
        raise InputError(f"{folder}: holds no frames; {_ADVICE}")
    return caches or frames


def _pvd_series(path: Path, max_bytes: int, displacement: str | None, surface: bool, split: Split) -> list[Series]:
    """The series of a collection of ParaView: a body for each part, with a file for each time."""
    try:
        root = ET.fromstring(read_file(path, max_bytes))
    except (ET.ParseError, LookupError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: its XML cannot be read ({error}); write it again") from error
    parts: dict[tuple[str, str], list[tuple[float, Path]]] = {}
    for entry in root.iter("DataSet"):
        try:
            time, name = float(entry.get("timestep", "0")), entry.attrib["file"]
        except (KeyError, ValueError) as error:
            raise InputError(f"{path}: a DataSet has no file, or a time that is no number; write it again") from error
        part = (entry.get("group", ""), entry.get("part", "0"))
        parts.setdefault(part, []).append((time, path.parent / name))
    if root.get("type") != "Collection" or not parts:
        raise InputError(f"{path}: is no collection of ParaView with a DataSet for each frame; {_ADVICE}")
    series: list[Series] = []
    for entries in parts.values():
        entries.sort(key=lambda entry: entry[0])
        times, files = [time for time, _ in entries], [file for _, file in entries]
        name = path.name if len(parts) == 1 else series_name(files)
        series.append(FileSeries(name, files, max_bytes, displacement, surface, times, split))
    return series
