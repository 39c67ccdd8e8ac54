"""Attack on step 13 of `kernels/pair/rounding.py`: offsets and clips with a Euclidean distance, in exact arithmetic."""

import math
from fractions import Fraction
from functools import cache

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.pair.norm import EUCLIDEAN_NORM
from ccd_warp.kernels.pair.rounding import SLACK, SQUARE_UNDERFLOW, UNIT_ROUNDOFF
from ccd_warp.kernels.pair.single_points import row_points
from ccd_warp.kernels.template import specialised
from cull_probe import culled
from exact import exact_distance_tois
from hard_cases import FAMILIES
from rounding_samples import CORNERS, FLOATS, KINDS, REALS, cross, drawn, dropped, exactly

# Powers of two by which the axes are scaled: with the second, products of lengths on the short axes underflow.
SCALES = {"as_drawn": (0, 0, 0), "flat": (0, -20, -90), "small": (-900, -900, -900), "thin": (0, -200, 0)}


@cache
def make_probe(real):
    """Kernels that write offsets, and the times to which the clips prove a pair free."""
    vec3 = wp.types.vector(length=3, dtype=real)
    Options = specialised("pair.query", real=real).Options
    normalise = specialised("pair.solver", real=real, norm=EUCLIDEAN_NORM).normalise
    ball = specialised("pair.ball", real=real)
    offset, turn_of_side, clip_turn = ball.offset, ball.turn_of_side, ball.clip_turn
    with_largest_one = ball.with_largest_one
    clip_beyond = specialised("pair.inclusion", real=real).clip_beyond
    separation_offset = specialised("pair.volume", real=real, norm=EUCLIDEAN_NORM).separation_offset
    advance_volume = specialised("pair.advance", real=real, norm=EUCLIDEAN_NORM).advance_volume
    module = wp.get_module(f"test_ball_rounding.{real.__name__}")
    wp.set_module_options({"enable_backward": False, "fuse_fp": False, "max_unroll": 1}, module=module)

    @wp.kernel(module=module)
    def probe(
        # in
        kind: int,
        vertices_t0: wp.array2d[wp.vec3d],
        vertices_t1: wp.array2d[wp.vec3d],
        options: Options,
        directions: wp.array[wp.vec3d],
        times: wp.array[wp.float64],
        # out
        units: wp.array[wp.vec3d],
        numbers: wp.array2d[wp.float64],  # error, separation, offset; that of the volume at a time, its bound
        clips: wp.array2d[wp.float64],  # with the direction, with the volume, turning with each side
    ):
        i = wp.tid()
        n = normalise(kind, row_points(vertices_t0, i), row_points(vertices_t1, i), options)
        d = vec3(real(directions[i][0]), real(directions[i][1]), real(directions[i][2]))
        error = n.problem.error
        separation = n.problem.separation
        units[i] = n.unit
        for k in range(3):
            numbers[i, k] = wp.float64(error[k])
            numbers[i, 3 + k] = wp.float64(separation[k])
        numbers[i, 6] = wp.float64(offset(d, error, separation))
        t = real(times[i])
        hull = separation_offset(n.problem.volume, separation, t, t)
        numbers[i, 7] = wp.float64(hull.c0)
        numbers[i, 8] = wp.float64(hull.c1)
        numbers[i, 9] = wp.float64(n.problem.volume.bound)
        zero = real(0.0)
        one = real(1.0)
        a = with_largest_one(d)
        off = offset(a, error, separation)
        clips[i, 0] = wp.float64(clip_beyond(a, off, zero, n.patch.t0, n.patch.t1, n.patch.is_triangle))
        clips[i, 1] = wp.float64(advance_volume(n.problem, zero, one))
        for side in range(3):
            turn = turn_of_side(side, n.patch.t0, a, n.patch.is_face)
            if side < 2 or n.patch.is_face:
                s = clip_turn(n.patch.t0, n.patch.t1, separation, error, turn, zero, one, 8)
                clips[i, 2 + side] = wp.float64(s)

    return Options, probe


def probed(kind, points, real, distance, directions, times):
    """Units, numbers and clips of `probe`."""
    Options, probe = make_probe(REALS[real])
    options = Options()
    options.tolerance, options.minimum_separation = 1e-300, distance
    options.t_max = options.t_end = 1.0
    n = len(times)
    outputs = [wp.zeros(n, dtype=wp.vec3d), *(wp.zeros((n, k), dtype=wp.float64) for k in (10, 5))]
    x = [wp.array(p, dtype=wp.vec3d) for p in (*points, directions)]
    inputs = [KINDS[kind], *x[:2], options, x[2], wp.array(times, dtype=wp.float64)]
    wp.launch(probe, dim=n, inputs=inputs, outputs=outputs)
    return tuple(array.numpy() for array in outputs)


def root_down(x: Fraction) -> Fraction:
    """√x, rounded down to some 200 bits."""
    if x == 0:
        return x
    bits = 2 * max(0, 200 + (x.denominator.bit_length() - x.numerator.bit_length()) // 2)
    return Fraction(math.isqrt((x.numerator << bits) // x.denominator), 1 << (bits // 2))


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("distance", [0.125, 1 / 3, 1e-5, 7e9, 1e-60])
def test_offset_is_above_the_exact_one_and_not_lazy(distance, real):
    rng = np.random.default_rng(91)
    u = Fraction(UNIT_ROUNDOFF[REALS[real]])
    least = np.inf
    for _ in range(3):
        inputs = drawn(300, rng)
        points = (inputs["vertices_t0"], inputs["vertices_t1"])
        d = inputs["d"].astype(FLOATS[real]).astype(np.float64)
        d[::3] *= 2.0**-40
        units, numbers, _ = probed("edge-edge", points, real, distance, d, inputs["t"])
        assert (units == units[:, :1]).all() and (numbers[:, 3:6] == numbers[:, 3:4]).all()
        for unit, row, direction in zip(exactly(units[:, 0]), exactly(numbers), exactly(d), strict=True):
            radius = Fraction(distance) / unit
            if 2**-100 < radius < 2**60:
                assert radius * (1 + 13 * u) < row[3] <= radius * (1 + (SLACK + 3) * u)
            margin = sum(abs(direction) * row[:3])
            exact = margin + radius * root_down(sum(direction * direction))
            assert row[6] > exact or radius > 2**60
            if radius < 2**60:
                lazy = radius * Fraction(math.sqrt(SQUARE_UNDERFLOW[REALS[real]]))
                assert row[6] < exact * (1 + 40 * u) + 2 * lazy
                least = min(least, float((row[6] - exact) / (exact * u)))
    # the sum of roundings took part of the slack: what is left is counted, and no more than that
    assert least > 0


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("kind", KINDS)
def test_offset_of_the_volume_is_above_the_exact_one_within_its_bound(kind, real):
    rng = np.random.default_rng(92)
    inputs = drawn(600, rng)
    points = (inputs["vertices_t0"], inputs["vertices_t1"])
    times = inputs["t"].astype(FLOATS[real]).astype(np.float64)
    units, numbers, _ = probed(kind, points, real, 0.125, inputs["d"], times)
    x0, x1 = (exactly(p) for p in points)
    (a, b), (c, e) = {"vertex-face": ((1, 2), (1, 3)), "edge-edge": ((2, 3), (1, 0))}[kind]
    for i, (unit, row, t) in enumerate(zip(exactly(units[:, 0]), exactly(numbers), exactly(times), strict=True)):
        q, r = (
            [((1 - t) * (x0[i, j] - x0[i, k]) + t * (x1[i, j] - x1[i, k])) / unit for j, k in ends]
            for ends in (((a, b),), ((c, e),))
        )
        exact = Fraction(1, 8) / unit * root_down(sum(cross(q[0], r[0]) ** 2))
        for found in row[7:9]:
            assert found + row[9] > exact
            assert found < exact * Fraction(1.00001) + 4 * row[9]


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("share", [1e-7, 1e-3, 0.2])
def test_no_clip_passes_the_time_at_which_the_distance_is_reached(share, scale, kind, real):
    rng = np.random.default_rng(93)
    advanced = np.zeros(5, dtype=int)
    for family in ("random", "random_colliding", "one_plane", "lattice", "slivers", "rotation_like", "tiny_motion"):
        points = [np.ldexp(p, SCALES[scale]) for p in FAMILIES[family](kind, 40, rng)]
        start = np.mean([points[0][:, i] - points[0][:, j] for i, j in CORNERS[kind]], axis=0)
        largest = np.abs(start).max(axis=1, keepdims=True)
        d = start / np.where(largest > 0, largest, 1) + rng.normal(0, 0.2, start.shape) * (largest > 0)
        d = d.astype(FLOATS[real]).astype(np.float64)
        distance = share * float(np.median(np.abs(points[0])[..., 0].max(axis=1)))
        _, _, clips = probed(kind, points, real, distance, d, np.zeros(40))
        for truth, times in zip(exact_distance_tois(kind, *points, distance), clips.tolist(), strict=True):
            for time in times:
                assert not (truth.hit and (time >= 2 or truth.late(time)))
        advanced += (clips > 0).sum(axis=0)
    assert scale != "as_drawn" or advanced[: 5 if kind == "vertex-face" else 4].min() > 20


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("t_end", [1.0, 0.3])
@pytest.mark.parametrize("test", ["volume", "sides", "both"])
@pytest.mark.parametrize("scale", [0, -100, -300, 100, 300])
def test_cull_drops_no_pair_that_comes_within_the_distance(scale, test, t_end, kind):
    rng = np.random.default_rng(94)
    num_dropped = 0
    for family in ("random", "one_plane", "parallel_edges", "cloth_like", "slivers", "mixed_axis_scales"):
        points = [np.ldexp(p, scale) for p in FAMILIES[family](kind, 80, rng)]
        for share in (1e-3, 0.2):
            distance = share * float(np.median(np.abs(points[0]).max(axis=(1, 2))))
            free = dropped(kind, points, exact_distance_tois, distance, t_end, is_euclidean=True, test=test)
            # the box around the ball holds more than the ball
            boxed = culled(kind, *points, 1, separation=distance, t_end=t_end, test=test)
            assert boxed.sum() <= free.sum() + 2 or abs(scale) > 100
            num_dropped += free.sum()
    assert num_dropped > 20 or scale != 0
