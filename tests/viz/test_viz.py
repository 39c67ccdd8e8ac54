"""Pictures of a step: where contacts are drawn, what the picture shows, and what is refused."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd
from ccd_warp import viz
from ccd_warp._cli.command import main
from ccd_warp._files.frames import write_mesh
from ccd_warp.viz._camera import make_camera
from ccd_warp.viz._scene import make_scene
from ccd_warp.viz._window import drawing_without_display

SIZE = (600, 200)
NO_FACES = np.zeros((0, 3), dtype=int)


def _reason_not_to_draw() -> str:
    try:
        with drawing_without_display():
            return ""
    except (ImportError, RuntimeError) as error:
        return str(error)


REASON = _reason_not_to_draw()
requires_drawing = pytest.mark.skipif(bool(REASON), reason=REASON)


def _contacts(kind, primitives, toi, parameters) -> ccd.Contacts:
    count = len(toi)
    return ccd.Contacts(
        kind=np.array(kind, dtype=np.int32),
        primitives=np.array(primitives, dtype=np.int32).reshape(-1, 2),
        toi=np.array(toi, dtype=np.float64),
        parameters=np.array(parameters, dtype=np.float64).reshape(-1, 2),
        normal=np.tile([0.0, 0.0, 1.0], (count, 1)),
        status=np.ones(count, dtype=np.int32),
        gap=np.zeros(count),
        width=np.zeros(count),
    )


def _balls_over_box(scale=1.0, offset=0.0):
    """Two balls fall, the first into a static box, the second beside it; frames and mesh."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    box = trimesh.creation.box(extents=(3.0, 3.0, 1.0))
    mesh = ccd.CollisionMesh.from_trimesh([ball, ball, box], static=[2])
    start = np.vstack([ball.vertices + [0.2, 0.1, 1.5], ball.vertices + [2.2, 0.0, 1.5], box.vertices])
    end = start - np.repeat([1.0, 1.0, 0.0], np.diff(mesh.body_vertex_range))[:, None] * [0.0, 0.0, 1.0]
    return mesh, scale * start + offset, scale * end + offset


def _read(path) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def _draw(folder, mesh, start, end, *, mesh_options=None, **options) -> list[np.ndarray]:
    """The three panels of a picture, without their titles."""
    result = ccd.mesh_ccd(mesh, start, end, **(mesh_options or {}))
    options = {"size": SIZE} | options
    path = viz.render_step(mesh, start, end, result, folder / "step.png", **options)
    image = _read(path)
    assert image.shape == (options["size"][1], options["size"][0], 3)
    return np.split(image[image.shape[0] // 10 :], 3, axis=1)


def _is_drawn(panel) -> np.ndarray:
    return (panel < 245).any(axis=2)


def _alike(a, b) -> bool:
    """Equal but for rounding, and with it the pixels along a few silhouettes."""
    return bool((np.abs(a - b).max(axis=2) > 40).mean() < 0.005)


def _red(panel) -> int:
    """Pixels in the colour of the contacts."""
    return int(((panel[..., 0] > 150) & (panel[..., 1:] < 80).all(axis=2)).sum())


def test_contact_point_of_a_vertex_on_a_face():
    """The face rises by 4 t, the vertex falls by 4 t from 2: they meet at t = 1/4, at z = 1."""
    triangle = [[0.0, 0, 0], [4, 0, 0], [0, 4, 0]]
    mesh = ccd.CollisionMesh.from_arrays([(triangle, [[0, 1, 2]]), ([[1.0, 2, 2]], NO_FACES)])
    start = np.vstack([triangle, [[1.0, 2, 2]]])
    end = start + np.array([[0, 0, 4.0]] * 3 + [[0, 0, -4.0]])
    points = viz.contact_points(mesh, start, end, _contacts([0], [[3, 0]], [0.25], [[0.25, 0.5]]))
    assert points.tolist() == [[1.0, 2.0, 1.0]]


def test_contact_point_is_halfway_between_features_that_are_a_gap_apart():
    triangle = [[0.0, 0, 0], [4, 0, 0], [0, 4, 0]]
    mesh = ccd.CollisionMesh.from_arrays([(triangle, [[0, 1, 2]]), ([[1.0, 2, 2]], NO_FACES)])
    frame = np.vstack([triangle, [[1.0, 2, 2]]])
    points = viz.contact_points(mesh, frame, frame, _contacts([0], [[3, 0]], [0.5], [[0.25, 0.5]]))
    assert points.tolist() == [[1.0, 2.0, 1.0]]


def test_contact_point_of_two_edges():
    bodies = [([[0.0, 0, 0], [4, 0, 0]], NO_FACES, [[0, 1]]), ([[1.0, -1, 2], [1, 3, 2]], NO_FACES, [[0, 1]])]
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    start = np.vstack([body[0] for body in bodies])
    end = start - np.array([[0, 0, 0], [0, 0, 0], [0, 0, 4], [0, 0, 4]])
    points = viz.contact_points(mesh, start, end, _contacts([1], [[0, 1]], [0.5], [[0.25, 0.25]]))
    assert points.tolist() == [[1.0, 0.0, 0.0]]


def test_contact_points_of_codimensional_points():
    """A particle falls on a cable, at a quarter of it, and another meets a third; an edge of a face comes first."""
    bodies = [
        ([[9.0, 9, 0], [8, 9, 0], [9, 8, 0]], [[0, 1, 2]]),
        ([[0.0, 0, 0], [4, 0, 0]], NO_FACES, [[0, 1]]),
        ([[1.0, 0, 1], [0, 5, 0], [2, 5, 0]], NO_FACES),
    ]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True)
    start = np.vstack([body[0] for body in bodies])
    end = start.copy()
    end[5] -= [0, 0, 2]
    end[6] += [2, 0, 0]
    (cable,) = mesh.codimensional_edges
    contacts = _contacts([2, 3], [[5, cable], [6, 7]], [0.5, 1.0], [[0.25, 0.0], [0.0, 0.0]])
    assert viz.contact_points(mesh, start, end, contacts).tolist() == [[1.0, 0.0, 0.0], [2.0, 5.0, 0.0]]
    found = ccd.mesh_ccd(mesh, start, end).contacts
    # The tolerance, 1e-6 of a motion nine units long, moves each toi by less than as much over a speed of two.
    assert np.allclose(viz.contact_points(mesh, start, end, found), [[1.0, 0.0, 0.0], [2.0, 5.0, 0.0]], atol=2e-5)


def test_contact_points_of_another_mesh_are_refused():
    mesh, start, end = _balls_over_box()
    with pytest.raises(
        ValueError, match=r"contacts\.primitives holds 999999; expected indices of the mesh's 652 faces"
    ):
        viz.contact_points(mesh, start, end, _contacts([0], [[0, 999999]], [0.5], [[0.0, 0.0]]))


def test_contact_points_of_nothing():
    mesh, start, end = _balls_over_box()
    assert viz.contact_points(mesh, start, end, _contacts([], [], [], [])).shape == (0, 3)


def test_package_imports_without_its_parts_and_loads_them_when_used():
    code = (
        "import sys, ccd_warp as c; print(*(f'ccd_warp.{p}' in sys.modules for p in ('viz', 'datasets')));"
        "print({'viz', 'datasets'} <= set(dir(c)), callable(c.viz.render_step), callable(c.datasets.find_queries));"
        "print('pyvista' in sys.modules, 'vtkmodules' in sys.modules);"
        "print({n for n in dir(c) if not n.startswith('__')} == set(c.__all__) - {'__version__'}); c.nothing"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.split()[-8:] == ["False", "False", "True", "True", "True", "False", "False", "True"]
    assert "AttributeError: module 'ccd_warp' has no attribute 'nothing'" in done.stderr


@pytest.mark.parametrize(("toi", "text"), [(0.3, "0.3"), (0.4877777777, "0.487777"), (1.0, "1"), (0.0, "0")])
def test_toi_in_a_title_is_no_later(toi, text):
    assert viz._rounded_down(toi) == text
    assert float(text) <= toi


@pytest.mark.parametrize("axis", [0, 1])
def test_automatic_view_looks_across_the_motion(axis):
    start = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    end = start + 5.0 * np.eye(3)[axis]
    camera = make_camera(start, end, None, (400.0, 400.0), (10.0, 30.0, 50.0))
    towards = (camera.position - camera.focus) / np.linalg.norm(camera.position - camera.focus)
    assert abs(towards[axis]) < abs(towards[1 - axis]) and towards[2] > 0.0
    # Everything is within the margins, and touches two of them.
    shown = (np.vstack([start, end]) - camera.focus) @ np.column_stack([np.cross(camera.up, towards), camera.up])
    pixels = shown / camera.pixel + 200.0
    lower, upper = pixels.min(axis=0), pixels.max(axis=0)
    assert (lower >= np.array([10.0, 50.0]) - 1e-6).all() and (upper <= np.array([390.0, 370.0]) + 1e-6).all()
    assert np.isclose(upper - lower, [380.0, 320.0]).any()


def test_scene_has_no_place_and_no_unit():
    reference = make_scene(*_with_result(*_balls_over_box()))
    for scale, offset in ((1.0, 1e6), (1e-6, 0.0), (1e300, 0.0)):
        scene = make_scene(*_with_result(*_balls_over_box(scale, offset)))
        # 2**-53 of an offset of 1e6, over the half side of 1.6
        assert np.allclose(scene.start, reference.start, atol=1e-9) and np.allclose(scene.end, reference.end, atol=1e-9)
        assert np.isclose(scene.first_body_size, reference.first_body_size)
    assert np.abs(np.vstack([reference.start, reference.end])).max() == 1.0


def _with_result(mesh, start, end):
    return mesh, start, end, ccd.mesh_ccd(mesh, start, end)


@requires_drawing
def test_picture_shows_three_times(tmp_path):
    panels = _draw(tmp_path, *_balls_over_box())
    for panel in panels:
        assert _is_drawn(panel).mean() > 0.1
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert not _alike(panels[a], panels[b])


@requires_drawing
def test_contacts_are_drawn_at_the_toi_alone(tmp_path):
    panels = _draw(tmp_path, *_balls_over_box())
    assert _red(panels[1]) > 20
    assert _red(panels[0]) == _red(panels[2]) == 0


@requires_drawing
def test_no_contact_shows_the_end_of_what_was_looked_at(tmp_path):
    mesh, start, end = _balls_over_box()
    panels = _draw(tmp_path, mesh, start, end, mesh_options={"t_max": 0.25}, t_max=0.25)
    assert all(_red(panel) == 0 for panel in panels)
    assert not _alike(panels[0], panels[1]) and not _alike(panels[1], panels[2])
    apart = end + [0.0, 0.0, 2.0]
    panels = _draw(tmp_path, mesh, start, np.where(mesh.static[mesh.vertex_body][:, None], start, apart))
    assert _alike(panels[1], panels[2]) and not _alike(panels[0], panels[2])


@requires_drawing
def test_static_bodies_are_grey_and_rest(tmp_path):
    panels = _draw(tmp_path, *_balls_over_box(), colour="body")
    spread = [np.ptp(panel, axis=2) for panel in panels]
    for panel, colourful in zip(panels, spread, strict=True):
        assert (_is_drawn(panel) & (colourful < 12)).mean() > 0.05  # the box
        assert (colourful > 40).mean() > 0.02  # the balls
    is_box = (spread[0] < 12) & (spread[2] < 12) & _is_drawn(panels[0]) & _is_drawn(panels[2])
    assert np.median(np.abs(panels[0] - panels[2])[is_box]) == 0


def _bullet_and_wall():
    """A ball flies through a static wall of twelve faces, along x."""
    ball, wall = trimesh.creation.icosphere(subdivisions=2, radius=0.4), trimesh.creation.box(extents=(0.1, 5.0, 5.0))
    mesh = ccd.CollisionMesh.from_trimesh([ball, wall], static=["wall"], names=["bullet", "wall"])
    start = np.vstack([ball.vertices + [-3.0, 0.4, 0.3], wall.vertices])
    return mesh, start, start + np.repeat([6.0, 0.0], np.diff(mesh.body_vertex_range))[:, None] * [1, 0, 0]


@requires_drawing
def test_large_faces_of_static_bodies_stay_as_they_were(tmp_path):
    """At t = 1 the corners of a wall bore balls in the colours of their toi."""
    mesh, start, end = _bullet_and_wall()
    panels = _draw(tmp_path, mesh, start, end)
    areas = []
    for panel in (panels[0], panels[2]):
        places = np.argwhere(np.ptp(panel[:130], axis=2) > 40)  # above the colour bar
        areas.append(np.ptp(places, axis=0).prod())
    assert areas[1] < 1.5 * areas[0]  # the ball alone is colourful, here as there


@requires_drawing
def test_what_moves_and_touches_nothing_is_pale_in_its_colour_and_static_bodies_are_grey(tmp_path):
    mesh, start, end = _balls_over_box()  # the second ball touches nothing
    image = _draw(tmp_path, mesh, start, end)[2][:130]
    spread, light = np.ptp(image, axis=2), image.min(axis=2) > 150
    assert ((spread > 14) & (spread < 60) & light).mean() > 0.01  # the ball beside the box
    assert ((spread < 10) & _is_drawn(image)).mean() > 0.03  # the box


@requires_drawing
def test_large_faces_that_move_have_one_colour_each_by_their_earliest_corner(tmp_path):
    box, wall = trimesh.creation.box(), trimesh.creation.box(extents=(0.2, 3.0, 3.0))
    mesh = ccd.CollisionMesh.from_trimesh([box, wall], static=[1])
    start = np.vstack([box.vertices - [1.5, 0.13, 0.07], wall.vertices])
    end = start + np.repeat([1.3, 0.0], 8)[:, None] * [1, 0, 0]
    end[np.flatnonzero(box.vertices[:, 0] > 0), 0] += 0.05 * np.arange(4)  # no two corners arrive together
    panel = _draw(tmp_path, mesh, start, end, size=(1200, 400))[2][:250]
    assert ((panel[..., 1] < 60) & (panel[..., 2] > 50)).sum() > 300  # in the first of the colours


def test_the_legend_names_what_moves_and_what_is_static():
    scene = make_scene(*_with_result(*_bullet_and_wall()))
    assert [text for _, text in scene.legend] == ["bullet, moving", "wall, static"]
    crowd = ccd.CollisionMesh.from_arrays([(np.eye(3) + 3.0 * k, [[0, 1, 2]]) for k in range(9)], static=[7, 8])
    texts = [text for _, text in make_scene(*_with_result(crowd, crowd.vertices, crowd.vertices)).legend]
    assert texts == ["body 0, moving", "body 1, moving", "and 5 more, moving", "body 7, body 8, static"]
    bodies = [(np.eye(3) + 3.0 * k, [[0, 1, 2]]) for k in range(5)]
    for kinematic, expected in (
        ([0], ["body 0, kinematic", "body 1, moving", "and 3 more, moving"]),
        ([4], ["body 0, moving", "body 1, moving", "and 3 more, moving and kinematic"]),
        (range(2, 5), ["body 0, moving", "body 1, moving", "and 3 more, kinematic"]),
    ):
        mesh = ccd.CollisionMesh.from_arrays(bodies, kinematic=kinematic)
        assert [text for _, text in make_scene(*_with_result(mesh, mesh.vertices, mesh.vertices)).legend] == expected


@requires_drawing
def test_a_picture_is_shown_by_a_notebook_and_stands_for_its_file(tmp_path):
    import io

    from PIL import Image

    step = _with_result(*_balls_over_box())
    picture = viz.draw_step(*step, size=SIZE)
    assert picture.image.shape == (200, 600, 3) and picture.image.dtype == np.uint8 and picture.path is None
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(picture._repr_png_()))), picture.image)
    with pytest.raises(ValueError, match=r"picture has no file; expected picture\.save"):
        os.fspath(picture)
    saved = viz.render_step(*step, tmp_path / "step.png", size=SIZE)
    assert os.fspath(saved) == str(tmp_path / "step.png") and np.array_equal(_read(saved), saved.image)
    assert repr(saved) == f"Picture(600 × 200 pixels, {tmp_path / 'step.png'})"
    assert picture.save(tmp_path / "again.png").path.exists()
    launched = ccd.CollisionPipeline(step[0], device="cpu").launch(*step[1:3]).to_host()
    assert viz.draw_step(*step[:3], launched, size=SIZE).image.shape == picture.image.shape


def test_a_step_goes_to_pyvista_with_its_names_and_data():
    pytest.importorskip("pyvista")
    bodies = [
        ([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]], [[0, 1, 2]]),
        ([[0.0, 0, 1], [0, 0, 2], [3.0, 3, 3]], NO_FACES, [[0, 1]]),
    ]
    mesh = ccd.CollisionMesh.from_arrays(
        bodies, static=["floor"], names=["floor", "rod"], codimensional_points=[False, True]
    )
    end = mesh.vertices - (np.arange(6) >= 3)[:, None] * [0.0, 0.0, 2.0]
    result = ccd.mesh_ccd(mesh, mesh.vertices, end)
    blocks = viz.to_pyvista(mesh, mesh.vertices, end, result, t=0.5)
    assert blocks.keys() == ["floor", "rod", "contacts"]
    floor, rod, contacts = blocks
    assert floor.n_cells == 1 and floor.field_data["static"].tolist() == [1]
    assert np.allclose(rod.points, [[0, 0, 0], [0, 0, 1], [3, 3, 2]]) and rod.field_data["static"].tolist() == [0]
    assert rod.n_lines == rod.n_verts == 1 and rod.cell_data["primitive"].tolist() == [5, mesh.codimensional_edges[0]]
    assert rod.point_data["vertex"].tolist() == [3, 4, 5] and rod.point_data["displacement"][0].tolist() == [0, 0, -2]
    assert rod.point_data["toi"].tolist() == result.vertex_toi[3:].tolist()
    assert np.array_equal(contacts.points, result.contacts.points.astype(contacts.points.dtype))
    assert contacts.point_data["bodies"].tolist() == result.contacts.bodies.tolist()
    assert viz.to_pyvista(mesh, mesh.vertices, end).keys() == ["floor", "rod"]
    apart = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices)
    assert viz.to_pyvista(mesh, mesh.vertices, mesh.vertices, apart)["contacts"].n_points == 0
    with pytest.raises(ValueError, match=r"t is 1\.5; expected a number in \[0, 1\]"):
        viz.to_pyvista(mesh, mesh.vertices, end, t=1.5)


@requires_drawing
def test_a_scene_of_static_bodies_alone(tmp_path):
    box = trimesh.creation.box()
    mesh = ccd.CollisionMesh.from_trimesh([box], static=[0])
    panels = _draw(tmp_path, mesh, box.vertices, box.vertices)
    assert _is_drawn(panels[0]).mean() > 0.2
    assert _alike(panels[0], panels[2])


@requires_drawing
@pytest.mark.parametrize(("scale", "offset"), [(1.0, 1e6), (1e-6, 0.0), (1e-6, 1.0)])
def test_far_and_tiny_scenes_fill_the_frame(tmp_path, scale, offset):
    reference = _draw(tmp_path, *_balls_over_box())
    panels = _draw(tmp_path, *_balls_over_box(scale, offset))
    for panel, expected in zip(panels[:2], reference[:2], strict=True):
        rows, columns = (np.flatnonzero(_is_drawn(panel).any(axis=axis)) for axis in (1, 0))
        assert np.ptp(rows) > 0.6 * panel.shape[0] or np.ptp(columns) > 0.9 * panel.shape[1]
        assert _alike(panel, expected)


@requires_drawing
def test_cables_and_particles_are_drawn(tmp_path):
    x = np.linspace(-1.0, 1.0, 21)
    cable = np.column_stack([x, 0.0 * x, 0.5 + 0.2 * x * x])
    particles = np.column_stack([x, 0.5 + 0.0 * x, 0.3 + 0.0 * x])
    links = np.column_stack([np.arange(20), np.arange(1, 21)])
    mesh = ccd.CollisionMesh.from_arrays(
        [(cable, NO_FACES, links), (particles, NO_FACES)], codimensional_points=[False, True]
    )
    start = np.vstack([cable, particles])
    end = start - [0.0, 0.0, 0.5]
    panels = _draw(tmp_path, mesh, start, end)
    blue = [(panel[..., 2] - panel[..., 0] > 30).sum() for panel in panels]
    ochre = [(panel[..., 0] - panel[..., 2] > 30).sum() for panel in panels]
    assert min(blue) > 50 and min(ochre) > 50
    alone = ccd.CollisionMesh.from_arrays([(cable, NO_FACES, links)])
    assert _is_drawn(_draw(tmp_path, alone, cable, cable + [0, 0, 1.0])[0]).sum() > 50


@requires_drawing
@pytest.mark.parametrize("case", ["one_point", "degenerate_faces", "flat", "towards_the_viewer"])
def test_degenerate_scenes_are_drawn(tmp_path, case):
    faces, camera = [[0, 1, 2]], None
    start = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    end = start + [0.0, 0.0, 1.0]
    match case:
        case "one_point":
            start = end = np.ones((3, 3))
        case "degenerate_faces":
            faces = [[0, 1, 1], [0, 0, 0], [0, 1, 2], [0, 1, 2]]
        case "flat":
            end = start
        case "towards_the_viewer":
            camera = (0.0, 0.0, 1.0)
    mesh = ccd.CollisionMesh.from_arrays([(start, faces)])
    panels = _draw(tmp_path, mesh, start, end, camera=camera)
    assert case == "one_point" or _is_drawn(panels[0]).mean() > 0.02


@requires_drawing
def test_what_is_small_is_shown_close_up(tmp_path):
    """A ball of 2 % of the motion: without a close-up its colour would be on a few pixels."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    wall = trimesh.creation.box(extents=(0.1, 5.0, 5.0))
    mesh = ccd.CollisionMesh.from_trimesh([ball, wall], static=[1])
    start = np.vstack([ball.vertices - [4.6, 0.4, 0.3], wall.vertices])
    panels = _draw(tmp_path, mesh, start, start + np.repeat([9.0, 0.0], [len(ball.vertices), 8])[:, None] * [1, 0, 0])
    blue = [int((panel[..., 2] - panel[..., 0] > 30).sum()) for panel in panels]
    assert blue[1] > 4 * blue[0] > 0


@pytest.mark.parametrize("is_fine", [False, True])
@requires_drawing
def test_a_contact_below_a_hundredth_of_the_picture_is_shown_close_up(tmp_path, monkeypatch, is_fine):
    """A box of a quarter of the picture comes down on its corner: fine faces are shown with their edges."""
    box = trimesh.creation.box()
    for _ in range(6 if is_fine else 0):
        box = box.subdivide()
    turn = trimesh.transformations.rotation_matrix(0.5, [1.0, 0.6, 0.0])[:3, :3]
    floor = (np.array([[-2.0, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]]), [[0, 1, 2], [0, 2, 3]])
    bodies = [(box.vertices @ turn.T + [0, 0, 1.5], box.faces), floor]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1], self_collision=False)
    step = mesh.vertices, mesh.vertices - np.outer(mesh.vertex_body == 0, [0, 0, 1.0])
    scene = make_scene(*_with_result(mesh, *step))
    assert scene.first_contact_size == pytest.approx(0.5 * (2**-6 if is_fine else 1.0), rel=0.5)
    panels = _draw(tmp_path, mesh, *step, size=(1200, 400))
    monkeypatch.setattr("ccd_warp.viz._front._TINY", 0.0)
    without = _draw(tmp_path, mesh, *step, size=(1200, 400))
    share = [(np.abs(a - b).max(axis=2) > 40).mean() for a, b in zip(panels, without, strict=True)]
    assert share[0] == share[2] == 0.0 and (share[1] > 0.04 if is_fine else share[1] == 0.0)


@requires_drawing
def test_places_where_surfaces_cross_at_the_start_are_marked_there():
    mesh, start, _ = _balls_over_box()
    start[mesh.vertex_body < 2] -= [0, 0, 0.7]
    result, crossing = ccd.mesh_ccd(mesh, start, start), ccd.find_intersections(mesh, start)
    assert crossing.num_crossing > 10
    images = [
        viz.draw_step(mesh, start, start, replace(result, start=each), size=(900, 300)).image.astype(int)
        for each in (crossing, None)
    ]
    is_marked = [(np.abs(image - [214, 0, 143]).max(axis=2) < 12) for image in images]
    assert is_marked[0][:, :300].sum() > 60 and not is_marked[0][:, 300:].any() and not is_marked[1].any()
    scene = make_scene(mesh, start, start, replace(result, start=crossing))
    assert [text for _, text in scene.legend][-1] == "surfaces cross"


@requires_drawing
def test_colours_of_toi_read_in_grey(tmp_path):
    from ccd_warp.viz._panel import _toi_colours

    def lightness(rgb):
        return np.asarray(rgb)[..., :3] @ [0.2126, 0.7152, 0.0722]

    levels = lightness(_toi_colours()(np.linspace(0.0, 1.0, 32)))
    bodies = [(np.eye(3), [[0, 1, 2]])] * 6  # one of each colour
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=False, body_pairs=np.zeros((6, 6), dtype=bool))
    none = lightness(make_scene(*_with_result(mesh, mesh.vertices, mesh.vertices)).pale_colours / 255.0)
    assert (np.diff(levels) > 0.0).all() and levels[-1] < none.min() - 0.05


@requires_drawing
def test_earlier_vertices_are_darker(tmp_path):
    """A wavy sheet falls flat on a finer static sheet, its left side first; seen from above at t = 1."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21), indexing="ij"))
    corner = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel()
    faces = np.vstack(
        [np.column_stack([corner, corner + 21, corner + 1]), np.column_stack([corner + 1, corner + 21, corner + 22])]
    )
    rest = np.column_stack([x, y, 0.0 * x])
    mesh = ccd.CollisionMesh.from_arrays([(rest, faces), (rest, faces)], static=[1])
    start = np.vstack([rest + np.column_stack([0 * x, 0 * x, 0.1 + 0.5 * x]), rest])
    end = start - np.repeat([0.7, 0.0], len(rest))[:, None] * [0.0, 0.0, 1.0]
    panel = _draw(tmp_path, mesh, start, end, camera=(0.0, 0.0, 1.0))[2]
    strip = panel[panel.shape[0] // 3, :].sum(axis=1)
    inside = np.flatnonzero(strip < 700)
    left, right = np.array_split(strip[inside], 2)
    assert left.mean() < right.mean() - 50


def test_results_and_files_that_do_not_fit_are_refused(tmp_path):
    mesh, start, end, result = _with_result(*_balls_over_box())
    box = trimesh.creation.box()
    other = ccd.CollisionMesh.from_trimesh([box])
    with pytest.raises(ValueError, match=r"result\.vertex_toi has shape \(332,\); expected \(8,\)"):
        viz.render_step(other, box.vertices, box.vertices, result, tmp_path / "step.png")
    for name, words in (("step.jpg", "must end in .png"), ("none/step.png", "does not exist")):
        with pytest.raises(ValueError, match=words):
            viz.render_step(mesh, start, end, result, tmp_path / name)


def test_path_that_is_given_first_is_told_where_it_belongs(tmp_path):
    step = _with_result(*_balls_over_box())
    for path in (tmp_path / "step.png", "step.png"):
        with pytest.raises(ValueError, match=r"mesh is .*; expected the mesh first.*vertices_t1, result, path\)"):
            viz.render_step(path, *step)


def test_missing_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    mesh, start, end, result = _with_result(*_balls_over_box())
    with pytest.raises(ImportError, match=r"pip install 'ccd-warp\[viz\]'"):
        viz.render_step(mesh, start, end, result, tmp_path / "step.png")
    with pytest.raises(ImportError, match=r"pip install 'ccd-warp\[viz\]'"):
        viz.show_step(mesh, start, end, result)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems always have a display")
def test_window_without_a_display_is_refused(monkeypatch):
    pytest.importorskip("pyvista")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(RuntimeError, match="show_step found no display"):
        viz.show_step(*_with_result(*_balls_over_box()))


@requires_drawing
@pytest.mark.parametrize("colour", ["body", "vertex_toi"])
def test_window_has_a_slider_that_moves_the_bodies(monkeypatch, colour):
    import pyvista

    seen = {}

    def play(plotter):
        slider = plotter.widgets.slider_widgets[0] if hasattr(plotter, "widgets") else plotter.slider_widgets[0]
        seen["value"] = slider.GetRepresentation().GetValue()
        for t in (0.0, 1.0):
            slider.GetRepresentation().SetValue(t)
            slider.InvokeEvent("InteractionEvent")
            (surface,) = (actor for name, actor in plotter.actors.items() if name.startswith("faces with edges"))
            seen[t] = surface.bounds
        plotter.close()

    monkeypatch.setattr(pyvista, "OFF_SCREEN", True)
    monkeypatch.setattr(pyvista.Plotter, "show", play)
    step = _with_result(*_balls_over_box())
    with drawing_without_display():
        viz.show_step(*step, colour=colour)
    assert seen["value"] == pytest.approx(step[3].toi)
    assert seen[1.0][5] < seen[0.0][5]


@requires_drawing
def test_environment_is_left_as_it_was(tmp_path):
    before = dict(os.environ)
    _draw(tmp_path, *_balls_over_box())
    assert dict(os.environ) == before


@pytest.fixture
def files(tmp_path):
    """Files of a ball at both ends of a step, and of a box below it."""
    ball, box = trimesh.creation.icosphere(subdivisions=2), trimesh.creation.box(extents=(4.0, 4.0, 1.0))
    write_mesh(tmp_path / "start.ply", ball.vertices + [0.1, 0.2, 3.0], ball.faces)
    write_mesh(tmp_path / "end.ply", ball.vertices + [0.1, 0.2, 0.0], ball.faces)
    write_mesh(tmp_path / "box.ply", box.vertices, box.faces)
    return tmp_path


def _run(files, picture, *options) -> int:
    arguments = ["run", files / "start.ply", files / "end.ply", "--static", files / "box.ply", "--picture", picture]
    return main([str(argument) for argument in [*arguments, *options]])


@requires_drawing
def test_command_writes_a_picture_and_says_so(files, capfd):
    assert _run(files, files / "step.png") == 0
    captured = capfd.readouterr()
    assert captured.err == ""
    assert f"wrote {files / 'step.png'}" in captured.out and "draw picture" in captured.out
    assert _is_drawn(_read(files / "step.png")).mean() > 0.1


@requires_drawing
def test_quiet_command_says_nothing(files, capfd):
    assert _run(files, files / "step.PNG", "--quiet", "--t-max", "0.1") == 0
    assert capfd.readouterr() == ("", "")
    assert (files / "step.PNG").exists()


@requires_drawing
def test_demo_writes_a_picture_a_scene(tmp_path, capfd):
    assert main(["demo", "--pictures", str(tmp_path / "new" / "folder")]) == 0
    captured = capfd.readouterr()
    assert captured.err == "" and "wrote the pictures" in captured.out
    assert {path.name for path in (tmp_path / "new" / "folder").iterdir()} == {"bullet.png", "cloth.png"}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("step.jpg", "the name must end in .png"),
        ("none/step.png", "does not exist"),
        ("folder.png", "cannot be written"),
    ],
)
def test_command_refuses_a_bad_name_before_the_work(files, capfd, name, words):
    (files / "folder.png").mkdir()
    (files / "start.ply").unlink()  # not even looked for
    assert _run(files, files / name) == 2
    captured = capfd.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert "--picture" in captured.err and words in captured.err


@pytest.mark.parametrize("command", ["run", "demo"])
def test_command_names_the_missing_extra_before_the_work(files, capfd, monkeypatch, command):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    status = _run(files, files / "step.png") if command == "run" else main(["demo", "--pictures", str(files)])
    assert status == 2
    captured = capfd.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert "pip install 'ccd-warp[viz]'" in captured.err


def test_command_names_a_missing_opengl(files, capfd, monkeypatch):
    pytest.importorskip("pyvista")

    def find_none():
        raise RuntimeError("found no OpenGL to draw with")

    monkeypatch.setattr("ccd_warp.viz._window._window_without_display", find_none)
    monkeypatch.delenv("VTK_DEFAULT_OPENGL_WINDOW", raising=False)
    assert _run(files, files / "step.png") == 2
    assert capfd.readouterr().err == "ccd-warp: error: --picture: found no OpenGL to draw with\n"


def test_half_spaces_are_squares_in_their_planes_that_reach_beyond_the_step(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    planes = [ccd.HalfSpace([7, 0, 0], [0.1, 0, 2]), ccd.HalfSpace([0, 0, -50], [0, 0, 1])]
    mesh = ccd.CollisionMesh.from_trimesh([ball, *planes], names=["ball", "ground", "far below"])
    start = ball.vertices + [7, 0, 2]
    result = ccd.mesh_ccd(mesh, start, start - [0, 0, 3])
    scene = make_scene(mesh, start, start - [0, 0, 3], result)
    assert scene.squares.shape == (1, 4, 3)  # the one far below is not in the picture
    blocks = viz.to_pyvista(mesh, start, start - [0, 0, 3], result)
    corners = np.asarray(blocks["ground"].points)
    np.testing.assert_allclose((corners - [7, 0, 0]) @ [0.1, 0, 2], 0, atol=1e-5)
    assert blocks["ground"].n_cells == 1 and np.ptp(corners[:, 0]) > 4 and blocks["ball"].n_cells == len(ball.faces)
    assert (np.asarray(blocks["contacts"].point_data["bodies"]) == [0, 1]).all()


@requires_drawing
def test_a_half_space_is_seen_in_the_picture(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    start = ball.vertices + [0, 0, 1.5]
    darkness = {}
    for name, bodies in (("ground", [ball, ccd.HalfSpace([0, 0, 0], [0, 0, 1])]), ("nothing", [ball])):
        mesh = ccd.CollisionMesh.from_trimesh(bodies)
        panels = _draw(tmp_path, mesh, start, start - [0, 0, 1.2])
        darkness[name] = (panels[0] < 250).any(axis=2).mean()
    assert darkness["ground"] > 2 * darkness["nothing"]


# --- bodies that turn ---


def _turning_bar():
    """A bar that turns by 4 radians about z while it rises, and a ball in its way: mesh, motion, result."""
    bar, ball = trimesh.creation.box((2.0, 0.2, 0.2)), trimesh.creation.icosphere(subdivisions=2, radius=0.35)
    mesh = ccd.CollisionMesh.from_trimesh([bar, ball], names=["bar", "ball"])
    poses = [[0, 0, 0, 0, 0, 0, 1], [0.2, 1.2, 0.1, 0, 0, 0, 1]]
    motion = ccd.RigidMotion(poses, twist=[[0, 0, 0.3, 0, 0, 4.0], [0.1, -0.4, 0, 0, 0, 0]])
    return mesh, motion, ccd.rigid_ccd(mesh, poses, twist=[[0, 0, 0.3, 0, 0, 4.0], [0.1, -0.4, 0, 0, 0, 0]])


def _bar_at(mesh, t):
    """Where the vertices of the bar are."""
    c, s = np.cos(4.0 * t), np.sin(4.0 * t)
    return mesh.vertices[:8] @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [0, 0, 0.3 * t]


def test_bodies_that_turn_are_placed_on_their_arcs():
    mesh, motion, result = _turning_bar()
    step = mesh, mesh.vertices, mesh.vertices
    assert np.array_equal(viz.contact_points(*step, result.contacts, motion=motion), result.contacts.points)
    scene = make_scene(*step, result, motion)
    blocks = viz.to_pyvista(*step, result, t=result.toi, motion=motion) if not REASON else None
    if blocks is not None:
        assert np.allclose(blocks["bar"].points, _bar_at(mesh, result.toi), atol=1e-6)
        displacement = _bar_at(mesh, 1.0) - _bar_at(mesh, 0.0)
        assert np.allclose(blocks["bar"].point_data["displacement"], displacement, atol=1e-12)
    # the picture is moved and scaled, so distances between two of its times are compared
    unit = np.linalg.norm(scene.start[1] - scene.start[0]) / np.linalg.norm(mesh.vertices[1] - mesh.vertices[0])
    moved = (scene.positions(0.3) - scene.positions(0.0))[:8]
    assert np.allclose(moved, unit * (_bar_at(mesh, 0.3) - _bar_at(mesh, 0.0)), atol=1e-12)
    # the path of the bar reaches farther than its places at both ends, and all of it is in the picture
    assert np.abs(scene.between).max() <= 1.0 + 1e-12 and np.abs(scene.between).max() > 0.99
    arcs = scene.trails
    assert len(arcs) > 2 and min(map(len, arcs)) > 30
    middle = 0.5 * (scene.positions(0.0)[0] + scene.positions(0.0)[7])
    for arc in arcs:
        radius = np.linalg.norm((arc - middle)[:, :2], axis=1)
        assert np.allclose(radius, radius[0], rtol=1e-12) and np.ptp(arc[:, 2]) == pytest.approx(0.3 * unit)


def test_a_motion_is_that_of_the_rigid_bodies_alone():
    mesh, start, end = _balls_over_box()
    bodies = [
        (mesh.vertices[a:b], mesh.faces[mesh.face_body == k] - a)
        for k, (a, b) in enumerate(zip(mesh.body_vertex_range, mesh.body_vertex_range[1:], strict=False))
    ]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[2], rigid=[0])
    motion = ccd.RigidMotion([[0, 0, 0, 0, 0, 0, 1]], twist=[[0, 0, -1, 0, 0, 0.5]])
    start, end = start.copy(), end.copy()
    end[:162] = start[:162]
    result = ccd.mesh_ccd(mesh, start, end, motion=motion)
    scene = make_scene(mesh, start, end, result, motion)
    assert np.allclose(scene.positions(0.5)[162:], 0.5 * (scene.start + scene.end)[162:], atol=1e-15)
    with pytest.raises(ValueError, match="motion has 2 rows for 1 rigid body of the mesh"):
        make_scene(mesh, start, end, result, _turning_bar()[1])
    with pytest.raises(ValueError, match="motion is 7; expected a RigidMotion"):
        make_scene(mesh, start, end, result, 7)


@requires_drawing
def test_a_picture_shows_the_arcs(tmp_path):
    mesh, motion, result = _turning_bar()
    step = mesh, mesh.vertices, mesh.vertices, result
    image = _read(viz.render_step(*step, tmp_path / "arcs.png", size=SIZE, motion=motion))
    first, middle, last = np.split(image[20:], 3, axis=1)
    assert _red(middle) > 10 and _red(first) == 0
    assert not _alike(first, middle) and not _alike(middle, last)
