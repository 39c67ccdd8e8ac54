"""The command ``ccd-warp``: CCD (continuous collision detection) of two mesh files, a demo, a benchmark."""

import argparse
import os
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from ccd_warp._cli.arguments import add_options, add_scene_arguments, add_verbosity
from ccd_warp._cli.process import FAILED, INTERRUPTED, say, spelled_streams, standard_output, start_quietly
from ccd_warp._input.messages import printable
from ccd_warp._runtime.shared_header import remove_headers
from ccd_warp._runtime.threads import is_any_aside
from ccd_warp._version import __version__

# A command is imported when it runs, with what it alone needs: the engine, trimesh, the extras.


class _BadUsageError(ValueError):
    """A command line that argparse refuses."""


class _Parser(argparse.ArgumentParser):
    """Reports a bad command line in one line; argparse prints the usage, too."""

    def error(self, message: str) -> NoReturn:
        raise _BadUsageError(f"{message}; see {self.prog} --help")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: Arguments after the program's name; those of the process by default.

    Returns:
        Exit status: 0 for a finished run, with a collision or without; 1 where ``--fail-on-contact`` is given and there
        is a contact, or ``bench`` found an answer missed or late; 2 for bad input, and for a file that cannot be
        written, with one line on stderr; 130 after Ctrl-C. A pipe whose reader has gone changes nothing.
    """
    with spelled_streams():
        return _answered(argv)


def _answered(argv: Sequence[str] | None) -> int:
    try:
        with standard_output():
            # argparse would take what follows an option for its value where that may be left out
            given = ["--split=" if each == "--split" else each for each in (sys.argv[1:] if argv is None else argv)]
            arguments = _make_parser().parse_args(given)
            return arguments.command(arguments)
    except ValueError as error:  # of the library's own checks, too: each message names the argument and the finding
        say(f"ccd-warp: error: {printable(str(error))}")
        return 2
    except OSError as error:
        place = f"{error.filename}: " if error.filename is not None else ""
        say(f"ccd-warp: error: {printable(f'{place}{error.strerror or error}')}")
        return 2
    except KeyboardInterrupt:
        return INTERRUPTED


def _make_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="ccd-warp",
        description="Continuous collision detection (CCD) of deforming triangle meshes: "
        "earliest times of impact over a step, never late.",
    )
    parser.add_argument("--version", action="version", version=f"ccd-warp {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_run(commands)
    _add_sequence(commands)
    _add_demo(commands)
    _add_bench(commands)
    return parser


def _add_run(commands) -> None:
    parser = commands.add_parser(
        "run",
        help="earliest times of impact between two frames of a mesh",
        description="Every vertex moves on a straight line from its place in START to its place in END; with --poses "
        "rigid bodies turn, and their vertices move on arcs. Exit status: "
        "0 for a finished run, with a collision or without, 1 for a contact with --fail-on-contact, 2 for bad input.",
    )
    parser.add_argument(
        "start", metavar="START", help="mesh at the start of the step: PLY, OBJ, STL, OFF, GLB or an archive"
    )
    parser.add_argument("end", metavar="END", nargs="?", help="mesh at its end, with the same faces; none with --poses")
    parser.add_argument(
        "--output",
        metavar="FILE",
        type=Path,
        help="write contacts and the toi of every vertex as .npz, .json or .csv (two files: NAME.csv holds the "
        "contacts, NAME_vertices.csv the vertices); - writes JSON to standard output, and the report to stderr",
    )
    parser.add_argument(
        "--picture", metavar="FILE", type=Path, help="draw the step at its start, toi and end as .png (extra 'viz')"
    )
    add_scene_arguments(parser)
    add_options(parser)
    parser.set_defaults(command=_run)


def _add_sequence(commands) -> None:
    parser = commands.add_parser(
        "sequence",
        help="earliest times of impact in every step of a sequence of frames",
        description="Every vertex moves on a straight line from each frame to the next; with --poses rigid bodies "
        "turn, and their vertices move on arcs. Ctrl-C keeps what was "
        "computed, and the same command goes on from there. Exit status: 0 for a finished run, with a collision or "
        "without, 1 for a contact with --fail-on-contact, 2 for bad input, 130 after Ctrl-C.",
    )
    parser.add_argument(
        "frames",
        metavar="FRAME",
        nargs="+",
        type=Path,
        help="mesh files, in the order of the numbers in their names, where files of another name are another body; or "
        "folders of them, or caches, a body each: .npz of positions, .pvd, .xdmf",
    )
    parser.add_argument(
        "--output",
        metavar="DIR",
        type=Path,
        default=Path("ccd_warp_sequence"),
        help="folder of steps.csv and steps.png (ccd_warp_sequence); - writes the CSV alone, to standard output, and "
        "the report to stderr",
    )
    parser.add_argument(
        "--picture",
        metavar="FILE",
        type=Path,
        help="an animation as .gif or .mp4 (which needs ffmpeg), or the first step with a contact as .png (extra "
        "'viz')",
    )
    parser.add_argument(
        "--displacement", metavar="NAME", help="field of a VTK or XDMF file that is added to its positions"
    )
    parser.add_argument(
        "--faces", metavar="FILE", type=Path, help="mesh whose faces a .npz takes that holds positions alone"
    )
    add_scene_arguments(parser)
    add_options(parser)
    parser.set_defaults(command=_sequence)


def _add_demo(commands) -> None:
    parser = commands.add_parser(
        "demo",
        help="two built-in scenes",
        description="A bullet through a thin wall, which a test at both ends of the step misses; and a cloth that "
        "drops over a sphere.",
    )
    parser.add_argument(
        "--output-dir", metavar="DIR", type=Path, help="write the scenes' meshes (PLY) and results (JSON) there"
    )
    parser.add_argument("--pictures", metavar="DIR", type=Path, help="draw the scenes as .png there (extra 'viz')")
    add_verbosity(parser)
    add_options(parser)
    parser.set_defaults(command=_demo)


def _add_bench(commands) -> None:
    parser = commands.add_parser(
        "bench",
        help="how fast this machine is, and whether anything is missed",
        description="Times queries whose exact answers are known by construction, and whole steps of a cloth; counts "
        "missed, late and phantom answers; beside ipc-toolkit where it is installed. Exit status: 1 where an answer of "
        "ours is missed or late, else 0.",
    )
    parser.add_argument("--quick", action="store_true", help="fewer queries and rounds: half a minute on two cores")
    parser.add_argument("--devices", metavar="NAME", nargs="+", help="Warp devices (the CPU and every GPU)")
    parser.add_argument(
        "--output",
        metavar="DIR",
        type=Path,
        default=Path("ccd_warp_bench"),
        help="folder of bench.csv and bench.png (ccd_warp_bench); the picture needs the extra 'bench'",
    )
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    parser.set_defaults(command=_bench)


def _run(arguments: argparse.Namespace) -> int:
    from ccd_warp._cli.run import run_step

    return run_step(arguments)


def _sequence(arguments: argparse.Namespace) -> int:
    from ccd_warp._cli.sequence import run_sequence

    return run_sequence(arguments)


def _demo(arguments: argparse.Namespace) -> int:
    from ccd_warp._cli.demo_command import run_demo

    return run_demo(arguments)


def _bench(arguments: argparse.Namespace) -> int:
    from ccd_warp._cli.bench import run_bench

    start_quietly(None)
    return run_bench(arguments)


def run_program() -> NoReturn:
    """The command ``ccd-warp``: :func:`main`, and the end of the process."""
    try:
        status = main()
    except Exception:  # Python's own status of a traceback is 1, which means contact here
        traceback.print_exc()
        status = FAILED
    # After Ctrl-C nobody waits for modules to be cleared; a compiler at work would delay the end, or end with a fault.
    if status == INTERRUPTED or is_any_aside():
        if sys.stdout is not None:
            with suppress(OSError):
                sys.stdout.flush()
        remove_headers()
        os._exit(status)
    sys.exit(status)
