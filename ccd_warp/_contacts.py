"""Contacts of a step: their arrays, what follows from the mesh, and one contact at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from ccd_warp._display import MOST_ROWS, counted, html_table, point_text, shortened
from ccd_warp._status import CCDStatus, PairKind

# Number of vertices of a pair of each kind; where it is less than four, `Contacts.vertices` repeats some.
_CORNERS = {
    PairKind.VERTEX_FACE: (0, 1, 2, 3),
    PairKind.EDGE_EDGE: (0, 1, 2, 3),
    PairKind.POINT_SEGMENT: (0, 2, 3),
    PairKind.POINT_POINT: (0, 2),
    PairKind.VERTEX_PLANE: (0,),
}


class Placed:
    """Keeps what contacts know beside their arrays in a slot, so that ``vars()`` gives the arrays alone.

    It is a ``ContactPlace`` of `ccd_warp._contact_place`, or of contacts on a device a ``DeviceStep``. These modules
    import this one and know the types.
    """

    __slots__ = ("_place",)
    _place: Any

    def __post_init__(self) -> None:
        object.__setattr__(self, "_place", None)


@dataclass(frozen=True, repr=False, eq=False)
class Contacts(Placed):
    """Pairs that touch, ordered by :class:`ccd_warp.PairKind` and then lexicographically by primitives.

    ``contacts[k]`` is a :class:`ccd_warp.Contact`, and so is each item of an iteration; ``contacts[chosen]``, with a
    slice, a mask or an array of indices, is a ``Contacts`` of these alone.

    Attributes:
        kind: :class:`ccd_warp.PairKind` of each contact, int32, shape [m].
        primitives: Indices of a vertex and a face, of two edges, of the vertex and the edge of a codimensional point
            and a codimensional edge (in the plane of any vertex and edge), of the vertices of two codimensional points,
            or of a vertex and a plane of ``mesh.planes``, int32, shape [m, 2].
        toi: Earliest time of impact in [0, t_max], float64, shape [m].
        parameters: (u, v) of the closest points at toi, between which the gap is, as in :class:`ccd_warp.PairResult`,
            0 of a vertex and a plane, float64, shape [m, 2].
        normal: Unit vector along the gap at toi, from the closest point of the second primitive to that of the first,
            wherever a gap of more than rounding is left (32 roundings of the largest distance between the two in the
            step): with a distance or separation nearly always, and also of a pair that starts within it. Of a pair that
            touches without a gap it is the normal of the face or of both edges, from the second primitive towards the
            side from which the first comes; a point has no sides, and there it opposes the relative velocity (its
            component across the segment, if there is one). Zero where nothing moves and no side defines a direction.
            Of a vertex and a plane it is the normal of the plane. float64, shape [m, 3], of a mesh in the plane [m, 2].
        status: :class:`ccd_warp.CCDStatus` of each contact, int32, shape [m].
        gap: Upper bound of the gap (L∞) beyond the minimum separation at toi, a length, float64, shape [m]. With a
            minimum distance, or radii, the gap beyond the distance of the pair, Euclidean.
        width: Width of the time interval left open, 0 except at a limit, as in :class:`ccd_warp.PairResult`, float64,
            shape [m].
    """

    kind: NDArray[np.int32]
    primitives: NDArray[np.int32]
    toi: NDArray[np.float64]
    parameters: NDArray[np.float64]
    normal: NDArray[np.float64]
    status: NDArray[np.int32]
    gap: NDArray[np.float64]
    width: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.toi)

    @overload
    def __getitem__(self, index: int | np.integer[Any]) -> "Contact": ...

    @overload
    def __getitem__(self, index: slice | Sequence[int] | NDArray[Any]) -> "Contacts": ...

    def __getitem__(self, index: Any) -> "Contact | Contacts":
        if isinstance(index, (int, np.integer)) and not isinstance(index, bool):
            if not -len(self) <= index < len(self):
                raise IndexError(f"index is {index}; expected one of {len(self)} contacts")
            k = int(index) % len(self)
            return Contact(self[k : k + 1], k)
        if isinstance(index, (list, tuple)):
            index = np.asarray(index, dtype=bool if index and isinstance(index[0], bool) else np.int64)
        chosen = Contacts(**{name: values[index] for name, values in vars(self).items()})
        return chosen if self._place is None else chosen._placed(self._place.chosen(index))

    def __iter__(self) -> Iterator["Contact"]:
        if self._place is not None and len(self):  # for all at once, and not for each
            _ = self.vertices, self.points if self._place.has_points else None
        return (self[k] for k in range(len(self)))

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_place": self._place}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)

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

        It is halfway between the closest points. These have the parameters (u, v), and are v and
        f0 + u (f1 − f0) + v (f2 − f0); ea0 + u (ea1 − ea0) and eb0 + v (eb1 − eb0); p and a + u (b − a); p and q; or v
        and the point of the plane below it. Their distance is the gap.
        """
        points: NDArray[np.float64] | None = self._known().points_of(self)
        if points is None:
            raise ValueError(
                "contacts.points are not known, as no launch has read positions; expected a launch before, or "
                "to_host(vertices_t0, vertices_t1)"
            )
        return points

    @property
    def vertices(self) -> NDArray[np.int32]:
        """Vertices of each contact, int32, shape [m, 4].

        They are v, f0, f1, f2; ea0, ea1, eb0, eb1; p, p, a, b; p, p, q, q; or of a vertex and a plane v, v, v, v.
        Columns repeat the vertex of a point so that there are always four.
        """
        vertices: NDArray[np.int32] = self._known().vertices_of(self)
        return vertices

    @property
    def weights(self) -> NDArray[np.float64]:
        """Weights of the four ``vertices`` in the difference of the closest points at toi, float64, shape [m, 4].

        Those of the first primitive add up to 1, those of the second to -1, and a column that repeats a vertex has
        weight 0. A push along ``normal`` moves each vertex by its weight of that.
        """
        return pair_weights(self.kind, self.parameters)

    @property
    def bodies(self) -> NDArray[np.int32]:
        """Bodies of the first and the second primitive of each contact, int32, shape [m, 2]."""
        mesh = self._known().mesh
        bodies: NDArray[np.int32] = mesh.vertex_body[self.vertices[:, [0, 3]]]
        is_plane = self.kind == int(PairKind.VERTEX_PLANE)
        bodies[is_plane, 1] = mesh.planes.bodies[self.primitives[is_plane, 1]]
        return bodies

    @property
    def world(self) -> NDArray[np.int32]:
        """World of each contact, int32, shape [m]."""
        world: NDArray[np.int32] = self._known().mesh.vertex_world[self.vertices[:, 0]]
        return world

    def sorted_by_toi(self) -> "Contacts":
        """The contacts by ascending toi, those with one toi in their present order, in new arrays.

        Indices into contacts, such as ``MeshResult.vertex_contact``, are those of the original order.
        """
        return self[np.argsort(self.toi, kind="stable")]

    def _placed(self, place: Any) -> "Contacts":
        """The contacts with this place."""
        same = Contacts(**vars(self))
        object.__setattr__(same, "_place", place)
        return same

    def _known(self) -> Any:
        """The place of the contacts, or a ValueError."""
        if self._place is None:
            raise ValueError("contacts were made of arrays alone; expected those of a result, which knows its mesh")
        return self._place

    def _first(self) -> "Contact | None":
        """The earliest contact, the first where several are; None if there are none."""
        return self[int(np.argmin(self.toi))] if len(self) else None


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
    def vertices(self) -> NDArray[np.int32]:
        """Vertices of the first primitive and then of the second, 1 to 4 in all, as a plane has none, int32.

        ``positions[contact.vertices]`` are their positions.
        """
        return self._row.vertices[0, list(_CORNERS[self.kind])]

    @property
    def bodies(self) -> NDArray[np.int32]:
        """Bodies of the first and the second primitive, int32, shape [2]."""
        return self._row.bodies[0]

    @property
    def body_names(self) -> tuple[str, str]:
        """Names of these bodies."""
        names, (a, b) = self._row._known().mesh.names, self.bodies.tolist()
        return names[a], names[b]

    @property
    def world(self) -> int:
        """World of the contact."""
        return int(self._row._known().mesh.vertex_world[self._row.vertices[0, 0]])

    def __repr__(self) -> str:
        return f"Contact({self._described()}, toi={self.toi!r})"

    def _described(self) -> str:
        """What touches what and where, as far as it is known."""
        place = self._row._place
        text = _kind_name(self.kind)
        if place is None:
            return text
        a, b = map(shortened, self.body_names)
        text += f" of {a} and {b}" if len({*self.bodies.tolist()}) == 2 else f" of {a} and itself"
        return text if not place.has_points else f"{text} at {point_text(self.point)}"

    def _cells(self) -> tuple[str, ...]:
        """The cells of a table that holds this contact."""
        known = self._row._known()
        point = point_text(self.point) if known.has_points else ""
        return _kind_name(self.kind), ", ".join(self.body_names), repr(self.toi), point, self.status.name.lower()


def pair_weights(kind: NDArray[np.int32], parameters: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights of the four vertices of each pair in the difference of its closest points, from its kind and (u, v).

    Those of the first primitive add up to 1, those of the second to -1; a column that repeats a vertex has weight 0.
    Shape [m, 4].
    """
    u, v = parameters.T
    one, zero = np.ones(len(kind)), np.zeros(len(kind))
    by_kind: dict[PairKind, tuple[Any, ...]] = {
        PairKind.VERTEX_FACE: (one, u + v - 1.0, -u, -v),
        PairKind.EDGE_EDGE: (1.0 - u, u, v - 1.0, -v),
        PairKind.POINT_SEGMENT: (one, zero, u - 1.0, -u),
        PairKind.POINT_POINT: (one, zero, -one, zero),
        PairKind.VERTEX_PLANE: (one, zero, zero, zero),
    }
    weights = np.empty((len(kind), 4))
    for of_kind, columns in by_kind.items():
        rows = kind == int(of_kind)
        weights[rows] = np.stack(columns, axis=1)[rows]
    return weights


def _kind_name(kind: PairKind) -> str:
    return kind.name.lower().replace("_", "-")


def _by_kind(kinds: NDArray[np.int32]) -> str:
    """How many contacts there are of each kind, where there are any."""
    counts = np.bincount(kinds, minlength=len(PairKind)) if len(kinds) else np.zeros(len(PairKind), dtype=np.int64)
    parts = [f"{counts[kind]:,} {_kind_name(kind)}" for kind in PairKind if counts[kind]]
    return f": {', '.join(parts)}" if parts else ""


def outcome(toi: float, world_toi: NDArray[np.float64], contacts: Contacts) -> str:
    """The outcome of a step in a line: its toi, in how many worlds, how many contacts, and the first."""
    if not np.isfinite(toi):
        return "toi=inf, no contact"
    parts = [f"toi={toi!r}"]
    if len(world_toi) > 1:
        parts.append(f"{np.isfinite(world_toi).sum():,} of {len(world_toi):,} worlds")
    parts.append(counted(len(contacts), "contact", "contacts"))
    first = contacts._first()
    return ", ".join(parts) + (f", first: {first._described()}" if first else "")


def first_contacts(
    toi: NDArray[np.float64], parts: NDArray[np.int32], part_toi: NDArray[np.float64]
) -> NDArray[np.int32]:
    """Index of the contact that gives the toi of each part, the first where several share it, -1 where there is none.

    Args:
        toi: The toi of each contact.
        parts: The parts to which each contact belongs, shape [m, k].
        part_toi: The toi of each part.
    """
    contact, column = np.nonzero(toi[:, None] == part_toi[parts])
    first = np.full(len(part_toi), -1, dtype=np.int32)
    first[parts[contact, column][::-1]] = contact[::-1]  # of several the last written stays, which is the first
    return first
