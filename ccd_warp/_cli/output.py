"""Write the results of a run as NPZ, JSON or CSV."""

import csv
import json
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ccd_warp._engine.contact_corners import contact_vertices
from ccd_warp._files.frames import Body, InputError

if TYPE_CHECKING:
    from ccd_warp._results import Counts
    from ccd_warp._status import PairKind

RESULT_SUFFIXES = (".npz", ".json", ".csv")


def check_output_path(path: Path) -> None:
    """Reject a result file that cannot be written, before the computation."""
    if path.suffix.lower() not in RESULT_SUFFIXES:
        raise InputError(f"--output {path}: the name must end in {', '.join(RESULT_SUFFIXES)}")
    if not path.parent.is_dir():
        raise InputError(f"--output {path}: the folder {path.parent} does not exist; create it first")


def write_result(path: Path, bodies: list[Body], mesh, result) -> list[Path]:
    """Write a run's result: contacts, and the toi of every vertex, of every body and of the scene.

    Vertices and faces are numbered consecutively over all bodies in their order, and edges as in
    ``CollisionMesh.edges``. Floats are written so that they read back bit for bit; "no collision" is ``inf``, and null
    in JSON, which has no infinity.

    Args:
        path: ``.npz`` (everything), ``.json`` (all but the mesh) or ``.csv`` (contacts; the vertices' toi go to a
            second file whose name ends in ``_vertices.csv``).
        bodies: The scene.
        mesh: Its ``CollisionMesh``.
        result: The result of ``mesh_ccd``.

    Returns:
        The files written.

    Raises:
        InputError: If a file cannot be written.
    """
    try:
        match path.suffix.lower():
            case ".npz":
                _write_npz(path, bodies, mesh, result)
                return [path]
            case ".json":
                _write_json(path, bodies, mesh, result)
                return [path]
            case ".csv":
                return _write_csv(path, mesh, result)
            case _:
                raise InputError(f"{path}: the name must end in {', '.join(RESULT_SUFFIXES)}")
    except OSError as error:
        raise InputError(f"cannot write {path} ({error.strerror or error})") from error


def _write_npz(path: Path, bodies: list[Body], mesh, result) -> None:
    contacts = result.contacts
    arrays: dict[str, Any] = {
        "toi": np.float64(result.toi),
        "vertex_toi": np.asarray(result.vertex_toi),
        "body_toi": np.asarray(result.body_toi),
        "body_name": np.array([body.name for body in bodies]),
        "body_first_vertex": np.cumsum([0] + [len(body.vertices_t0) for body in bodies])[:-1],
        "vertex_source_index": np.concatenate([body.source_index for body in bodies]),
        "faces": np.asarray(mesh.faces),
        "edges": np.asarray(mesh.edges),
        "contact_kind": np.asarray(contacts.kind),
        "contact_primitives": np.asarray(contacts.primitives),
        "contact_vertices": contact_vertices(mesh, contacts).astype(np.int64),
        "contact_toi": np.asarray(contacts.toi),
        "contact_parameters": np.asarray(contacts.parameters),
        "contact_normal": np.asarray(contacts.normal),
        "contact_status": np.asarray(contacts.status),
        "contact_gap": np.asarray(contacts.gap),
        "contact_width": np.asarray(contacts.width),
    }
    with path.open("wb") as file:  # given a name, NumPy would add a second suffix to RESULT.NPZ
        np.savez_compressed(file, **arrays)


_CONTACT_FIELDS = ("kind", "primitives", "vertices", "toi", "parameters", "normal", "status", "gap", "width")


def _contact_rows(mesh, contacts) -> list[dict[str, Any]]:
    """The contacts as plain Python values, the enumerations by name."""
    from ccd_warp._status import CCDStatus, PairKind

    columns = (
        [PairKind(int(kind)).name.lower() for kind in np.asarray(contacts.kind)],
        np.asarray(contacts.primitives).tolist(),
        contact_vertices(mesh, contacts).tolist(),
        np.asarray(contacts.toi).tolist(),
        np.asarray(contacts.parameters).tolist(),
        np.asarray(contacts.normal).tolist(),
        [CCDStatus(int(status)).name.lower() for status in np.asarray(contacts.status)],
        np.asarray(contacts.gap).tolist(),
        np.asarray(contacts.width).tolist(),
    )
    return [dict(zip(_CONTACT_FIELDS, row, strict=True)) for row in zip(*columns, strict=True)]


def plain_counts(counts: "Counts") -> dict[str, int | dict[str, int]]:
    """Counts as JSON holds them, kinds of pairs by name."""

    def plain(value: int | dict["PairKind", int]) -> int | dict[str, int]:
        return {kind.name.lower(): n for kind, n in value.items()} if isinstance(value, dict) else value

    return {field.name: plain(getattr(counts, field.name)) for field in fields(counts)}


def _write_json(path: Path, bodies: list[Body], mesh, result) -> None:
    def finite_or_none(value):
        return float(value) if np.isfinite(value) else None

    first = np.cumsum([0] + [len(body.vertices_t0) for body in bodies])
    data = {
        "toi": finite_or_none(result.toi),
        "bodies": [
            {
                "name": body.name,
                "static": body.is_static,
                "first_vertex": int(first[k]),
                "vertices": len(body.vertices_t0),
                "faces": len(body.faces),
                "toi": finite_or_none(result.body_toi[k]),
            }
            for k, body in enumerate(bodies)
        ],
        "counts": plain_counts(result.counts),
        "timings": {name: float(seconds) for name, seconds in result.timings.items()},
        "vertex_toi": [finite_or_none(toi) for toi in np.asarray(result.vertex_toi)],
        "contacts": [row | {"gap": finite_or_none(row["gap"])} for row in _contact_rows(mesh, result.contacts)],
    }
    path.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _write_csv(path: Path, mesh, result) -> list[Path]:
    vertices_path = path.with_name(f"{path.stem}_vertices{path.suffix}")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            "kind primitive_0 primitive_1 vertex_0 vertex_1 vertex_2 vertex_3 toi u v "
            "normal_x normal_y normal_z status gap width".split()
        )
        for row in _contact_rows(mesh, result.contacts):
            writer.writerow(
                [row["kind"], *row["primitives"], *row["vertices"], repr(row["toi"])]
                + [repr(x) for x in row["parameters"] + row["normal"]]
                + [row["status"], repr(row["gap"]), repr(row["width"])]
            )
    with vertices_path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["vertex", "toi"])
        writer.writerows([k, repr(toi)] for k, toi in enumerate(np.asarray(result.vertex_toi).tolist()))
    return [path, vertices_path]
