"""A robot: its joints, and the links that have collision geometry as rigid bodies."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._display import counted, listed
from ccd_warp._input.arguments import check_items, shown
from ccd_warp._input.arrays import as_any_array, as_float64
from ccd_warp._input.poses import read_values
from ccd_warp._joint_motion import JointMotion
from ccd_warp._joints import Joint
from ccd_warp._mesh import CollisionMesh

Body = tuple[NDArray[np.float64], NDArray[np.int64]]


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """A mechanism from a URDF file: its joints, and the links that have collision geometry as bodies.

    Attributes:
        joints: All joints.
        coordinates: Names of the joints that a configuration has numbers for, in this order: all that move, but those
            that mimic another one. A free joint has 7 numbers.
        names: Names of the links that have collision geometry.
        bodies: Vertices and faces of each of them in the frame of the link: [V, 3] float64 and [F, 3].
        neighbours: Pairs of these links that are not tested against each other: a joint joins them, or joints with
            nothing between them but links without geometry, or they are fixed to each other.
        static: Those of these links that never move: the root, and what is fixed to it.
    """

    joints: tuple[Joint, ...]
    coordinates: tuple[str, ...]
    names: tuple[str, ...]
    bodies: tuple[Body, ...]
    neighbours: frozenset[tuple[str, str]]
    static: tuple[str, ...]
    _mimics: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)

    @property
    def num_coordinates(self) -> int:
        """How many numbers a configuration has."""
        sizes = {joint.name: joint.num_coordinates for joint in self.joints}
        return sum(sizes[name] for name in self.coordinates)

    def mesh(
        self,
        obstacles: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
        *,
        exclude: Iterable[tuple[str, str]] = (),
        **options: Any,
    ) -> CollisionMesh:
        """The robot among obstacles: links as rigid bodies in their own frames, obstacles static in the world.

        Args:
            obstacles: Vertices and faces by name.
            exclude: Further pairs of names that are not tested against each other, such as links whose geometry
                overlaps, or a base and the floor that it stands on.
            options: Further options of :meth:`CollisionMesh.from_arrays`, such as ``radius``.

        Returns:
            The mesh, whose bodies are ``names`` and the obstacles; :meth:`CollisionMesh.replicate` makes worlds of it.

        Raises:
            ValueError: If a name is unknown or not unique, or as :meth:`CollisionMesh.from_arrays` does.
        """
        if obstacles is not None and not isinstance(obstacles, Mapping):
            raise ValueError(f"obstacles is {shown(obstacles)}; expected vertices and faces by name")
        others = dict(obstacles or {})
        names = [*self.names, *others]
        may = ~np.eye(len(names), dtype=bool)
        for pair in [*self.neighbours, *check_items("exclude", exclude, "pairs of names")]:
            if not isinstance(pair, (tuple, list)) or len(pair) != 2 or not all(name in names for name in pair):
                raise ValueError(f"exclude has {shown(pair)}; expected two names out of {listed(names)}")
            a, b = (names.index(name) for name in pair)
            may[a, b] = may[b, a] = False
        return CollisionMesh.from_arrays(
            [*self.bodies, *others.values()],
            rigid=range(len(self.names)),
            static=[*self.static, *others],
            names=names,
            body_pairs=may,
            **options,
        )

    def motion(self, q0: ArrayLike, q1: ArrayLike) -> JointMotion:
        """The motion between configurations, whose rows are the bodies.

        Args:
            q0: Numbers of the joints in ``coordinates``, [n], or [W, n] with worlds; of a path of waypoints [K, n],
                ``q[:-1]``.
            q1: Those at t = 1; ``q[1:]``.

        Returns:
            The motion; joints that mimic another one go with it.

        Raises:
            ValueError: As :class:`JointMotion` does.
        """
        return JointMotion(self.joints, self.configuration(q0, "q0"), self.configuration(q1, "q1"), links=self.names)

    def configuration(self, q: ArrayLike, name: str = "q") -> NDArray[np.float64]:
        """Numbers of all joints, those that mimic another one included, as :class:`JointMotion` takes them.

        Args:
            q: Numbers of the joints in ``coordinates``, [..., n].
            name: What messages call it.

        Returns:
            Numbers of all ``joints``, [..., m].

        Raises:
            ValueError: If there are not n numbers.
        """
        n = self.num_coordinates
        expected = f"shape (..., {n}), the numbers of the joints {listed(self.coordinates)}"
        array = as_any_array(read_values(q, name), name, expected)
        if array.ndim == 0 or array.shape[-1] != n:
            raise ValueError(f"{name} has shape {array.shape}; expected {expected}")
        given = as_float64(array if array.ndim > 1 else array[None], name, q if array.ndim > 1 else [q])
        given = given.reshape(array.shape)
        sizes = {joint.name: joint.num_coordinates for joint in self.joints}
        ends = dict(zip(self.coordinates, np.cumsum([sizes[c] for c in self.coordinates]).tolist(), strict=True))
        parts = []
        for joint in self.joints:
            source, factor, offset = self._mimics.get(joint.name, (joint.name, 1.0, 0.0))
            if source in ends:
                parts.append(factor * given[..., ends[source] - sizes[source] : ends[source]] + offset)
        return np.concatenate([*parts, np.zeros((*given.shape[:-1], 0))], axis=-1)

    def __repr__(self) -> str:
        links = counted(len(self.names), "link with geometry", "links with geometry")
        return f"Robot({counted(len(self.coordinates), 'moving joint', 'moving joints')}, {links})"
