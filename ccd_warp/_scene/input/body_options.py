"""What a mesh takes besides the arrays of its bodies, for a type checker and a reader."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypedDict

from numpy.typing import ArrayLike


class BodyOptions(TypedDict, total=False):
    """What :meth:`CollisionMesh.from_arrays` takes besides the arrays of bodies, with the meaning that it has there.

    Attributes:
        static: Bodies that do not move.
        self_collision: Whether a body may collide with itself.
        codimensional_points: Whether vertices in no face and no edge are codimensional points.
        kinematic: Bodies that move as they are told.
        rigid: Bodies that keep their shape.
        names: Names of the bodies.
        body_pairs: Which pairs of different bodies may collide.
        exclusion_rings: How many edges apart primitives must be to be tested.
        exclude_pairs: Single pairs that are excluded.
        vertex_world: World of each vertex.
        radius: Half the thickness of sheets, the radius of cables and particles.
    """

    static: Iterable[int | str] | None
    self_collision: bool | Sequence[bool]
    codimensional_points: bool | Sequence[bool]
    kinematic: Iterable[int | str] | None
    rigid: Iterable[int | str] | None
    names: Sequence[str] | None
    body_pairs: ArrayLike | Iterable[Any] | None
    exclusion_rings: int
    exclude_pairs: Mapping[str, Any] | None
    vertex_world: ArrayLike | None
    radius: ArrayLike | None
