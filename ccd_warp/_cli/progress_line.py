"""A line on the terminal that shows the stage of a step, a bar, and how long it will take."""

import sys
import time

from ccd_warp._runtime.progress import Progress

PATIENCE = 2.0  # seconds before a line appears
_HALF_LIFE = 8.0  # seconds in which the bar goes half of the way of an item that takes long, as a module to compile
_WIDTH = 24
_ERASE = "\r\x1b[K"  # back to the begin of the line, and nothing behind


class ProgressLine:
    """The stage of a run, a bar, and the estimated time left; on stderr, if that is a terminal."""

    def __init__(self, is_quiet: bool) -> None:
        self._is_shown = not is_quiet and sys.stderr is not None and sys.stderr.isatty()
        self._begin = self._stage_begin = self._item_begin = time.monotonic()
        self._stage, self._done = "", 0

    def show(self, progress: Progress) -> None:
        """Rewrite the line, once the run has taken two seconds."""
        now = time.monotonic()
        if progress.stage != self._stage:
            self._stage, self._stage_begin, self._done = progress.stage, now, -1
        if progress.done != self._done:
            self._done, self._item_begin = progress.done, now
        if self._is_shown and now - self._begin >= PATIENCE:
            line = line_of(progress, now - self._stage_begin, now - self._item_begin)
            print(end=f"{_ERASE}{line}", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Clear the line."""
        if self._is_shown:
            print(end=_ERASE, file=sys.stderr, flush=True)


def line_of(progress: Progress, seconds: float, of_item: float = 0.0) -> str:
    """The line of a stage that has taken ``seconds`` so far, ``of_item`` of them since an item was last done."""
    share, underway = min(1.0, progress.done / max(progress.total, 1)), 1.0 - 2.0 ** (-of_item / _HALF_LIFE)
    shown = min(1.0, share + underway / max(progress.total, 1))
    bar = f"{'#' * int(shown * _WIDTH):{_WIDTH}}"
    left = f"about {_duration(seconds * (1.0 - share) / share)} left" if share > 0.02 else "..."
    return f"{progress.stage}  [{bar}] {shown:4.0%}  {left}"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
