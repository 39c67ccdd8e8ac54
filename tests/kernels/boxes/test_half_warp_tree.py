"""Boxes and orders as CUDA makes them, run on the CPU: equal to those of the CPU's kernels."""

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes.box_tree import fill_vertex_aabbs
from scenes import sheet, single, soup

import ccd_warp as ccd
from ccd_warp._engine.boxes.rest_order import order_at, rest_order
from ccd_warp._engine.boxes.trees import Tree
from ccd_warp._engine.mesh.topology import Topology, choose_quantization
from ccd_warp._runtime.launch import Execution

DEVICE = wp.get_device("cpu")


class AsOnCuda(Execution):
    """Launches kernels as on CUDA."""

    is_cuda = True


def executions():
    return Execution(DEVICE, 1), AsOnCuda(DEVICE, 1)


def vertex_aabbs_of(topology, num_aabbs):
    """Vertex AABBs that differ at the two ends of a step."""
    mesh = topology.mesh
    start, end = (wp.array(x, dtype=wp.vec3d) for x in (mesh.vertices, mesh.vertices[::-1].copy()))
    quantization = choose_quantization(topology, (mesh.vertices, mesh.vertices), num_aabbs)
    aabbs = wp.empty(mesh.num_vertices * num_aabbs * 8, dtype=wp.float32)
    every = wp.array(np.arange(mesh.num_vertices), dtype=wp.int32)
    active = wp.ones(mesh.num_bodies, dtype=wp.int32)
    Execution(DEVICE, 1).launch(
        fill_vertex_aabbs,
        mesh.num_vertices,
        inputs=[
            every,
            *topology.of_vertices(active),
            start,
            end,
            1.0,
            0.01,
            topology.box_radius,
            quantization.packed,
            num_aabbs,
        ],
        outputs=[aabbs],
    )
    return aabbs


@pytest.mark.parametrize("num_aabbs", [1, 2])
@pytest.mark.parametrize("count", [1, 15, 16, 17, 255, 256, 257, 1500, 4097])
def test_half_warps_fill_the_same_boxes(count, num_aabbs):
    topology = Topology(single(*soup(np.random.default_rng(count), count, 0.1)), DEVICE)
    aabbs = vertex_aabbs_of(topology, num_aabbs)
    for kind in ("vertex", "edge", "face"):
        primitives = topology.primitives(kind, "moving")
        order = rest_order(topology, primitives, Execution(DEVICE, 1))
        nodes = []
        for execution in executions():
            tree = Tree(primitives)
            tree.set_order(num_aabbs, order, wp.full(tree.num_floats(num_aabbs), value=np.nan, dtype=wp.float32))
            tree.fill([tree], aabbs, execution)
            nodes.append(tree.arrays.nodes.numpy())
        assert not np.isnan(nodes[0]).any()
        np.testing.assert_array_equal(*nodes)


def test_boxes_stay_where_the_flag_is_not_set():
    topology = Topology(single(*soup(np.random.default_rng(3), 300, 0.1)), DEVICE)
    aabbs = vertex_aabbs_of(topology, 2)
    tree = Tree(topology.primitives("edge", "moving"))
    order = rest_order(topology, tree.primitives, Execution(DEVICE, 1))
    tree.set_order(2, order, wp.full(tree.num_floats(2), value=7.0, dtype=wp.float32))
    flag = wp.zeros(1, dtype=wp.int32)
    tree.fill([tree], aabbs, AsOnCuda(DEVICE, 1), only_if=flag)
    assert (tree.arrays.nodes.numpy() == 7.0).all()
    flag.fill_(1)
    tree.fill([tree], aabbs, AsOnCuda(DEVICE, 1), only_if=flag)
    assert not (tree.arrays.nodes.numpy() == 7.0).any()


def blocks_of(mesh, kind, execution):
    """The primitives of each block."""
    primitives = Topology(mesh, DEVICE).primitives(kind, "moving")
    order = order_at(Topology(mesh, DEVICE), mesh.vertices, primitives, execution)[0].numpy()
    assert np.array_equal(np.sort(order), np.arange(primitives.count))
    return [set(order[k : k + 16].tolist()) for k in range(0, primitives.count, 16)]


@pytest.mark.parametrize("num_faces", [1234, 5])
def test_sorted_keys_halve_segments_as_selection_does(num_faces):
    """Every block then holds the same primitives, since no two coordinates of a segment are equal."""
    mesh = single(*soup(np.random.default_rng(5), num_faces, 0.01))
    for kind in ("vertex", "edge", "face"):
        selected, by_keys = (blocks_of(mesh, kind, execution) for execution in executions())
        assert selected == by_keys


def test_sorted_keys_split_short_segments_between_bodies():
    rng = np.random.default_rng(4)
    mesh = ccd.CollisionMesh.from_arrays([soup(rng, count, 0.05) for count in (70, 333, 5)])
    for kind, body in (("vertex", mesh.vertex_body), ("edge", mesh.edge_body), ("face", mesh.face_body)):
        mixed = [
            sum(len(set(body[list(block)])) > 1 for block in blocks_of(mesh, kind, execution))
            for execution in executions()
        ]
        assert mixed[1] <= mixed[0] < len(body) / 64


def test_an_order_of_equal_and_of_distant_places():
    vertices, faces = sheet(20)
    vertices[7] = [1e300, -1e300, 0.0]
    mesh = single(np.round(5 * vertices) / 5, faces)
    topology = Topology(mesh, DEVICE)
    for kind in ("vertex", "edge", "face"):
        primitives = topology.primitives(kind, "moving")
        order, corners, _ = order_at(topology, mesh.vertices, primitives, AsOnCuda(DEVICE, 1))
        assert np.array_equal(np.sort(order.numpy()), np.arange(primitives.count))
        placed = corners.numpy().reshape(-1, 3, 16).transpose(0, 2, 1).reshape(-1, 3)
        np.testing.assert_array_equal(placed[: primitives.count], primitives.corners.numpy()[order.numpy()])
        assert (placed[primitives.count :] == -1).all()
