"""Positions of the contacts of a step."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._results.contact_place import BodyMotion, MovingVertices, points_at_toi
from ccd_warp._results.results import Contacts
from ccd_warp._scene.input.arguments import check_instance
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.viz._moving import moving_vertices


def contact_points(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    contacts: Contacts,
    *,
    motion: BodyMotion | None = None,
) -> NDArray[np.float64]:
    """Position of each contact at its toi, as ``contacts.points`` has it: where the surfaces touch, with radii.

    Args:
        mesh: The mesh of the step.
        vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3].
        vertices_t1: End positions, as ``mesh_ccd`` takes them, shape [V, 3] or [V_moving, 3].
        contacts: ``MeshResult.contacts`` of the step.
        motion: How rigid bodies turn, a :class:`ccd_warp.RigidMotion`.

    Returns:
        Positions, float64, same length unit as the mesh, shape [m, 3].

    Raises:
        ValueError: If the positions do not match the mesh, or the contacts refer to primitives that it does not have.
    """
    check_instance("mesh", mesh, CollisionMesh)
    check_instance("contacts", contacts, Contacts)
    if motion is None:
        return points_at_toi(MovingVertices(mesh, *mesh.frames(vertices_t0, vertices_t1)), contacts)
    return points_at_toi(moving_vertices(mesh, vertices_t0, vertices_t1, motion), contacts)
