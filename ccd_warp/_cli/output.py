"""Write the result of a step as NPZ or JSON: the same tables; ``docs/command_line.md`` describes what they hold."""

import json
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._cli.contacts import primitives_in_body, vertices_in_body
from ccd_warp._cli.process import STDOUT, write_out
from ccd_warp._cli.report import left_out
from ccd_warp._cli.solve import SolvedStep
from ccd_warp._runtime.status import CCDStatus, PairKind
from ccd_warp._runtime.version import __version__
from ccd_warp._scene.input.messages import InputError

RESULT_SUFFIXES = (".npz", ".json")
_KINDS = np.array([kind.name.lower() for kind in PairKind])
_STATUSES = np.array([status.name.lower() for status in CCDStatus])
Table = dict[str, NDArray[Any]]


def write_result(path: Path, step: SolvedStep) -> None:
    """Write the result of a step: contacts by ascending toi, and the toi of every vertex, body and of the scene.

    Floats read back bit for bit; "no collision" is ``inf``, and null in JSON, which has no infinity.

    Args:
        path: ``.npz``, with the faces and edges of the mesh, or ``.json``; ``-`` is JSON on standard output.
        step: The step.

    Raises:
        InputError: If the file cannot be written.
    """
    about, tables = _about(step), _tables(step)
    try:
        if path != STDOUT and path.suffix.lower() == ".npz":
            arrays: dict[str, Any] = {"faces": step.mesh.faces, "edges": step.mesh.edges}
            arrays |= {name: json.dumps(value) if isinstance(value, dict) else value for name, value in about.items()}
            arrays |= {f"{name}_{column}": values for name, table in tables.items() for column, values in table.items()}
            with path.open("wb") as file:  # given a name, NumPy would add a second suffix to RESULT.NPZ
                np.savez_compressed(file, **arrays)
            return
        about["toi"] = _plain(np.array([about["toi"]]))[0]
        columns = {name: {column: _plain(x) for column, x in table.items()} for name, table in tables.items()}
        text = json.dumps(about | columns, indent=1, allow_nan=False) + "\n"
        if path == STDOUT:
            write_out(text, sys.stdout)
        else:
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write {path} ({error.strerror or error})") from error


def _plain(values: NDArray[Any]) -> list[Any]:
    """A column as JSON holds it."""
    if values.dtype.kind == "f" and values.ndim == 1:
        return [value if np.isfinite(value) else None for value in values.tolist()]
    return list(values.tolist())


def _about(step: SolvedStep) -> dict[str, Any]:
    """What is said of the whole step, as JSON holds it; in NPZ a dictionary is a JSON text."""
    options = {field.name: getattr(step.options, field.name) for field in fields(step.options)}
    kinds, device = options["pair_kinds"], options["device"]
    options["pair_kinds"] = None if kinds is None else [kind.name.lower() for kind in step.options.kinds]
    options["device"] = None if device is None else str(device)
    counts = {field.name: getattr(step.result.counts, field.name) for field in fields(step.result.counts)}
    return {
        "version": __version__,
        "options": options,
        "units": {"length": "that of the files", "toi": "fraction of the step", "seconds": "s"},
        "left_out": left_out(step.mesh, step.options, step.ignored),
        "counts": {
            name: {kind.name.lower(): count for kind, count in value.items()} if isinstance(value, dict) else value
            for name, value in counts.items()
        },
        "timings": {**step.timings, "total": sum(step.timings.values())},
        "toi": float(step.result.toi),
    }


def _tables(step: SolvedStep) -> dict[str, Table]:
    """The tables of a step, each of columns of one length."""
    mesh, result, contacts = step.mesh, step.result, step.result.contacts.sorted_by_toi()
    names = np.array(mesh.names)
    tables: dict[str, Table] = {
        "body": {
            "name": names,
            "static": mesh.static,
            "kinematic": mesh.kinematic,
            "first_vertex": mesh.body_vertex_range[:-1].astype(np.int64),
            "vertices": np.diff(mesh.body_vertex_range),
            "faces": np.bincount(mesh.face_body, minlength=mesh.num_bodies),
            "toi": result.body_toi,
        },
        "vertex": {
            "body": mesh.vertex_body,
            "source_index": step.frames.source_index,
            "toi": result.vertex_toi,
        },
        "contact": {
            "toi": contacts.toi,
            "kind": _KINDS[contacts.kind],
            "bodies": names[contacts.bodies],
            "point": contacts.points,
            "primitives": contacts.primitives,
            "vertices": contacts.vertices.astype(np.int64),
            "primitives_in_body": primitives_in_body(mesh, contacts),
            "vertices_in_body": vertices_in_body(mesh, contacts),
            "parameters": contacts.parameters,
            "normal": contacts.normal,
            "status": _STATUSES[contacts.status],
            "gap": contacts.gap,
            "width": contacts.width,
        },
        "crossing": {
            "primitives": step.crossing.primitives,
            "bodies": names[step.crossing.bodies],
            "point": step.crossing.points,
        },
        "plane": {"body": names[mesh.planes.bodies], "point": mesh.planes.points, "normal": mesh.planes.normals},
    }
    if mesh.radius is not None:
        tables["vertex"]["radius"] = mesh.radius
    return tables
