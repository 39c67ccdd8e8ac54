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
from ccd_warp._results.results import Counts
from ccd_warp._runtime.status import CCDStatus, PairKind
from ccd_warp._runtime.version import __version__
from ccd_warp._scene.input.messages import InputError
from ccd_warp._scene.input.options import Options

RESULT_SUFFIXES = (".npz", ".json")
_KINDS = [kind.name.lower() for kind in PairKind]
Table = dict[str, NDArray[Any]]


def write_result(path: Path, step: SolvedStep) -> None:
    """Write the result of a step: contacts by ascending toi, and the toi of every vertex, body and of the scene.

    Floats read back bit for bit; "no collision" is ``inf``, and null in JSON, which has no infinity.

    Args:
        path: ``.npz`` (everything) or ``.json`` (all but the mesh); ``-`` is JSON on standard output.
        step: The step.

    Raises:
        InputError: If the file cannot be written.
    """
    about, tables = _about(step), _tables(step)
    if path == STDOUT:
        write_out(_json(about, tables, step.mesh.names), sys.stdout)
        return
    try:
        if path.suffix.lower() == ".json":
            path.write_text(_json(about, tables, step.mesh.names), encoding="utf-8")
            return
        arrays: dict[str, Any] = {"faces": step.mesh.faces, "edges": step.mesh.edges}
        for name, value in about.items():
            arrays[name] = json.dumps(value) if isinstance(value, dict) else value
        for name, table in tables.items():
            arrays |= {f"{name}_{column}": values for column, values in table.items()}
        with path.open("wb") as file:  # given a name, NumPy would add a second suffix to RESULT.NPZ
            np.savez_compressed(file, **arrays)
    except OSError as error:
        raise InputError(f"cannot write {path} ({error.strerror or error})") from error


def _about(step: SolvedStep) -> dict[str, Any]:
    """What is said of the whole step, as JSON holds it; in NPZ a dictionary is a JSON text."""
    return {
        "version": __version__,
        "options": _plain_options(step.options),
        "units": {"length": "that of the files", "toi": "fraction of the step", "seconds": "s"},
        "left_out": left_out(step.mesh, step.options, step.ignored),
        "kind_name": _KINDS,
        "status_name": [status.name.lower() for status in CCDStatus],
        "counts": _plain_counts(step.result.counts),
        "timings": {name: float(seconds) for name, seconds in step.result.timings.items()},
        "toi": float(step.result.toi),
    }


def _tables(step: SolvedStep) -> dict[str, Table]:
    """The tables of a step, each of columns of one length."""
    mesh, result, contacts = step.mesh, step.result, step.result.contacts.sorted_by_toi()
    tables: dict[str, Table] = {
        "body": {
            "name": np.array(mesh.names),
            "static": mesh.static,
            "kinematic": mesh.kinematic,
            "first_vertex": mesh.body_vertex_range[:-1].astype(np.int64),
            "vertices": np.array([len(body.vertices_t0) for body in step.bodies]),
            "faces": np.array([len(body.faces) for body in step.bodies]),
            "toi": result.body_toi,
        },
        "vertex": {
            "body": mesh.vertex_body,
            "source_index": np.concatenate([body.source_index for body in step.bodies]),
            "toi": result.vertex_toi,
        },
        "contact": {
            "toi": contacts.toi,
            "kind": contacts.kind,
            "bodies": contacts.bodies,
            "point": contacts.points,
            "primitives": contacts.primitives,
            "vertices": contacts.vertices.astype(np.int64),
            "primitives_in_body": primitives_in_body(mesh, contacts),
            "vertices_in_body": vertices_in_body(mesh, contacts),
            "parameters": contacts.parameters,
            "normal": contacts.normal,
            "status": contacts.status,
            "gap": contacts.gap,
            "width": contacts.width,
        },
        "crossing": {
            "primitives": step.crossing.primitives,
            "bodies": step.crossing.bodies,
            "point": step.crossing.points,
        },
        "plane": {"body": mesh.planes.bodies, "point": mesh.planes.points, "normal": mesh.planes.normals},
    }
    if mesh.radius is not None:
        tables["vertex"]["radius"] = mesh.radius
    return tables


def _json(about: dict[str, Any], tables: dict[str, Table], names: tuple[str, ...]) -> str:
    """The tables as lists of rows, in which kinds, statuses and bodies have names; that of vertices as columns."""
    called = {"kind": _KINDS, "status": about["status_name"], "bodies": names}

    def plain(name: str, values: NDArray[Any]) -> list[Any]:
        if name in called:
            values = np.array(called[name])[values]
        if values.dtype.kind == "f" and values.ndim == 1:
            return [value if np.isfinite(value) else None for value in values.tolist()]
        return list(values.tolist())

    data = about | {"toi": about["toi"] if np.isfinite(about["toi"]) else None}
    for name, plural in {"body": "bodies", "contact": "contacts", "crossing": "crossings", "plane": "planes"}.items():
        columns = [plain(*column) for column in tables[name].items()]
        data[plural] = [dict(zip(tables[name], row, strict=True)) for row in zip(*columns, strict=True)]
    data |= {f"vertex_{name}": plain(name, values) for name, values in tables["vertex"].items()}
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def _plain_options(options: Options) -> dict[str, Any]:
    """Options as JSON holds them, kinds of pairs by name."""
    plain = {field.name: getattr(options, field.name) for field in fields(options)}
    plain["pair_kinds"] = None if options.pair_kinds is None else [kind.name.lower() for kind in options.kinds]
    plain["device"] = None if options.device is None else str(options.device)
    return plain


def _plain_counts(counts: Counts) -> dict[str, Any]:
    """Counts as JSON holds them, kinds of pairs by name."""
    plain = {field.name: getattr(counts, field.name) for field in fields(counts)}
    return {
        name: {kind.name.lower(): count for kind, count in value.items()} if isinstance(value, dict) else value
        for name, value in plain.items()
    }
