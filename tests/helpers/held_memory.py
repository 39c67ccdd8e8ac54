"""What this process holds in memory, as Linux tells it."""

import ctypes
import gc
import os
from contextlib import suppress
from pathlib import Path

import pytest

requires_status = pytest.mark.skipif(
    not os.access("/proc/self/clear_refs", os.W_OK), reason="tells memory as Linux does, or its peak cannot be reset"
)


def held_bytes(name: str = "VmRSS") -> int:
    """Bytes that the process holds, or has held at its peak (VmHWM), without what is only kept to be used again."""
    if name == "VmRSS":
        gc.collect()
        with suppress(AttributeError, OSError, TypeError):  # no glibc
            ctypes.CDLL(None).malloc_trim(0)
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    return 1024 * next(int(line.split()[1]) for line in status.splitlines() if line.startswith(name))
