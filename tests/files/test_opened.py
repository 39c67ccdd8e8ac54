"""Files that are no regular ones, or too large, are refused before they are read, wherever a mesh refers to them."""

import json
import os

import numpy as np
import pytest
import trimesh

from ccd_warp._files.archive import MAX_BYTES
from ccd_warp._files.frames import write_mesh
from ccd_warp._files.mesh import read_mesh
from ccd_warp._files.opened import noted_files
from ccd_warp._files.series import find_series
from ccd_warp._input.messages import InputError

_ITEM = '<DataItem DataType="{}" Precision="8" Dimensions="{}" Format="{}">{}</DataItem>'
_CELLS = _ITEM.format("Int", "1 3", "XML", "0 1 2")


def _xdmf(folder, how, place):
    text = (
        f'<Xdmf Version="3.0"><Domain><Grid><Topology TopologyType="Triangle">{_CELLS}</Topology>'
        f'<Geometry GeometryType="XYZ">{_ITEM.format("Float", "3 3", how, place)}</Geometry></Grid></Domain></Xdmf>'
    )
    (folder / "a.xdmf").write_text(text)
    return folder / "a.xdmf"


def _gltf(folder):
    """A glTF whose buffer is the file ``data``."""
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    files = trimesh.Scene(mesh).export(file_type="gltf", merge_buffers=True)
    tree = json.loads(files.pop("model.gltf"))
    tree["buffers"][0]["uri"] = "data"
    (folder / "a.gltf").write_text(json.dumps(tree))
    return folder / "a.gltf", next(iter(files.values()))


def _opened(path):
    """Read one mesh, or all that a cache holds."""
    if path.suffix in (".npz", ".pvd", ".xmf"):
        return find_series([path], max_bytes=MAX_BYTES)
    return read_mesh(path, MAX_BYTES)


def _places(folder):
    """Each place of a file: the file to read, and the one that is put there."""
    names = ("a.ply", "a.obj", "a.stl", "a.zip", "a.vtu", "a.vtk", "a.npz", "a.pvd", "a.xmf")
    yield from ((folder / name, folder / name) for name in names)
    yield _gltf(folder)[0], folder / "data"
    yield _xdmf(folder, "Binary", "data"), folder / "data"


@pytest.mark.parametrize("kind", ["pipe", "device", "3 GiB"])
def test_what_is_no_file_of_a_usual_size_is_refused_at_once(tmp_path, kind):
    for path, place in _places(tmp_path):
        if kind == "pipe":
            os.mkfifo(place)
        elif kind == "device":
            place.symlink_to("/dev/zero")
        else:
            with place.open("wb") as file:
                file.truncate(3 << 30)  # sparse
        expected = (
            "it has 3,221,225,472 bytes, and the limit is 1,073,741,824 bytes; raise it with --max-bytes"
            if kind == "3 GiB"
            else "a folder, a pipe or a device; expected a regular file"
        )
        with pytest.raises(InputError, match=expected) as caught:
            _opened(path)
        assert str(place) in str(caught.value) and "\n" not in str(caught.value)
        place.unlink()


@pytest.mark.parametrize("kind", ["pipe", "3 GiB"])
def test_hdf5_file_that_is_a_pipe_or_holds_nothing(tmp_path, kind):
    pytest.importorskip("h5py", reason="the extra formats is not installed")
    path = _xdmf(tmp_path, "HDF", "data.h5:/points")
    if kind == "pipe":
        os.mkfifo(tmp_path / "data.h5")
    else:
        with (tmp_path / "data.h5").open("wb") as file:
            file.truncate(3 << 30)
    with pytest.raises(InputError, match=r"data\.h5: no such file but" if kind == "pipe" else "cannot be read"):
        read_mesh(path, MAX_BYTES)


def test_limit_that_is_raised_holds_for_plain_files(tmp_path):
    with (tmp_path / "a.stl").open("wb") as file:
        file.truncate((1 << 30) + 1)
    with pytest.raises(InputError, match="the limit is 1,073,741,824 bytes"):
        read_mesh(tmp_path / "a.stl", 1)


def test_all_files_of_a_frame_are_noted(tmp_path):
    path, data = _gltf(tmp_path)
    (tmp_path / "data").write_bytes(data)
    np.eye(3).tofile(tmp_path / "points")
    write_mesh(tmp_path / "b.ply", np.eye(3), np.array([[0, 1, 2]]))
    with noted_files() as outer:
        for each, names in (
            (path, {"a.gltf", "data"}),
            (_xdmf(tmp_path, "Binary", "points"), {"a.xdmf", "points"}),
            (tmp_path / "b.ply", {"b.ply"}),
        ):
            with noted_files() as noted:
                read_mesh(each, MAX_BYTES)
            assert {name for name, _, _ in noted} == {str(tmp_path / name) for name in names}
    assert len({name for name, _, _ in outer}) == 5


def test_buffer_is_the_file_that_is_named(tmp_path):
    """And none of the same name elsewhere; blanks in its name are escaped."""
    path, data = _gltf(tmp_path)
    (tmp_path / "data").write_bytes(data)
    path.write_text(path.read_text().replace('"data"', '"gone/data"'))
    with pytest.raises(InputError, match="no such file"):
        read_mesh(path, MAX_BYTES)
    (tmp_path / "my data").write_bytes(data)
    path.write_text(path.read_text().replace('"gone/data"', '"my%20data"'))
    assert len(read_mesh(path, MAX_BYTES).faces) == 1
