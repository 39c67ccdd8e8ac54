"""A sequence of frames read from files, frame by frame, and its steps."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from ccd_warp._files.archive import MAX_BYTES
from ccd_warp._files.frames import Body, body_between, warn_of_step
from ccd_warp._files.mesh import Mesh
from ccd_warp._files.mesh_frames import Frames, checked_static, mesh_of, read_frames, static_bodies
from ccd_warp._files.parts import Parts, check_split
from ccd_warp._files.series import Series, find_series
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.arguments import check_count, check_flag, check_items, check_path, shown
from ccd_warp._scene.input.messages import InputError, printable
from ccd_warp._scene.mesh import CollisionMesh


class FrameSequence:
    """The frames of one body or several, which :func:`ccd_warp.read_sequence` has found; each is read when asked for.

    ``len(sequence)`` is the number of frames. ``sequence[k]`` and an iteration give the positions of all vertices of
    ``sequence.mesh``, float64, in the length unit of the files, shape [V, 3]; a slice gives a list of these. Two frames
    that follow one another are kept in memory, so an iteration reads every file once.

    Attributes:
        mesh: The bodies in the first step: those that move, then the static ones.
        labels: Name of each frame, that of its file or its number in it, as of the first body.
        times: Time of each frame as the files say it (.pvd, .xdmf), else its number, float64, shape [number of frames].
    """

    def __init__(
        self,
        series: Sequence[Any],
        static: list[Any],
        make_mesh: Callable[[list[Any]], CollisionMesh],
        *,
        split: bool | str = False,
    ) -> None:
        """Of the series of files that move, and obstacles; ``make_mesh`` joins the bodies of a step."""
        self._series: Sequence[Series] = series
        self._name = ", ".join(each.name for each in series)
        self._split, self._seen = split, set[int]()
        self._parts: list[Parts | None] = []
        self._static = static
        self._make_mesh = make_mesh
        self._read: dict[int, list[Mesh]] = {}
        self.labels = [printable(label) for label in series[0].labels]
        found = [each.times for each in series if each.times is not None]
        self.times = np.array(found[0] if found else range(len(self.labels)), dtype=np.float64)
        self._first_bodies = self._bodies(0)
        for start, end in zip(*self._read.values(), strict=True):
            warn_of_step(start, end)
        self.mesh = make_mesh(self._first_bodies)

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
            ValueError: If a file is damaged, or its format splits vertices, and others are one than in the first step.
        """
        if isinstance(k, slice):
            return [self[n] for n in range(len(self))[k]]
        number = range(len(self))[k]
        step = self.step(max(number - 1, 0))
        if step.mesh is not self.mesh:
            raise InputError(
                f"{self.labels[number]} has other vertices in common than the first frames; take each step with its "
                "own mesh, by steps(), or save the frames in a format that says which vertices are one, such as PLY"
            )
        return step.vertices_t1 if number else step.vertices_t0

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        return (self[k] for k in range(len(self)))

    def step(self, k: int) -> Frames:
        """The step from frame ``k`` to the next.

        Its mesh is that of the sequence, but where a format splits vertices, and other ones coincide in this step.

        Raises:
            IndexError: If there is no such step.
            ValueError: If a file is damaged, or its topology differs.
        """
        number = range(len(self) - 1)[k]
        bodies = self._bodies(number)
        frames = Frames._of(self._mesh_of(bodies), bodies)
        if number not in self._seen:
            self._seen.add(number)
            frames._warn()
        return frames

    def steps(self) -> Iterator[Frames]:
        """All steps, one after the other."""
        return map(self.step, range(len(self) - 1))

    def _bodies(self, k: int) -> list[Body]:
        """The bodies in the step from frame ``k`` to the next; what both have in common is kept."""
        self._read = {n: self._read.get(n) or [each.read(n) for each in self._series] for n in (k, k + 1)}
        starts, ends = self._read.values()
        if k == 0:
            self._parts = [start.parts for start in starts]
        moving = [
            body
            for each, parts, start, end in zip(self._series, self._parts, starts, ends, strict=True)
            for body in replace(body_between(start, end), name=each.name, parts=parts).split(self._split)
        ]
        return moving + self._static

    def _motion(self, k: int) -> None:
        """How bodies turn in the step: vertices move straight from frame to frame."""

    def _mesh_of(self, bodies: list[Body]) -> CollisionMesh:
        """The mesh of these bodies: that of the first step, unless vertices are merged in another way."""
        same = len(bodies) == len(self._first_bodies) and all(
            len(a.vertices_t0) == len(b.vertices_t0) and np.array_equal(a.faces, b.faces)
            for a, b in zip(bodies, self._first_bodies, strict=False)
        )
        if not same and self.mesh.exclude_pairs.keys() - {"bodies"}:
            raise InputError(
                "pairs of vertices or primitives are left out, which need the same numbers in each frame; save the "
                "frames in a format that says which vertices are one, such as PLY"
            )
        return self.mesh if same else self._make_mesh(bodies)


@text_completed_by(read_frames)
def read_sequence(
    paths: str | Path | Iterable[str | Path],
    *,
    static: Iterable[str | Path | HalfSpace] = (),
    kinematic: Iterable[int | str] = (),
    self_collision: bool | Sequence[bool] = True,
    displacement: str | None = None,
    faces: str | Path | None = None,
    surface: bool = False,
    split: bool | str = False,
    max_bytes: int = MAX_BYTES,
) -> FrameSequence:
    """Find the frames of a simulation in its files, as ``ccd-warp sequence`` does; each is read when it is asked for.

    Args:
        paths: A folder of mesh files, in the order of the numbers in their names; a collection of ParaView (.pvd), in
            the order of its times; a temporal collection (.xdmf); or an archive (.npz) of ``positions``, shape
            [frames, n, 3], and ``faces``, shape [m, 3]. Or a list of these, a body each, or of mesh files, where files
            whose names differ in more than their last number are bodies of their own.
        displacement: Name of the field at the points of VTK and XDMF files that is added to their positions.
        faces: Mesh file whose faces a .npz takes that holds positions alone.
        surface: Whether volume cells of VTK and XDMF files stand for their boundary surface, as of
            :meth:`ccd_warp.CollisionMesh.from_volume`: positions of all nodes, of which those inside collide with
            nothing. Otherwise they are refused.

    Returns:
        The frames, as a sequence of positions, with their mesh and times.

    Raises:
        ValueError: If a path is missing, damaged or not known, there are fewer than two frames, bodies differ in their
            number of frames or their times, or another argument is not as described.
    """
    given = [paths] if isinstance(paths, (str, Path)) else check_items("paths", paths, "a path, or a list of paths")
    if not given:
        raise ValueError("paths is empty; expected a path, or a list of paths")
    if displacement is not None and not isinstance(displacement, str):
        raise ValueError(f"displacement is {shown(displacement)}; expected the name of a field")
    how: dict[str, Any] = {"max_bytes": check_count("max_bytes", max_bytes, 2**63 - 1)}
    how |= {"surface": check_flag("surface", surface), "split": check_split(split)}
    chosen = check_items("kinematic", kinematic, "a list of body indices")
    series = find_series(
        [check_path("paths", path) for path in given],
        displacement=displacement,
        faces=None if faces is None else check_path("faces", faces),
        **how,
    )
    bodies = static_bodies(checked_static(static), **how)
    make_mesh = partial(mesh_of, kinematic=chosen, self_collision=self_collision)
    return FrameSequence(series, bodies, make_mesh, split=how["split"])
