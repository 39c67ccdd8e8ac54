"""Contacts as a person reads them: by ascending toi, with names of bodies and numbers within these."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._display import point_text
from ccd_warp._mesh import CollisionMesh
from ccd_warp._status import PairKind

if TYPE_CHECKING:
    from ccd_warp._contacts import Contacts


def kind_name(kind: PairKind) -> str:
    """A kind of pair as the command line writes it."""
    return kind.name.lower().replace("_", "-")


@dataclass(frozen=True)
class ContactTable:
    """The contacts of a step.

    Attributes:
        mesh: The bodies.
        contacts: Its contacts, by ascending toi; where they are the earliest, the first is that of the result.
    """

    mesh: CollisionMesh
    contacts: "Contacts"

    @classmethod
    def of(cls, mesh: CollisionMesh, contacts: "Contacts", most: int | None = None) -> "ContactTable":
        """The table of contacts in any order, or of the earliest ones, of which the first is that of the result."""
        order = np.argsort(contacts.toi, kind="stable")
        if most is not None and len(order):
            first = contacts._known().first_of(contacts)
            order = np.append(first, order[order != first])[:most]
        return cls(mesh, contacts[order])

    def __len__(self) -> int:
        return len(self.contacts)

    @cached_property
    def kinds(self) -> list[PairKind]:
        """Kind of each contact."""
        return [PairKind(kind) for kind in self.contacts.kind.tolist()]

    @cached_property
    def body_names(self) -> list[tuple[str, str]]:
        """Names of both bodies of each contact."""
        names = self.mesh.names
        return [(names[a], names[b]) for a, b in self.contacts.bodies.tolist()]

    @cached_property
    def vertices(self) -> NDArray[np.int64]:
        """Vertices of each contact, as in ``Contacts.vertices``, numbered within their bodies, shape [m, 4]."""
        vertices = self.contacts.vertices.astype(np.int64)
        return vertices - self.mesh.body_vertex_range[self.mesh.vertex_body[vertices]]

    @cached_property
    def primitives(self) -> NDArray[np.int64]:
        """Both primitives of each contact, numbered within their bodies among those of their kind, shape [m, 2]."""
        mesh, bodies = self.mesh, np.arange(self.mesh.num_bodies)
        first: dict[str, NDArray[Any]] = {
            "vertex": mesh.body_vertex_range[:-1],
            "edge": np.searchsorted(mesh.edge_body, bodies),
            "face": np.searchsorted(mesh.face_body, bodies),
            "plane": np.cumsum(np.isin(bodies, mesh.planes.bodies)) - 1,
        }
        sides = {
            PairKind.VERTEX_FACE: ("vertex", "face"),
            PairKind.EDGE_EDGE: ("edge", "edge"),
            PairKind.POINT_SEGMENT: ("vertex", "edge"),
            PairKind.POINT_POINT: ("vertex", "vertex"),
            PairKind.VERTEX_PLANE: ("vertex", "plane"),
        }
        numbers = self.contacts.primitives.astype(np.int64)
        for kind, names in sides.items():
            of_kind = self.contacts.kind == int(kind)
            for side, name in enumerate(names):
                numbers[of_kind, side] -= first[name][self.contacts.bodies[of_kind, side]]
        return numbers

    def described(self, k: int) -> str:
        """What touches what in contact ``k``."""
        a, b = self.body_names[k]
        v = self.vertices[k].tolist()
        match self.kinds[k]:
            case PairKind.VERTEX_FACE:
                return f"vertex {v[0]} of {a} and face {self.primitives[k, 1]} of {b}"
            case PairKind.EDGE_EDGE:
                return f"edge {v[0]}-{v[1]} of {a} and edge {v[2]}-{v[3]} of {b}"
            case PairKind.POINT_SEGMENT:
                return f"point {v[0]} of {a} and edge {v[2]}-{v[3]} of {b}"
            case PairKind.VERTEX_PLANE:
                return f"vertex {v[0]} of {a} and {b}"
            case _:
                return f"point {v[0]} of {a} and point {v[2]} of {b}"

    def placed(self, k: int) -> str:
        """Where contact ``k`` is."""
        u, v = self.contacts.parameters[k].tolist()
        normal = point_text(self.contacts.normal[k])
        return f"at {point_text(self.contacts.points[k])}, (u, v) = ({u:.6g}, {v:.6g}), normal {normal}"
