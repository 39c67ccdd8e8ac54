"""The bullet of the literature: it touches no wall at either end of the step, yet it passes through one.

A point flies from x = 0.5 to x = 9.5 at height y = 3.5 within one step. A static wall stands at x = 5 from y = 1 to
y = 6 (here extruded along z, two triangles). A test at the start and at the end of the step finds nothing. Continuous
collision detection covers the whole step: the first contact is at t = 0.5.

Run it: python examples/bullet_through_wall.py
"""

import numpy as np

import ccd_warp as ccd

bullet_t0 = np.array([0.5, 3.5, 0.0])
bullet_t1 = np.array([9.5, 3.5, 0.0])
wall = np.array([[5.0, 1.0, -2.0], [5.0, 6.0, -2.0], [5.0, 6.0, 1.0], [5.0, 1.0, 1.0]])
faces = np.array([[0, 1, 2], [0, 2, 3]])


def test_at_one_instant(point: np.ndarray) -> str:
    """The result of a test at one instant: is the point on the wall's rectangle?"""
    low, high = wall.min(axis=0), wall.max(axis=0)
    return "HIT" if ((low <= point) & (point <= high)).all() else "MISS"


# One query for each triangle: the point, then the triangle's corners; shape [2, 4, 3]. The wall is static.
points_t0 = np.stack([[bullet_t0, *wall[face]] for face in faces])
points_t1 = np.stack([[bullet_t1, *wall[face]] for face in faces])
result = ccd.vertex_face_ccd(points_t0, points_t1)

print("test at the start of the step:", test_at_one_instant(bullet_t0))
print("test at the end of the step:  ", test_at_one_instant(bullet_t1))
print("CCD over the whole step:       toi =", float(result.toi.min()))
