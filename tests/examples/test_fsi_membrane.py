"""The particles of the example stay on their side with CCD, and do not without, by the winding number."""

import numpy as np
import pytest
from conftest import loaded_example

import ccd_warp as ccd

NUM_PARTICLES, RESOLUTION, NUM_FRAMES = 600, 16, 60


@pytest.fixture(scope="module")
def fsi_membrane():
    pytest.importorskip("igl", reason="the extra examples is not installed")
    with loaded_example("fsi_membrane") as module:
        yield module


def run(module, with_ccd):
    """The scene after some frames; of each: particles on the wrong side, heights, and the stretch of the membrane."""
    scene = module.Trampoline(NUM_PARTICLES, RESOLUTION, with_ccd=with_ccd)
    counts, heights, stretch = [], [], []
    for frame in range(NUM_FRAMES):
        scene.advance(frame)
        scene.check_capacity()
        vertices = scene.x.numpy().astype(np.float64)
        counts.append(module.wrong_side(scene, vertices))
        heights.append(vertices[:, 2])
        stretch.append(module.longest_edge(scene, vertices))
    return scene, counts, np.array(heights), np.array(stretch)


def test_no_particle_changes_sides_with_ccd(fsi_membrane):
    scene, counts, heights, stretch = run(fsi_membrane, True)
    assert counts == [0] * NUM_FRAMES
    membrane, fluid = heights[:, : scene.num_membrane], heights[:, scene.num_membrane :]
    # it moves, as far as its rim is told to, and it gives way, as a sheet that hardly stretches
    assert 0.9 * fsi_membrane.STROKE < membrane.max() < 1.5 * fsi_membrane.STROKE
    assert -0.2 < membrane.min() < -0.08
    assert stretch.max() < 1.1
    # it throws the fluid up, above its highest point, but not as by an explosion
    assert fsi_membrane.STROKE < np.median(fluid, axis=1).max() and fluid.max() < 4 * fsi_membrane.STROKE
    assert np.quantile(scene.compression.numpy(), 0.95) < 0.2


@pytest.mark.long  # says something of the scene, not of the library
def test_the_steps_are_too_large_without_ccd(fsi_membrane):
    assert max(run(fsi_membrane, False)[1]) > 10


def test_only_particles_and_faces_are_looked_for(fsi_membrane):
    scene = fsi_membrane.Trampoline(NUM_PARTICLES, RESOLUTION)
    found = ccd.find_candidates(scene.mesh, scene.mesh.vertices, scene.mesh.vertices, 0.1, pair_kinds=["vertex_face"])
    assert (found.vertex_face[:, 0] >= scene.num_membrane).all() and len(found.vertex_face)


def test_the_check_sees_a_particle_below_the_membrane(fsi_membrane):
    scene = fsi_membrane.Trampoline(NUM_PARTICLES, RESOLUTION)
    vertices = scene.mesh.vertices.copy()
    assert fsi_membrane.wrong_side(scene, vertices) == 0
    vertices[scene.num_membrane : scene.num_membrane + 7, 2] *= -1.0
    assert fsi_membrane.wrong_side(scene, vertices) == 7


def test_the_series_reads_back(fsi_membrane, tmp_path):
    meshio = pytest.importorskip("meshio", reason="the extra examples is not installed")
    scene = fsi_membrane.Trampoline(NUM_PARTICLES, RESOLUTION)
    fsi_membrane.write_frame(
        tmp_path / "frame.vtu", scene, scene.mesh.vertices, np.full(scene.mesh.num_vertices, np.inf)
    )
    fsi_membrane.write_series(tmp_path / "series.pvd", ["frame.vtu"])
    frame = meshio.read(tmp_path / "frame.vtu")
    cells = {block.type: len(block.data) for block in frame.cells}
    num_particles = scene.mesh.num_vertices - scene.num_membrane
    assert cells == {"triangle": len(scene.mesh.faces), "vertex": num_particles}
    assert set(frame.point_data) == {"velocity", "toi"}
    assert (tmp_path / "series.pvd").read_text().count("frame.vtu") == 1
