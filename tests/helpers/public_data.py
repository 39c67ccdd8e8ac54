"""The public sample data of continuous collision detection, read exactly: queries, their truth, boxes, frames.

    SCENE/{edge-edge,vertex-face}/*.csv      handcrafted queries with their truth, 7 columns
    SCENE/queries/STEM{ee,vf}.csv            queries of a simulation, 6 columns
    SCENE/mma_bool/STEM{ee,vf}_mma_bool.json their truth
    SCENE/boxes/STEM{ee,vf}.json             their primitives
    SCENE/frames/*.ply                       the mesh at both ends of the step

References: Wang et al., "A Large-scale Benchmark and an Inclusion-based Algorithm for Continuous Collision Detection",
2021; Belgrod et al., "Time of Impact Dataset for Continuous Collision Detection and a Scalable Conservative Algorithm",
2023.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import ccd_warp as ccd

ROWS = 8  # of a query: four points at the start, four at the end
_KINDS = {"vf": "vertex-face", "ee": "edge-edge"}


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
            kind = _KINDS[path.stem[-2:]] if part == "queries" else part
            sets.setdefault((part == "queries", _scene(path, folder), kinds.index(kind)), []).append(path)
    if not sets:
        raise ValueError(f"{folder} holds no queries in folders {', '.join(kinds)} or queries")
    found = []
    for (_, name, k), paths in sorted(sets.items()):
        starts, ends, truths = zip(*map(read_queries, paths), strict=True)
        truth = None if truths[0] is None else np.concatenate(truths)
        found.append(Queries(name, kinds[k], np.concatenate(starts), np.concatenate(ends), truth))
    return found


def _under(folder: Path, pattern: str) -> list[Path]:
    """The files of the scenes of a folder: in itself, its children or their children."""
    return sorted(path for depth in ("", "*/", "*/*/") for path in folder.glob(depth + pattern))


def read_queries(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Both ends of the queries of a file, float64, shape [n, 4, 3] each, and their truth, bool, shape [n], or None.

    A row is a point: integers ``xn,xd,yn,yd,zn,zd``, each coordinate the rational n/d, and perhaps the truth; elsewhere
    that is in a file of its own.
    """
    rows = [[*map(int, row.split(","))] for row in path.read_text("utf-8-sig").splitlines() if row]
    if len(rows) % ROWS:
        raise ValueError(f"{path}: has {len(rows)} rows; expected {ROWS} a query")
    ends = np.array([[_exact(*row[k : k + 2]) for k in (0, 2, 4)] for row in rows]).reshape(-1, 2, 4, 3)
    beside = path.parents[1] / "mma_bool" / f"{path.stem}_mma_bool.json"
    truth = None
    if path.parent.name == "queries" and beside.is_file():
        truth = np.array(json.loads(beside.read_bytes()), dtype=bool)
    elif rows and len(rows[0]) == 7:
        truth = np.array([row[6] == 1 for row in rows[::ROWS]])
    if truth is not None and len(truth) != len(ends):
        raise ValueError(f"{beside} has {len(truth)} truths; expected {len(ends)}, one a query of {path}")
    return ends[:, 0].copy(), ends[:, 1].copy(), truth


def _exact(n: int, d: int) -> float:
    """A rational as float64; a ValueError where it is none."""
    p, q = (n / d).as_integer_ratio()  # rounded once, to nearest
    if p * d != n * q:
        raise ValueError(f"{n}/{d} is no float64")
    return n / d


def read_boxes(path: Path) -> np.ndarray:
    """Ids of both primitives of each query, int64, shape [n, 2].

    In a mesh of V vertices and E edges, vertex v has the id v, edge e of ``CollisionMesh.edges`` the id V + e, and face
    f the id V + E + f.
    """
    return np.array(json.loads(path.read_bytes()), dtype=np.int64).reshape(-1, 2)


def find_steps(folder: Path) -> dict[str, tuple[Path, ...]]:
    """Both frames of the step of each scene under a folder, by its name, in the order of their numbers."""
    scenes: dict[str, list[Path]] = {}
    for path in sorted(_under(folder, "frames/*.ply"), key=lambda path: int(path.stem)):
        scenes.setdefault(_scene(path, folder), []).append(path)
    return {name: tuple(paths) for name, paths in sorted(scenes.items())}


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
