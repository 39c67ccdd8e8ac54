"""The text that the command line prints: bodies and their toi, the first contact, counts, the time of each stage."""

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from ccd_warp._engine.contact_corners import contact_vertices
from ccd_warp._files.frames import Body
from ccd_warp._input.messages import printable

if TYPE_CHECKING:
    from ccd_warp._results import Counts


def format_toi(toi: float) -> str:
    """A toi in full: rounding it to fewer digits could print a later time than the certain one."""
    return repr(float(toi)) if math.isfinite(toi) else "none"


def format_table(header: Sequence[str], rows: Sequence[Sequence[str]], *, align: str) -> list[str]:
    """Lines of a plain table; ``align`` holds ``<`` or ``>`` for each column."""
    widths = [max(len(row[k]) for row in [header, *rows]) for k in range(len(header))]
    return [
        "  " + "  ".join(f"{cell:{side}{width}}" for cell, side, width in zip(row, align, widths, strict=True)).rstrip()
        for row in [header, *rows]
    ]


def format_report(title: str, bodies: Sequence[Body], mesh, result, timings: dict[str, float], t_max: float) -> str:
    """The report of one run.

    Args:
        title: First line.
        bodies: The scene, in the order of its vertices.
        mesh: Its ``CollisionMesh``.
        result: Of ``mesh_ccd``.
        timings: Seconds of each stage, in order, as they are to be shown.
        t_max: End of the step that was looked at.

    Returns:
        Several lines without a final newline.
    """
    lines = [printable(title), ""]
    lines += format_table(
        ("body", "", "vertices", "faces", "earliest toi"),
        [
            (
                printable(body.name),
                "static" if body.is_static else "moving",
                f"{len(body.vertices_t0):,}",
                f"{len(body.faces):,}",
                format_toi(result.body_toi[k]),
            )
            for k, body in enumerate(bodies)
        ],
        align="<<>><",
    )
    lines += [
        f"  ({body.merged:,} vertices of {printable(body.name)} merged by position)" for body in bodies if body.merged
    ]
    lines.append("")
    if math.isfinite(result.toi):
        lines.append(f"scene toi  {format_toi(result.toi)}   (of the step; no pair touches before it)")
        if len(result.contacts.toi):
            lines.append(f"first contact  {describe_contact(bodies, mesh, result)}")
    else:
        lines.append(f"scene toi  none   (certain: nothing touches in [0, {t_max!r}])")
    capped = _count_capped(result)
    if capped:
        lines.append(
            f"{capped:,} of {len(result.contacts.toi):,} contacts stopped at the iteration limit: their toi is early, "
            "never late; raise --max-iterations or --max-work to refine them"
        )
    lines.append("")
    lines += format_table(
        ("count", ""), [(name, f"{count:,}") for name, count in count_rows(result.counts)], align="<>"
    )
    lines.append("")
    total = sum(timings.values())
    lines += format_table(
        ("stage", "seconds", "share"),
        [
            (_spaced(name), f"{seconds:.4f}", f"{seconds / total:.0%}" if total > 0 else "")
            for name, seconds in [*timings.items(), ("total", total)]
        ],
        align="<>>",
    )
    return "\n".join(lines)


def count_rows(counts: "Counts") -> list[tuple[str, int]]:
    """Counts by what a reader calls them; codimensional primitives only where there are any."""
    rows: list[tuple[str, int]] = []
    for field in fields(counts):
        value, name = getattr(counts, field.name), _spaced(field.name.removeprefix("num_"))
        if isinstance(value, dict):
            rows += [(f"{kind.name.lower().replace('_', '-')} {name}", count) for kind, count in value.items()]
        elif value or not name.startswith("codimensional"):
            rows.append((name, value))
    return rows


def describe_contact(bodies: Sequence[Body], mesh, result) -> str:
    """One line on the earliest contact: what touches what, where, and the normal."""
    contacts = result.contacts
    k = int(np.argmin(np.asarray(contacts.toi)))
    first_vertex = np.cumsum([0] + [len(body.vertices_t0) for body in bodies])
    vertices = contact_vertices(mesh, contacts)[k].tolist()
    touching = [bodies[int(np.searchsorted(first_vertex, v, side="right")) - 1] for v in (vertices[0], vertices[3])]
    names = [printable(body.name) for body in touching]
    if int(np.asarray(contacts.kind)[k]) == 0:
        face = int(np.asarray(contacts.primitives)[k, 1])
        pair = f"vertex {vertices[0]} of {names[0]} and face {face} of {names[1]}"
    else:
        pair = f"edge {vertices[0]}-{vertices[1]} of {names[0]} and edge {vertices[2]}-{vertices[3]} of {names[1]}"
    u, v = np.asarray(contacts.parameters)[k].tolist()
    normal = ", ".join(f"{x:.6g}" for x in np.asarray(contacts.normal)[k].tolist())
    return f"{pair} at (u, v) = ({u:.6g}, {v:.6g}), normal ({normal})"


def _count_capped(result) -> int:
    from ccd_warp._status import CCDStatus

    return int((np.asarray(result.contacts.status) == CCDStatus.ITERATION_LIMIT).sum())


def _spaced(name: str) -> str:
    return name.replace("_", " ")
