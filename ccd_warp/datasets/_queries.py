"""Queries of the public data: vertex-face and edge-edge pairs with their truth, read file by file or by folder."""

import numbers
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ccd_warp._display import counted
from ccd_warp._input.arguments import (
    check_choice,
    check_count,
    check_flag,
    check_items,
    check_path,
    check_unmasked,
    shown,
)
from ccd_warp._input.arrays import as_array, as_float64
from ccd_warp.datasets._csv import read_csv, write_csv
from ccd_warp.datasets._json import read_truth
from ccd_warp.datasets._paths import DEPTHS, root_folder, scene_name

if TYPE_CHECKING:
    from ccd_warp._status import PairKind

_KINDS = ("vertex-face", "edge-edge")
_SHORT = {"vf": "vertex-face", "ee": "edge-edge"}


@dataclass(frozen=True, eq=False)
class Queries:
    """Queries of one kind, in the order of their files.

    Attributes:
        name: Name of the scene, for tables and messages.
        kind: "vertex-face" or "edge-edge"; the constructor also takes a `PairKind`, "vertex_face" and "edge_edge".
        points_t0: Positions at the start of the step, in the file's length unit, float64, shape [n, 4, 3]. The points
            are v, f0, f1, f2 or ea0, ea1, eb0, eb1.
        points_t1: Positions at its end, same shape.
        truth: Whether the query collides, as published, bool, shape [n]; None where that is not known.
        sources: Label of each file and the number of queries from it.
    """

    name: str
    kind: str
    points_t0: np.ndarray
    points_t1: np.ndarray
    truth: np.ndarray | None
    sources: tuple[tuple[str, int], ...]

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise ValueError(f"name is {shown(self.name)}; expected a text")
        object.__setattr__(self, "kind", _check_kind(self.kind))
        _check_points(self.points_t0, self.points_t1, self.truth)
        counted = _counted(self.sources)
        if counted != len(self.points_t0):
            raise ValueError(f"sources count {counted} queries; expected {len(self.points_t0)} like points_t0")

    def __len__(self) -> int:
        return len(self.points_t0)

    def __repr__(self) -> str:
        files = counted(len(self.sources), "file", "files")
        hits = "truth not known" if self.truth is None else f"{np.count_nonzero(self.truth):,} collide"
        return f"Queries({shown(self.name)}, {len(self):,} {self.kind}, {hits}, from {files})"

    def id(self, i: int) -> str:
        """Origin of query ``i`` as "label:number", with the label of its file and its number there, from 0."""
        is_index = isinstance(i, numbers.Integral) and not isinstance(i, (bool, np.bool_))
        if not is_index:
            raise ValueError(f"i is {shown(i)}; expected the index of a query")
        if not -len(self) <= i < len(self):
            raise IndexError(f"i is {shown(i)}; expected an index of {len(self)} queries")
        number = range(len(self))[i]
        for label, count in self.sources:
            if number < count:
                return f"{label}:{number}"
            number -= count
        raise AssertionError("sources count every query")

    @classmethod
    def joined(cls, name: str, parts: Sequence["Queries"]) -> "Queries":
        """All queries of several sets as one.

        Args:
            name: Name of the whole.
            parts: One or more sets of one kind; except for empty sets, all with their truth or all without.

        Returns:
            The queries in the order of the parts.

        Raises:
            ValueError: If there is no part, or the parts differ in kind or in whether the truth is known.
        """
        parts = check_items("parts", parts, "sets of queries")
        for part in parts:
            if not isinstance(part, cls):
                raise ValueError(f"parts holds {shown(part)}; expected sets of queries")
        kinds = sorted({part.kind for part in parts})
        if len(kinds) != 1:
            raise ValueError(f"parts of {name} are of the kinds {kinds}; expected one or more parts of one kind")
        filled = [part for part in parts if len(part)] or [parts[0]]
        truths = [part.truth for part in filled if part.truth is not None]
        if 0 < len(truths) < len(filled):
            lacking = next(part for part in filled if part.truth is None)
            raise ValueError(
                f"parts of {name}: the truth of {lacking.sources[0][0]} is not known, that of others is; "
                "expected it of all or of none"
            )
        return cls(
            name,
            kinds[0],
            np.concatenate([part.points_t0 for part in parts]),
            np.concatenate([part.points_t1 for part in parts]),
            np.concatenate(truths) if truths else None,
            tuple(source for part in parts for source in part.sources),
        )


def read_queries(
    path: str | Path,
    *,
    kind: "PairKind | str | None" = None,
    truth: str | Path | None = None,
    progress: bool = False,
) -> Queries:
    """Read one file of queries.

    Args:
        path: CSV file without a header, 8 rows a query, ``xn,xd,yn,yd,zn,zd`` or ``xn,xd,yn,yd,zn,zd,truth``: decimal
            integers of at most 10,000 digits, each coordinate the rational n/d with d > 0. Commas may be followed by
            spaces, and line ends may be LF or CRLF; an empty file holds no query. Some published files have no line
            end at their end, so none is required, and a file truncated within its very last number cannot be
            distinguished from a complete one.
        kind: `PairKind.VERTEX_FACE`, "vertex_face" or "vertex-face", or the same of edge-edge. None takes it from the
            file's folder, if that is called "vertex-face" or "edge-edge", or from the end of the file's name, "vf" or
            "ee".
        truth: JSON file of the truth of queries of 6 columns, see `read_truth`.
        progress: Show a bar on stderr; needs tqdm.

    Returns:
        The queries; their truth is None where neither a column nor ``truth`` states it.

    Raises:
        ValueError: If a line is malformed, an integer is too long, a rational is not exactly a float64, the rows do not
            form whole queries, or one query has two truths; the message names file and line. Also if the kind is
            unknown or the truth does not match.
        OSError: If a file cannot be read.
        ImportError: If ``progress`` is set and tqdm is not installed.

    References:
        Wang et al. 2021; Belgrod et al. 2023.

    Guarantee: every coordinate is the rational of the file, without rounding; after an error nothing is returned. A
    zero has no sign.
    """
    path = check_path("path", path)
    progress = check_flag("progress", progress)
    kind = _kind_of(path) if kind is None else _check_kind(kind)
    with _progress_bar([path], progress) as advance:
        return _read(path, path.name, kind, None if truth is None else check_path("truth", truth), advance)


def write_queries(
    path: str | Path, points_t0: np.ndarray, points_t1: np.ndarray, truth: np.ndarray | None = None
) -> None:
    """Write queries in the public format, which gives their kind only by a name that ends in "vf" or "ee".

    Args:
        path: CSV file, replaced where it exists.
        points_t0: Positions at the start of the step, any length unit, float64, shape [n, 4, 3].
        points_t1: Positions at its end, same shape.
        truth: Whether each query collides, bool, shape [n]; None writes 6 columns instead of 7.

    Raises:
        ValueError: If a shape or dtype does not match, or a coordinate is not finite.
        OSError: If the file cannot be written.

    References:
        Wang et al. 2021; Belgrod et al. 2023.

    Guarantee: `read_queries` returns the same numbers, with -0.0 as 0.0; after an error the file is unchanged.
    """
    path = check_path("path", path)
    expected = "float64 of shape (n, 4, 3)"
    start, end = as_array(points_t0, "points_t0", expected), as_array(points_t1, "points_t1", expected)
    known = None if truth is None else as_array(truth, "truth", "bool of shape (n,)")
    _check_points(start, end, known)
    for name, points, given in (("points_t0", start, points_t0), ("points_t1", end, points_t1)):
        as_float64(points, name, given, row_name="query")
        bad = np.argwhere(~np.isfinite(points))
        if len(bad):
            query, point, axis = bad[0].tolist()
            raise ValueError(
                f"{name}[{query}, {point}, {axis}] is {points[query, point, axis]}; expected finite coordinates"
            )
    write_csv(path, start, end, known)


def find_queries(folder: str | Path, *, kind: "PairKind | str | None" = None, progress: bool = False) -> list[Queries]:
    """Read every query under a folder of public data, whichever part of it was downloaded.

    Args:
        folder: The root of the data, its part "handcrafted" or "simulation", a single scene, or a folder of CSV files
            whose names end in "ee" or "vf".
        kind: Only queries of this kind, given as in `read_queries`. A file whose folder and name say no kind is then
            taken to be of this one.
        progress: Show a bar on stderr; needs tqdm.

    Returns:
        One set for each scene and kind, vertex-face before edge-edge, scenes of handcrafted layout first, sorted by
        name. The names are those of the scenes relative to the folder, such as "handcrafted/erleben-spikes"; the labels
        of the sources are those of the files.

    Raises:
        ValueError: If the folder is missing or holds no query file, or one of the files is malformed, see
            `read_queries`; or if the kind is unknown.
        OSError: If a file cannot be read.
        ImportError: If ``progress`` is set and tqdm is not installed.

    References:
        Wang et al. 2021; Belgrod et al. 2023.
    """
    root = root_folder(folder)
    progress = check_flag("progress", progress)
    wanted = None if kind is None else _check_kind(kind)
    patterns = [f"{depth}{part}/*.csv" for depth in DEPTHS for part in (*_KINDS, "queries")]
    paths = sorted({path for pattern in [*patterns, "*.csv"] for path in root.glob(pattern) if path.is_file()})
    if not paths:
        raise ValueError(
            f"{folder} holds no queries; looked for *.csv in it, and SCENE/edge-edge/*.csv, SCENE/vertex-face/*.csv "
            "and SCENE/queries/*.csv, where SCENE is the folder itself or at most two below it"
        )
    sets: dict[tuple[bool, str, int], list[Path]] = {}
    for path in paths:
        is_simulation = path.parent.name not in _KINDS
        scene = path.parent if is_simulation and path.parent.name != "queries" else path.parent.parent
        stated = _stated_kind(path) or wanted or _kind_of(path)
        if wanted in (None, stated):
            key = (is_simulation, scene_name(scene, root), _KINDS.index(stated))
            sets.setdefault(key, []).append(path)
    found = []
    with _progress_bar([path for members in sets.values() for path in members], progress) as advance:
        for (_, name, k), members in sorted(sets.items()):
            parts = []
            for path in members:
                truth = path.parents[1] / "mma_bool" / f"{path.stem}_mma_bool.json"
                has_truth = path.parent.name == "queries" and truth.is_file()
                label = path.relative_to(root).as_posix()
                parts.append(_read(path, label, _KINDS[k], truth if has_truth else None, advance))
            found.append(Queries.joined(name, parts))
    return found


def _read(path: Path, label: str, kind: str, truth_path: Path | None, advance: Callable[[int], object]) -> Queries:
    points_t0, points_t1, truth = read_csv(path, advance)
    if truth_path is not None:
        if truth is not None:
            raise ValueError(f"{path} has 7 columns, the truth among them; expected 6 with the truth of {truth_path}")
        truth = read_truth(truth_path)
        if len(truth) != len(points_t0):
            raise ValueError(f"{truth_path} has {len(truth)} truths; expected {len(points_t0)}, one a query of {path}")
    return Queries(path.stem, kind, points_t0, points_t1, truth, ((label, len(points_t0)),))


def _stated_kind(path: Path) -> str | None:
    """The kind of a file's queries, from its folder or name; None if neither states it."""
    folder = path.absolute().parent.name
    return folder if folder in _KINDS else _SHORT.get(path.stem[-2:])


def _kind_of(path: Path) -> str:
    """The stated kind of a file's queries, or a ValueError."""
    kind = _stated_kind(path)
    if kind is None:
        raise ValueError(
            f"{path}: neither its folder (vertex-face, edge-edge) nor the end of its name (vf, ee) says the kind of "
            "its queries; expected one of these, or kind= of read_queries and find_queries"
        )
    return kind


def _check_kind(kind: "PairKind | str") -> str:
    """One of `_KINDS`, which may be given as a member of `PairKind` or with an underscore, too."""
    if isinstance(kind, (IntEnum, str)):  # PairKind itself would import Warp, which reading files does not need
        spelled = (kind.name.lower() if isinstance(kind, IntEnum) else kind).replace("_", "-")
        if spelled in _KINDS:
            return spelled
    return check_choice("kind", kind, _KINDS)


def _counted(sources: tuple[tuple[str, int], ...]) -> int:
    """Total number of queries in the sources, or a ValueError."""
    try:
        return sum(check_count("count", count, 2**63 - 1, least=0) for _, count in sources)
    except (TypeError, ValueError):
        raise ValueError(f"sources is {shown(sources)}; expected pairs (label of a file, its queries)") from None


def _check_points(points_t0: np.ndarray, points_t1: np.ndarray, truth: np.ndarray | None) -> None:
    for name, array in (("points_t0", points_t0), ("points_t1", points_t1), ("truth", truth)):
        if not isinstance(array, np.ndarray) and not (name == "truth" and array is None):
            raise ValueError(f"{name} is {shown(array)}; expected a NumPy array")
        check_unmasked(name, array)
    for name, points in (("points_t0", points_t0), ("points_t1", points_t1)):
        if points.dtype != np.float64 or points.ndim != 3 or points.shape[1:] != (4, 3):
            raise ValueError(
                f"{name} is {shown(points.dtype)} of shape {points.shape}; expected float64 of shape (n, 4, 3)"
            )
    if len(points_t0) != len(points_t1):
        raise ValueError(f"points_t1 has shape {points_t1.shape}; expected {points_t0.shape} like points_t0")
    if truth is not None and (truth.dtype != np.bool_ or truth.shape != (len(points_t0),)):
        raise ValueError(
            f"truth is {shown(truth.dtype)} of shape {truth.shape}; expected bool of shape ({len(points_t0)},)"
        )


@contextmanager
def _progress_bar(paths: list[Path], progress: bool) -> Iterator[Callable[[int], object]]:
    """The function to call with the number of bytes read."""
    if not progress:
        yield lambda count: None
        return
    try:
        from tqdm import tqdm
    except ImportError as error:
        raise ImportError("progress=True needs tqdm; pip install 'ccd-warp[bench]'") from error
    with tqdm(total=sum(path.stat().st_size for path in paths), unit="B", unit_scale=True, desc="queries") as bar:
        yield bar.update
