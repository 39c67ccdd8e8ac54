"""What a case of a stage is given: how much time there is, and where its rows go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Record:
    """The rows of a case.

    Attributes:
        left: Returns the seconds that are left of the stage's time.
        say: Called with a line for people.
        rows: What was measured, in order.
    """

    left: Callable[[], float]
    say: Callable[[str], None]
    rows: list[dict] = field(default_factory=list)

    def add(self, line: str | None = None, **row: Any) -> None:
        """Keep a row, and say a line about it."""
        self.rows.append(row)
        if line is not None:
            self.say(line)


# The cases of a stage, by name, in the order in which they run.
Cases = dict[str, Callable[[Record], None]]
