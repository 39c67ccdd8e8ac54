"""Joints between links, and the tree that they form."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._display import counted, listed
from ccd_warp._input.arguments import check_choice, check_instance, check_items, shown
from ccd_warp._input.arrays import as_any_array, as_float64
from ccd_warp._input.poses import checked_poses, read_values

KINDS = ("revolute", "continuous", "prismatic", "fixed", "free")
COORDINATES = {"revolute": 1, "continuous": 1, "prismatic": 1, "fixed": 0, "free": 7}


@dataclass(frozen=True)
class Joint:
    """A joint, which carries one link on another, as URDF describes it.

    The joint's frame stands at ``origin`` in the frame of the parent; in the configuration 0 it is the frame of the
    child. The child moves in it.

    ==================  ==========================================================================================
    "revolute"          turns about ``axis`` by the joint's coordinate, in radians; limits are not looked at
    "continuous"        the same
    "prismatic"         slides along ``axis`` by the joint's coordinate, a length
    "fixed"             stays
    "free"              is at the pose that the joint's 7 coordinates are: position and quaternion **x y z w**
    ==================  ==========================================================================================

    Attributes:
        name: Name of the joint.
        parent: Name of the link that carries the other one.
        child: Name of the link that is carried.
        kind: One of the kinds above.
        axis: Direction in the joint's frame, of any length but 0, of a revolute, continuous or prismatic joint.
        origin: Pose of the joint's frame in the frame of the parent: position and quaternion **x y z w**, or a
            matrix [4, 4].

    Raises:
        ValueError: If a name is no text, the kind is none of these, an axis is missing, not finite, of length 0, or
            given for a joint that has none, or the origin is no pose. It names the joint.
    """

    name: str
    parent: str
    child: str
    kind: Literal["revolute", "continuous", "prismatic", "fixed", "free"]
    axis: Sequence[float] | None = None
    origin: ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        for field in ("name", "parent", "child"):
            value = getattr(self, field)
            if not isinstance(value, str) or not value:
                raise ValueError(f"{field} is {shown(value)}; expected the name of a joint or link")
        check_choice(f"kind of joint {self.name!r}", self.kind, KINDS)
        object.__setattr__(self, "axis", self._checked_axis())
        object.__setattr__(self, "origin", self._checked_origin())

    def _checked_axis(self) -> tuple[float, ...] | None:
        name = f"axis of joint {self.name!r}"
        if self.kind in ("fixed", "free"):
            if self.axis is not None:
                raise ValueError(f"{name} is {shown(self.axis)}; expected none, as the joint is {self.kind}")
            return None
        expected = "three finite numbers, not all 0"
        array = as_any_array(self.axis, name, expected) if self.axis is not None else None
        if array is None or array.shape != (3,):
            raise ValueError(f"{name} is {shown(self.axis)}; expected {expected}")
        axis = as_float64(array[None], name, [self.axis])[0]
        if not np.isfinite(axis).all() or not axis.any():
            raise ValueError(f"{name} is {shown(self.axis)}, of length {np.linalg.norm(axis)}; expected {expected}")
        return tuple(axis.tolist())

    def _checked_origin(self) -> tuple[float, ...]:
        name = f"origin of joint {self.name!r}"
        expected = "a pose, position and quaternion x y z w, or a matrix (4, 4)"
        array = as_any_array(self.origin, name, expected)
        if array.shape not in ((7,), (4, 4)):
            raise ValueError(f"{name} has shape {array.shape}; expected {expected}")
        try:
            poses, _ = checked_poses(array[None], name)
        except ValueError as error:
            raise ValueError(str(error).replace(" for body 0", "")) from None
        pose = poses[0] if array.ndim == 2 else array.astype(np.float64)
        return tuple((pose + 0.0).tolist())

    @property
    def num_coordinates(self) -> int:
        """The numbers that say where the child is; 1, of a fixed joint 0, of a free one 7."""
        return COORDINATES[self.kind]


class JointTree:
    """Links and the joints that carry them; the one that nothing carries, the root, stands at the world's origin.

    Attributes:
        joints: The joints, as given.
        links: Names of the links, in the order in which joints name them.
        joint_of: The joint that carries a link; -1 of the root.
        order: Links in an order in which each comes after the one that carries it.
        columns: Where the coordinates of each joint are in a configuration.
    """

    def __init__(self, joints: Iterable[Joint]) -> None:
        self.joints = tuple(check_items("joints", joints, "joints"))
        if not self.joints:
            raise ValueError("joints is empty; expected at least one joint")
        for joint in self.joints:
            check_instance("an item of joints", joint, Joint)
        check_distinct("joints", [joint.name for joint in self.joints])
        self.links = tuple(dict.fromkeys(name for joint in self.joints for name in (joint.parent, joint.child)))
        self.index = {name: k for k, name in enumerate(self.links)}
        self.joint_of = [-1] * len(self.links)
        for k, joint in enumerate(self.joints):
            child = self.index[joint.child]
            if self.joint_of[child] >= 0:
                other = self.joints[self.joint_of[child]].name
                raise ValueError(
                    f"joints has two joints that carry the link {joint.child!r}, {other!r} and {joint.name!r}; "
                    f"expected a tree, in which one carries each link"
                )
            self.joint_of[child] = k
        self.order = self._ordered()
        roots = [name for name, joint in zip(self.links, self.joint_of, strict=True) if joint < 0]
        if len(roots) > 1:
            raise ValueError(
                f"joints has {len(roots)} links that no joint carries: {listed(roots)}; expected one, the root, and "
                f"the parent of every other joint to be the child of one"
            )
        ends = np.cumsum([0, *(joint.num_coordinates for joint in self.joints)]).tolist()
        self.columns = [slice(first, last) for first, last in pairwise(ends)]
        self.num_coordinates: int = ends[-1]

    def _ordered(self) -> list[int]:
        """Links after those that carry them; raise a ValueError if joints form a loop."""
        order: list[int] = []
        placed: set[int] = set()
        for link in range(len(self.links)):
            way: list[int] = []
            while link not in placed and link not in way:
                way.append(link)
                if self.joint_of[link] < 0:
                    break
                link = self.parent_of(link)
            else:
                if link in way:
                    names = [self.joints[self.joint_of[k]].name for k in reversed(way[way.index(link) :])]
                    raise ValueError(
                        f"joints has a loop of {counted(len(names), 'joint', 'joints')}: {listed(names)}; "
                        f"expected a tree, in which no link carries itself"
                    )
            order += reversed(way)
            placed.update(way)
        return order

    def parent_of(self, link: int) -> int:
        """The link that carries this one; -1 if nothing does."""
        joint = self.joint_of[link]
        return self.index[self.joints[joint].parent] if joint >= 0 else -1

    def rows(self, links: Any) -> list[int]:
        """Links by their names, all by default; raise a ValueError if one is unknown or named twice."""
        if links is None:
            return list(range(len(self.links)))
        names = check_items("links", links, "names of links")
        if not names:
            raise ValueError("links is empty; expected names of links")
        for name in names:
            if not isinstance(name, str) or name not in self.index:
                raise ValueError(f"links has {shown(name)}; expected names of links: {listed(self.links)}")
        check_distinct("links", names)
        return [self.index[name] for name in names]

    def configurations(self, values: Any, name: str) -> NDArray[np.float64]:
        """Configurations, shape [n] or [W, n].

        Raises:
            ValueError: If they have another shape, or `check` finds a number that is none.
        """
        n = self.num_coordinates
        expected = f"shape ({n},), one number a coordinate of the joints, or (W, {n}) with worlds"
        array = as_any_array(read_values(values, name), name, expected)
        if array.ndim not in (1, 2) or array.shape[-1] != n:
            raise ValueError(f"{name} has shape {array.shape}; expected {expected}")
        given = [values] if array.ndim == 1 else values
        array = as_float64(np.atleast_2d(array), name, given).reshape(array.shape)
        self.check(array, name)
        return array

    def check(self, array: NDArray[np.float64], name: str) -> None:
        """Raise a ValueError that names the joint if a number is not finite; shape [..., n]."""
        finite = np.isfinite(array)
        if not finite.all():
            at = tuple(np.argwhere(~finite)[0].tolist())
            joint = next(j for j, c in zip(self.joints, self.columns, strict=True) if c.start <= at[-1] < c.stop)
            raise ValueError(
                f"{name} holds {array[at]} at {list(at)}, for joint {joint.name!r}; expected finite numbers"
            )

    def check_quaternions(self, configurations: NDArray[np.float64], name: str) -> None:
        """Raise a ValueError if a quaternion of a free joint has length 0; shape [W, n]."""
        for joint, columns in zip(self.joints, self.columns, strict=True):
            if joint.kind == "free":
                zero = ~configurations[:, columns][:, 3:].any(axis=1)
                if zero.any():
                    raise ValueError(
                        f"{name} has a quaternion of length 0 for the free joint {joint.name!r}, of configuration "
                        f"{int(zero.argmax())}; expected any other length (position, quaternion x y z w)"
                    )


def check_distinct(argument: str, names: Sequence[str]) -> None:
    """Raise a ValueError if a name occurs twice."""
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{argument} has {names.count(name)} of the name {name!r}; expected each name once")
