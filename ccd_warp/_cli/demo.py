"""``ccd-warp demo``: a bullet through a thin wall, and a cloth over a sphere."""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from ccd_warp._calls.pipeline import CollisionPipeline
from ccd_warp._cli.arguments import command_line_options
from ccd_warp._cli.output import write_result
from ccd_warp._cli.pictures import check_picture, draw_step
from ccd_warp._cli.process import make_folder, start_quietly, teller
from ccd_warp._cli.progress_line import ProgressLine
from ccd_warp._cli.report import format_report, format_toi
from ccd_warp._cli.solve import SolvedStep, make_options, solve
from ccd_warp._files.ply import write_ply
from ccd_warp._files.sequence import Frames
from ccd_warp._scene.input.messages import printable
from ccd_warp._scene.mesh import CollisionMesh


@dataclass(frozen=True)
class DemoScene:
    """A scene of the demo.

    Attributes:
        name: Short name, also of its files.
        title: What it shows.
        frames: A body that moves and an obstacle, at both ends of the step.
    """

    name: str
    title: str
    frames: Frames


def bullet_scene() -> DemoScene:
    """A ball of radius 0.1 flies nine units in one step through a wall 0.02 thick."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    wall = trimesh.creation.box(extents=(0.02, 5.0, 5.0))
    # Off the bullet's line, so that it does not hit the diagonal between two faces of the wall.
    wall.apply_translation([5.0, 3.5, 0.4])
    ends = ball.vertices + [0.5, 3.5, 0.0], ball.vertices + [9.5, 3.5, 0.0]
    frames = _frames(("bullet", "wall"), ends, ball.faces, wall, self_collision=False)
    return DemoScene("bullet", "bullet through a thin wall, one step", frames)


def cloth_scene(cells: int = 71) -> DemoScene:
    """A rippled square cloth of ``2 cells²`` faces drops onto a sphere of radius 1."""
    steps = np.linspace(-1.5, 1.5, cells + 1)
    x, y = (grid.reshape(-1) for grid in np.meshgrid(steps, steps, indexing="ij"))
    ripple = 0.02 * np.sin(5.0 * x) * np.cos(4.0 * y)
    start = np.column_stack([x, y, 1.15 + ripple])
    # Free fall of the middle while the corners lag: the step deforms the cloth and ends inside the sphere.
    end = np.column_stack([0.99 * x, 0.99 * y, start[:, 2] - 0.35 + 0.05 * (x * x + y * y)])
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    faces = np.vstack(
        [
            np.column_stack([corner, corner + cells + 1, corner + 1]),
            np.column_stack([corner + 1, corner + cells + 1, corner + cells + 2]),
        ]
    )
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    frames = _frames(("cloth", "sphere"), (start, end), faces, sphere, self_collision=True)
    return DemoScene("cloth", "cloth over a sphere, one step", frames)


def _frames(
    names: tuple[str, str],
    ends: tuple[NDArray[np.float64], NDArray[np.float64]],
    faces: NDArray[np.integer],
    obstacle: trimesh.Trimesh,
    *,
    self_collision: bool,
) -> Frames:
    """A body that moves, and a static one."""
    bodies = [(ends[0], faces), (obstacle.vertices, obstacle.faces)]
    mesh = CollisionMesh.from_arrays(bodies, static=[1], names=names, self_collision=self_collision)
    start, end = (np.concatenate([moving, obstacle.vertices]) for moving in ends)
    index = np.concatenate([np.arange(len(vertices)) for vertices, _ in bodies])
    return Frames(mesh, start, end, index, np.zeros(2, dtype=np.int64))


def run(arguments: argparse.Namespace) -> int:
    """Solve the scenes one after the other; the exit status is 0."""
    start_quietly(arguments.device)
    folder, pictures, is_quiet = arguments.output_dir, arguments.pictures, arguments.quiet
    scenes = (bullet_scene(), cloth_scene())
    for path, option in ((folder, "--output-dir"), (pictures, "--pictures")):
        if path is not None:
            make_folder(path, option)
    for scene in scenes if pictures is not None else ():
        check_picture(pictures / f"{scene.name}.png", "--pictures")
    tell, option_values = teller(None, is_quiet=is_quiet), command_line_options(arguments)
    for number, scene in enumerate(scenes, 1):
        line, mesh = ProgressLine(is_quiet), scene.frames.mesh
        try:
            step = solve(scene.frames, make_options(option_values, mesh), line, is_quiet=is_quiet)
        finally:
            line.clear()
        tell(f"{format_report(f'demo {number}: {scene.title}', step)}\n")
        if scene.name == "bullet":
            at_start, at_end = _tests_at_both_ends(step)
            tell(f"  test at the start of the step  {at_start}\n  test at the end of the step    {at_end}")
            tell(f"  CCD over the whole step        toi = {format_toi(step.result.toi)}\n")
        if pictures is not None:
            draw_step(pictures / f"{scene.name}.png", step)
        if folder is not None:
            _write(folder, scene)
            write_result(folder / f"{scene.name}.json", step)
    for path, what in ((folder, "meshes and results"), (pictures, "pictures")):
        if path is not None:
            tell(f"wrote the {what} to {printable(str(path))}")
    return 0


def _write(folder: Path, scene: DemoScene) -> None:
    """Write both frames of the body that moves, and the obstacle."""
    mesh = scene.frames.mesh
    for time, positions in enumerate((scene.frames.vertices_t0, scene.frames.vertices_t1)):
        for body, name in enumerate(mesh.names if time == 0 else mesh.names[:1]):
            first, last = mesh.body_vertex_range[body : body + 2].tolist()
            faces = mesh.faces[mesh.face_body == body] - first
            write_ply(folder / f"{scene.name}_{name}_t{time}.ply", positions[first:last], faces)


def _tests_at_both_ends(step: SolvedStep) -> list[str]:
    """What a simulation without CCD finds: whether surfaces cross at the start, and whether they do at the end."""
    with CollisionPipeline._borrowed(step.mesh, step.options) as pipeline:
        ends = (step.frames.vertices_t0, step.frames.vertices_t1)
        num_crossing = [pipeline.find_intersections(vertices).num_crossing for vertices in ends]
    return ["HIT" if count else "MISS" for count in num_crossing]
