"""What the motion of a call is to its steps: paths of bodies that turn, positions at both ends, or many worlds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._engine.host.course import Course
from ccd_warp._rigid.mesh_paths import MeshPaths, check_own_frames
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._runtime.display import listed
from ccd_warp._scene.input.arguments import check_instance, shown
from ccd_warp._scene.input.names import body_label
from ccd_warp._scene.input.options import Options
from ccd_warp._scene.mesh import CollisionMesh

if TYPE_CHECKING:
    from ccd_warp._rigid.motion_worlds import MotionWorlds, Pipeline


def straight_sentence(mesh: CollisionMesh) -> str:
    """What to say of rigid bodies in a call without a motion, which then move as others do."""
    names = [body_label(body, mesh.names) for body in mesh._moving_rigid.tolist()]
    return (
        f"motion is None, and {listed(names)} {'is' if len(names) == 1 else 'are'} rigid: vertices move on "
        f"straight lines, not on arcs; pass a RigidMotion as motion, and vertices in the frames of their "
        f"bodies, or leave out rigid= where the mesh is built"
    )


def paths_of(mesh: CollisionMesh, options: Options, motion: RigidMotion | MeshPaths) -> MeshPaths:
    """The paths of the rigid bodies."""
    if isinstance(motion, MeshPaths):
        return motion
    check_instance("motion", motion, RigidMotion)
    check_options_on_arcs(options)
    return MeshPaths.of(mesh, motion._body_paths)


def check_options_on_arcs(options: Options) -> None:
    """Check that the options are those that arcs have: clips of time, and no fraction of the gap at the start."""
    if not options.is_clipping:
        raise ValueError(f"method is {shown(options.method)}; expected 'clipping' where motion is given")
    if options.start_gap_share > 0.0:
        raise ValueError(
            f"start_gap_fraction is {options.start_gap_fraction}; expected 'hold' or None where motion is given"
        )


def start_of(
    mesh: CollisionMesh, options: Options, vertices_t0: ArrayLike, motion: RigidMotion | MeshPaths | None
) -> NDArray[np.float64]:
    """The positions of all vertices in the world at the start of a step."""
    start = mesh.frame(vertices_t0)
    return start if motion is None else paths_of(mesh, options, motion).at(mesh, start, start, 0.0)


def course_of(
    mesh: CollisionMesh,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    paths: MeshPaths | None,
    motion: RigidMotion | None,
) -> Course:
    """The course of a line search between positions, of bodies on paths in their own frames."""
    if paths is None or motion is None:
        return Course(start, end)
    from ccd_warp._rigid.arc_course import ArcCourse  # few programs need it

    check_own_frames(mesh, start, end)
    return ArcCourse(mesh, start, end, paths, motion)


def worlds_of(
    pipeline: Pipeline, vertices_t0: ArrayLike, vertices_t1: ArrayLike, motion: RigidMotion | None, *, check_start: bool
) -> MotionWorlds | None:
    """The worlds of a motion for a mesh of one world; or None."""
    mesh = pipeline.mesh
    if not isinstance(motion, RigidMotion) or mesh.num_worlds > 1:
        return None
    from ccd_warp._rigid.motion_worlds import MotionWorlds  # few programs need it

    check_options_on_arcs(pipeline._options)
    if check_start and motion.num_worlds > 1:
        raise ValueError(
            f"check_start is True with a motion of {motion.num_worlds} worlds for a mesh of one; expected "
            f"mesh.replicate({motion.num_worlds}), or False"
        )
    start, end = mesh._both_placed(*mesh.frames(vertices_t0, vertices_t1))
    return MotionWorlds(pipeline, start, end, motion)
