"""The bodies of a scene as one mesh, and CCD of its steps."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp import CollisionPipeline
from ccd_warp._cli.half_spaces import half_space_bodies
from ccd_warp._cli.process import notice, warnings_on_stderr
from ccd_warp._cli.progress import ProgressLine
from ccd_warp._cli.scene import SceneArguments, StartContacts
from ccd_warp._cli.scope import check_kinds
from ccd_warp._files.frames import Body, make_body
from ccd_warp._input.options import Options
from ccd_warp._intersections import Intersections
from ccd_warp._mesh import CollisionMesh
from ccd_warp._results import MeshResult


@dataclass(frozen=True)
class SolvedStep:
    """A step and its result.

    Attributes:
        bodies: The scene, in the order of its vertices.
        mesh: The bodies as one mesh.
        vertices_t0: Start positions of all vertices, shape [V, 3].
        vertices_t1: End positions, shape [V, 3].
        options: Validated options.
        result: Of ``mesh_ccd``.
        start: What touches, or passes through another, at the start.
        ignored: What is left out of both, because it is in contact in the first frame; None if nothing is.
        timings: Seconds of each stage, in order.
    """

    bodies: Sequence[Body]
    mesh: CollisionMesh
    vertices_t0: NDArray[np.float64]
    vertices_t1: NDArray[np.float64]
    options: Options
    result: MeshResult
    start: Intersections
    ignored: StartContacts | None
    timings: dict[str, float]


def positions_of(bodies: Sequence[Body]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions of the vertices of all bodies at both ends of the step."""
    return np.vstack([body.vertices_t0 for body in bodies]), np.vstack([body.vertices_t1 for body in bodies])


def make_options(given: dict[str, Any], mesh: CollisionMesh) -> Options:
    """The options of the command line, with the length scale that they mean if they give none.

    It is that of the mesh: the longest side of the box around all bodies at the start. The options are validated here,
    so that no message names a function that is not on the command line.

    Raises:
        ValueError: If an option is out of its range, or the bodies cannot form a kind of pair that it names.
    """
    options = Options(**given)
    check_kinds(mesh, options)
    return options if options.length_scale is not None else replace(options, length_scale=mesh.length_scale)


def solve(
    bodies: Sequence[Body],
    mesh: CollisionMesh,
    options: Options,
    line: ProgressLine,
    *,
    is_quiet: bool,
    ignored: StartContacts | None = None,
) -> SolvedStep:
    """Run ``mesh_ccd`` on a step of a mesh, whose bodies these are, with its progress on a line that stays there.

    What intersects at its start is found, too. ``ignored`` is what the mesh leaves out from the first frame on.
    """
    vertices_t0, vertices_t1 = positions_of(bodies)
    with CollisionPipeline.borrowed(mesh, options) as pipeline:
        pipeline._show_progress = line.show
        with warnings_on_stderr(line.clear, is_quiet=is_quiet):
            result = pipeline.mesh_ccd(vertices_t0, vertices_t1)
            timings = {name: seconds for name, seconds in result.timings.items() if name != "total"}
            begin = time.perf_counter()
            start = pipeline.find_intersections(vertices_t0)
            timings["intersections at start"] = time.perf_counter() - begin
    start = start if ignored is None else ignored.others(start)
    return SolvedStep(bodies, mesh, vertices_t0, vertices_t1, options, result, start, ignored, timings)


def solve_scene(
    bodies: Sequence[Body],
    given: dict[str, Any],
    *,
    scene: SceneArguments,
    is_quiet: bool,
    shows_progress: bool = True,
    ignores_start: bool = False,
) -> SolvedStep:
    """Make the mesh of one step and run ``mesh_ccd``."""
    begin = time.perf_counter()
    mesh = scene.mesh(bodies)
    build_seconds = time.perf_counter() - begin
    options, line, ignored = make_options(given, mesh), ProgressLine(is_quiet or not shows_progress), None
    if ignores_start:
        with warnings_on_stderr(is_quiet=is_quiet):
            ignored = StartContacts.of(mesh, positions_of(bodies)[0], options)
        mesh = mesh.excluding(ignored.pairs)
    try:
        step = solve(bodies, mesh, options, line, is_quiet=is_quiet, ignored=ignored)
    finally:
        line.clear()
    return replace(step, timings={"build mesh": build_seconds, **step.timings})


def load_kernels(
    given: dict[str, Any], *, is_quiet: bool, has_radius: bool = False, has_half_space: bool = False
) -> float:
    """Compile or load every kernel on a scene of two triangles, so that no stage's time holds a compilation."""
    begin = time.perf_counter()
    triangle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    above = [[x, y + 0.1, 0.5] for x, y, _ in triangle]
    below = [[x, y + 0.1, -0.5] for x, y, _ in triangle]
    bodies = [
        make_body("moving", above, below, [[0, 1, 2]]),
        make_body("resting", triangle, None, [[0, 1, 2]], is_static=True),
    ]
    bodies += half_space_bodies(["0,0,0,0,0,1"]) if has_half_space else []
    chosen: dict[str, Any] = {name: given[name] for name in ("precision", "device") if name in given}
    with notice("compiling kernels (first run only) …", seconds=2.0, is_quiet=is_quiet):
        scene = SceneArguments(self_collision=False, radius=["0.1"] if has_radius else [])
        solve_scene(bodies, chosen, scene=scene, is_quiet=is_quiet, shows_progress=False)
    return time.perf_counter() - begin
