"""Reading frames: nothing is rounded, merged or reordered unless the format calls for it."""

import re
from contextlib import nullcontext

import numpy as np
import pytest
import trimesh
from mesh_files import exported, of_extra, ply, polygon_file

import ccd_warp as ccd

TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
# A sphere whose coordinates need all 53 bits.
_SPHERE = trimesh.creation.icosphere(subdivisions=1, radius=1.0 / 3.0)
BALL, BALL_FACES = np.asarray(_SPHERE.vertices) + np.pi, np.asarray(_SPHERE.faces).astype(np.int32)


def _frames(folder, name, start, end=None, **options):
    """What is read of two files with these contents."""
    paths = [folder / f"{time} {name}" for time in ("start", "end")]
    for path, data in zip(paths, (start, start if end is None else end), strict=True):
        path.write_bytes(data.encode() if isinstance(data, str) else data)
    return ccd.read_frames(*paths, **options)


def test_glb_puts_the_parts_of_a_scene_in_place_and_merges_the_copies_at_a_seam(tmp_path):
    """Within a node alone: of two nodes that coincide they are two bodies in contact."""
    corners, scene = BALL[BALL_FACES].reshape(-1, 3), trimesh.Scene()
    for name, offset in (("left", 0.0), ("right", 10.0), ("same", 10.0)):
        mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
        place = trimesh.transformations.translation_matrix([offset, 0, 0])
        scene.add_geometry(mesh, geom_name=name, node_name=name, transform=place)
    frames = _frames(tmp_path, "a.glb", scene.export(file_type="glb"))
    assert {*frames.mesh.names} == {"left", "right", "same"} and frames.mesh.num_faces == 3 * len(BALL_FACES)
    for body, name in enumerate(frames.mesh.names):
        found = frames.vertices_t0[frames.mesh.vertex_body == body]
        expected = BALL.astype(np.float32).astype(np.float64) + [10.0 * (name != "left"), 0, 0]
        assert np.array_equal(np.unique(found, axis=0), np.unique(expected, axis=0)) and len(found) == len(BALL)


def test_glb_vertices_that_touch_at_the_start_and_part_are_refused(tmp_path):
    start, faces = np.vstack([TRIANGLE, -TRIANGLE]), np.arange(6).reshape(-1, 3)
    contents = [exported("glb", x, faces) for x in (start, start - (np.arange(6) > 2)[:, None])]
    assert len(_frames(tmp_path, "a.glb", contents[0]).vertices_t0) == 5
    with pytest.raises(ValueError, match=r"end a\.glb: vertex 3 leaves vertex 0, although both are in one place in"):
        _frames(tmp_path, "a.glb", *contents)
    assert len(_frames(tmp_path, "a.glb", *contents[::-1]).vertices_t0) == 6


@pytest.mark.parametrize(
    "start, end, message",
    [
        ("ball.ply", "few.ply", r"ball\.ply has 42 vertices and 80 faces, .*few\.ply has 4 vertices and 2 faces"),
        ("ball.ply", "order.ply", r"differs: face 7 is \[.*\] in .*ball\.ply and \[.*\] in .*order\.ply \(72 of 80"),
        ("four.obj", "three.obj", r"face 0 is \[0, 1, 2, 3\] in .*four\.obj and \[0, 1, 2\] in .*three\.obj \(2 of 2"),
        ("ball.stl", "ball.ply", r"ball\.stl has 240 vertices and 80 faces, .*ball\.ply has 42"),
        *(("ball.stl", f"torn_{k}.stl", r"torn_.\.stl: vertex \d+ leaves .*save all frames in another") for k in "xyz"),
        ("ball.ply", "none.ply", r"none\.ply: no such file"),
    ],
)
def test_frames_that_do_not_fit_are_refused_in_one_line(tmp_path, start, end, message):
    corners, soup = BALL[BALL_FACES].reshape(-1, 3), np.arange(240).reshape(-1, 3)
    five = np.array([[0.0, 0, 0], [1, 0, 0], [2, 1, 0], [1, 2, 0], [0, 1, 0]])
    torn = {f"torn_{k}.stl": corners + np.outer(np.arange(240) == 5, k == np.array([*"xyz"])) for k in "xyz"}
    for name, data in {
        "ball.ply": ply(BALL, BALL_FACES),
        "few.ply": ply(BALL[:4], [[0, 1, 2], [1, 2, 3]]),
        "order.ply": ply(BALL, np.vstack([BALL_FACES[:7], BALL_FACES[7:][::-1]])),
        "ball.stl": exported("stl", BALL, BALL_FACES),
        "four.obj": polygon_file("four.obj", five, [[0, 1, 2, 3], [0, 3, 4]]).encode(),  # of the same fan
        "three.obj": polygon_file("three.obj", five, [[0, 1, 2], [0, 2, 3, 4]]).encode(),
        **{name: exported("stl", vertices, soup) for name, vertices in torn.items()},
    }.items():
        (tmp_path / name).write_bytes(data)
    with pytest.raises(ValueError, match=message) as caught:
        ccd.read_frames(tmp_path / start, tmp_path / end)
    assert "\n" not in str(caught.value)


# ---- Files of cells --------------------------------------------------------------------------------------------------


def test_pieces_are_one_where_their_points_are_in_one_place(tmp_path):
    """Two tetrahedra with a side in common, in pieces of a file and in a file each; a cell of two pieces is one."""
    meshio = of_extra("meshio")
    points, pieces = np.concatenate([np.eye(4, 3, k=-1), [[1.0, 1.0, 1.0]]]), []
    for k, corners in enumerate(([0, 1, 2, 3], [1, 2, 3, 4])):
        path = tmp_path / f"{k}.vtu"
        meshio.Mesh(points[corners], [("tetra", [[0, 1, 2, 3]])]).write(path, binary=False)
        pieces.append(re.search(r"(?s)<Piece.*</Piece>", path.read_text("utf-8"))[0])
    text = path.read_text("utf-8").replace(pieces[1], "".join(pieces))
    (tmp_path / "a.vtu").write_text(text)
    sources = "".join(f'<Piece Source="{k}.vtu"/>' for k in range(2))
    (tmp_path / "a.pvtu").write_text(
        f'<VTKFile type="PUnstructuredGrid"><PUnstructuredGrid>{sources}</PUnstructuredGrid></VTKFile>'
    )
    ghost = '<CellData><DataArray type="UInt8" Name="vtkGhostType" format="ascii">{}</DataArray></CellData></Piece>'
    copied = [piece.replace("</Piece>", ghost.format(k // 2)) for k, piece in enumerate([*pieces, pieces[0]])]
    (tmp_path / "b.vtu").write_text(text.replace("".join(pieces), "".join(copied)))
    for name in ("a.vtu", "a.pvtu", "b.vtu"):
        frames = ccd.read_frames(tmp_path / name, tmp_path / name, surface=True)
        assert frames.mesh.num_faces == 6 and len(frames.vertices_t0) == 5
        assert {*map(tuple, frames.vertices_t0.tolist())} == {*map(tuple, points.tolist())}


TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
BESIDE = [("vertex", [[0]]), ("line", [[0, 1]]), ("triangle", [[0, 2, 1]]), ("tetra", [[0, 1, 2, 3]])]


@pytest.mark.parametrize(
    "suffix, options", [("vtu", {}), ("vtk", {}), ("msh", {"file_format": "gmsh22"}), ("mesh", {})]
)
def test_curves_and_points_beside_cells_are_left_out_and_counted(tmp_path, suffix, options):
    """As Gmsh and meshio write physical groups; alone they are cables and particles."""
    meshio = of_extra("meshio")
    cells, path = BESIDE[suffix == "mesh" :], tmp_path / f"a.{suffix}"
    meshio.Mesh(TETRAHEDRON, cells).write(path, **options)
    said = "1 edges of curves beside" if suffix == "mesh" else "1 edges of curves and 1 points beside"
    for surface in (False, True):
        with pytest.warns(RuntimeWarning, match=rf"^a.{suffix}: {said} its faces and cells are left out$"):
            mesh = ccd.read_frames(path, path, surface=surface).mesh
        assert mesh.num_faces == 4 and not len(mesh.codimensional_edges)
    if suffix != "mesh":  # which has no particles
        meshio.Mesh(TETRAHEDRON, [("vertex", [[3]]), ("line", [[0, 1], [1, 2]])]).write(path, **options)
        mesh = ccd.read_frames(path, path).mesh
        assert mesh.edges.tolist() == [[0, 1], [1, 2]] and mesh.codimensional_points.tolist() == [3]


# Types of VTK: of curves, of surfaces, and those that have the middles of all edges; others are volumes.
LINES, SHELLS, QUADRATIC = (3, 21, 35, 68, 75), (5, 7, 8, 9, 22, 23, 28, 69, 70, 76, 77), (*range(22, 30), 37)
TYPES = [(kind, 1) for kind in (3, 5, *range(7, 15), *range(21, 30), 35, 37)]
TYPES += [(kind, order) for kind in (*range(68, 74), *range(75, 81)) for order in (1, 2, 3, 4)]  # Lagrange, Bézier


@pytest.mark.filterwarnings("error:cells of")
@pytest.mark.parametrize("kind, order", TYPES)
def test_cells_of_files_are_the_same_whatever_their_order_and_type(tmp_path, kind, order):
    """A unit cube or square or segment of any cells, mirrored: by its corners, and turned outward."""
    pyvista, path = of_extra("pyvista"), tmp_path / "a.vtu"
    from vtkmodules.vtkFiltersSources import vtkCellTypeSource

    source = vtkCellTypeSource()
    source.SetCellType(kind)
    source.SetCellOrder(order)
    source.SetBlocksDimensions(1, 1, 1)
    source.Update()
    grid = pyvista.wrap(source.GetOutput())
    grid.points = np.float32(grid.points * [1.0, 1.0, -1.0] + np.pi)  # whose roundings bend no edge
    grid.save(path)
    is_told = kind in (21, 35) or order > (1 if kind in LINES else 2)
    with pytest.warns(RuntimeWarning, match="a higher order collide by their corners") if is_told else nullcontext():
        mesh = ccd.read_frames(path, path, surface=True).mesh
    a, b, c = np.moveaxis((grid.points - grid.points.mean(axis=0))[mesh.faces], 1, 0)
    volume, area = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0, np.linalg.norm(np.cross(b - a, c - a), axis=1)
    expected = (1, 0, 0, 0) if kind in LINES else (5, 2, 1, 0) if kind in SHELLS else (18, 12, 6, 1)
    assert (mesh.num_edges, mesh.num_faces, area.sum() / 2.0, volume) == pytest.approx(expected, abs=1e-5)
    if kind in QUADRATIC or (order == 2 and kind not in LINES):  # the middles are moved off those of their edges
        grid.points[np.setdiff1d(range(grid.n_points), mesh.faces)] += [0.0, 0.1, 0.0]
        grid.save(path)
        with pytest.warns(RuntimeWarning, match=r"^cells of a.vtu: quadratic ones .* up to 0\.1 off these, the long"):
            assert np.array_equal(ccd.read_frames(path, path, surface=True).mesh.faces, mesh.faces)
    if volume > 0.5:
        with pytest.raises(ValueError, match=r"holds cells of the type .*; expected triangles and polygons"):
            ccd.read_frames(path, path)


def test_strips_and_pixels_are_polygons(tmp_path):
    """A square of two pixels and as a strip, all of which are seen from one side."""
    pyvista = of_extra("pyvista")
    points, strip = np.array([[x, y, 0.0] for x in range(3) for y in range(2)]), tmp_path / "a.vtp"
    pixels = tmp_path / "a.vtu"
    pyvista.PolyData(points, strips=[6, *range(6)]).save(strip)
    pyvista.UnstructuredGrid([4, 0, 2, 1, 3, 4, 2, 4, 3, 5], [8, 8], points).save(pixels)
    for path, sign in ((strip, -1.0), (pixels, 1.0)):
        a, b, c = np.moveaxis(points[ccd.read_frames(path, path).mesh.faces], 1, 0)
        assert np.cross(b - a, c - a)[:, 2].tolist() == [sign] * 4


# ---- Frames of a step ------------------------------------------------------------------------------------------------


def test_vertices_of_a_file_that_are_in_no_face_meet_nothing(tmp_path):
    """One that would fly through the table, and one that is no number."""
    for name, z, stray in (("a", 5.0, "0 0 1"), ("b", 3.0, "0 0 -1")):
        text = f"v 50 0 {z}\nv 51 0 {z}\nv nan 0 0\nv 50 1 {z}\nv {stray}\nf 1 2 4\n"
        (tmp_path / f"{name}.obj").write_text(text)
    (tmp_path / "table.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nv 0 0 99\nf 1 2 3\n")
    frames = ccd.read_frames(tmp_path / "a.obj", tmp_path / "b.obj", static=[tmp_path / "table.obj"])
    assert "3 vertices take no part" in repr(frames)
    assert ccd.mesh_ccd(frames.mesh, frames.vertices_t0, frames.vertices_t1).toi == np.inf
    sequence = ccd.read_sequence([tmp_path / "a.obj", tmp_path / "b.obj"])
    assert sequence.mesh.unused_vertices.tolist() == [2, 4] and np.isnan(sequence[1][2, 0])
