"""Worlds in quantized coordinates: each in a cell of its own, wherever it is and however large, with all its pairs."""

from dataclasses import dataclass

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes.box_tree import fill_vertex_aabbs
from expected_warnings import OF_ROUNDING
from oracles import brute_force
from scenes import soup

import ccd_warp as ccd
from ccd_warp._engine.mesh.samples import uneven_samples
from ccd_warp._engine.mesh.topology import NUM_SAMPLES, Topology, choose_quantization
from ccd_warp._engine.mesh.worlds import lattice_bits, world_lattice
from ccd_warp._runtime.launch import Execution

pytestmark = OF_ROUNDING

DEVICE = wp.get_device("cpu")
_LARGEST = np.finfo(np.float64).max


@dataclass
class Worlds:
    """Faces at random places, two bodies to a world, of which every third has a static one."""

    mesh: ccd.CollisionMesh
    start: np.ndarray
    end: np.ndarray
    hides_gaps: bool = False  # coordinates are so large that by rounding all may touch: what a search keeps may differ


def worlds(count, numbers=None, sizes=1.0, seed=0):
    rng = np.random.default_rng(seed)
    numbers = np.arange(count) if numbers is None else numbers
    bodies = [soup(rng, 2, 0.3) for _ in range(2 * count)]
    size = np.broadcast_to(sizes, count)
    bodies = [(vertices * size[k // 2], faces) for k, (vertices, faces) in enumerate(bodies)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=range(1, 2 * count, 6), vertex_world=np.repeat(numbers, 12))
    motion = 0.2 * rng.standard_normal((len(mesh.vertices), 3)) * np.repeat(size, 12)[:, None]
    motion[mesh.static[mesh.vertex_body]] = 0.0
    return Worlds(mesh, mesh.vertices.copy(), mesh.vertices + motion)


def in_one_place():
    return worlds(24)


def far_apart():
    scene = worlds(9)
    offset = 1e12 * scene.mesh.vertex_world[:, None] ** 3
    scene.start += offset
    scene.end += offset
    return scene


def of_very_different_sizes():
    return worlds(10, sizes=10.0 ** np.array([-300, -40, -9, -1, 0, 0, 1, 9, 40, 290]))


def vertices_that_have_flown_away():
    scene = worlds(9)
    for world, values in {1: [1e9], 2: [_LARGEST], 3: [-_LARGEST, _LARGEST, 1e300], 4: [1e40] * 7}.items():
        scene.start[12 * world : 12 * world + len(values)] = np.array(values)[:, None]
    scene.end[60:63] = -1e200
    scene.hides_gaps = True
    return scene


def of_a_wall_much_larger_than_what_moves():
    scene = worlds(20)
    scene.start[18::12] *= 1e4
    scene.end[18::12] *= 1e4
    return scene


def seen_from_a_place_that_is_none_of_theirs():
    scene = worlds(9)
    scene.mesh = scene.mesh.replicate(1)
    scene.start, scene.end = scene.start * 50.0 - 2000.0, scene.end * 50.0 - 2000.0
    return scene


def with_numbers_left_out():
    return worlds(4, numbers=np.array([0, 3, 9, 40]))


def of_vertices_that_take_turns():
    """Two worlds, each with half of every body."""
    rng = np.random.default_rng(3)
    vertices, faces = soup(rng, 12, 0.3)
    mesh = ccd.CollisionMesh.from_arrays([(vertices, faces)] * 2, vertex_world=np.arange(72) // 3 % 2)
    return Worlds(mesh, mesh.vertices.copy(), mesh.vertices + 0.2 * rng.standard_normal((72, 3)))


SCENES = [
    in_one_place,
    far_apart,
    of_very_different_sizes,
    vertices_that_have_flown_away,
    of_a_wall_much_larger_than_what_moves,
    seen_from_a_place_that_is_none_of_theirs,
    with_numbers_left_out,
    of_vertices_that_take_turns,
]


@pytest.fixture(scope="module", params=SCENES, ids=lambda make: make.__name__)
def scene(request):
    return request.param()


def quantized(scene, positions=None):
    """Lower and upper corners of the AABBs of all vertices at both ends, in quantized coordinates, [V, 2, 3] each."""
    mesh = scene.mesh
    topology = Topology(mesh, DEVICE)
    quantization = choose_quantization(topology, positions or (scene.start, scene.end), 2)
    every = wp.array(np.arange(mesh.num_vertices), dtype=wp.int32)
    active = wp.ones(mesh.num_bodies, dtype=wp.int32)
    aabbs = wp.empty(mesh.num_vertices * 16, dtype=wp.float32)
    frames = [wp.array(x, dtype=wp.vec3d) for x in (scene.start, scene.end)]
    inputs = [every, *topology.of_vertices(active), *frames, 1.0, 0.0, topology.box_radius, quantization.packed, 2]
    Execution(DEVICE, 1).launch(fill_vertex_aabbs, mesh.num_vertices, inputs=inputs, outputs=[aabbs])
    corners = aabbs.numpy().reshape(-1, 2, 2, 4)[..., :3]
    return corners[:, :, 0], -corners[:, :, 1]


def test_all_boxes_of_a_world_lie_in_its_cell(scene):
    # at the positions of the step, and as a launch has it, which knows those of the mesh alone
    for positions in (None, (scene.mesh.vertices, scene.mesh.vertices)):
        lower, upper = quantized(scene, positions)
        num_worlds = scene.mesh.num_worlds
        middle = world_lattice(num_worlds)[scene.mesh.vertex_world][:, None]
        assert np.isfinite(lower).all() and (lower <= upper).all()
        distance = np.maximum(np.abs(lower - middle), np.abs(upper - middle)).max()
        assert distance < 0.99 * 2.0 ** -(lattice_bits(num_worlds) + 1)
        assert len(np.unique(middle.reshape(-1, 3), axis=0)) == len(np.unique(scene.mesh.vertex_world))


def test_what_is_apart_keeps_its_order_in_each_world(scene):
    lower, upper = quantized(scene)
    exact = np.stack([scene.start, scene.end], axis=1)
    for world in np.unique(scene.mesh.vertex_world):
        rows = np.flatnonzero(scene.mesh.vertex_world == world)
        for axis in range(3):
            order = np.argsort(exact[rows, :, axis], axis=None)
            for corners in (lower, upper):
                assert (np.diff(corners[rows, :, axis].ravel()[order]) >= 0).all()


def test_every_world_has_the_pairs_that_it_has_alone(scene):
    mesh = scene.mesh
    bodies = [
        (mesh.vertices[begin:end], mesh.faces[mesh.face_body == body] - begin)
        for body, (begin, end) in enumerate(zip(mesh.body_vertex_range, mesh.body_vertex_range[1:], strict=False))
    ]
    together = ccd.CollisionMesh.from_arrays(bodies, static=np.flatnonzero(mesh.static))
    world = {"vertex_face": (mesh.vertex_world, mesh.vertex_world[mesh.faces[:, 0]])}
    world["edge_edge"] = (mesh.vertex_world[mesh.edges[:, 0]],) * 2
    everything = dict(zip(("vertex_face", "edge_edge"), brute_force(together, scene.start, scene.end), strict=False))
    for broad_phase in ("tree", "hash"):
        found = ccd.find_candidates(mesh, scene.start, scene.end, device="cpu", broad_phase=broad_phase).sorted()
        for kind, (one, other) in world.items():
            expected = [(i, j) for i, j in everything[kind] if one[i] == other[j]]
            assert list(map(tuple, getattr(found, kind).tolist())) == expected


def test_both_drivers_and_broad_phases_give_the_same_results(scene):
    frames = scene.start, scene.end
    results = {}
    for broad_phase in ("tree", "hash"):
        pipeline = ccd.CollisionPipeline(scene.mesh, device="cpu", broad_phase=broad_phase, max_pairs=1 << 15)
        results[broad_phase] = pipeline.mesh_ccd(*frames), pipeline.launch(*frames).to_host()
    for name in ("vertex_toi", "body_toi", "world_toi", "vertex_contact", "body_contact", "world_contact"):
        of_drivers = zip(*results.values(), strict=True)
        on_host, launched = ([getattr(result, name) for result in of_driver] for of_driver in of_drivers)
        assert np.array_equal(*on_host) and np.array_equal(*launched), name
        assert scene.hides_gaps or np.array_equal(on_host[0], launched[0]), name


@pytest.mark.parametrize("broad_phase", ["tree", "hash"])
def test_boxes_of_static_bodies_stay_right_while_all_else_moves_away(broad_phase):
    rng = np.random.default_rng(7)
    bodies = [soup(rng, 4, 0.3), soup(rng, 1, 0.5)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1], self_collision=False).replicate(6)
    moves = ~mesh.static[mesh.vertex_body]
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", broad_phase=broad_phase)
    for shift in (0.0, 0.3, -0.9, 2.5):
        start, end = mesh.vertices.copy(), mesh.vertices.copy()
        start[moves] += shift
        end[moves] -= shift
        expected = ccd.CollisionPipeline(mesh, device="cpu", broad_phase=broad_phase).mesh_ccd(start, end)
        assert shift == 0.0 or len(expected.contacts)
        for result in (pipeline.mesh_ccd(start, end), pipeline.launch(start, end).to_host()):
            assert np.array_equal(result.vertex_toi, expected.vertex_toi)


def test_walls_of_many_worlds_are_met_where_they_stand_in_each_step():
    """A point passes a wall in each of 20 worlds; later one wall stands far away, and one moves, which is refused."""
    face = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
    bodies = [(np.array([[0.0, 0, 1]]), np.zeros((0, 3), dtype=int)), (face, [[0, 1, 2]])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1], codimensional_points=True).replicate(20)
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    start = mesh.vertices.copy()
    down = np.where(mesh.static[mesh.vertex_body][:, None], 0.0, [0, 0, -2])
    for elsewhere in ([], [13], [4], []):
        x = start.copy().reshape(20, 4, 3)
        x[elsewhere, 1:, 0] += 9.0
        found = pipeline.mesh_ccd(x, x + down.reshape(20, 4, 3)).world_toi
        assert np.array_equal(np.flatnonzero(np.isinf(found)), elsewhere) and found.min() == pytest.approx(0.5)
    end = start + down
    end[4 * 17 + 2] += 0.1
    with pytest.raises(ValueError, match=r"vertex 1 of body 35 .* \(row 70\)"):
        pipeline.mesh_ccd(start, end)


def test_the_earliest_contact_of_each_world():
    scene = worlds(NUM_SAMPLES)
    result = ccd.mesh_ccd(scene.mesh, scene.start, scene.end, device="cpu")
    assert result.world_contact.dtype == np.int32 and result.world_contact.shape == (NUM_SAMPLES,)
    for world, k in enumerate(result.world_contact):
        of_world = np.flatnonzero(result.contacts.world == world)
        assert k == (of_world[np.argmin(result.contacts.toi[of_world])] if len(of_world) else -1)
        assert (k < 0) == np.isinf(result.world_toi[world])
    assert 0 < (result.world_contact >= 0).sum() < NUM_SAMPLES


def extents(scene):
    """The longest side of each world, as a share of its cell."""
    lower, upper = quantized(scene)
    rows = [scene.mesh.vertex_world == world for world in range(scene.mesh.num_worlds)]
    sides = [(upper[at].max(axis=(0, 1)) - lower[at].min(axis=(0, 1))).max() for at in rows]
    return np.array(sides) * 2.0 ** lattice_bits(scene.mesh.num_worlds)


@pytest.mark.parametrize("count", [NUM_SAMPLES - 3, NUM_SAMPLES, 4 * NUM_SAMPLES])
def test_the_part_of_a_cell_that_a_world_takes_is_the_same_for_any_number_of_worlds(count):
    """With samples at a fixed distance all of them were the first vertex of a world, and the scene had no extent."""
    mesh = ccd.CollisionMesh.from_arrays([soup(np.random.default_rng(5), 40, 0.01)]).replicate(count)
    assert (abs(np.log2(extents(Worlds(mesh, mesh.vertices, mesh.vertices))) + 4) < 2).all()


def test_worlds_of_all_sizes_take_like_parts_of_their_cells():
    part = extents(worlds(7, sizes=10.0 ** np.array([-9, -3, 0, 0, 0, 2, 9])))
    assert part.max() < 16 * part.min() and part.min() > 1 / 64


@pytest.mark.parametrize("count", [0, 1, 5, NUM_SAMPLES, 24 * NUM_SAMPLES, 10**9])
def test_samples_are_spread_over_all_numbers_and_stand_at_no_fixed_distance(count):
    samples = uneven_samples(count, NUM_SAMPLES)
    assert (samples == np.clip(np.sort(samples), 0, max(count - 1, 0))).all()
    if count > 10 * NUM_SAMPLES:
        assert (samples * NUM_SAMPLES // count == np.arange(NUM_SAMPLES)).all()
        assert len(np.unique(samples % (count // NUM_SAMPLES))) > 20
