"""The vertices of a contact."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp._contacts import Contacts
from ccd_warp._mesh import CollisionMesh
from ccd_warp._status import PairKind

# Columns that repeat the vertices of both primitives to make four, by the number of vertices.
_FOUR = {4: [0, 1, 2, 3], 3: [0, 0, 1, 2], 2: [0, 0, 1, 1], 1: [0, 0, 0, 0]}


def contact_vertices(mesh: CollisionMesh, contacts: Contacts) -> NDArray[np.int32]:
    """The vertices of each contact, shape [m, 4].

    They are v, f0, f1, f2, or ea0, ea1, eb0, eb1; p, p, a, b; p, p, q, q; or v alone, which meets a plane.
    """
    vertices = np.empty((len(contacts), 4), dtype=np.int32)
    for kind in np.unique(contacts.kind):
        of_kind = contacts.kind == kind
        both = np.hstack(contact_corners(mesh, PairKind(int(kind)), contacts.primitives[of_kind]))
        vertices[of_kind] = both[:, _FOUR[both.shape[1]]]
    return vertices


def contact_bodies(mesh: CollisionMesh, contacts: Contacts) -> NDArray[np.int32]:
    """Bodies of the first and the second primitive of each contact, shape [m, 2]."""
    bodies: NDArray[np.int32] = mesh.vertex_body[contact_vertices(mesh, contacts)[:, [0, 3]]]
    is_plane = contacts.kind == int(PairKind.VERTEX_PLANE)
    bodies[is_plane, 1] = mesh.planes.bodies[contacts.primitives[is_plane, 1]]
    return bodies


def contact_corners(
    mesh: CollisionMesh, kind: PairKind, primitives: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Vertices of both primitives of each pair of a kind, int32, shapes [m, 1 to 3], and [m, 0] of a plane.

    Raises:
        ValueError: If the mesh does not have such primitives.
    """
    vertices = np.arange(mesh.num_vertices, dtype=np.int32)[:, None]
    tables: dict[PairKind, tuple[tuple[str, Any], tuple[str, Any]]] = {
        PairKind.VERTEX_FACE: (("vertices", vertices), ("faces", mesh.faces)),
        PairKind.EDGE_EDGE: (("edges", mesh.edges), ("edges", mesh.edges)),
        PairKind.POINT_SEGMENT: (("vertices", vertices), ("edges", mesh.edges)),
        PairKind.POINT_POINT: (("vertices", vertices), ("vertices", vertices)),
        PairKind.VERTEX_PLANE: (("vertices", vertices), ("planes", np.zeros((len(mesh.planes), 0), dtype=np.int32))),
    }
    sides = []
    for (name, table), ids in zip(tables[kind], primitives.T, strict=True):
        if not ((ids >= 0) & (ids < len(table))).all():
            raise ValueError(
                f"contacts.primitives holds {ids[(ids < 0) | (ids >= len(table))][0]}; "
                f"expected indices of the mesh's {len(table)} {name}"
            )
        sides.append(table[ids])
    return sides[0], sides[1]
