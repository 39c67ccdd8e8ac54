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

# Twelve vertices, so that a face may name a vertex of two digits, and the last index is one; one needs all 53 bits.
VERTICES = np.random.default_rng(7).uniform(-2.0, 2.0, (12, 3))
VERTICES[1:] = np.round(VERTICES[1:], 3)
FACES = np.array([[0, 1, 2], [2, 3, 4], [4, 5, 6], [6, 7, 8], [8, 9, 10], [9, 1, 10]])
_HEADER = "ply\nformat {} 1.0\ncomment a test\nelement vertex {}\nproperty double x\nproperty double y\n"
_HEADER += "property double z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n"


_DAE = (
    '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset/><library_geometries>'
    '<geometry id="g"><mesh><source id="s"><float_array id="a" count="{numbers}">{x}</float_array><technique_common>'
    '<accessor source="#a" count="{points}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>'
    '<param name="Z" type="float"/></accessor></technique_common></source><vertices id="v"><input semantic="POSITION" '
    'source="#s"/></vertices><polylist count="{faces}"><input semantic="VERTEX" source="#v" offset="0"/>'
    "<vcount>{sizes}</vcount><p>{corners}</p></polylist></mesh></geometry></library_geometries><library_visual_scenes>"
    "<visual_scene id='w'><node id='n'><instance_geometry url='#g'/></node></visual_scene></library_visual_scenes>"
    "<scene><instance_visual_scene url='#w'/></scene></COLLADA>"
)


_VTP = (
    '<VTKFile type="PolyData"><PolyData><Piece NumberOfPoints="{points}" NumberOfPolys="{faces}"><Points>'
    '<DataArray type="Float64" NumberOfComponents="3" format="ascii">{x}</DataArray></Points><Polys>'
    '<DataArray type="Int64" Name="connectivity" format="ascii">{corners}</DataArray>'
    '<DataArray type="Int64" Name="offsets" format="ascii">{ends}</DataArray></Polys></Piece></PolyData></VTKFile>'
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
        case "dae" | "vtp" as kind:
            corners = [corner for polygon in polygons for corner in polygon]
            words = {"x": rows, "sizes": counts, "corners": corners, "ends": np.cumsum(counts)}
            texts = {name: " ".join(map(str, values)) for name, values in words.items()}
            template = {"dae": _DAE, "vtp": _VTP}[kind]
            lines = [template.format(numbers=3 * len(rows), points=len(rows), faces=len(counts), **texts)]
        case kind:
            heads = {"ply": _HEADER.format("ascii", len(rows), len(lists)), "off": f"OFF\n{len(rows)} {len(lists)} 0"}
            lines = [heads[kind].rstrip(), *rows, *(f"{count} {row}" for count, row in zip(counts, lists, strict=True))]
    return "\n".join([*lines, ""])


_ITEM = '<DataItem DataType="{}" Precision="8" Dimensions="{}" Format="XML">{}</DataItem>'
XDMF = (  # of one triangle
    '<Xdmf Version="3.0"><Domain><Grid><Topology TopologyType="Triangle" NumberOfElements="1">'
    f'{_ITEM.format("Int", "1 3", "0 1 2")}</Topology><Geometry GeometryType="XYZ">'
    f"{_ITEM.format('Float', '3 3', '0 0 0 1 0 0 0 1 0')}</Geometry></Grid></Domain></Xdmf>"
)


def gltf_files(vertices=VERTICES, faces=FACES) -> tuple[dict, bytes]:
    """The tree of a glTF and its buffer, which lies in no file yet."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    files = trimesh.Scene(mesh).export(file_type="gltf", merge_buffers=True)
    tree, (buffer,) = json.loads(files.pop("model.gltf")), files.values()
    return tree, buffer


def exported(kind, vertices=VERTICES, faces=FACES) -> bytes:
    data = trimesh.Trimesh(vertices, faces, process=False).export(file_type=kind)
    return data.encode() if isinstance(data, str) else data


def of_extra(module):
    """A package of the extra `formats`; where it is not installed the test is skipped."""
    return pytest.importorskip(module, reason="the extra formats is not installed")


def _of_corners() -> bytes:
    """A file of COLLADA whose faces have normals of their own, for each of which a vertex is there again."""
    of_extra("collada")
    return exported("dae", VERTICES[FACES].reshape(-1, 3), np.arange(FACES.size).reshape(-1, 3))


def of_meshio(name, mesh=None, **options) -> bytes:
    """A file of cells as meshio writes it: a quadrilateral behind the triangles, and a field of vectors."""
    meshio = of_extra("meshio")
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
    return of_extra("meshio").Mesh(VERTICES, {"triangle": FACES})


def of_vtk(name, *how) -> bytes:
    """A file of the same as PolyData as VTK writes it: settings of its writer, called in turn."""
    pyvista = of_extra("pyvista")
    from vtkmodules import vtkIOLegacy, vtkIOXML

    mesh = pyvista.PolyData(VERTICES, faces=[*np.insert(FACES[:5], 0, 3, axis=1).ravel(), 4, 9, 1, 10, 0])
    mesh["u"] = VERTICES
    writer = {
        "vtp": vtkIOXML.vtkXMLPolyDataWriter,
        "vtu": vtkIOXML.vtkXMLUnstructuredGridWriter,
        "vtk": vtkIOLegacy.vtkPolyDataWriter,
    }[name.rpartition(".")[2]]()
    writer.SetInputData(mesh.cast_to_unstructured_grid() if name.endswith("vtu") else mesh)
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
    "scene.dae": _of_corners,
    "scene.3mf": lambda: of_extra("lxml") and exported("3mf"),
    "text_42.vtk": lambda: of_meshio("a.vtk", fmt_version="4.2", binary=False),
    "binary_42.vtk": lambda: of_meshio("a.vtk", fmt_version="4.2", binary=True),
    "text_51.vtk": lambda: of_meshio("a.vtk", fmt_version="5.1", binary=False),
    "binary_51.vtk": lambda: of_meshio("a.vtk", fmt_version="5.1", binary=True),
    "text.vtu": lambda: of_vtk("a.vtu", "SetDataModeToAscii"),
    "binary.vtu": lambda: of_meshio("a.vtu"),
    "text.vtp": lambda: of_vtk("a.vtp", "SetDataModeToAscii"),
    "binary.vtp": lambda: of_vtk("a.vtp", "SetDataModeToBinary", "SetCompressorTypeToNone"),
    "raw.vtp": lambda: of_vtk("a.vtp", "EncodeAppendedDataOff", "SetCompressorTypeToNone"),
    "packed.vtp": lambda: of_vtk("a.vtp", "EncodeAppendedDataOff", "SetCompressorTypeToLZ4"),
    "big_endian.vtp": lambda: of_vtk("a.vtp", "SetDataModeToBinary", "SetByteOrderToBigEndian"),
    "raw_big_endian.vtp": lambda: of_vtk("a.vtp", "EncodeAppendedDataOff", "SetByteOrderToBigEndian"),
    "big_endian.vtu": lambda: of_vtk("a.vtu", "SetDataModeToBinary", "SetByteOrderToBigEndian"),
    "binary_of_polygons.vtk": lambda: of_vtk("a.vtk", "SetFileTypeToBinary"),
    "text.xdmf": lambda: of_meshio("a.xdmf", data_format="XML"),
    "text_22.msh": lambda: of_meshio("a.msh", of_triangles(), fmt_version="2.2", binary=False),
    "binary_22.msh": lambda: of_meshio("a.msh", fmt_version="2.2"),
    "text_40.msh": lambda: of_meshio("a.msh", of_triangles(), fmt_version="4.0", binary=False),
    "binary_40.msh": lambda: of_meshio("a.msh", fmt_version="4.0"),
    "text_41.msh": lambda: of_meshio("a.msh", of_triangles(), binary=False),
    "binary_41.msh": lambda: of_meshio("a.msh", of_triangles()),
    "text.mesh": lambda: of_meshio("a.mesh"),
    "text.inp": lambda: of_meshio("a.inp"),
    # Decimals with all digits in files that say that they hold single precision.
    "float_42.vtk": lambda: whole("text_42.vtk").replace(b"double", b"float", 1),
    "float.vtp": lambda: whole("text.vtp").replace(b"Float64", b"Float32"),
    "float.mesh": lambda: whole("text.mesh").replace(b"Formatted 2", b"Formatted 1"),
}


# What `test_drawn_files` reads in full, and one that is to be damaged by hand.
_FURTHER = {
    **{
        name: lambda name=name: polygon_file(name, VERTICES, FACES.tolist()).encode()
        for name in ("text.ply", "text.obj")
    },
    "one.xdmf": lambda: of_extra("meshio") and XDMF.encode(),
}


@cache
def whole(name) -> bytes:
    """The mesh in the format that a name says."""
    return (WHOLE | _FURTHER)[name]()


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
