"""Frames of a sequence from files: natural order, bodies by name, series of ParaView and XDMF."""

import numpy as np
import pytest
from mesh_files import of_extra, of_meshio, ply

import ccd_warp as ccd

FACES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
# Thirds, so that a format that rounds is seen.
POSITIONS = np.random.default_rng(0).uniform(size=(3, 4, 3)) / 3.0
EIGHTHS = np.round(POSITIONS * 8.0) / 8.0  # whose sums and texts are exact


def write_frames(folder, *names, suffix=".ply"):
    """Write the frames, the n-th of each body moved by n, under these patterns of names."""
    for n, name in enumerate(names):
        for k, frame in enumerate(POSITIONS + n):
            path = folder / f"{name.format(8 + k)}{suffix}"
            if suffix == ".ply":
                path.write_bytes(ply(frame, FACES))
            else:
                path.write_bytes(of_meshio(path.name, of_extra("meshio").Mesh(frame, [("triangle", FACES)])))


def check(paths, *, names, positions=POSITIONS, **options):
    """What is read are the frames, a body for each name, the n-th moved by n."""
    sequence = ccd.read_sequence(paths, **options)
    assert sequence.mesh.names == names and len(sequence) == len(positions)
    for found, frame in zip(sequence, positions, strict=True):
        assert np.array_equal(found, np.concatenate([frame + n for n in range(len(names))]))
    assert np.array_equal(sequence.mesh.faces, np.concatenate([FACES + 4 * n for n in range(len(names))]))
    return sequence


def refused(paths, message, **options):
    with pytest.raises(ValueError, match=message) as caught:
        [*ccd.read_sequence(paths, **options)]
    assert "\n" not in str(caught.value)


def test_natural_order_is_that_of_a_reader(tmp_path):
    """Files 8, 9, 10 of a folder, in which other files lie, too; a body for what the names share."""
    write_frames(tmp_path, "v2_ball_{}", "v2_cloth_{}")
    (tmp_path / "drop.png").write_bytes(b"")
    assert check(tmp_path, names=("v2_ball", "v2_cloth")).labels == [f"v2_ball_{k}.ply" for k in (8, 9, 10)]


def test_frames_without_numbers_keep_the_order_in_which_they_are_given(tmp_path):
    for name, frame in (("b.ply", POSITIONS[0]), ("a.ply", POSITIONS[1])):
        (tmp_path / name).write_bytes(ply(frame, FACES))
    check([tmp_path / name for name in ("b.ply", "a.ply", "b.ply")], names=("b.ply",), positions=POSITIONS[[0, 1, 0]])


@pytest.mark.parametrize(
    "names, message",
    [
        (["cloth_1", "cloth_2", "ball_0", "ball_1"], r"ball_0\.ply and cloth_1\.ply would be of one time; number the"),
        (["a_1", "a_2", "b"], r"the frames are 2 files a_#\.ply and 1 b\.ply; each body needs one file for each frame"),
        ([], "holds no frames"),
    ],
)
def test_files_that_are_no_frames_of_bodies_are_refused(tmp_path, names, message):
    for name in names:
        (tmp_path / f"{name}.ply").write_bytes(ply())
    refused([tmp_path / f"{name}.ply" for name in names] or tmp_path, message)


def test_collection_of_paraview_is_in_the_order_of_its_times_with_a_body_for_each_part(tmp_path):
    write_frames(tmp_path, "a_{}", "b_{}", suffix=".vtu")
    check(tmp_path, names=("a", "b"))
    entry = '<DataSet timestep="{}" part="{}" file="{}_{}.vtu"/>'
    entries = "".join(entry.format(k / 2, part, "ab"[part], 8 + k) for k in (2, 0, 1) for part in range(2))
    path, text = tmp_path / "all.pvd", f'<VTKFile type="Collection"><Collection>{entries}</Collection></VTKFile>'
    path.write_text(text)
    assert check(path, names=("a", "b")).times.tolist() == [0.0, 0.5, 1.0]
    for damaged in (text[:-5], text.replace("Collection", "Other"), text.replace("file=", "name=")):
        path.write_text(damaged)
        refused(path, r"all\.pvd: ")


def test_series_of_xdmf_moves_by_its_displacements(tmp_path, monkeypatch):
    meshio, _ = of_extra("meshio"), of_extra("h5py")
    monkeypatch.chdir(tmp_path)
    with meshio.xdmf.TimeSeriesWriter("a.xdmf") as writer:  # with its numbers in a.h5
        writer.write_points_cells(EIGHTHS[0], [("triangle", FACES)])
        for k, frame in enumerate(EIGHTHS):
            writer.write_data(k, point_data={"u": frame - EIGHTHS[0], "p": np.zeros(4)})
    check(tmp_path / "a.xdmf", names=("a.xdmf",), positions=EIGHTHS, displacement="u")
    refused(tmp_path / "a.xdmf", r"the same geometry; expected --displacement NAME .* and found 'u'")
    refused(tmp_path / "a.xdmf", "has no field 'v' at its points; expected one of them: 'u', 'p'", displacement="v")


def _item(kind, values) -> str:
    shape, text = " ".join(map(str, np.shape(values))), " ".join(map(repr, np.ravel(values).tolist()))
    return f'<DataItem DataType="{kind}" Precision="8" Dimensions="{shape}" Format="XML">{text}</DataItem>'


def _grid(frame, inside="") -> str:
    topology = f'<Topology TopologyType="Triangle">{_item("Int", FACES)}</Topology>'
    return f'<Grid>{topology}<Geometry GeometryType="XYZ">{_item("Float", frame)}</Geometry>{inside}</Grid>'


def _collection(grids) -> str:
    return f'<Grid GridType="Collection" CollectionType="Temporal">{"".join(grids)}</Grid>'


def test_series_of_xdmf_with_a_geometry_for_each_time(tmp_path):
    of_extra("meshio")
    path, xdmf = tmp_path / "a.xmf", '<Xdmf Version="3.0"><Domain>{}</Domain></Xdmf>'
    series = _collection(_grid(x, f'<Time Value="{k}"/>') for k, x in enumerate(POSITIONS))
    path.write_text(xdmf.format(series))
    assert check(path, names=("a.xmf",)).times.tolist() == [0.0, 1.0, 2.0]
    path.write_text(xdmf.format(series + series))
    refused(path, "one temporal collection and one beside it")
