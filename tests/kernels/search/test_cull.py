"""The cull: one answer in every width, lane and company, and never free for a pair that touches."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.pair.single_points import corners, points_of
from ccd_warp.kernels.template import specialised
from exact import exact_distance_tois, exact_tois
from hard_cases import FAMILIES
from rounding_samples import KINDS

from ccd_warp._runtime import lanes

WIDTHS = (1, 4, 8)
every_kind = pytest.mark.parametrize("kind", KINDS)
# Powers of two by which the axes are scaled: exact, but products of such lengths underflow and overflow.
SCALES = (0, 0, 0), (-900, -900, -900), (-1060, -1060, -1060), (1000, 1000, 1000), (700, -537, -530)


@cache
def _make_probe(width, test, flags):
    module = wp.get_module(f"cull_probe.{width}.{test}.{flags}")
    options = {"enable_backward": False, "fuse_fp": False, **({"cpu_compiler_flags": flags} if flags else {})}
    wp.set_module_options(options, module=module)
    cull = specialised("search.cull", width=width)
    free_lanes, bits_of = cull.free_lanes, cull.bits_of
    by_volume, by_sides = cull.is_free_by_volume, cull.is_free_by_sides
    Corners = specialised("pair.patch", width=width).Corners
    lanes = wp.constant(width)

    if width > 1:
        points_at = specialised("search.lane_points", width=width).points_at
        corners_of_lanes = specialised("pair.points", width=width).corners

        @wp.func
        def corners_at(kind: int, x: wp.array[wp.vec3d], first: int, count: int) -> Corners:
            vertices = wp.zeros(shape=32, dtype=wp.int32)
            for k in range(lanes):
                for n in range(4):
                    vertices[n * 8 + k] = 4 * wp.min(first + k, count - 1) + n
            return corners_of_lanes(kind, points_at(x, vertices, 0, 8))

    else:

        @wp.func
        def corners_at(kind: int, x: wp.array[wp.vec3d], first: int, count: int) -> Corners:
            v = 4 * first
            if kind == 1:
                return corners(kind, points_of(kind, wp.vec3i(v, v + 1, v), wp.vec3i(v + 2, v + 3, v), x))
            return corners(kind, points_of(kind, wp.vec3i(v, v, v), wp.vec3i(v + 1, v + 2, v + 3), x))

    @wp.kernel(module=module)
    def probe(
        kind: int,
        x0: wp.array[wp.vec3d],
        x1: wp.array[wp.vec3d],
        separation: wp.float64,
        is_euclidean: int,
        t_end: wp.float64,
        is_free: wp.array[wp.bool],
    ):
        first = wp.tid() * lanes
        count = is_free.shape[0]
        c0 = corners_at(kind, x0, first, count)
        c1 = corners_at(kind, x1, first, count)
        bits = wp.uint32(0)
        if wp.static(test == "volume"):
            bits = bits_of(by_volume(c0, c1, separation, is_euclidean, t_end))
        elif wp.static(test == "sides"):
            bits = bits_of(by_sides(kind, c0, c1, separation, is_euclidean, t_end))
        else:
            bits = free_lanes(kind, c0, c1, separation, is_euclidean, t_end, wp.uint32(0xFFFFFFFF))
        for k in range(lanes):
            if first + k < count:
                is_free[first + k] = ((bits >> wp.uint32(k)) & wp.uint32(1)) != wp.uint32(0)

    return probe


def culled(kind, points_t0, points_t1, width, *, separation=0.0, is_euclidean=False, t_end=1.0, test="both", flags=""):
    """Which pairs, given by points of shape [n, 4, 3], a test of the cull proves free.

    A separation is one in the maximum norm, or with ``is_euclidean`` a distance.
    ``flags`` are those of Warp's compiler, such as another processor.
    """
    count = len(points_t0)
    x = [wp.array(np.reshape(p, (-1, 3)), dtype=wp.vec3d, device="cpu") for p in (points_t0, points_t1)]
    is_free = wp.zeros(count, dtype=wp.bool, device="cpu")
    inputs = [KINDS[kind], *x, separation, int(is_euclidean), t_end]
    wp.launch(_make_probe(width, test, flags), -(-count // width), inputs=inputs, outputs=[is_free], device="cpu")
    return is_free.numpy()


@every_kind
@pytest.mark.parametrize("flags", ["", "-target-cpu haswell"], ids=["of this machine", "without AVX-512"])
def test_every_width_gives_one_answer(flags, kind):
    if flags and lanes.cpu_lanes() < 4:
        pytest.skip("this processor has no AVX2")
    rng, found = np.random.default_rng(51), []
    for separation, t_end in ((0.0, 1.0), (2.0**-10, 1.0), (0.0, 0.3), (2.0**-10, 0.3)):
        for family in FAMILIES.values():
            drawn = family(kind, 101, rng)
            for scale in SCALES:
                with np.errstate(over="ignore", under="ignore"):
                    points, options = np.ldexp(drawn, scale), {"separation": separation, "t_end": t_end}
                found.append(culled(kind, *points, 1, **options))
                for width in WIDTHS[not flags :]:
                    wide = culled(kind, *points, width, flags=flags, **options)
                    assert np.array_equal(wide, found[-1]), (family.name, scale, width)
    assert 0.01 < np.mean(found) < 0.99


@pytest.mark.parametrize("width", [4, 8])
def test_what_an_item_collects_is_as_long_as_its_array(width):
    collected = specialised("search.collected", width=width)
    assert collected.number_at + 1 == collected.partners_at == 6 * collected.capacity + 1
    assert collected.num_collected == collected.partners_at + 16


@every_kind
@pytest.mark.parametrize("width", WIDTHS)
def test_answer_depends_neither_on_the_lane_nor_on_the_neighbours(width, kind):
    rng = np.random.default_rng(52)
    points = np.concatenate([family(kind, 60, rng) for family in FAMILIES.values()], axis=1)
    for p in points:  # some with numbers that spoil whatever they meet
        p[rng.integers(len(p), size=40), rng.integers(4, size=40), rng.integers(3, size=40)] = np.nan
    first = culled(kind, *points, width)
    assert 0 < first.sum() < len(first)
    for order in (rng.permutation(len(first)) for _ in range(3)):
        assert np.array_equal(culled(kind, *points[:, order], width), first[order])


# Whether the distance is Euclidean, powers of two by which the axes are scaled, and distances as shares of the size.
CULLS = [(False, 0, 0.0), (False, 0, 2.0**-10), (False, 0, 2.0**-6), (False, -900, 0.0), (False, SCALES[4], 0.0)]
CULLS += [(True, scale, share) for scale in (0, -100, -300, 100, 300) for share in (1e-3, 0.2)]
OF_DISTANCES = ("random", "one_plane", "parallel_edges", "cloth_like", "slivers", "mixed_axis_scales")


@every_kind
@pytest.mark.parametrize("t_end", [1.0, 0.6, 0.3])
@pytest.mark.parametrize(("is_euclidean", "scale", "share"), CULLS)
def test_no_pair_in_contact_is_free(is_euclidean, scale, share, t_end, kind):
    rng, num_free = np.random.default_rng(44), dict.fromkeys(["volume", "sides", "both"], 0)
    for family in OF_DISTANCES if is_euclidean else FAMILIES:
        points = [np.ldexp(p, scale) for p in FAMILIES[family](kind, 100 if is_euclidean else 40, rng)]
        distance = share * float(np.median(np.abs(points[0]).max(axis=(1, 2))))
        options, free = {"separation": distance, "is_euclidean": is_euclidean, "t_end": t_end}, False
        for test in num_free:
            narrow, *wider = (culled(kind, *points, width, test=test, **options) for width in WIDTHS)
            assert all(np.array_equal(narrow, each) for each in wider)
            num_free[test] += narrow.sum()
            free |= narrow
        tois = exact_distance_tois if is_euclidean else exact_tois
        assert not any(truth.hit for truth in tois(kind, *(p[free] for p in points), distance, t_end))
    assert min(num_free.values()) > 10 or scale != 0 or share > 0.1


@every_kind
def test_sides_leave_a_point_on_a_side_open(kind):
    """A point at two fifths of a side touches it; the projections across the side are nothing but rounding."""
    rng = np.random.default_rng(45)
    p0, far = rng.integers(-(2**49), 2**49, (2, 4000, 3))  # sums of these are exact
    g = rng.integers(-(2**40), 2**40, (4000, 3))
    on_side, side = p0 + 2 * g, [p0, p0 + 5 * g]
    points = [on_side, *side, far] if kind == "vertex-face" else [on_side, far, *side]
    x = np.stack(points, axis=1).astype(np.float64)
    assert not any(culled(kind, x, x, width, test="sides").any() for width in WIDTHS)


@every_kind
@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("width", WIDTHS)
def test_pair_with_a_number_that_is_not_finite_stays_open(width, number, kind):
    rng = np.random.default_rng(54)
    far = rng.random((2, 96, 4, 3))
    far[:, :, 2 if kind == "edge-edge" else 1 :, 0] += 9.0
    assert culled(kind, *far, width).mean() > 0.9
    spoiled = far.reshape(2, 96, 12).copy()
    for k in range(96):  # each coordinate at one end, at the other, and at both
        spoiled[[0, 1] if k % 24 < 12 and k > 48 else k // 12 % 2, k, k % 12] = number
    for test in ("volume", "sides", "both"):
        assert not culled(kind, *spoiled.reshape(far.shape), width, test=test).any()
