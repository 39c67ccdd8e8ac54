"""How far a step is, for a person who waits for it."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass
class Progress:
    """The stage that a step is in.

    Attributes:
        show: Called about ten times a second while a stage takes long; None where nobody looks.
        stage: Its name.
        done: Items that are done; threads add to it without a lock, so it may be a little low.
        total: Items of the stage.
    """

    show: "Callable[[Progress], None] | None" = None
    stage: str = ""
    done: int = 0
    total: int = 0

    def begin(self, stage: str, total: int, done: int = 0) -> None:
        """Enter a stage, or go on with it."""
        self.stage, self.total, self.done = stage, total, done

    @property
    def tick(self) -> Callable[[], None] | None:
        """What the thread that waits is to call."""
        if self.show is None:
            return None
        show = self.show
        return lambda: show(self)
