"""Pictures of a step: where contacts are drawn, what the picture shows, and what is refused."""

import io
import os
import sys
from functools import cache

import numpy as np
import pytest
import trimesh

import ccd_warp as ccd
from ccd_warp import viz
from ccd_warp._cli.command import main
from ccd_warp.viz._scene import make_scene
from ccd_warp.viz._window import drawing_without_display

SIZE = (600, 200)
NO_FACES = np.zeros((0, 3), dtype=int)
BALL = trimesh.creation.icosphere(subdivisions=2, radius=0.5)


@cache
def _reason_not_to_draw() -> str:
    try:
        with drawing_without_display():
            return ""
    except (ImportError, RuntimeError) as error:
        return str(error)


@pytest.fixture
def drawing():
    if reason := _reason_not_to_draw():
        pytest.skip(reason)


# ---- Scenes: a mesh, and positions at both ends of a step ------------------------------------------------------------


def balls(scale=1.0, offset=0.0, lift=0.0):
    """Two balls fall, the first into a static box, the second beside it."""
    box = trimesh.creation.box(extents=(3.0, 3.0, 1.0))
    mesh = ccd.CollisionMesh.from_trimesh([BALL, BALL, box], static=[2])
    start = np.vstack([BALL.vertices + [0.2, 0.1, 1.5], BALL.vertices + [2.2, 0.0, 1.5], box.vertices])
    end = start + np.outer(mesh.vertex_body < 2, [0.0, 0.0, lift - 1.0])
    return mesh, scale * start + offset, scale * end + offset


def bullet():
    """A small ball flies far through a static wall of twelve faces, along x."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    wall = trimesh.creation.box(extents=(0.1, 5.0, 5.0))
    mesh = ccd.CollisionMesh.from_trimesh([ball, wall], static=["wall"], names=["bullet", "wall"])
    start = np.vstack([ball.vertices + [-4.6, 0.4, 0.3], wall.vertices])
    return mesh, start, start + np.outer(mesh.vertex_body == 0, [9.0, 0, 0])


def strings():
    """A cable falls, and a row of particles."""
    x = np.linspace(-1.0, 1.0, 21)
    cable = np.column_stack([x, 0.0 * x, 0.5 + 0.2 * x * x])
    particles = np.column_stack([x, 0.5 + 0.0 * x, 0.3 + 0.0 * x])
    bodies = [(cable, NO_FACES, np.column_stack([np.arange(20), np.arange(1, 21)])), (particles, NO_FACES)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=[False, True])
    return mesh, mesh.vertices, mesh.vertices - [0.0, 0.0, 0.5]


def over():
    """A ball falls on a half-space."""
    mesh = ccd.CollisionMesh.from_trimesh([BALL, ccd.HalfSpace([0, 0, 0], [0, 0, 1])])
    return mesh, BALL.vertices + [0, 0, 1.5], BALL.vertices + [0, 0, 0.3]


def result_of(mesh, start, end, **options):
    return mesh, start, end, ccd.mesh_ccd(mesh, start, end, **options)


# ---- Pictures --------------------------------------------------------------------------------------------------------


def pixels(path) -> np.ndarray:
    return np.asarray(pytest.importorskip("PIL.Image").open(path).convert("RGB")).astype(int)


@cache
def panels_of(scene, *arguments, size=SIZE, t_max=1.0, **options) -> list[np.ndarray]:
    """The three panels of the picture of a scene, without their titles."""
    picture = viz.draw_step(*result_of(*scene(*arguments), t_max=t_max), size=size, t_max=t_max, **options)
    assert picture.image.shape == (size[1], size[0], 3)
    return np.split(picture.image[size[1] // 10 :].astype(int), 3, axis=1)


def drawn(panel) -> np.ndarray:
    return (panel < 245).any(axis=2)


def alike(a, b) -> bool:
    """Equal but for rounding, and with it the pixels along a few silhouettes."""
    return bool((np.abs(a - b).max(axis=2) > 40).mean() < 0.005)


def red(panel) -> int:
    """Pixels in the colour of the contacts."""
    return int(((panel[..., 0] > 150) & (panel[..., 1:] < 80).all(axis=2)).sum())


def bluish(panel) -> int:
    return int((panel[..., 2] - panel[..., 0] > 30).sum())


def grey(panel) -> np.ndarray:
    return drawn(panel) & (np.ptp(panel, axis=2) < 12)


PICTURES = {  # a scene, its arguments, options, and what is to be seen in the panels of the start, the toi and the end
    "contacts at the toi alone": (balls, (), {}, lambda p: red(p[1]) > 20 and red(p[0]) == red(p[2]) == 0),
    "no contact": (balls, (1.0, 0.0, 2.0), {}, lambda p: alike(p[1], p[2]) and not alike(p[0], p[2])),
    "the end of what was looked at": (balls, (), {"t_max": 0.25}, lambda p: not red(p[1]) and not alike(p[1], p[2])),
    "static bodies grey": (balls, (), {"colour": "body"}, lambda p: min(grey(each).mean() for each in p) > 0.05),
    "a ball of 2 % on its way": (bullet, (), {}, lambda p: min(map(bluish, p[:2])) > 0 < red(p[1])),
    "cable and particles": (strings, (), {}, lambda p: min(map(bluish, p)) > 50 < bluish(p[0][..., ::-1])),
    "half-space": (over, (), {}, lambda p: grey(p[0]).mean() > 0.02),
}


@pytest.mark.parametrize("name", PICTURES)
def test_picture_shows(name, drawing):
    scene, arguments, options, is_seen = PICTURES[name]
    environment = dict(os.environ)
    assert is_seen(panels_of(scene, *arguments, **options)) and dict(os.environ) == environment


def test_a_picture_is_shown_by_a_notebook_and_stands_for_its_file(drawing, tmp_path):
    step, path = result_of(*balls()), tmp_path / "step.png"
    picture = viz.draw_step(*step, size=SIZE)
    assert picture.image.shape == (200, 600, 3) and picture.image.dtype == np.uint8
    assert np.array_equal(pixels(io.BytesIO(picture._repr_png_())), picture.image)
    saved = viz.render_step(*step, path, size=SIZE)
    assert os.fspath(saved) == str(path) and np.array_equal(pixels(saved), saved.image)
    launched = ccd.CollisionPipeline(step[0]).launch(*step[1:3]).to_host()
    assert viz.draw_step(*step[:3], launched, size=SIZE).image.shape == picture.image.shape


# ---- What is drawn ---------------------------------------------------------------------------------------------------


def test_scene_has_no_place_and_no_unit_and_its_titles_round_no_toi_up():
    reference = make_scene(*result_of(*balls()))
    for scale, offset in ((1.0, 1e6), (1e-6, 0.0), (1e300, 0.0)):
        scene = make_scene(*result_of(*balls(scale, offset)))
        # 2**-53 of an offset of 1e6, over the half side of 1.6
        assert np.allclose(scene.start, reference.start, atol=1e-9) and np.allclose(scene.end, reference.end, atol=1e-9)
    assert np.abs(np.vstack([reference.start, reference.end])).max() == 1.0
    for toi, text in ((0.3, "0.3"), (0.4877777777, "0.487777"), (1.0, "1"), (0.0, "0")):
        assert viz._rounded_down(toi) == text


def test_the_legend_names_what_moves_and_what_is_static():
    bodies = [(np.eye(3) + 3.0 * k, [[0, 1, 2]]) for k in range(9)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[7, 8], kinematic=[0])
    texts = [text for _, text in make_scene(*result_of(mesh, mesh.vertices, mesh.vertices)).legend]
    assert texts == ["body 0, kinematic", "body 1, moving", "and 5 more, moving", "body 7, body 8, static"]


def test_bodies_that_turn_are_placed_on_their_arcs():
    """A bar that turns by 4 radians about z while it rises, and a ball in its way."""
    bar, ball = trimesh.creation.box((2.0, 0.2, 0.2)), trimesh.creation.icosphere(subdivisions=2, radius=0.35)
    mesh = ccd.CollisionMesh.from_trimesh([bar, ball], names=["bar", "ball"])
    poses = [[0, 0, 0, 0, 0, 0, 1], [0.2, 1.2, 0.1, 0, 0, 0, 1]]
    twist = [[0, 0, 0.3, 0, 0, 4.0], [0.1, -0.4, 0, 0, 0, 0]]
    motion, result = ccd.RigidMotion(poses, twist=twist), ccd.rigid_ccd(mesh, poses, twist=twist)
    step = mesh, mesh.vertices, mesh.vertices

    def bar_at(t):
        c, s = np.cos(4.0 * t), np.sin(4.0 * t)
        return bar.vertices @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [0, 0, 0.3 * t]

    scene = make_scene(*step, result, motion)
    # the picture is moved and scaled, so distances between two of its times are compared
    unit = np.linalg.norm(scene.start[1] - scene.start[0]) / np.linalg.norm(mesh.vertices[1] - mesh.vertices[0])
    moved = (scene.positions(0.3) - scene.positions(0.0))[:8]
    assert np.allclose(moved, unit * (bar_at(0.3) - bar_at(0.0)), atol=1e-12)
    # the path of the bar reaches farther than its places at both ends, and all of it is in the picture
    assert 0.99 < np.abs(scene.between).max() <= 1.0 + 1e-12 and len(scene.trails) > 2
    if not _reason_not_to_draw():
        block = viz.to_pyvista(*step, result, t=result.toi, motion=motion)["bar"]
        assert np.allclose(block.points, bar_at(result.toi), atol=1e-6) and block.field_data["static"].tolist() == [0]
        assert np.allclose(block.point_data["displacement"], bar_at(1.0) - bar_at(0.0), atol=1e-12)
        assert block.point_data["toi"].tolist() == result.vertex_toi[:8].tolist()


# ---- Refusals --------------------------------------------------------------------------------------------------------


def test_an_extra_that_is_not_there_is_named(tmp_path, monkeypatch, capfd):
    step = result_of(*balls())
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match=r"pip install 'ccd-warp\[viz\]'"):
        viz.render_step(*step, tmp_path / "step.png")
    assert main(["demo", "--pictures", str(tmp_path)]) == 2
    shown = capfd.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and "pip install 'ccd-warp[viz]'" in shown.err
