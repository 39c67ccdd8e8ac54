"""Motions of mechanisms: links in a tree of joints, whose coordinates go from one configuration to another."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from collections.abc import Iterable, Sequence
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._affine_motion import AffineMotion
from ccd_warp._body_paths import BodyPaths
from ccd_warp._display import counted
from ccd_warp._input.arrays import as_array, as_float64
from ccd_warp._input.poses import checked_fractions, read_only, read_values
from ccd_warp._joint_bounds import Window, motions
from ccd_warp._joint_courses import courses_of, poses, product, turning, value
from ccd_warp._joint_paths import slices
from ccd_warp._joint_sweeps import Sweeps, sweeps
from ccd_warp._joints import Joint, JointTree
from ccd_warp._motion import RigidMotion
from ccd_warp._read_only import ReadOnly


class JointMotion(ReadOnly):
    """How the links of a mechanism, such as a robot's arm, move while its joints do.

    Joints (:class:`Joint`) carry links on links in a tree, whose root stands at the origin of the world, as the base
    of an arm does; a free joint lets a link float. A configuration is the coordinates of all joints, one after another
    in the order of ``joints``: an angle in radians, a length, nothing for a fixed joint, position and quaternion
    **x y z w** for a free one. In a step from t = 0 to 1 each coordinate is q0 + t (q1 − q0), and a free joint turns at
    constant speed the shortest way. This is an edge of a motion planner; the links move on no simple curves.

    Many motions of one mechanism are worlds, as in a mesh that is replicated: the edges of a roadmap, or the segments
    of a path (:meth:`from_waypoints`).

    Args:
        joints: The joints, in any order.
        q0: Configurations at t = 0, float64, [n], or [W, n] with worlds.
        q1: Configurations at t = 1; [n] and [W, n] go together, one configuration for all worlds.
        links: Names of the links that are rows of the poses, and bodies of a mesh, in this order; by default all, in
            the order in which joints name them.

    Raises:
        ValueError: If joints form a loop, two carry one link, a second link is carried by none (such as a parent whose
            name is misspelt), names occur twice or are unknown, a number is not finite, or there are not as many
            coordinates as joints have.

    A motion does not change; its arrays are read-only.

    Guarantee: calls that take a motion are never late for exactly these trajectories: of the coordinates, axes and
    origins as they are given, axes and quaternions normalised without rounding.
    """

    def __init__(
        self, joints: Iterable[Joint], q0: ArrayLike, q1: ArrayLike, *, links: Sequence[str] | None = None
    ) -> None:
        tree = JointTree(joints)
        start, end = (tree.configurations(q, name) for q, name in ((q0, "q0"), (q1, "q1")))
        if start.ndim == end.ndim == 2 and len(start) != len(end):
            raise ValueError(
                f"q1 is of {counted(len(end), 'world', 'worlds')}; expected {len(start)} like q0, or one configuration"
            )
        start, end = np.broadcast_arrays(start, end)
        for q, name in ((start, "q0"), (end, "q1")):
            tree.check_quaternions(np.atleast_2d(q), name)
        with np.errstate(over="ignore", invalid="ignore"):
            coefficients = np.stack([np.atleast_2d(start), np.atleast_2d(end - start)])
        self._set(tree, coefficients, np.atleast_2d(end), start.shape[:-1], links)

    @classmethod
    def from_waypoints(
        cls, joints: Iterable[Joint], waypoints: ArrayLike, *, links: Sequence[str] | None = None
    ) -> JointMotion:
        """The segments of a path of configurations, each a world of its own.

        Args:
            joints: The joints, as of :class:`JointMotion`.
            waypoints: Configurations, [K, n], at least two.
            links: Names of the links that are rows.

        Returns:
            A motion of K − 1 worlds, of which world k goes from waypoint k to waypoint k + 1.

        Raises:
            ValueError: As :class:`JointMotion` does, and if there are not two waypoints.
        """
        tree = JointTree(joints)
        path = tree.configurations(waypoints, "waypoints")
        if path.ndim != 2 or len(path) < 2:
            raise ValueError(f"waypoints has shape {path.shape}; expected (K, {tree.num_coordinates}), K at least 2")
        tree.check_quaternions(path, "waypoints")
        return cls(tree.joints, path[:-1], path[1:], links=links)

    @classmethod
    def from_cubics(
        cls, joints: Iterable[Joint], coefficients: ArrayLike, *, links: Sequence[str] | None = None
    ) -> JointMotion:
        """A motion whose coordinates are cubics of time, as between the knots of a spline.

        Args:
            joints: The joints, as of :class:`JointMotion`.
            coefficients: c with q(t) = c[0] + c[1] t + c[2] t² + c[3] t³, [4, n], or [W, 4, n] with worlds. The
                quaternion of a free joint stays: its rows 1 to 3 are 0.
            links: Names of the links that are rows.

        Returns:
            The motion.

        Raises:
            ValueError: As :class:`JointMotion` does, and if the quaternion of a free joint does not stay.
        """
        tree = JointTree(joints)
        n = tree.num_coordinates
        expected = f"shape (4, {n}), or (W, 4, {n}) with worlds"
        array = as_array(read_values(coefficients, "coefficients"), "coefficients", expected)
        if array.ndim not in (2, 3) or array.shape[-2:] != (4, n):
            raise ValueError(f"coefficients has shape {array.shape}; expected {expected}")
        array = as_float64(array, "coefficients", coefficients)
        tree.check(array, "coefficients")
        powers = np.ascontiguousarray((array if array.ndim == 3 else array[None]).transpose(1, 0, 2))
        tree.check_quaternions(powers[0], "coefficients")
        for joint, columns in zip(tree.joints, tree.columns, strict=True):
            if joint.kind == "free" and powers[1:, :, columns][..., 3:].any():
                raise ValueError(
                    f"coefficients turns the free joint {joint.name!r}; expected 0 in rows 1 to 3 of its quaternion"
                )
        motion = cls.__new__(cls)
        motion._set(tree, powers, None, array.shape[:-2], links)
        return motion

    def _set(self, tree: JointTree, coefficients: Any, ends: Any, worlds: tuple[int, ...], links: Any) -> None:
        self._tree, self._worlds, self._coefficients = tree, worlds, read_only(coefficients)
        self._rows = tree.rows(links)
        with np.errstate(over="ignore", invalid="ignore"):
            self._courses = courses_of(tree, coefficients, ends)
            self._place_ends()
        finite = (np.isfinite(self._poses_t0) & np.isfinite(self._poses_t1)).all(axis=1)
        if not finite.all():
            row = int(finite.argmin())
            raise ValueError(
                f"link {self.names[row % self.num_links]!r} is at no finite pose; expected a smaller motion"
            )

    def _place_ends(self) -> None:
        self._poses_t0, self._poses_t1 = (read_only(self._at(np.full(self.num_worlds, t))) for t in (0.0, 1.0))

    @property
    def joints(self) -> tuple[Joint, ...]:
        """The joints, as given."""
        return self._tree.joints

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the links, one a row of the poses."""
        return tuple(self._tree.links[k] for k in self._rows)

    @property
    def num_links(self) -> int:
        """Number of links, in each world."""
        return len(self._rows)

    @property
    def num_coordinates(self) -> int:
        """How many numbers a configuration has."""
        return self._tree.num_coordinates

    @property
    def num_worlds(self) -> int:
        """Number of worlds; 1 where the configurations have no axis of them."""
        return self._worlds[0] if self._worlds else 1

    @property
    def poses_t0(self) -> NDArray[np.float64]:
        """Poses at t = 0, position and unit quaternion x y z w, float64, shape [L, 7], or [W, L, 7] with worlds."""
        return self._poses_t0.reshape(*self._worlds, self.num_links, 7)

    @property
    def poses_t1(self) -> NDArray[np.float64]:
        """Poses at t = 1, of the form of ``poses_t0``."""
        return self._poses_t1.reshape(*self._worlds, self.num_links, 7)

    def at(self, t: ArrayLike) -> NDArray[np.float64]:
        """The poses at a fraction of the step.

        Args:
            t: Fraction in [0, 1], for all worlds, or one a world, [W].

        Returns:
            Positions and unit quaternions x y z w, float64, of the shape of ``poses_t0``.

        Raises:
            ValueError: If a fraction is not in [0, 1], or there are not as many as worlds.
        """
        return self._at(self._times(t)).reshape(*self._worlds, self.num_links, 7)

    def configuration(self, t: ArrayLike) -> NDArray[np.float64]:
        """The configurations at a fraction of the step, such as that up to which an edge is free.

        Args:
            t: Fraction in [0, 1], for all worlds, or one a world, [W].

        Returns:
            Coordinates, float64, shape [n], or [W, n] with worlds.

        Raises:
            ValueError: If a fraction is not in [0, 1], or there are not as many as worlds.
        """
        times = self._times(t)
        found: NDArray[np.float64] = np.array(value(self._coefficients, times[:, None]))
        for link, course in enumerate(self._courses):
            if course.after is not None:
                columns = self._tree.columns[self._tree.joint_of[link]]
                rotation = course.after if course.angle is None else product(turning(course, times), course.after)
                found[:, columns.start + 3 : columns.stop] = rotation.T
        return found.reshape(*self._worlds, self.num_coordinates)

    def shortened(self, t: ArrayLike) -> JointMotion:
        """The motion up to a fraction of the step, on the same paths.

        Args:
            t: Fraction in [0, 1], for all worlds, or one a world, [W].

        Returns:
            The motion that ends there, in as much time as this one.

        Raises:
            ValueError: If a fraction is not in [0, 1], or there are not as many as worlds.
        """
        times = self._times(t)
        motion = copy(self)
        powers = times ** np.arange(len(self._coefficients))[:, None]
        motion._coefficients = read_only(self._coefficients * powers[:, :, None])
        motion._courses = [
            course._replace(
                angle=None if course.angle is None else course.angle * powers[: len(course.angle)],
                slide=None if course.slide is None else course.slide * powers[:, None],
            )
            for course in self._courses
        ]
        motion._place_ends()
        return motion

    @property
    def _paths_at_start(self) -> BodyPaths:
        """Paths of all links, on which they stay where they are at the start."""
        return self._slices(0.0, 0.0, np.zeros(self.num_links))[0]

    def _of_worlds(self, worlds: NDArray[np.integer]) -> JointMotion:
        """The motion in some worlds."""
        motion = copy(self)
        motion._worlds = (len(worlds),)
        motion._coefficients = read_only(self._coefficients[:, worlds])
        motion._courses = [
            course._replace(
                axis=course.axis if course.axis is None or course.axis.shape[1] == 1 else course.axis[:, worlds],
                angle=None if course.angle is None else course.angle[:, worlds],
                slide=None if course.slide is None else course.slide[:, :, worlds],
                after=None if course.after is None else course.after[:, worlds],
            )
            for course in self._courses
        ]
        rows = (worlds[:, None] * self.num_links + np.arange(self.num_links)).ravel()
        motion._poses_t0, motion._poses_t1 = (read_only(poses[rows]) for poses in (self._poses_t0, self._poses_t1))
        return motion

    def _times(self, t: ArrayLike) -> NDArray[np.float64]:
        """Fractions of the step, one a world."""
        return checked_fractions(t, (self.num_worlds,), "world")

    def _at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Poses at a time of each world, shape [W·L, 7]."""
        positions, rotations = poses(self._courses, self._tree.order, times)
        rows = [np.concatenate([positions[k], rotations[k]]) for k in self._rows]
        return np.stack(rows, axis=-1).reshape(7, -1).T + 0.0

    def _turns(self, t_begin: ArrayLike, t_end: ArrayLike) -> NDArray[np.float64]:
        """By how much each link turns at most in a slice of the step, in radians, shape [W·L].

        Args:
            t_begin: Begin of the slice, one for all worlds or one a world.
            t_end: Its end.
        """
        with np.errstate(all="ignore"):
            found = motions(self._courses, self._tree.order, self._window(t_begin, t_end))
        return np.stack([found[k].most_omega for k in self._rows], axis=1).ravel()

    def _slices(
        self, t_begin: ArrayLike, t_end: ArrayLike, reach: ArrayLike, centre: ArrayLike | None = None
    ) -> tuple[BodyPaths, NDArray[np.float64]]:
        """Paths of the links in a slice of the step, and how far any of their points may be from there.

        Args:
            t_begin: Begin of the slice, one for all worlds or one a world.
            t_end: Its end.
            reach: How far points of each link are from its centre at most, shape [L].
            centre: Centres in the frames of the links, shape [L, 3]; by default their origins.

        Returns:
            Paths over the slice as if it were a step from 0 to 1, of N = W·L bodies, those of one world after
            another's; and lengths, shape [N]: at any time of the slice a point is no farther from where these paths
            have it, in the mathematics of real numbers, than this. They fall as the square of the slice.
        """
        centres = np.zeros((self.num_links, 3)) if centre is None else np.asarray(centre, dtype=np.float64)
        reaches = np.asarray(reach, dtype=np.float64)
        window = self._window(t_begin, t_end)
        return slices(self._courses, self._tree.order, self._rows, window, reaches, centres)

    def _sweeps(self, t_begin: ArrayLike, t_end: ArrayLike, middles: Any, pairs: NDArray[np.intp]) -> Sweeps:
        """Where links are in the middles of windows of a slice of each world, and how far they go (`sweeps`)."""
        links = [(self._rows[a], self._rows[b]) for a, b in pairs.tolist()]
        window = self._window(t_begin, t_end)
        return sweeps(self._courses, self._tree.order, self._rows, window, middles, links)

    def _window(self, t_begin: ArrayLike, t_end: ArrayLike) -> Window:
        begin, end = (np.broadcast_to(np.asarray(t, np.float64), self.num_worlds) for t in (t_begin, t_end))
        return Window.of(begin, end)

    def __repr__(self) -> str:
        joints = counted(sum(joint.kind != "fixed" for joint in self.joints), "moving joint", "moving joints")
        worlds = f" in each of {counted(self.num_worlds, 'world', 'worlds')}" if self._worlds else ""
        return f"JointMotion({counted(self.num_links, 'link', 'links')}, {joints}{worlds})"


# What calls on a step take.
Motion = RigidMotion | JointMotion | AffineMotion
