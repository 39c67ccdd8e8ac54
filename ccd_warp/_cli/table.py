"""The table of a sequence: a row for each step, in the CSV file."""

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from ccd_warp._cli.contacts import described, earliest, vertices_in_body
from ccd_warp._cli.solve import SolvedStep
from ccd_warp._runtime.status import PairKind

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
    displacement: float

    @classmethod
    def of(cls, number: int, labels: Sequence[str], step: SolvedStep) -> "StepRow":
        """The row of a solved step between frames of these names."""
        mesh, counts, contacts = step.mesh, step.result.counts, earliest(step.result)
        first: list[Any] = [""] * len(_FIRST)
        if len(contacts):
            names = [mesh.names[body] for body in contacts.bodies[0].tolist()]
            numbers = vertices_in_body(mesh, contacts)[0].tolist()
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
