"""VTK, VTU and XDMF files, damaged in what says how many cells there are and of which corners."""

import re
import zlib

import numpy as np
import pytest

import ccd_warp as ccd
from ccd_warp._files.archive import MAX_BYTES
from ccd_warp._files.mesh import read_mesh
from ccd_warp._input.messages import InputError

meshio = pytest.importorskip("meshio", reason="the extra examples is not installed")

POINTS = np.random.default_rng(5).uniform(size=(7, 3))
TRIANGLES, QUADS = np.array([[0, 1, 2], [2, 3, 4], [4, 5, 6]]), np.array([[0, 2, 4, 6]])
FACES = [*TRIANGLES.tolist(), [0, 2, 4], [0, 4, 6]]
MESH = meshio.Mesh(POINTS, [("triangle", TRIANGLES), ("quad", QUADS)], {"u": POINTS})


def _written(path, **options):
    if path.suffix == ".vtk":
        meshio.vtk.write(path, MESH, **options)
    else:
        MESH.write(path, **options)
    return path.read_bytes()


def _read(path, data):
    path.write_bytes(data)
    return read_mesh(path, MAX_BYTES).faces.tolist()


def _refused(path, data, message):
    path.write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        read_mesh(path, MAX_BYTES)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize("is_binary", [False, True])
@pytest.mark.parametrize("version", ["4.2", "5.1"])
def test_legacy_vtk_cut_at_any_byte_is_refused_or_the_whole(tmp_path, version, is_binary):
    path = tmp_path / "a.vtk"
    data = _written(path, fmt_version=version, binary=is_binary)
    assert _read(path, data) == FACES
    for length in range(len(data)):
        try:
            assert _read(path, data[:length]) == FACES
            assert np.array_equal(read_mesh(path, MAX_BYTES).vertices, POINTS)
        except InputError:
            pass


def test_row_of_three_corners_that_says_one_is_refused(tmp_path):
    data = _written(tmp_path / "a.vtk", fmt_version="4.2", binary=False)
    assert data.count(b"\n3\n2\n3\n4\n") == 1
    _refused(
        tmp_path / "a.vtk", data.replace(b"\n3\n2\n3\n4\n", b"\n1\n2\n3\n4\n"), "corners of its 4 cells do not take"
    )
    # What follows is a row, too: the numbers add up, and the corners are not those of the types.
    _refused(tmp_path / "a.vtk", data.replace(b"\n3\n0\n1\n2\n3\n", b"\n4\n0\n1\n2\n2\n"), "cell 0 is a triangle of 4")


def test_damaged_offset_of_a_cell_is_refused(tmp_path):
    data = _written(tmp_path / "a.vtk", fmt_version="5.1", binary=False)
    damaged = re.sub(rb"\n6\s+9\s+13\b", b"\n5 9 13", data)
    _refused(tmp_path / "a.vtk", damaged, "cell 1 is a triangle of 2 corners; expected 3")
    path = tmp_path / "a.vtu"
    data = _written(path, binary=False)
    assert _read(path, data) == FACES
    _refused(path, re.sub(rb"\b6\s+9\s+13\b", b"5 9 13", data), "cell 1 is a triangle of 2 corners; expected 3")


@pytest.mark.parametrize("is_appended", [False, True])
def test_base64_with_foreign_characters_is_refused(tmp_path, is_appended):
    """Left out, they would shift what follows; of appended data the next array then fills the gap."""
    path = tmp_path / "a.vtu"
    meshio.vtu.write(path, MESH, binary=True, compression=None)
    data = path.read_bytes()
    if is_appended:
        parts = re.findall(rb'format="binary"[^>]*>([^<]*)<', data)
        offsets = np.cumsum([0] + [len(part.strip()) for part in parts[:-1]]).tolist()
        for offset in offsets:
            inline = rb'format="binary"([^>]*)>[^<]*<'
            data = re.sub(inline, b'format="appended" offset="%d"\\1><' % offset, data, count=1)
        body = b'<AppendedData encoding="base64">_' + b"".join(part.strip() for part in parts) + b"</AppendedData>"
        data = data.replace(b"</VTKFile>", body + b"</VTKFile>")
    assert _read(path, data) == FACES
    at = data.index(b"_" if is_appended else b">", data.index(b"AppendedData" if is_appended else b"DataArray")) + 60
    _refused(path, data[:at] + b"!" * 32 + data[at + 32 :], "cannot be read")


def test_attribute_of_the_whole_file_that_is_not_known_is_refused(tmp_path):
    """As a damaged header_type, of which a default of half the size would be taken."""
    data = _written(tmp_path / "a.vtu").replace(b"<VTKFile", b'<VTKFile headez_type="UInt64"')
    _refused(tmp_path / "a.vtu", data, "is no VTKFile .* header_type")


def test_all_pieces_are_read(tmp_path):
    data = _written(tmp_path / "a.vtu", binary=False)
    piece = re.search(rb"<Piece.*</Piece>", data, re.DOTALL)[0]
    moved = [[corner + 7 for corner in face] for face in FACES]
    assert _read(tmp_path / "a.vtu", data.replace(piece, 2 * piece)) == FACES + moved
    beyond = re.sub(rb"\b0\s+1\s+2\b", b"0 7 2", piece, count=1)
    _refused(tmp_path / "a.vtu", data.replace(piece, beyond + piece), "its piece of 7 vertices lacks")


_XDMF = (
    '<Xdmf Version="3.0"><Domain><Grid><Topology TopologyType="Triangle" NumberOfElements="3"><DataItem DataType="Int" '
    'Precision="8" Dimensions="3 3" Format="Binary">cells.bin</DataItem></Topology><Geometry GeometryType="XYZ">'
    '<DataItem DataType="Float" Precision="8" Dimensions="7 3" Format="Binary">points.bin</DataItem></Geometry></Grid>'
    "</Domain></Xdmf>"
)


def test_damaged_type_of_cells_in_xdmf_is_refused(tmp_path, monkeypatch):
    """Integers taken for reals are nearly zero, and would be the corners 0, 0, 0 of every face."""
    path = tmp_path / "a.xdmf"
    TRIANGLES.astype("<i8").tofile(tmp_path / "cells.bin")
    POINTS.tofile(tmp_path / "points.bin")
    monkeypatch.chdir(tmp_path)
    assert _read(path, _XDMF.encode()) == TRIANGLES.tolist()
    assert np.array_equal(read_mesh(path, MAX_BYTES).vertices, POINTS)
    for old, new, message in (
        ('DataType="Int"', 'DataType="Float"', "are Float of shape .*; expected integers"),
        ('DataType="Int"', 'DataType="Ynt"', "cannot be read"),
        ('DataType="Int"', 'DataTyqe="Int"', "attributes that are not read: DataTyqe"),
        ('Precision="8" Dimensions="3 3"', 'Precision="4" Dimensions="3 3"', "are 18 numbers of int32; expected 9"),
        ('Precision="8" Dimensions="3 3"', 'Precision="b" Dimensions="3 3"', "have the precision 'b'; expected 1, 2"),
        ('NumberOfElements="3"', 'NumberOfElements="2"', "holds 3 cells, and says that it has 2"),
        ("Triangle", "Quadrilateral", r"cells of the type Quadrilateral in the shape \(3, 3\)"),
    ):
        _refused(path, _XDMF.replace(old, new).encode(), message)


def test_hdf5_of_another_shape_or_elsewhere_is_refused(tmp_path, monkeypatch):
    h5py = pytest.importorskip("h5py", reason="the extra formats is not installed")
    path = tmp_path / "a.xdmf"
    monkeypatch.chdir(tmp_path)
    data = _written(path, data_format="HDF")
    assert _read(path, data) == FACES
    _refused(path, data.replace(b'Dimensions="7 3"', b'Dimensions="3 7"'), "no dataset of shape")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["data9"] = h5py.ExternalLink("other.h5", "data0")
        bomb = file.create_dataset("bomb", (7, 3), "f8", chunks=(7, 3), compression="gzip")
        bomb.id.write_direct_chunk((0, 0), zlib.compress(bytes(1 << 22)))
        file.create_dataset("huge", (1 << 27, 3), "f8", chunks=(1 << 10, 3))  # 3 GiB of which nothing is stored
    name = re.search(rb"a\.h5:/(\w+)", data)[1]
    _refused(path, data.replace(b"/" + name, b"/data9"), "as a link alone")
    _refused(path, data.replace(b"/" + name, b"/bomb"), "a chunk that unpacks to more than its 168 bytes")
    huge = data.replace(b"/" + name, b"/huge").replace(b'Dimensions="7 3"', b'Dimensions="%d 3"' % (1 << 27))
    _refused(path, huge, "has 3,221,225,472 bytes, and the limit is")


@pytest.mark.parametrize("suffix", ["vtu", "vtk", "xdmf"])
@pytest.mark.parametrize("kind", ["triangle6", "quad8", "tetra10", "hexahedron20"])
def test_quadratic_cells_of_files_collide_by_their_corners(tmp_path, kind, suffix):
    """One cell with straight edges; at the end of the step a node is a tenth off the middle of its edge."""
    cube = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], dtype=float
    )
    ring = [(0, 1), (1, 2), (2, 3), (3, 0)]
    corners, edges = {
        "triangle6": ([0, 1, 2], [(0, 1), (1, 2), (2, 0)]),
        "quad8": ([0, 1, 2, 3], ring),
        "tetra10": ([0, 1, 3, 4], [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]),
        "hexahedron20": (range(8), [*ring, *((a + 4, b + 4) for a, b in ring), *((a, a + 4) for a in range(4))]),
    }[kind]
    points = cube[list(corners)]
    start = np.concatenate([points, points[np.array(edges)].mean(axis=1)])
    end = start - [0, 0, 3.0]
    end[len(points)] += [0.25, -0.1, 0.0]  # along the edge, and off it
    paths = [tmp_path / f"{name}.{suffix}" for name in ("start", "end")]
    for path, x in zip(paths, (start, end), strict=True):
        meshio.Mesh(x, [(kind, np.arange(len(start))[None])]).write(path)
    with pytest.warns(
        RuntimeWarning, match=f"^cells of start.{suffix}: quadratic ones .* up to 0.1 off these, the longest"
    ):
        frames = ccd.read_frames(*paths, surface=kind in ("tetra10", "hexahedron20"))
    linear = ccd.CollisionMesh.from_volume(points, {kind.rstrip("01268"): np.arange(len(points))[None]})
    assert np.array_equal(frames.mesh.faces, linear.faces)
    assert frames.mesh.inner_vertices.tolist() == list(range(len(points), len(start)))
    with pytest.warns(RuntimeWarning, match="quadratic ones"):
        sequence = ccd.read_sequence(paths, surface=kind in ("tetra10", "hexahedron20"), static=paths[:1])
    assert len(sequence.mesh.inner_vertices) == 2 * len(edges) and np.array_equal(sequence[1][: len(end)], end)


def test_quadratic_cells_among_others_in_xdmf(tmp_path):
    data = {"Topology": [4, 0, 1, 2, 36, 0, 2, 3, 4, 5, 6], "Geometry": POINTS.ravel().tolist()}
    items = "".join(
        f'<{tag} Type="{kind}"><DataItem DataType="{number}" Dimensions="{shape}" Format="XML">'
        f"{' '.join(map(repr, data[tag]))}</DataItem></{tag}>"
        for tag, kind, number, shape in (("Topology", "Mixed", "Int", "11"), ("Geometry", "XYZ", "Float", "7 3"))
    )
    text = f"<Xdmf><Domain><Grid>{items}</Grid></Domain></Xdmf>"
    assert _read(tmp_path / "a.xdmf", text.encode()) == [[0, 1, 2], [0, 2, 3]]
