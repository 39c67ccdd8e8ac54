"""Pairs that are left out, from a file: ``--exclude FILE``."""

import csv
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp._files.archive import MAX_BYTES
from ccd_warp._input.excluded_pairs import KEYS
from ccd_warp._input.messages import InputError
from ccd_warp._mesh import CollisionMesh

_ROW = "expected rows KEY,A,B, as vertices,12,340 or bodies,cloth,wall"


def read_exclusions(path: Path, mesh: CollisionMesh) -> CollisionMesh:
    """The mesh without the pairs of a file.

    A ``.npz`` holds an array of shape [k, 2] by each key of ``CollisionMesh.excluding``, a ``.npy`` one of pairs of
    vertices; any other file rows of text, ``KEY,A,B``, with names or indices of bodies, and ``#`` before a remark.

    Raises:
        InputError: If it cannot be read, or its pairs are not pairs of such parts of the mesh.
    """
    if not path.is_file():
        raise InputError(f"--exclude {path}: no such file")
    try:
        return mesh.excluding(_pairs_in(path, mesh))
    except InputError:
        raise
    except (OSError, ValueError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise InputError(f"--exclude {path}: {reason}") from error


def _pairs_in(path: Path, mesh: CollisionMesh) -> dict[str, Any]:
    suffix = path.suffix.lower()
    if suffix == ".npz":
        from ccd_warp._files.npz import npz_arrays

        return npz_arrays(path, MAX_BYTES)
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"--exclude {path}: has {path.stat().st_size:,} bytes; expected at most {MAX_BYTES:,}")
    if suffix == ".npy":
        return {"vertices": np.load(path, allow_pickle=False)}
    pairs: dict[str, list[list[int]]] = {}
    with path.open(encoding="utf-8", newline="") as file:
        rows = csv.reader(file, skipinitialspace=True, strict=True)
        for row in rows:
            if not any(row) or row[0].startswith("#"):
                continue
            if len(row) != 3 or row[0].strip() not in KEYS:
                raise InputError(f"--exclude {path}: line {rows.line_num} is {','.join(row)!r}; {_ROW}")
            key, *pair = (cell.strip() for cell in row)
            known = mesh.names if key == "bodies" else ()
            try:
                pairs.setdefault(key, []).append([known.index(cell) if cell in known else int(cell) for cell in pair])
            except ValueError:
                names = f"; bodies are {', '.join(mesh.names[:8])}" if key == "bodies" else ""
                raise InputError(
                    f"--exclude {path}: line {rows.line_num} is {','.join(row)!r}; {_ROW}{names}"
                ) from None
    return pairs
