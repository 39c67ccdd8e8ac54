"""Small mesh files of every format, and what they hold in the eyes of readers that share no code with ours."""

import base64
import bz2
import contextlib
import gzip
import io
import itertools
import json
import struct
import tarfile
import tempfile
import xml.etree.ElementTree as ET
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import meshio
import numpy as np
import trimesh
import vtk
from vtk.util.numpy_support import vtk_to_numpy

VERTICES = np.round(np.random.default_rng(7).uniform(-2.0, 2.0, (12, 3)), 3)
FACES = np.array([[0, 1, 2], [2, 3, 4], [4, 5, 6], [6, 7, 8], [8, 9, 10], [9, 1, 11]])
Files = dict[str, bytes]  # the first is the one that is read; the others lie beside it


def whole_files() -> dict[str, Files]:
    """A small mesh in every format, and in every way in which it stores numbers."""
    rows = [" ".join(map(str, row)) for row in VERTICES.tolist()]
    faces = ["3 " + " ".join(map(str, face)) for face in FACES.tolist()]
    head = "ply\nformat ascii 1.0\nelement vertex 12\nproperty double x\nproperty double y\nproperty double z\n"
    ply = "\n".join([head + "element face 6\nproperty list uchar int vertex_indices\nend_header", *rows, *faces, ""])
    off = "\n".join(["OFF", "12 6 0", *rows, *faces, ""])
    found: dict[str, Files] = {"ascii.ply": {"a.ply": ply.encode()}, "text.off": {"a.off": off.encode()}}
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    for kind in ("ply", "stl", "stl_ascii", "obj", "glb", "3mf", "dae"):  # the last two need lxml and pycollada
        data = mesh.export(file_type=kind)
        found[f"binary.{kind}"] = {f"a.{kind[:3]}": data.encode() if isinstance(data, str) else data}
    gltf = trimesh.Scene(mesh).export(file_type="gltf", merge_buffers=True)
    found["gltf"] = {"model.gltf": gltf.pop("model.gltf"), **gltf}
    tree = json.loads(found["gltf"]["model.gltf"])
    tree["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(*gltf.values()).decode()
    found["base64.gltf"] = {"a.gltf": json.dumps(tree).encode()}
    with tempfile.TemporaryDirectory() as folder:
        found |= _files_of_cells(Path(folder))
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as tar:
        member = tarfile.TarInfo("one.ply")
        member.size = len(ply)
        tar.addfile(member, io.BytesIO(ply.encode()))
    found["tar.gz"] = {"a.tar.gz": gzip.compress(buffer.getvalue(), mtime=0)}
    found["bz2"] = {"a.ply.bz2": bz2.compress(ply.encode())}
    for kind, method, save in (("stored", zipfile.ZIP_STORED, np.savez), ("packed", 8, np.savez_compressed)):
        packed, arrays = io.BytesIO(), io.BytesIO()
        with zipfile.ZipFile(packed, "w", method) as archive:
            for name, text in (("one.ply", ply), ("two.off", off)):
                archive.writestr(zipfile.ZipInfo(name), text, method)
        save(arrays, positions=np.stack([VERTICES, VERTICES + 1.0]), faces=FACES)
        found[f"{kind}.zip"], found[f"{kind}.npz"] = {"a.zip": packed.getvalue()}, {"a.npz": arrays.getvalue()}
    return found


def _files_of_cells(folder: Path) -> dict[str, Files]:
    found: dict[str, Files] = {}

    def keep(kind: str, *names: str) -> None:
        found[kind] = {name: (folder / name).read_bytes() for name in names}

    mesh = meshio.Mesh(VERTICES, [("triangle", FACES)])
    for how in ("XML", "HDF"):
        with contextlib.chdir(folder), meshio.xdmf.TimeSeriesWriter("series.xdmf", data_format=how) as writer:
            writer.write_points_cells(VERTICES, [("triangle", FACES)])
            for k in range(2):
                writer.write_data(k, point_data={"u": VERTICES * k})
        keep(f"series.{how}.xdmf", "series.xdmf", *(["series.h5"] if how == "HDF" else []))
    mixed = meshio.Mesh(VERTICES, [("triangle", FACES[:4]), ("quad", [[0, 5, 8, 11]])])
    for how in ("XML", "HDF"):
        for kind, cells in (("", mesh), ("mixed.", mixed)):
            cells.write(folder / "a.xdmf", data_format=how)
            keep(f"{kind}{how}.xdmf", "a.xdmf", *(["a.h5"] if how == "HDF" else []))
    for version, binary in itertools.product(("4.2", "5.1"), (False, True)):
        meshio.vtk.write(folder / "a.vtk", mixed if binary else mesh, fmt_version=version, binary=binary)
        keep(f"{'binary' if binary else 'ascii'}{version}.vtk", "a.vtk")
    grid = vtk.vtkUnstructuredGridReader(file_name=str(folder / "a.vtk"))
    for kind, mode, pack, encode in (
        *(("ascii", 0, None, 0), ("base64", 1, None, 0), ("zlib", 1, vtk.vtkZLibDataCompressor(), 0)),
        *(("raw", 2, None, 0), ("appended", 2, None, 1), ("both", 2, vtk.vtkZLibDataCompressor(), 1)),
    ):
        writer = vtk.vtkXMLUnstructuredGridWriter(file_name=str(folder / "a.vtu"), data_mode=mode, compressor=pack)
        writer.SetInputConnection(grid.GetOutputPort())
        writer.SetEncodeAppendedData(encode)
        writer.Write()
        keep(f"{kind}.vtu", "a.vtu")
    pieces = "".join(f'<DataSet timestep="{k}" file="{name}"/>' for k, name in enumerate(("a.vtu", "b.vtu")))
    collection = f'<VTKFile type="Collection" version="0.1"><Collection>{pieces}</Collection></VTKFile>'
    one, two = (found[f"{kind}.vtu"]["a.vtu"] for kind in ("ascii", "base64"))
    found["pvd"] = {"a.pvd": collection.encode(), "a.vtu": one, "b.vtu": two}
    return found


def judged(path: Path) -> np.ndarray:
    """The corners of all triangles of a file, [n, 3, 3]; raises anything where it refuses the file."""
    suffix = path.suffix
    if suffix == ".npz":
        with np.load(path) as arrays:
            return arrays["positions"][:, arrays["faces"]].reshape(-1, 3, 3)
    if suffix in (".gz", ".bz2"):
        data = (gzip if suffix == ".gz" else bz2).decompress(path.read_bytes())
        inner = path.with_name("inner.ply")
        inner.write_bytes(data[512 : 512 + int(data[124:135], 8)] if suffix == ".gz" else data)
        return judged(inner)
    if suffix == ".zip":
        parts = []
        for name, data in _members(path.read_bytes()):
            inner = path.with_name(name)
            inner.write_bytes(data)
            parts.append(judged(inner))
        return np.concatenate(parts)
    if suffix == ".pvd":
        entries = ET.parse(path).getroot().findall("Collection/DataSet")
        entries.sort(key=lambda entry: float(entry.attrib["timestep"]))
        return np.concatenate([judged(path.with_name(entry.attrib["file"])) for entry in entries])
    if suffix in (".3mf", ".dae"):
        return _judged_3mf(path) if suffix == ".3mf" else _judged_dae(path)
    if path.name == "series.xdmf":
        with meshio.xdmf.TimeSeriesReader(path) as reader:
            points, cells = reader.read_points_cells()
            fields = [reader.read_data(k)[1]["u"] for k in range(reader.num_steps)]
        return np.concatenate([(points + u)[b.data].reshape(-1, 3, 3) for u in fields for b in cells])
    if suffix == ".xdmf":
        mesh = meshio.read(path)
        corners = {"triangle": [[0, 1, 2]], "quad": [[0, 1, 2], [0, 2, 3]]}
        return np.concatenate([mesh.points[b.data[:, corners[b.type]]].reshape(-1, 3, 3) for b in mesh.cells])
    readers = {".ply": vtk.vtkPLYReader, ".obj": vtk.vtkOBJReader, ".off": vtk.vtkOFFReader, ".stl": vtk.vtkSTLReader}
    readers |= {".vtk": vtk.vtkUnstructuredGridReader, ".vtu": vtk.vtkXMLUnstructuredGridReader}
    readers |= {".glb": vtk.vtkGLTFReader, ".gltf": vtk.vtkGLTFReader}
    reader = readers[suffix]()
    reader.SetFileName(str(path))
    errors: list[str] = []
    for source in (reader, reader.GetExecutive()):
        source.AddObserver("ErrorEvent", lambda *_: errors.append("vtk"))
    if suffix == ".stl":
        reader.MergingOff()
    reader.Update()
    output = reader.GetOutputDataObject(0)
    surface = output
    if suffix in (".glb", ".gltf"):
        joined = vtk.vtkCompositeDataGeometryFilter(input_data_object=output)
        joined.Update()
        surface = joined.GetOutput()
    if errors:
        raise ValueError(errors[0])
    cells = surface.GetPolys() if surface.IsA("vtkPolyData") else surface.GetCells()
    offsets, corners = vtk_to_numpy(cells.GetOffsetsArray()), vtk_to_numpy(cells.GetConnectivityArray())
    points = vtk_to_numpy(surface.GetPoints().GetData())
    polygons = [corners[a:b] for a, b in itertools.pairwise(offsets.tolist())]
    fans = [polygon[[0, k, k + 1]] for polygon in polygons for k in range(1, len(polygon) - 1)]
    return points[np.array(fans)]


def _judged_3mf(path: Path) -> np.ndarray:
    """The objects of a 3MF that its build names, with their transformations."""
    model = next(data for name, data in _members(path.read_bytes()) if name == "3D/3dmodel.model")
    core = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
    root, corners = ET.fromstring(model), []
    objects = {entry.attrib["id"]: entry for entry in root.iter(f"{core}object")}
    for item in root.findall(f"{core}build/{core}item"):
        entry = objects[item.attrib["objectid"]]
        points = [[float(vertex.attrib[axis]) for axis in "xyz"] for vertex in entry.iter(f"{core}vertex")]
        faces = [[int(face.attrib[k]) for k in ("v1", "v2", "v3")] for face in entry.iter(f"{core}triangle")]
        matrix = np.array((item.attrib.get("transform") or "1 0 0 0 1 0 0 0 1 0 0 0").split(), float).reshape(4, 3)
        if np.min(faces) < 0:
            raise ValueError("a vertex has a negative number")
        corners.append((np.array(points) @ matrix[:3] + matrix[3])[np.array(faces)])
    return np.concatenate(corners)


def _judged_dae(path: Path) -> np.ndarray:
    """The triangles of a COLLADA file of one geometry in one node."""
    name = "{http://www.collada.org/2005/11/COLLADASchema}"
    root = ET.parse(path).getroot()
    sources = {entry.attrib["id"]: entry for entry in root.iter() if "id" in entry.attrib}
    (mesh,) = root.iter(f"{name}mesh")
    (node,) = root.findall(f".//{name}visual_scene/{name}node")
    (used,) = node.findall(f"{name}instance_geometry")
    if sources[used.attrib["url"][1:]].find(f"{name}mesh") is not mesh:
        raise ValueError("the node shows another geometry")
    triangles = mesh.find(f"{name}triangles")
    inputs = triangles.findall(f"{name}input")
    vertex = next(entry for entry in inputs if entry.attrib["semantic"] == "VERTEX")
    vertices = sources[vertex.attrib["source"][1:]]
    position = next(entry for entry in vertices if entry.attrib["semantic"] == "POSITION")
    source = sources[position.attrib["source"][1:]]
    points = np.array(source.find(f"{name}float_array").text.split(), float)
    if len(points) != int(source.find(f"{name}float_array").attrib["count"]):
        raise ValueError("another count of numbers")
    indices = np.array(triangles.find(f"{name}p").text.split(), int)
    stride = 1 + max(int(entry.attrib["offset"]) for entry in inputs)
    corners = indices.reshape(int(triangles.attrib["count"]), 3, stride)[:, :, int(vertex.attrib["offset"])]
    if corners.min() < 0:
        raise ValueError("a vertex has a negative number")
    matrix = node.find(f"{name}matrix")
    transform = np.eye(4) if matrix is None else np.array(matrix.text.split(), float).reshape(4, 4)
    return (points.reshape(-1, 3) @ transform[:3, :3].T + transform[:3, 3])[corners]


def _members(data: bytes) -> Iterator[tuple[str, bytes]]:
    """The members of a ZIP archive one after another, by what is written before each."""
    at = 0
    while data[at : at + 4] == b"PK\3\4":
        method, _, _, _, packed, _, name, extra = struct.unpack("<HHHIIIHH", data[at + 8 : at + 30])
        begin = at + 30 + name + extra
        content = data[begin : begin + packed]
        yield data[at + 30 : at + 30 + name].decode(), zlib.decompress(content, -15) if method else content
        at = begin + packed
