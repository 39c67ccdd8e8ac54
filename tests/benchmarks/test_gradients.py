"""The benchmark of gradients: its calls do what their names say, and its table has their quotients."""

import numpy as np
from ccd_warp.benchmarks import gradients, scenes


def test_backward_passes_follow_taped_calls_and_give_gradients():
    measured = gradients.Measured(scenes.cloth_over_sphere(300))
    assert measured.contacts > 0
    start = measured._given[0]
    for calls in (measured.launch("toi"), measured.launch("vertex_toi"), measured.line_search("vertex")):
        calls[gradients.PLAIN]()
        calls[gradients.TAPED]()
        start.grad.zero_()
        calls[gradients.BACKWARD]()
        assert np.isfinite(start.grad.numpy()).all() and start.grad.numpy().any()


def test_rows_have_the_quotients_of_medians():
    rows = gradients.measure(gradients.pressed_spheres(300), rounds=1)
    assert len(rows) == 4 and all(min(row["seconds"].values()) > 0 for row in rows)
    seconds = {gradients.PLAIN: 2e-3, gradients.TAPED: 2.1e-3, gradients.BACKWARD: 1e-4}
    row = {"scene": "a scene", "contacts": 1234, "call": "`launch`", "seconds": seconds}
    lines = gradients.rows_table([row, row])
    assert lines[2] == "| a scene | 1,234 | `launch` | 2 | +5.0 % | 5.0 % |"
    assert lines[3] == "|  |  | `launch` | 2 | +5.0 % | 5.0 % |"
