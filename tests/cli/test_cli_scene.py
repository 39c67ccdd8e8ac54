"""What the command line says of the mesh beside its files: pairs that are left out, and surfaces of volumes."""

import json
import re

import numpy as np
import pytest

from ccd_warp._cli.command import main
from ccd_warp._files.frames import write_mesh

SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.fixture
def sheets(tmp_path):
    """A sheet whose corner touches a wall, which falls on a floor one below, within a step of two."""
    sheet = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    write_mesh(tmp_path / "start.ply", sheet, SQUARE)
    write_mesh(tmp_path / "end.ply", sheet - [0.0, 0.0, 2.0], SQUARE)
    upright = np.array([[0.0, -9.0, -9.0], [0.0, 9.0, -9.0], [0.0, 9.0, 9.0], [0.0, -9.0, 9.0]])
    write_mesh(tmp_path / "wall.ply", upright, SQUARE)
    write_mesh(
        tmp_path / "floor.ply", 9.0 * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) - [0, 0, 1], SQUARE
    )
    return tmp_path


def _run(folder, *options) -> int:
    files = [
        folder / "start.ply",
        folder / "end.ply",
        "--static",
        folder / "wall.ply",
        "--static",
        folder / "floor.ply",
    ]
    return main([str(argument) for argument in ("run", *files, *options)])


def _result(folder, *options) -> dict:
    assert _run(folder, "--quiet", "--output", folder / "result.json", *options) == 0
    return json.loads((folder / "result.json").read_text())


def test_contacts_of_the_first_frame_are_left_out_and_counted(sheets, capfd):
    assert _result(sheets)["toi"] == 0.0
    result = _result(sheets, "--ignore-start-contacts")
    assert 0.499 < result["toi"] <= 0.5
    assert _run(sheets, "--ignore-start-contacts") == 0
    out = capfd.readouterr().out
    (line,) = [line for line in out.splitlines() if line.startswith("left out")]
    assert "pairs that touch in the first frame (--ignore-start-contacts)" in line and result["left_out"] in line
    assert int(line.split(";")[1].split()[0]) == len(_result(sheets, "--t-max", "1e-9")["contacts"])
    sheet = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]) + [1e-7, 0.0, 0.0]
    write_mesh(sheets / "start.ply", sheet, SQUARE)  # a rounding of float32 beside the wall, and into it
    write_mesh(sheets / "end.ply", sheet - [2e-6, 0.0, 2.0], SQUARE)
    assert 0.499 < _result(sheets, "--ignore-start-contacts")["toi"] <= 0.5


def test_edges_that_cross_in_the_first_frame_are_left_out_and_counted(sheets, capfd):
    sheet = np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 1.0, 0.0], [-0.5, 1.0, 0.0]])
    for name in ("start", "end"):
        write_mesh(sheets / f"{name}.ply", sheet, SQUARE)
    assert _run(sheets, "--fail-on-contact") == 1
    assert "so surfaces cross" in capfd.readouterr().out
    assert _run(sheets, "--fail-on-contact", "--ignore-start-contacts") == 0
    out = capfd.readouterr().out
    assert (
        "edges that pass through a face in the first frame (--ignore-start-contacts)" in out
        and "so surfaces" not in out
    )


TEXT = """# what touches by design
bodies, start.ply, wall.ply

bodies,0,"floor.ply"
"""


@pytest.mark.parametrize("name", ["pairs.txt", "pairs.npz", "pairs.npy"])
def test_excluded_pairs_come_from_text_and_arrays(sheets, name, capfd):
    path = sheets / name
    everything = np.array([(a, b) for a in range(4) for b in range(4, 12)])
    if name.endswith("txt"):
        path.write_text(TEXT, encoding="utf-8")
    elif name.endswith("npz"):
        np.savez(path, vertices=everything, bodies=[[0, 1]])
    else:
        np.save(path, everything)
    assert _run(sheets, "--exclude", path, "--fail-on-contact", "--no-self-collision") == 0
    out = capfd.readouterr().out
    assert ("2 pairs of bodies (--exclude)" if name.endswith("txt") else "32 pairs of vertices (--exclude)") in out


def test_rings_are_excluded(sheets, capfd):
    assert _run(sheets, "--exclusion-rings", "3") == 0
    assert "pairs that fewer than 3 edges connect (--exclusion-rings)" in capfd.readouterr().out


@pytest.mark.parametrize(
    "text, message",
    [
        ("bodies,start.ply", "line 1 is 'bodies,start.ply'; expected rows KEY,A,B"),
        ("\nfaces,1,2", "line 2 is 'faces,1,2'; expected rows KEY,A,B"),
        (
            "bodies,start.ply,nobody",
            "line 1 is 'bodies,start.ply,nobody'; .*; bodies are start.ply, wall.ply, floor.ply",
        ),
        ("vertices,1,1.5", "line 1 is 'vertices,1,1.5'"),
        ("vertices,1,99", r"exclude_pairs\['vertices'\] holds vertex 99"),
        ("vertices,1,\udcff", "codec can't decode"),
    ],
)
def test_a_file_of_other_pairs_is_refused_with_its_line(sheets, text, message, capfd):
    (sheets / "pairs.txt").write_bytes(text.encode("utf-8", "surrogateescape"))
    assert _run(sheets, "--exclude", sheets / "pairs.txt") == 2
    error = capfd.readouterr().err
    assert error.startswith(f"ccd-warp: error: --exclude {sheets}/pairs.txt: ") and error.count("\n") == 1
    assert re.search(message, error)


@pytest.mark.parametrize("name, content", [("none.txt", None), ("a.npz", b"PK"), ("a.npy", b"\x93NUMPY")])
def test_a_damaged_file_of_pairs_is_refused(sheets, name, content, capfd):
    if content is not None:
        (sheets / name).write_bytes(content)
    assert _run(sheets, "--exclude", sheets / name) == 2
    assert capfd.readouterr().err.count("\n") == 1
