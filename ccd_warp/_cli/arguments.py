"""Arguments that several commands take: the options of the collision detection, the scene, how much is printed."""

import argparse
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

from ccd_warp._files.archive import MAX_BYTES
from ccd_warp._input.option_types import BroadPhase, MeshOptions, Method, PairKindName, Precision
from ccd_warp._input.options import Options

_DEFAULTS: dict[str, Any] = {field.name: field.default for field in fields(Options)}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of every public function; one that is not given is the library's default."""
    group = parser.add_argument_group("options of the collision detection")

    def add(name: str, text: str, absent: str | None = None, **how: Any) -> None:
        default = _DEFAULTS[name] if absent is None else absent
        shown = f"{default:g}" if isinstance(default, float) else default
        group.add_argument(f"--{name.replace('_', '-')}", help=f"{text} ({shown})", **how)

    add("tolerance", "width at which a contact is accepted, in length scales", type=float, metavar="X")
    add("minimum_separation", "gap that counts as a contact, in length scales", type=float, metavar="X")
    add(
        "minimum_distance",
        "Euclidean distance that counts as a contact, in the unit of the positions",
        type=float,
        metavar="L",
    )
    add(
        "start_gap_fraction",
        "separation of a pair at most F times its start gap, so that a close start can move",
        "off",
        type=float,
        metavar="F",
    )
    add("t_max", "look at [0, T] of the step only", type=float, metavar="T")
    add("max_iterations", "limit of the work on a pair", type=int, metavar="N")
    add("max_work", "limit of the work on all hard pairs of a kind", type=int, metavar="N")
    add(
        "length_scale",
        "length that tolerance and minimum separation are multiples of",
        "longest side of the box around all bodies at the start",
        type=float,
        metavar="L",
    )
    add("precision", "arithmetic of the kernels", choices=get_args(Precision))
    add("method", "the bisection is the literature's, for comparison", choices=get_args(Method))
    add("broad_phase", "how pairs that may touch are found; both give the same answer", choices=get_args(BroadPhase))
    names = [name.replace("_", "-") for name in get_args(PairKindName)]
    add(
        "pair_kinds",
        f"{', '.join(names)}, with commas between",
        "all that the bodies can form",
        type=lambda text: text.replace("-", "_").split(","),
        metavar="KINDS",
    )
    add("memory_limit", "memory of the step beside its input", "1 GiB for the pairs", type=int, metavar="BYTES")
    add("device", "cpu, cuda, cuda:1, …", "Warp's default device", metavar="NAME")
    add("num_threads", "threads on the CPU", "all cores", type=int, metavar="N")


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what `run` and `sequence` take alike: obstacles, limits, and what decides the exit status."""
    parser.add_argument(
        "--poses",
        metavar="FILE",
        type=Path,
        help="rigid bodies: poses of the bodies of one mesh file, in which each is in its own frame. A CSV or .json "
        "with a row for each body and time: t, body, px, py, pz, qx, qy, qz, qw; a body without rows does not move",
    )
    parser.add_argument(
        "--path",
        choices=("linear", "screw"),
        help="how a body of --poses moves: its origin on a straight line, or the body on a screw (linear)",
    )
    parser.add_argument(
        "--static",
        metavar="FILE",
        type=Path,
        action="append",
        default=[],
        help="an obstacle that does not move; may be given several times",
    )
    parser.add_argument(
        "--kinematic",
        metavar="NAME",
        action="append",
        default=[],
        help="a body that moves as it is told, as a scripted wall: it is tested against free bodies alone; may be "
        "given several times",
    )
    parser.add_argument(
        "--half-space",
        metavar="[NAME=]X,Y,Z,NX,NY,NZ",
        action="append",
        default=[],
        help="a half-space that does not move, as a ground, by a point of its plane and the normal that points out of "
        "it; may be given several times",
    )
    parser.add_argument(
        "--radius",
        metavar="[NAME=]R",
        action="append",
        default=[],
        help="half the thickness of all bodies, or of one, in the unit of the files; may be given several times",
    )
    parser.add_argument(
        "--exclude",
        metavar="FILE",
        type=Path,
        help="pairs to leave out: rows of text KEY,A,B, as vertices,12,340 or bodies,cloth,wall; a .npz of arrays by "
        "key; or a .npy of pairs of vertices",
    )
    parser.add_argument(
        "--exclusion-rings",
        type=int,
        metavar="N",
        default=1,
        help="leave out pairs with two vertices that fewer than N edges connect (1: pairs that share a vertex)",
    )
    parser.add_argument(
        "--ignore-start-contacts",
        action="store_true",
        help="leave out of every step the pairs that are in contact in the first frame, as at a clamped edge",
    )
    parser.add_argument(
        "--surface",
        action="store_true",
        help="take the boundary surface of volume cells: tetrahedra, hexahedra, wedges and pyramids of VTK and XDMF",
    )
    parser.add_argument(
        "--split",
        metavar="[=FIELD]",
        type=lambda text: text or True,
        default=False,
        help="without a FIELD, each file is divided into its connected components, bodies called NAME#0, NAME#1, ...; "
        "--split=FIELD: by a field of the cells of VTK and XDMF files, or by an array of a .npz, a value for each face",
    )
    parser.add_argument("--no-self-collision", action="store_true", help="leave out contacts of a body with itself")
    parser.add_argument(
        "--max-bytes",
        type=int,
        metavar="BYTES",
        default=MAX_BYTES,
        help=f"what an archive of meshes (ZIP, …) may unpack to ({MAX_BYTES >> 20} MiB); a file may have 1 GiB",
    )
    parser.add_argument("--fail-on-contact", action="store_true", help="end with exit status 1 if there is a contact")
    add_verbosity(parser)


def add_verbosity(parser: argparse.ArgumentParser) -> None:
    """Add how much is printed."""
    verbosity = parser.add_mutually_exclusive_group()
    verbosity.add_argument("--verbose", action="store_true", help="print what each stage counted, too")
    verbosity.add_argument("--quiet", action="store_true", help="print nothing but errors")


def given_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """The options that the command line gives."""
    names = MeshOptions.__optional_keys__
    return {name: value for name in sorted(names) if (value := getattr(arguments, name)) is not None}
