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
_DEPTHS = ("", "*/", "*/*/")  # of the scenes: the folder itself, its children, their children


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
        for path in sorted(path for depth in _DEPTHS for path in folder.glob(f"{depth}{part}/*.csv")):
            kind = _KINDS.get(path.stem[-2:], "") if part == "queries" else part
            if not kind:
                raise ValueError(f"{path}: its name says no kind of queries; expected one that ends in vf or ee")
            key = part == "queries", _scene(path, folder), kinds.index(kind)
            sets.setdefault(key, []).append(path)
    if not sets:
        raise ValueError(f"{folder} holds no queries in folders {', '.join(kinds)} or queries")
    return [_joined(name, kinds[k], paths) for (_, name, k), paths in sorted(sets.items())]


def _joined(name: str, kind: str, paths: list[Path]) -> Queries:
    starts, ends, truths = zip(*map(_read, paths), strict=True)
    if len({truth is None for truth in truths}) != 1:
        raise ValueError(f"the truth of some files of {name}, {kind}, is not known; expected it of all or of none")
    return Queries(
        name, kind, *map(np.concatenate, (starts, ends)), None if truths[0] is None else np.concatenate(truths)
    )


def _read(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
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
    text = path.read_bytes().removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").rstrip(b"\n")
    rows = re.sub(rb", +(?=[-0-9])", b",", text).split(b"\n") if text else []
    columns = rows[0].count(b",") + 1 if rows else 6
    if columns not in (6, 7) or len(rows) % ROWS:
        raise ValueError(
            f"{path}, line {len(rows)}: {len(rows)} rows of {columns} columns; expected 6 or 7, and 8 a query"
        )
    points, truths = np.empty((len(rows), 3)), np.empty(len(rows), dtype=bool)
    for k, row in enumerate(rows):
        try:
            if not re.fullmatch(rb"-?[0-9]+(,-?[0-9]+)*", row) or row.count(b",") + 1 != columns:
                raise ValueError(f"{row[:80]!r} is not {columns} integers")
            fields = row.split(b",")
            points[k] = [_exact(int(n), int(d)) for n, d in zip(fields[0:6:2], fields[1:6:2], strict=True)]
            if columns == 7 and fields[6] not in (b"0", b"1"):
                raise ValueError(f"the truth is {fields[6]!r}; expected 0 or 1")
        except ValueError as error:  # of int() for more digits than a float64 has
            raise ValueError(f"{path}, line {k + 1}: {error}") from None
        truths[k] = fields[-1] == b"1"
    of_query = truths.reshape(-1, ROWS)
    if columns == 7 and (mixed := (of_query != of_query[:, :1]).any(axis=1)).any():
        raise ValueError(f"{path}, line {ROWS * int(np.argmax(mixed)) + 1}: one query has two truths")
    ends = points.reshape(-1, 2, 4, 3)
    return ends[:, 0].copy(), ends[:, 1].copy(), of_query[:, 0].copy() if columns == 7 else None


def _exact(n: int, d: int) -> float:
    """A rational as float64, if it is one."""
    if d <= 0:
        raise ValueError(f"a denominator is {d}; expected a positive integer")
    try:
        value = n / d  # rounded once, to nearest
    except OverflowError:
        value = float("inf")
    p, q = value.as_integer_ratio() if value < float("inf") else (0, 0)
    if not q or p * d != n * q:
        raise ValueError(f"{str(n)[:40]}/{str(d)[:40]} is not a float64")
    return value


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
    for path in sorted(path for depth in _DEPTHS for path in folder.glob(f"{depth}frames/*.ply")):
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
