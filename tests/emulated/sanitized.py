"""A pass over calls with AddressSanitizer: `python tests/emulated/sanitized.py`, in the environment of `environment()`.

Kernels are compiled with checks of every access to memory, and of the alignment of vectors. The process ends at the
first that is wrong; otherwise it prints what it has run, and fails if a result is not that of the CPU.
"""

import os
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parent.parent)

import warp as wp  # noqa: E402

from emulated.build import sanitizer_library  # noqa: E402
from emulated.comparison import PAIRS, PLAN, Comparison, summary  # noqa: E402

# Small ones, with and without worlds, static bodies, codimensional primitives, lists of excluded pairs and a hash.
_STEPS = ("contact at the start", "in the plane, one body static", "worlds", "excluded pairs", "spatial hash")
# Loops over the others, without a kernel of their own.
_LOOPS = ("replays", "line_searches")
_CASES = [case for case in PLAN if case[0] not in _LOOPS and case[1] in _STEPS]


def environment() -> dict[str, str]:
    """The variables with which a process of Python finds the sanitizer; what Python itself never frees is no matter."""
    return {**os.environ, "LD_PRELOAD": sanitizer_library(), "ASAN_OPTIONS": "detect_leaks=0"}


def main() -> int:
    """Run the smaller steps of the plan, as instrumented code is slow."""
    wp.config.log_level = wp.LOG_ERROR
    comparison = Comparison(is_sanitized=True)
    found = [f"{case}: {line}" for case in _CASES for line in comparison.of_step(*case)]
    found += [f"{case}: {line}" for case in PAIRS[::4] for line in comparison.of_pairs(*case)]
    print(*found, summary(comparison), sep="\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
