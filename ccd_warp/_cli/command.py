"""The command ``ccd-warp``: CCD (continuous collision detection) of mesh files, a demo, and a benchmark."""

import os
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from typing import NoReturn

from ccd_warp._cli.arguments import make_parser
from ccd_warp._cli.process import FAILED, INTERRUPTED, say, write_out
from ccd_warp._runtime.shared_header import remove_headers
from ccd_warp._runtime.threads import is_any_aside
from ccd_warp._scene.input.messages import printable


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: Arguments after the program's name; those of the process by default.

    Returns:
        Exit status: 0 for a finished run, with a collision or without; 1 where ``--fail-on-contact`` is given and there
        is a contact, or ``bench`` found an answer missed or late; 2 for bad input, and for a file that cannot be
        written, with one line on stderr; 130 after Ctrl-C. A pipe whose reader has gone changes nothing.
    """
    try:
        try:
            arguments = make_parser().parse_args(argv)
        finally:
            write_out("", sys.stdout)  # what argparse has printed
        # a command is imported when it runs, with what it alone needs: trimesh, the extras
        status: int = import_module(f"ccd_warp._cli.{arguments.command}").run(arguments)
        return status
    except ValueError as error:  # of the library's own checks, too: each message names the argument and the finding
        say(f"ccd-warp: error: {printable(str(error))}")
        return 2
    except OSError as error:
        place = f"{error.filename}: " if error.filename is not None else ""
        say(f"ccd-warp: error: {printable(f'{place}{error.strerror or error}')}")
        return 2
    except KeyboardInterrupt:
        return INTERRUPTED


def run_program() -> NoReturn:
    """The command ``ccd-warp``: :func:`main`, and the end of the process."""
    if sys.stdout is not None:
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]  # Python would raise an error
    try:
        status = main()
    except Exception:  # Python's own status of a traceback is 1, which means contact here
        traceback.print_exc()
        status = FAILED
    # After Ctrl-C nobody waits for modules to be cleared; a compiler at work would delay the end, or end with a fault.
    if status == INTERRUPTED or is_any_aside():
        remove_headers()
        os._exit(status)
    sys.exit(status)
