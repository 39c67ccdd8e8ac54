"""Worlds: copies of a mesh, positions with an axis of worlds, and a cell of quantized coordinates for each world."""

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes.box_tree import fill_vertex_aabbs
from expected_warnings import OF_ROUNDING
from scenes import FACE, NO_FACES, TRIANGLE, cloth_and_ball_in_worlds, soup

import ccd_warp as ccd
from ccd_warp._engine.mesh.topology import NUM_SAMPLES, Topology, choose_quantization
from ccd_warp._engine.mesh.worlds import lattice_bits, world_lattice
from ccd_warp._runtime.launch import Execution

pytestmark = OF_ROUNDING

_LARGEST = np.finfo(np.float64).max

# --- copies of a mesh ---


def test_copies_of_a_mesh_are_worlds_of_their_own():
    bodies, pairs = [(TRIANGLE, FACE), (np.eye(4, 3), NO_FACES, [[0, 1]])], ~np.eye(2, dtype=bool)
    options = {"codimensional_points": [False, True], "self_collision": [True, False], "body_pairs": pairs}
    one = ccd.CollisionMesh.from_arrays(
        bodies, exclusion_rings=2, static=[1], kinematic=["a"], names=["a", "b"], **options
    )
    mesh, n = one.replicate(2).replicate(2), one.num_vertices
    assert mesh.num_worlds == 4 and mesh.exclusion_rings == 2 and "4 worlds" in repr(mesh)
    assert one.replicate(2).names == ("a[0]", "b[0]", "a[1]", "b[1]") and len({*mesh.names}) == 8
    assert mesh.kinematic.tolist() == [True, False] * 4
    assert np.array_equal(mesh.moving_vertices, np.flatnonzero(np.arange(4 * n) % n < 3))
    assert mesh.static.tolist() == [False, True] * 4 and mesh.self_collision.tolist() == [True, False] * 4
    assert np.array_equal(mesh.vertices.reshape(4, n, 3)[3], one.vertices)
    assert mesh.vertex_world.tolist() == np.repeat(range(4), n).tolist()
    for name in ("faces", "edges", "codimensional_points"):
        own = getattr(one, name)
        assert np.array_equal(getattr(mesh, name).reshape(4, *own.shape)[2], own + 2 * n)
    assert mesh.edges[mesh.codimensional_edges].tolist() == [[3 + n * w, 4 + n * w] for w in range(4)]
    assert np.array_equal(mesh.body_pairs[2:4, 2:4], pairs) and mesh.body_pairs.shape == (8, 8)


@pytest.mark.parametrize("make", ["list", "numpy", "numpy float32", "warp float64", "warp vec3d", "warp vec3f"])
def test_every_call_takes_positions_with_an_axis_of_worlds_and_launches_write_through_it(make):
    one, mesh, start, end = cloth_and_ball_in_worlds()
    real = np.float32 if make.endswith(("f", "32")) else np.float64
    start, end = start.astype(real), end.astype(real)

    def array(x, device="cpu"):
        dtype = {"warp float64": wp.float64, "warp vec3d": wp.vec3d, "warp vec3f": wp.vec3f}.get(make)
        return wp.array(x, dtype=dtype, device=device) if dtype else x.tolist() if make == "list" else x.copy()

    alone, flat = ccd.mesh_ccd(one, start[0], end[0]), [x.reshape(-1, 3) for x in (start, end)]
    expected = ccd.mesh_ccd(mesh, *flat)
    assert expected.world_toi.tolist() == [alone.toi, alone.toi, np.inf, np.inf] and alone.hit
    assert expected.first.world == 0 and expected.first.body_names == tuple(f"{n}[0]" for n in alone.first.body_names)
    for t1 in (end, end[:, :25]):  # all, or the cloths alone
        assert np.array_equal(ccd.mesh_ccd(mesh, array(start), array(t1)).vertex_toi, expected.vertex_toi)
    searched = ccd.line_search(mesh, array(start), array(end), per="world").vertices
    assert np.array_equal(searched, ccd.line_search(mesh, *flat, per="world").vertices)
    if make == "list":
        return  # launches take arrays alone
    pipeline, there = ccd.CollisionPipeline(mesh), lambda x: array(x, None)
    wished = there(end)
    pipeline.reserve(vertices=start)
    for t1 in (end, end[:, :25]):
        assert np.array_equal(pipeline.launch(there(start), there(t1)).world_toi.numpy(), expected.world_toi)
    moved = pipeline.launch(there(start), displacements=there(end - start)).world_toi.numpy()
    assert np.isfinite(moved).tolist() == [True, True, False, False]
    pipeline.launch_line_search(there(start), wished, per="world")
    shortened = (wished.numpy() if isinstance(wished, wp.array) else wished).reshape(end.shape)
    assert (shortened[:2, :25, 2] > end[:2, :25, 2]).all() and np.array_equal(shortened[2:], end[2:])


def test_copies_of_several_worlds_have_an_axis_of_copies_and_worlds_of_different_sizes_none():
    bodies = [(TRIANGLE, FACE), (np.eye(4, 3), FACE)]
    one = ccd.CollisionMesh.from_arrays(bodies, vertex_world=[0] * 3 + [1] * 4, static=[1])
    mesh, start = one.replicate(3), np.tile(one.vertices, (3, 1, 1))
    end = start + [0.0, 0.0, 0.5] * (np.arange(7) < 3)[:, None]
    assert np.array_equal(mesh.frames(start, end[:, :3])[1], mesh.frames(mesh.vertices, end.reshape(-1, 3))[1])
    twice = cloth_and_ball_in_worlds(2)[1].replicate(3)
    for blocks in (6, 3, 2, 1):
        assert np.array_equal(twice.frame(twice.vertices.reshape(blocks, -1, 3)), twice.vertices)
    with pytest.raises(ValueError, match=r"vertices_t0 has shape \(7, 1, 3\); expected \(7, 3\) one row a vertex"):
        one.frame(one.vertices[:, None])


# --- in quantized coordinates ---


def worlds(count, numbers=None, sizes=1.0):
    """Faces at random places, two bodies to a world, of which every third has a static one: mesh, start and end."""
    rng, size = np.random.default_rng(0), np.broadcast_to(sizes, count)
    bodies = [(vertices * size[k // 2], faces) for k in range(2 * count) for vertices, faces in [soup(rng, 2, 0.3)]]
    numbers = np.arange(count) if numbers is None else numbers
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=range(1, 2 * count, 6), vertex_world=np.repeat(numbers, 12))
    motion = 0.2 * rng.standard_normal((len(mesh.vertices), 3)) * np.repeat(size, 12)[:, None]
    return mesh, mesh.vertices.copy(), mesh.vertices + motion * ~mesh.static[mesh.vertex_body][:, None]


def far_apart():
    mesh, start, end = worlds(9)
    offset = 1e12 * mesh.vertex_world[:, None] ** 3
    return mesh, start + offset, end + offset


def flown_away():
    """Some vertices of a few worlds."""
    mesh, start, end = worlds(9)
    for world, values in {1: [1e9], 2: [_LARGEST], 3: [-_LARGEST, _LARGEST, 1e300], 4: [1e40] * 7}.items():
        start[12 * world : 12 * world + len(values)] = np.array(values)[:, None]
    end[60:63] = -1e200
    return mesh, start, end


def of_a_wall_much_larger_than_what_moves():
    mesh, start, end = worlds(20)
    start[18::12] *= 1e4
    end[18::12] *= 1e4
    return mesh, start, end


def taking_turns():
    """Two worlds, each with half of every body."""
    rng = np.random.default_rng(3)
    mesh = ccd.CollisionMesh.from_arrays([soup(rng, 12, 0.3)] * 2, vertex_world=np.arange(72) // 3 % 2)
    return mesh, mesh.vertices, mesh.vertices + 0.2 * rng.standard_normal((72, 3))


SCENES = {
    "in one place": lambda: worlds(24),
    "of very different sizes": lambda: worlds(10, sizes=10.0 ** np.array([-300, -40, -9, -1, 0, 0, 1, 9, 40, 290])),
    "with numbers left out": lambda: worlds(4, numbers=np.array([0, 3, 9, 40])),
}
SCENES |= {of.__name__: of for of in (far_apart, flown_away, of_a_wall_much_larger_than_what_moves, taking_turns)}


def quantized(mesh, *frames, positions=None):
    """Lower and upper corners of the AABBs of all vertices at both ends, in quantized coordinates, [V, 2, 3] each."""
    with wp.ScopedDevice("cpu") as device:
        topology = Topology(mesh, device)
        quantization = choose_quantization(topology, positions or frames, 2)
        every = wp.array(np.arange(mesh.num_vertices), dtype=wp.int32)
        inputs = [every, *topology.of_vertices(wp.ones(mesh.num_bodies, dtype=wp.int32))]
        inputs += [*(wp.array(x, dtype=wp.vec3d) for x in frames), 1.0, 0.0, topology.box_radius]
        aabbs = wp.empty(mesh.num_vertices * 16, dtype=wp.float32)
        inputs += [quantization.packed, 2]
        Execution(device, 1).launch(fill_vertex_aabbs, mesh.num_vertices, inputs=inputs, outputs=[aabbs])
    corners = aabbs.numpy().reshape(-1, 2, 2, 4)[..., :3]
    return corners[:, :, 0], -corners[:, :, 1]


@pytest.mark.parametrize("name", SCENES)
def test_all_boxes_of_a_world_lie_in_its_cell_and_what_is_apart_keeps_its_order(name):
    mesh, *frames = SCENES[name]()
    middle = world_lattice(mesh.num_worlds)[mesh.vertex_world][:, None]
    assert len(np.unique(middle.reshape(-1, 3), axis=0)) == len(np.unique(mesh.vertex_world))
    # at the positions of the step, and as a launch has it, which knows those of the mesh alone
    for positions in ((mesh.vertices, mesh.vertices), None):
        lower, upper = quantized(mesh, *frames, positions=positions)
        assert np.isfinite(lower).all() and (lower <= upper).all()
        distance = np.maximum(np.abs(lower - middle), np.abs(upper - middle)).max()
        assert distance < 0.99 * 2.0 ** -(lattice_bits(mesh.num_worlds) + 1)
    exact = np.stack(frames, axis=1)
    for world in np.unique(mesh.vertex_world):
        rows = np.flatnonzero(mesh.vertex_world == world)
        for axis in range(3):
            order = np.argsort(exact[rows, :, axis], axis=None)
            assert all((np.diff(corners[rows, :, axis].ravel()[order]) >= 0).all() for corners in (lower, upper))


def extents(mesh, *frames):
    """The longest side of each world, as a share of its cell."""
    lower, upper = quantized(mesh, *frames)
    rows = [mesh.vertex_world == world for world in range(mesh.num_worlds)]
    sides = [(upper[at].max(axis=(0, 1)) - lower[at].min(axis=(0, 1))).max() for at in rows]
    return np.array(sides) * 2.0 ** lattice_bits(mesh.num_worlds)


@pytest.mark.parametrize("count", [NUM_SAMPLES - 3, NUM_SAMPLES, 4 * NUM_SAMPLES])
def test_worlds_take_like_parts_of_their_cells_whatever_their_number_and_sizes(count):
    """With samples at a fixed distance all of them were the first vertex of a world, and the scene had no extent."""
    mesh = ccd.CollisionMesh.from_arrays([soup(np.random.default_rng(5), 40, 0.01)]).replicate(count)
    assert (abs(np.log2(extents(mesh, mesh.vertices, mesh.vertices)) + 4) < 2).all()
    part = extents(*worlds(7, sizes=10.0 ** np.array([-9, -3, 0, 0, 0, 2, 9])))
    assert part.max() < 16 * part.min() and part.min() > 1 / 64
