"""One mesh in a file of every format that is read, and what the library takes from any file."""

import base64
import json
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd

# Twelve vertices, so that a face may name a vertex of two digits, and the last index is one.
VERTICES = np.round(np.random.default_rng(7).uniform(-2.0, 2.0, (12, 3)), 3)
FACES = np.array([[0, 1, 2], [2, 3, 4], [4, 5, 6], [6, 7, 8], [8, 9, 10], [9, 1, 10]])
_HEADER = "ply\nformat {} 1.0\ncomment a test\nelement vertex {}\nproperty double x\nproperty double y\n"
_HEADER += "property double z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n"


_DAE = (
    '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset/><library_geometries>'
    '<geometry id="g"><mesh><source id="s"><float_array id="a" count="{}">{}</float_array><technique_common>'
    '<accessor source="#a" count="{}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>'
    '<param name="Z" type="float"/></accessor></technique_common></source><vertices id="v"><input semantic="POSITION" '
    'source="#s"/></vertices><polylist count="{}"><input semantic="VERTEX" source="#v" offset="0"/><vcount>{}</vcount>'
    "<p>{}</p></polylist></mesh></geometry></library_geometries><library_visual_scenes><visual_scene id='w'>"
    "<node id='n'><instance_geometry url='#g'/></node></visual_scene></library_visual_scenes>"
    "<scene><instance_visual_scene url='#w'/></scene></COLLADA>"
)


def ply(vertices=VERTICES, faces=FACES, order="<") -> bytes:
    """A binary PLY file in double precision."""
    rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", f"{order}i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = _HEADER.format(name, len(vertices), len(faces))
    return header.encode() + np.asarray(vertices).astype(f"{order}f8").tobytes() + rows.tobytes()


def polygon_file(name, vertices, polygons) -> str:
    """A text file of polygons."""
    rows = [" ".join(map(repr, row)) for row in np.asarray(vertices).tolist()]
    lists = [" ".join(map(str, polygon)) for polygon in polygons]
    counts = [len(polygon) for polygon in polygons]
    match name.rpartition(".")[2]:
        case "obj":
            lines = [f"v {row}" for row in rows] + [" ".join(["f", *(str(k + 1) for k in face)]) for face in polygons]
        case "dae":
            corners = [str(corner) for polygon in polygons for corner in polygon]
            texts = " ".join(rows), " ".join(map(str, counts)), " ".join(corners)
            lines = [_DAE.format(3 * len(rows), texts[0], len(rows), len(counts), *texts[1:])]
        case kind:
            head = (
                _HEADER.format("ascii", len(rows), len(lists))
                if kind == "ply"
                else f"OFF\n{len(rows)} {len(lists)} 0\n"
            )
            lines = [head.rstrip(), *rows, *(f"{count} {row}" for count, row in zip(counts, lists, strict=True))]
    return "\n".join([*lines, ""])


PLY = polygon_file("a.ply", VERTICES, FACES.tolist())


def gltf_files(vertices=VERTICES, faces=FACES) -> tuple[dict, bytes]:
    """The tree of a glTF and its buffer, which lies in no file yet."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    files = trimesh.Scene(mesh).export(file_type="gltf", merge_buffers=True)
    tree, (buffer,) = json.loads(files.pop("model.gltf")), files.values()
    return tree, buffer


def exported(kind, vertices=VERTICES, faces=FACES) -> bytes:
    data = trimesh.Trimesh(vertices, faces, process=False).export(file_type=kind)
    return data.encode() if isinstance(data, str) else data


def of_extra(module, kind) -> bytes:
    """A file of a format for which trimesh needs another package."""
    pytest.importorskip(module)
    return exported(kind)


def of_meshio(name, mesh=None, **options) -> bytes:
    """A file of cells as meshio writes it: a quadrilateral behind the triangles, and a field of vectors."""
    meshio = pytest.importorskip("meshio", reason="the extra formats is not installed")
    mesh = mesh or meshio.Mesh(VERTICES, [("triangle", FACES[:5]), ("quad", [[9, 1, 10, 0]])], {"u": VERTICES})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        if path.suffix in (".vtk", ".msh"):
            {".vtk": meshio.vtk, ".msh": meshio.gmsh}[path.suffix].write(path, mesh, **options)
        else:
            mesh.write(path, **options)
        return path.read_bytes()


def of_triangles():
    """The triangles alone, as meshio holds them."""
    return pytest.importorskip("meshio", reason="the extra formats is not installed").Mesh(
        VERTICES, {"triangle": FACES}
    )


def of_vtk(name, *how) -> bytes:
    """A file of the same as PolyData as VTK writes it: settings of its writer, called in turn."""
    pyvista = pytest.importorskip("pyvista", reason="the extra formats is not installed")
    from vtkmodules import vtkIOLegacy, vtkIOXML

    mesh = pyvista.PolyData(VERTICES, faces=[*np.insert(FACES[:5], 0, 3, axis=1).ravel(), 4, 9, 1, 10, 0])
    mesh["u"] = VERTICES
    writer = vtkIOXML.vtkXMLPolyDataWriter() if name.endswith("vtp") else vtkIOLegacy.vtkPolyDataWriter()
    writer.SetInputData(mesh)
    with tempfile.TemporaryDirectory() as folder:
        writer.SetFileName(f"{folder}/{name}")
        for setting in how:
            getattr(writer, setting)()
        writer.Write()
        return Path(folder, name).read_bytes()


def _gltf() -> bytes:
    """A glTF that holds its buffer."""
    tree, buffer = gltf_files()
    tree["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(buffer).decode()
    return json.dumps(tree).encode()


WHOLE = {
    "scene.glb": lambda: exported("glb"),
    "scene.gltf": _gltf,
    "scene.dae": lambda: of_extra("collada", "dae"),
    "scene.3mf": lambda: of_extra("lxml", "3mf"),
    "text_42.vtk": lambda: of_meshio("a.vtk", fmt_version="4.2", binary=False),
    "binary_42.vtk": lambda: of_meshio("a.vtk", fmt_version="4.2", binary=True),
    "text_51.vtk": lambda: of_meshio("a.vtk", fmt_version="5.1", binary=False),
    "binary_51.vtk": lambda: of_meshio("a.vtk", fmt_version="5.1", binary=True),
    "text.vtu": lambda: of_meshio("a.vtu", binary=False),
    "binary.vtu": lambda: of_meshio("a.vtu"),
    "text.vtp": lambda: of_vtk("a.vtp", "SetDataModeToAscii"),
    "binary.vtp": lambda: of_vtk("a.vtp", "SetDataModeToBinary", "SetCompressorTypeToNone"),
    "raw.vtp": lambda: of_vtk("a.vtp", "EncodeAppendedDataOff", "SetCompressorTypeToNone"),
    "packed.vtp": lambda: of_vtk("a.vtp", "EncodeAppendedDataOff", "SetCompressorTypeToLZ4"),
    "binary_of_polygons.vtk": lambda: of_vtk("a.vtk", "SetFileTypeToBinary"),
    "text.xdmf": lambda: of_meshio("a.xdmf", data_format="XML"),
    "text_22.msh": lambda: of_meshio("a.msh", of_triangles(), fmt_version="2.2", binary=False),
    "binary_22.msh": lambda: of_meshio("a.msh", fmt_version="2.2"),
    "text_41.msh": lambda: of_meshio("a.msh", of_triangles(), binary=False),
    "binary_41.msh": lambda: of_meshio("a.msh", of_triangles()),
    "text.mesh": lambda: of_meshio("a.mesh"),
    "text.inp": lambda: of_meshio("a.inp"),
}


@cache
def whole(name) -> bytes:
    """The mesh in the format that a name says."""
    return WHOLE[name]()


def content(path) -> tuple[np.ndarray, np.ndarray]:
    """Positions and faces of any file of a mesh or of a sequence."""
    if path.suffix in (".pvd", ".vtk", ".vtp", ".vtu"):
        is_whole = path.suffix == ".pvd"
        sequence = ccd.read_sequence(path if is_whole else [path] * 2, displacement=None if is_whole else "u")
        return np.array([*sequence]), sequence.mesh.faces
    frames = ccd.read_frames(path, path)
    return frames.vertices_t0, frames.mesh.faces


def read(path, data):
    """What the library takes from a file with this content; None where it refuses it, in a line that names it."""
    path.write_bytes(data)
    try:
        return content(path)
    except ValueError as error:
        message = str(error)
        assert str(path) in message and message.isprintable() and len(message) < 500
        return None


def same(found, expected) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(found, expected, strict=True))
