"""Tables of poses: what is refused with line and column, and sequences made of them."""

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd

COLUMNS = ["t", "body", "px", "py", "pz", "qx", "qy", "qz", "qw"]
HEADER = ",".join(COLUMNS)
ROWS = ["0,arm,1,2,3,0,0,0,1", "0.5,arm,1,2,3.25,0,0,0.6,0.8", "2e0,arm,1,2,4,0,0,1,0"]
POSES = [[float(x) for x in row.split(",")[2:]] for row in ROWS]


@pytest.fixture
def read(tmp_path):
    """Reads a table for two boxes, called base and arm."""
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    corners = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in box.vertices.tolist())
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in (box.faces - 8).tolist())
    (tmp_path / "two.obj").write_text("".join(f"o {name}\n{corners}{faces}" for name in ("base", "arm")))

    def read_table(rows, **options):
        (tmp_path / "poses.csv").write_text("\n".join(rows))
        return ccd.read_poses(tmp_path / "two.obj", tmp_path / "poses.csv", **options)

    return read_table


def test_rows_in_any_order_are_poses_by_time(read):
    for rows in (ROWS, [HEADER, "# a remark", "", *reversed(ROWS)]):
        sequence = read(rows, path="screw")
        assert sequence.times.tolist() == [0.0, 0.5, 2.0] and len(sequence) == 3 and len([*sequence.steps()]) == 2
        assert sequence.poses[:, 0].tolist() == POSES and np.array_equal(sequence[1], sequence.poses[1])
    # the body without poses is static, and in the world
    assert sequence.mesh.names == ("base", "arm") and sequence.mesh.static.tolist() == [True, False]
    assert sequence.mesh.rigid.tolist() == [False, True] and [*map(len, sequence)] == [1, 1, 1]
    motion = sequence.step(-1)
    assert motion.path == "screw" and np.allclose(motion.poses_t1, sequence.poses[2])


@pytest.mark.parametrize(
    "rows, message",
    [
        ([ROWS[0], "1,arm,1,2,3,0,0,0,0"], "line 2, columns qx qy qz qw are all 0; expected a quaternion"),
        ([ROWS[0], "1,arm,1,2,3,0,0,1"], "line 2, has 8 columns; expected t, body, px"),
        (["0,leg,1,2,3,0,0,0,1", "1,leg,1,2,3,0,0,0,1"], "holds leg, and no body is called so; expected one of base"),
        ([HEADER, ROWS[0], "1,arm,1,2,3,0,0,nan,1"], "line 3, column qz is 'nan'; expected a finite number"),
        ([*ROWS, *(row.replace("arm", "1") for row in ROWS)], "line 4, is another pose of body 1 at t = 0"),
        ([*ROWS, "0,arm,1,2,3,0,0,0,1"], "line 4, is another pose of body arm at t = 0, after line 1"),
        ([*ROWS[:2], '2,"arm,1,2,4,0,0,1,0'], "line 3, unexpected end of data"),
    ],
)
def test_a_damaged_table_is_refused_with_line_and_column(read, rows, message):
    with pytest.raises(ValueError, match=r"poses\.csv") as refused:
        read(rows)
    assert message in str(refused.value) and "\n" not in str(refused.value)
