"""Run a program on the emulated device: `python tests/emulated [--sanitize] (-m MODULE | SCRIPT) [ARGUMENT …]`."""

import argparse
import os
import runpy
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parent.parent)

import warp as wp  # noqa: E402

from emulated.build import sanitizer_library  # noqa: E402
from emulated.device import Emulation, emulation  # noqa: E402
from emulated.sanitized import environment  # noqa: E402


def main() -> int:
    """Run the program, and say what it has launched."""
    parser = argparse.ArgumentParser(prog="python tests/emulated", description=__doc__)
    parser.add_argument("--sanitize", action="store_true", help="find accesses out of bounds with AddressSanitizer")
    parser.add_argument("-m", dest="is_module", action="store_true", help="PROGRAM is the name of a module")
    parser.add_argument("program", metavar="PROGRAM")
    parser.add_argument("arguments", nargs=argparse.REMAINDER)
    given = parser.parse_args()
    if given.sanitize and os.environ.get("LD_PRELOAD") != sanitizer_library():
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment())
    wp.config.log_level = wp.LOG_WARNING
    sys.argv[1:] = given.arguments
    with emulation(Emulation(given.sanitize)) as emulated:
        if given.is_module:
            runpy.run_module(given.program, run_name="__main__", alter_sys=True)
        else:
            sys.argv[0] = given.program
            runpy.run_path(given.program, run_name="__main__")
    print(f"{len(emulated.launches)} kernels run {sum(emulated.launches.values())} times", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
