"""The planes of half-spaces on a device, what vertices and they are asked for, and what is near or in the solid."""

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from operator import mul
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._engine.mesh.lengths import next_above
from ccd_warp._engine.mesh.mesh_cache import MeshCache
from ccd_warp._scene.half_space import unit_normals

if TYPE_CHECKING:
    from ccd_warp._engine.mesh.topology import Topology
    from ccd_warp._scene.input.options import Options
    from ccd_warp._scene.mesh import CollisionMesh

_U = 2.0**-53
_UP = 1.0 + 4.0 * _U
# The largest relative error of a length or sum of three numbers is 2u.
_LENGTH_UP = 1.0 + 8.0 * _U
# Components of a scaled normal below this may have lost bits.
_LEAST_NORMAL = 2.0**-1000
_LOST = 2.0**-1070
# As in `kernels.narrow_phase.planes`.
_LARGE, _SMALL, _SHRINK, _GROW = 2.0**1000, 2.0**-400, 2.0**-16, 2.0**600
_FAR = 2.0**1015
_VALUE, _ABSOLUTE = 4.5 * _U, 2.0**-1000
# More than the roundings of a reach and of its difference from a value, relative to the reach.
_REACH = 32.0 * _U


class ScaledPlanes(NamedTuple):
    """The planes as the kernels take them; those of a mesh in the plane have z = 0.

    Attributes:
        point: A point of each, shape [H, 3].
        normal: Normals times powers of two, so that the largest component is in [1, 2), shape [H, 3].
        lost: Bound of what a component of the normal has lost by that, shape [H].
        length: Length of each normal, rounded up, shape [H].
        sum: Sum of its magnitudes, rounded up, shape [H].
    """

    point: NDArray[np.float64]
    normal: NDArray[np.float64]
    lost: NDArray[np.float64]
    length: NDArray[np.float64]
    sum: NDArray[np.float64]


def scaled_planes(mesh: "CollisionMesh") -> ScaledPlanes:
    """The planes of a mesh, scaled."""
    normals = mesh._in_space(mesh.planes.normals)
    largest = np.abs(normals).max(axis=1, initial=0.0)
    normal = np.ldexp(normals, 1 - np.frexp(largest)[1][:, None])
    is_small = (normals != 0.0) & (np.abs(normal) < _LEAST_NORMAL)
    return ScaledPlanes(
        mesh._in_space(mesh.planes.points),
        normal,
        np.where(is_small.any(axis=1), _LOST, 0.0),
        np.array([math.hypot(*n) for n in normal.tolist()]) * _LENGTH_UP,
        np.array([math.fsum(map(abs, n)) for n in normal.tolist()]) * _LENGTH_UP,
    )


def meets(mesh: "CollisionMesh") -> NDArray[np.bool_]:
    """Whether the collision filter leaves a plane and a body, shape [H, B]."""
    may_meet = np.ones((len(mesh.planes), mesh.num_bodies), dtype=bool)
    if mesh.body_pairs is not None:
        may_meet = mesh.body_pairs[mesh.planes.bodies]
    number = np.full(mesh.num_bodies, -1)
    number[mesh.planes.bodies] = np.arange(len(mesh.planes))
    pairs = mesh.exclude_pairs.get("bodies", np.zeros((0, 2), dtype=np.int32))
    for first, second in (pairs.T, pairs.T[::-1]):
        is_plane = number[first] >= 0
        may_meet[number[first[is_plane]], second[is_plane]] = False
    return may_meet


def planes_by_world(mesh: "CollisionMesh") -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The planes that the vertices of each world meet, world after world, and where those of each begin, and the end.

    One that does not move meets all worlds; one that moves that of its vertex.
    """
    point, number = mesh.planes.vertices, np.arange(len(mesh.planes))
    shared, moving = number[point < 0], number[point >= 0]
    worlds = np.arange(mesh.num_worlds)
    world = np.concatenate([np.repeat(worlds, len(shared)), mesh.vertex_world[point[moving]]])
    of_world = np.concatenate([np.tile(shared, mesh.num_worlds), moving])
    begin = np.append(0, np.cumsum(np.bincount(world, minlength=mesh.num_worlds)))
    return begin.astype(np.int32), of_world[np.lexsort((of_world, world))].astype(np.int32)


def excluded_keys(mesh: "CollisionMesh") -> NDArray[np.int64]:
    """Keys of the excluded pairs of a vertex and a plane, ascending."""
    pairs = mesh.exclude_pairs.get("vertex_plane", np.zeros((0, 2), dtype=np.int32)).astype(np.int64)
    return pairs[:, 0] << 32 | pairs[:, 1]


def planes_of(topology: "Topology") -> Any:
    """The planes of a mesh on its device as the struct of the kernels, made once."""
    if topology.planes is None:
        topology.planes = _planes_on(topology.mesh, topology.array)
    return topology.planes


def _planes_on(mesh: "CollisionMesh", array: Callable[[NDArray[Any], Any], wp.array]) -> Any:
    """The planes of a mesh as the struct of the kernels; ``array`` puts values of a dtype on a device."""
    from ccd_warp.kernels.narrow_phase.planes import Planes  # not before a scene needs it

    planes = Planes()
    if len(mesh.planes) == 0:
        return planes
    scaled = scaled_planes(mesh)
    planes.point = array(scaled.point, wp.vec3d)
    if mesh._moves_planes:
        planes.vertex = array(mesh.planes.vertices, wp.int32)
        if mesh.num_worlds > 1:
            begin, of_world = planes_by_world(mesh)
            planes.world_begin, planes.of_world = array(begin, wp.int32), array(of_world, wp.int32)
    planes.normal = array(scaled.normal, wp.vec3d)
    planes.lost, planes.length, planes.sum = (array(values, wp.float64) for values in scaled[2:])
    planes.unit = array(mesh._in_space(unit_normals(mesh.planes.normals)), wp.vec3d)
    planes.body = array(mesh.planes.bodies, wp.int32)
    planes.meets = array(meets(mesh).astype(np.uint8), wp.uint8)
    planes.excluded = array(excluded_keys(mesh), wp.int64)
    return planes


def plane_query(options: "Options", length_scale: float, *, is_euclidean: bool, lets_part: bool = False) -> Any:
    """What vertices and planes are asked for, as the struct of the kernels.

    ``lets_part`` is whether what starts within its distance may part and slide.
    """
    from ccd_warp.kernels.narrow_phase.planes import PlaneQuery  # not before a scene needs it
    from ccd_warp.kernels.pair.start_gap import LEAST_TOLERANCE

    separation = options.separation(length_scale)
    query = PlaneQuery()
    query.is_euclidean = int(is_euclidean)
    query.distance = separation
    if separation > 0.0 and not is_euclidean:  # a product of two numbers
        query.distance = next_above(separation)
    query.start_gap_fraction = options.start_gap_share
    query.keeps_start_distance = int(lets_part)
    query.t_max = options.t_max
    query.most_gap = 2.0 * max(options.tolerance, LEAST_TOLERANCE[wp.float64]) * length_scale
    return query


def plane_candidates(
    mesh: "CollisionMesh",
    vertices: NDArray[np.int32],
    positions: Sequence[NDArray[np.float64]],
    inflation: float,
    box_radius: NDArray[np.float64],
) -> NDArray[np.int32]:
    """Those of the vertices and planes whose boxes, enlarged by ``inflation``, overlap in a step, lexicographically.

    The enlarged half-space is where f ≤ inflation·Σ|n_k|, and the box of a vertex reaches as far beyond it, and by its
    radius more where there are any. So they overlap where f of the vertex is at most the sum of both, and f is least at
    one of both ends of the step. Float64 decides where f is beyond its error, and rational arithmetic elsewhere.
    """
    kept = MeshCache.of(mesh).parts
    if "planes" not in kept:
        kept["planes"] = scaled_planes(mesh), meets(mesh), excluded_keys(mesh)
    scaled, of_plane, excluded = kept["planes"]
    near_by_plane = []
    with np.errstate(over="ignore", under="ignore"):
        for k in range(len(mesh.planes)):
            tested = _in_world_of(mesh, k, vertices[of_plane[k, mesh.vertex_body[vertices]]])
            radius = box_radius[tested] if len(box_radius) else np.zeros(len(tested))
            is_near = np.zeros(len(tested), dtype=bool)
            for x in positions:
                p = _point_at(mesh, scaled, k, x)
                f, error, s = _values(x[tested], p, scaled, k)
                reach = np.minimum((2.0 * inflation + radius) * s * scaled.sum[k] * _UP, _FAR)
                error += _ABSOLUTE * (reach > 0.0)
                is_open = ~is_near & (np.abs(f - reach) <= error + _REACH * reach) & (error > 0.0)
                is_near |= f <= reach
                for row in is_open.nonzero()[0].tolist():
                    between = [a - b for a, b in zip(_exact(x[tested[row]]), _exact(p), strict=False)]
                    length = 2 * Fraction(inflation) + Fraction(float(radius[row]))
                    normal = _exact(mesh.planes.normals[k])
                    is_near[row] = sum(map(mul, between, normal)) <= length * sum(map(abs, normal))
            near_by_plane.append(tested[is_near].astype(np.int64) << 32 | k)
    near = np.concatenate(near_by_plane)
    if len(excluded):
        near = near[~np.isin(near, excluded)]
    near.sort()
    pairs = np.empty((len(near), 2), dtype=np.int32)
    pairs[:, 0], pairs[:, 1] = near >> 32, near & 0xFFFFFFFF
    return pairs


def vertices_in_half_spaces(mesh: "CollisionMesh", x: NDArray[np.float64]) -> NDArray[np.int32]:
    """Vertices of free bodies in half-spaces or on their planes, exactly, with the planes, in lexicographic order."""
    return plane_candidates(mesh, mesh._free_surface_vertices, [x], 0.0, np.zeros(0))


def _in_world_of(mesh: "CollisionMesh", k: int, vertices: NDArray[np.int32]) -> NDArray[np.int32]:
    """Those of the vertices that are in the world of plane k, where it moves and thus is in one."""
    point = mesh.planes.vertices[k]
    if point < 0 or mesh.num_worlds == 1:
        return vertices
    return vertices[mesh.vertex_world[vertices] == mesh.vertex_world[point]]


def _point_at(mesh: "CollisionMesh", planes: ScaledPlanes, k: int, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """A point of plane k, where vertices are at positions ``x``."""
    vertex = mesh.planes.vertices[k]
    point: NDArray[np.float64] = planes.point[k] if vertex < 0 else x[vertex]
    return point


def _values(
    x: NDArray[np.float64], p: NDArray[np.float64], planes: ScaledPlanes, k: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """(x - p)·n for scaled positions and plane k at p, the bounds of the errors, and the scales."""
    n = planes.normal[k]
    largest = np.maximum(np.abs(x).max(axis=1, initial=0.0), np.abs(p).max())
    s = np.where(largest > _LARGE, _SHRINK, np.where(largest < _SMALL, _GROW, 1.0))
    difference = s[:, None] * x - s[:, None] * p
    terms = n * difference
    error = _VALUE * np.abs(terms).sum(axis=1) + _ABSOLUTE + planes.lost[k] * np.abs(difference).sum(axis=1)
    is_exact = (s >= 1.0) & (planes.lost[k] == 0.0)
    error[is_exact & ((n == 0.0) | (difference == 0.0)).all(axis=1)] = 0.0
    return terms.sum(axis=1), error, s


def _exact(numbers: NDArray[np.float64]) -> list[Fraction]:
    return [Fraction(number) for number in numbers.tolist()]
