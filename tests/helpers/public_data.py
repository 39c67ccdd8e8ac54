"""The public sample data of continuous collision detection, read exactly or not at all: queries, truth, boxes, frames.

    SCENE/{edge-edge,vertex-face}/*.csv      handcrafted queries with their truth, 7 columns
    SCENE/queries/STEM{ee,vf}.csv            queries of a simulation, 6 columns
    SCENE/mma_bool/STEM{ee,vf}_mma_bool.json their truth
    SCENE/boxes/STEM{ee,vf}.json             their primitives
    SCENE/frames/*.ply                       the mesh at both ends of the step

A damaged file is a ValueError that names it, and of a query its line. References: Wang et al., "A Large-scale Benchmark
and an Inclusion-based Algorithm for Continuous Collision Detection", 2021; Belgrod et al., "Time of Impact Dataset for
Continuous Collision Detection and a Scalable Conservative Algorithm", 2023.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import ccd_warp as ccd

ROWS = 8  # of a query: four points at the start, four at the end
_KINDS = {"vf": "vertex-face", "ee": "edge-edge"}
_RATIO = rb"(-?[0-9]+), *([0-9]+)"
_ROW = re.compile(rb", *".join([_RATIO] * 3) + rb"(?:, *([01]))?")


@dataclass(frozen=True, eq=False)
class Queries:
    """Queries of one kind and scene, in the order of their files.

    Attributes:
        name: The scene, such as "handcrafted/erleben-spikes".
        kind: "vertex-face" or "edge-edge".
        points_t0: Positions at the start, v, f0, f1, f2 or ea0, ea1, eb0, eb1, float64, shape [n, 4, 3].
        points_t1: Positions at the end.
        truth: Whether the query collides, as published, shape [n]; None where that is not known.
    """

    name: str
    kind: str
    points_t0: np.ndarray
    points_t1: np.ndarray
    truth: np.ndarray | None

    def __len__(self) -> int:
        return len(self.points_t0)


def find_queries(folder: Path) -> list[Queries]:
    """All queries under a folder, one set for each scene and kind, handcrafted scenes first, vertex-face first."""
    sets: dict[tuple[bool, str, int], list[Path]] = {}
    kinds = list(_KINDS.values())
    for part in (*kinds, "queries"):
        for path in _under(folder, f"{part}/*.csv"):
            kind = _KINDS.get(path.stem[-2:], "") if part == "queries" else part
            if not kind:
                raise ValueError(f"{path}: its name says no kind of queries; expected one that ends in vf or ee")
            sets.setdefault((part == "queries", _scene(path, folder), kinds.index(kind)), []).append(path)
    if not sets:
        raise ValueError(f"{folder} holds no queries in folders {', '.join(kinds)} or queries")
    found = []
    for (_, name, k), paths in sorted(sets.items()):
        starts, ends, truths = zip(*map(_with_truth, paths), strict=True)
        if len({truth is None for truth in truths}) != 1:
            raise ValueError(f"the truth of some files of {name}, {kinds[k]}, is not known; expected it of all or none")
        truth = None if truths[0] is None else np.concatenate(truths)
        found.append(Queries(name, kinds[k], np.concatenate(starts), np.concatenate(ends), truth))
    return found


def _under(folder: Path, pattern: str) -> list[Path]:
    """The files of the scenes of a folder: in itself, its children or their children."""
    return sorted(path for depth in ("", "*/", "*/*/") for path in folder.glob(depth + pattern))


def _with_truth(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """The queries of a file, with the truth of the file that belongs to it."""
    start, end, truth = read_queries(path)
    beside = path.parents[1] / "mma_bool" / f"{path.stem}_mma_bool.json"
    if path.parent.name == "queries" and beside.is_file():
        if truth is not None:
            raise ValueError(f"{path} has 7 columns, the truth among them; expected 6 with the truth of {beside}")
        truth = read_truth(beside)
        if len(truth) != len(start):
            raise ValueError(f"{beside} has {len(truth)} truths; expected {len(start)}, one a query of {path}")
    return start, end, truth


def read_queries(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Points of the queries of a file at both ends, [n, 4, 3], and their truth, [n], where the file has 7 columns.

    A row is a point: decimal integers ``xn,xd,yn,yd,zn,zd``, each coordinate the rational n/d, and the truth. Commas
    may be followed by blanks. Some published files have no line end at their end, so that a file which is cut within
    its very last number cannot be told from a whole one.
    """
    rows = path.read_bytes().removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").rstrip(b"\n").split(b"\n")
    rows = rows if rows != [b""] else []
    if len(rows) % ROWS:
        raise ValueError(f"{path}: has {len(rows)} rows; expected {ROWS} a query")
    points, truths = np.empty((len(rows), 3)), []
    for k, row in enumerate(rows):
        try:
            *fields, truth = _ROW.fullmatch(row).groups()
            points[k] = [_exact(int(n), int(d)) for n, d in zip(fields[::2], fields[1::2], strict=True)]
        except (AttributeError, ValueError):  # of int() for more digits than a float64 has
            expected = "three float64, each as two integers, and the truth, 0 or 1, in all rows or none"
            raise ValueError(f"{path}, line {k + 1}: {row[:80]!r}; expected {expected}") from None
        truths.append(truth)
    of_query = [{*truths[k : k + ROWS]} for k in range(0, len(rows), ROWS)]
    if any(len(found) > 1 or (None in found) != (truths[0] is None) for found in of_query):
        raise ValueError(f"{path}: expected one truth a query, or none of all")
    ends = points.reshape(-1, 2, 4, 3)
    truth = None if not truths or truths[0] is None else np.array([found == {b"1"} for found in of_query])
    return ends[:, 0].copy(), ends[:, 1].copy(), truth


def _exact(n: int, d: int) -> float:
    """A rational as float64; a ValueError where it is none."""
    try:
        p, q = (n / d).as_integer_ratio()  # rounded once, to nearest
    except ArithmeticError as error:
        raise ValueError from error
    if p * d != n * q:
        raise ValueError
    return n / d


def read_truth(path: Path) -> np.ndarray:
    """Which queries of a simulation collide, shape [n]."""
    entries = _list(path)
    if not all(type(entry) is bool for entry in entries):
        raise ValueError(f"{path} holds other entries than true and false")
    return np.array(entries, dtype=bool)


def read_boxes(path: Path) -> np.ndarray:
    """Ids of both primitives of each query, int64, shape [n, 2].

    In a mesh of V vertices and E edges, vertex v has the id v, edge e of ``CollisionMesh.edges`` the id V + e, and face
    f the id V + E + f.
    """
    pairs = _list(path)
    for pair in pairs:
        if not (type(pair) is list and len(pair) == 2 and all(type(x) is int and 0 <= x < 1 << 63 for x in pair)):
            raise ValueError(f"{path} holds {str(pair)[:80]}; expected two ids, integers from 0")
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _list(path: Path) -> list:
    try:
        entries = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} cannot be read as JSON ({error})") from None
    if type(entries) is not list:
        raise ValueError(f"{path} holds no list")
    return entries


def find_steps(folder: Path) -> dict[str, tuple[Path, Path]]:
    """Both frames of the step of each scene under a folder, by its name, in the order of their numbers."""
    scenes: dict[str, list[Path]] = {}
    for path in _under(folder, "frames/*.ply"):
        scenes.setdefault(_scene(path, folder), []).append(path)
    for name, paths in scenes.items():
        if len(paths) != 2 or not all(path.stem.isdecimal() for path in paths):
            raise ValueError(f"{name} has the frames {[path.name for path in paths]}; expected two, named by numbers")
    return {name: tuple(sorted(paths, key=lambda path: int(path.stem))) for name, paths in sorted(scenes.items())}


@dataclass(frozen=True, eq=False)
class Step:
    """The mesh at both ends of a step, in the order of its files."""

    vertices_t0: np.ndarray
    vertices_t1: np.ndarray
    faces: np.ndarray


def read_step(start: Path, end: Path) -> Step:
    """The step between two mesh files."""
    frames = ccd.read_frames(start, end)
    return Step(frames.vertices_t0, frames.vertices_t1, frames.mesh.faces)


def _scene(path: Path, folder: Path) -> str:
    """The name of the scene of a file, as seen from a folder, or its own name where it is that folder."""
    scene = path.parents[1].resolve()
    return scene.name if scene == folder.resolve() else scene.relative_to(folder.resolve()).as_posix()
