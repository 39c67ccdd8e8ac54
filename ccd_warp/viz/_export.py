"""A step as data sets of PyVista, for pictures of one's own."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._results.contact_place import BodyMotion, points_at_toi
from ccd_warp._results.pairs import pair_bodies
from ccd_warp._results.results import HostLaunchResult, MeshResult
from ccd_warp._scene.input.arguments import check_instance, check_real
from ccd_warp._scene.mesh import CollisionMesh
from ccd_warp.viz._moving import moving_vertices
from ccd_warp.viz._scene import check_result, middle_of, plane_squares
from ccd_warp.viz._window import import_pyvista

if TYPE_CHECKING:
    import pyvista


def to_pyvista(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    result: MeshResult | HostLaunchResult | None = None,
    *,
    t: float = 0.0,
    motion: BodyMotion | None = None,
) -> pyvista.MultiBlock:
    """A step as a ``pyvista.MultiBlock``: a block for each body, called by its name, and one for the contacts.

    A body has its faces, its codimensional edges as lines and its codimensional points as vertices. Its points have the
    data ``vertex`` (index in the mesh), ``displacement`` (from t = 0 to t = 1) and, with a result, ``toi`` (inf if
    none); its cells have ``primitive`` (index of the vertex, edge or face in the mesh). Its field data hold ``static``,
    1 for a body that does not move. A half-space is a square of its plane, larger than the step. The last block,
    ``contacts``, holds the points of the contacts at their toi with ``toi``, ``normal``, ``gap``, ``kind``, ``status``
    and ``bodies``.

    Args:
        mesh: The mesh of the step.
        vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3].
        vertices_t1: End positions, as ``mesh_ccd`` takes them, shape [V, 3] or [V_moving, 3].
        result: The result of ``mesh_ccd``, or of a launch on the host; None leaves out the contacts and ``toi``.
        t: Time at which the bodies are placed, in [0, 1].
        motion: How rigid bodies turn, as in :func:`draw_step`.

    Returns:
        A ``pyvista.MultiBlock``.

    Raises:
        ImportError: If the extra ``viz`` is not installed.
        ValueError: If an argument is not as described.
    """
    check_instance("mesh", mesh, CollisionMesh)
    if result is not None:
        check_result(result)
    t = check_real("t", t, "a number in [0, 1]", lambda x: 0 <= x <= 1)
    moving = moving_vertices(mesh, vertices_t0, vertices_t1, motion)
    start, end = (moving.all_at(time) for time in (0.0, 1.0))
    if result is not None and result.vertex_toi.shape != (len(start),):
        raise ValueError(f"result.vertex_toi has shape {result.vertex_toi.shape}; expected {(len(start),)}")
    pyvista = import_pyvista()
    positions = moving.all_at(t)
    blocks = pyvista.MultiBlock()
    squares = {}
    if len(mesh.planes):
        box = middle_of(*mesh._both_placed(start, end))
        squares = dict(zip(mesh.planes.bodies.tolist(), plane_squares(mesh, *box), strict=True))
    for body, name in enumerate(mesh.names):
        first, last = mesh.body_vertex_range[body : body + 2].tolist()
        primitives = _primitives(mesh, body)
        cells = {kind: _padded(corners - first) for kind, (_, corners) in primitives.items() if len(corners)}
        shape = pyvista.PolyData()
        if last > first:  # PyVista takes no empty arrays
            shape = pyvista.PolyData(positions[first:last], **cells)
            shape.point_data["vertex"] = np.arange(first, last, dtype=np.int32)
            shape.point_data["displacement"] = end[first:last] - start[first:last]
            if result is not None:
                shape.point_data["toi"] = result.vertex_toi[first:last].copy()
        if body in squares:
            shape = pyvista.PolyData(squares[body], faces=[4, 0, 1, 2, 3])
        if cells:
            shape.cell_data["primitive"] = np.concatenate([ids for ids, _ in primitives.values()])
        shape.field_data["static"] = np.array([int(mesh.static[body])])
        blocks.append(shape, name)
    if result is not None:
        contacts = result.contacts
        shape = pyvista.PolyData()
        if len(contacts):
            shape = pyvista.PolyData(points_at_toi(moving, contacts))
            shape.point_data["normal"] = mesh._in_space(contacts.normal.copy())
            for field in ("toi", "gap", "kind", "status"):
                shape.point_data[field] = getattr(contacts, field).copy()
            shape.point_data["bodies"] = pair_bodies(mesh, contacts)
        blocks.append(shape, "contacts")
    return blocks


def _primitives(mesh: CollisionMesh, body: int) -> dict[str, tuple[NDArray[np.int32], NDArray[np.int32]]]:
    """Indices and vertices of what a body shows, by PyVista's word for such cells and in the order of its cells."""
    points = mesh.codimensional_points[mesh.vertex_body[mesh.codimensional_points] == body]
    edges = mesh.codimensional_edges[mesh.edge_body[mesh.codimensional_edges] == body]
    faces = np.flatnonzero(mesh.face_body == body).astype(np.int32)
    return {
        "verts": (points, points[:, None]),
        "lines": (edges, mesh.edges[edges]),
        "faces": (faces, mesh.faces[faces]),
    }


def _padded(corners: NDArray[np.int32]) -> NDArray[np.int32]:
    """Cells as VTK takes them: the number of corners before each."""
    return np.insert(corners, 0, corners.shape[1], axis=1).ravel()
