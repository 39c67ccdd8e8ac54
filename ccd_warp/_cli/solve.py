"""CCD of one step of a scene."""

import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp import CollisionPipeline
from ccd_warp._cli.process import waiting, warnings_on_stderr
from ccd_warp._cli.progress_line import ProgressLine
from ccd_warp._cli.scene import StartContacts
from ccd_warp._engine.mesh.scene import possible_kinds
from ccd_warp._files.frames import Body
from ccd_warp._files.odd_motion import motion_warnings
from ccd_warp._results.contact_place import MovingVertices
from ccd_warp._results.intersections import Intersections
from ccd_warp._results.results import MeshResult
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._runtime.display import kind_name
from ccd_warp._runtime.kernel_cache import announced_compilation
from ccd_warp._runtime.progress import Progress
from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.messages import InputError
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh


@dataclass(frozen=True)
class SolvedStep:
    """A step and its result.

    Attributes:
        bodies: The scene, in the order of its vertices.
        mesh: The bodies as one mesh.
        options: Validated options.
        result: Of ``mesh_ccd``.
        start: What touches, or passes through another, at the start.
        ignored: What is left out of both, because it is in contact in the first frame; None if nothing is.
        timings: Seconds of each stage, in order.
        motion: How rigid bodies turn, whose positions are in their own frames; None where all vertices move straight.
    """

    bodies: Sequence[Body]
    mesh: CollisionMesh
    options: Options
    result: MeshResult
    start: Intersections
    ignored: StartContacts | None
    timings: dict[str, float]
    motion: RigidMotion | None = None

    @property
    def crossing(self) -> Intersections:
        """Edges that pass through faces at the start."""
        return self.start[self.start.is_crossing]

    @cached_property
    def moving(self) -> MovingVertices:
        """How the vertices move."""
        return moving_vertices(self.mesh, self.bodies, self.motion)

    @cached_property
    def displacement(self) -> float:
        """The largest distance of a vertex from its place at the start."""
        start = self.moving.all_at(0.0)
        with np.errstate(over="ignore"):
            ways = [np.linalg.norm(self.moving.all_at(t) - start, axis=1) for t in self.moving.times[1:]]
        return max(float(way.max(initial=0.0)) for way in ways)

    @property
    def warnings(self) -> list[str]:
        """What is odd about the motion, a line each."""
        return motion_warnings(self.mesh, *positions_of(self.bodies), self.options.t_max)


def positions_of(bodies: Sequence[Body]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions of the vertices of all bodies at both ends of the step."""
    return np.vstack([body.vertices_t0 for body in bodies]), np.vstack([body.vertices_t1 for body in bodies])


def moving_vertices(mesh: CollisionMesh, bodies: Sequence[Body], motion: RigidMotion | None) -> MovingVertices:
    """How the vertices of all bodies move; those that take no part as others of their bodies do."""
    places = mesh._both_placed(*positions_of(bodies))
    return MovingVertices(mesh, *places) if motion is None else motion._moving(mesh, *places)


def make_options(given: dict[str, Any], mesh: CollisionMesh, start: NDArray[np.float64] | None = None) -> Options:
    """The options of the command line, with the length scale that they mean if they give none.

    It is that of the mesh: the longest side of the box around all bodies at the start, where ``start`` says where they
    are if they have frames of their own.

    Raises:
        ValueError: If an option is out of its range, or the bodies cannot form a kind of pair that it names.
    """
    options, possible = Options(**given), possible_kinds(mesh, Options())
    for kind in options.kinds if options.pair_kinds is not None else ():
        if kind not in possible:
            raise InputError(
                f"--pair-kinds holds {kind_name(kind)}, which these bodies cannot form, as they have no particles, "
                f"cables or half-spaces; expected some of {', '.join(map(kind_name, possible))}"
            )
    if options.length_scale is not None:
        return options
    size = 0.0 if start is None else float(np.ptp(start, axis=0).max())
    return replace(options, length_scale=size if size > 0.0 and np.isfinite(size) else mesh.length_scale)


def solve(
    bodies: Sequence[Body],
    mesh: CollisionMesh,
    options: Options,
    line: ProgressLine,
    *,
    is_quiet: bool,
    show: Callable[[Progress], None] | None = None,
    ignored: StartContacts | None = None,
    motion: RigidMotion | None = None,
) -> SolvedStep:
    """Run ``mesh_ccd`` on a step of a mesh, whose bodies these are, with its progress on a line that stays there.

    What intersects at its start is found, too. ``ignored`` is what the mesh leaves out from the first frame on.
    """
    with CollisionPipeline.borrowed(mesh, options) as pipeline, warnings_on_stderr(line.clear, is_quiet=is_quiet):
        pipeline._show_progress = line.show if show is None else show
        result = pipeline.mesh_ccd(*positions_of(bodies), motion=motion)
        timings = {name: seconds for name, seconds in result.timings.items() if name != "total"}
        begin = time.perf_counter()
        start = pipeline.find_intersections(moving_vertices(mesh, bodies, motion).all_at(0.0))
        timings["intersections at start"] = time.perf_counter() - begin
    start = start if ignored is None else ignored.others(start)
    return SolvedStep(bodies, mesh, options, result, start, ignored, timings, motion)


def solve_scene(
    bodies: Sequence[Body],
    given: dict[str, Any],
    make_mesh: Callable[[Sequence[Body]], CollisionMesh],
    *,
    is_quiet: bool,
    ignores_start: bool = False,
    motion: RigidMotion | None = None,
) -> SolvedStep:
    """Make the mesh of one step and run ``mesh_ccd``."""
    begin = time.perf_counter()
    with waiting("making the mesh", is_quiet=is_quiet):
        mesh = make_mesh(bodies)
    timings, ignored = {"build mesh": time.perf_counter() - begin}, None
    at_start = moving_vertices(mesh, bodies, motion).all_at(0.0)
    options, line = make_options(given, mesh, None if motion is None else at_start), ProgressLine(is_quiet)
    if ignores_start:
        with warnings_on_stderr(is_quiet=is_quiet):
            ignored = StartContacts.of(mesh, at_start, options)
        mesh = mesh.excluding(ignored.pairs)
    try:
        step = solve(bodies, mesh, options, line, is_quiet=is_quiet, ignored=ignored, motion=motion)
    finally:
        line.clear()
    return replace(step, timings={**timings, **step.timings})


def load_kernels(
    given: dict[str, Any],
    *,
    is_quiet: bool,
    has_radius: bool = False,
    has_half_space: bool = False,
    has_poses: bool = False,
) -> float:
    """Compile or load every kernel on two triangles, so that no stage's time holds a compilation; the seconds."""
    begin = time.perf_counter()
    low = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    start, end = (low, low) if has_poses else (low + [0.0, 0.1, 0.5], low + [0.0, 0.1, -0.5])
    bodies = [(start, [[0, 1, 2]]), (low, [[0, 1, 2]])]
    planes = [HalfSpace([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])] * has_half_space
    motion = RigidMotion([[0.0, 0.1, 0.5, 0, 0, 0, 1]], [[0.0, 0.1, -0.5, 0, 0, 0, 1]]) if has_poses else None
    chosen: dict[str, Any] = {name: given[name] for name in ("precision", "device") if name in given}
    with nullcontext() if is_quiet else announced_compilation(), waiting("loading kernels", is_quiet=is_quiet):
        mesh = CollisionMesh.from_arrays(
            [*bodies, *planes],
            static=[1],
            self_collision=False,
            radius=[0.1, 0.1, 0.0][: 2 + len(planes)] if has_radius else None,
            rigid=[0] if has_poses else [],
        )
        with CollisionPipeline.borrowed(mesh, Options(**chosen)) as pipeline:
            pipeline.mesh_ccd(np.vstack([start, low]), np.vstack([end, low]), motion=motion)
            pipeline.find_intersections(np.vstack([start, low]))
    return time.perf_counter() - begin
