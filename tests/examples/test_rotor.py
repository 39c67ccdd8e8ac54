"""No grain of the example comes nearer to a blade than its radius, in many places of a frame; with chords some do."""

import numpy as np
import pytest
from conftest import loaded_example

NUM_GRAINS, NUM_FRAMES = 300, 14


@pytest.fixture(scope="module")
def rotor():
    with loaded_example("rotor") as module:
        yield module


def run(module, with_arcs):
    """The scene after some frames, and how many grains were in a blade."""
    scene, num_inside = module.Mixer(NUM_GRAINS, with_arcs=with_arcs), 0
    for _ in range(NUM_FRAMES):
        num_inside += scene.num_inside(*scene.advance(module.TURN))
    return scene, num_inside


def test_no_grain_gets_into_a_blade_and_the_rotor_turns(rotor):
    scene, num_inside = run(rotor, True)
    assert num_inside == 0
    assert scene.waited < 0.1 and scene.angle > (NUM_FRAMES - 0.1) * rotor.TURN
    # the box holds the grains, and the blades have thrown some of them up and to the sides
    half = 0.5 * rotor.SIDE - rotor.RADIUS
    assert np.abs(scene.x[:, :2]).max() <= half and scene.x[:, 2].min() >= rotor.RADIUS
    height = scene.mesh.vertices[scene.num_rotor :, 2].max()
    assert height < scene.x[:, 2].max() < 10.0 * height
    assert np.quantile(np.linalg.norm(scene.velocity, axis=1), 0.9) < 3 * rotor.TURN * rotor.BLADE[0] / rotor.FRAME_TIME


def test_grains_get_into_blades_whose_vertices_move_on_chords(rotor):
    assert run(rotor, False)[1] > 10


def test_the_check_sees_a_grain_in_a_blade(rotor):
    scene = rotor.Mixer(NUM_GRAINS)
    assert scene.num_inside(scene.x, 0.0) == 0
    middle = scene.blades[1][:3, 3] + [0.0, 0.0, rotor.BLADE_HEIGHT]
    beside = scene.blades[2][:3, :3] @ [0.0, 0.5 * rotor.BLADE[1] + 0.9 * rotor.RADIUS, 0.0]
    scene.x[:2] = [middle, scene.blades[2][:3, 3] + [0.0, 0.0, rotor.BLADE_HEIGHT] + beside]
    assert scene.num_inside(scene.x, 0.0) == 2
