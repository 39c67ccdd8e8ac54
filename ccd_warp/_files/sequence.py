"""Frames of moving bodies read from files: both ends of a step, or a sequence, frame by frame."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from ccd_warp._files.bodies import Body, FileBodies, mesh_of, static_bodies
from ccd_warp._files.series import FileSeries, Series, find_series
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.arguments import check_flag, check_items, check_path, shown
from ccd_warp._scene.input.mesh_checks import listed_bodies
from ccd_warp._scene.input.messages import printable
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
    def _of(
        cls, mesh: CollisionMesh, bodies: Sequence[Body], start: NDArray[np.float64], end: NDArray[np.float64]
    ) -> "Frames":
        """The step of a mesh between two positions; ``bodies`` are those of the mesh."""
        source_index = np.concatenate([body.source_index for body in bodies]).astype(np.int64)
        return cls(mesh, start, end, source_index, np.array([body.num_merged for body in bodies], dtype=np.int64))

    def __repr__(self) -> str:
        merged = f", {self.num_merged.sum():,} vertices merged" if self.num_merged.any() else ""
        return f"Frames({self.mesh!r}{merged})"


class FrameSequence:
    """The frames of one body or several, which :func:`ccd_warp.read_sequence` has found; each is read when asked for.

    ``len(sequence)`` is the number of frames. ``sequence[k]`` and an iteration give the positions of all vertices of
    ``sequence.mesh``, float64, in the length unit of the files, shape [V, 3]; a slice gives a list of these. Two frames
    that follow one another are kept in memory, so an iteration reads every file once.

    Attributes:
        mesh: The bodies: those that move, then the static ones. Vertices that a format splits are one where they are
            in one place in the first frame, and frames in which they part are refused.
        labels: Name of each frame, that of its file or its number in it, as of the first body.
        times: Time of each frame as the files say it (.pvd, .xdmf), else its number, float64, shape [number of frames].
    """

    def __init__(
        self,
        series: Sequence[Any],
        static: list[Any],
        make_mesh: Callable[[list[Any]], CollisionMesh],
        *,
        split: bool = False,
    ) -> None:
        """Of the series of files that move, and obstacles; ``make_mesh`` joins their bodies."""
        self._series: Sequence[Series] = series
        self._name = ", ".join(frames.name for frames in series)
        self.labels = [printable(label) for label in series[0].labels]
        times = [frames.times for frames in series if frames.times is not None]
        self.times = np.array(times[0] if times else range(len(self.labels)), dtype=np.float64)
        self._files, ends = [], []
        for frames in series:
            first, second = frames.read(0), frames.read(1)
            self._files.append(of := FileBodies(first, frames.name, split=split))
            ends.append([of.positions(first), of.positions(second)])
            of.warn(first, second)
        self._bodies = [*(body for file in self._files for body in file.bodies), *static]
        self._static = [body.vertices for body in static]
        self._read = {k: np.concatenate([*(of_file[k] for of_file in ends), *self._static]) for k in (0, 1)}
        self.mesh = make_mesh(self._bodies)

    def __repr__(self) -> str:
        return f"FrameSequence({len(self)} frames of {self.mesh!r})"

    def __len__(self) -> int:
        return len(self.labels)

    @overload
    def __getitem__(self, k: int) -> NDArray[np.float64]: ...
    @overload
    def __getitem__(self, k: slice) -> list[NDArray[np.float64]]: ...
    def __getitem__(self, k: int | slice) -> NDArray[np.float64] | list[NDArray[np.float64]]:
        """The positions in frame ``k``.

        Raises:
            IndexError: If there is no such frame.
            ValueError: If a file is damaged, or differs from the first in its topology.
        """
        if isinstance(k, slice):
            return [self[n] for n in range(len(self))[k]]
        number = range(len(self))[k]
        if number not in self._read:
            self._read = {n: frame for n, frame in self._read.items() if abs(n - number) == 1}
            moving = [of.positions(frames.read(number)) for of, frames in zip(self._files, self._series, strict=True)]
            self._read[number] = np.concatenate([*moving, *self._static])
        return self._read[number].copy()

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        return (self[k] for k in range(len(self)))

    def step(self, k: int) -> Frames:
        """The step from frame ``k`` to the next.

        Raises:
            IndexError: If there is no such step.
            ValueError: If a file is damaged, or its topology differs.
        """
        number = range(len(self) - 1)[k]
        return Frames._of(self.mesh, self._bodies, self[number], self[number + 1])

    def steps(self) -> Iterator[Frames]:
        """All steps, one after the other."""
        return map(self.step, range(len(self) - 1))


def read_frames(
    start_path: str | Path,
    end_path: str | Path,
    *,
    static: Iterable[str | Path | HalfSpace] | None = (),
    kinematic: Iterable[int | str] | None = (),
    self_collision: bool | Sequence[bool] = True,
    surface: bool = False,
    split: bool = False,
) -> Frames:
    """Read both ends of a step from mesh files, in full precision, completely or not at all.

    The formats are PLY, OBJ, STL, OFF, GLB, glTF and, with the extra ``formats``, 3MF, DAE, VTU, VTP, legacy VTK, Gmsh,
    Medit, Abaqus and XDMF. Numbers are double precision where the format holds it. The corners of an STL file, and the
    copies of a vertex that GLB and DAE make at a seam, or pieces of VTK files where they meet, are merged by their
    positions in ``start_path``, which ``end_path`` must agree with. Polygons become triangles that cover their area,
    chosen in ``start_path``; lines and points of OBJ and PLY files are codimensional; glTF is placed at rest by nodes,
    morph weights and skins.

    Each object or group of an OBJ file, node of a scene and file of an archive is a body with its name; those that
    share a vertex are one. A file that holds one body gives it its own name.

    Args:
        start_path: Mesh file of the start positions.
        end_path: Mesh file of the end positions, with the same faces in the same order.
        static: Mesh files of bodies that do not move, or half-spaces.
        kinematic: Indices or names of the bodies that move as they are told, as of
            :meth:`ccd_warp.CollisionMesh.from_arrays`.
        self_collision: Whether a body may collide with itself: one flag for all bodies or one for each.
        surface: Whether volume cells of a file stand for their boundary surface, as of
            :func:`ccd_warp.read_sequence`.
        split: Whether a file, or a body in it, is divided into its connected components, bodies called ``NAME#0``,
            ``NAME#1`` and so on.

    Returns:
        The mesh and its positions at both ends, as all functions on meshes take them.

    Raises:
        ValueError: If a file is missing, damaged, cut short or not finite, the two frames differ in topology, or
            another argument is not as described.

    Guarantee: every coordinate is the number in the file, rounded to nearest where the file holds decimals.
    """
    files = [check_path("start_path", start_path), check_path("end_path", end_path)]
    how: dict[str, Any] = {"surface": check_flag("surface", surface)}
    bodies = static_bodies(checked_static(static), split=check_flag("split", split), **how)
    make_mesh = partial(mesh_of, kinematic=kinematic, self_collision=self_collision)
    sequence = FrameSequence([FileSeries(files[0].name, files, **how)], bodies, make_mesh, split=bool(split))
    return sequence.step(0)


def checked_static(static: object) -> list[Path | HalfSpace]:
    """Paths of mesh files and half-spaces, or a ValueError."""
    items = [] if static is None else check_items("static", static, "a list of paths and half-spaces")
    return [item if isinstance(item, HalfSpace) else check_path("static", item) for item in items]


@text_completed_by(read_frames)
def read_sequence(
    paths: str | Path | Iterable[str | Path],
    *,
    static: Iterable[str | Path | HalfSpace] | None = (),
    kinematic: Iterable[int | str] | None = (),
    self_collision: bool | Sequence[bool] = True,
    displacement: str | None = None,
    surface: bool = False,
    split: bool = False,
) -> FrameSequence:
    """Find the frames of a simulation in its files, as ``ccd-warp sequence`` does; each is read when it is asked for.

    Args:
        paths: A folder of mesh files, in the order of the numbers in their names; a collection of ParaView (.pvd), in
            the order of its times; or a temporal collection (.xdmf). Or a list of these, a body each, or of mesh files,
            where files whose names differ in more than their last number are bodies of their own.
        displacement: Name of the field at the points of files of cells that is added to their positions.
        surface: Whether volume cells of a file stand for their boundary surface, as of
            :meth:`ccd_warp.CollisionMesh.from_volume`: positions of all nodes, of which those inside collide with
            nothing. Otherwise a file of volumes alone is refused.

    Returns:
        The frames, as a sequence of positions, with their mesh and times.

    Raises:
        ValueError: If a path is missing, damaged or not known, there are fewer than two frames, bodies differ in their
            number of frames or their times, or another argument is not as described.
    """
    items = [paths] if isinstance(paths, (str, Path)) else check_items("paths", paths, "a path, or a list of paths")
    if not items:
        raise ValueError("paths is empty; expected a path, or a list of paths")
    if displacement is not None and not isinstance(displacement, str):
        raise ValueError(f"displacement is {shown(displacement)}; expected the name of a field")
    how: dict[str, Any] = {"surface": check_flag("surface", surface)}
    series = find_series([check_path("paths", path) for path in items], displacement=displacement, **how)
    bodies = static_bodies(checked_static(static), split=check_flag("split", split), **how)
    make_mesh = partial(mesh_of, kinematic=listed_bodies("kinematic", kinematic), self_collision=self_collision)
    return FrameSequence(series, bodies, make_mesh, split=bool(split))
