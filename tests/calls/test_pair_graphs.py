"""Functions on pairs while a graph of the CPU is captured: all of a call is part of the graph, or it says why not."""

import faults
import numpy as np
import pytest
import warp as wp
from scenes import CORNERS, random_pairs

import ccd_warp as ccd

OPTIONS = {"minimum_separation": 0.02, "device": "cpu"}


@pytest.mark.parametrize("num_threads", [1, 4])
@pytest.mark.parametrize("kind", CORNERS)
def test_graph_holds_all_pairs_and_answers_for_what_its_arrays_hold_by_then(kind, num_threads):
    call = getattr(ccd, f"{kind}_ccd")
    vertices_t0, vertices_t1 = (wp.array(x, dtype=wp.vec3d, device="cpu") for x in random_pairs(kind, 10_000))
    with wp.ScopedCapture(device="cpu") as capture:
        result = call(vertices_t0, vertices_t1, num_threads=num_threads, **OPTIONS)
    for seed in (0, 1, 2):
        start, end = random_pairs(kind, 10_000, seed)
        vertices_t0.assign(start)
        vertices_t1.assign(end)
        wp.capture_launch(capture.graph)
        truth = faults.arrays_of(call(start, end, **OPTIONS))
        assert np.isfinite(truth["result.toi"]).sum() > 20
        assert faults.difference(faults.arrays_of(result), truth) == ""


@pytest.mark.parametrize("num_threads", [1, 4])
def test_graph_of_pairs_in_the_plane(num_threads):
    vertices_t0, vertices_t1 = (
        wp.array(x, dtype=wp.vec2d, device="cpu") for x in random_pairs("point_segment", 10_000, dimension=2)
    )
    with wp.ScopedCapture(device="cpu") as capture:
        result = ccd.point_segment_ccd(vertices_t0, vertices_t1, num_threads=num_threads, **OPTIONS)
    start, end = random_pairs("point_segment", 10_000, 1, dimension=2)
    vertices_t0.assign(start)
    vertices_t1.assign(end)
    wp.capture_launch(capture.graph)
    truth = faults.arrays_of(ccd.point_segment_ccd(start, end, **OPTIONS))
    assert faults.difference(faults.arrays_of(result), truth) == ""


def test_graph_of_both_precisions():
    vertices_t0, vertices_t1 = (wp.array(x, dtype=wp.vec3d, device="cpu") for x in random_pairs("edge_edge", 10_000, 3))
    with wp.ScopedCapture(device="cpu") as capture:
        results = [ccd.edge_edge_ccd(vertices_t0, vertices_t1, precision=p, **OPTIONS) for p in ("float32", "float64")]
    for array, values in zip((vertices_t0, vertices_t1), random_pairs("edge_edge", 10_000, 4), strict=True):
        array.assign(values)
    wp.capture_launch(capture.graph)
    for precision, result in zip(("float32", "float64"), results, strict=True):
        truth = faults.arrays_of(ccd.edge_edge_ccd(vertices_t0, vertices_t1, precision=precision, **OPTIONS))
        assert faults.difference(faults.arrays_of(result), truth) == ""


@pytest.mark.parametrize("kind", CORNERS)
def test_pairs_of_numpy_in_a_capture_are_refused(kind):
    call = getattr(ccd, f"{kind}_ccd")
    start, end = random_pairs(kind, 100)
    with pytest.raises(RuntimeError, match=r"(?i)captur.*(warp|device)"), wp.ScopedCapture(device="cpu"):
        call(start, end, **OPTIONS)
    # and once the capture is over they are answered
    truth = faults.arrays_of(call(*(wp.array(x, dtype=wp.vec3d, device="cpu") for x in (start, end)), **OPTIONS))
    assert faults.difference(faults.arrays_of(call(start, end, **OPTIONS)), truth) == ""
