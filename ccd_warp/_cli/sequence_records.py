"""What is kept of each step of a sequence: in the journal, in the CSV file, and in the plot."""

import csv
import io
import math
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ccd_warp._cli.places import ContactTable
from ccd_warp._cli.solve import SolvedStep
from ccd_warp._files.opened import Stamp
from ccd_warp._odd_motion import motion_warnings
from ccd_warp._status import PairKind

# Points that are kept for pictures, of contacts the earliest ones.
_MOST_POINTS = 200
_KINDS = (PairKind.VERTEX_FACE, PairKind.EDGE_EDGE, PairKind.VERTEX_PLANE)

COLUMNS = (
    *(
        "step",
        "start",
        "end",
        "toi",
        "contacts",
        *(kind.name.lower() for kind in _KINDS),
        "at_start",
        "crossing_at_start",
        "at_limit",
    ),
    *("kind", "body_0", "body_1", "x", "y", "z", "vertex_0", "vertex_1", "vertex_2", "vertex_3"),
)


@dataclass(frozen=True)
class StepRecord:
    """A step of a sequence.

    Attributes:
        step: Its number, from 0 on: the step from frame ``step`` to the next.
        start: Name of the frame at its start.
        end: Name of that at its end.
        toi: Earliest time of impact, inf if none.
        counts: Number of contacts of each kind, by its name.
        at_start: Number of pairs in contact at the start, with the names of their bodies.
        crossing: Number of edges that pass through faces at the start, with the names of their bodies.
        at_limit: Number of contacts that stopped at a limit.
        first: Of the earliest contact, by the names of the CSV file; None if there is none.
        described: What touches what in it, and where; empty if there is none.
        points: Places of the earliest contacts.
        sizes: Of the smaller body of the earliest contact and of its smaller primitive, 0 without one.
        crossing_points: Places where edges pass through faces at the start.
        displacement: The largest of a vertex.
        warnings: What is odd about the motion.
        files: Stamps of the files from which its frames were read.
    """

    step: int
    start: str
    end: str
    toi: float
    counts: dict[str, int]
    at_start: list[tuple[str, str, int]]
    crossing: list[tuple[str, str, int]]
    at_limit: int
    first: dict[str, Any] | None
    described: list[str]
    points: list[list[float]]
    sizes: tuple[float, float]
    crossing_points: list[list[float]]
    displacement: float
    warnings: list[str]
    files: list[Stamp]

    @classmethod
    def of(cls, number: int, labels: Sequence[str], step: SolvedStep, files: list[Stamp]) -> "StepRecord":
        """The record of a solved step."""
        from ccd_warp.viz._scene import contact_sizes  # not before a step is solved

        contacts, counts = step.result.contacts, step.result.counts
        table = ContactTable.of(step.mesh, contacts, _MOST_POINTS)
        first = None
        if len(table):
            columns = COLUMNS[COLUMNS.index("kind") :]
            place = table.contacts.points[0].tolist()
            values = [table.kinds[0].name.lower(), *table.body_names[0], *place, *table.vertices[0].tolist()]
            first = dict(zip(columns, values, strict=True))
        return cls(
            step=number,
            start=labels[0],
            end=labels[1],
            toi=float(step.result.toi),
            counts={kind.name.lower(): counts.num_contacts.get(kind, 0) for kind in _KINDS},
            at_start=_listed(step.result.pairs_at_start),
            crossing=_listed(step.start[step.start.is_crossing].by_bodies()),
            at_limit=counts.num_contacts_at_limit,
            first=first,
            described=[table.described(0), table.placed(0)] if len(table) else [],
            points=table.contacts.points.tolist(),
            sizes=contact_sizes(step.mesh, step.moving.all_at(0.0), table.contacts, 0 if len(table) else -1),
            crossing_points=step.start.points[step.start.is_crossing][:_MOST_POINTS].tolist(),
            displacement=step.displacement,
            warnings=motion_warnings(step.mesh, step.vertices_t0, step.vertices_t1, step.options.t_max),
            files=files,
        )

    @property
    def hit(self) -> bool:
        """Whether the step has a contact."""
        return math.isfinite(self.toi)

    @property
    def pairs_at_start(self) -> Counter[tuple[str, str]]:
        """Number of pairs in contact at the start, by the names of their bodies."""
        return Counter({(a, b): count for a, b, count in self.at_start})

    @property
    def pairs_crossing(self) -> Counter[tuple[str, str]]:
        """Number of edges that pass through faces at the start, by names of bodies."""
        return Counter({(a, b): count for a, b, count in self.crossing})

    def plain(self) -> dict[str, Any]:
        """The record as JSON holds it."""
        return {**vars(self), "toi": self.toi if self.hit else None}

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> "StepRecord":
        """The record that :meth:`plain` gave."""
        toi = math.inf if plain["toi"] is None else plain["toi"]
        pairs = {name: [(a, b, count) for a, b, count in plain[name]] for name in ("at_start", "crossing")}
        return cls(**{**plain, "toi": toi, **pairs})

    @classmethod
    def from_journal(cls, records: dict[str, Any], num_steps: int) -> "dict[int, StepRecord]":
        """The records of a journal by the numbers of their steps, without what is none."""
        found = {}
        for key, plain in records.items():
            with suppress(KeyError, TypeError, ValueError, AttributeError):
                record = cls.from_plain(plain)
                if record.step == int(key) and 0 <= record.step < num_steps and len(record.row()) == len(COLUMNS):
                    found[record.step] = record
        return found

    def row(self) -> list[Any]:
        """The row of the CSV file; numbers read back bit for bit."""
        first = self.first or dict.fromkeys(COLUMNS[COLUMNS.index("kind") :], "")
        counts = list(self.counts.values())
        at_start = [self.pairs_at_start.total(), self.pairs_crossing.total()]
        return [
            *(self.step, self.start, self.end, self.toi, sum(counts), *counts, *at_start, self.at_limit),
            *first.values(),
        ]


def _listed(pairs: Counter[tuple[str, str]]) -> list[tuple[str, str, int]]:
    return [(a, b, count) for (a, b), count in pairs.most_common()]


def csv_text(records: Sequence[StepRecord]) -> str:
    """The CSV file: a row for each step."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(record.row() for record in records)
    return file.getvalue()


def draw_plot(path: Path, records: Sequence[StepRecord], t_max: float) -> Any:
    """Draw the toi and the number of contacts of every step, and mark those at whose start surfaces cross.

    Returns:
        The figure of matplotlib.

    Raises:
        ImportError: If matplotlib is not installed.
    """
    import matplotlib

    from ccd_warp.viz._scene import CROSSING_COLOUR

    with matplotlib.rc_context({"font.size": 10}):
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9.0, 4.5), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        bad = [record for record in records if record.hit]
        free = [record.step for record in records if not record.hit and not record.crossing]
        crossing = [record.step for record in records if record.crossing]
        upper.plot(free, [t_max] * len(free), ".", color="#b8b8b8", label="no contact")
        upper.plot([record.step for record in bad], [record.toi for record in bad], "o", color="#c8102e", label="toi")
        if crossing:
            said = "surfaces cross at the start"
            upper.plot(
                crossing,
                [0.0] * len(crossing),
                "x",
                color=CROSSING_COLOUR,
                label=said,
                markersize=9.0,
                markeredgewidth=2.0,
            )
        upper.set_ylim(-0.05 * t_max, 1.08 * t_max)
        upper.set_ylabel("toi")
        upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
        lower.bar([record.step for record in bad], [sum(record.counts.values()) for record in bad], color="#c8102e")
        lower.set_ylabel("contacts")
        lower.set_xlabel("step")
        lower.xaxis.get_major_locator().set_params(integer=True)
        lower.yaxis.get_major_locator().set_params(integer=True)
        figure.savefig(path, dpi=120)
    return figure


def ranges_text(numbers: Sequence[int]) -> str:
    """Ascending numbers, with runs of them as ranges: ``3-5, 8``."""
    parts: list[list[int]] = []
    for number in numbers:
        if parts and number == parts[-1][-1] + 1:
            parts[-1] = [parts[-1][0], number]
        else:
            parts.append([number])
    return ", ".join("-".join(map(str, part)) for part in parts)
