"""Write the result of a step as NPZ, JSON or CSV; ``docs/command_line.md`` describes what they hold."""

import csv
import json
import sys
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp._cli.places import ContactTable
from ccd_warp._cli.process import check_standard_output
from ccd_warp._cli.replacing import replacing
from ccd_warp._cli.scope import left_out
from ccd_warp._cli.solve import SolvedStep
from ccd_warp._files.frames import Body, InputError
from ccd_warp._input.options import Options
from ccd_warp._mesh import CollisionMesh
from ccd_warp._results import Counts
from ccd_warp._status import CCDStatus, PairKind
from ccd_warp._version import __version__

RESULT_SUFFIXES = (".npz", ".json", ".csv")
STDOUT = Path("-")
UNITS = {"length": "that of the files", "toi": "fraction of the step", "seconds": "s"}

CONTACT_COLUMNS = (
    *("toi", "kind", "body_0", "body_1", "x", "y", "z", "primitive_0", "primitive_1"),
    *("vertex_0", "vertex_1", "vertex_2", "vertex_3", "u", "v", "normal_x", "normal_y", "normal_z"),
    *("status", "gap", "width", "mesh_primitive_0", "mesh_primitive_1"),
)
VERTEX_COLUMNS = ("body", "vertex", "toi", "source_vertex", "mesh_vertex")


def check_output_path(path: Path) -> None:
    """Refuse a result file that cannot be written, before the computation."""
    if path == STDOUT:
        check_standard_output()
        return
    if path.suffix.lower() not in RESULT_SUFFIXES:
        raise InputError(f"--output {path}: the name must end in {', '.join(RESULT_SUFFIXES)}, or be - alone")
    if not path.parent.is_dir():
        raise InputError(f"--output {path}: the folder {path.parent} does not exist; create it first")


def make_folder(folder: Path, option: str) -> None:
    """Make a folder to write to, if it does not exist."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{option} {folder}: cannot create it ({error.strerror or error})") from error


def write_result(path: Path, step: SolvedStep) -> list[Path]:
    """Write the result of a step: contacts by ascending toi, and the toi of every vertex, body and of the scene.

    Floats are written so that they read back bit for bit; "no collision" is ``inf``, and null in JSON, which has no
    infinity.

    Args:
        path: ``.npz`` (everything), ``.json`` (all but the mesh) or ``.csv`` (contacts; the vertices' toi go to a
            second file whose name ends in ``_vertices.csv``); ``-`` is JSON on standard output.
        step: The step.

    Returns:
        The files written.

    Raises:
        InputError: If a file cannot be written.
    """
    table = ContactTable.of(step.mesh, step.result.contacts)
    if path == STDOUT:
        sys.stdout.write(_json(step, table))
        return []
    with ExitStack() as stack:

        def place(each: Path) -> Path:
            return stack.enter_context(replacing(each))

        match path.suffix.lower():
            case ".npz":
                _write_npz(place(path), step, table)
                return [path]
            case ".json":
                place(path).write_text(_json(step, table), encoding="utf-8")
                return [path]
            case ".csv":
                vertices_path = path.with_name(f"{path.stem}_vertices{path.suffix}")
                _write_contacts(place(path), table)
                _write_vertices(place(vertices_path), step)
                return [path, vertices_path]
            case _:
                raise InputError(f"{path}: the name must end in {', '.join(RESULT_SUFFIXES)}")


def plain_options(options: Options) -> dict[str, Any]:
    """Options as JSON holds them, kinds of pairs by name."""
    plain = {field.name: getattr(options, field.name) for field in fields(options)}
    plain["pair_kinds"] = None if options.pair_kinds is None else [kind.name.lower() for kind in options.kinds]
    plain["device"] = None if options.device is None else str(options.device)
    return plain


def plain_counts(counts: Counts) -> dict[str, int | dict[str, int]]:
    """Counts as JSON holds them, kinds of pairs by name."""

    def plain(value: int | dict[PairKind, int]) -> int | dict[str, int]:
        return {kind.name.lower(): n for kind, n in value.items()} if isinstance(value, dict) else value

    return {field.name: plain(getattr(counts, field.name)) for field in fields(counts)}


def finite_or_none(value: float) -> float | None:
    """A number, None where it is infinite."""
    return float(value) if np.isfinite(value) else None


def _write_npz(path: Path, step: SolvedStep, table: ContactTable) -> None:
    mesh, result, contacts = step.mesh, step.result, table.contacts
    arrays: dict[str, Any] = {
        "version": np.array(__version__),
        "options": np.array(json.dumps(plain_options(step.options))),
        "units": np.array(json.dumps(UNITS)),
        "left_out": np.array(left_out(mesh, step.options, step.ignored)),
        "kind_name": np.array([kind.name.lower() for kind in PairKind]),
        "status_name": np.array([status.name.lower() for status in CCDStatus]),
        "toi": np.float64(result.toi),
        "vertex_toi": np.asarray(result.vertex_toi),
        "body_toi": np.asarray(result.body_toi),
        "body_name": np.array(mesh.names),
        "body_static": mesh.static,
        "body_kinematic": mesh.kinematic,
        "body_first_vertex": mesh.body_vertex_range[:-1].astype(np.int64),
        "vertex_body": mesh.vertex_body,
        "vertex_source_index": np.concatenate([body.source_index for body in step.bodies]),
        "faces": mesh.faces,
        "edges": mesh.edges,
        "crossing_at_start": step.start.primitives[step.start.is_crossing],
        "contact_kind": contacts.kind,
        "contact_bodies": contacts.bodies,
        "contact_point": contacts.points,
        "contact_primitives": contacts.primitives,
        "contact_vertices": contacts.vertices.astype(np.int64),
        "contact_primitives_in_body": table.primitives,
        "contact_vertices_in_body": table.vertices,
        "contact_toi": contacts.toi,
        "contact_parameters": contacts.parameters,
        "contact_normal": contacts.normal,
        "contact_status": contacts.status,
        "contact_gap": contacts.gap,
        "contact_width": contacts.width,
    }
    if mesh.radius is not None:
        arrays["radius"] = mesh.radius
    if len(mesh.planes):
        arrays |= {f"plane_{name}": getattr(mesh.planes, f"{name}s") for name in ("point", "normal")}
        arrays["plane_body"] = mesh.planes.bodies
    with path.open("wb") as file:  # given a name, NumPy would add a second suffix to RESULT.NPZ
        np.savez_compressed(file, **arrays)


_CONTACT_FIELDS = (
    *("toi", "kind", "bodies", "point", "primitives", "vertices", "primitives_in_body", "vertices_in_body"),
    *("parameters", "normal", "status", "gap", "width"),
)


def contact_rows(table: ContactTable) -> list[dict[str, Any]]:
    """The contacts by ascending toi as plain Python values, bodies and enumerations by name."""
    contacts = table.contacts
    columns = (
        contacts.toi.tolist(),
        [kind.name.lower() for kind in table.kinds],
        [list(names) for names in table.body_names],
        contacts.points.tolist(),
        contacts.primitives.tolist(),
        contacts.vertices.tolist(),
        table.primitives.tolist(),
        table.vertices.tolist(),
        contacts.parameters.tolist(),
        contacts.normal.tolist(),
        [CCDStatus(status).name.lower() for status in contacts.status.tolist()],
        contacts.gap.tolist(),
        contacts.width.tolist(),
    )
    return [dict(zip(_CONTACT_FIELDS, row, strict=True)) for row in zip(*columns, strict=True)]


def _json(step: SolvedStep, table: ContactTable) -> str:
    mesh, result = step.mesh, step.result
    data = {
        "version": __version__,
        "options": plain_options(step.options),
        "units": UNITS,
        "left_out": left_out(mesh, step.options, step.ignored),
        "kinds": {kind.name.lower(): int(kind) for kind in PairKind},
        "toi": finite_or_none(result.toi),
        "bodies": [
            {
                "name": name,
                "static": body.is_static,
                "kinematic": bool(mesh.kinematic[k]),
                "first_vertex": int(mesh.body_vertex_range[k]),
                "vertices": len(body.vertices_t0),
                "faces": len(body.faces),
                **_radius_of(mesh, k),
                **_half_space_of(body),
                "toi": finite_or_none(result.body_toi[k]),
            }
            for k, (name, body) in enumerate(zip(mesh.names, step.bodies, strict=True))
        ],
        "crossing_at_start": [
            {"bodies": list(names), "edges_through_faces": count}
            for names, count in step.start[step.start.is_crossing].by_bodies().most_common()
        ],
        "counts": plain_counts(result.counts),
        "timings": {name: float(seconds) for name, seconds in result.timings.items()},
        "vertex_toi": [finite_or_none(toi) for toi in result.vertex_toi.tolist()],
        "contacts": [row | {"gap": finite_or_none(row["gap"])} for row in contact_rows(table)],
    }
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def _half_space_of(body: Body) -> dict[str, Any]:
    """The point and the normal of a half-space; nothing of other bodies."""
    half_space = body.half_space
    return {} if half_space is None else {"half_space": {"point": half_space.point, "normal": half_space.normal}}


def _radius_of(mesh: CollisionMesh, body: int) -> dict[str, float]:
    """The radius of a body, where radii are given: the command line gives one to each."""
    begin, end = mesh.body_vertex_range[body : body + 2]
    return {} if mesh.radius is None else {"radius": float(mesh.radius[begin:end].max(initial=0.0))}


def _write_contacts(path: Path, table: ContactTable) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(CONTACT_COLUMNS)
        for row in contact_rows(table):
            writer.writerow(
                [row["toi"], row["kind"], *row["bodies"], *row["point"]]
                + row["primitives_in_body"]
                + row["vertices_in_body"]
                + row["parameters"]
                + row["normal"]
                + [row["status"], row["gap"], row["width"], *row["primitives"]]
            )


def _write_vertices(path: Path, step: SolvedStep) -> None:
    mesh = step.mesh
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(VERTEX_COLUMNS)
        toi = step.result.vertex_toi.tolist()
        source = np.concatenate([body.source_index for body in step.bodies]).tolist()
        for k, body in enumerate(mesh.vertex_body.tolist()):
            writer.writerow([mesh.names[body], k - mesh.body_vertex_range[body], toi[k], source[k], k])
