"""The arguments of all commands."""

import argparse
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, NoReturn, get_args

from ccd_warp._cli.compile import add_compile
from ccd_warp._cli.doctor import add_doctor
from ccd_warp._runtime.version import __version__
from ccd_warp._scene.input.option_types import BroadPhase, MeshOptions, Method, PairKindName, Precision
from ccd_warp._scene.input.options import Options

_DEFAULTS: dict[str, Any] = {field.name: field.default for field in fields(Options)}
_STATUS = (
    "Exit status: 0 for a finished run, with a collision or without, 1 for a contact with --fail-on-contact, "
    "2 for bad input, 130 after Ctrl-C."
)
_FLAG: dict[str, Any] = {"action": "store_true"}
_REPEATED: dict[str, Any] = {"action": "append", "default": []}


class _BadUsageError(ValueError):
    """A command line that argparse refuses."""


class _Parser(argparse.ArgumentParser):
    """Reports a bad command line in one line; argparse prints the usage, too."""

    def error(self, message: str) -> NoReturn:
        raise _BadUsageError(f"{message}; see {self.prog} --help")


def _file(metavar: str = "FILE", **how: Any) -> dict[str, Any]:
    return {"metavar": metavar, "type": Path, **how}


def make_parser() -> argparse.ArgumentParser:
    """The parser of the command line; ``command`` is the module of ``ccd_warp._cli`` that runs it."""
    parser = _Parser(
        prog="ccd-warp",
        description="Continuous collision detection (CCD) of deforming triangle meshes: "
        "earliest times of impact over a step, never late.",
    )
    parser.add_argument("--version", action="version", version=f"ccd-warp {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, dest="command")
    for name, text, description, add_arguments in (
        (
            "run",
            "earliest times of impact between two frames of a mesh",
            f"Every vertex moves on a straight line from its place in START to its place in END. {_STATUS}",
            _add_run,
        ),
        (
            "sequence",
            "earliest times of impact in every step of a sequence of frames",
            "Every vertex moves on a straight line from each frame to the next. Ctrl-C keeps the rows of the steps so "
            f"far. {_STATUS}",
            _add_sequence,
        ),
        (
            "demo",
            "two built-in scenes",
            "A bullet through a thin wall, which a test at both ends of the step misses; and a cloth that drops over a "
            "sphere.",
            _add_demo,
        ),
        (
            "bench",
            "how fast this machine is, and whether anything is missed",
            "Times queries whose exact answers are known by construction, and whole steps of a cloth; counts missed, "
            "late and phantom answers; beside ipc-toolkit where it is installed. Exit status: 1 where an answer of "
            "ours is missed or late, else 0.",
            _add_bench,
        ),
    ):
        command = commands.add_parser(name, help=text, description=description)
        add_arguments(_adder(command))
        _adder(command)("--quiet", "print nothing but errors", **_FLAG)
        if name != "bench":
            _add_options(_adder(command.add_argument_group("options of the collision detection")))
    add_compile(commands)
    add_doctor(commands)
    return parser


_Add = Callable[..., None]


def _adder(parser: Any) -> _Add:
    """A function that adds an argument by its name, what help says of it, and how it is read."""

    def add(name: str, text: str, **how: Any) -> None:
        parser.add_argument(name, help=text, **how)

    return add


def _add_run(add: _Add) -> None:
    add("start", "mesh at the start of the step: PLY, OBJ, STL, OFF, GLB, VTU, ...", **_file("START"))
    add("end", "mesh at its end, with the same faces", **_file("END"))
    text = "write contacts and the toi of every vertex as .npz or .json; - writes JSON to standard output"
    add("--output", f"{text}, and the report to stderr", **_file())
    add("--picture", "draw the step at its start, toi and end as .png (extra 'viz')", **_file())
    _add_scene(add)


def _add_sequence(add: _Add) -> None:
    text = "mesh files, in the order of the numbers in their names, where files of another name are another body"
    others = "or folders of them, or files of many frames, a body each: .pvd, .xdmf"
    add("frames", f"{text}; {others}", **_file("FRAME", nargs="+"))
    text = "folder of steps.csv (ccd_warp_sequence); - writes the CSV alone, to standard output"
    add("--output", f"{text}, and the report to stderr", **_file("DIR", default=Path("ccd_warp_sequence")))
    add("--picture", "draw the first step with a contact as .png (extra 'viz')", **_file())
    _add_scene(add)


def _add_demo(add: _Add) -> None:
    add("--output-dir", "write the scenes' meshes (PLY) and results (JSON) there", **_file("DIR"))
    add("--pictures", "draw the scenes as .png there (extra 'viz')", **_file("DIR"))


def _add_bench(add: _Add) -> None:
    add("--quick", "fewer queries and rounds: half a minute on two cores", **_FLAG)
    add("--devices", "Warp devices (the CPU and every GPU)", metavar="NAME", nargs="+")
    add("--output", "folder of bench.csv (ccd_warp_bench)", **_file("DIR", default=Path("ccd_warp_bench")))


def _add_scene(add: _Add) -> None:
    """What `run` and `sequence` take alike: obstacles, limits, and what decides the exit status."""
    again = "may be given several times"
    add("--static", f"an obstacle that does not move; {again}", **_file(), **_REPEATED)
    text = "a body that moves as it is told, as a scripted wall: it is tested against free bodies alone"
    add("--kinematic", f"{text}; {again}", metavar="NAME", **_REPEATED)
    text = "a half-space that does not move, as a ground, by a point of its plane and the normal that points out of it"
    add("--half-space", f"{text}; {again}", metavar="[NAME=]X,Y,Z,NX,NY,NZ", **_REPEATED)
    text = "half the thickness of all bodies, or of one, in the unit of the files"
    add("--radius", f"{text}; {again}", metavar="[NAME=]R", **_REPEATED)
    add("--exclude", f"two bodies that never meet, as cloth,wall; {again}", metavar="A,B", **_REPEATED)
    text = "leave out pairs with two vertices that fewer than N edges connect (1: pairs that share a vertex)"
    add("--exclusion-rings", text, type=int, metavar="N", default=1)
    text = "leave out of every step the pairs that are in contact in the first frame, as at a clamped edge"
    add("--ignore-start-contacts", text, **_FLAG)
    add("--displacement", "field of a file of cells that is added to its positions", metavar="NAME")
    text = "take the boundary surface of volume cells: tetrahedra, hexahedra, wedges and pyramids of a file"
    add("--surface", text, **_FLAG)
    add("--split", "divide each file into its connected components, called NAME#0, NAME#1, ...", **_FLAG)
    add("--no-self-collision", "leave out contacts of a body with itself", **_FLAG)
    add("--fail-on-contact", "end with exit status 1 if there is a contact", **_FLAG)


def _add_options(add_argument: _Add) -> None:
    """The options of every public function; one that is not given is the library's default."""

    def add(name: str, text: str, absent: str | None = None, **how: Any) -> None:
        default = _DEFAULTS[name] if absent is None else absent
        shown = f"{default:g}" if isinstance(default, float) else default
        add_argument(f"--{name.replace('_', '-')}", f"{text} ({shown})", **how)

    add("tolerance", "width at which a contact is accepted, in length scales", type=float, metavar="X")
    add("minimum_separation", "gap that counts as a contact, in length scales", type=float, metavar="X")
    text = "Euclidean distance that counts as a contact, in the unit of the positions"
    add("minimum_distance", text, type=float, metavar="L")
    text = "separation of a pair at most F times its start gap, so that a close start can move"
    add("start_gap_fraction", text, "off", type=float, metavar="F")
    add("t_max", "look at [0, T] of the step only", type=float, metavar="T")
    add("max_iterations", "limit of the work on a pair", type=int, metavar="N")
    add("max_work", "limit of the work on all hard pairs of a kind", type=int, metavar="N")
    box = "longest side of the box around all bodies at the start"
    text = "length that tolerance and minimum separation are multiples of"
    add("length_scale", text, box, type=float, metavar="L")
    add("precision", "arithmetic of the kernels", choices=get_args(Precision))
    add("method", "the bisection is the literature's, for comparison", choices=get_args(Method))
    add("broad_phase", "how pairs that may touch are found; both give the same answer", choices=get_args(BroadPhase))
    names = [name.replace("_", "-") for name in get_args(PairKindName)]
    text = f"{', '.join(names)}, with commas between"
    read = {"type": lambda kinds: kinds.replace("-", "_").split(","), "metavar": "KINDS"}
    add("pair_kinds", text, "all that the bodies can form", **read)
    add("memory_limit", "memory of the step beside its input", "1 GiB for the pairs", type=int, metavar="BYTES")
    add("device", "cpu, cuda, cuda:1, ...", "Warp's default device", metavar="NAME")
    add("num_threads", "threads on the CPU", "all cores", type=int, metavar="N")


def command_line_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """The options that the command line gives."""
    names = MeshOptions.__optional_keys__
    return {name: value for name in sorted(names) if (value := getattr(arguments, name)) is not None}
