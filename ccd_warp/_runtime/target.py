"""The processor for which kernels of the CPU are compiled: one of a few by name, so that an object serves others.

Warp compiles for the very processor at hand, and an object is found again on such a one alone. Code for a named level
of x86-64 is as fast (benchmarks/notes/compilation.md), and its object has the same name wherever it is made.
"""

import os
from functools import cache
from typing import Any

import warp as wp

from ccd_warp._runtime.lanes import cpu_lanes

NATIVE = "native"
# What is compiled for a number of lanes; vectors of 512 bits have to be asked for.
LEVELS = {8: "x86-64-v4", 4: "x86-64-v3", 1: "x86-64"}
_WIDEST = " -mprefer-vector-width=512"
_HOST = "-march=native"
# What a processor must have for each, in the words of the kernel of Linux.
_V3 = frozenset("avx avx2 bmi1 bmi2 f16c fma abm movbe popcnt sse4_2 xsave".split())
_V4 = _V3 | frozenset("avx512f avx512bw avx512cd avx512dq avx512vl".split())
_NEEDED = {"x86-64-v4": _V4, "x86-64-v3": _V3, "x86-64": frozenset({"sse2"})}


@cache
def cpu_target() -> str:
    """The level for the lanes of this process, or ``"native"``, as the environment variable ``CCD_WARP_TARGET`` asks.

    A processor that lacks something of the level, or is no x86-64 at all, is compiled for as it is.

    Raises:
        ValueError: If the variable is anything else.
    """
    value = os.environ.get("CCD_WARP_TARGET", "")
    if value not in ("", NATIVE):
        raise ValueError(f"the environment variable CCD_WARP_TARGET must be {NATIVE} or absent; found {value!r}")
    level = LEVELS[cpu_lanes()]
    return level if not value and _NEEDED[level] <= _flags_of_processor() else NATIVE


def set_flags(module: Any, device: wp.Device) -> None:
    """Have Warp compile a module for a device as all of them are; flags are a part of its name.

    Warp keeps the name for each size of a block, and on CUDA it is the same on every machine.
    """
    module.options["cpu_compiler_flags"] = compiler_flags(cpu_target()) if device.is_cpu else None


def compiler_flags(target: str) -> str | None:
    """Warp's flags with a level in the place of the very processor; None where a user's flags say something else."""
    flags = wp.config.cpu_compiler_flags or _HOST if wp.config.cpu_compiler_flags != "" else ""
    if target == NATIVE or _HOST not in flags.split():
        return None
    return flags.replace(_HOST, f"-target-cpu {target}{_WIDEST if target == LEVELS[8] else ''}")


def _flags_of_processor() -> frozenset[str]:
    try:
        with open("/proc/cpuinfo", encoding="ascii", errors="replace") as lines:
            return frozenset(next((line for line in lines if line.startswith("flags")), "").split())
    except OSError:
        return frozenset()
