"""Sine and cosine of half a turn, which are the same on all devices, against interval arithmetic."""

import numpy as np
import warp as wp
from ccd_warp.kernels.rigid.place_bodies import sine_and_cosine
from flint import arb, ctx

UNIT = 2.0**-53


@wp.kernel
def fill(angles: wp.array[wp.float64], out: wp.array[wp.vec2d]):
    i = wp.tid()
    out[i] = sine_and_cosine(angles[i])


def test_sine_and_cosine_are_within_four_roundings_also_after_many_turns():
    rng = np.random.default_rng(0)
    quarters = np.pi / 4 * np.arange(1, 400)  # beside zeros of one and the other
    spread = [rng.uniform(0, 2, 1000), 10.0 ** rng.uniform(-300, 5.9, 1000), quarters, np.nextafter(quarters, 0), [0.0]]
    angles = np.concatenate(spread)
    found = wp.zeros(len(angles), dtype=wp.vec2d, device="cpu")
    inputs = [wp.array(angles, dtype=wp.float64, device="cpu")]
    wp.launch(fill, len(angles), inputs=inputs, outputs=[found], device="cpu")
    worst = relative = 0.0
    with ctx.workprec(200):
        for angle, (s, c) in zip(angles.tolist(), found.numpy().tolist(), strict=True):
            exact = arb(angle).sin(), arb(angle).cos()
            errors = [abs(float(arb(value) - truth)) for value, truth in zip((s, c), exact, strict=True)]
            worst = max(worst, *errors)
            if 0.0 < angle < 0.75:
                relative = max(relative, float(errors[0] / abs(float(exact[0]))))
    assert 0.5 * UNIT < worst < 4 * UNIT
    assert relative < 4 * UNIT
