"""The particles of the example stay on their side with CCD, and do not without, by the winding number."""

import numpy as np
import pytest
from conftest import loaded_example

import ccd_warp as ccd

RESOLUTION, NUM_FRAMES = 12, 60


@pytest.fixture(scope="module")
def fsi_membrane():
    pytest.importorskip("igl", reason="the extra examples is not installed")
    with loaded_example("fsi_membrane") as module:
        yield module


def wrong_side(scene, vertices):
    """Number of particles below the membrane: outside of the surface that it makes with four walls and a lid."""
    from igl import winding_number

    m = scene.num_membrane
    faces = scene.mesh.faces.astype(np.int64)
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, first, number = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    a, b = sides[first[number == 1]].T  # along the rim, as the faces go around
    rim = np.unique(a)
    lifted = np.searchsorted(rim, [a, b]) + m
    wall = np.concatenate([np.stack([b, a, lifted[0]], axis=1), np.stack([b, lifted[0], lifted[1]], axis=1)])
    lid = np.stack([lifted[1], lifted[0], np.full(len(a), m + len(rim))], axis=1)
    top = vertices[:, 2].max() + 1.0
    points = np.concatenate([vertices[:m], vertices[rim] * [1, 1, 0] + [0, 0, top], [[0, 0, top]]])
    numbers = winding_number(points, np.concatenate([faces, wall, lid]), vertices[m:].copy())
    return int((np.abs(numbers) < 0.5).sum())


def longest_edge(scene, vertices):
    """The 99th percentile of the lengths of the membrane's edges, as multiples of their lengths at rest."""
    edges = scene.mesh.edges
    lengths = [np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) for x in (scene.mesh.vertices, vertices)]
    return float(np.quantile(lengths[1] / lengths[0], 0.99))


def run(module, with_ccd):
    """The scene after some frames; of each: particles on the wrong side, positions, and the stretch of the membrane."""
    scene = module.Trampoline(RESOLUTION, with_ccd=with_ccd)
    counts, frames, stretch = [], [], []
    for frame in range(NUM_FRAMES):
        scene.advance(frame)
        assert not any(result.flags.numpy()[0] for result in scene.results)
        vertices = scene.x.numpy().astype(np.float64)
        counts.append(wrong_side(scene, vertices))
        frames.append(vertices)
        stretch.append(longest_edge(scene, vertices))
    return scene, counts, np.array(frames), np.array(stretch)


def neighbours_apart(points):
    """The 5th percentile of the distances of points to their nearest neighbours."""
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    np.fill_diagonal(apart, np.inf)
    return np.quantile(apart.min(axis=1), 0.05)


def test_no_particle_changes_sides_with_ccd(fsi_membrane):
    scene, counts, frames, stretch = run(fsi_membrane, True)
    assert counts == [0] * NUM_FRAMES
    membrane, fluid = frames[:, : scene.num_membrane, 2], frames[:, scene.num_membrane :, 2]
    # it moves, as far as its rim is told to, and it gives way, as a sheet that hardly stretches
    assert 0.9 * fsi_membrane.STROKE < membrane.max() < 1.5 * fsi_membrane.STROKE
    assert -0.2 < membrane.min() < -0.08
    assert stretch.max() < 1.1
    # it throws the fluid up, above its highest point, but not as by an explosion
    assert fsi_membrane.STROKE < np.median(fluid, axis=1).max() and fluid.max() < 4 * fsi_membrane.STROKE
    # which is hardly compressed, and within the walls
    assert neighbours_apart(frames[-1, scene.num_membrane :]) > 0.8 * scene.spacing
    assert np.abs(frames[:, scene.num_membrane :, :2]).max() < 0.5 * fsi_membrane.SIDE


@pytest.mark.long  # says something of the scene, not of the library
def test_the_steps_are_too_large_without_ccd(fsi_membrane):
    assert max(run(fsi_membrane, False)[1]) > 10


def test_only_particles_and_faces_are_looked_for(fsi_membrane):
    scene = fsi_membrane.Trampoline(RESOLUTION)
    found = ccd.find_candidates(scene.mesh, scene.mesh.vertices, scene.mesh.vertices, 0.1, pair_kinds=["vertex_face"])
    assert (found.vertex_face[:, 0] >= scene.num_membrane).all() and len(found.vertex_face)


def test_the_check_sees_a_particle_below_the_membrane(fsi_membrane):
    scene = fsi_membrane.Trampoline(RESOLUTION)
    vertices = scene.mesh.vertices.copy()
    assert wrong_side(scene, vertices) == 0
    vertices[scene.num_membrane : scene.num_membrane + 7, 2] *= -1.0
    assert wrong_side(scene, vertices) == 7
