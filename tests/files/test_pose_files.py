"""Tables of poses: CSV and JSON, what is refused with line and column, and sequences made of them."""

import json

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd
from ccd_warp._files.poses import COLUMNS

HEADER = ",".join(COLUMNS)
ROWS = ["0,arm,1,2,3,0,0,0,1", "0.5,arm,1,2,3.25,0,0,0.6,0.8", "2e0,arm,1,2,4,0,0,1,0"]


@pytest.fixture
def folder(tmp_path):
    scene = trimesh.creation.box((1.0, 1.0, 1.0))
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in scene.vertices.tolist()]
    faces = [[f"f {a} {b} {c}" for a, b, c in (scene.faces + first).tolist()] for first in (1, 9)]
    (tmp_path / "two.obj").write_text("\n".join(["o base", *lines, *faces[0], "o arm", *lines, *faces[1], ""]))
    return tmp_path


def read(folder, text, name="poses.csv", **options):
    (folder / name).write_text(text, encoding="utf-8")
    return ccd.read_poses(folder / "two.obj", folder / name, **options)


@pytest.mark.parametrize("text", ["\n".join(ROWS), "\n".join([HEADER, "# a remark", "", *reversed(ROWS)])])
def test_rows_of_csv_in_any_order_are_poses_by_time(folder, text):
    sequence = read(folder, text, path="screw")
    assert sequence.times.tolist() == [0.0, 0.5, 2.0] and len(sequence) == 3 and len([*sequence.steps()]) == 2
    assert sequence.poses[:, 0].tolist() == [[float(x) for x in row.split(",")[2:]] for row in ROWS]
    assert np.array_equal(sequence[1], sequence.poses[1]) and [*map(len, sequence)] == [1, 1, 1]
    # the body without poses is static, and in the world
    assert sequence.mesh.names == ("base", "arm") and sequence.mesh.static.tolist() == [True, False]
    assert sequence.mesh.rigid.tolist() == [False, True]
    motion = sequence.step(-1)
    assert motion.path == "screw" and np.allclose(motion.poses_t1, sequence.poses[2])
    assert repr(sequence).startswith("PoseSequence(3 times of CollisionMesh(2 bodies")


def test_columns_in_another_order_and_bodies_by_index(folder):
    text = (
        "qw,qx,qy,qz,body,t,px,py,pz\n1,0,0,0,1,0,9,8,7\n1,0,0,0,base,0,1,0,0\n1,0,0,0,1,1,9,8,8\n1,0,0,0,base,1,2,0,0"
    )
    sequence = read(folder, text)
    assert sequence.poses[0].tolist() == [[1, 0, 0, 0, 0, 0, 1], [9, 8, 7, 0, 0, 0, 1]]  # in the order of the mesh
    assert not sequence.mesh.static.any()


def test_json_holds_the_same(folder):
    rows = [
        dict(zip(COLUMNS, [float(row.split(",")[0]), "arm", *map(float, row.split(",")[2:])], strict=True))
        for row in ROWS
    ]
    sequence = read(folder, json.dumps(rows), "poses.json")
    assert np.array_equal(sequence.poses, read(folder, "\n".join(ROWS)).poses)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([*ROWS, "3,arm,1,2,x,0,0,0,1"], "line 4, column pz is 'x'; expected a finite number"),
        ([HEADER, ROWS[0], "1,arm,1,2,3,0,0,nan,1"], "line 3, column qz is 'nan'; expected a finite number"),
        ([ROWS[0], "1_0,arm,1,2,3,0,0,0,1"], "line 2, column t is '1_0'"),
        ([ROWS[0], "1,arm,1,2,3,0,0,0,0"], "line 2, columns qx qy qz qw are all 0; expected a quaternion"),
        ([ROWS[0], "1,arm,1,2,3,0,0,1"], "line 2 has 8 columns; expected t, body, px"),
        ([ROWS[0], "1,,1,2,3,0,0,0,1"], "line 2, column body is ''; expected a name or an index"),
        ([ROWS[0], "1,leg,1,2,3,0,0,0,1"], "holds no pose of body leg at t = 0"),
        (
            ["0,leg,1,2,3,0,0,0,1", "1,leg,1,2,3,0,0,0,1"],
            "holds leg, and no body is called so; expected one of base",
        ),
        (["0,2,1,2,3,0,0,0,1", "1,2,1,2,3,0,0,0,1"], "column body holds 2, and no body is called so"),
        ([*ROWS, *(row.replace("arm", "1") for row in ROWS)], "column body holds arm and 1, which are one body"),
        ([*ROWS, "0,arm,1,2,3,0,0,0,1"], "line 4 is another pose of body arm at t = 0, after line 1"),
        (ROWS[:1], "holds poses at t = 0 alone; expected two times or more"),
        ([HEADER], "holds no poses"),
        ([*ROWS, '"0,arm'], "line 4: unexpected end of data"),
    ],
)
def test_a_damaged_table_is_refused_with_line_and_column(folder, rows, message):
    with pytest.raises(ValueError, match=r"poses\.csv") as refused:
        read(folder, "\n".join(rows))
    assert message in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[{"t": 0,\n "body"}]', "line 2, column 8: no JSON"),
        ('{"t": 0}', "holds no list"),
        ('[{"t": 0}]', "row 1 has t; expected t, body"),
        (json.dumps([dict.fromkeys(COLUMNS, 1) | {"qx": None}]), "row 1, column qx is None; expected a finite number"),
        (json.dumps([dict.fromkeys(COLUMNS, 1) | {"t": True}]), "row 1, column t is True"),
        (json.dumps([dict.fromkeys(COLUMNS, 1) | {"body": []}]), "row 1, column body is []"),
    ],
)
def test_damaged_json_is_refused(folder, text, message):
    with pytest.raises(ValueError, match=r"poses\.json") as refused:
        read(folder, text, "poses.json")
    assert message in str(refused.value)


def test_what_is_no_table_is_refused(folder):
    (folder / "poses.csv").write_bytes(b"0,arm\xff")
    with pytest.raises(ValueError, match=r"poses\.csv: no text in UTF-8 at byte 5"):
        ccd.read_poses(folder / "two.obj", folder / "poses.csv")
    with pytest.raises(ValueError, match=r"none\.csv: no such file"):
        ccd.read_poses(folder / "two.obj", folder / "none.csv")
    with pytest.raises(ValueError, match="path is 'arc'"):
        read(folder, "\n".join(ROWS), path="arc")


def test_a_soup_of_parts_moves_by_the_poses_of_each(tmp_path):
    boxes = [trimesh.creation.box().apply_translation([2.0 * k, 0, 0]) for k in range(3)]
    trimesh.util.concatenate(boxes).export(tmp_path / "three.stl")
    (tmp_path / "poses.csv").write_text("0,three.stl#0,0,0,0,0,0,0,1\n1,three.stl#0,1.5,0,0,0,0,0,1\n")
    sequence = ccd.read_poses(tmp_path / "three.stl", tmp_path / "poses.csv", split=True)
    mesh = sequence.mesh
    assert mesh.names == ("three.stl#0", "three.stl#1", "three.stl#2") and mesh.static.tolist() == [False, True, True]
    result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, motion=sequence.step(0))
    assert result.toi == pytest.approx(2 / 3) and {*result.first.body_names} == {*mesh.names[:2]}
    with pytest.raises(ValueError, match=r"three\.stl: holds no fields of cells, and is to be split by 'x'"):
        ccd.read_poses(tmp_path / "three.stl", tmp_path / "poses.csv", split="x")
