"""Clips as they are compiled, in both norms and precisions: the times that they report are free in exact arithmetic.

What each step of the rounding analysis loses is counted on its source (`test_counted`); these say that the whole holds.
"""

from functools import cache

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes.boxes import end_box
from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.pair.single_points import row_points
from ccd_warp.kernels.template import specialised
from exact import exact_distance_tois, exact_tois
from hard_cases import FAMILIES
from rounding_samples import CORNERS, KINDS, REALS, exactly

POINTS = wp.array2d[wp.vec3d]
_FAMILIES = "random_colliding one_plane lattice slivers tiny_motion mixed_axis_scales one_ulp_neighbours".split()


@cache
def make_probe(real, norm):
    """A kernel that writes up to which times a direction, the volume, and facets or turning sides prove a pair free."""
    vec3, times = wp.types.vector(length=3, dtype=real), wp.types.vector(length=14, dtype=real)
    solver, advance, query, inclusion = (
        specialised(f"pair.{name}", real=real, norm=norm) for name in ("solver", "advance", "query", "inclusion")
    )
    Options, normalise, advance_volume, clip = query.Options, solver.normalise, advance.advance_volume, inclusion.clip
    zero, one = wp.constant(real(0.0)), wp.constant(real(1.0))
    module = wp.get_module(f"test_rounding.{norm}.{real.__name__}")
    # the options of the solver's own module
    wp.set_module_options({"enable_backward": False, "fuse_fp": False, "max_unroll": 1}, module=module)
    if norm == Norm.EUCLIDEAN:
        ball, clip_beyond = specialised("pair.ball", real=real), inclusion.clip_beyond
        turn_of_side, clip_turn, with_largest_one, offset = (
            getattr(ball, name) for name in ("turn_of_side", "clip_turn", "with_largest_one", "offset")
        )

        @wp.kernel(module=module)
        def probe(kind: int, x0: POINTS, x1: POINTS, options: Options, d: wp.array[vec3], out: wp.array[times]):
            i = wp.tid()
            n = normalise(kind, row_points(x0, i), row_points(x1, i), options)
            error, separation = n.problem.error, n.problem.separation
            s, a = times(), with_largest_one(d[i])
            beyond = offset(a, error, separation)
            s[0] = clip_beyond(a, beyond, zero, n.patch.t0, n.patch.t1, n.patch.is_triangle)
            s[1] = advance_volume(n.problem, zero, one)
            for side in range(3):
                turn = turn_of_side(side, n.patch.t0, a, n.patch.is_face)
                if side < 2 or n.patch.is_face:
                    s[2 + side] = clip_turn(n.patch.t0, n.patch.t1, separation, error, turn, zero, one, 8)
            out[i] = s

    else:
        clip_facet = specialised("pair.facets", real=real).clip_facet

        @wp.kernel(module=module)
        def probe(kind: int, x0: POINTS, x1: POINTS, options: Options, d: wp.array[vec3], out: wp.array[times]):
            i = wp.tid()
            n = normalise(kind, row_points(x0, i), row_points(x1, i), options)
            error, separation = n.problem.error, n.problem.separation
            s = times()
            s[0] = clip(d[i], error + separation, zero, n.patch.t0, n.patch.t1, n.patch.is_triangle)
            s[1] = advance_volume(n.problem, zero, one)
            for k in range(12):
                s[2 + k] = clip_facet(n.patch.t0, n.patch.t1, separation, error, real(k), zero, one, 12)
            out[i] = s

    return Options, vec3, times, probe


def clip_times(kind, points, real, norm, distance, rng):
    """Times that each clip reports; the direction is near that of the mean corner."""
    Options, vec3, times, probe = make_probe(REALS[real], norm)
    start = np.mean([points[0][:, i] - points[0][:, j] for i, j in CORNERS[kind]], axis=0)
    largest = np.abs(start).max(axis=1, keepdims=True)
    d = start / np.where(largest > 0, largest, 1) + rng.normal(0, 0.2, start.shape) * (largest > 0)
    options = Options()
    options.tolerance, options.minimum_separation, options.length_scale = 1e-300, distance, 1.0
    options.t_max = options.t_end = 1.0
    out, x = wp.zeros(len(d), dtype=times), [wp.array(p, dtype=wp.vec3d) for p in points]
    wp.launch(probe, len(d), inputs=[KINDS[kind], *x, options, wp.array(d, dtype=vec3)], outputs=[out])
    return out.numpy().astype(np.float64)


# Powers of two by which the axes are scaled: exact, but products of such lengths underflow and overflow.
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("norm", "share", "scale"),
    [
        (Norm.OWN_BOX, 0, 0),
        (Norm.OWN_BOX, 1e-3, 0),
        (Norm.OWN_BOX, 0, -900),
        (Norm.OWN_BOX, 0, (700, -537, -530)),
        (Norm.EUCLIDEAN, 1e-7, 0),
        (Norm.EUCLIDEAN, 1e-3, (0, -20, -90)),
        (Norm.EUCLIDEAN, 0.2, 0),
        (Norm.EUCLIDEAN, 1e-3, (0, -200, 0)),
        (Norm.EUCLIDEAN, 1e-3, -900),
    ],
)
def test_no_clip_passes_a_contact(norm, share, scale, kind, real):
    rng, advanced = np.random.default_rng(43), np.zeros(14, dtype=int)
    for family in _FAMILIES:
        points = [np.ldexp(p, scale) for p in FAMILIES[family](kind, 30, rng)]
        distance = share * float(np.median(np.abs(points[0])[..., 0].max(axis=1)))
        times = clip_times(kind, points, real, norm, distance, rng)
        exact = exact_distance_tois if norm == Norm.EUCLIDEAN else exact_tois
        for truth, reported in zip(exact(kind, *points, distance), times.tolist(), strict=True):
            # 2: certainly free to the end
            assert not any(truth.hit and (time >= 2 or truth.late(time)) for time in reported)
        advanced += (times > 0).sum(axis=0)
    assert scale != 0 or (advanced[:2].min() > 20 and advanced[2:].max() > 20)


@wp.kernel(module="unique", enable_backward=False)
def write_end_boxes(a: wp.array[wp.vec3d], b: wp.array[wp.vec3d], t: wp.array[wp.float64], ends: wp.array2d[wp.vec3d]):
    i = wp.tid()
    box = end_box(a[i], b[i], t[i])
    ends[i, 0] = box.lower
    ends[i, 1] = box.upper


@pytest.mark.parametrize("exponent", [0, 1000, -1070])
def test_box_at_the_end_of_a_shorter_step_holds_the_point(exponent):
    rng, n = np.random.default_rng(46), 3000
    a, b = (np.ldexp(rng.standard_normal((n, 3)), exponent) for _ in range(2))
    b[::3] = np.nextafter(a[::3], np.inf)
    a[1::7] *= 1e-9
    t = rng.random(n) ** rng.integers(1, 20, n)
    ends, points = wp.empty((n, 2), dtype=wp.vec3d), [wp.array(x, dtype=wp.vec3d) for x in (a, b)]
    wp.launch(write_end_boxes, dim=n, inputs=[*points, wp.array(t, dtype=wp.float64)], outputs=[ends])
    lower, upper = ends.numpy().swapaxes(0, 1)
    first, last, at = exactly(a), exactly(b), exactly(t)[:, None]
    at = first + at * (last - first)
    assert (exactly(lower) <= at).all() and (at <= exactly(upper)).all() and (lower < upper).sum() > n
