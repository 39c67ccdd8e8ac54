"""Measurement of peak memory."""

from __future__ import annotations

import ctypes
import gc
from pathlib import Path


class PeakMemory:
    """Peak memory of this process in bytes beyond that at construction; None where it is unknown."""

    def __init__(self) -> None:
        # Memory freed earlier would be reused without being noticed, so it is returned to the system first.
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
        """The peak since construction."""
        return None if self.before is None else max(0, resident("VmHWM") - self.before)


def resident(name: str, process: int | str = "self") -> int:
    """Resident bytes of a process under Linux: VmRSS for now, VmHWM for the peak."""
    lines = Path(f"/proc/{process}/status").read_text("utf-8").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(name))
