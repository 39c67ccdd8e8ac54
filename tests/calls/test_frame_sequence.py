"""Sequences of frames in Python, with the reader of the command line; and a case of fluid-structure interaction."""

import csv
import itertools
from pathlib import Path

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd
from ccd_warp._cli.command import main
from ccd_warp._files.ply import write_ply

NUM_FRAMES = 50


@pytest.fixture(scope="module")
def flag(tmp_path_factory) -> Path:
    """A flag of hexahedra, clamped in a wall, that flaps until its end meets a plate: a .pvd as a solver writes it."""
    meshio = pytest.importorskip("meshio", reason="the extra formats is not installed")
    folder = tmp_path_factory.mktemp("flag")
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    cubes = np.array(list(itertools.product(range(6), range(3), range(2))))
    nodes, index = np.unique((cubes[:, None] + corners).reshape(-1, 3), axis=0, return_inverse=True)
    nodes, entries = nodes * [2.0 / 6, 1.0 / 3, 0.05], []
    for k in range(NUM_FRAMES):
        displacement = np.outer(0.9 * np.sin(np.pi * k / 33) * (nodes[:, 0] / 2.0) ** 2, [0, 0, 1])
        mesh = meshio.Mesh(nodes, [("hexahedron", index.reshape(-1, 8))], point_data={"U": displacement})
        mesh.write(folder / f"flag_{k}.vtu")
        entries.append(f'<DataSet timestep="{0.01 * k:.2f}" part="0" file="flag_{k}.vtu"/>')
    text = f'<VTKFile type="Collection" version="0.1"><Collection>{"".join(entries)}</Collection></VTKFile>'
    (folder / "flag.pvd").write_text(text, encoding="utf-8")
    (folder / "late.pvd").write_text(text.replace('timestep="0.02"', 'timestep="0.025"'), encoding="utf-8")
    for name, sides, middle in (("wall", (1, 3, 3), (-0.5, 0.5, 0)), ("plate", (0.5, 3, 0.1), (1.9, 0.5, 0.85))):
        box = trimesh.creation.box(extents=sides)
        write_ply(folder / f"{name}.ply", box.vertices + middle, box.faces)
    return folder


@pytest.fixture(scope="module")
def sequence(flag):
    static = [flag / "wall.ply", flag / "plate.ply"]
    return ccd.read_sequence(flag / "flag.pvd", static=static, displacement="U", surface=True)


def test_many_frames_give_in_python_what_the_command_gives(flag, sequence, tmp_path, capfd):
    """The clamped edge touches the wall in every frame, and is left out; what remains is the plate."""
    assert len(sequence) == NUM_FRAMES and sequence.times.tolist() == [round(0.01 * k, 2) for k in range(NUM_FRAMES)]
    assert sequence.mesh.names == ("flag.pvd", "wall.ply", "plate.ply") and len(sequence.mesh.inner_vertices) == 10
    x0 = sequence[0]
    contacts = ccd.mesh_ccd(sequence.mesh, x0, x0).contacts
    mesh = sequence.mesh.excluding({k.name.lower(): contacts.primitives[contacts.kind == k] for k in ccd.PairKind})
    pipeline = ccd.CollisionPipeline(mesh, length_scale=mesh.length_scale)
    results = [pipeline.mesh_ccd(*ends) for ends in itertools.pairwise(sequence)]
    line = f"sequence {flag}/flag.pvd --static {flag}/wall.ply --static {flag}/plate.ply --surface --displacement U"
    assert main([*line.split(), "--output", str(tmp_path), "--ignore-start-contacts", "--fail-on-contact"]) == 1
    with (tmp_path / "steps.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["toi"]) for row in rows] == [result.toi for result in results]
    assert [int(row["contacts"]) for row in rows] == [len(result.contacts) for result in results]
    bad = [row for row in rows if np.isfinite(float(row["toi"]))]
    assert 0 < len(bad) < 20 and {row[f"body_{k}"] for row in bad for k in (0, 1)} == {"flag.pvd", "plate.ply"}
    left_out = f"left out  pairs of static bodies; {len(contacts)} pairs that touch in the first frame (--ignore-"
    assert left_out in capfd.readouterr().out


def test_frames_are_read_when_asked_for_and_each_once(flag, sequence, monkeypatch):
    read, (series,) = [], sequence._series
    of_class = type(series).read
    monkeypatch.setattr(type(series), "read", lambda self, k: read.append(k) or of_class(self, k))
    sequence[7][:] = np.nan  # what is handed out is the caller's
    assert np.array_equal(sequence[7], sequence.step(7).vertices_t0) and read == [7, 8]
    assert np.isfinite(sequence[7]).all()
    for frames in (sequence, sequence.steps()):
        read.clear()
        assert sum(1 for _ in frames) >= NUM_FRAMES - 1 and sorted(read) == list(range(NUM_FRAMES))
    assert {id(step.mesh) for step in sequence.steps()} == {id(sequence.mesh)}
    assert np.array_equal(sequence[-1], sequence.step(-1).vertices_t1)
    assert [x.tolist() for x in sequence[3:7:2]] == [sequence[3].tolist(), sequence[5].tolist()]
    for ask, k in (
        (sequence.__getitem__, NUM_FRAMES),
        (sequence.__getitem__, ~NUM_FRAMES),
        (sequence.step, NUM_FRAMES - 1),
    ):
        with pytest.raises(IndexError):
            ask(k)
    with pytest.raises(ValueError, match="the times of the bodies differ"):
        ccd.read_sequence([flag / "flag.pvd", flag / "late.pvd"], surface=True)
    assert repr(sequence).startswith("FrameSequence(50 frames of CollisionMesh(3 bodies (flag.pvd, wall.ply, plate.pl")


@pytest.fixture
def ball(tmp_path):
    """Five frames of a ball that falls, as .ply and .stl; in the last two as .stl two vertices are in one place."""
    shape = trimesh.creation.icosphere(subdivisions=1, radius=0.5)
    positions = shape.vertices - [[[0.0, 0.0, 0.5 * k]] for k in range(5)]
    for k, vertices in enumerate(positions):
        write_ply(tmp_path / f"ball_{k}.ply", vertices, shape.faces)
        meeting = positions[3, [0, 0, *range(2, len(vertices))]] if k > 2 else vertices
        trimesh.Trimesh(meeting, shape.faces, process=False).export(tmp_path / f"ball_{k}.stl")
    return tmp_path, positions


def test_lists_and_half_spaces(ball):
    folder, positions = ball
    ground = ccd.HalfSpace([0.0, 0.0, -1.6], [0.0, 0.0, 1.0])
    files = [folder / f"ball_{k}.ply" for k in (3, 1, 2, 0, 4)]
    sequence = ccd.read_sequence(map(str, files), static=[ground], self_collision=False)
    assert np.array_equal(np.stack(list(sequence)), positions) and sequence.times.tolist() == [0, 1, 2, 3, 4]
    hits = [ccd.mesh_ccd(step.mesh, step.vertices_t0, step.vertices_t1).hit for step in sequence.steps()]
    assert hits == [False, False, True, True]
    assert ccd.read_sequence(files, kinematic=["ball"]).mesh.kinematic.tolist() == [True]


def test_vertices_of_a_soup_are_one_as_in_its_first_frame(ball):
    """Corners of STL files are one where they coincide there: two that meet stay two, and what parts is refused."""
    files = [ball[0] / f"ball_{k}.stl" for k in range(5)]
    sequence = ccd.read_sequence(files)
    assert {id(step.mesh) for step in sequence.steps()} == {id(sequence.mesh)} and sequence.mesh.num_vertices == 42
    assert [len(np.unique(frame, axis=0)) for frame in sequence] == [42, 42, 42, 41, 41]
    with pytest.raises(ValueError, match=r"ball_2\.stl: vertex \d+ leaves vertex \d+, although both are in"):
        ccd.read_frames(files[4], files[2])
