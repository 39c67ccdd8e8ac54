"""Up to which distance it matters how near pairs are at the start of a step, and what contacts are made of."""

from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from ccd_warp._engine.mesh.lengths import add_rounded_up
from ccd_warp._engine.mesh.scene import length_scale_of

if TYPE_CHECKING:
    from ccd_warp._engine.mesh.topology import Topology
    from ccd_warp._scene.input.options import Options
    from ccd_warp._scene.mesh import CollisionMesh

# What starts beyond its distance by no more than rounding keeps its start distance, too: these shares of the distance
# and of the size of the mesh are far above the margin of a pair (`kernels.pair.start_distance`), unless its
# motion is far larger than the mesh. A gap of 7.6e-6 of the size would be lost in float32, so what starts within twice
# that keeps it there, and with it is solved in float64.
_OF_DISTANCE = 2.0**-20
_OF_SIZE = {"float64": 2.0**-40, "float32": 2.0**-16}


def largest_start_distance(mesh: "CollisionMesh", options: "Options", radius: float) -> float:
    """The distance up to which start distances are kept, radii besides, of which this is the largest."""
    distance = options.separation(length_scale_of(mesh, options))
    with np.errstate(over="ignore"):
        slack = _OF_DISTANCE * (distance + 2.0 * radius) + _OF_SIZE[options.precision] * mesh.length_scale
    return add_rounded_up(distance, min(slack, float(np.finfo(np.float64).max)))


def keeps_start_distances(mesh: "CollisionMesh", options: "Options") -> bool:
    """Whether pairs keep a distance, and what starts within it its start distance."""
    if not options.keeps_start_distances:
        return False
    return options.minimum_separation > 0 or options.minimum_distance > 0 or mesh.is_thick


def corners_by_kind(topology: "Topology") -> list[wp.array]:
    """The vertices of the primitives that contacts name: of vertices, edges and faces."""
    return [topology.corners[name] for name in ("vertex", "edge", "face")]
