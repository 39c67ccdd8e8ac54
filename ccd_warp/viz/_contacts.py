"""Positions of the contacts of a step."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._engine.contact_corners import contact_corners
from ccd_warp._input.arguments import check_instance
from ccd_warp._mesh import CollisionMesh
from ccd_warp._results import Contacts
from ccd_warp._status import PairKind


def contact_points(
    mesh: CollisionMesh, vertices_t0: ArrayLike, vertices_t1: ArrayLike, contacts: Contacts
) -> NDArray[np.float64]:
    """Position of each contact at its toi: the midpoint of the two points with the parameters (u, v).

    These are v and f0 + u (f1 − f0) + v (f2 − f0); ea0 + u (ea1 − ea0) and eb0 + v (eb1 − eb0); p and a + u (b − a); or
    p and q. Their distance is the gap, which the tolerance and the minimum separation bound.

    Args:
        mesh: The mesh of the step.
        vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3].
        vertices_t1: End positions, as ``mesh_ccd`` takes them, shape [V, 3] or [V_moving, 3].
        contacts: ``MeshResult.contacts`` of the step.

    Returns:
        Positions, float64, same length unit as the mesh, shape [m, 3].

    Raises:
        ValueError: If the positions do not match the mesh, or the contacts refer to primitives that it does not have.
    """
    check_instance("mesh", mesh, CollisionMesh)
    check_instance("contacts", contacts, Contacts)
    start, end = mesh.frames(vertices_t0, vertices_t1)
    points = np.empty((len(contacts), 3))
    for kind in np.unique(contacts.kind):
        of_kind = contacts.kind == kind
        first, second = contact_corners(mesh, PairKind(int(kind)), contacts.primitives[of_kind])
        t = contacts.toi[of_kind, None]
        u, v = contacts.parameters[of_kind].T[..., None]
        weights = {
            PairKind.VERTEX_FACE: ([1.0], [1.0 - u - v, u, v]),
            PairKind.EDGE_EDGE: ([1.0 - u, u], [1.0 - v, v]),
            PairKind.POINT_SEGMENT: ([1.0], [1.0 - u, u]),
            PairKind.POINT_POINT: ([1.0], [1.0]),
        }[PairKind(int(kind))]
        sides = [
            sum(w * ((1.0 - t) * start[i] + t * end[i]) for w, i in zip(side_weights, corners.T, strict=True))
            for side_weights, corners in zip(weights, (first, second), strict=True)
        ]
        points[of_kind] = 0.5 * sides[0] + 0.5 * sides[1]
    return points
