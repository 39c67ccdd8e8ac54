"""Contacts of a step: their arrays, what follows from the mesh, and one contact at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.pairs import ClosePairs, pair_corners
from ccd_warp._results.placed import Placed
from ccd_warp._runtime.display import MOST_ROWS, counted, html_table, kind_name, point_text, shortened
from ccd_warp._runtime.status import CCDStatus, PairKind
from ccd_warp._runtime.texts import text_completed_by

if TYPE_CHECKING:
    from ccd_warp._results.toi_gradient import ToiGradient
    from ccd_warp._scene.mesh import CollisionMesh


@text_completed_by(ClosePairs)
@dataclass(frozen=True, repr=False, eq=False)
class Contacts(Placed, ClosePairs):
    """Pairs that touch, ordered by :class:`ccd_warp.PairKind` and then lexicographically by primitives.

    ``contacts[k]`` is a :class:`ccd_warp.Contact`, and so is each item of an iteration; ``contacts[chosen]``, with a
    slice, a mask or an array of indices, is a ``Contacts`` of these alone.

    Attributes:
        toi: Earliest time of impact in [0, t_max], float64, shape [m].
        parameters: (u, v) of the closest points at toi, between which the gap is, as in :class:`ccd_warp.PairResult`,
            0 of a vertex and a plane, float64, shape [m, 2].
        normal: Unit vector along the gap at toi, from the closest point of the second primitive to that of the first,
            wherever a gap of more than rounding is left (32 roundings of the largest distance between the two in the
            step): with a distance or separation nearly always, and also of a pair that starts within it. Of a pair that
            touches without a gap it is the normal of the face or of both edges, from the second primitive towards the
            side from which the first comes; a point, and two edges in one line, have no sides, and there it opposes the
            relative velocity (its component across the segment, if there is one). Zero only where nothing moves, and
            neither a face nor two edges that cross define a direction.
            Of a vertex and a plane it is the normal of the plane. float64, shape [m, 3], of a mesh in the plane [m, 2].
        status: :class:`ccd_warp.CCDStatus` of each contact, int32, shape [m].
        gap: Upper bound of the gap (L∞) beyond the minimum separation at toi, a length, float64, shape [m]. With a
            minimum distance, or radii, the gap beyond the distance of the pair, Euclidean.
        width: Width of the time interval left open, 0 except at a limit, as in :class:`ccd_warp.PairResult`, float64,
            shape [m].
    """

    toi: NDArray[np.float64]
    parameters: NDArray[np.float64]
    normal: NDArray[np.float64]
    status: NDArray[np.int32]
    gap: NDArray[np.float64]
    width: NDArray[np.float64]

    @overload  # type: ignore[override]  # the other tables have no rows of their own
    def __getitem__(self, index: int | np.integer[Any]) -> "Contact": ...

    @overload
    def __getitem__(self, index: slice | Sequence[int] | NDArray[Any]) -> "Contacts": ...

    def __getitem__(self, index: Any) -> "Contact | Contacts":
        if isinstance(index, (int, np.integer)) and not isinstance(index, bool):
            if not -len(self) <= index < len(self):
                raise IndexError(f"index is {index}; expected one of {len(self)} contacts")
            k = int(index) % len(self)
            return Contact(self._subset(slice(k, k + 1)), k)
        return self._subset(index)

    def _subset(self, index: slice | Sequence[int] | Sequence[bool] | NDArray[Any]) -> "Contacts":
        contacts = super()._subset(index)
        return contacts if self._place is None else contacts._of(self._place.subset(index))

    def __iter__(self) -> Iterator["Contact"]:
        if self._place is not None and len(self):  # for all at once, and not for each
            _ = self.vertices, self.points if self._place.has_points else None
        return (self[k] for k in range(len(self)))

    def __repr__(self) -> str:
        return f"Contacts({counted(len(self), 'contact', 'contacts')}{_by_kind(self.kind)})"

    def _repr_html_(self) -> str:
        return self._table(repr(self))

    def _table(self, title: str) -> str:
        """A table of the earliest contacts for a notebook; empty if the mesh is not known."""
        if self._place is None:
            return html_table(title, (), [])
        earliest = np.argsort(self.toi, kind="stable")[:MOST_ROWS].tolist()
        rows = [(k, *self[k]._cells()) for k in earliest]
        header = ("", "kind", "bodies", "toi", "point", "status")
        return html_table(f"{title}, the earliest first" if rows else title, header, rows, len(self))

    @property
    def points(self) -> NDArray[np.float64]:
        """Position of each contact at its toi, a length, float64, shape [m, 3], or [m, 2] in the plane.

        It is where both surfaces touch: without radii halfway between the closest points, which have the parameters
        (u, v), and are v and f0 + u (f1 − f0) + v (f2 − f0); ea0 + u (ea1 − ea0) and eb0 + v (eb1 − eb0); p and
        a + u (b − a); p and q; or v and the point of the plane below it. With radii a closest point of a surface is the
        radius of its primitive from that of the primitive, along ``normal``, and the position is halfway between these.
        """
        return self._placed("points", self._known_place().points_of(self))

    @property
    def relative_velocity(self) -> NDArray[np.float64]:
        """How the first primitive moves relative to the second at toi, float64, shape [m, 3], in the plane [m, 2].

        It is the velocity of its closest point less that of the second's, as a displacement in the whole step: a length
        in the unit of the mesh. Divided by the duration of the step it is a velocity in time. Its product with
        ``normal`` is negative where the two approach. The closest points are points of the bodies, with fixed (u, v).
        """
        return self._placed("relative_velocity", self._known_place().relative_velocity_of(self))

    def toi_gradient(self) -> "ToiGradient":
        """How the toi of each contact changes with the positions of its vertices at both ends of the step.

        Nothing of it is computed before. With a motion, how it changes with the poses of rigid bodies follows from it:
        :meth:`ccd_warp.RigidMotion.gradient_by_poses` and ``gradient_by_twist``.

        Raises:
            ValueError: If the contacts do not know their step, as those of a line search do not; or with a motion that
                has a ``within``, or a number as ``start_gap_fraction``.
        """
        gradient: ToiGradient = self._known_place().toi_gradient_of(self)
        return gradient

    def unique(self) -> "Contacts":
        """One contact for each two features that touch, in the order of the list: what a response adds up over.

        A vertex that lands on an edge touches it with each face at the edge, and with each of its own edges: pairs that
        say the same, some with normals that belong to no surface. They are one touch where their closest points span
        the same vertices, to rounding. Of its contacts the one is kept whose normal separates the surfaces around it;
        of several such the one that approaches most, and of equal ones a vertex and a face before two edges. What
        touches at a distance (a separation, radii) only after something next to it that is nearer is left out, such as
        a ball and the edge beside the face that it has met.

        Of many worlds in batches, and of a line search, positions are not kept. The surfaces around a contact are not
        known then, and two edges come last.

        Raises:
            ValueError: If the contacts do not know their mesh, or their relative velocities.
        """
        unique: Contacts = self._known_place().unique_of(self)
        return unique

    def sorted_by_toi(self) -> "Contacts":
        """The contacts by ascending toi, those with one toi in their present order, in new arrays.

        Indices into contacts, such as ``MeshResult.vertex_contact``, are those of the original order.
        """
        return self[np.argsort(self.toi, kind="stable")]

    @staticmethod
    def _placed(name: str, values: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """What follows from positions, or a ValueError where these are not known."""
        if values is None:
            raise ValueError(
                f"contacts.{name} are not known, as no launch has read positions; expected a launch before, or "
                "to_host(vertices_t0, vertices_t1)"
            )
        return values

    def _known_mesh(self) -> "CollisionMesh":
        mesh: CollisionMesh = self._known_place().mesh
        return mesh

    def _mesh_or_none(self) -> "CollisionMesh | None":
        return None if self._place is None else self._known_mesh()

    def _fields(self) -> dict[str, Any]:
        return vars(self)

    def _kept(self) -> dict[str, Any]:
        return {} if self._place is None else vars(self._place)

    def _known_place(self) -> Any:
        """The place of the contacts, or a ValueError."""
        if self._place is None:
            raise ValueError("contacts were made of arrays alone; expected those of a result, which knows its mesh")
        return self._place


class Contact:
    """One contact of a :class:`ccd_warp.Contacts`.

    Attributes:
        index: Its index there.
    """

    __slots__ = ("_row", "index")

    def __init__(self, row: Contacts, index: int) -> None:
        """The contact with this index, from a ``Contacts`` of it alone."""
        self._row = row
        self.index = index

    @property
    def kind(self) -> PairKind:
        """Kind of the pair."""
        return PairKind(int(self._row.kind[0]))

    @property
    def primitives(self) -> NDArray[np.int32]:
        """Indices of both primitives in the mesh, as in :class:`ccd_warp.Contacts`, int32, shape [2]."""
        return self._row.primitives[0].copy()

    @property
    def toi(self) -> float:
        """Earliest time of impact, in [0, t_max]."""
        return float(self._row.toi[0])

    @property
    def parameters(self) -> tuple[float, float]:
        """(u, v) at toi, as in :class:`ccd_warp.PairResult`."""
        u, v = self._row.parameters[0].tolist()
        return u, v

    @property
    def normal(self) -> NDArray[np.float64]:
        """Unit normal at toi, as in :class:`ccd_warp.Contacts`, float64, shape [3], or [2] in the plane."""
        return self._row.normal[0].copy()

    @property
    def status(self) -> CCDStatus:
        """How the answer was obtained."""
        return CCDStatus(int(self._row.status[0]))

    @property
    def gap(self) -> float:
        """Upper bound of the gap beyond the minimum separation (L∞) or distance (Euclidean) at toi, a length."""
        return float(self._row.gap[0])

    @property
    def width(self) -> float:
        """Width of the time interval left open, 0 except at a limit."""
        return float(self._row.width[0])

    @property
    def point(self) -> NDArray[np.float64]:
        """Position at toi, a length, float64, shape [3], or [2] in the plane."""
        return self._row.points[0].copy()

    @property
    def relative_velocity(self) -> NDArray[np.float64]:
        """Of the first primitive relative to the second, as in :class:`ccd_warp.Contacts`, float64, shape [3] or [2].

        A displacement in the whole step.
        """
        return self._row.relative_velocity[0].copy()

    @property
    def vertices(self) -> NDArray[np.int32]:
        """Vertices of the first primitive and then of the second, 1 to 4 in all, as a plane has none, int32.

        ``positions[contact.vertices]`` are their positions.
        """
        return np.hstack(pair_corners(self._row._known_mesh(), self.kind, self._row.primitives))[0]

    @property
    def bodies(self) -> NDArray[np.int32]:
        """Bodies of the first and the second primitive, int32, shape [2]."""
        return self._row.bodies[0]

    @property
    def body_names(self) -> tuple[str, str]:
        """Names of these bodies."""
        names, (a, b) = self._row._known_mesh().names, self.bodies.tolist()
        return names[a], names[b]

    @property
    def world(self) -> int:
        """World of the contact."""
        return int(self._row.world[0])

    def __repr__(self) -> str:
        return f"Contact({self._described()}, toi={self.toi!r})"

    def _described(self) -> str:
        """What touches what and where, as far as it is known."""
        place = self._row._place
        text = kind_name(self.kind)
        if place is None:
            return text
        a, b = map(shortened, self.body_names)
        text += f" of {a} and {b}" if len({*self.bodies.tolist()}) == 2 else f" of {a} and itself"
        return text if not place.has_points else f"{text} at {point_text(self.point)}"

    def _cells(self) -> tuple[str, ...]:
        """The cells of a table that holds this contact."""
        place = self._row._known_place()
        point = point_text(self.point) if place.has_points else ""
        return kind_name(self.kind), ", ".join(self.body_names), repr(self.toi), point, self.status.name.lower()


def _by_kind(kinds: NDArray[np.int32]) -> str:
    """How many contacts there are of each kind, where there are any."""
    counts = np.bincount(kinds, minlength=len(PairKind)) if len(kinds) else np.zeros(len(PairKind), dtype=np.int64)
    parts = [f"{counts[kind]:,} {kind_name(kind)}" for kind in PairKind if counts[kind]]
    return f": {', '.join(parts)}" if parts else ""


class Outcome:
    """What follows from the toi of a step and its contacts, as a result on the host has them."""

    toi: float
    world_toi: NDArray[np.float64]
    contacts: Contacts

    @property
    def hit(self) -> bool:
        """Whether any pair has a finite toi."""
        return bool(np.isfinite(self.toi))

    @property
    def first(self) -> Contact | None:
        """The earliest contact in the list; of those at the same toi the one that approaches most along its normal.

        Tois are the same to rounding: up to twice the gaps of two contacts divided by their relative velocities, and a
        thousandth of the step at most. Of each two features that touch then one contact counts, that of
        :meth:`Contacts.unique`. None if the list is empty.
        """
        contacts = self.contacts
        if len(contacts) == 0:
            return None
        place = contacts._place
        return contacts[int(np.argmin(contacts.toi)) if place is None else place.first_of(contacts)]

    def _outcome(self) -> str:
        """In a line: the toi, in how many worlds, how many contacts, and the first."""
        if not self.hit:
            return "toi=inf, no contact"
        parts = [f"toi={self.toi!r}"]
        if len(self.world_toi) > 1:
            parts.append(f"{np.isfinite(self.world_toi).sum():,} of {len(self.world_toi):,} worlds")
        parts.append(counted(len(self.contacts), "contact", "contacts"))
        return ", ".join(parts) + (f", first: {self.first._described()}" if self.first else "")

    def _repr_html_(self) -> str:
        return self.contacts._table(repr(self))


def first_contacts(
    toi: NDArray[np.float64], owners: NDArray[np.int32], owner_toi: NDArray[np.float64]
) -> NDArray[np.int32]:
    """Index of the contact that gives the toi of each owner, the first where several share it, -1 where there is none.

    Args:
        toi: The toi of each contact.
        owners: The vertices, bodies or worlds to which each contact belongs, shape [m, k].
        owner_toi: The toi of each of these.
    """
    contact, column = np.nonzero(toi[:, None] == owner_toi[owners])
    first = np.full(len(owner_toi), -1, dtype=np.int32)
    first[owners[contact, column][::-1]] = contact[::-1]  # of several the last written stays, which is the first
    return first
