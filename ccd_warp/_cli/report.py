"""The text that the command line prints on a step: bodies and their toi, the first contact, lengths, times."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import fields

import numpy as np
import warp as wp

from ccd_warp._cli.motion import Lengths
from ccd_warp._cli.places import ContactTable, kind_name
from ccd_warp._cli.scene import StartContacts
from ccd_warp._cli.scope import NOT_SEEN, left_out, looked_at
from ccd_warp._cli.solve import SolvedStep
from ccd_warp._display import counted, named_counts, start_sentence
from ccd_warp._files.frames import Body
from ccd_warp._input.messages import printable
from ccd_warp._input.options import Options
from ccd_warp._mesh import CollisionMesh
from ccd_warp._results import Counts
from ccd_warp._status import CCDStatus
from ccd_warp._version import __version__

_MOST_BODIES = 30  # that a report lists; the result files have all


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


def format_title(title: str, options: Options) -> str:
    """The first line of a report."""
    device = wp.get_device(options.device)
    return printable(
        f"ccd-warp {__version__}  {title}  ({options.precision}, {device.name if device.is_cuda else 'CPU'})"
    )


def format_report(title: str, step: SolvedStep, timings: dict[str, float], *, is_verbose: bool) -> str:
    """The report of one step.

    Args:
        title: First line.
        step: The step and its result.
        timings: Seconds of each stage, in order, as they are to be shown.
        is_verbose: Whether to show what each stage counted.

    Returns:
        Several lines without a final newline.
    """
    lines = [format_title(title, step.options), "", *_bodies(step), "", *_outcome(step), ""]
    lengths = Lengths.of(step.moving.all_at(0.0), step.displacement, step.options)
    lines += format_table(("in the unit of the files", ""), lengths.rows(step.mesh.radius), align="<<")
    lines.append("")
    if is_verbose:
        rows = [(name, f"{count:,}") for name, count in count_rows(step.result.counts)]
        lines += [*format_table(("count", ""), rows, align="<>"), ""]
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


def body_table(header: Sequence[str], rows: Sequence[Sequence[str]], *, align: str) -> list[str]:
    """A table of bodies, the first ones where there are many."""
    more = [f"  … {len(rows) - _MOST_BODIES:,} more bodies"] if len(rows) > _MOST_BODIES else []
    return format_table(header, rows[:_MOST_BODIES], align=align) + more


def body_rows(mesh: CollisionMesh, bodies: Sequence[Body]) -> list[tuple[str, str, str, str]]:
    """Name, whether it moves, and size of each body."""
    return [
        (
            name,
            mesh._kind_of_body(b),
            f"{len(body.vertices_t0):,}",
            f"{len(body.faces):,}",
        )
        for b, (name, body) in enumerate(zip(mesh.names, bodies, strict=True))
    ]


def vertex_lines(mesh: CollisionMesh, bodies: Sequence[Body]) -> list[str]:
    """What was merged in reading and what takes no part, a line for each body."""
    unused = mesh.vertex_body[np.setdiff1d(mesh.unused_vertices, mesh.inner_vertices)]
    num_unused = np.bincount(unused, minlength=mesh.num_bodies).tolist()
    lines = []
    for name, body, count in zip(mesh.names, bodies, num_unused, strict=True):
        lines += [f"  ({body.merged:,} vertices of {name} merged by position)"] if body.merged else []
        described = counted(count, f"vertex of {name} in no face takes", f"vertices of {name} in no face take")
        lines += [f"  ({described} no part)"] if count else []
    return lines[:_MOST_BODIES]


def scope_lines(mesh: CollisionMesh, options: Options, ignored: StartContacts | None) -> list[str]:
    """What was left out, and what CCD does not see."""
    return [f"left out  {left_out(mesh, options, ignored)}", f"not seen  {NOT_SEEN}"]


def _bodies(step: SolvedStep) -> list[str]:
    rows = [
        (*row, format_toi(toi))
        for row, toi in zip(body_rows(step.mesh, step.bodies), step.result.body_toi.tolist(), strict=True)
    ]
    header = ("body", "", "vertices", "faces", "earliest toi")
    return body_table(header, rows, align="<<>><") + vertex_lines(step.mesh, step.bodies)


def _outcome(step: SolvedStep) -> list[str]:
    result, contacts = step.result, step.result.contacts
    if not result.hit:
        pairs = looked_at(step.mesh, step.options)
        line = f"scene toi  none   (certain for the pairs looked at: {pairs})"
        return [line, *_at_start(step), *scope_lines(step.mesh, step.options, step.ignored)]
    lines = [f"scene toi  {format_toi(result.toi)}   (of the step; no pair looked at touches before it)"]
    if len(contacts):
        first = ContactTable.of(step.mesh, contacts, 1)
        lines += [f"first contact  {first.described(0)}", f"               {first.placed(0)}"]
        by_kind = result.counts.num_contacts.items()
        counts = ", ".join(f"{count:,} {kind_name(kind)}" for kind, count in by_kind if count)
        lines.append(f"contacts  {len(contacts):,}: {counts}")
    lines += _at_start(step)
    num_capped = int((contacts.status == int(CCDStatus.ITERATION_LIMIT)).sum())
    if num_capped:
        lines.append(
            f"{num_capped:,} of {len(contacts):,} contacts stopped at the iteration limit: their toi is early, never "
            "late; raise --max-iterations or --max-work to refine them"
        )
    return [*lines, *scope_lines(step.mesh, step.options, step.ignored)]


def crossing_sentence(pairs: Counter[tuple[str, str]]) -> str:
    """A sentence on the edges that pass through faces at the start."""
    if not pairs:
        return "no edge passes through a face"
    edges = counted(pairs.total(), "edge passes", "edges pass")
    return f"{edges} through a face, so surfaces cross: {', '.join(named_counts(pairs))}"


def _at_start(step: SolvedStep) -> list[str]:
    """What touches, and what crosses, at the start."""
    sentence = start_sentence(step.result.pairs_at_start)
    crossing = crossing_sentence(step.start[step.start.is_crossing].by_bodies())
    return [f"at the start  {each}" for each in (sentence, step.result.hidden_gaps, crossing) if each]


def count_rows(counts: Counts) -> list[tuple[str, int]]:
    """Counts by what a reader calls them; codimensional primitives only where there are any."""
    rows: list[tuple[str, int]] = []
    for field in fields(counts):
        value, name = getattr(counts, field.name), _spaced(field.name.removeprefix("num_"))
        if isinstance(value, dict):
            rows += [(f"{kind_name(kind)} {name}", count) for kind, count in value.items()]
        elif value or not name.startswith("codimensional"):
            rows.append((name, value))
    return rows


def _spaced(name: str) -> str:
    return name.replace("_", " ")
