"""The bullet of the literature in the plane, and the work of each method on it.

A point flies from (0.5, 3.5) to (9.5, 3.5) within one step, past a static wall: the segment at x = 5 from y = 1 to
y = 6. The first contact is at t = 0.5, in the middle of the wall. Plain inclusion bisection finds it by halving boxes
of time and wall; the literature reports 53 of them at δ = 1e-4. The default method clips instead.

Run it: python examples/bullet_2d.py
"""

import numpy as np

import ccd_warp as ccd

# p, a, b: shape [1, 3, 2]
points_t0 = np.array([[[0.5, 3.5], [5.0, 1.0], [5.0, 6.0]]])
points_t1 = np.array([[[9.5, 3.5], [5.0, 1.0], [5.0, 6.0]]])

for method, step in (("bisection", "boxes"), ("clipping", "steps")):
    result = ccd.point_segment_ccd(points_t0, points_t1, method=method, tolerance=1e-4, length_scale=1.0)
    print(
        f"{method:10} toi = {result.toi[0]:.6f}  at {result.parameters[0, 0]:.4f} of the wall,",
        f"gap <= {result.gap[0]:.1e}, {result.iterations[0]} {step}",
    )
