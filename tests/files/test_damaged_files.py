"""A damaged file is refused in one line or read as the whole one is; it is never a smaller obstacle."""

import base64
import bz2
import io
import json
import re
import struct
import sys
import tarfile
import zipfile

import numpy as np
import pytest
import trimesh

from ccd_warp import datasets
from ccd_warp._cli.command import main
from ccd_warp._files import text
from ccd_warp._files.frames import InputError, read_frames, read_static, write_mesh
from ccd_warp._files.series import find_series
from ccd_warp._input.messages import printable

# Twelve vertices, so that a face may name a vertex of two digits, and the last index is one.
VERTICES = np.round(np.random.default_rng(7).uniform(-2.0, 2.0, (12, 3)), 3)
FACES = np.array([[0, 1, 2], [2, 3, 4], [4, 5, 6], [6, 7, 8], [8, 9, 10], [9, 1, 10]])
_ROWS = [" ".join(map(repr, row)) for row in VERTICES.tolist()]
_HEADER = (
    "ply\nformat ascii 1.0\ncomment a test\nelement vertex 12\nproperty double x\nproperty double y\n"
    "property double z\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
)


def _lines(*rows, end="\n"):
    return ("\n".join(rows) + end).encode()


def _counted_faces(colour=""):
    return ["3 " + " ".join(map(str, face)) + colour for face in FACES.tolist()]


def _binary_ply(order="<"):
    name = {"<": "little", ">": "big"}[order]
    rows = np.zeros(len(FACES), dtype=[("count", "u1"), ("corners", f"{order}i4", 3)])
    rows["count"], rows["corners"] = 3, FACES
    header = _HEADER.replace("ascii", f"binary_{name}_endian").encode()
    return header + VERTICES.astype(f"{order}f8").tobytes() + rows.tobytes()


def _exported(kind):
    data = trimesh.Trimesh(VERTICES, FACES, process=False).export(file_type=kind)
    return data.encode() if isinstance(data, str) else data


def _gltf():
    files = trimesh.Scene(trimesh.Trimesh(VERTICES, FACES, process=False)).export(file_type="gltf", merge_buffers=True)
    tree = json.loads(files["model.gltf"])
    (buffer,) = tree["buffers"]
    buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(files[buffer["uri"]]).decode()
    return json.dumps(tree).encode()


def _zipped(files, method=zipfile.ZIP_DEFLATED):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", method) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return packed.getvalue()


def _tarred(files, kind="gz"):
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode=f"w:{kind}") as archive:
        for name, data in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return packed.getvalue()


ASCII_PLY = _HEADER.encode() + _lines(*_ROWS, *_counted_faces())
OFF = _lines("OFF", "12 6 0", *_ROWS, *_counted_faces())
OBJ = _lines(*("v " + row for row in _ROWS), *("f " + " ".join(map(str, face)) for face in (FACES + 1).tolist()))
_COLOURED = _HEADER.replace("vertex_indices\n", "vertex_indices\nproperty uchar red\n")
WHOLE = {
    "ascii.ply": ASCII_PLY,
    "coloured.ply": _COLOURED.encode() + _lines(*_ROWS, *_counted_faces(" 255")),
    "binary.ply": _binary_ply(),
    "big_endian.ply": _binary_ply(">"),
    "text.off": OFF,
    "commented.off": _lines("OFF # it is", "", "12 6 0", *_ROWS, "# faces", *_counted_faces(" 0.5 0.5 1"), "# the end"),
    "binary.stl": _exported("stl"),
    "ascii.stl": _exported("stl_ascii"),
    "scene.glb": _exported("glb"),
    "scene.gltf": _gltf(),
    "archive.zip": _zipped({"folder/mesh.ply": ASCII_PLY, "read me.txt": b"a mesh"}),
    "archive.tar.gz": _tarred({"mesh.ply": ASCII_PLY}),
    "archive.tar.bz2": _tarred({"mesh.ply": ASCII_PLY}, "bz2"),
    "mesh.ply.bz2": bz2.compress(ASCII_PLY),
}


def _read(folder, name, data):
    """The mesh of a file's content, or None where it is refused, in one line that names the file."""
    path = folder / name
    path.write_bytes(data)
    try:
        body = read_static(path)
    except InputError as error:
        message = str(error)
        assert message.startswith(f"{path}") and printable(message) == message and len(message) < 500
        return None
    return body.vertices_t0, body.faces


def _same(found, expected):
    return all(np.array_equal(a, b) for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("name", WHOLE)
def test_file_cut_at_any_byte_is_refused_or_read_as_the_whole(tmp_path, name):
    data = WHOLE[name]
    expected = _read(tmp_path, name, data)
    assert expected is not None and len(expected[1]) == len(FACES)
    for length in range(len(data)):
        found = _read(tmp_path, name, data[:length])
        assert found is None or _same(found, expected), f"cut to {length} of {len(data)} bytes"


@pytest.mark.parametrize("name", ["ascii.ply", "coloured.ply", "text.off", "commented.off", "ascii.stl"])
def test_file_cut_at_any_byte_with_a_line_end_after_it_is_never_fewer_faces(tmp_path, name):
    """As an editor leaves it that ends every file with a line end."""
    data = WHOLE[name]
    expected = _read(tmp_path, name, data)
    for length in range(len(data)):
        found = _read(tmp_path, name, data[:length] + b"\n")
        assert found is None or found[1].shape == expected[1].shape, f"cut to {length} of {len(data)} bytes"


def test_obj_cut_within_a_line_is_refused(tmp_path):
    """A cut between two lines cannot be seen: an OBJ file says nowhere how much it holds."""
    whole = _read(tmp_path, "a.obj", OBJ)
    assert np.array_equal(whole[1], FACES)
    for length in range(len(OBJ)):
        found = _read(tmp_path, "a.obj", OBJ[:length])
        assert found is None or OBJ[:length].endswith(b"\n")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("name", ["ascii.ply", "text.off", "ascii.stl", "a.obj"])
def test_line_ends_of_every_system_are_read(tmp_path, name, end):
    data = WHOLE.get(name, OBJ)
    head, body = (data[: len(_HEADER)], data[len(_HEADER) :]) if name.endswith("ply") else (b"", data)
    if end == "\r\n":
        head = head.replace(b"\n", b"\r\n")
    assert _same(_read(tmp_path, name, head + body.replace(b"\n", end.encode())), _read(tmp_path, name, data))


@pytest.mark.parametrize("name, data", [("a.ply", ASCII_PLY), ("a.off", OFF)])
def test_last_index_without_a_line_end_is_taken_where_no_digit_can_be_lost(tmp_path, name, data):
    whole = _read(tmp_path, name, data)
    assert data.endswith(b" 10\n")  # of 12 vertices: a third digit would name none
    assert _same(_read(tmp_path, name, data[:-1]), whole)
    assert _read(tmp_path, name, data[:-2]) is None


def test_bytes_that_are_dropped_or_doubled_never_lose_a_face(tmp_path):
    rng = np.random.default_rng(3)
    for name, data in WHOLE.items():
        expected = _read(tmp_path, name, data)
        for begin in rng.integers(0, len(data), 25).tolist():
            end = begin + int(rng.integers(1, 40))
            for damaged in (data[:begin] + data[end:], data[:end] + data[begin:]):
                found = _read(tmp_path, name, damaged)
                assert found is None or len(found[1]) >= len(expected[1]), (name, begin, end)


@pytest.mark.parametrize("name", ["ascii.ply", "coloured.ply", "text.off", "commented.off", "ascii.stl"])
def test_line_that_is_missing_or_doubled_is_refused(tmp_path, name):
    lines = WHOLE[name].splitlines(keepends=True)
    expected = _read(tmp_path, name, WHOLE[name])
    for k, line in enumerate(lines):
        for damaged in (lines[:k] + lines[k + 1 :], lines[: k + 1] + lines[k:]):
            found = _read(tmp_path, name, b"".join(damaged))
            is_beside = line.startswith((b"#", b"comment", b"endfacet")) or not line.strip()
            assert found is None or (is_beside and _same(found, expected)), line


# ---- What each format may not hold -----------------------------------------------------------------------------------

_TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
_STL = "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"
_PLY = ASCII_PLY.decode()
_OFF = OFF.decode()


@pytest.mark.parametrize(
    "name, text, message",
    [
        (
            "a.ply",
            _PLY.replace("element face 6", "element face 7"),
            "holds 6 rows of the element 'face', and its h.* 7",
        ),
        ("a.ply", _PLY.replace("element face 6", "element face 5"), "line 28 is one more than the header says"),
        ("a.ply", _PLY.replace("element vertex 12", "element vertex 13"), "line 23 holds 4 numbers; expected 3"),
        ("a.ply", _PLY.replace("3 6 7 8", "4 6 7 8"), "line 26 says 4 corners and holds 3 numbers behind that"),
        ("a.ply", _PLY.replace("3 6 7 8", "3 6 7.5 8"), r"line 26 holds '7\.5'; expected an integer"),
        ("a.ply", _PLY.replace("3 6 7 8", "2 6 7"), "line 26 says 2 corners"),
        ("a.ply", _PLY.replace("3 6 7 8", "3 6 7 12"), r"face 3 is \[6, 7, 12\], but the file has 12 vertices"),
        ("a.ply", _PLY.replace(_ROWS[4], _ROWS[4] + "-1"), "line 15 holds .*; expected a number"),
        ("a.ply", _PLY.replace(_ROWS[4], "1_0 2 3"), "line 15 holds '1_0'; expected a number"),
        ("a.ply", _PLY.replace("element face", "element tristrips"), "holds strips of triangles"),
        ("a.ply", _PLY.replace("property double z\n", ""), "gives its vertices no x, y and z"),
        ("a.ply", _PLY.replace("ascii", "binary_middle_endian"), "line 2 of the header is 'format binary_middle"),
        ("a.ply", _PLY.replace("double y", "quadruple y"), "line 6 of the header is 'property quadruple y'"),
        ("a.off", _OFF.replace("12 6 0", "12 7 0"), "holds 12 vertices and 6 faces, and says that it has 12 and 7"),
        ("a.off", _OFF.replace("12 6 0", "12 5 0"), "line 20 is one more than its counts say"),
        ("a.off", _OFF.replace("3 6 7 8", "3 6 7"), "line 18 says 3 corners and holds 2 numbers"),
        ("a.off", _OFF.replace("12 6 0", "12"), "lacks the line that counts"),
        ("a.off", _OFF.replace(_ROWS[4], "1 2"), "line 7 holds 2 numbers; expected 3, a vertex"),
        ("a.obj", _TRIANGLE + "f 1 2\n", "line 4 is a face of 2 corners; expected 3 or more"),
        ("a.obj", _TRIANGLE + "f 1 2 3\nf\n", "line 5 is a face of 0 corners"),
        ("a.obj", _TRIANGLE + "f 1 2 3", "the last line has no line end"),
        ("a.obj", _TRIANGLE + "f 1 2 3\n# and", "the last line has no line end"),
        ("a.obj", _TRIANGLE + "f 1 2 0\n", "line 4 is a face of vertex 0"),
        ("a.obj", _TRIANGLE + "f 1 2 4\n", "line 4 is a face of vertex 4, but the file has 3 vertices"),
        ("a.obj", _TRIANGLE + "f 1 2 -4\n", "line 4 is a face of vertex -4"),
        ("a.obj", _TRIANGLE + "f 1 /2 3\n", "line 4 holds '/2'; expected an integer"),
        ("a.obj", _TRIANGLE + "v 1 2\nf 1 2 3\n", "line 4 is a vertex of 2 numbers"),
        ("a.obj", _TRIANGLE + "v 1 2 nonsense\nf 1 2 3\n", "line 4 holds 'nonsense'; expected a number"),
        ("a.obj", _TRIANGLE + "f 1 2 3\nfa 1 2 3\n", "line 5 begins with 'fa', which is not read"),
        ("a.obj", _TRIANGLE + "v 1/2 0 0\nf 1 2 3\n", "line 4 holds '1/2'; expected a number"),
        ("a.obj", _TRIANGLE + "v 1 2 nan\nf 1 2 4\n", r"vertex 3 is \[1.0, 2.0, nan\]"),
        ("a.stl", _STL.replace("endsolid\n", ""), "ends without 'endsolid'"),
        ("a.stl", _STL.replace("vertex 1 0 0\n", ""), "line 6 begins with 'endloop'; expected vertex"),
        ("a.stl", _STL.replace("vertex 1 0 0\n", "vertex 1 0 0\nvertex 2 0 0\n"), "line 7 begins with 'vertex'"),
        ("a.stl", _STL.replace("vertex 1 0 0", "vertex 1 0"), "line 5 is a vertex of 2 numbers"),
        ("a.stl", _STL.replace("vertex 1 0 0", "vertex 1 0 x"), "line 5 holds 'x'; expected a number"),
        ("a.stl", _STL + "facet", "line 10 begins with 'facet'; expected solid"),
        ("a.stl", _STL.replace("solid\nfacet", "solid\nendsolid\nfacet"), "line 3 begins with 'facet'; expected solid"),
        ("a.msh", "$MeshFormat\n", "files that end in '.msh' are not read; save it as PLY"),
    ],
)
def test_malformed_content_is_named(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_static(tmp_path / name)
    assert str(caught.value).startswith(f"{tmp_path / name}: ") and "\n" not in str(caught.value)


def test_binary_files_of_another_length_say_what_they_should_have(tmp_path):
    (tmp_path / "a.stl").write_bytes(WHOLE["binary.stl"][:-50])
    with pytest.raises(InputError, match="has 334 bytes, but its header says 6 faces, which take 384"):
        read_static(tmp_path / "a.stl")
    (tmp_path / "a.ply").write_bytes(WHOLE["binary.ply"] + b"\n")
    with pytest.raises(InputError, match="holds 1 bytes more than its header says"):
        read_static(tmp_path / "a.ply")
    (tmp_path / "a.glb").write_bytes(WHOLE["scene.glb"] + b"\0")
    with pytest.raises(InputError, match=r"has \d+ bytes, but its header says \d+"):
        read_static(tmp_path / "a.glb")


def test_polygons_become_fans_in_the_order_of_the_file(tmp_path):
    expected = [[0, 1, 2], [0, 2, 3], [1, 2, 4], [0, 1, 2], [0, 2, 3], [0, 3, 4]]
    points = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n-1 0 0\n"
    header = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element face 3\nproperty list uchar int vertex_index\nend_header\n"
    faces = "4 0 1 2 3\n3 1 2 4\n5 0 1 2 3 4\n"
    (tmp_path / "a.ply").write_text(header + points + faces)
    (tmp_path / "a.off").write_text("OFF 5 3\n" + points + faces)
    (tmp_path / "a.obj").write_text(
        "".join(f"v {row}\n" for row in points.splitlines())
        + "f 1 2 3 4\nf 2//1 \\\n3//1 5//1\nf -5/1 -4/1 -3/1 -2 -1\n"
    )
    for name in ("a.ply", "a.off", "a.obj"):
        assert read_static(tmp_path / name).faces.tolist() == expected


@pytest.mark.parametrize("name", ["ascii.ply", "coloured.ply", "text.off", "commented.off", "ascii.stl", "a.obj"])
def test_nothing_shows_where_a_long_file_is_cut_into_blocks(tmp_path, monkeypatch, name):
    data = WHOLE.get(name, OBJ.replace(b"f 10 2 11\n", b"v 1 2 3\nf -4 2 11\n"))
    whole = _read(tmp_path, name, data)
    for rows in (1, 3, 5):
        monkeypatch.setattr(text, "_BLOCK", rows)
        assert _same(_read(tmp_path, name, data), whole)


def test_negative_index_counts_from_the_vertices_above_its_face(tmp_path):
    (tmp_path / "a.obj").write_text(_TRIANGLE + "f -3 -2 -1\n" + _TRIANGLE.replace("0\n", "5\n") + "f -3 -2 -1\n")
    assert read_static(tmp_path / "a.obj").faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_gltf_that_would_be_read_in_part_is_refused(tmp_path):
    for change, message in (
        (lambda tree: tree.update(extensionsRequired=["KHR_draco_mesh_compression"]), "requires the extension 'KHR_dr"),
        (lambda tree: tree["meshes"][0]["primitives"][0].update(mode=6), "mode 6, which is not read"),
        (lambda tree: tree["accessors"][0].update(sparse={}), "mesh 0 is compressed or sparse"),
        (lambda tree: tree["accessors"][1].update(normalized=True), "mesh 0 has positions in normalized integers"),
        (lambda tree: tree["buffers"][0].update(uri=tree["buffers"][0]["uri"] + "!!!!"), "buffer 0 is no base64"),
        (lambda tree: tree["bufferViews"][1].update(byteLength=999), "its buffer view 1 goes beyond its buffer 0"),
        (lambda tree: tree["buffers"][0].update(byteLength=9999), r"buffer 0 has \d+ bytes, expected 9999"),
    ):
        tree = json.loads(WHOLE["scene.gltf"])
        change(tree)
        (tmp_path / "a.gltf").write_text(json.dumps(tree))
        with pytest.raises(InputError, match=message):
            read_static(tmp_path / "a.gltf")


@pytest.mark.parametrize(
    ("uri", "said"), [("data;" + "A" * 30_000, "has a name of 30,005 characters"), ("B" * 700, "B … B")]
)
def test_damaged_buffer_is_not_quoted_whole(tmp_path, uri, said):
    tree = json.loads(WHOLE["scene.gltf"])
    tree["buffers"][0]["uri"] = uri
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    with pytest.raises(InputError, match=said) as caught:
        read_static(tmp_path / "a.gltf")
    assert len(str(caught.value)) < 800


def test_gltf_reads_the_buffer_beside_it_whole_or_not_at_all(tmp_path):
    files = trimesh.Scene(trimesh.Trimesh(VERTICES, FACES, process=False)).export(file_type="gltf", merge_buffers=True)
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    assert len(read_static(tmp_path / "model.gltf").faces) == len(FACES)
    (name,) = set(files) - {"model.gltf"}
    (tmp_path / name).write_bytes(files[name][:-4])
    with pytest.raises(InputError, match=r"buffer 0 \(.*\) has \d+ bytes, expected"):
        read_static(tmp_path / "model.gltf")


# ---- Archives --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('<float_array id="a" count="9">0 0 0 1 0 0</float_array>', "float_array 'a' holds 6 values; it says 9"),
        ('<triangles count="1"><input offset="1"/><p>0 1 2</p></triangles>', "triangles '' holds 3 indices; it says 6"),
        ('<polylist count="2"><vcount>4</vcount><p>0 1 2 3</p></polylist>', "polylist '' holds 1 polygons; it says 2"),
        ('<polylist count="1"><vcount>4</vcount><p>0 1 2</p></polylist>', "polylist '' holds 3 indices; it says 4"),
    ],
)
def test_collada_whose_counts_do_not_agree_is_refused(tmp_path, text, message):
    """Three numbers less are a vertex less, and an input less makes other faces; what reads COLLADA is not asked."""
    (tmp_path / "a.dae").write_text(f"<COLLADA>{text}</COLLADA>")
    with pytest.raises(InputError, match=rf"a\.dae: {message}$"):
        read_static(tmp_path / "a.dae")


def test_damaged_mesh_in_an_archive_is_refused_and_not_passed_over(tmp_path):
    (tmp_path / "a.zip").write_bytes(_zipped({"whole.ply": ASCII_PLY, "cut.ply": ASCII_PLY[:-20]}))
    with pytest.raises(InputError, match=r"a\.zip, cut\.ply: "):
        read_static(tmp_path / "a.zip")


def test_file_in_an_archive_that_may_be_a_mesh_is_refused_and_not_passed_over(tmp_path):
    for name in ("b.vtk", "inner.zip"):
        (tmp_path / "a.zip").write_bytes(_zipped({"whole.ply": ASCII_PLY, name: b"?"}))
        with pytest.raises(InputError, match=f"a\\.zip, {name}: files that end in .* are not read"):
            read_static(tmp_path / "a.zip")


def test_what_systems_and_textures_leave_beside_a_mesh_is_passed_over(tmp_path):
    beside = {"__MACOSX/._mesh.ply": b"?", ".DS_Store": b"?", "wood.png": b"?", "LICENSE": b"?", "a/": b""}
    (tmp_path / "a.zip").write_bytes(_zipped({"a/mesh.ply": ASCII_PLY, **beside}))
    assert read_static(tmp_path / "a.zip").faces.tolist() == FACES.tolist()


def test_meshes_of_an_archive_are_one_body(tmp_path):
    (tmp_path / "a.zip").write_bytes(_zipped({"one.ply": ASCII_PLY, "two.off": OFF}))
    body = read_static(tmp_path / "a.zip")
    assert np.array_equal(body.faces, np.vstack([FACES, FACES + 12]))
    assert np.array_equal(body.vertices_t0, np.vstack([VERTICES, VERTICES]))


def test_stl_frames_in_archives_are_merged_as_bare_ones_are(tmp_path):
    (tmp_path / "a.zip").write_bytes(_zipped({"a.stl": WHOLE["ascii.stl"]}))
    (tmp_path / "a.stl").write_bytes(WHOLE["ascii.stl"])
    packed, bare = read_frames(tmp_path / "a.zip", tmp_path / "a.zip"), read_static(tmp_path / "a.stl")
    assert np.array_equal(packed.faces, bare.faces) and packed.merged == bare.merged > 0


@pytest.mark.parametrize(
    "name, pack",
    [
        ("bomb.zip", lambda data: _zipped({"a.ply": data})),
        ("bomb.3mf", lambda data: _zipped({"3D/3dmodel.model": data})),
        ("bomb.tar.gz", lambda data: _tarred({"a.ply": data})),
        ("bomb.tar.bz2", lambda data: _tarred({"a.ply": data}, "bz2")),
        ("bomb.ply.bz2", bz2.compress),
    ],
)
def test_archive_that_unpacks_to_more_than_the_limit_names_it(tmp_path, name, pack):
    (tmp_path / name).write_bytes(pack(ASCII_PLY + bytes(3_000_000)))
    assert (tmp_path / name).stat().st_size < 10_000
    with pytest.raises(InputError, match=r"the limit is 1,000,000 bytes; raise it with --max-bytes \(max_bytes= in"):
        read_static(tmp_path / name, max_bytes=1_000_000)
    with pytest.raises(InputError, match=f"{name}(?!.*limit)"):
        read_static(tmp_path / name)


def test_archive_that_states_less_than_it_holds_is_refused(tmp_path):
    packed = bytearray(_zipped({"a.ply": ASCII_PLY + bytes(3_000_000)}))
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        at = packed.index(signature) + offset
        packed[at : at + 4] = (1000).to_bytes(4, "little")
    (tmp_path / "a.zip").write_bytes(packed)
    with pytest.raises(InputError, match=r"a\.zip: cannot be unpacked"):
        read_static(tmp_path / "a.zip", max_bytes=100_000)


def test_member_packed_by_bzip2_or_lzma_is_refused(tmp_path):
    """Of these, Python unpacks all that there is, whatever size is stated: here a thousand bytes."""
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        for name, member in (("a.zip", "a.ply"), ("a.3mf", "3D/3dmodel.model"), ("a.npz", "positions.npy")):
            packed = bytearray(_zipped({member: bytes(3_000_000)}, method))
            at = packed.index(b"PK\x01\x02") + 24
            packed[at : at + 4] = (1000).to_bytes(4, "little")
            (tmp_path / name).write_bytes(packed)
            with pytest.raises(InputError, match=f"{name}: .*{member} is packed in a way that is not read"):
                find_series([tmp_path / name], max_bytes=1 << 28) if name == "a.npz" else read_static(tmp_path / name)


@pytest.mark.parametrize("kind", ["zip", "npz"])
def test_archive_whose_end_loses_a_member_is_refused(tmp_path, kind):
    """The directory is one entry shorter: what is listed is whole, and one of two meshes is gone."""
    if kind == "zip":
        data = _zipped({"one.ply": ASCII_PLY, "two.off": OFF})
    else:
        buffer = io.BytesIO()
        np.savez(buffer, extra=FACES, positions=np.stack([VERTICES, VERTICES]), faces=FACES)
        data = buffer.getvalue()
    path = tmp_path / f"a.{kind}"
    read = read_static if kind == "zip" else lambda path: find_series([path], max_bytes=1 << 28)
    path.write_bytes(data)
    read(path)
    end, first = data.rindex(b"PK\5\6"), data.index(b"PK\1\2")
    second = data.index(b"PK\1\2", first + 1)
    fewer = struct.pack("<II", end - second, second)  # size and place of the directory
    last = data.rindex(b"PK\1\2")
    without_last = data[:last] + data[end : end + 12] + struct.pack("<II", last - first, first) + data[end + 20 :]
    for damaged in (data[: end + 12] + fewer + data[end + 20 :], without_last):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="that its directory does not list"):
            read(path)
    if kind == "zip":  # a mesh that would be taken for a folder
        path.write_bytes(data[:last] + data[last:].replace(b"two.off", b"two.of/"))
        with pytest.raises(InputError, match="cannot be unpacked"):
            read(path)


def test_array_that_is_shorter_than_its_header_says_is_refused(tmp_path):
    """And at once: NumPy would first take the memory."""
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"descr": "<f8", "fortran_order": False, "shape": (2, 1 << 40, 3)})
    (tmp_path / "a.npz").write_bytes(_zipped({"positions.npy": buffer.getvalue() + bytes(80)}))
    with pytest.raises(InputError, match=r"positions\.npy holds 80 bytes, not float64 of shape"):
        find_series([tmp_path / "a.npz"], max_bytes=1 << 28)


def test_limit_holds_for_archives_alone(tmp_path):
    (tmp_path / "a.ply").write_bytes(ASCII_PLY)
    assert len(read_static(tmp_path / "a.ply", max_bytes=1).faces) == len(FACES)
    (tmp_path / "a.zip").write_bytes(_zipped({"a.ply": ASCII_PLY}))
    assert len(read_static(tmp_path / "a.zip", max_bytes=len(ASCII_PLY)).faces) == len(FACES)
    with pytest.raises(InputError, match=f"unpacks to {len(ASCII_PLY):,} bytes"):
        read_static(tmp_path / "a.zip", max_bytes=len(ASCII_PLY) - 1)


@pytest.mark.parametrize("value", [0, -1, 1.5, True])
def test_limit_is_a_positive_integer(tmp_path, value):
    (tmp_path / "a.ply").write_bytes(ASCII_PLY)
    for read in (
        lambda: read_static(tmp_path / "a.ply", max_bytes=value),
        lambda: datasets.read_step(tmp_path / "a.ply", tmp_path / "a.ply", max_bytes=value),
    ):
        with pytest.raises(ValueError, match=r"max_bytes is .*; expected a positive integer"):
            read()


# ---- On the command line ---------------------------------------------------------------------------------------------


@pytest.fixture
def falling(tmp_path):
    """A triangle that falls through a floor halfway, and what writes the floor in some format."""
    triangle = np.array([[0.1, 0.1, 1.0], [0.3, 0.1, 1.0], [0.1, 0.3, 1.0]])
    write_mesh(tmp_path / "start.ply", triangle, [[0, 1, 2]])
    write_mesh(tmp_path / "end.ply", triangle - [0, 0, 2.0], [[0, 1, 2]])
    return tmp_path


def _run(folder, obstacle, *options):
    return main([*map(str, ["run", folder / "start.ply", folder / "end.ply", "--static", obstacle]), *options])


# The first face is far away; the second is the floor.
_FLOOR = ["9 9 9", "8 9 9", "9 8 9", "-1 -1 0", "3 -1 0", "-1 3 0"]
_FLOORS = {
    "floor.ply": _HEADER.replace("vertex 12", "vertex 6").replace("face 6", "face 2").encode()
    + _lines(*_FLOOR, "3 0 1 2", "3 3 4 5"),
    "floor.off": _lines("OFF", "6 2 0", *_FLOOR, "3 0 1 2", "3 3 4 5"),
    "floor.obj": _lines(*("v " + row for row in _FLOOR), "f 1 2 3", "f 4 5 6"),
}


@pytest.mark.parametrize("name", _FLOORS)
def test_obstacle_that_lost_its_last_face_does_not_pass_for_nothing_touches(falling, capfd, name):
    path = falling / name
    path.write_bytes(_FLOORS[name])
    assert _run(falling, path) == 0
    (toi,) = re.findall(r"scene toi  (\S+)", capfd.readouterr().out)
    assert 0.5 - 1e-5 <= float(toi) <= 0.5  # the tolerance, 1e-6 of a scene ten units long, over the speed of two
    for cut in (_FLOORS[name][:-4], _FLOORS[name].rsplit(b"\n", 2)[0] + b"\n"):
        if name == "floor.obj" and cut.endswith(b"\n"):
            continue  # no OBJ file says how many faces it has
        path.write_bytes(cut)
        assert _run(falling, path) == 2
        captured = capfd.readouterr()
        assert captured.out == "" and captured.err.count("\n") == 1 and str(path) in captured.err


def test_max_bytes_is_named_by_the_error_and_raises_the_limit(falling, capfd):
    path = falling / "floor.zip"
    path.write_bytes(_zipped({"floor.ply": _FLOORS["floor.ply"]}))
    assert _run(falling, path, "--max-bytes", "100") == 2
    assert "raise it with --max-bytes" in capfd.readouterr().err
    assert _run(falling, path, "--max-bytes", "1000", "--quiet") == 0
    for value in ("0", "-5", "many"):
        assert _run(falling, path, "--max-bytes", value) == 2
        captured = capfd.readouterr().err
        assert ("max_bytes" in captured or "--max-bytes" in captured) and captured.count("\n") == 1


_HOSTILE = "bad\x1b]0;title\x07\x1b[31m\x9b2J\u202e\nsecond line é.ply"
_SHOWN = r"bad\x1b]0;title\x07\x1b[31m\x9b2J\u202e\nsecond line é.ply"


def test_file_names_reach_the_terminal_without_their_escape_codes(falling, capfd):
    (falling / _HOSTILE).write_bytes(_FLOORS["floor.ply"])
    assert _run(falling, falling / _HOSTILE, "--output", str(falling / "a\x1b[2J.json")) == 0
    captured = capfd.readouterr()
    assert "\x1b" not in captured.out and "\x07" not in captured.out and "\x9b" not in captured.out
    assert captured.out.count(_SHOWN) == 2  # in the table and in the first contact
    assert r"a\x1b[2J.json" in captured.out
    # A body has one name, which everything that is written calls it by.
    data = json.loads((falling / "a\x1b[2J.json").read_text())
    assert [body["name"] for body in data["bodies"]] == ["start.ply", _SHOWN]


@pytest.mark.parametrize("content", [b"not a mesh", _FLOORS["floor.ply"][:-9], None])
def test_errors_reach_the_terminal_without_escape_codes(falling, capfd, content):
    path = falling / _HOSTILE
    if content is not None:
        path.write_bytes(content)
    assert _run(falling, path) == 2
    error = capfd.readouterr().err
    assert error.endswith("\n") and printable(error[:-1]) == error[:-1]
    assert _SHOWN in error


def test_content_reaches_the_terminal_without_escape_codes(falling, capfd):
    for name, content in {
        "a.obj": b"v 0 0 \x1b[31m\n",
        "b.off": b"OFF\x1b[2J\n",
        "c.ply": b"ply\nformat \x1b[2J\n",
        "d.zip": _zipped({"\x1b[2J.vtk": b""}),
        "e.gltf": json.dumps({"extensionsRequired": ["\x1b[2J"]}).encode(),
        "f.\x1b[2J": b"",
    }.items():
        (falling / name).write_bytes(content)
        assert _run(falling, falling / name) == 2
        error = capfd.readouterr().err
        assert printable(error[:-1]) == error[:-1] and "x1b" in error


def test_argument_reaches_the_terminal_without_escape_codes(capfd):
    assert main(["run", "a.ply", "b.ply", "--tolerance", "\x1b[31m"]) == 2
    assert "\x1b" not in capfd.readouterr().err


def test_printable_text_stays_as_it_is():
    assert printable("größe 高さ αβγ.ply") == "größe 高さ αβγ.ply"
    assert printable("a\tb\r\n\x7f\udc80") == r"a\tb\r\n\x7f\udc80"


# ---- The public data -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("limit", [None, 0])
@pytest.mark.parametrize("rational", ["{0},1", "1,{0}", "-{0},1", "{0},{0}"])
def test_numbers_of_millions_of_digits_are_refused_at_once(tmp_path, rational, limit):
    path = tmp_path / "vf.csv"
    row = rational.format("7" * 10_000_000)
    path.write_text("1,2,3,4,5,8\n" * 3 + f"1,2,{row},5,8\n" + "1,2,3,4,5,8\n" * 4)
    before = sys.get_int_max_str_digits()
    if limit is not None:
        sys.set_int_max_str_digits(limit)
    try:
        with pytest.raises(ValueError, match=r"vf\.csv, line 4: .* is too long; expected an integer of at most 10,000"):
            datasets.read_queries(path)
    finally:
        sys.set_int_max_str_digits(before)


def test_number_of_as_many_digits_as_may_be_is_read(tmp_path):
    path = tmp_path / "vf.csv"
    path.write_text(f"1,2,-3{'0' * 9999},1{'0' * 9999},5,8\n" * 8)
    assert (datasets.read_queries(path).points_t0[:, :, 1] == -3.0).all()


@pytest.mark.parametrize("truth", [False, True])
def test_queries_cut_at_any_byte_are_refused_or_fewer_whole_queries(tmp_path, truth):
    points = np.random.default_rng(1).standard_normal((2, 4, 3))
    path = tmp_path / "vf.csv"
    datasets.write_queries(path, points, points + 1.0, np.array([True, False]) if truth else None)
    data = path.read_bytes()
    # The last denominator: a power of two that was cut may be one again, and published files end without a line end.
    last = len(data) if truth else data.rindex(b",") + 1
    half = len(b"".join(data.splitlines(keepends=True)[:8]))
    for length in range(last):
        path.write_bytes(data[:length])
        try:
            queries = datasets.read_queries(path)
        except ValueError:
            continue
        at_denominator = not truth and half - len(data[:half].rsplit(b",", 1)[1]) < length < half - 1
        if not at_denominator:
            assert np.array_equal(queries.points_t1, points[: len(queries)] + 1.0)


@pytest.mark.parametrize("kind", ["truth", "boxes"])
def test_lists_cut_at_any_byte_are_refused(tmp_path, kind):
    path = tmp_path / "list.json"
    write, read = (
        (datasets.write_truth, datasets.read_truth) if kind == "truth" else (datasets.write_boxes, datasets.read_boxes)
    )
    write(path, np.array([True, False, True]) if kind == "truth" else np.array([[1, 20], [3, 40]]))
    data = path.read_bytes()
    for length in range(len(data)):
        path.write_bytes(data[:length])
        with pytest.raises(ValueError, match=r"list\.json"):
            read(path)


def test_frames_of_the_public_data_cut_at_any_byte_are_refused(tmp_path):
    step = datasets.SimulationStep(VERTICES, VERTICES + 1.0, FACES)
    datasets.write_step(tmp_path / "1.ply", tmp_path / "2.ply", step)
    data = (tmp_path / "2.ply").read_bytes()
    for length in range(len(data)):
        (tmp_path / "2.ply").write_bytes(data[:length])
        with pytest.raises(ValueError, match=r"2\.ply"):
            datasets.read_step(tmp_path / "1.ply", tmp_path / "2.ply")
