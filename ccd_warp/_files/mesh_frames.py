"""Both ends of a step read from mesh files, as a mesh and two frames of positions."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._files import frames as files
from ccd_warp._files.archive import MAX_BYTES
from ccd_warp._files.odd_motion import motion_warnings
from ccd_warp._files.parts import Split, check_split
from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.arguments import check_flag, check_items, check_path
from ccd_warp._scene.input.messages import warn
from ccd_warp._scene.input.names import distinct_names
from ccd_warp._scene.mesh import CollisionMesh


@dataclass(frozen=True, eq=False, repr=False)
class Frames:
    """A step read from files.

    Attributes:
        mesh: The bodies, called by the names of their files, objects or nodes: first those that move, then the static
            ones.
        vertices_t0: Start positions, float64, in the files' length unit, shape [V, 3].
        vertices_t1: End positions, shape [V, 3]; static bodies are where they were.
        source_index: Index of each vertex in its file, the first one of merged vertices, int64, shape [V].
        num_merged: Number of vertices of each body that were merged into others, int64, shape [B].
    """

    mesh: CollisionMesh
    vertices_t0: NDArray[np.float64]
    vertices_t1: NDArray[np.float64]
    source_index: NDArray[np.int64]
    num_merged: NDArray[np.int64]

    @classmethod
    def _of(cls, mesh: CollisionMesh, bodies: Sequence[files.Body]) -> "Frames":
        """The step of bodies, and the mesh that they make."""
        return cls(
            mesh,
            np.concatenate([body.vertices_t0 for body in bodies]),
            np.concatenate([body.vertices_t1 for body in bodies]),
            np.concatenate([body.source_index for body in bodies]).astype(np.int64),
            np.array([body.merged for body in bodies], dtype=np.int64),
        )

    def _warn(self) -> None:
        """Say what is odd about the motion."""
        for sentence in motion_warnings(self.mesh, self.vertices_t0, self.vertices_t1):
            warn(sentence)

    def __repr__(self) -> str:
        merged = f", {self.num_merged.sum():,} vertices merged" if self.num_merged.any() else ""
        return f"Frames({self.mesh!r}{merged})"


def read_frames(
    start_path: str | Path,
    end_path: str | Path,
    *,
    static: Iterable[str | Path | HalfSpace] = (),
    kinematic: Iterable[int | str] = (),
    self_collision: bool | Sequence[bool] = True,
    surface: bool = False,
    split: bool | str = False,
    max_bytes: int = MAX_BYTES,
) -> Frames:
    """Read both ends of a step from mesh files, in full precision, completely or not at all.

    The formats are PLY, OBJ, STL, OFF, GLB, glTF (3MF and DAE where trimesh has what it needs for them), VTU, legacy
    VTK and XDMF (with the extra ``formats``), and ZIP archives of all but the last three. Numbers are double precision
    where the format holds it. The corners of an STL file are merged by their positions in ``start_path``, which
    ``end_path`` must agree with; copies of a vertex that GLB and DAE make at a seam are merged where they coincide at
    both ends.

    A ``RuntimeWarning`` says where the frames are in different units, vertices are at the same places in another order,
    edges shrink to a tenth, or the numbers in the names of the files tell that the two are swapped.

    Each object or group of an OBJ file, node of a scene and file of an archive is a body with its name; those that
    share a vertex are one. A file that holds one body gives it its own name.

    Args:
        start_path: Mesh file of the start positions.
        end_path: Mesh file of the end positions, with the same faces in the same order.
        static: Mesh files of bodies that do not move, or half-spaces.
        kinematic: Indices or names of the bodies that move as they are told, as of
            :meth:`ccd_warp.CollisionMesh.from_arrays`.
        self_collision: Whether a body may collide with itself: one flag for all bodies or one for each.
        surface: Whether volume cells of VTK and XDMF files stand for their boundary surface, as of
            :func:`ccd_warp.read_sequence`.
        split: Whether a file, or a body in it, is divided into its connected components, bodies called ``NAME#0``,
            ``NAME#1`` and so on. Or the name of a field of the cells of VTK and XDMF files, in ``read_sequence`` also
            that of an array of a .npz with a number or a text for each face: cells of one value are a body, called by
            field and value (``material 3``). Those that share a vertex are one body in any case, called by all their
            values. Static files without the field stay whole.
        max_bytes: Limit on the unpacked size of an archive; a plain file may have as much, or 1 GiB.

    Returns:
        The mesh and its positions at both ends, as all functions on meshes take them.

    Raises:
        ValueError: If a file is missing, damaged, cut short, not finite or unpacks to more than the limit, the two
            frames differ in topology, or another argument is not as described.

    Guarantee: every coordinate is the number in the file, rounded to nearest where the file holds decimals.
    """
    start, end = check_path("start_path", start_path), check_path("end_path", end_path)
    surface, split = check_flag("surface", surface), check_split(split)
    obstacles = checked_static(static)
    bodies = files.read_frames(start, end, max_bytes=max_bytes, surface=surface, split=split).split(split)
    bodies += static_bodies(obstacles, max_bytes=max_bytes, surface=surface, split=split)
    frames = Frames._of(mesh_of(bodies, kinematic=kinematic, self_collision=self_collision), bodies)
    frames._warn()
    return frames


def checked_static(static: Any) -> list[Path | HalfSpace]:
    """Paths of mesh files and half-spaces, or a ValueError."""
    items = check_items("static", static, "a list of paths and half-spaces")
    return [item if isinstance(item, HalfSpace) else check_path("static", item) for item in items]


def static_bodies(
    static: Sequence[Path | HalfSpace], *, max_bytes: int, surface: bool, split: Split = False
) -> list[files.Body]:
    """The bodies in mesh files, and half-spaces."""
    bodies = []
    for item in static:
        if isinstance(item, HalfSpace):
            bodies.append(files.Body.of_half_space("half-space", item))
        else:
            bodies += files.read_static(item, max_bytes=max_bytes, surface=surface, split=split).split(split)
    return bodies


def mesh_of(bodies: Sequence[files.Body], **options: Any) -> CollisionMesh:
    """The bodies as one mesh, called by their names, with further options of ``CollisionMesh.from_arrays``."""
    return CollisionMesh.from_arrays(
        [body.arrays for body in bodies],
        static=[b for b, body in enumerate(bodies) if body.is_static],
        names=distinct_names([body.name for body in bodies]),
        **options,
    )
