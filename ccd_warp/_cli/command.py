"""The command ``ccd-warp``: CCD (continuous collision detection) of two mesh files, a demo, a page, a benchmark."""

import argparse
import logging
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import warp as wp

# The demo, the benchmark and pictures are imported where they are used: they load trimesh and the extras.
from ccd_warp._cli.output import check_output_path, write_result
from ccd_warp._cli.progress import ProgressLine
from ccd_warp._cli.report import format_report, format_toi
from ccd_warp._files.archive import MAX_BYTES
from ccd_warp._files.frames import Body, InputError, make_body, read_frames, read_static, write_mesh
from ccd_warp._input.messages import printable
from ccd_warp._input.names import distinct_names
from ccd_warp._input.options import Options, resolve_device
from ccd_warp._mesh import CollisionMesh
from ccd_warp._pipeline import CollisionPipeline
from ccd_warp._runtime.threads import is_any_aside
from ccd_warp._version import __version__

_INTERRUPTED = 130  # the status of a command that Ctrl-C has ended


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
        Exit status: 0 for a finished run, with a collision or without; 1 where ``bench --compare`` found something
        worse; 2 for bad input, with one line on stderr; 130 after Ctrl-C.
    """
    try:
        arguments = _make_parser().parse_args(argv)
        return arguments.command(arguments)
    except ValueError as error:  # of the library's own checks, too: each message names the argument and the finding
        _say(f"ccd-warp: error: {printable(str(error))}")
        return 2
    except BrokenPipeError:  # the reader of a pipe has seen enough; Python would fail again when it flushes stdout
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        return _INTERRUPTED


def _make_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="ccd-warp",
        description="Continuous collision detection (CCD) of deforming triangle meshes: "
        "earliest times of impact over a step, never late.",
    )
    parser.add_argument("--version", action="version", version=f"ccd-warp {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    run = commands.add_parser(
        "run",
        help="earliest times of impact between two frames of a mesh",
        description="Every vertex moves on a straight line from its place in START to its place in END. Exit status: "
        "0 for a finished run, with a collision or without; 2 for bad input.",
    )
    run.add_argument(
        "start", metavar="START", help="mesh at the start of the step: PLY, OBJ, STL, OFF, GLB or an archive"
    )
    run.add_argument("end", metavar="END", help="mesh at its end, with the same faces")
    run.add_argument(
        "--static", metavar="FILE", nargs="+", action="extend", default=[], help="obstacles that do not move"
    )
    run.add_argument("--no-self-collision", action="store_true", help="leave out contacts of the mesh with itself")
    run.add_argument(
        "--output",
        metavar="FILE",
        type=Path,
        help="write contacts and the toi of every vertex as .npz, .json or .csv (two files: NAME.csv holds the "
        "contacts, NAME_vertices.csv the vertices)",
    )
    run.add_argument(
        "--max-bytes",
        type=int,
        metavar="BYTES",
        help="what an archive of meshes (ZIP, …) may unpack to (256 MiB)",
    )
    run.add_argument(
        "--picture", metavar="FILE", type=Path, help="draw the step at its start, toi and end as .png (extra 'viz')"
    )
    _add_options(run)
    run.set_defaults(command=_run)

    demo = commands.add_parser(
        "demo",
        help="two built-in scenes",
        description="A bullet through a thin wall, which a test at both ends of the step misses; and a cloth that "
        "drops over a sphere.",
    )
    demo.add_argument(
        "--output-dir", metavar="DIR", type=Path, help="write the scenes' meshes (PLY) and results (JSON) there"
    )
    demo.add_argument("--pictures", metavar="DIR", type=Path, help="draw the scenes as .png there (extra 'viz')")
    _add_options(demo)
    demo.set_defaults(command=_demo)

    explore = commands.add_parser(
        "explore",
        help="a page to play with the method",
        description="Writes one HTML page that opens in a browser, without a network: a bullet and a wall, tested at "
        "samples and by CCD; and a point and a segment, solved by bisection and by clips, step by step.",
    )
    explore.add_argument(
        "--output",
        metavar="FILE",
        type=Path,
        default=Path("ccd_warp_explore.html"),
        help="where to write it (ccd_warp_explore.html)",
    )
    explore.add_argument("--quiet", action="store_true", help="print nothing but errors")
    explore.set_defaults(command=_explore)

    bench = commands.add_parser(
        "bench",
        help="speed against error, beside the peers (extra 'bench')",
        description="Measures time, error, and missed, late and phantom answers of ours, ipc-toolkit's Tight-Inclusion "
        "and additive CCD, the univariate cubic and others, on published and generated queries, and whole steps. "
        "Ctrl-C keeps what was measured, and the same command goes on from there.",
    )
    from ccd_warp.benchmarks.command import add_arguments

    add_arguments(bench)
    bench.set_defaults(command=_bench)
    return parser


def _add_options(parser: argparse.ArgumentParser) -> None:
    """The options of every public function; one not given is the library's default."""
    group = parser.add_argument_group("options of the collision detection")
    group.add_argument(
        "--tolerance", type=float, metavar="X", help="width at which a contact is accepted, in length scales (1e-6)"
    )
    group.add_argument(
        "--minimum-separation", type=float, metavar="X", help="gap that counts as a contact, in length scales (0)"
    )
    group.add_argument(
        "--start-gap-fraction",
        type=float,
        metavar="F",
        help="separation of a pair at most F times its start gap, so that a close start can move (off)",
    )
    group.add_argument("--t-max", type=float, metavar="T", help="look at [0, T] of the step only (1)")
    group.add_argument("--max-iterations", type=int, metavar="N", help="limit of the work on a pair (10000)")
    group.add_argument(
        "--max-work", type=int, metavar="N", help="limit of the work on all hard pairs of a kind (5000000)"
    )
    group.add_argument(
        "--length-scale", type=float, metavar="L", help="unit of the two above (longest side of the motion's box)"
    )
    group.add_argument("--precision", choices=("float64", "float32"), help="arithmetic of the kernels (float64)")
    group.add_argument(
        "--method", choices=("clipping", "bisection"), help="bisection: the literature's, for comparison (clipping)"
    )
    group.add_argument(
        "--pair-kinds",
        type=lambda text: text.replace("-", "_").split(","),
        metavar="KINDS",
        help="vertex-face, edge-edge, point-segment, point-point, with commas between (all)",
    )
    group.add_argument(
        "--memory-limit", type=int, metavar="BYTES", help="memory of the step beside its input (1 GiB for the pairs)"
    )
    group.add_argument("--device", metavar="NAME", help="cpu, cuda, cuda:1, … (Warp's default device)")
    group.add_argument("--num-threads", type=int, metavar="N", help="threads on the CPU (all cores)")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def _given_options(arguments: argparse.Namespace) -> dict[str, Any]:
    from ccd_warp._input.option_types import MeshOptions

    names = MeshOptions.__optional_keys__
    return {name: value for name in sorted(names) if (value := getattr(arguments, name)) is not None}


def _run(arguments: argparse.Namespace) -> int:
    _start_quietly(arguments.device)
    if arguments.output is not None:
        check_output_path(arguments.output)
    if arguments.picture is not None:
        _check_picture(arguments.picture, "--picture")
    begin = time.perf_counter()
    max_bytes = MAX_BYTES if arguments.max_bytes is None else arguments.max_bytes
    bodies = [read_frames(arguments.start, arguments.end, max_bytes=max_bytes)]
    bodies += [read_static(path, max_bytes=max_bytes) for path in arguments.static]
    read_seconds = time.perf_counter() - begin

    options = _given_options(arguments)
    kernel_seconds = _load_kernels(options, quiet=arguments.quiet)
    mesh, result, timings = _solve(
        bodies, options, self_collision=not arguments.no_self_collision, is_quiet=arguments.quiet
    )
    timings = {"read files": read_seconds, "load kernels": kernel_seconds, **timings}
    written: list[Path] = []
    if arguments.output is not None:
        begin = time.perf_counter()
        written = write_result(arguments.output, bodies, mesh, result)
        timings["write files"] = time.perf_counter() - begin
    if arguments.picture is not None:
        begin = time.perf_counter()
        written.append(_draw(arguments.picture, bodies, mesh, result, options))
        timings["draw picture"] = time.perf_counter() - begin
    if not arguments.quiet:
        _print_report(f"{arguments.start} -> {arguments.end}", bodies, mesh, result, timings, options)
        for path in written:
            print(f"wrote {printable(str(path))}")
    return 0


def _demo(arguments: argparse.Namespace) -> int:
    from ccd_warp._cli.demo import bullet_scene, cloth_scene, static_test

    _start_quietly(arguments.device)
    folder, pictures = arguments.output_dir, arguments.pictures
    scenes = (bullet_scene(), cloth_scene())
    if folder is not None:
        _make_folder(folder, "--output-dir")
    if pictures is not None:
        _make_folder(pictures, "--pictures")
        for scene in scenes:
            _check_picture(pictures / f"{scene.name}.png", "--pictures")
    options = _given_options(arguments)
    kernel_seconds = _load_kernels(options, quiet=arguments.quiet)
    for number, scene in enumerate(scenes):
        mesh, result, timings = _solve(
            scene.bodies, options, self_collision=scene.self_collision, is_quiet=arguments.quiet
        )
        if number == 0:
            timings = {"load kernels": kernel_seconds, **timings}
        if not arguments.quiet:
            if number:
                print()
            _print_report(f"demo {number + 1}: {scene.title}", scene.bodies, mesh, result, timings, options)
            if scene.compare_static_test:
                at_start, at_end = static_test(scene.bodies)
                print()
                print(f"  test at the start of the step  {'HIT' if at_start else 'MISS'}")
                print(f"  test at the end of the step    {'HIT' if at_end else 'MISS'}")
                print(f"  CCD over the whole step        toi = {format_toi(result.toi)}")
        if pictures is not None:
            _draw(pictures / f"{scene.name}.png", scene.bodies, mesh, result, options)
        if folder is None:
            continue
        for body in scene.bodies:
            write_mesh(folder / f"{scene.name}_{body.name}_t0.ply", body.vertices_t0, body.faces)
            if not body.is_static:
                write_mesh(folder / f"{scene.name}_{body.name}_t1.ply", body.vertices_t1, body.faces)
        write_result(folder / f"{scene.name}.json", scene.bodies, mesh, result)
    if folder is not None and not arguments.quiet:
        print(f"\nwrote the meshes and results to {printable(str(folder))}")
    if pictures is not None and not arguments.quiet:
        print(f"\nwrote the pictures to {printable(str(pictures))}")
    return 0


def _explore(arguments: argparse.Namespace) -> int:
    from ccd_warp._cli.explore import write_page

    path = write_page(arguments.output)
    if not arguments.quiet:
        print(f"wrote {printable(str(path))}; open it in a browser")
    return 0


def _make_folder(folder: Path, option: str) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{option} {folder}: cannot create it ({error.strerror or error})") from error


def _check_picture(path: Path, option: str) -> None:
    """Refuse a picture that cannot be drawn or written, before the work is done."""
    from ccd_warp.viz._file import check_picture_path
    from ccd_warp.viz._window import drawing_without_display

    check_picture_path(path, option)
    try:
        with _closed_stderr(), drawing_without_display():
            pass
    except (ImportError, RuntimeError) as error:
        raise InputError(f"{option}: {error}") from error


def _draw(path: Path, bodies: list[Body], mesh, result, options: dict[str, Any]) -> Path:
    from ccd_warp import viz

    vertices_t0 = np.vstack([body.vertices_t0 for body in bodies])
    vertices_t1 = np.vstack([body.vertices_t1 for body in bodies])
    try:
        with _closed_stderr():
            viz.render_step(path, mesh, vertices_t0, vertices_t1, result, t_max=options.get("t_max", 1.0))
            return path
    except OSError as error:
        raise InputError(f"cannot write {path} ({error.strerror or error})") from error


def _bench(arguments: argparse.Namespace) -> int:
    from ccd_warp.benchmarks.command import run

    _start_quietly(None)
    return run(arguments)


def _print_report(title: str, bodies: list[Body], mesh, result, timings: dict[str, float], options: dict) -> None:
    device = wp.get_device(options.get("device"))
    where = device.name if device.is_cuda else "CPU"
    title = f"ccd-warp {__version__}  {title}  ({options.get('precision', 'float64')}, {where})"
    print(format_report(title, bodies, mesh, result, timings, options.get("t_max", 1.0)))


def _solve(
    bodies: list[Body], options: dict[str, Any], *, self_collision: bool, is_quiet: bool
) -> tuple[Any, Any, dict[str, float]]:
    """Put the bodies into one mesh and run ``mesh_ccd``; the seconds of every stage come with the result."""

    begin = time.perf_counter()
    mesh = CollisionMesh.from_arrays(
        [(body.vertices_t0, body.faces) for body in bodies],
        static=[k for k, body in enumerate(bodies) if body.is_static],
        self_collision=self_collision,
        names=distinct_names([body.name for body in bodies]),
    )
    vertices_t0 = np.vstack([body.vertices_t0 for body in bodies])
    vertices_t1 = np.vstack([body.vertices_t1 for body in bodies])
    build_seconds = time.perf_counter() - begin
    line = ProgressLine(is_quiet)
    # options made here, so that no message names a function that is not on the command line
    with CollisionPipeline.borrowed(mesh, Options(**options)) as pipeline:
        pipeline._show_progress = line.show
        try:
            with _warnings_on_stderr(line, is_quiet=is_quiet):
                result = pipeline.mesh_ccd(vertices_t0, vertices_t1)
        finally:
            line.clear()
    stages = {name: seconds for name, seconds in result.timings.items() if name != "total"}
    return mesh, result, {"build mesh": build_seconds, **stages}


@contextmanager
def _warnings_on_stderr(line: ProgressLine, *, is_quiet: bool):
    """Print what the library warns of as one line each."""

    def show(message: Any, *_: Any, **__: Any) -> None:
        if not is_quiet:
            line.clear()
            _say(f"ccd-warp: warning: {printable(str(message))}")

    with warnings.catch_warnings():
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = show
        yield


def _load_kernels(options: dict[str, Any], *, quiet: bool) -> float:
    """Compile or load every kernel on a scene of two triangles, so that no stage's time holds a compilation."""

    begin = time.perf_counter()
    triangle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    above = [[x, y + 0.1, 0.5] for x, y, _ in triangle]
    below = [[x, y + 0.1, -0.5] for x, y, _ in triangle]
    bodies = [
        make_body("moving", above, below, [[0, 1, 2]]),
        make_body("resting", triangle, None, [[0, 1, 2]], is_static=True),
    ]
    chosen: dict[str, Any] = {name: options[name] for name in ("precision", "device") if name in options}
    with _notice("compiling kernels (first run only) …", seconds=2.0, quiet=quiet):
        _solve(bodies, chosen, self_collision=False, is_quiet=True)
    return time.perf_counter() - begin


@contextmanager
def _notice(message: str, *, seconds: float, quiet: bool):
    """Say ``message`` on a terminal's stderr if the work inside takes longer than ``seconds``."""
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield
        return
    timer = threading.Timer(seconds, lambda: _say(message))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _say(line: str) -> None:
    """Print a line on stderr, where there is one; ``print`` would take stdout where there is none."""
    if sys.stderr is not None:
        print(line, file=sys.stderr, flush=True)


def _start_quietly(device: str | None) -> None:
    """Start Warp without its banner, and keep compile messages and trimesh's log off the terminal.

    Args:
        device: The device asked for.

    Raises:
        ValueError: If there is no such device.
    """

    wp.config.log_level = wp.LOG_ERROR
    with _closed_stderr(), _heeded_interrupts():
        import trimesh  # noqa: F401

        wp.init()

        resolve_device(device)
    logger = logging.getLogger("trimesh")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False


@contextmanager
def _heeded_interrupts():
    """Raise Ctrl-C again where the work inside has caught it, as trimesh catches whatever its imports raise."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught = []
    before = signal.getsignal(signal.SIGINT)

    def heed(number: int, frame: Any) -> None:
        caught.append(number)
        if callable(before):
            before(number, frame)

    if callable(before):  # else it is ignored, as in a job in the background
        signal.signal(signal.SIGINT, heed)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if caught:
        raise KeyboardInterrupt


@contextmanager
def _closed_stderr():
    """Drop what native code writes to stderr: without a CUDA driver Warp complains there, whatever its log level."""
    try:
        saved = os.dup(2)
    except OSError:  # the process has no stderr
        yield
        return
    try:
        with open(os.devnull, "wb") as null:
            os.dup2(null.fileno(), 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


def run_program() -> NoReturn:
    """The command ``ccd-warp``: :func:`main`, and the end of the process."""
    status = main()

    # after Ctrl-C nobody waits for modules to be cleared; a compiler at work would hold up the end, or end with a fault
    if status == _INTERRUPTED or is_any_aside():
        if sys.stdout is not None:
            with suppress(OSError):
                sys.stdout.flush()
        os._exit(status)
    sys.exit(status)


if __name__ == "__main__":
    run_program()
