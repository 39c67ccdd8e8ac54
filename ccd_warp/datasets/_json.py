"""Truth and boxes of the public data: JSON lists with one entry for each query."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp._input.arguments import check_path, shown
from ccd_warp._input.arrays import as_array
from ccd_warp._input.edges import unique_edges
from ccd_warp._texts import text_completed_by
from ccd_warp.datasets._paths import replacing


def read_truth(path: str | Path) -> np.ndarray:
    """Read which queries of a simulation collide.

    Args:
        path: JSON file, a list of booleans.

    Returns:
        One boolean for each query, shape [n].

    Raises:
        ValueError: If the file is not JSON (the message names the line) or not a list of booleans.
        OSError: If the file cannot be read.

    References:
        Belgrod et al. 2023.
    """
    entries = _read_json_list(check_path("path", path))
    for i, entry in enumerate(entries):
        if type(entry) is not bool:
            raise ValueError(f"{path}: entry {i} is {_shown(entry)}; expected true or false")
    return np.array(entries, dtype=bool)


def write_truth(path: str | Path, truth: np.ndarray) -> None:
    """Write which queries of a simulation collide.

    Args:
        path: JSON file, replaced where it exists.
        truth: One boolean for each query, shape [n].

    Raises:
        ValueError: If ``truth`` has another dtype or shape.
        OSError: If the file cannot be written.

    References:
        Belgrod et al. 2023.

    Guarantee: after an error the file is as it was.
    """
    path = check_path("path", path)
    truth = as_array(truth, "truth", "bool of shape (n,)")
    if truth.dtype != np.bool_ or truth.ndim != 1:
        raise ValueError(f"truth is {shown(truth.dtype)} of shape {truth.shape}; expected bool of shape (n,)")
    _write_json(path, truth.tolist())


@text_completed_by(read_truth)
def read_boxes(path: str | Path) -> np.ndarray:
    """Read the primitives of the queries of a simulation.

    Args:
        path: JSON file, a list of pairs of ids.

    Returns:
        Ids of both primitives of each query, int64, shape [n, 2]. In a mesh of V vertices and E edges, vertex v has
        the id v, edge e the id V + e and face f the id V + E + f; see `edges_by_max` for the order of the edges.

    Raises:
        ValueError: If the file is not JSON (the message names the line) or not a list of pairs of ids.
    """
    entries = _read_json_list(check_path("path", path))
    for i, pair in enumerate(entries):
        if not (type(pair) is list and len(pair) == 2 and all(type(x) is int and 0 <= x < 1 << 63 for x in pair)):
            raise ValueError(f"{path}: entry {i} is {_shown(pair)}; expected two ids, integers from 0")
    return np.array(entries, dtype=np.int64).reshape(-1, 2)


@text_completed_by(write_truth)
def write_boxes(path: str | Path, ids: np.ndarray) -> None:
    """Write the primitives of the queries of a simulation.

    Args:
        ids: Ids of both primitives of each query, any integer dtype, shape [n, 2]; see `read_boxes`.

    Raises:
        ValueError: If ``ids`` has another dtype or shape, or holds a negative number.
    """
    path = check_path("path", path)
    ids = as_array(ids, "ids", "integers of shape (n, 2)")
    if ids.dtype.kind not in "iu" or ids.ndim != 2 or ids.shape[1] != 2:
        raise ValueError(f"ids is {shown(ids.dtype)} of shape {ids.shape}; expected integers of shape (n, 2)")
    if ids.size and ids.min() < 0:
        raise ValueError(f"ids holds {ids.min()}; expected integers from 0")
    _write_json(path, ids.tolist())


def edges_by_max(faces: np.ndarray) -> np.ndarray:
    """Edges of a mesh in the order that the ids of `read_boxes` use.

    Args:
        faces: Vertex indices, any integer dtype, shape [F, 3].

    Returns:
        Each edge once, as (min, max) of its vertices, sorted by (max, min), dtype of ``faces``, shape [E, 2]; those of
        ``CollisionMesh``, where a pair (a, a) is not an edge.

    Raises:
        ValueError: If ``faces`` has another dtype or shape.

    References:
        Belgrod et al. 2023.
    """
    faces = as_array(faces, "faces", "integers of shape (F, 3)")
    if faces.dtype.kind not in "iu" or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"faces is {shown(faces.dtype)} of shape {faces.shape}; expected integers of shape (F, 3)")
    # Ranks have the order of the indices, and are small even where the indices are not.
    indices, ranks = np.unique(faces, return_inverse=True)
    edges, _ = unique_edges(ranks.reshape(faces.shape), np.zeros((0, 2), dtype=np.int32))
    return indices[edges]


def _read_json_list(path: Path) -> list[Any]:
    try:
        entries = json.loads(path.read_bytes())
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}, line {error.lineno}: {error.msg}; expected a JSON list") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} cannot be read as JSON ({error}); expected a JSON list") from None
    if type(entries) is not list:
        raise ValueError(f"{path} holds {_shown(entries)}; expected a JSON list")
    return entries


def _write_json(path: Path, entries: list) -> None:
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps(entries, separators=(",", ":")), encoding="ascii")


def _shown(entry: object) -> str:
    text = json.dumps(entry)
    return text if len(text) <= 40 else f"{text[:37]}..."
