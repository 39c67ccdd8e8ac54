"""What the options of a call mean for a scene: kinds of pairs, norm, length scale, what is near."""

from typing import TYPE_CHECKING, Any

import warp as wp

from ccd_warp._runtime.status import PairKind
from ccd_warp._scene.input.arguments import shown
from ccd_warp.kernels.pair.norm import Norm

if TYPE_CHECKING:
    from ccd_warp._scene.input.options import Options
    from ccd_warp._scene.mesh import CollisionMesh


def possible_kinds(mesh: "CollisionMesh", options: "Options") -> tuple[PairKind, ...]:
    """Kinds of pairs that the primitives of a mesh can form and the options select.

    In the plane vertices with edges, and points with points, suffice. Let A and B be two segments, or a point and a
    segment, that do not touch at the start. They touch where the origin is in the convex polygon A - B. It moves
    continuously, so the origin enters it, and first comes within a distance of it, at its boundary. Each side of that
    boundary is a vertex of one of the two minus the other, because A - B is the convex hull of such sides: a
    parallelogram, or, of parallel segments, one segment that the four sides cover.
    """
    if mesh.dimension == 2:
        possible = {
            PairKind.POINT_SEGMENT: mesh.num_edges > 0,
            PairKind.POINT_POINT: len(mesh.codimensional_points) > 0,
            PairKind.VERTEX_PLANE: len(mesh.planes) > 0,
        }
        return tuple(kind for kind in options.kinds if possible.get(kind))
    possible = {
        PairKind.VERTEX_FACE: mesh.num_faces > 0,
        PairKind.EDGE_EDGE: mesh.num_edges > 0,
        PairKind.POINT_SEGMENT: len(mesh.codimensional_points) > 0 and len(mesh.codimensional_edges) > 0,
        PairKind.POINT_POINT: len(mesh.codimensional_points) > 0,
        PairKind.VERTEX_PLANE: len(mesh.planes) > 0,
    }
    return tuple(kind for kind in options.kinds if possible[kind])


def norm_of(
    mesh: "CollisionMesh",
    options: "Options",
    *,
    on_arcs: bool = False,
) -> Norm:
    """The norm of separations (``kernels.pair.norm``): the Euclidean one with radii, even of 0, or a minimum distance.

    Args:
        mesh: The bodies.
        options: The options of the call.
        on_arcs: Whether bodies turn, for which the norm of either shape has one of its own.

    Raises:
        ValueError: If there are radii, which are Euclidean lengths, and a separation in the maximum norm.
    """
    if mesh.radius is None:
        return options.norm.on_arcs if on_arcs else options.norm
    if options.minimum_separation > 0:
        raise ValueError(
            f"minimum_separation is {shown(options.minimum_separation)} and the mesh has a radius of up to "
            f"{mesh.radius.max():.6g}; expected minimum_distance, which is Euclidean as a radius is, or no radius"
        )
    return Norm.EUCLIDEAN.on_arcs if on_arcs else Norm.EUCLIDEAN


def length_scale_of(mesh: "CollisionMesh", options: "Options") -> float:
    """The unit of tolerance and separation: that of the options, or the size of the mesh."""
    return mesh.length_scale if options.length_scale is None else options.length_scale


def packed_reach(radius: wp.array, distance: float, stop: wp.array, kept: float = 0.0) -> Any:
    """What is near at one time, as the struct of the kernels, for radii of the vertices."""
    from ccd_warp.kernels.at_one_time.proximity import Reach  # not before a scene needs it

    reach = Reach()
    reach.distance, reach.kept, reach.radius, reach.stop = distance, kept, radius, stop
    return reach
