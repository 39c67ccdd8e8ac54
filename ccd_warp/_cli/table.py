"""The table of a sequence: a row for each step, in the CSV file and in the plot."""

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ccd_warp._cli.contacts import described, earliest, vertices_in_body
from ccd_warp._cli.solve import SolvedStep
from ccd_warp._runtime.status import PairKind

_MOST_POINTS = 200  # that are kept for pictures, of contacts the earliest ones
_KINDS = (PairKind.VERTEX_FACE, PairKind.EDGE_EDGE, PairKind.VERTEX_PLANE)
_FIRST = ("kind", "body_0", "body_1", "x", "y", "z", "vertex_0", "vertex_1", "vertex_2", "vertex_3")
COLUMNS = (
    *("step", "start", "end", "toi", "contacts", *(kind.name.lower() for kind in _KINDS)),
    *("at_start", "crossing_at_start", "at_limit", *_FIRST),
)


@dataclass(frozen=True)
class StepRow:
    """A step of a sequence.

    Attributes:
        step: Its number, from 0 on: the step from frame ``step`` to the next.
        start: Name of the frame at its start.
        end: Name of that at its end.
        toi: Earliest time of impact, inf if none.
        counts: Number of contacts of each kind of the table.
        at_start: Number of pairs in contact at the start, by the names of their bodies.
        crossing: Number of edges that pass through faces at the start, by the names of their bodies.
        at_limit: Number of contacts that stopped at a limit.
        first: Cells of the earliest contact, empty if there is none.
        described: What touches what in it, and where.
        points: Places of the earliest contacts, the first one's first, shape [k, 3].
        sizes: Of the smaller body of the earliest contact and of its smaller primitive, 0 without one.
        crossing_points: Places where edges pass through faces at the start, shape [m, 3].
        displacement: The largest of a vertex.
    """

    step: int
    start: str
    end: str
    toi: float
    counts: list[int]
    at_start: Counter[tuple[str, str]]
    crossing: Counter[tuple[str, str]]
    at_limit: int
    first: list[Any]
    described: list[str]
    points: NDArray[Any]
    sizes: tuple[float, float]
    crossing_points: NDArray[Any]
    displacement: float

    @classmethod
    def of(cls, number: int, labels: Sequence[str], step: SolvedStep) -> "StepRow":
        """The row of a solved step between frames of these names."""
        from ccd_warp.viz._scene import contact_sizes  # not before a step is solved

        mesh, counts, contacts = step.mesh, step.result.counts, earliest(step.result, _MOST_POINTS)
        first: list[Any] = [""] * len(_FIRST)
        if len(contacts):
            names = [mesh.names[body] for body in contacts.bodies[0].tolist()]
            numbers = vertices_in_body(mesh, contacts[:1])[0].tolist()
            first = [PairKind(int(contacts.kind[0])).name.lower(), *names, *contacts.points[0].tolist(), *numbers]
        return cls(
            step=number,
            start=labels[0],
            end=labels[1],
            toi=float(step.result.toi),
            counts=[counts.num_contacts.get(kind, 0) for kind in _KINDS],
            at_start=step.result.pairs_at_start,
            crossing=step.crossing.by_bodies(),
            at_limit=counts.num_contacts_at_limit,
            first=first,
            described=described(mesh, contacts) if len(contacts) else [],
            points=contacts.points,
            sizes=contact_sizes(mesh, step.moving.all_at(0.0), contacts, 0 if len(contacts) else -1),
            crossing_points=step.crossing.points[:_MOST_POINTS],
            displacement=step.displacement,
        )

    @property
    def hit(self) -> bool:
        """Whether the step has a contact."""
        return math.isfinite(self.toi)

    @property
    def cells(self) -> list[Any]:
        """The row of the CSV file; numbers read back bit for bit."""
        at_start = [self.at_start.total(), self.crossing.total(), self.at_limit]
        return [self.step, self.start, self.end, self.toi, sum(self.counts), *self.counts, *at_start, *self.first]


def csv_text(rows: Iterable[Sequence[Any]]) -> str:
    """Rows of a CSV file."""
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerows(rows)
    return file.getvalue()


def draw_plot(path: Path, rows: Sequence[StepRow], t_max: float) -> None:
    """Draw the toi and the number of contacts of every step, and mark those at whose start surfaces cross.

    Raises:
        ImportError: If matplotlib is not installed.
    """
    import matplotlib

    from ccd_warp.viz._scene import CROSSING_COLOUR

    with matplotlib.rc_context({"font.size": 10}):
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9.0, 4.5), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        hits = [row for row in rows if row.hit]
        steps, free = [row.step for row in hits], [row.step for row in rows if not row.hit and not row.crossing]
        upper.plot(free, [t_max] * len(free), ".", color="#b8b8b8", label="no contact")
        upper.plot(steps, [row.toi for row in hits], "o", color="#c8102e", label="toi")
        if crossing := [row.step for row in rows if row.crossing]:
            style = {"color": CROSSING_COLOUR, "markersize": 9.0, "markeredgewidth": 2.0}
            upper.plot(crossing, [0.0] * len(crossing), "x", label="surfaces cross at the start", **style)
        upper.set(ylim=(-0.05 * t_max, 1.08 * t_max), ylabel="toi")
        upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
        lower.bar(steps, [sum(row.counts) for row in hits], color="#c8102e")
        lower.set(ylabel="contacts", xlabel="step")
        for axis in (lower.xaxis, lower.yaxis):
            axis.get_major_locator().set_params(integer=True)
        figure.savefig(path, dpi=120)
