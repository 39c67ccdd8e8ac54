"""Loaders of the published sample queries and meshes, which the project reads where they are present.

The folder is `../shared/data` beside the repository, or what the environment variable CCD_WARP_DATA names; its README
states the formats.

References:
    Wang et al., "A Large-scale Benchmark and an Inclusion-based Algorithm for Continuous Collision Detection", 2021.
    Belgrod et al., "Time of Impact Dataset for Continuous Collision Detection and a Scalable Conservative Algorithm",
    2023.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

DATA = Path(os.environ.get("CCD_WARP_DATA", Path(__file__).resolve().parents[1].parent / "shared" / "data"))

requires_data = pytest.mark.skipif(
    not (DATA / "handcrafted").is_dir() or not (DATA / "simulation").is_dir(),
    reason="the published sample data is absent: set CCD_WARP_DATA to its folder",
)

_SHORT = {"vertex-face": "vf", "edge-edge": "ee"}


@dataclass(frozen=True)
class PublishedQueries:
    """Queries of one scene and kind.

    Attributes:
        name: Scene and file, for messages.
        kind: "vertex-face" or "edge-edge".
        points_t0: Positions at the start of the step, float64, shape [n, 4, 3].
        points_t1: Positions at its end, same shape.
        truth: Whether the query collides, as published, bool, shape [n].
        ids: Which query it is, "file:number", length n.
    """

    name: str
    kind: str
    points_t0: np.ndarray
    points_t1: np.ndarray
    truth: np.ndarray
    ids: list[str]

    def __len__(self) -> int:
        return len(self.truth)


@dataclass(frozen=True)
class SimulationStep:
    """A mesh at both ends of a step.

    Attributes:
        vertices_t0: Positions at the start, float64, shape [V, 3].
        vertices_t1: Positions at the end, same shape.
        faces: Vertex indices, int32, shape [F, 3].
    """

    vertices_t0: np.ndarray
    vertices_t1: np.ndarray
    faces: np.ndarray


def exact_floats(numerators: list[int], denominators: list[int], where: str) -> np.ndarray:
    """Rationals as float64; a ValueError where one of them is not exactly a float64."""
    values = np.array([n / d for n, d in zip(numerators, denominators, strict=True)])
    for value, n, d in zip(values.tolist(), numerators, denominators, strict=True):
        p, q = value.as_integer_ratio()
        if p * d != n * q:
            raise ValueError(f"{where} holds {n}/{d}; expected a rational that is exactly a float64")
    return values


def _read_csv(path: Path, columns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both frames, [n, 4, 3] each, and the last column of the first row of each query (truth, where there is one)."""
    rows = [tuple(map(int, line.split(","))) for line in path.read_text().split()]
    if len(rows) % 8 or any(len(row) != columns for row in rows):
        raise ValueError(f"{path.name} has {len(rows)} rows; expected 8 a query with {columns} columns each")
    numerators = [row[k] for row in rows for k in (0, 2, 4)]
    denominators = [row[k] for row in rows for k in (1, 3, 5)]
    points = exact_floats(numerators, denominators, path.name).reshape(-1, 2, 4, 3)
    last = np.array([row[-1] for row in rows], dtype=object).reshape(-1, 8)
    if columns == 7 and not (last == last[:, :1]).all():
        raise ValueError(f"{path.name} states two truths for one query")
    return np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1]), last[:, 0]


def handcrafted_scenes() -> list[str]:
    """Names of the handcrafted scenes that are present."""
    return sorted(p.name for p in (DATA / "handcrafted").glob("*") if p.is_dir())


def simulation_scenes() -> list[str]:
    """Names of the simulation scenes that are present."""
    return sorted(p.name for p in (DATA / "simulation").glob("*") if p.is_dir())


def handcrafted_queries(scene: str, kind: str) -> PublishedQueries:
    """All handcrafted queries of one scene and kind ("vertex-face" or "edge-edge")."""
    parts = []
    ids = []
    for path in sorted((DATA / "handcrafted" / scene / kind).glob("*.csv")):
        parts.append(_read_csv(path, 7))
        ids += [f"{scene}/{kind}/{path.name}:{i}" for i in range(len(parts[-1][0]))]
    points_t0, points_t1, truth = (np.concatenate(part) for part in zip(*parts, strict=True))
    return PublishedQueries(f"handcrafted/{scene}", kind, points_t0, points_t1, truth.astype(bool), ids)


def simulation_queries(scene: str, kind: str) -> PublishedQueries:
    """All queries of one simulation scene and kind ("vertex-face" or "edge-edge")."""
    short = _SHORT[kind]
    parts = []
    ids = []
    for path in sorted((DATA / "simulation" / scene / "queries").glob(f"*{short}.csv")):
        points_t0, points_t1, _ = _read_csv(path, 6)
        truth = np.array(json.loads((path.parents[1] / "mma_bool" / f"{path.stem}_mma_bool.json").read_text()), bool)
        if len(truth) != len(points_t0):
            raise ValueError(f"{path.name} has {len(points_t0)} queries and {len(truth)} truths")
        parts.append((points_t0, points_t1, truth))
        ids += [f"{scene}/{path.name}:{i}" for i in range(len(truth))]
    points_t0, points_t1, truth = (np.concatenate(part) for part in zip(*parts, strict=True))
    return PublishedQueries(f"simulation/{scene}", kind, points_t0, points_t1, truth, ids)


def all_queries() -> list[PublishedQueries]:
    """Every published set that is present, handcrafted first."""
    sets = [handcrafted_queries(scene, kind) for scene in handcrafted_scenes() for kind in _SHORT]
    return sets + [simulation_queries(scene, kind) for scene in simulation_scenes() for kind in _SHORT]


def simulation_boxes(scene: str, kind: str) -> np.ndarray:
    """Id pairs of the queries of one simulation scene: vertex v, edge nV + e, face nV + nE + f; int64, shape [n, 2]."""
    paths = sorted((DATA / "simulation" / scene / "boxes").glob(f"*{_SHORT[kind]}.json"))
    return np.concatenate([np.array(json.loads(path.read_text()), np.int64).reshape(-1, 2) for path in paths])


def simulation_step(scene: str) -> SimulationStep:
    """The mesh of one simulation scene at both ends of its step; the frames are in the order of their numbers."""
    import trimesh  # a slow import that most tests do without

    paths = sorted((DATA / "simulation" / scene / "frames").glob("*.ply"), key=lambda p: int(p.stem))
    if len(paths) != 2:
        raise ValueError(f"{scene} has {len(paths)} frames; expected 2")
    start, end = (trimesh.load(path, process=False) for path in paths)
    if not np.array_equal(start.faces, end.faces):
        raise ValueError(f"{scene}: the faces of the two frames differ")
    return SimulationStep(
        np.array(start.vertices, dtype=np.float64),
        np.array(end.vertices, dtype=np.float64),
        np.array(start.faces, dtype=np.int32),
    )


def edges_by_max(faces: np.ndarray) -> np.ndarray:
    """Unique edges (min, max), sorted by (max, min): the order behind the ids of `simulation_boxes`, shape [E, 2]."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(edges[:, ::-1], axis=0)[:, ::-1]
