"""Boxes and orders as CUDA makes them, run on the CPU and the emulated device: equal to those of the CPU's kernels."""

import itertools
import time
from contextlib import nullcontext

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes.box_tree import fill_vertex_aabbs
from emulated import MARKS
from emulated.device import emulation
from scenes import sheet, single, soup

from ccd_warp import CollisionPipeline
from ccd_warp._engine.boxes.rest_order import order_at, rest_order
from ccd_warp._engine.boxes.trees import Tree
from ccd_warp._engine.mesh.topology import Topology, choose_quantization
from ccd_warp._runtime.launch import Execution

DEVICE = wp.get_device("cpu")
WAYS = Execution(DEVICE, 1), type("AsOnCuda", (Execution,), {"is_cuda": True})(DEVICE, 1)


@pytest.fixture(autouse=True)
def on_the_cpu():
    """Arrays of which nothing is said are there too."""
    with wp.ScopedDevice("cpu"):
        yield


def vertex_aabbs_of(topology, num_aabbs):
    """Vertex AABBs that differ at the two ends of a step."""
    mesh = topology.mesh
    ends = [wp.array(x, dtype=wp.vec3d) for x in (mesh.vertices, mesh.vertices[::-1].copy())]
    packed = choose_quantization(topology, (mesh.vertices, mesh.vertices), num_aabbs).packed
    aabbs = wp.empty(mesh.num_vertices * num_aabbs * 8, dtype=wp.float32)
    inputs = [wp.array(np.arange(mesh.num_vertices), dtype=wp.int32)]
    inputs += [*topology.of_vertices(wp.ones(mesh.num_bodies, dtype=wp.int32)), *ends, 1.0, 0.01]
    inputs += [topology.box_radius, packed, num_aabbs]
    WAYS[0].launch(fill_vertex_aabbs, mesh.num_vertices, inputs=inputs, outputs=[aabbs])
    return aabbs


@pytest.mark.parametrize("num_aabbs", [1, 2])
@pytest.mark.parametrize("count", [pytest.param(n, marks=MARKS) for n in (1, 15, 16, 17, 255, 256, 257, 1500, 4097)])
def test_half_warps_fill_the_same_boxes(count, num_aabbs):
    """In one launch for all kinds, twice: the half warps of an inner block are counted from 0 again."""
    topology = Topology(single(*soup(np.random.default_rng(count), count, 0.1)), DEVICE)
    aabbs = vertex_aabbs_of(topology, num_aabbs)
    nodes = []
    for is_emulated in (False, True):
        trees = [Tree(topology.primitives(kind, "moving")) for kind in ("face", "vertex", "edge")]
        for tree in trees:
            order = rest_order(topology, tree.primitives, WAYS[0])
            tree.set_order(num_aabbs, order, wp.full(tree.num_floats(num_aabbs), value=np.nan, dtype=wp.float32))
        with emulation() if is_emulated else nullcontext():
            execution = Execution(DEVICE, 1)  # it keeps what its device is
            if is_emulated:
                Tree.fill(trees, aabbs, execution, only_if=wp.zeros(1, dtype=wp.int32))
                assert all(np.isnan(tree.arrays.nodes.numpy()).all() for tree in trees)  # as the flag is not set
            for _ in range(2):
                for tree in trees:
                    tree.arrays.nodes.fill_(np.nan)
                Tree.fill(trees, aabbs, execution)
        nodes.append(np.concatenate([tree.arrays.nodes.numpy() for tree in trees]))
    assert not np.isnan(nodes[0]).any()
    np.testing.assert_array_equal(*nodes)


def test_boxes_of_every_level_are_those_of_the_cpu_launch_after_launch(device):
    """With a GPU a million faces, whose last block of a level may end in any block of threads, for half a minute."""
    num_sides, seconds = (708, 30.0) if "cuda" in device else (30, 0.0)
    mesh, rng = single(*sheet(num_sides)), np.random.default_rng(0)
    waves = mesh.vertices + 0.1 * np.sin(37.0 * mesh.vertices[:, :1]) * [0, 0, 1]
    ends, steps = [mesh.vertices, mesh.vertices + [0.3, 0, 0], waves], [(0, 1), (1, 2), (2, 0)]
    found: list[dict] = []
    for at in ("cpu", device):
        pipeline, of_steps, until = CollisionPipeline(mesh, device=at), {}, time.monotonic() + seconds * (at != "cpu")
        arrays = [wp.array(x, dtype=wp.vec3d, device=at) for x in ends]
        for count in itertools.count():
            if count >= 2 * len(steps) and time.monotonic() >= until:
                break
            for k in (*rng.integers(0, 3, 5), count % 3):  # what stands there before is of another step
                trees = pipeline.launch(*(arrays[end] for end in steps[k]))._step.trees
            boxes = [x.numpy().view(np.int32) for tree in trees for x in (tree.arrays.nodes, tree.arrays.primitive)]
            kept = of_steps.setdefault(k, [x.copy() for x in boxes])
            for one, other in zip(boxes, kept, strict=True):
                np.testing.assert_array_equal(one, other)
        found.append(of_steps)
    for k, boxes in found[0].items():
        for one, other in zip(boxes, found[1][k], strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("num_faces", [1234, 5])
def test_sorted_keys_halve_segments_as_selection_does(num_faces):
    """Every block then holds the same primitives, since no two coordinates of a segment are equal."""
    mesh = single(*soup(np.random.default_rng(5), num_faces, 0.01))
    for kind in ("vertex", "edge", "face"):
        blocks, topology = [], Topology(mesh, DEVICE)
        for execution in WAYS:
            primitives = topology.primitives(kind, "moving")
            order, corners, _ = (
                a if a is None else a.numpy() for a in order_at(topology, mesh.vertices, primitives, execution)
            )
            placed = corners.reshape(-1, 3, 16).transpose(0, 2, 1).reshape(-1, 3)
            assert np.array_equal(placed[: len(order)], primitives.corners.numpy()[order])
            assert np.array_equal(np.sort(order), np.arange(len(order))) and (placed[len(order) :] == -1).all()
            blocks.append([set(order[k : k + 16].tolist()) for k in range(0, len(order), 16)])
        assert blocks[0] == blocks[1]
