"""``ccd-warp compile``: kernels compiled before they are needed, for this machine or for others that take its cache."""

import argparse
import shutil
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from ccd_warp._cli.process import start_quietly, teller
from ccd_warp._cli.progress_line import ProgressLine
from ccd_warp._runtime.beforehand import compile_modules
from ccd_warp._runtime.kept_hashes import hashes_of
from ccd_warp._runtime.lanes import cpu_lanes
from ccd_warp._runtime.packaged import write_index
from ccd_warp._runtime.progress import Progress
from ccd_warp._runtime.target import LEVELS, cpu_target
from ccd_warp._scene.input.options import resolve_device

# What a word of --for adds to what all steps in float64 need, by parts of the names in `every_module`.
_OF_START = ("start_distances", "near_contacts", "measure_pairs")
WORDS = {
    "mesh_ccd": (),
    "pairs": (),
    "collision_free_step": _OF_START,
    "line_search": _OF_START,
    "launch": ("input_rows", "contact_points"),
    "thickness": ("thick", "euclidean", "arc_ball"),
    "separation": ("own_box",),
    "float32": ("float32",),
    "2d": (" 2",),
    "hash": ("hash",),
    "half_spaces": ("planes",),
    "excluded_pairs": ("True",),
    "find_candidates": ("boxes ",),
    "find_proximity": ("proximity", "measure_pairs", "near_planes", "unique"),
    "find_intersections": ("intersections",),
    "motion": ("arc_", "place_bodies", "shorten_paths", "part_overlap"),
    "gradients": ("toi_", "adjoint", "attained", "ordered_sums", "regularity"),
}


def add_compile(commands: Any) -> None:
    """Add the command to those of the parser."""
    text = "compile kernels before they are needed"
    more = "Compiles side by side into Warp's kernel cache (WARP_CACHE_PATH) what is not there yet, for images of "
    more += "containers, for machines without a network or a GPU, or before a demonstration."
    command = commands.add_parser("compile", help=text, description=more)
    where = command.add_mutually_exclusive_group()
    where.add_argument("--device", help="cpu, cuda, cuda:1, ... (Warp's default device)", metavar="NAME")
    text = "compile for GPUs of these architectures, such as 90; no GPU is needed"
    where.add_argument("--arch", help=text, type=int, nargs="+", metavar="N", default=[])
    what = command.add_mutually_exclusive_group()
    what.add_argument("--all", help="all kernels there are: several minutes", action="store_true")
    text = f"what steps in float64 need, and what these add, with commas between: {', '.join(WORDS)} (mesh_ccd)"
    what.add_argument("--for", help=text, dest="words", metavar="WORDS", type=_words, default={"mesh_ccd"})
    text = "put all kernels into a new folder, as a wheel takes them, for all levels of x86-64 and --arch, or --device"
    command.add_argument("--package", help=text, metavar="DIR", type=Path)
    command.add_argument("--quiet", help="print nothing but errors", action="store_true")


def needed(names: Iterable[str], words: Collection[str]) -> list[str]:
    """Of the names of `every_module` those of what the words need."""
    marks = {mark for marks in WORDS.values() for mark in marks}
    allowed = {mark for word in words for mark in WORDS[word]}
    return [name for name in names if all(mark in allowed for mark in marks if mark in name)]


def run(arguments: argparse.Namespace) -> int:
    """Compile, and say what for and where to."""
    from ccd_warp._runtime.every_module import every_module  # defines all kernels that can be imported plainly

    start_quietly(arguments.device)
    line = ProgressLine(arguments.quiet)
    progress, tell = Progress(line.show), teller(None, is_quiet=arguments.quiet)
    places: list[tuple[int | None, Any]] = [(None, arch) for arch in arguments.arch]
    if arguments.package:
        arguments.package.mkdir(parents=True)
        places += [] if arguments.device else LEVELS.items()
    if not places:
        device = resolve_device(arguments.device)
        places = [(None, device) if device.is_cuda else (cpu_lanes(), cpu_target())]
    hashes: dict[str, list[Any]] = {}
    for width, place in places:
        modules = every_module(width)
        is_all = arguments.all or arguments.package
        names = list(modules) if is_all else needed(modules, arguments.words)
        made = compile_modules({name: modules[name] for name in names}, place, progress)
        line.clear()
        shown = f"sm_{place}" if isinstance(place, int) else place
        if arguments.package:
            for name, path in made.items():
                shutil.copyfile(path, arguments.package / name)
            for module in modules.values():
                hashes |= hashes_of(module, 1 if width else module.options["block_dim"])
        at = arguments.package or next((path.parents[1] for path in made.values()), "the package")
        tell(f"{len(names)} modules for {shown} are in {at}")
    if arguments.package:
        write_index(arguments.package, hashes)
    return 0


def _words(text: str) -> set[str]:
    words = set(text.split(","))
    if unknown := words - WORDS.keys():
        raise argparse.ArgumentTypeError(f"unknown {', '.join(sorted(unknown))}; expected some of {', '.join(WORDS)}")
    return words
