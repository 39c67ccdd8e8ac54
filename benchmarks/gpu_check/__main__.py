"""The command ``python -m ccd_warp.benchmarks.gpu_check``."""

from __future__ import annotations

import argparse
import sys
from importlib.util import find_spec
from pathlib import Path

import warp as wp

if find_spec("pytest") is None:
    sys.exit("error: gpu_check needs pytest; install with: pip install pytest")

from ccd_warp.benchmarks.gpu_check import pack, precompile
from ccd_warp.benchmarks.gpu_check.bits import read_answers
from ccd_warp.benchmarks.gpu_check.emulation import require_emulation
from ccd_warp.benchmarks.gpu_check.fingerprint import fingerprint, identity
from ccd_warp.benchmarks.gpu_check.journal import Journal
from ccd_warp.benchmarks.gpu_check.runner import run_all, run_ordered
from ccd_warp.benchmarks.gpu_check.stages import NAMES
from ccd_warp.benchmarks.gpu_check.summary import complaints, summary
from ccd_warp.benchmarks.gpu_check.target import CPU, CUDA, EMULATED, Target

# Folders of a checkout, with a file by which each is known.
_FOLDERS = {"tests": "benchmarks/test_gpu_check.py", "examples": "newton_cloth.py"}
_MINUTES = 8.0


def parser() -> argparse.ArgumentParser:
    """The options."""
    result = argparse.ArgumentParser(
        prog="python -m ccd_warp.benchmarks.gpu_check",
        description="What a GPU answers and how fast, in at most eight minutes; docs/cuda.md says more. The command "
        "gpu_check pack --out DIR makes what a machine without Warp and without a network needs.",
    )
    result.add_argument("--output", metavar="DIR", type=Path, help="folder of gpu_check.jsonl and gpu_check.md")
    result.add_argument("--device", metavar="NAME", help="Warp device (cuda:0); cpu rehearses, shortened")
    result.add_argument("--emulated", action="store_true", help="run the CUDA source on the CPU, shortened")
    result.add_argument("--minutes", metavar="X", type=float, default=_MINUTES, help="time for all stages (8)")
    result.add_argument("--only", metavar="STAGE", nargs="+", help=f"stages to run: {', '.join(NAMES)} (all)")
    result.add_argument("--again", action="store_true", help="measure anew what an earlier run has in --output")
    result.add_argument("--tests", metavar="DIR", type=Path, help="folder of the tests (that of a checkout)")
    result.add_argument("--examples", metavar="DIR", type=Path, help="folder of the examples (that of a checkout)")
    result.add_argument(
        "--precompile", metavar="DIR", type=Path, help="make cubins, without a GPU, and do nothing else"
    )
    result.add_argument(
        "--arch", metavar="N", type=int, nargs="+", default=list(precompile.ARCHS), help="of --precompile (80 90 120)"
    )
    result.add_argument("--modules", metavar="WORD", nargs="+", default=[], help="of --precompile: only these modules")
    result.add_argument("--precompiled", metavar="DIR", type=Path, help="folder that --precompile has filled")
    result.add_argument("--answers", metavar="FILE", type=Path, help="digests of the CPU's answers, made by pack")
    result.add_argument(
        "--apart", action="store_true", help="of a rehearsal: each stage in a process of its own, as on a GPU"
    )
    result.add_argument("--stage", help=argparse.SUPPRESS)
    return result


def checked(given: argparse.Namespace) -> None:
    """Check what can be checked before anything is started.

    Raises:
        ValueError: If an argument is wrong.
    """
    if given.output is None:
        raise ValueError("output is not given; expected --output DIR, or --precompile DIR")
    if not given.minutes > 0:
        raise ValueError(f"minutes is {given.minutes}; expected a positive number")
    for name in given.only or []:
        if name not in NAMES:
            raise ValueError(f"only holds {name!r}; expected some of {', '.join(NAMES)}")
    if given.emulated and given.device not in (None, "cpu"):
        raise ValueError(f"emulated is given with device {given.device!r}; expected no device, as it runs on the CPU")
    for name in _FOLDERS:
        folder = getattr(given, name)
        if folder is not None and not folder.is_dir():
            raise ValueError(f"{name} is {folder}; expected a folder")


def found(name: str, file: str) -> Path | None:
    """A folder of the checkout that this package is in, or that is the current folder; None if there is none."""
    places = (root / name for root in (Path(__file__).resolve().parents[2], Path.cwd()))
    return next((folder for folder in places if (folder / file).is_file()), None)


def target_of(given: argparse.Namespace) -> Target:
    """The device that is checked.

    Raises:
        ValueError: If there is no such device.
    """
    if given.emulated:
        return Target("cpu", EMULATED, is_short=True)
    device = given.device or "cuda:0"
    if device == "cpu":
        return Target("cpu", CPU, is_short=True)
    names = [each.alias for each in wp.get_devices()]
    if device not in names:
        raise ValueError(
            f"device is {device!r}; expected one of {', '.join(names)} (--emulated and --device cpu need no GPU)"
        )
    return Target(device, CUDA)


def check(given: argparse.Namespace) -> int:
    """Run the stages, and write and print the summary.

    Returns:
        0 if every stage that ran ended as it should, and nothing failed or differs from the CPU; else 1.
    """
    checked(given)
    folder: Path = given.output
    folder.mkdir(parents=True, exist_ok=True)
    if given.precompiled is not None:
        print(precompile.check_folder(given.precompiled), flush=True)
        precompile.use_in_all_processes(given.precompiled)
    target = target_of(given)
    places = {name: getattr(given, name) or found(name, file) for name, file in _FOLDERS.items()}
    if given.answers is not None:
        places["answers"] = given.answers.resolve()
        print(
            f"{len(read_answers(places['answers'], target.is_short))} answers of the CPU are carried along", flush=True
        )
    settings = {"device": target.device, "kind": target.kind, "code": fingerprint(), "warp": wp.config.version}
    settings["gpu"] = identity(target.device)
    journal = Journal(folder, settings)
    chosen = list(given.only or NAMES)
    print(journal.begin(chosen if given.only or given.again else []), flush=True)
    if given.emulated:
        require_emulation(places["tests"])
    is_apart = given.apart or target.is_real
    run_all(target, places, journal, chosen, 60 * given.minutes, lambda line: print(line, flush=True), is_apart)
    stages = journal.stages()
    print("\n" + "\n".join(summary(settings, stages)))
    return int(bool(complaints(stages)))


def main(arguments: list[str] | None = None) -> int:
    """The command.

    Returns:
        Its exit status.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["pack"]:
        return pack.main(arguments[1:])
    given = parser().parse_args(arguments)
    wp.config.log_level = wp.LOG_WARNING
    try:
        if given.stage is not None:
            precompile.use_named()
            return run_ordered(given.stage, given.output)
        if given.precompile is not None:
            given.precompile.mkdir(parents=True, exist_ok=True)
            precompile.use(given.precompile, cubins=False)
            precompile.precompile(given.precompile, given.arch, lambda line: print(line, flush=True), given.modules)
            return 0
        return check(given)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; the stages that have ended are kept, and the same command goes on from there")
        return 130


if __name__ == "__main__":
    sys.exit(main())
