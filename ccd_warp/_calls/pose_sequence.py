"""Rigid bodies from a mesh file and their poses at several times from a table, and the steps between these."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ccd_warp._files.bodies import file_bodies, mesh_of, static_bodies
from ccd_warp._files.poses import read_poses as read_table
from ccd_warp._files.sequence import Frames, checked_static
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.arguments import check_choice, check_flag, check_path
from ccd_warp._scene.input.mesh_checks import listed_bodies
from ccd_warp._scene.input.messages import printable
from ccd_warp._scene.input.names import distinct_names
from ccd_warp._scene.mesh import CollisionMesh


class PoseSequence:
    """Rigid bodies and their poses at several times, which :func:`ccd_warp.read_poses` has read.

    ``len(sequence)`` is the number of times, ``sequence[k]`` the poses at time ``k``, float64, shape [B, 7], a row for
    each rigid body of the mesh in its order.

    Attributes:
        mesh: The bodies: those with poses are rigid, their vertices in their own frames; all others are static.
        times: Ascending, float64, shape [T].
        poses: Position and quaternion **x y z w** of each rigid body, float64, shape [T, B, 7].
        labels: Name of each time.
        path: Path between two poses, as of :class:`ccd_warp.RigidMotion`.
    """

    def __init__(
        self,
        mesh_path: Path,
        poses_path: Path,
        path: Literal["linear", "screw"],
        static: list[Any],
        make_mesh: Callable[..., CollisionMesh],
        *,
        surface: bool = False,
        split: bool = False,
    ) -> None:
        """Of the files; ``make_mesh`` joins bodies, with the rigid ones as ``rigid=``."""
        bodies = file_bodies(mesh_path, surface=surface, split=split)
        self.times, rigid, self.poses = read_table(poses_path, distinct_names([body.name for body in bodies]))
        self._bodies = [*(replace(body, is_static=k not in rigid) for k, body in enumerate(bodies)), *static]
        self._vertices = np.concatenate([body.vertices for body in self._bodies])
        self.poses.flags.writeable = False
        self.path = path
        self.labels = [f"t = {t!r}" for t in self.times.tolist()]
        self.mesh = make_mesh(self._bodies, rigid=rigid)
        self._name = f"{printable(mesh_path.name)} at {printable(poses_path.name)}"

    def __repr__(self) -> str:
        return f"PoseSequence({len(self)} times of {self.mesh!r})"

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, k: int) -> NDArray[np.float64]:
        """The poses at time ``k``, shape [B, 7].

        Raises:
            IndexError: If there is no such time.
        """
        return self.poses[k]

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        return iter(self.poses)

    def step(self, k: int) -> RigidMotion:
        """The motion from time ``k`` to the next, by the shortest turn of each body.

        Raises:
            IndexError: If there is no such step.
        """
        number = range(len(self) - 1)[k]
        return RigidMotion(self.poses[number], self.poses[number + 1], path=self.path)

    def steps(self) -> Iterator[RigidMotion]:
        """All motions, one after the other."""
        return map(self.step, range(len(self) - 1))

    def _step(self, k: int) -> tuple[Frames, RigidMotion]:
        """The positions of all vertices, in the frames of their bodies, and the motion, as of a `FrameSequence`."""
        return Frames._of(self.mesh, self._bodies, self._vertices, self._vertices), self.step(k)


def read_poses(
    mesh_path: str | Path,
    poses_path: str | Path,
    *,
    path: Literal["linear", "screw"] = "linear",
    static: Iterable[str | Path | HalfSpace] | None = (),
    kinematic: Iterable[int | str] | None = (),
    split: bool = False,
) -> PoseSequence:
    """Read rigid bodies and their poses at several times, as ``ccd-warp run`` and ``sequence`` do with ``--poses``.

    Args:
        mesh_path: Mesh file of all bodies, each in its own frame.
        poses_path: CSV, a row for each body and time: ``t, body, px, py, pz, qx, qy, qz, qw``, the quaternion
            **x y z w**, with these names in the first row or without. A body is given by its name, or by its index in
            the mesh file; one without poses is static.
        path: How bodies move from one pose to the next, as of :class:`ccd_warp.RigidMotion`.
        static: Mesh files of bodies that do not move, or half-spaces.
        kinematic: Indices or names of the bodies that move as they are told.
        split: Whether bodies of files are divided into their connected components, as of :func:`ccd_warp.read_frames`.

    Returns:
        The sequence, whose steps are motions for ``mesh_ccd``.

    Raises:
        ValueError: If a file is missing or damaged, a row is not as described (the message names the line and the
            column), a body is unknown, lacks a pose at some time or has two, or there are fewer than two times.
    """
    files = check_path("mesh_path", mesh_path), check_path("poses_path", poses_path)
    check_choice("path", path, ("linear", "screw"))
    scripted, split = listed_bodies("kinematic", kinematic), check_flag("split", split)
    obstacles = static_bodies(checked_static(static), split=split)
    return PoseSequence(*files, path, obstacles, partial(mesh_of, kinematic=scripted), split=split)
