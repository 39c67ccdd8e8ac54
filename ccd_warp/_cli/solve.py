"""CCD of the steps of a scene."""

import argparse
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._calls.pipeline import CollisionPipeline
from ccd_warp._cli.arguments import command_line_options
from ccd_warp._cli.process import warnings_on_stderr
from ccd_warp._cli.progress_line import ProgressLine
from ccd_warp._cli.scene import StartContacts
from ccd_warp._engine.mesh.scene import possible_kinds
from ccd_warp._files.sequence import Frames, FrameSequence
from ccd_warp._results.intersections import Intersections
from ccd_warp._results.results import MeshResult
from ccd_warp._runtime.display import kind_name
from ccd_warp._runtime.kernel_cache import announced_compilation
from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.progress import Progress
from ccd_warp._scene.input.messages import InputError
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh


@dataclass(frozen=True)
class SolvedStep:
    """A step and its result.

    Attributes:
        frames: The mesh, and its positions at both ends.
        options: Validated options.
        result: Of ``mesh_ccd``.
        start: What touches, or passes through another, at the start.
        ignored: What is left out of both, because it is in contact in the first frame; None if nothing is.
        timings: Seconds of each stage, in order, without a total.
    """

    frames: Frames
    options: Options
    result: MeshResult
    start: Intersections
    ignored: StartContacts | None
    timings: dict[str, float]

    @property
    def mesh(self) -> CollisionMesh:
        """The mesh."""
        return self.frames.mesh

    @property
    def crossing(self) -> Intersections:
        """Edges that pass through faces at the start."""
        return self.start[self.start.is_crossing]

    @lazy_property
    def ends(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions at both ends; vertices that take no part are where others of their bodies are."""
        return self.mesh._both_placed(self.frames.vertices_t0, self.frames.vertices_t1)

    @lazy_property
    def displacement(self) -> float:
        """The largest distance of a vertex from its place at the start."""
        start, end = self.ends
        with np.errstate(over="ignore"):
            return float(np.linalg.norm(end - start, axis=1).max(initial=0.0))


def make_options(values: dict[str, Any], mesh: CollisionMesh) -> Options:
    """The options of the command line, with the length scale of the mesh if they give none.

    Raises:
        ValueError: If an option is out of its range, or the bodies cannot form a kind of pair that it names.
    """
    options, possible = Options(**values), possible_kinds(mesh, Options())
    for kind in options.kinds if options.pair_kinds is not None else ():
        if kind not in possible:
            raise InputError(
                f"--pair-kinds holds {kind_name(kind)}, which these bodies cannot form, as they have no particles, "
                f"cables or half-spaces; expected some of {', '.join(map(kind_name, possible))}"
            )
    return options if options.length_scale is not None else replace(options, length_scale=mesh.length_scale)


def solve(
    frames: Frames,
    options: Options,
    line: ProgressLine,
    *,
    is_quiet: bool,
    show: Callable[[Progress], None] | None = None,
    ignored: StartContacts | None = None,
) -> SolvedStep:
    """Run ``mesh_ccd`` on a step, with its progress on a line that stays there, and find what intersects at its start.

    ``ignored`` is what the mesh leaves out from the first frame on.
    """
    with (
        nullcontext() if is_quiet else announced_compilation(),
        warnings_on_stderr(line.clear, is_quiet=is_quiet),
        CollisionPipeline._borrowed(frames.mesh, options) as pipeline,
    ):
        pipeline._show_progress = line.show if show is None else show
        result = pipeline.mesh_ccd(frames.vertices_t0, frames.vertices_t1)
        timings = {name: seconds for name, seconds in result.timings.items() if name != "total"}
        begin = time.perf_counter()
        start = pipeline.find_intersections(frames.vertices_t0)
        timings["intersections_at_start"] = time.perf_counter() - begin
    start = start if ignored is None else ignored.others(start)
    return SolvedStep(frames, options, result, start, ignored, timings)


class Steps:
    """The steps of a sequence, and the line that says how far they are.

    Attributes:
        sequence: The sequence, whose mesh leaves out what is ignored.
        options: Validated options.
        ignored: What is in contact in the first frame, where that is left out of every step.
        at_start: Positions in the first frame.
        line: The line.
    """

    def __init__(self, arguments: argparse.Namespace, sequence: FrameSequence) -> None:
        self.sequence, self.is_quiet, self.ignored = sequence, arguments.quiet, None
        first = sequence.step(0)
        self.at_start, _ = sequence.mesh._both_placed(first.vertices_t0, first.vertices_t1)
        self.options = make_options(command_line_options(arguments), sequence.mesh)
        if arguments.ignore_start_contacts:
            with warnings_on_stderr(is_quiet=self.is_quiet):
                self.ignored = StartContacts.of(sequence.mesh, self.at_start, self.options)
            sequence.mesh = sequence.mesh.excluding(self.ignored.pairs)
        self.line, self._progress = ProgressLine(self.is_quiet), Progress()

    def __len__(self) -> int:
        return len(self.sequence) - 1

    def begin(self, what: str, total: int) -> None:
        """Show a share of so many items of some name, in place of the stages of a step."""
        self._progress.begin(what, total)
        self.line.show(self._progress)

    def advance(self) -> None:
        """One more is done."""
        self._progress.done += 1
        self.line.show(self._progress)

    def solved(self, k: int) -> SolvedStep:
        """A step and its result."""
        show = None if not self._progress.stage else lambda _: self.line.show(self._progress)
        how: dict[str, Any] = {"show": show, "ignored": self.ignored}
        return solve(self.sequence.step(k), self.options, self.line, is_quiet=self.is_quiet, **how)
