"""Lines on the terminal that show what a command is doing."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from ccd_warp._runtime import progress_line
from ccd_warp._runtime.progress import Progress
from ccd_warp._runtime.progress_line import ProgressLine
from ccd_warp._runtime.terminal import has_terminal, write_to_terminal


class ItemsLine(ProgressLine):
    """Progress of items of which each takes a while: the line shows how many are done, whatever stage each is in."""

    def __init__(self, is_quiet: bool) -> None:
        super().__init__(is_quiet)
        self._items = Progress()

    def begin(self, what: str, total: int) -> None:
        """Begin with so many items of some name."""
        self._items.begin(what, total)
        self.show(self._items)

    def advance(self) -> None:
        """One more is done."""
        self._items.done += 1
        self.show(self._items)

    def show(self, progress: Progress) -> None:
        """Rewrite the line; the progress within an item only says that time goes by."""
        super().show(self._items)


@contextmanager
def waiting(what: str, *, is_quiet: bool) -> Iterator[None]:
    """Show what the work inside is, once it has taken two seconds and until it is done, where no share is known."""
    if is_quiet or not has_terminal():
        yield
        return
    shown: list[str] = []

    def show() -> None:
        shown.append(f"{what} ...")
        write_to_terminal(f"\r{shown[0]}")

    timer = threading.Timer(progress_line.PATIENCE, show)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()
        if shown:
            write_to_terminal(f"\r{'':{len(shown[0])}}\r")
