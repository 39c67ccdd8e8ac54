"""Small mesh files of every format, and what they hold in the eyes of readers that share no code with ours."""

import base64
import bz2
import gzip
import io
import itertools
import json
import struct
import tarfile
import tempfile
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
    for kind in ("ply", "stl", "stl_ascii", "obj", "glb"):
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


def _members(data: bytes) -> Iterator[tuple[str, bytes]]:
    """The members of a ZIP archive one after another, by what is written before each."""
    at = 0
    while data[at : at + 4] == b"PK\3\4":
        method, _, _, _, packed, _, name, extra = struct.unpack("<HHHIIIHH", data[at + 8 : at + 30])
        begin = at + 30 + name + extra
        content = data[begin : begin + packed]
        yield data[at + 30 : at + 30 + name].decode(), zlib.decompress(content, -15) if method else content
        at = begin + packed
