"""The layers of the example keep their thickness, rest on the ball, and all come free when they are lifted."""

import numpy as np
import pytest
from conftest import loaded_example

RESOLUTION, NUM_FRAMES = 12, 40


@pytest.fixture(scope="module")
def two_layers():
    with loaded_example("two_layers") as module:
        yield module


def test_layers_keep_their_thickness_and_none_of_their_vertices_is_stuck(two_layers):
    scene = two_layers.TwoLayers(RESOLUTION)
    thickness = 2 * two_layers.RADIUS
    for _ in range(NUM_FRAMES):
        scene.advance()
        # with a fraction of the gap at the start, 0.5, it is 2e-7 mm in the end
        assert scene.least_distance() > thickness * (1 - 1e-9)
        assert not len(scene.pipeline.find_intersections(scene.positions))
    # they lie on the ball: the search has stopped some of their pairs, and neither layer has slid off
    lower, upper = scene.positions[scene.moves].reshape(2, -1, 3)
    assert two_layers.BALL_RADIUS < lower[:, 2].max() < upper[:, 2].max() < two_layers.BALL_RADIUS + 0.01
    assert (scene.pipeline.find_proximity(scene.positions, 1e-3 * thickness).distance < 1.001 * thickness).sum() > 20
    edges = np.linalg.norm(np.subtract(*scene.positions[scene.springs.T]), axis=1) / scene.rest_length
    assert 0.9 < edges.min() and edges.max() < 1.3
    # 0 in a strict search, start_gap_fraction=None
    np.testing.assert_allclose(scene.lift(), two_layers.LIFT[2], rtol=1e-12)
    assert scene.least_distance() > thickness * (1 - 1e-9)
