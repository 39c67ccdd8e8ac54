"""How much memory something takes at the peak."""

from __future__ import annotations

from pathlib import Path


class PeakMemory:
    """Bytes that this process takes at the peak beyond what it had when this was made; None where that is unknown."""

    def __init__(self) -> None:
        self._before = None
        try:
            Path("/proc/self/clear_refs").write_text("5")
            self._before = _resident("VmRSS")
        except OSError:
            pass

    def bytes(self) -> int | None:
        """The peak since then."""
        return None if self._before is None else max(0, _resident("VmHWM") - self._before)


def _resident(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(name))
