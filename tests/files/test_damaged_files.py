"""A damaged file is refused in one line or read as the whole one is; it is never a smaller obstacle."""

import json
import os
import re
import sys
from importlib import import_module
from unittest import mock

import numpy as np
import pytest
from mesh_files import FACES, VERTICES, WHOLE, XDMF, content, gltf_files, of_extra, read, same, whole

from ccd_warp._files.vtk import _Process


def refused(path, data, message):
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    with pytest.raises(ValueError, match=message) as caught:
        content(path)
    assert str(path) in str(caught.value) and str(caught.value).isprintable() and len(str(caught.value)) < 800


@pytest.mark.parametrize("name", WHOLE)
def test_a_file_is_read_exactly_and_a_damaged_one_never_in_part(tmp_path, name):
    """Every vertex comes once and with all its bits, but for scenes, which hold single precision or decimals; files are
    cut at any byte, and bytes are dropped or doubled."""
    rng, data, is_scene = np.random.default_rng(3), whole(name), name.startswith("scene")
    expected = positions, faces = read(tmp_path / name, data)
    if positions.ndim == 3:  # two frames of VTK, displaced by the positions
        positions = positions[1] / 2.0
    num_used = np.unique(FACES).size if name.endswith(".dae") else len(VERTICES)
    assert len(positions) == num_used and (is_scene or np.array_equal(faces[:5], FACES[:5]))
    assert np.abs(positions[faces[:5]] - VERTICES[FACES[:5]]).max() <= 1e-6 * is_scene
    if name.endswith(".inp"):  # which says of nothing how much
        return
    for length in range(len(data)):
        found = read(tmp_path / name, data[:length])
        assert found is None or same(found, expected), f"cut to {length} of {len(data)} bytes"
    for begin in rng.integers(0, len(data), 25).tolist():
        end = begin + int(rng.integers(1, 40))
        for damaged in (data[:begin] + data[end:], data[:end] + data[begin:]):
            found = read(tmp_path / name, damaged)
            assert found is None or len(found[1]) >= len(expected[1]), (begin, end)


# ---- What is no file of a mesh ---------------------------------------------------------------------------------------

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
    of_extra("meshio")
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

NUMBERS = "cannot be read .string or file could not be read to its end"
DAMAGED = [  # of a file: what stands in place of what, a regular expression, and what the message says
    ("text.ply", "3 6 7 8", "3 6 7.5 8", r"line 26 holds 7\.5; expected an integer"),
    ("text.ply", "3 6 7 8", "3 6 7 8_0", r"line 26 holds '8_0'; expected a number"),
    ("text.ply", "3 6 7 8", "3 6 7 12", r"face 3 is \[6, 7, 12\], but the file has 12 vertices"),
    ("text.ply", "property double z", "property double w", "gives its vertices no x, y and z"),
    ("text.ply", "element face", "element fact", "holds 'fact' of vertices, which is not read"),
    ("text.obj", "f 1 2 3", "f 1 2 -14", "line 13 is a face of a vertex that is none of the 12 of the file"),
    ("text.obj", "f 1 2 3\n", "f 1 2 3\nfa 1 2 3\n", "line 14 begins with 'fa', which is not read"),
    ("one.xdmf", 'NumberOfElements="1"', 'NumberOfElements="2"', "holds 1 cells, and says that it has 2"),
    ("one.xdmf", "0 1 2", "0 1 2 9", r"cannot be read \(cannot reshape array of size 4 into shape"),
    ("one.xdmf", "0 1 2", "0 1 2.5", NUMBERS),
    ("one.xdmf", "0 1 0<", "0 1 z<", NUMBERS),
    (
        "one.xdmf",
        "<DataItem ",
        '<DataItem ItemType="HyperSlab" ',
        "'XML', or that refer to others; expected XML or HDF",
    ),
    ("one.xdmf", '"XML">0 0 0 1', '"Binary">data', "has data of the format 'Binary', or that refer to"),
    # A row of three corners that says one, and one that takes a number of the next row.
    ("text_42.vtk", r"\n3\n2\n3\n4\n", "\n1\n2\n3\n4\n", "triangle of 1 corners"),
    ("text_42.vtk", "CELLS 6", "CELLS 7", "VTK cannot read it: Error reading ascii"),
    ("text_51.vtk", r"\b6\s+9\s+12\b", "5 9 12", "is a triangle of 2 corners"),
    ("text_51.vtk", "5\n9\nP", "5\n99\nP", "cell 5 is of the type VTK_99"),
    ("text_51.vtk", r"\s+\Z", "", "may have lost digits"),
    ("text.vtu", r"\b6\s+9\s+12\b", "5 9 12", "is a triangle of 2 corners"),
    ("text.vtp", 'Polys="6"', 'Polys="5"', "'offsets' holds 6 numbers; expected 5"),
    ("text.vtp", "(?s)<Polys>(.*)</Polys>", r"<Polis>\1</Polis>", "announces 12 points"),
    # As many bytes in all, of which the offsets to the next array are other ones.
    ("raw.vtp", "(?s)( _.{60}).(.*)</App", r"\1\2 </App", "has not the .* bytes"),
    ("text_40.msh", r"\n1 6\n", "\n1 7\n", "announces 7 elements, and"),
    # A node that is announced and in no block, which meshio leaves as memory was.
    ("text_41.msh", "1 12 1 12", "1 13 1 12", "announces 13 nodes, and 12"),
    ("text_41.msh", "2 0 0 12", "2 0 0 11", "announces 12 nodes, and 11"),
    ("text_40.msh", r"\n1 12\n", r"\n1 13\n", "announces 13 nodes, and 12"),
    ("text_41.msh", r"\$EndNodes", "7\n$EndNodes", "12 can be read, or its section is of another length"),
    ("text_22.msh", " 2 2 ", " 146 2 ", r"its reader knows no 146\)"),
    ("text_22.msh", r"\$EndElements", "", "each closed by its"),
    ("text.mesh", "\nEnd", "", "does not end with 'End'"),
    ("text.inp", r"\s+\Z", "", "may have lost digits"),
    ("text.inp", r"\*ELEMENT", "*NODE\n1,0,0,0\n*ELEMENT", r"has 2 lists \*NODE"),
    ("text.inp", r"\Z", "*INSTANCE, NAME=A\n1, 0, 0\n", "holds .INSTANCE, NAME=A, which makes or moves"),
    # Three numbers less are a vertex less, and an input less makes other faces.
    ("scene.dae", 'count="54"', 'count="57"', "does not hold 57 values"),
    ("scene.dae", "(?s)triangles(.*)triangles", r"tristrips\1tristrips", "holds tristrips, which are not read"),
    ("scene.dae", "(?s)<triangles.*</triangles>", "", "holds no triangles; give"),
    ("scene.dae", '<triangles count="6"', '<triangles count="7"', "has 7 triangles, and 6"),
]


@pytest.mark.parametrize("name, old, new, message", DAMAGED)
def test_damage_that_would_be_read_in_part_is_named(tmp_path, name, old, new, message):
    damaged = re.sub(old.encode(), new.encode(), whole(name), count=1)
    assert damaged != whole(name)
    refused(tmp_path / name, damaged, message)


def test_hdf5_of_another_shape_or_elsewhere_is_refused(tmp_path, monkeypatch):
    meshio, _ = of_extra("meshio"), of_extra("h5py")
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "a.xdmf"
    meshio.Mesh(np.eye(7, 3), [("triangle", FACES[:3])]).write(path, data_format="HDF")
    data = path.read_bytes()
    assert content(path)[1].tolist() == FACES[:3].tolist()
    name = re.search(rb"a\.h5:/(\w+)", data)[1]
    damaged = data.replace(b'Dimensions="7 3"', b'Dimensions="3 7"')
    refused(path, damaged, r"float64 of shape \(7, 3\); expected numbers of shape \(3, 7\)")
    refused(path, data.replace(b"/" + name, b"/other"), "object 'other' doesn't exist")


@pytest.mark.parametrize(
    "name, packages",
    {"one.xdmf": "h5py meshio", "text.vtp": "vtk", "scene.dae": "collada", "scene.3mf": "lxml networkx"}.items(),
)
def test_the_extra_that_brings_a_package_is_named_where_it_is_not_installed(tmp_path, monkeypatch, name, packages):
    content = whole(name)  # before a package of those that write it is missing
    for package in packages.split():
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, package.replace("vtk", "vtkmodules"), None)
            patch.setattr("ccd_warp._files.vtk._PROCESS", _Process())
            message = rf"{package} reads it; install with: pip install 'ccd-warp\[formats\]'"
            refused(tmp_path / name, content, message)


def test_a_vtk_that_takes_part_of_a_text_for_all_is_as_good_as_none(tmp_path, monkeypatch):
    content = whole("text.vtp")
    process = import_module("ccd_warp._files.vtk_process")
    numbers = {"GetVTKMajorVersion.return_value": 9, "GetVTKMinorVersion.return_value": 6}
    monkeypatch.setattr(process, "vtkVersion", mock.Mock(**numbers))
    monkeypatch.setattr("ccd_warp._files.vtk._PROCESS.read", process._read)
    message = r"vtk from 9.7 on reads it; install with: pip install 'ccd-warp\[formats\]'"
    refused(tmp_path / "text.vtp", content, message)
