"""The bodies that objects of trimesh stand for: a mesh, a path or a point cloud is one, a scene one for each node."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._scene.half_space import HalfSpace
from ccd_warp._scene.input.arguments import shown
from ccd_warp._scene.input.names import distinct_names

if TYPE_CHECKING:
    from trimesh.parent import Geometry

# trimesh itself is loaded by who has such an object.
TrimeshObject: TypeAlias = "Geometry | HalfSpace"

_OBJECTS = "a trimesh.Trimesh, Path3D, PointCloud or Scene, or a HalfSpace"


@dataclass(frozen=True)
class TrimeshBody:
    """A body made from an object of trimesh.

    Attributes:
        name: Name of its node in a scene; None for an object outside a scene.
        arrays: Vertices, faces and, for a path, edges, as :meth:`ccd_warp.CollisionMesh.from_arrays` takes them; or a
            half-space.
        is_cloud: Whether it is a point cloud.
    """

    name: str | None
    arrays: tuple[ArrayLike, ...] | HalfSpace
    is_cloud: bool


def trimesh_bodies(objects: object) -> list[TrimeshBody]:
    """The bodies of one object, or of a list of objects.

    Raises:
        TypeError: If it is neither, or one of the list is no such object.
        ValueError: If a path is curved, or a scene is empty.
    """
    bodies: list[TrimeshBody] = []
    for index, item in enumerate(objects_of(objects, "bodies")):
        if _is_scene(item):
            bodies += _bodies_of_scene(item, index)
        elif isinstance(item, HalfSpace):
            bodies.append(TrimeshBody(None, item, False))
        else:
            bodies.append(TrimeshBody(None, *_arrays_of(item, f"body {index}")))
    if any(body.name for body in bodies):
        names = distinct_names([body.name for body in bodies])
        bodies = [TrimeshBody(name, body.arrays, body.is_cloud) for name, body in zip(names, bodies, strict=True)]
    return bodies


def check_single_body(name: str, body: object) -> None:
    """Check that an argument is an object of trimesh that is one body.

    Raises:
        TypeError: If it is none.
        ValueError: If it is several.
    """
    if not (_is_shape(body) or _is_scene(body)):
        raise TypeError(f"{name} is {shown(body)}; expected a trimesh.Trimesh, Path3D, PointCloud or Scene")
    num_bodies = len(trimesh_bodies(body))
    if num_bodies != 1:
        raise ValueError(f"{name} is {num_bodies} bodies; expected an object of trimesh that is one")


def objects_of(objects: object, name: str = "others") -> list[Any]:
    """One object, or the objects of a list, of an argument.

    Raises:
        TypeError: If it is neither.
    """
    if _is_shape(objects) or _is_scene(objects) or isinstance(objects, HalfSpace):
        return [objects]
    if not isinstance(objects, Iterable) or isinstance(objects, (str, bytes, bytearray, memoryview, Mapping)):
        raise TypeError(f"{name} is {shown(objects)}; expected {_OBJECTS}, or a list of these")
    try:
        return list(objects)
    except Exception as error:  # an array without dimensions, or whatever an iterator of the caller raises
        raise TypeError(f"{name} is {shown(objects)}; expected {_OBJECTS}, or a list of these") from error


def transformed(vertices: ArrayLike, matrix: ArrayLike) -> NDArray[np.float64]:
    """Positions under a homogeneous transformation; under the identity exactly the same.

    The comparison is exact, because trimesh's own flattening of a scene ignores a transformation close to the identity.
    """
    positions = np.array(vertices, dtype=np.float64)
    if np.array_equal(matrix, np.eye(4)):
        return positions
    matrix = np.asarray(matrix, dtype=np.float64)
    return positions @ matrix[:3, :3].T + matrix[:3, 3]


def _is_scene(value: object) -> bool:
    return not isinstance(value, type) and hasattr(value, "graph") and hasattr(value, "geometry")


def _is_shape(value: object) -> bool:
    return not isinstance(value, type) and hasattr(value, "vertices")


def _bodies_of_scene(scene: Any, index: int) -> list[TrimeshBody]:
    nodes = list(scene.graph.nodes_geometry)
    if not nodes:
        raise ValueError(f"body {index} is a Scene without geometry; expected one node or more with a mesh")
    bodies = []
    for node in nodes:
        matrix, geometry = scene.graph[node]
        (vertices, *others), is_cloud = _arrays_of(scene.geometry[geometry], f"node {shown(node)}")
        bodies.append(TrimeshBody(str(node), (transformed(vertices, matrix), *others), is_cloud))
    return bodies


def _arrays_of(shape: Any, label: str) -> tuple[tuple[ArrayLike, ...], bool]:
    """The arrays of a mesh, a path or a point cloud, and whether it is the last."""
    no_faces = np.zeros((0, 3), dtype=np.int64)
    if not _is_shape(shape):
        raise TypeError(f"{label} is a {type(shape).__name__}; expected {_OBJECTS}")
    if hasattr(shape, "faces"):
        return (shape.vertices, shape.faces), False
    if not hasattr(shape, "entities"):
        return (shape.vertices, no_faces), True
    for entity in shape.entities:
        # The polyline through the points of an arc or a spline does not follow the curve.
        if type(entity).__name__ != "Line":
            raise ValueError(f"{label} holds a {type(entity).__name__}; expected a path of straight lines")
    segments = [np.asarray(entity.nodes) for entity in shape.entities]
    edges = np.concatenate([np.zeros((0, 2), dtype=np.int64), *segments])
    if np.shape(shape.vertices)[1:] == (2,):
        return (shape.vertices, edges), False  # a path in the plane
    return (shape.vertices, no_faces, edges), False
