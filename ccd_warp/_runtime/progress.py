"""The progress of a step, for a user who waits for it."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass
class Progress:
    """The stage that a step is in.

    Attributes:
        show: Called about ten times a second while a stage takes long; None where no progress is shown.
        stage: Its name.
        done: Items done so far; threads increase it without a lock, so it may be slightly too low.
        total: Items of the stage.
    """

    show: "Callable[[Progress], None] | None" = None
    stage: str = ""
    done: int = 0
    total: int = 0

    def begin(self, stage: str, total: int, done: int = 0) -> None:
        """Begin or continue a stage."""
        self.stage, self.total, self.done = stage, total, done

    @property
    def tick(self) -> Callable[[], None] | None:
        """The function that the waiting thread calls, or None."""
        if self.show is None:
            return None
        show = self.show
        return lambda: show(self)
