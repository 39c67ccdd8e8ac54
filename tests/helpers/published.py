"""The published sample queries and meshes, which the project reads where they are present.

The folder is `../shared/data` beside the repository, or what the environment variable CCD_WARP_DATA names; its README
states the formats, `public_data` reads them.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from public_data import Queries, Step, find_queries, find_steps, read_boxes, read_step

DATA = Path(os.environ.get("CCD_WARP_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))

requires_data = pytest.mark.skipif(
    not (DATA / "handcrafted").is_dir() or not (DATA / "simulation").is_dir(),
    reason="the published sample data is absent: set CCD_WARP_DATA to its folder",
)


@cache
def _sets() -> dict[tuple[str, str], Queries]:
    return {(queries.name, queries.kind): queries for queries in find_queries(DATA)}


def handcrafted_scenes() -> list[str]:
    """Names of the handcrafted scenes that are present."""
    return sorted(p.name for p in (DATA / "handcrafted").glob("*") if p.is_dir())


def simulation_scenes() -> list[str]:
    """Names of the simulation scenes that are present."""
    return sorted(p.name for p in (DATA / "simulation").glob("*") if p.is_dir())


def handcrafted_queries(scene: str, kind: str) -> Queries:
    """All handcrafted queries of one scene and kind ("vertex-face" or "edge-edge")."""
    return _sets()[f"handcrafted/{scene}", kind]


def simulation_queries(scene: str, kind: str) -> Queries:
    """All queries of one simulation scene and kind ("vertex-face" or "edge-edge")."""
    return _sets()[f"simulation/{scene}", kind]


def all_queries() -> list[Queries]:
    """Every published set that is present, handcrafted first."""
    return list(_sets().values())


def simulation_boxes(scene: str, kind: str) -> np.ndarray:
    """Id pairs of the queries of one simulation scene: vertex v, edge nV + e, face nV + nE + f; int64, shape [n, 2]."""
    short = {"vertex-face": "vf", "edge-edge": "ee"}[kind]
    paths = sorted((DATA / "simulation" / scene / "boxes").glob(f"*{short}.json"))
    return np.concatenate([read_boxes(path) for path in paths])


def simulation_step(scene: str) -> Step:
    """The mesh of one simulation scene at both ends of its step."""
    return read_step(*find_steps(DATA)[f"simulation/{scene}"])
