"""The nut of the example sits on the head after the turns that its lengths give, and jams where its pitch is wrong."""

import numpy as np
import pytest
from conftest import loaded_example

START = 3


@pytest.fixture
def nut_on_bolt(monkeypatch):
    with loaded_example("nut_on_bolt") as module:
        monkeypatch.setattr(module, "BOLT_TURNS", START + 4)
        monkeypatch.setattr(module, "NUT_TURNS", 2)
        monkeypatch.setattr(module, "START", START)
        yield module


def test_the_nut_sits_on_the_head_after_as_many_turns_as_its_lengths_give_and_comes_up_again(nut_on_bolt):
    scene = nut_on_bolt.Nut()
    assert [scene.turn(-1.0) for _ in range(START)] == [1.0] * START
    last = scene.turn(-1.0)
    # its lower side and the top of the head are parallel, and it stops at the distance kept
    expected = (-nut_on_bolt.HEAD_TOP - nut_on_bolt.KEPT) / nut_on_bolt.PITCH
    assert expected - 1e-6 < last <= expected
    assert scene.positions()[scene.mesh.vertex_body == 1, 2].min() == pytest.approx(
        nut_on_bolt.HEAD_TOP + nut_on_bolt.KEPT, abs=1e-5
    )
    assert scene.turn(2.0) == 1.0 and scene.turns == pytest.approx(-START - last + 2.0)


def test_a_nut_of_another_pitch_jams_when_the_clearance_is_used_up(nut_on_bolt):
    scene = nut_on_bolt.Nut()
    free = scene.turn(-3.0, 1.02 * nut_on_bolt.PITCH)
    # along the axis the flanks are as far apart as the clearance times their slope, less what is kept and the facets
    apart = nut_on_bolt.CLEARANCE * 0.25 * nut_on_bolt.PITCH / (nut_on_bolt.CREST - nut_on_bolt.ROOT)
    turns = apart / (0.02 * nut_on_bolt.PITCH)
    assert 0.4 * turns < -scene.turns < turns and 0.0 < free < 1.0


def test_vertices_are_on_helices(nut_on_bolt):
    scene = nut_on_bolt.Nut()
    start = scene.positions()
    scene.pose = scene.motion(-1.25).poses_t1
    x, y, z = (scene.positions() - start)[scene.mesh.vertex_body == 1].T
    before = start[scene.mesh.vertex_body == 1]
    # a quarter of a turn to the left beyond the whole one
    np.testing.assert_allclose(np.stack([x, y], axis=1) + before[:, :2], before[:, [1, 0]] * [1, -1], atol=1e-12)
    np.testing.assert_allclose(z, -1.25 * nut_on_bolt.PITCH, rtol=1e-12)
