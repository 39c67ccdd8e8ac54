"""Read the polygons of COLLADA files by pycollada, as many as they say they hold."""

import io
import xml.etree.ElementTree as ET

import numpy as np

from ccd_warp._files.content import FilePart
from ccd_warp._files.opened import not_installed
from ccd_warp._files.text import CUT
from ccd_warp._scene.input.messages import InputError
from ccd_warp._scene.input.trimesh_bodies import transformed


def read_dae(data: bytes) -> list[FilePart]:
    """Every geometry of the scene where its node places it, called by its identifier.

    Raises:
        InputError: If the file is cut, or holds what is not read.
    """
    try:
        import collada
    except ImportError as error:
        raise not_installed(error.name) from error
    from trimesh.util import unique_name

    stated = _stated_triangles(ET.fromstring(data))
    # What is broken and is no geometry is passed over, and what is missing of that is seen by the count.
    scene = collada.Collada(io.BytesIO(data), ignore=[collada.common.DaeError]).scene
    parts: list[FilePart] = []
    names: dict[str, None] = {}
    for bound in scene.objects("geometry") if scene is not None else ():
        names[name := unique_name(bound.original.id, names)] = None
        for primitive in bound.original.primitives:
            counts = None
            if isinstance(primitive, collada.polylist.Polylist):
                counts, primitive = np.asarray(primitive.vcounts, dtype=np.int64), primitive.triangleset()
            if isinstance(primitive, collada.triangleset.TriangleSet) and primitive.vertex is not None:
                used, first, corners = np.unique(primitive.vertex_index, return_index=True, return_inverse=True)
                order = np.argsort(first)  # by appearance
                vertices = transformed(primitive.vertex[used[order]], bound.matrix)
                parts.append(FilePart(vertices, np.argsort(order)[corners.reshape(-1, 3)], counts, names=[name]))
    if not stated <= (num_read := sum(len(part.faces) for part in parts)):
        raise InputError(f"says that it has {stated} triangles, and {num_read} of its scene can be read; {CUT}")
    return parts


def _stated_triangles(root: ET.Element) -> int:
    """The triangles of the scene: of each geometry as often as it stands there."""
    geometries: dict[str, int] = {}
    for geometry in root.iterfind(".//{*}geometry"):
        for array in geometry.iterfind(".//{*}float_array"):  # of which three numbers less are a vertex less
            if len((array.text or "").split()) != int(array.attrib["count"]):
                raise InputError(f"the array {array.get('id')!r} does not hold {array.get('count')} values; {CUT}")
        geometries[geometry.get("id", "")] = sum(map(_of_primitives, geometry.iter()))
    if root.find(".//{*}instance_controller") is not None:
        raise InputError("has a mesh that a controller moves, which is not read; export it without")
    instances = root.iterfind(".//{*}instance_geometry")  # a node that is used again has more
    return sum(geometries[instance.get("url", "").removeprefix("#")] for instance in instances)


def _of_primitives(element: ET.Element) -> int:
    kind, count = element.tag.rpartition("}")[2], int(element.get("count", "0"))
    stride = 1 + max((int(part.get("offset", "0")) for part in element), default=0)
    match kind:
        case "triangles":
            return count
        case "polylist":
            corners = [int(word) for part in element.iterfind("{*}vcount") for word in (part.text or "").split()]
        case "polygons":
            corners = [len((part.text or "").split()) // stride for part in element.iterfind("{*}p")]
        case "trifans" | "tristrips":
            raise InputError(f"holds {kind}, which are not read; export triangles")
        case _:
            return 0
    if len(corners) != count or min(corners, default=3) < 3:
        raise InputError(f"{kind} of {len(corners)} faces, of 3 corners or more, say that they are {count}; {CUT}")
    return sum(corners) - 2 * count
