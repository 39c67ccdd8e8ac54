"""Contacts as a person reads them: with names of bodies, and vertices and primitives numbered within their bodies."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._results.contacts import Contacts
from ccd_warp._results.results import MeshResult
from ccd_warp._runtime.display import point_text
from ccd_warp._runtime.status import PairKind, primitives_of
from ccd_warp._scene.mesh import CollisionMesh


def earliest(result: MeshResult) -> Contacts:
    """The earliest contact, alone or not there."""
    first = 0 if result.first is None else result.first.index
    return result.contacts[first : first + 1]


def vertices_in_body(mesh: CollisionMesh, contacts: Contacts) -> NDArray[np.int64]:
    """Vertices of each contact, as in ``Contacts.vertices``, numbered within their bodies, shape [m, 4]."""
    vertices = contacts.vertices.astype(np.int64)
    return vertices - mesh.body_vertex_range[mesh.vertex_body[vertices]]


def primitives_in_body(mesh: CollisionMesh, contacts: Contacts) -> NDArray[np.int64]:
    """Both primitives of each contact, numbered within their bodies among those of their kind, shape [m, 2]."""
    bodies = np.arange(mesh.num_bodies)
    first: dict[str, NDArray[Any]] = {
        "vertex": mesh.body_vertex_range[:-1],
        "edge": np.searchsorted(mesh.edge_body, bodies),
        "face": np.searchsorted(mesh.face_body, bodies),
        "plane": np.cumsum(np.isin(bodies, mesh.planes.bodies)) - 1,
    }
    numbers = contacts.primitives.astype(np.int64)
    for kind in PairKind:
        of_kind = contacts.kind == int(kind)
        for side, name in enumerate(primitives_of(kind)):
            numbers[of_kind, side] -= first[name][contacts.bodies[of_kind, side]]
    return numbers


def described(mesh: CollisionMesh, contacts: Contacts) -> list[str]:
    """What touches what in the only contact, and where: two lines."""
    a, b = (mesh.names[body] for body in contacts.bodies[0].tolist())
    v, face = vertices_in_body(mesh, contacts)[0].tolist(), primitives_in_body(mesh, contacts)[0, 1]
    what = {
        PairKind.VERTEX_FACE: f"vertex {v[0]} of {a} and face {face} of {b}",
        PairKind.EDGE_EDGE: f"edge {v[0]}-{v[1]} of {a} and edge {v[2]}-{v[3]} of {b}",
        PairKind.POINT_SEGMENT: f"point {v[0]} of {a} and edge {v[2]}-{v[3]} of {b}",
        PairKind.POINT_POINT: f"point {v[0]} of {a} and point {v[2]} of {b}",
        PairKind.VERTEX_PLANE: f"vertex {v[0]} of {a} and {b}",
    }[PairKind(int(contacts.kind[0]))]
    u, v = contacts.parameters[0].tolist()
    place, normal = point_text(contacts.points[0]), point_text(contacts.normal[0])
    return [what, f"at {place}, (u, v) = ({u:.6g}, {v:.6g}), normal {normal}"]
