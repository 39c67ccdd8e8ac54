"""Half-spaces: bodies that are all of space on one side of a plane."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._runtime.read_only import ReadOnly


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """A half-space, such as the ground: a body of a :class:`ccd_warp.CollisionMesh` without a mesh.

    It stands in the list of bodies as the others do, has an index and a name as they have, and is static. All vertices
    of bodies that are free meet its plane, those of every world; edges and faces meet it with a vertex first. A vertex
    that is in the solid at the start is in contact with it, toi 0, wherever it moves. Of a mesh in the plane it is a
    half-plane.

    Among the ``kinematic`` bodies of the mesh it moves as it is told, a piston or a floor that rises: its point is then
    a vertex of the mesh, one row in all positions, and its normal stays. It is met by the vertices of that vertex's
    world.

    Attributes:
        point: A point of the plane, in the caller's length unit, shape [3], or [2] in the plane.
        normal: Normal of the plane, which points out of the solid, of any length above 0, shape [3] or [2]. The solid
            is where (x − point)·normal < 0.

    The numbers are checked where the half-space becomes part of a mesh.

    Guarantee: toi is never late for exactly this plane, whatever its normal's length and whatever rounds in float64.
    """

    point: ArrayLike
    normal: ArrayLike


@dataclass(frozen=True, eq=False, repr=False)
class Planes(ReadOnly):
    """The planes of the half-spaces of a mesh, in the order of their bodies.

    Attributes:
        points: A point of each plane, as given, float64, shape [H, 3], or [H, 2] in the plane.
        normals: Normal of each plane, as given, float64, of the shape of ``points``.
        bodies: Body of each plane, int32, shape [H].
        vertices: The vertex that is the point of a kinematic one, -1 of a static one, int32, shape [H].
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    bodies: NDArray[np.int32]
    vertices: NDArray[np.int32]

    def __post_init__(self) -> None:
        self.__setstate__(vars(self))

    def __len__(self) -> int:
        return len(self.bodies)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Planes):
            return NotImplemented
        return all(map(np.array_equal, vars(self).values(), vars(other).values()))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Planes({len(self)})"


def unit_normals(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors along normals of any length, shape [H, 3] or [H, 2]; their zeros are positive."""
    largest = np.abs(normals).max(axis=1, keepdims=True, initial=0.0)
    scaled = np.ldexp(normals, 1 - np.frexp(largest)[1])  # so that squares neither overflow nor vanish
    return scaled / np.sqrt((scaled * scaled).sum(axis=1, keepdims=True)) + 0.0
