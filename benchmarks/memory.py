"""How much memory something takes at the peak."""

from __future__ import annotations

import ctypes
import gc
from pathlib import Path


class PeakMemory:
    """Bytes that this process takes at the peak beyond what it had when this was made; None where that is unknown."""

    def __init__(self) -> None:
        # What was freed before would be used again without a trace, so it goes back to the system first.
        gc.collect()
        try:
            ctypes.CDLL(None).malloc_trim(0)
        except (AttributeError, OSError, TypeError):  # no glibc
            pass
        self.before = None
        try:
            Path("/proc/self/clear_refs").write_text("5")
            self.before = resident("VmRSS")
        except OSError:
            pass

    def bytes(self) -> int | None:
        """The peak since then."""
        return None if self.before is None else max(0, resident("VmHWM") - self.before)


def resident(name: str, process: int | str = "self") -> int:
    """Bytes that Linux calls so: VmRSS now, VmHWM at the peak."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(name))
