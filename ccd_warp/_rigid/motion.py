"""Motions of rigid bodies in a step: their vertices move on arcs."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from copy import copy
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._results.contact_place import MovingVertices
from ccd_warp._results.toi_gradient import ToiGradient
from ccd_warp._rigid.body_paths import BodyPaths
from ccd_warp._rigid.mesh_paths import MeshPaths, check_own_frames
from ccd_warp._rigid.poses import (
    check_ends,
    check_leading,
    check_rows_finite,
    checked_fractions,
    checked_lengths,
    checked_pivot,
    checked_poses,
    checked_rows,
    read_only,
    shown_bodies,
    shown_body,
)
from ccd_warp._rigid.rotations import normalized, norms, products, quaternions_of, rotated
from ccd_warp._runtime.read_only import ReadOnly
from ccd_warp._scene.input.arguments import check_choice, check_instance, shown
from ccd_warp._scene.mesh import CollisionMesh

# Radians in a step: what is proved of sine and cosine holds below (`rigid.place_bodies`), and a slice takes 0.2.
_LARGEST_TURN = 1e6


class RigidMotion(ReadOnly):
    """How rigid bodies move in a step: each turns at constant speed about a point that moves straight, or on a screw.

    The vertices of such bodies stand in the bodies' own frames and move on arcs. A pose is the position of the body's
    origin in the world and its rotation. **Quaternions are x y z w, the scalar last**, as in Warp, newton, ROS, Bullet
    and SciPy; MuJoCo, Drake and python-fcl have the scalar first: :meth:`from_scalar_first`. Nothing in the numbers
    tells one order from the other, so a wrong one is not noticed.

    With R0 the rotation at t = 0, c the pivot and ω the rotation vector of the whole step in the frame of the world, a
    point X of a body is at x(t) = p(t) + Rot(t ω) R0 (X − c).

    * ``path="linear"``: p(t), the place of the pivot, moves on a straight line at constant speed. The pivot is the
      body's origin or ``pivot``, such as the centre of mass, about which free bodies turn.
    * ``path="screw"``: the body turns about one axis fixed in space and slides along it, as a nut on a bolt; its origin
      moves on a helix. The pivot does not matter then.

    ω is the shortest rotation vector between the poses, of at most π, or that of ``twist``, which may be several turns.
    Half a turn is as short in both directions: take a ``twist`` there, too. Bodies of a mesh in the plane turn about z:
    all that leads out of it is exactly 0, as in the pose (x, y, 0, 0, 0, z, w).

    Args:
        poses_t0: Poses at t = 0, [B, 7], position and quaternion **x y z w** (``wp.transform``), or matrices,
            [B, 4, 4]; with worlds [W, B, 7] or [W, B, 4, 4]. Arrays of NumPy, Warp and any library with DLPack; those
            on a GPU are read to the host. Quaternions of any length but 0 are normalised; of a matrix the nearest
            rotation is taken.
        poses_t1: Poses at t = 1, of as many bodies and worlds.
        path: "linear" or "screw".
        pivot: Points about which the bodies turn, in their own frames, [3], [B, 3] or [W, B, 3], only with "linear".
        twist: In place of ``poses_t1``, motion in the whole step (velocity times its duration), **linear part first,
            then angular** in radians, in the frame of the world, [B, 6] or [W, B, 6]. The linear part is the
            displacement of the pivot, with "screw" the velocity of the body's origin at t = 0. A turn is below 1e6
            radians. If ``poses_t1`` is given as well, it must be the same end to 1e-6 relative, and the path is that of
            the twist.
        within: How far any point of a body may be from its place on the path, at any time of the step, a Euclidean
            length of at least 0: one for all bodies, or [B] or [W, B]. So a motion that is no path of this kind (a
            spline, a measured track, a link of an arm, a body that gives way) is one that is near it; 0 of static
            bodies.

    Raises:
        ValueError: If shapes do not fit, a number is not finite, a quaternion has length 0, a matrix is no rotation to
            1e-6 or has another bottom row than 0 0 0 1, a pivot is given for a screw, ``twist`` contradicts
            ``poses_t1``, or turns a body by 1e6 radians or more, or ``within`` is below 0. It names the argument and
            the body.

    A motion of W worlds for a mesh of one moves copies of the mesh, of which only a batch is ever made: arrays of a
    result then have an axis of worlds in front. A motion does not change; its arrays are read-only.

    Guarantee: calls that take a motion are never late for exactly these trajectories, of the quaternions as they are
    given, normalised without rounding; for matrices, of the quaternions of ``poses_t0`` and ``poses_t1``. With
    ``within`` they are never late for all motions whose points are no farther from these trajectories, at the start
    and at the end as well. A toi is then early by the time in which a pair crosses the lengths of both of its bodies;
    what comes so near without touching may have one; and what starts within its distance and may part and slide keeps
    what it had on the paths, less four times the lengths of both.
    """

    def __init__(
        self,
        poses_t0: ArrayLike,
        poses_t1: ArrayLike | None = None,
        *,
        path: Literal["linear", "screw"] = "linear",
        pivot: ArrayLike | None = None,
        twist: ArrayLike | None = None,
        within: ArrayLike = 0.0,
    ) -> None:
        self._set(poses_t0, poses_t1, path, pivot, twist, within, scalar_first=False)

    @classmethod
    def from_scalar_first(
        cls,
        poses_t0: ArrayLike,
        poses_t1: ArrayLike | None = None,
        *,
        path: Literal["linear", "screw"] = "linear",
        pivot: ArrayLike | None = None,
        twist: ArrayLike | None = None,
        within: ArrayLike = 0.0,
    ) -> RigidMotion:
        """The motion of poses whose quaternions are **w x y z, the scalar first**, as in MuJoCo, Drake and python-fcl.

        Args:
            poses_t0: Poses at t = 0: position and quaternion w x y z, [B, 7] or [W, B, 7].
            poses_t1: Poses at t = 1, in the same order.
            path: As of :class:`RigidMotion`, as all that follow.
            pivot: Points about which the bodies turn, in their own frames.
            twist: Motion in the whole step, linear part first, then angular.
            within: How far points may be from the paths.

        Returns:
            The motion; its own poses are x y z w.

        Raises:
            ValueError: As :class:`RigidMotion` does.
        """
        motion = cls.__new__(cls)
        motion._set(poses_t0, poses_t1, path, pivot, twist, within, scalar_first=True)
        return motion

    def _set(
        self,
        poses_t0: ArrayLike,
        poses_t1: ArrayLike | None,
        path: Any,
        pivot: ArrayLike | None,
        twist: ArrayLike | None,
        within: ArrayLike,
        *,
        scalar_first: bool,
    ) -> None:
        start, leading = checked_poses(poses_t0, "poses_t0", scalar_first=scalar_first)
        end = None
        if poses_t1 is not None:
            end, shape = checked_poses(poses_t1, "poses_t1", scalar_first=scalar_first)
            check_leading("poses_t1", shape, leading)
        elif twist is None:
            raise ValueError("poses_t1 is None; expected the poses at the end of the step, or twist in their place")
        self._path = check_choice("path", path, ("linear", "screw"))
        if pivot is not None and self._path == "screw":
            raise ValueError(f"pivot is {shown(pivot)}; expected none with path='screw', whose axis the poses give")
        is_linear = self._path == "linear"
        pivots = checked_pivot((0.0, 0.0, 0.0) if pivot is None else pivot, leading) if is_linear else None
        self._within = read_only(checked_lengths(within, "within", leading))
        self._leading = leading
        with np.errstate(over="ignore", invalid="ignore"):
            if twist is None:
                self._body_paths = BodyPaths.between(start, end, pivots)  # type: ignore[arg-type]
            else:
                twists, shape = checked_rows(twist, "twist", ((6,),), "shape (B, 6), linear part first, then angular")
                check_leading("twist", shape, leading)
                self._body_paths = BodyPaths.along(start, twists, pivots)
            turns = norms(self._body_paths.omega)
        for row in np.flatnonzero(~(turns < _LARGEST_TURN))[:1].tolist():
            raise ValueError(
                f"twist turns {shown_body(row, leading)} by {turns[row]:.6g} rad; expected less than {_LARGEST_TURN:g} "
                f"rad in a step: divide it into shorter ones"
            )
        for field in ("pivot_t0", "velocity", "turning"):
            rows = getattr(self._body_paths, field)
            check_rows_finite(rows, f"the {field} of the motion", leading, "a motion that float64 can hold")
        self._poses_t0 = read_only(np.hstack([start[:, :3], self._body_paths.rotation]))
        if twist is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                ends = self._at(np.ones(len(start)))
            check_rows_finite(ends, "the end of twist", leading, "a motion that float64 can hold")
            if end is not None:
                _check_agreement(self, ends, end)
        else:
            ends = np.hstack([end[:, :3], normalized(end[:, 3:])])  # type: ignore[index]
        self._poses_t1 = read_only(ends)
        self._body_paths = self._body_paths.within(self._within)

    @property
    def num_bodies(self) -> int:
        """Number of bodies, in each world."""
        return self._leading[-1]

    @property
    def num_worlds(self) -> int:
        """Number of worlds; 1 where the poses have no axis of them."""
        return self._leading[0] if len(self._leading) == 2 else 1

    @property
    def path(self) -> str:
        """The path of the bodies, "linear" or "screw"."""
        return self._path

    @property
    def poses_t0(self) -> NDArray[np.float64]:
        """Poses at t = 0, position and unit quaternion x y z w, float64, shape [B, 7], or [W, B, 7] with worlds."""
        return self._poses_t0.reshape(*self._leading, 7)

    @property
    def poses_t1(self) -> NDArray[np.float64]:
        """Poses at t = 1, where the paths end, of the form of ``poses_t0``."""
        return self._poses_t1.reshape(*self._leading, 7)

    @property
    def turns(self) -> NDArray[np.float64]:
        """Angle by which each body turns in the step, radians, float64, shape [B], or [W, B] with worlds."""
        return read_only(norms(self._body_paths.omega)).reshape(self._leading)

    @property
    def within(self) -> NDArray[np.float64]:
        """How far points of each body may be from the path, a length, float64, shape [B], or [W, B] with worlds."""
        return self._within.reshape(self._leading)

    def at(self, t: ArrayLike) -> NDArray[np.float64]:
        """The poses at a fraction of the step, such as the bound of a line search.

        Args:
            t: Fraction in [0, 1], for all bodies, or one a body, [B] or [W, B].

        Returns:
            Positions and unit quaternions x y z w, float64, of the shape of ``poses_t0``; those poses and
            ``poses_t1`` themselves where a fraction is 0 or 1.

        Raises:
            ValueError: If a fraction is not in [0, 1], or there are not as many as bodies.
        """
        times = checked_fractions(t, self._leading)
        poses = np.where((times == 0.0)[:, None], self._poses_t0, self._at(times))
        poses = np.where((times == 1.0)[:, None], self._poses_t1, poses)
        return poses.reshape(*self._leading, 7)

    def shortened(self, t: ArrayLike) -> RigidMotion:
        """The motion up to a fraction of the step, on the same paths.

        Args:
            t: Fraction in [0, 1], for all bodies, or one a body, [B] or [W, B].

        Returns:
            The motion that ends there, in as much time as this one, with points as far from it.

        Raises:
            ValueError: If a fraction is not in [0, 1], or there are not as many as bodies.
        """
        times = checked_fractions(t, self._leading)
        motion = copy(self)
        motion._body_paths = self._body_paths.shortened(times)
        ends = np.where((times == 1.0)[:, None], self._poses_t1, motion._at(np.ones(len(times))))
        motion._poses_t1 = read_only(np.where((times == 0.0)[:, None], self._poses_t0, ends))
        return motion

    def gradient_by_poses(self, gradient: ToiGradient) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """How tois change with the poses at both ends, of contacts of a call with this motion.

        Args:
            gradient: That of the contacts, ``contacts.toi_gradient()``.

        Returns:
            d toi / d ``poses_t0`` and d toi / d ``poses_t1``, position and quaternion x y z w, float64, shape [n, 2, 7]
            each: of the bodies in the columns of ``contacts.bodies``, in the world ``contacts.world``, 0 of those that
            are not rigid. The part of a unit quaternion has no component along it.

        Raises:
            ValueError: If the contacts are not those of a call with a motion of as many bodies, or this one is a screw.
        """
        points = self._turning_points(gradient)
        if points is None:
            return np.zeros((0, 2, 7)), np.zeros((0, 2, 7))
        gradients: tuple[NDArray[np.float64], NDArray[np.float64]]
        gradients = points.by_poses(self._body_paths, self._poses_t1[:, 3:])
        return gradients

    def gradient_by_twist(self, gradient: ToiGradient) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """How tois change with the poses at the start and with the twists, of contacts of a call with this motion.

        A motion that was made from poses has the shortest twists between them.

        Args:
            gradient: That of the contacts, ``contacts.toi_gradient()``.

        Returns:
            d toi / d ``poses_t0`` where the twists are held, shape [n, 2, 7], and d toi / d twist, linear part first,
            shape [n, 2, 6], float64, of the bodies as in :meth:`gradient_by_poses`.

        Raises:
            ValueError: As :meth:`gradient_by_poses` does.
        """
        points = self._turning_points(gradient)
        if points is None:
            return np.zeros((0, 2, 7)), np.zeros((0, 2, 6))
        gradients: tuple[NDArray[np.float64], NDArray[np.float64]] = points.by_twist(self._body_paths)
        return gradients

    def _turning_points(self, gradient: ToiGradient) -> Any:
        """The points of contacts on bodies that this motion can have moved; None where there are no contacts."""
        check_instance("gradient", gradient, ToiGradient)
        if self._path != "linear":
            raise ValueError(f"there are gradients by poses with path='linear' alone; this is {self!r}")
        if len(gradient) == 0:
            return None
        points: Any = gradient._place
        count = len(self._body_paths)
        if points is None or points.num_bodies != count:
            motion = "no motion" if points is None else f"a motion of {points.num_bodies} bodies"
            worlds = "" if self.num_worlds == 1 else f", {self.num_bodies} in each of {self.num_worlds} worlds"
            raise ValueError(f"gradient is that of contacts of a call with {motion}; expected one of {count}{worlds}")
        return points

    def _moving(self, mesh: CollisionMesh, start: NDArray[np.float64], end: NDArray[np.float64]) -> MovingVertices:
        """How all vertices move between positions in space; where no body of the mesh is rigid, all count as such.

        Raises:
            ValueError: If the motion does not match the mesh.
        """
        bodies = mesh if mesh.rigid.any() else mesh._all_rigid
        paths = MeshPaths.of(bodies, self._body_paths)
        check_own_frames(bodies, start, end)
        return MovingVertices(mesh, start, end, paths)

    def _of_worlds(self, worlds: NDArray[np.integer]) -> BodyPaths:
        """The paths of the bodies of some worlds, one world's after another's."""
        if np.array_equal(worlds, np.arange(self.num_worlds)):
            return self._body_paths
        return self._body_paths.rows((worlds[:, None] * self.num_bodies + np.arange(self.num_bodies)).ravel())

    def _at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses at a fraction for each body, shape [N, 7]."""
        paths, rows = self._body_paths, np.arange(len(times))
        arms = rotated(paths.rotation, -paths.pivot)  # from the pivot to the origin
        quaternions = products(quaternions_of(paths.omega, times), paths.rotation)
        positions = self._poses_t0[:, :3] + paths.displacements(arms, rows, times)
        return np.hstack([positions, normalized(quaternions)])

    def __repr__(self) -> str:
        turns = self.turns
        turn = f", turns up to {turns.max():.3g} rad" if turns.size else ""
        within = f", within {self._within.max():.3g}" if self._within.any() else ""
        return f"RigidMotion({shown_bodies(self._leading)}, path={self._path!r}{turn}{within})"


def _check_agreement(motion: RigidMotion, ends: NDArray[np.float64], poses: NDArray[np.float64]) -> None:
    """Raise a ValueError if the end of a twist is not the pose that is given with it."""
    paths = motion._body_paths
    lengths = [motion._poses_t0[:, :3], poses[:, :3], paths.velocity, paths.pivot, paths.turning]
    scale = np.max([np.abs(vectors).max(axis=1, initial=0.0) for vectors in lengths], axis=0)
    poses = np.hstack([poses[:, :3], normalized(poses[:, 3:])])
    turns = np.maximum(norms(paths.omega), 1.0)
    check_ends(ends, poses, np.column_stack([scale, turns]), motion._leading)
