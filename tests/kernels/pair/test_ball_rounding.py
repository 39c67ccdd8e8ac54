"""Attack on step 13 of `kernels/pair/rounding.py`: offsets and clips with a Euclidean distance, in exact arithmetic."""

import math
from functools import cache

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.pair.norm import EUCLIDEAN_NORM
from ccd_warp.kernels.pair.rounding import SLACK, SQUARE_UNDERFLOW, UNIT_ROUNDOFF
from ccd_warp.kernels.pair.single_points import row_points
from ccd_warp.kernels.template import specialised
from exact import exact_distance_tois
from flint import fmpq
from hard_cases import FAMILIES
from rounding_samples import CORNERS, FLOATS, KINDS, POINTS, REALS, SIDES, cross, drawn, exactly, rational, struct

# Powers of two by which the axes are scaled: with the second, products of lengths on the short axes underflow.
SCALES = {"as_drawn": (0, 0, 0), "flat": (0, -20, -90), "small": (-900, -900, -900), "thin": (0, -200, 0)}


@cache
def make_probe(real):
    """A kernel that writes offsets, and the times to which the clips prove a pair free."""
    vec3, vec5 = (wp.types.vector(length=n, dtype=real) for n in (3, 5))
    vecs, reals = wp.array[vec3], wp.array[real]
    solver, volume, advance = (
        specialised(f"pair.{x}", real=real, norm=EUCLIDEAN_NORM) for x in ("solver", "volume", "advance")
    )
    query, ball, inclusion = (specialised(f"pair.{x}", real=real) for x in ("query", "ball", "inclusion"))
    Options, normalise, advance_volume = query.Options, solver.normalise, advance.advance_volume
    offset, turn_of_side, clip_turn, with_largest_one = (
        getattr(ball, x) for x in ("offset", "turn_of_side", "clip_turn", "with_largest_one")
    )
    clip_beyond, separation_offset = inclusion.clip_beyond, volume.separation_offset
    reach_of, restrict = volume.reach_of, volume.restrict
    module = wp.get_module(f"test_ball_rounding.{real.__name__}")
    wp.set_module_options({"enable_backward": False, "fuse_fp": False, "max_unroll": 1}, module=module)

    # the offset of the volume at a time; clips with the direction, with the volume, turning with each side
    fields = [("unit", wp.vec3d), ("error separation", vec3), ("offset bound", real), ("of_volume reach", volume.Hull)]
    Found = struct("Found", [*fields, ("clips", vec5)])

    @wp.kernel(module=module)
    def probe(kind: int, x0: POINTS, x1: POINTS, options: Options, d: vecs, times: reals, out: wp.array[Found]):
        i = wp.tid()
        n = normalise(kind, row_points(x0, i), row_points(x1, i), options)
        error, separation, zero, one = n.problem.error, n.problem.separation, real(0.0), real(1.0)
        s = Found()
        s.unit = n.unit
        s.error = error
        s.separation = separation
        s.offset = offset(d[i], error, separation)
        s.of_volume = separation_offset(n.problem.volume, separation, times[i], times[i])
        s.reach = restrict(reach_of(n.problem.volume, separation), times[i], times[i])
        s.bound = n.problem.volume.bound
        a = with_largest_one(d[i])
        beyond = offset(a, error, separation)
        s.clips[0] = clip_beyond(a, beyond, zero, n.patch.t0, n.patch.t1, n.patch.is_triangle)
        s.clips[1] = advance_volume(n.problem, zero, one)
        for side in range(3):
            turn = turn_of_side(side, n.patch.t0, a, n.patch.is_face)
            if side < 2 or n.patch.is_face:
                s.clips[2 + side] = clip_turn(n.patch.t0, n.patch.t1, separation, error, turn, zero, one, 8)
        out[i] = s

    return Options, Found, probe


def probed(kind, points, real, distance, directions, times):
    """What the kernel writes, by name."""
    Options, Found, probe = make_probe(REALS[real])
    options = Options()
    options.tolerance, options.minimum_separation = 1e-300, distance
    options.t_max = options.t_end = 1.0
    out, (x, y) = wp.zeros(len(times), dtype=Found), (wp.array(p, dtype=wp.vec3d) for p in points)
    directions = wp.array(directions, dtype=wp.types.vector(length=3, dtype=REALS[real]))
    inputs = [KINDS[kind], x, y, options, directions, wp.array(times, dtype=REALS[real])]
    wp.launch(probe, dim=len(times), inputs=inputs, outputs=[out])
    return out.numpy()


def root_down(x: fmpq) -> fmpq:
    """√x, rounded down to some 200 bits."""
    p, q = int(x.numerator), int(x.denominator)
    bits = 2 * max(0, 200 + (q.bit_length() - p.bit_length()) // 2)
    return fmpq(math.isqrt((p << bits) // q), 1 << (bits // 2))


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("distance", [0.125, 1 / 3, 1e-5, 7e9, 1e-60])
def test_offset_is_above_the_exact_one_and_not_lazy(distance, real):
    rng = np.random.default_rng(91)
    u, far = rational(UNIT_ROUNDOFF[REALS[real]]), 2**60
    least = np.inf
    for _ in range(3):
        inputs = drawn(300, rng)
        points = (inputs["vertices_t0"], inputs["vertices_t1"])
        d = inputs["d"].astype(FLOATS[real]).astype(np.float64)
        d[::3] *= 2.0**-40
        out = probed("edge-edge", points, real, distance, d, inputs["t"])
        assert (out["unit"] == out["unit"][:, :1]).all() and (out["separation"] == out["separation"][:, :1]).all()
        names = ("unit", "error", "separation", "offset")
        for unit, error, separation, offset, direction in zip(
            *(exactly(out[k]) for k in names), exactly(d), strict=True
        ):
            radius = rational(distance) / unit[0]
            if fmpq(1, 2**100) < radius < far:
                assert radius * (1 + 13 * u) < separation[0] <= radius * (1 + rational(SLACK + 3) * u)
            exact = sum(abs(direction) * error) + radius * root_down(sum(direction * direction))
            assert offset > exact or radius > far
            if radius < far:
                lazy = radius * rational(math.sqrt(SQUARE_UNDERFLOW[REALS[real]]))
                assert offset < exact * (1 + 40 * u) + 2 * lazy
                least = min(least, float((offset - exact) / (exact * u)))
    # the sum of roundings took part of the slack: what is left is counted, and no more than that
    assert least > 0


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("kind", KINDS)
def test_offset_of_the_volume_is_above_the_exact_one_within_its_bound(kind, real):
    rng = np.random.default_rng(92)
    inputs = drawn(600, rng)
    points = (inputs["vertices_t0"], inputs["vertices_t1"])
    times = inputs["t"].astype(FLOATS[real]).astype(np.float64)
    out = probed(kind, points, real, 0.125, inputs["d"], times)
    unit, bound, t = (exactly(x)[:, None] for x in (out["unit"][:, 0], out["bound"], times))
    x0, x1 = (exactly(p) for p in points)
    q, r = (((1 - t) * (x0[:, i] - x0[:, j]) + t * (x1[:, i] - x1[:, j])) / unit for i, j in SIDES[kind])
    roots = np.array([[root_down(square)] for square in (cross(q, r) ** 2).sum(axis=1)])
    exact = fmpq(1, 8) / unit * roots
    for name in ("c0", "c1"):
        found = exactly(out["of_volume"][name])[:, None]
        assert (found + bound > exact).all() and (found < exact * rational(1.00001) + 4 * bound).all()
        assert (exactly(out["reach"][name])[:, None] + bound > exact).all()


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
        clips = probed(kind, points, real, distance, d, np.zeros(40))["clips"]
        for truth, times in zip(exact_distance_tois(kind, *points, distance), clips.tolist(), strict=True):
            for time in times:
                assert not (truth.hit and (time >= 2 or truth.late(time)))
        advanced += (clips > 0).sum(axis=0)
    assert scale != "as_drawn" or advanced[: 5 if kind == "vertex-face" else 4].min() > 20
