"""Frames of a sequence from files: natural order, bodies by name, caches of NumPy, series of ParaView and XDMF."""

import sys
from pathlib import Path

import numpy as np
import pytest

from ccd_warp._files.archive import MAX_BYTES
from ccd_warp._files.frames import write_mesh
from ccd_warp._files.mesh import read_mesh
from ccd_warp._files.natural import grouped_frames, natural_key, series_name
from ccd_warp._files.opened import noted_files
from ccd_warp._files.series import find_series
from ccd_warp._input.messages import InputError

FACES = np.array([[0, 1, 2], [0, 2, 3]])
# Thirds, so that a format that rounds is seen.
POSITIONS = np.random.default_rng(0).uniform(size=(3, 4, 3)) / 3.0


def _open(*paths, **options):
    return find_series([Path(path) for path in paths], max_bytes=MAX_BYTES, **options)


def _check(series, positions=POSITIONS):
    for k in range(len(positions)):
        mesh = series.read(k)
        assert np.array_equal(mesh.vertices, positions[k]) and mesh.faces.tolist() == FACES.tolist()
    assert len(series.labels) == len(positions)


def test_natural_order_is_that_of_a_reader():
    names = ["f10.ply", "f9.ply", "f010b.ply", "g.ply", "2.ply", "10.ply"]
    assert sorted(names, key=natural_key) == ["2.ply", "10.ply", "f9.ply", "f10.ply", "f010b.ply", "g.ply"]


def test_frames_are_grouped_by_what_their_names_share():
    names = ["v2_cloth_10.ply", "v2_cloth_9.ply", "v2_ball_9.ply", "v2_ball_10.ply"]
    cloth, ball = grouped_frames([Path(name) for name in names])
    assert [path.name for path in cloth] == ["v2_cloth_9.ply", "v2_cloth_10.ply"]
    assert [path.name for path in ball] == ["v2_ball_9.ply", "v2_ball_10.ply"]
    assert series_name(cloth) == "v2_cloth" and series_name([Path("drop/7.ply")]) == "drop"


def test_frames_of_different_times_are_not_paired():
    """Cloth 1 to 2 and ball 0 to 1, as two programs number them: pairs in their order would be of different times."""
    names = ["cloth_1.ply", "cloth_2.ply", "ball_0.ply", "ball_1.ply"]
    with pytest.raises(InputError, match=r"ball_0\.ply and cloth_1\.ply would be of one time; number the files"):
        grouped_frames([Path(name) for name in names])


def test_frames_without_numbers_keep_the_order_in_which_they_are_given():
    there_and_back = [Path("start.ply"), Path("end.ply"), Path("start.ply")]
    assert grouped_frames(there_and_back) == [there_and_back]


def test_files_of_a_folder_are_one_series_for_each_body(tmp_path):
    for k, frame in enumerate(POSITIONS):
        write_mesh(tmp_path / f"a_{8 + k}.ply", frame, FACES)
        write_mesh(tmp_path / f"b_{8 + k}.ply", frame + 1.0, FACES)
    (tmp_path / "drop.png").write_bytes(b"")
    a, b = _open(tmp_path)
    _check(a)
    _check(b, POSITIONS + 1.0)
    assert (a.name, b.name, a.labels[2]) == ("a", "b", "a_10.ply")


def test_collection_without_a_file_is_refused_before_the_work(tmp_path):
    from ccd_warp._cli.command import main

    for k in range(2):
        write_mesh(tmp_path / f"a_{k}.ply", POSITIONS[k], FACES)
    entries = "".join(f'<DataSet timestep="{k}" file="a_{k}.ply"/>' for k in range(3))
    (tmp_path / "a.pvd").write_text(f'<VTKFile type="Collection"><Collection>{entries}</Collection></VTKFile>')
    assert main(["sequence", str(tmp_path / "a.pvd"), "--output", str(tmp_path / "out"), "--quiet"]) == 2
    assert not list(tmp_path.glob("out/*.csv"))


def test_caches_of_positions(tmp_path):
    np.savez(tmp_path / "both.npz", positions=POSITIONS, faces=FACES)
    np.savez_compressed(tmp_path / "bare.npz", positions=POSITIONS)
    write_mesh(tmp_path / "faces.ply", POSITIONS[0], FACES)
    both, bare = _open(tmp_path / "both.npz", tmp_path / "bare.npz", faces=tmp_path / "faces.ply")
    _check(both)
    _check(bare)
    assert both.labels == ["both.npz[0]", "both.npz[1]", "both.npz[2]"]


@pytest.mark.parametrize(
    "arrays, message",
    [
        ({"faces": FACES}, "holds 'faces'; expected 'positions'"),
        ({"positions": POSITIONS}, "holds no 'faces'; add them, or give a mesh that has them with --faces"),
        ({"positions": POSITIONS[0], "faces": FACES}, r"'positions' is float64 of shape \(4, 3\)"),
        ({"positions": POSITIONS, "faces": FACES + 0.5}, "'faces' is float64"),
        ({"positions": POSITIONS, "faces": FACES + 2}, r"\[0\]: face 0 is \[2, 3, 4\], but the file has 4 vertices"),
        ({"positions": np.full((2, 4, 3), np.nan), "faces": FACES}, "are not finite"),
        ({"positions": POSITIONS[:1], "faces": FACES}, "has 1 frame; expected two or more"),
        ({"positions": np.array([None, {}]), "faces": FACES}, "cannot be read as a NumPy archive"),
    ],
)
def test_caches_that_hold_something_else_are_refused(tmp_path, arrays, message):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(InputError, match=message) as caught:
        _open(tmp_path / "a.npz")[0].read(0)
    assert "\n" not in str(caught.value)


def test_cache_that_is_cut_or_unpacks_to_too_much_is_refused(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", positions=np.zeros((4, 1000, 3)), faces=FACES)
    with pytest.raises(InputError, match=r"unpacks to .* bytes, and the limit is 9,000; raise it with --max-bytes"):
        find_series([tmp_path / "a.npz"], max_bytes=9000)
    (tmp_path / "b.npz").write_bytes((tmp_path / "a.npz").read_bytes()[:-30])
    with pytest.raises(InputError, match="cannot be read as a NumPy archive"):
        _open(tmp_path / "b.npz")


@pytest.fixture
def meshio():
    return pytest.importorskip("meshio", reason="the extra examples is not installed")


def _cells(meshio, frame):
    return meshio.Mesh(frame, [("triangle", FACES[:1]), ("triangle", FACES[1:])])


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
def test_frames_of_vtk_are_read_bit_for_bit(tmp_path, meshio, suffix):
    for k, frame in enumerate(POSITIONS):
        _cells(meshio, frame).write(tmp_path / f"sheet_{k}{suffix}")
    (series,) = _open(tmp_path)
    _check(series)
    assert series.name == "sheet"


def test_quads_are_two_triangles_and_other_cells_are_refused(tmp_path, meshio):
    meshio.Mesh(POSITIONS[0], [("quad", [[0, 1, 2, 3]])]).write(tmp_path / "quad.vtu")
    assert read_mesh(tmp_path / "quad.vtu", MAX_BYTES).faces.tolist() == FACES.tolist()
    meshio.Mesh(POSITIONS[0], [("tetra", [[0, 1, 2, 3]])]).write(tmp_path / "tetra.vtu")
    with pytest.raises(InputError, match="holds cells of the type tetra; expected triangles and quads"):
        read_mesh(tmp_path / "tetra.vtu", MAX_BYTES)


@pytest.mark.parametrize("name", ["a.vtu", "a.vtk", "a.xdmf"])
def test_vtk_and_xdmf_files_that_are_cut_are_refused_at_every_byte(tmp_path, meshio, name):
    options = {"data_format": "XML"} if name == "a.xdmf" else {}
    _cells(meshio, POSITIONS[0]).write(tmp_path / name, **options)
    content = (tmp_path / name).read_bytes()
    for end in range(0, len(content.rstrip()) - 1, 7):
        (tmp_path / name).write_bytes(content[:end])
        with pytest.raises(InputError) as caught:
            read_mesh(tmp_path / name, MAX_BYTES)
        assert "\n" not in str(caught.value)


def test_collection_of_paraview_is_in_the_order_of_its_times_with_a_body_for_each_part(tmp_path, meshio):
    entries = []
    for k in (2, 0, 1):
        for part, name in enumerate("ab"):
            _cells(meshio, POSITIONS[k] + part).write(tmp_path / f"{name}_{9 - k}.vtu")
            entries.append(f'<DataSet timestep="{0.5 * k}" part="{part}" file="{name}_{9 - k}.vtu"/>')
    text = f'<VTKFile type="Collection"><Collection>{"".join(entries)}</Collection></VTKFile>'
    (tmp_path / "all.pvd").write_text(text)
    a, b = _open(tmp_path / "all.pvd")
    _check(a)
    _check(b, POSITIONS + 1.0)
    assert (a.name, b.name) == ("a", "b")
    for damaged in (text[:-5], text.replace("Collection", "Other"), text.replace("file=", "name=")):
        (tmp_path / "all.pvd").write_text(damaged)
        with pytest.raises(InputError, match=r"all\.pvd: "):
            _open(tmp_path / "all.pvd")


@pytest.mark.parametrize("data_format", ["XML", "HDF"])
def test_series_of_xdmf_moves_by_its_displacements(tmp_path, meshio, data_format, monkeypatch):
    if data_format == "HDF":
        pytest.importorskip("h5py", reason="the extra formats is not installed")
    monkeypatch.chdir(tmp_path)
    moved = np.round(POSITIONS * 8.0) / 8.0  # sums and text are exact
    with meshio.xdmf.TimeSeriesWriter("a.xdmf", data_format=data_format) as writer:
        writer.write_points_cells(moved[0], [("triangle", FACES)])
        for k, frame in enumerate(moved):
            writer.write_data(k, point_data={"u": frame - moved[0], "p": np.zeros(4)})
    (series,) = _open(tmp_path / "a.xdmf", displacement="u")
    _check(series, moved)
    if data_format == "HDF":
        with noted_files() as noted:
            series.read(2)
        assert {Path(name).name for name, *_ in noted} == {"a.h5"}
    with pytest.raises(InputError, match=r"the same geometry; expected --displacement NAME .* and found 'u'"):
        _open(tmp_path / "a.xdmf")
    with pytest.raises(InputError, match="has no field 'v' at its points; expected one of them: 'u', 'p'"):
        _open(tmp_path / "a.xdmf", displacement="v")[0].read(0)


def test_series_of_xdmf_with_a_collection_for_each_field(tmp_path):
    def item(kind, values):
        values = np.asarray(values)
        shape = " ".join(map(str, values.shape))
        text = " ".join(map(repr, values.ravel().tolist()))
        return f'<DataItem DataType="{kind}" Precision="8" Dimensions="{shape}" Format="XML">{text}</DataItem>'

    mesh = (
        f'<Grid><Topology TopologyType="Triangle">{item("Int", FACES)}</Topology>'
        f'<Geometry GeometryType="XYZ">{item("Float", POSITIONS[0])}</Geometry></Grid>'
    )
    times = '<Grid><Time Value="{}"/><Attribute Name="{}" Center="Node">{}</Attribute></Grid>'
    fields = "".join(
        '<Grid GridType="Collection" CollectionType="Temporal">'
        + "".join(times.format(k, name, item("Float", values)) for k in range(3))
        + "</Grid>"
        for name, values in (("u", POSITIONS[1]), ("p", np.zeros(4)))
    )
    text = f'<Xdmf Version="3.0"><Domain>{mesh}{fields}</Domain></Xdmf>'
    (tmp_path / "a.xdmf").write_text(text)
    (series,) = _open(tmp_path / "a.xdmf", displacement="u")
    assert np.array_equal(series.read(2).vertices, POSITIONS[0] + POSITIONS[1])
    for old, new in (('Value="2"', 'Value="3"'), ("<Grid>", '<Grid GridType="Tree">')):  # of the mesh beside them, too
        (tmp_path / "a.xdmf").write_text(text.replace(old, new, 1))
        with pytest.raises(InputError, match="temporal collections of the same times"):
            _open(tmp_path / "a.xdmf", displacement="u")


def test_series_of_xdmf_with_a_geometry_for_each_time(tmp_path, meshio):
    def item(values, kind):
        shape = " ".join(map(str, values.shape))
        text = " ".join(map(repr, values.ravel().tolist()))
        return f'<DataItem DataType="{kind}" Precision="8" Dimensions="{shape}" Format="XML">{text}</DataItem>'

    grids = "".join(
        f'<Grid GridType="Uniform"><Topology TopologyType="Triangle">{item(FACES, "Int")}</Topology>'
        f'<Geometry GeometryType="XYZ">{item(frame, "Float")}</Geometry><Time Value="{k}"/></Grid>'
        for k, frame in enumerate(POSITIONS)
    )
    collection = f'<Grid GridType="Collection" CollectionType="Temporal">{grids}</Grid>'
    (tmp_path / "a.xmf").write_text(f'<Xdmf Version="3.0"><Domain>{collection}</Domain></Xdmf>')
    (series,) = _open(tmp_path / "a.xmf")
    _check(series)


def test_without_h5py_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    text = '<DataItem Dimensions="3 3" DataType="{}" Format="HDF">a.h5:/a</DataItem>'
    (tmp_path / "a.xdmf").write_text(
        f'<Xdmf><Domain><Grid><Topology Type="Triangle">{text.format("Int")}</Topology>'
        f"<Geometry>{text.format('Float')}</Geometry></Grid></Domain></Xdmf>"
    )
    with pytest.raises(InputError, match=r"lie in an HDF5 file; install with: pip install 'ccd-warp\[formats\]'"):
        read_mesh(tmp_path / "a.xdmf", MAX_BYTES)
