"""A damaged file is refused in one line or read as the whole one is; it is never a smaller obstacle."""

import json
import os
import re
import sys

import numpy as np
import pytest
from mesh_files import FACES, PLY, WHOLE, content, gltf_files, read, same, whole

from ccd_warp._files.vtk import _Process


def refused(path, data, message):
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    with pytest.raises(ValueError, match=message) as caught:
        content(path)
    assert str(path) in str(caught.value) and str(caught.value).isprintable() and len(str(caught.value)) < 800


@pytest.mark.parametrize(
    "name", [name for name in WHOLE if not name.endswith(".inp")]
)  # which says of nothing how much
def test_file_cut_at_any_byte_is_refused_or_read_as_the_whole(tmp_path, name):
    data = whole(name)
    expected = read(tmp_path / name, data)
    for length in range(len(data)):
        found = read(tmp_path / name, data[:length])
        assert found is None or same(found, expected), f"cut to {length} of {len(data)} bytes"


@pytest.mark.parametrize("name", [name for name in WHOLE if not name.endswith(".inp")])
def test_bytes_that_are_dropped_or_doubled_never_lose_a_face(tmp_path, name):
    rng, data = np.random.default_rng(3), whole(name)
    expected = read(tmp_path / name, data)
    for begin in rng.integers(0, len(data), 25).tolist():
        end = begin + int(rng.integers(1, 40))
        for damaged in (data[:begin] + data[end:], data[:end] + data[begin:]):
            found = read(tmp_path / name, damaged)
            assert found is None or len(found[1]) >= len(expected[1]), (begin, end)


# ---- What is no file of a mesh ---------------------------------------------------------------------------------------

_ITEM = '<DataItem DataType="{}" Precision="8" Dimensions="{}" Format="{}">{}</DataItem>'
XDMF = (
    '<Xdmf Version="3.0"><Domain><Grid><Topology TopologyType="Triangle" NumberOfElements="1">'
    f'{_ITEM.format("Int", "1 3", "XML", "0 1 2")}</Topology><Geometry GeometryType="XYZ">'
    f"{_ITEM.format('Float', '3 3', 'XML', '0 0 0 1 0 0 0 1 0')}</Geometry></Grid></Domain></Xdmf>"
)
NAMES = ["a.ply", "a.obj", "a.stl", "a.off", "a.glb", "a.vtu", "a.vtk", "a.pvd", "a.xmf"]
SAID = {
    "pipe": "no such file but a folder, a pipe or a device; expected a regular file",
    "device": "no such file but a folder, a pipe or a device; expected a regular file",
    "missing": "no such file",
    "pointer": "is a pointer of Git LFS and not the file; get that by: git lfs pull",
    "no mesh": "a.",
}


@pytest.mark.parametrize("kind", SAID)
def test_what_is_no_mesh_is_refused_at_once_wherever_a_file_stands(tmp_path, kind):
    (tmp_path / "a.xdmf").write_text(XDMF.replace('"XML">0 0', '"HDF">data:/0 0'))
    tree, buffer = gltf_files()
    tree["buffers"][0]["uri"] = "my%20data"
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    places = [(tmp_path / name, tmp_path / at) for name, at in (("a.gltf", "my data"), ("a.xdmf", "data"))]
    for path, place in places + [(tmp_path / name, tmp_path / name) for name in NAMES]:
        match kind:
            case "pipe":
                os.mkfifo(place)
            case "device":
                place.symlink_to("/dev/zero")
            case "pointer":
                place.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
            case "no mesh":
                place.write_text("this is no mesh\n")
        with pytest.raises(ValueError, match=SAID[kind]) as caught:
            content(path)
        assert str(path if kind == "no mesh" else place) in str(caught.value) and str(caught.value).isprintable()
        place.unlink(missing_ok=True)
    (tmp_path / "my data").write_bytes(buffer)  # blanks in its name are escaped
    assert len(content(tmp_path / "a.gltf")[1]) == len(FACES)


# ---- What each format may not hold -----------------------------------------------------------------------------------

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
BASE = {"ply": PLY, "obj": OBJ, "xdmf": XDMF}
MALFORMED = [  # of a format: what stands in place of what, and what the message says
    ("ply", "3 6 7 8", "3 6 7.5 8", r"line 26 holds 7\.5; expected an integer"),
    ("ply", "3 6 7 8", "3 6 7 8_0", r"line 26 holds '8_0'; expected a number"),
    ("ply", "property double z", "property double w", "gives its vertices no x, y and z"),
    ("ply", "element face", "element fact", "holds 'fact' of vertices, which is not read"),
    ("obj", "f 1 2 3", "f 1 2 -4", "line 4 is a face of a vertex that is none of the 3 of the file"),
    ("obj", "f 1 2 3\n", "f 1 2 3\nfa 1 2 3\n", "line 5 begins with 'fa', which is not read"),
    ("xdmf", 'NumberOfElements="1"', 'NumberOfElements="2"', "holds 1 cells, and says that it has 2"),
    ("xdmf", "0 1 2", "0 1 2 9", r"cannot be read \(cannot reshape array of size 4 into shape"),
    ("xdmf", "0 1 2", "0 1 2.5", "cannot be read .string or file could not be read to its end"),
    ("xdmf", "0 1 0<", "0 1 z<", "cannot be read .string or file could not be read to its end"),
    (
        "xdmf",
        "<DataItem ",
        '<DataItem ItemType="HyperSlab" ',
        "has data of the format 'XML', or that refer to others; expected XML or HDF",
    ),
    ("xdmf", '"XML">0 0 0 1', '"Binary">data', "has data of the format 'Binary', or that refer to"),
]


@pytest.mark.parametrize("suffix, old, new, message", MALFORMED)
def test_malformed_content_is_named(tmp_path, suffix, old, new, message):
    if suffix == "xdmf":
        pytest.importorskip("meshio", reason="the extra formats is not installed")
    refused(tmp_path / f"a.{suffix}", BASE[suffix].replace(old, new, 1), message)


@pytest.mark.parametrize(
    "name, damage, message",
    [
        # A row of three corners that says one, and one that takes a number of the next row.
        ("text_42.vtk", lambda data: data.replace(b"\n3\n2\n3\n4\n", b"\n1\n2\n3\n4\n"), "triangle of 1 corners"),
        ("text_42.vtk", lambda data: data.replace(b"CELLS 6", b"CELLS 7"), "VTK cannot read it: Error reading ascii"),
        ("text_51.vtk", lambda data: re.sub(rb"\b6\s+9\s+12\b", b"5 9 12", data), "is a triangle of 2 corners"),
        ("text_51.vtk", lambda data: data.replace(b"5\n9\nP", b"5\n99\nP"), "cell 5 is of the type VTK_99"),
        ("text_51.vtk", lambda data: data.rstrip(), "may have lost digits"),
        ("text.vtu", lambda data: re.sub(rb"\b6\s+9\s+12\b", b"5 9 12", data), "is a triangle of 2 corners"),
        ("text.vtp", lambda data: data.replace(b'Polys="6"', b'Polys="5"'), "'offsets' holds 6 numbers; expected 5"),
        (
            "text.vtp",
            lambda data: data.replace(b"<Polys>", b"<Polis>").replace(b"/Polys", b"/Polis"),
            "announces 12 points",
        ),
        # As many bytes in all, of which the offsets to the next array are other ones.
        ("raw.vtp", lambda data: re.sub(rb"(?s)( _.{60}).(.*)</App", rb"\1\2 </App", data), "has not the .* bytes"),
        ("text_41.msh", lambda data: data.replace(b"1 12 1 12", b"1 13 1 12"), "announces 13 nodes, and"),
        ("text_22.msh", lambda data: data.replace(b" 2 2 ", b" 146 2 ", 1), r"its reader knows no 146\)"),
        ("text_22.msh", lambda data: data.replace(b"$EndElements", b""), "each closed by its"),
        ("text.mesh", lambda data: data.replace(b"\nEnd", b""), "does not end with 'End'"),
        ("text.inp", lambda data: data.rstrip(), "may have lost digits"),
        ("text.inp", lambda data: data.replace(b"*ELEMENT", b"*NODE\n1,0,0,0\n*ELEMENT", 1), r"has 2 lists \*NODE"),
        (
            "text.inp",
            lambda data: data + b"*INSTANCE, NAME=A\n1, 0, 0\n",
            "holds .INSTANCE, NAME=A, which makes or moves",
        ),
        # Three numbers less are a vertex less, and an input less makes other faces.
        ("scene.dae", lambda data: data.replace(b'count="36"', b'count="39"', 1), "does not hold 39 values"),
        ("scene.dae", lambda data: data.replace(b"triangles", b"tristrips"), "holds tristrips, which are not read"),
        ("scene.dae", lambda data: re.sub(rb"(?s)<triangles.*</triangles>", b"", data), "holds no triangles; give"),
        (
            "scene.dae",
            lambda data: data.replace(b'<triangles count="6"', b'<triangles count="7"'),
            "has 7 triangles, and 6",
        ),
    ],
)
def test_damage_that_would_be_read_in_part_is_named(tmp_path, name, damage, message):
    damaged = damage(whole(name))
    assert damaged != whole(name)
    refused(tmp_path / name, damaged, message)


def test_hdf5_of_another_shape_or_elsewhere_is_refused(tmp_path, monkeypatch):
    pytest.importorskip("h5py", reason="the extra formats is not installed")
    meshio = pytest.importorskip("meshio", reason="the extra formats is not installed")
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "a.xdmf"
    meshio.Mesh(np.eye(7, 3), [("triangle", FACES[:3])]).write(path, data_format="HDF")
    data = path.read_bytes()
    assert content(path)[1].tolist() == FACES[:3].tolist()
    name = re.search(rb"a\.h5:/(\w+)", data)[1]
    damaged = data.replace(b'Dimensions="7 3"', b'Dimensions="3 7"')
    refused(path, damaged, r"float64 of shape \(7, 3\); expected numbers of shape \(3, 7\)")
    refused(path, data.replace(b"/" + name, b"/other"), "object 'other' doesn't exist")
    vtp = whole("text.vtp")
    for module, name, whole_data in (("h5py", "a.xdmf", data), ("meshio", "a.xdmf", data), ("vtk", "a.vtp", vtp)):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, module.replace("vtk", "vtkmodules"), None)
            monkeypatch.setattr("ccd_warp._files.vtk._PROCESS", _Process())
            refused(tmp_path / name, whole_data, rf"{module} reads it; install with: pip install 'ccd-warp\[formats\]'")
