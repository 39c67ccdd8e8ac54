"""Attack on the rounding analysis of `kernels/pair/rounding.py`: inputs searched to make (actual error / bound) large.

A Warp kernel evaluates the intermediate quantities of each step by calling the same functions as the solver. A
reference computes them from the input points alone. The search climbs with the reference in extended precision, which
is fast and eleven bits better than float64; what it ends with is judged in exact rational arithmetic. A ratio of 1 or
more breaks the guarantee; one that stays below 0.1 says that the bound is lazy.

The largest ratios are printed with `pytest -s`, and recorded as properties of the tests.
"""

from fractions import Fraction
from functools import cache
from itertools import combinations, pairwise

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes.boxes import end_box
from ccd_warp.kernels.pair.rounding import MOVING, PROJECTION_PATCH, PROJECTION_ROOT, TINY, UNIT_ROUNDOFF, VOLUME
from ccd_warp.kernels.pair.single_points import row_points
from ccd_warp.kernels.template import specialised
from cull_probe import WIDTHS, culled
from exact import exact_tois
from hard_cases import FAMILIES
from rounding_samples import CORNERS, FLOATS, KINDS, REALS, cross, drawn, dropped, exactly

# Columns of the kernel's output, in the order in which it writes them.
_LAYOUT = {
    "unit": 3,
    "size": 3,
    "corners_t0": 12,  # w00, w01, w10, w11 of the root at both ends of the step
    "corners_t1": 12,
    "sub": 6,  # corner (u, v) of the sub-patch at both ends
    "sub_at": 3,  # the same at time t
    "root_at": 3,
    "root_dot": 1,
    "sub_dot": 1,
    "offset": 1,
    "clip": 1,
    "volume": 4,
    "restricted": 4,
    "volume_bound": 1,
    "normal": 9,
    "separation": 3,
    "separation_offset": 4,
    "hull": 1,
    "zero": 1,
    "d_t": 3,  # direction of a moving facet at times t and x
    "d_x": 3,
    "moving": 3,  # Bernstein coefficients of its product with corner w00
}
_ENDS = np.cumsum([0, *_LAYOUT.values()]).tolist()
_COLUMNS = {name: slice(*ends) for name, ends in zip(_LAYOUT, pairwise(_ENDS), strict=True)}


@cache
def make_probe(real):
    """Kernels that write the intermediate quantities of the solver, and the clips that it is built of."""
    vec3 = wp.types.vector(length=3, dtype=real)
    vec4 = wp.types.vector(length=4, dtype=real)
    patch = specialised("pair.patch", real=real)
    Corners, corners_at = patch.Corners, patch.corners_at
    Options = specialised("pair.query", real=real).Options
    normalise = specialised("pair.solver", real=real).normalise
    sub_corners = specialised("pair.sub_patch", real=real).sub_corners
    # the functions for one lane; `test_lane_width` compares those for several with them
    inclusion = specialised("pair.inclusion", real=real)
    clip, clip_corner, offset = inclusion.clip, inclusion.clip_corner, inclusion.offset
    volume = specialised("pair.volume", real=real)
    Hull, hull_fall, restrict, separation_offset = volume.Hull, volume.fall, volume.restrict, volume.separation_offset
    advance_volume = specialised("pair.advance", real=real).advance_volume
    fall = specialised("pair.moving_clip", real=real).fall
    facets = specialised("pair.facets", real=real)
    direction, clip_facet = facets.direction, facets.clip_facet
    half = wp.constant(real(0.5))
    num_clips = wp.constant(12)

    module = wp.get_module(f"test_rounding.{real.__name__}")
    # the options of the solver's own module
    wp.set_module_options({"enable_backward": False, "fuse_fp": False, "max_unroll": 1}, module=module)

    @wp.func
    def points_of(h: Hull) -> vec4:
        return vec4(h.c0, h.c1, h.c2, h.c3)

    @wp.func
    def put(out: wp.array2d[wp.float64], i: int, k: int, a: vec3) -> int:
        out[i, k] = wp.float64(a[0])
        out[i, k + 1] = wp.float64(a[1])
        out[i, k + 2] = wp.float64(a[2])
        return k + 3

    @wp.func
    def put_corners(out: wp.array2d[wp.float64], i: int, k: int, c: Corners) -> int:
        return put(out, i, put(out, i, put(out, i, put(out, i, k, c.w00), c.w01), c.w10), c.w11)

    @wp.func
    def put4(out: wp.array2d[wp.float64], i: int, k: int, a: vec4) -> int:
        for m in range(4):
            out[i, k + m] = wp.float64(a[m])
        return k + 4

    @wp.func
    def put1(out: wp.array2d[wp.float64], i: int, k: int, a: real) -> int:
        # where nothing falls, the place at which it falls is no number
        out[i, k] = wp.where(wp.isfinite(a), wp.float64(a), wp.float64(0.0))
        return k + 1

    @wp.func
    def vector_of(numbers: wp.array2d[wp.float64], i: int, k: int) -> vec3:
        return vec3(real(numbers[i, k]), real(numbers[i, k + 1]), real(numbers[i, k + 2]))

    @wp.kernel(module=module)
    def probe(
        # in
        kind: int,
        vertices_t0: wp.array2d[wp.vec3d],
        vertices_t1: wp.array2d[wp.vec3d],
        options: Options,
        numbers: wp.array2d[wp.float64],  # direction d, margin, u, v, t, x, four control points
        facet: wp.array2d[int],  # side, axis
        # out
        out: wp.array2d[wp.float64],
    ):
        i = wp.tid()
        n = normalise(kind, row_points(vertices_t0, i), row_points(vertices_t1, i), options)
        d = vector_of(numbers, i, 0)
        margin = vector_of(numbers, i, 3)
        u = real(numbers[i, 6])
        v = real(numbers[i, 7])
        t = real(numbers[i, 8])
        x = real(numbers[i, 9])
        h = vec4(real(numbers[i, 10]), real(numbers[i, 11]), real(numbers[i, 12]), real(numbers[i, 13]))
        k = 0
        for m in range(3):
            out[i, k + m] = n.unit[m]
        k += 3
        k = put(out, i, k, n.size)
        k = put_corners(out, i, k, n.patch.t0)
        k = put_corners(out, i, k, n.patch.t1)
        sub_t0 = sub_corners(n.patch.t0, u, u, v, v)
        sub_t1 = sub_corners(n.patch.t1, u, u, v, v)
        k = put(out, i, k, sub_t0.w00)
        k = put(out, i, k, sub_t1.w00)
        k = put(out, i, k, corners_at(sub_t0, sub_t1, t).w00)
        c_t = corners_at(n.patch.t0, n.patch.t1, t)
        c_x = corners_at(n.patch.t0, n.patch.t1, x)
        k = put(out, i, k, c_t.w00)
        k = put1(out, i, k, wp.dot(d, n.patch.t0.w00))
        k = put1(out, i, k, wp.dot(d, sub_t0.w00))
        k = put1(out, i, k, offset(d, margin))
        k = put1(out, i, k, clip_corner(h[0], h[1], h[2], real(0.0)))
        f = n.problem.volume
        k = put4(out, i, k, vec4(f.b0, f.b1, f.b2, f.b3))
        k = put4(out, i, k, points_of(restrict(f, t, x)))
        k = put1(out, i, k, f.bound)
        k = put(out, i, k, f.normal_t0)
        k = put(out, i, k, f.normal_mid)
        k = put(out, i, k, f.normal_t1)
        k = put(out, i, k, n.problem.separation)
        k = put4(out, i, k, points_of(separation_offset(f, n.problem.separation, t, x)))
        hull = Hull()
        hull.c0 = h[0]
        hull.c1 = h[1]
        hull.c2 = h[2]
        hull.c3 = h[3]
        k = put1(out, i, k, hull_fall(hull))
        k = put1(out, i, k, fall(h[0], h[1], h[2]))
        number = real(3 * facet[i, 0] + 3 + facet[i, 1])
        d_t = direction(number, c_t)
        d_x = direction(number, c_x)
        k = put(out, i, k, d_t)
        k = put(out, i, k, d_x)
        k = put1(out, i, k, wp.dot(d_t, c_t.w00))
        k = put1(out, i, k, half * (wp.dot(d_t, c_x.w00) + wp.dot(d_x, c_t.w00)))
        k = put1(out, i, k, wp.dot(d_x, c_x.w00))

    @wp.kernel(module=module)
    def clips(
        # in
        kind: int,
        vertices_t0: wp.array2d[wp.vec3d],
        vertices_t1: wp.array2d[wp.vec3d],
        options: Options,
        numbers: wp.array2d[wp.float64],  # direction d, start t
        # out
        clipped: wp.array[wp.float64],
        by_volume: wp.array[wp.float64],
        by_facet: wp.array2d[wp.float64],
        unit: wp.array[wp.vec3d],
    ):
        i = wp.tid()
        n = normalise(kind, row_points(vertices_t0, i), row_points(vertices_t1, i), options)
        d = vector_of(numbers, i, 0)
        t = real(numbers[i, 3])
        margin = n.problem.error + n.problem.separation
        clipped[i] = wp.float64(clip(d, margin, t, n.patch.t0, n.patch.t1, n.patch.is_triangle))
        by_volume[i] = wp.float64(advance_volume(n.problem, real(0.0), real(1.0)))
        separation = n.problem.separation
        for k in range(12):
            s = clip_facet(
                n.patch.t0, n.patch.t1, separation, n.problem.error, real(k), real(0.0), real(1.0), num_clips
            )
            by_facet[i, k] = wp.float64(s)
        unit[i] = n.unit

    return Options, probe, clips


# ---- The reference, in any arithmetic --------------------------------------------------------------------------------


def extended(values: np.ndarray) -> np.ndarray:
    return np.asarray(values).astype(np.longdouble)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def permanent_cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sum of the magnitudes of the products of a cross product."""
    turn = [(1, 2), (2, 0), (0, 1)]
    return np.stack([abs(a[..., i] * b[..., j]) + abs(a[..., j] * b[..., i]) for i, j in turn], axis=-1)


def blossom(b: list, parameters: tuple) -> np.ndarray:
    """Multilinear form of a polynomial in Bernstein form: one interpolation a parameter."""
    for s in parameters:
        b = [(1 - s) * low + s * high for low, high in pairwise(b)]
    return b[0]


class Sample:
    """Inputs, the kernel's outputs, and the exact quantities, all in one arithmetic."""

    def __init__(self, kind: str, inputs: dict, out: np.ndarray, unit_roundoff: float, convert) -> None:
        self.kind = kind
        self.u = convert(np.array(unit_roundoff))[()]
        self.constant = lambda x: convert(np.array(x))[()]
        self.out = {name: convert(out[:, columns]) for name, columns in _COLUMNS.items()}
        for name in ("d", "margin", "h"):
            setattr(self, name, convert(inputs[name]))
        self.weights = [convert(inputs[name])[:, None] for name in ("u", "v", "t", "x")]
        unit = self.out["unit"]
        points = [convert(inputs[name]) for name in ("vertices_t0", "vertices_t1")]
        # (corner, side) as in kernels/pair/patch.py, from the definition of each pair kind
        self.corners = [[(p[:, i] - p[:, j]) / unit for i, j in (*CORNERS[kind], (0, 3))[:4]] for p in points]
        sides = {"vertex-face": ((1, 2), (1, 3)), "edge-edge": ((2, 3), (1, 0))}[kind]
        self.sides = [[(p[:, i] - p[:, j]) / unit for i, j in sides] for p in points]
        self.m = self.out["size"]

    def error_bound(self, factor: float) -> np.ndarray:
        """E of a projection."""
        return self.constant(factor) * self.u * self.m

    def sub_corner(self, frame: int) -> np.ndarray:
        u, v, _, _ = self.weights
        w00, w01, w10, w11 = self.corners[frame]
        return (1 - u) * ((1 - v) * w00 + v * w01) + u * ((1 - v) * w10 + v * w11)

    def volume(self) -> list[np.ndarray]:
        """Bernstein coefficients of P·(Q×R)."""
        p = [c[0] for c in self.corners]
        (q0, r0), (q1, r1) = self.sides
        n0, n1 = cross(q0, r0), cross(q1, r1)
        mixed = cross(q0, r1) + cross(q1, r0)
        return [
            dot(p[0], n0),
            (dot(p[1], n0) + dot(p[0], mixed)) / 3,
            (dot(p[0], n1) + dot(p[1], mixed)) / 3,
            dot(p[1], n1),
        ]

    def normals(self) -> list[np.ndarray]:
        (q0, r0), (q1, r1) = self.sides
        return [cross(q0, r0), (cross(q0, r1) + cross(q1, r0)) / 2, cross(q1, r1)]

    def largest_sides(self) -> tuple[np.ndarray, np.ndarray]:
        return tuple(np.maximum(abs(a), abs(b)) for a, b in zip(*self.sides, strict=True))


_SLACK = 1.001  # of steps 2 and 3
_STEPS = {}


def step(name: str, least: float = 0.1):
    """Registers (error, bound) of one step, each of shape [n] or [n, components]; least: a ratio that is reached."""

    def register(function):
        _STEPS[name] = (function, least)
        return function

    return register


@step("2 difference and normalisation")
def _(s: Sample):
    found = np.concatenate([s.out["corners_t0"], s.out["corners_t1"]], axis=1)
    return abs(found - np.concatenate([*s.corners[0], *s.corners[1]], axis=1)), s.constant(_SLACK) * s.u * abs(found)


@step("3 corner of a sub-patch")
def _(s: Sample):
    error = [abs(s.out["sub"][:, 3 * frame : 3 * frame + 3] - s.sub_corner(frame)) for frame in range(2)]
    return np.concatenate(error, axis=1), np.concatenate([s.error_bound(5 * _SLACK)] * 2, axis=1)


@step("4 projection of the root")
def _(s: Sample):
    error = abs(s.out["root_dot"][:, 0] - dot(s.d, s.corners[0][0]))
    return error, dot(abs(s.d), s.error_bound(PROJECTION_ROOT))


@step("4 projection of a sub-patch")
def _(s: Sample):
    error = abs(s.out["sub_dot"][:, 0] - dot(s.d, s.sub_corner(0)))
    return error, dot(abs(s.d), s.error_bound(PROJECTION_PATCH))


@step("6 offset")
def _(s: Sample):
    # what rounding took of the factor 1 + 8u
    exact = dot(abs(s.d), s.margin)
    return (1 + 8 * s.u) * exact - s.out["offset"][:, 0], 8 * s.u * exact


def _crossing(a, b):
    """First zero of a segment from a > 0 to b <= 0, as a fraction; beyond 1 otherwise."""
    falls = (a > 0) & (b <= 0)
    return np.where(falls, a / np.where(falls, a - b, 1), 5)


@step("7 time of a clip")
def _(s: Sample):
    a, b, offset = s.h[:, 0], s.h[:, 1], s.h[:, 2]
    falls = (a > offset) & (b <= offset)
    exact = (a - offset) / np.where(falls, a - b, 1)
    return np.where(falls, s.out["clip"][:, 0] - (1 - 8 * s.u) * exact, 0), np.where(falls, 8 * s.u * exact, 1)


@step("8 corner at a time")
def _(s: Sample):
    t = s.weights[2]
    error = abs(s.out["sub_at"] - ((1 - t) * s.sub_corner(0) + t * s.sub_corner(1)))
    return error, s.error_bound(8 * _SLACK)


@step("9 volume")
def _(s: Sample):
    exact = np.stack(s.volume(), axis=1)
    q, r = s.largest_sides()
    p = np.maximum(abs(s.corners[0][0]), abs(s.corners[1][0]))
    bound = s.constant(13) * s.u * dot(p, permanent_cross(q, r))
    return abs(s.out["volume"] - exact), np.repeat(bound[:, None], 4, axis=1)


@step("9 volume on an interval")
def _(s: Sample):
    t, x = (w[:, 0] for w in s.weights[2:])
    b = s.volume()
    exact = np.stack([blossom(b, (t,) * (3 - k) + (x,) * k) for k in range(4)], axis=1)
    return abs(s.out["restricted"] - exact), np.repeat(s.out["volume_bound"], 4, axis=1)


@step("9 normal")
def _(s: Sample):
    exact = np.concatenate(s.normals(), axis=1)
    bound = 15 * s.u * permanent_cross(*s.largest_sides())
    return abs(s.out["normal"] - exact), np.concatenate([bound] * 3, axis=1)


@step("9 separation", least=0.0)
def _(s: Sample):
    # the volume's magnitude beyond the separation may not be overestimated by more than the bound
    t, x = (w for w in s.weights[2:])
    b = s.volume()
    n = s.normals()
    v = [blossom(b, (t[:, 0],) * (3 - k) + (x[:, 0],) * k) for k in range(4)]
    sign = np.where(s.out["restricted"][:, 0] < 0, -1, 1)
    a = [dot(s.out["separation"], abs(blossom(n, (t,) * (2 - k) + (x,) * k))) for k in range(3)]
    elevated = [a[0], (a[0] + 2 * a[1]) / 3, (2 * a[1] + a[2]) / 3, a[2]]
    exact = np.stack([sign * f - o for f, o in zip(v, elevated, strict=True)], axis=1)
    found = sign[:, None] * s.out["restricted"] - s.out["separation_offset"]
    return found - exact, np.repeat(s.out["volume_bound"], 4, axis=1)


# The factor 1 - 12u covers eleven roundings between a crossing and a time; the functions measured here make fewer.
def _first_crossing(s: Sample, last: int, found: np.ndarray):
    h = [s.h[:, k] for k in range(last + 1)]
    times = [i + (j - i) * _crossing(h[i], h[j]) for i, j in combinations(range(last + 1), 2)]
    exact = np.where(h[0] > 0, np.minimum.reduce(times), 9)
    valid = exact < last + 1
    fraction = np.where(valid, exact / s.constant(last), 1)
    return np.where(valid, found[:, 0] - fraction, 0), 12 * s.u * fraction


@step("9 crossing of the hull")
def _(s: Sample):
    return _first_crossing(s, 3, s.out["hull"])


@step("10 crossing of a facet")
def _(s: Sample):
    return _first_crossing(s, 2, s.out["zero"])


@step("10 moving facet")
def _(s: Sample):
    t, x = s.weights[2:]
    w0, w1 = (c[0] for c in s.corners)
    w_t, w_x = ((1 - y) * w0 + y * w1 for y in (t, x))
    d_t, d_x = s.out["d_t"], s.out["d_x"]
    exact = [dot(d_t, w_t), (dot(d_t, w_x) + dot(d_x, w_t)) / 2, dot(d_x, w_x)]
    o_t, o_x = (dot(abs(d), s.error_bound(MOVING * PROJECTION_ROOT)) for d in (d_t, d_x))
    return abs(s.out["moving"] - np.stack(exact, axis=1)), np.stack([o_t, (o_t + o_x) / 2, o_x], axis=1)


# ---- The search ------------------------------------------------------------------------------------------------------


def ratio_of(error: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """Largest error over its bound, per sample; an error where no bound is left counts as inf."""
    shape = (len(error), -1)
    error, bound = np.reshape(error, shape), np.reshape(bound, shape)
    ratio = np.where(bound > 0, error / np.where(bound > 0, bound, 1), np.where(error > 0, np.inf, 0))
    return ratio.max(axis=1).astype(np.float64)


def as_taken(inputs: dict, real: str) -> dict:
    """Inputs as the kernel sees them: what enters in the precision of the iteration is rounded to it."""
    taken = dict(inputs)
    for name in ("d", "margin", "h", "t", "x"):
        taken[name] = inputs[name].astype(FLOATS[real]).astype(np.float64)
    low, high = np.minimum(taken["t"], taken["x"]), np.maximum(taken["t"], taken["x"])
    taken["t"], taken["x"] = low, high
    return taken


def mutated(inputs: dict, real: str, rng: np.random.Generator) -> dict:
    """A child of each sample: a few numbers with mantissa bits turned, signs turned, or drawn anew."""
    n = len(inputs["u"])
    fresh = drawn(n, rng)
    bits = 52 if real == "float64" else 23
    child = {}
    for name, old in inputs.items():
        pick = rng.random(old.shape) < 2.0 ** -rng.integers(1, 6, (n, *[1] * (old.ndim - 1)))
        if name in ("u", "v", "facet"):
            child[name] = np.where(rng.random((n, *[1] * (old.ndim - 1))) < 0.1, fresh[name], old)
            continue
        turned = old + rng.choice([-1, 1], old.shape) * np.ldexp(
            1.0, np.frexp(old)[1] - 1 - rng.integers(1, bits + 1, old.shape)
        )
        if name not in ("t", "x", "margin"):
            turned = np.where(rng.random(old.shape) < 0.1, -old, turned)
        new = np.where(rng.random(old.shape) < 0.15, fresh[name], turned)
        child[name] = np.where(pick, new, old)
    for name in ("t", "x"):
        child[name] = np.clip(child[name], 0, 1)
    return child


def launched(which: int, kind: str, points, real: str, separation: float, numbers: list, others: list, outputs: list):
    """What one of the kernels writes."""
    Options, *kernels = make_probe(REALS[real])
    options = Options()
    options.length_scale, options.tolerance, options.minimum_separation = 1.0, 1e-300, separation
    options.t_max = options.t_end = 1.0
    x = [wp.array(p, dtype=wp.vec3d) for p in points]
    numbers = wp.array(np.concatenate(numbers, axis=1), dtype=wp.float64)
    wp.launch(kernels[which], len(x[0]), [KINDS[kind], *x, options, numbers, *others], outputs=outputs)
    return tuple(array.numpy() for array in outputs)


def evaluated(kind: str, inputs: dict, real: str, separation: float) -> np.ndarray:
    """What the kernel computes, shape [n, columns]."""
    numbers = [inputs["d"], inputs["margin"], *(inputs[k][:, None] for k in ("u", "v", "t", "x")), inputs["h"]]
    out, facets = wp.zeros((len(inputs["u"]), _ENDS[-1]), dtype=wp.float64), wp.array(inputs["facet"], dtype=wp.int32)
    points = inputs["vertices_t0"], inputs["vertices_t1"]
    return launched(0, kind, points, real, separation, numbers, [facets], [out])[0]


def searched(kind: str, real: str, function, *, samples: int, generations: int, seed: int) -> float:
    """The largest ratio that the climb finds, judged in exact arithmetic."""
    rng = np.random.default_rng(seed)
    separation = 0.125
    u = UNIT_ROUNDOFF[REALS[real]]

    def ratios(inputs: dict, convert) -> np.ndarray:
        out = evaluated(kind, inputs, real, separation)
        with np.errstate(all="ignore"):
            return ratio_of(*function(Sample(kind, inputs, out, u, convert)))

    parents = as_taken(drawn(samples, rng), real)
    best = ratios(parents, extended)
    for generation in range(generations):
        child = as_taken(mutated(parents, real, rng), real)
        found = ratios(child, extended)
        better = found > best
        for name, values in child.items():
            parents[name] = np.where(better.reshape(-1, *[1] * (values.ndim - 1)), values, parents[name])
        best = np.where(better, found, best)
        if generation % 10 == 9:
            # the worse half starts again from the better one
            order = np.argsort(best)
            half = samples // 2
            for values in parents.values():
                values[order[:half]] = values[order[-half:]]
            best[order[:half]] = best[order[-half:]]
    top = np.argsort(best)[-6:]
    return float(ratios({name: values[top] for name, values in parents.items()}, exactly).max())


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", _STEPS)
def test_bound_holds_and_is_not_lazy(name, real, record_property):
    function, least = _STEPS[name]
    ratios = {kind: searched(kind, real, function, samples=192, generations=24, seed=41) for kind in KINDS}
    print(f"\n{name}, {real}: {ratios}")
    record_property("largest_ratio", ratios)
    assert max(ratios.values()) < 1
    assert max(ratios.values()) > least


# ---- The clips: every time that they report is certainly free --------------------------------------------------------


def clip_times(kind: str, points: tuple, real: str, separation: float, d: np.ndarray, t: np.ndarray) -> tuple:
    """Times that each clip reports, and the normalised unit of each axis."""
    outputs = [wp.zeros(shape, dtype=wp.float64) for shape in (len(t), len(t), (len(t), 12))]
    outputs.append(wp.zeros(len(t), dtype=wp.vec3d))
    return launched(1, kind, points, real, separation, [d, t[:, None]], [], outputs)


_CLIP_FAMILIES = ("random_colliding", "lattice", "slivers", "tiny_motion", "mixed_axis_scales", "one_ulp_neighbours")


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("separation", [0.0, 2.0**-10])
def test_clip_is_a_lower_bound(separation, kind, real):
    rng = np.random.default_rng(42)
    clipped_some = 0
    for family in _CLIP_FAMILIES:
        points = FAMILIES[family](kind, 60, rng)
        start, end = ([p[:, i] - p[:, j] for i, j in CORNERS[kind]] for p in points)
        t = rng.choice([0.0, 0.25, 0.5], 60)
        # a direction that separates at t in general, as the closest pair's does: the mean corner, and noise
        size = np.maximum(np.abs(start).max(axis=0), np.abs(end).max(axis=0)) + 1e-300
        d = np.mean(start, axis=0) * (1 - t[:, None]) + np.mean(end, axis=0) * t[:, None]
        d = (d / size + rng.normal(0, 0.1, d.shape)).astype(FLOATS[real]).astype(np.float64)
        s, _, _, unit = clip_times(kind, points, real, separation, d, t)
        exact_d, exact_unit, x0, x1 = (exactly(a) for a in (d, unit, *points))
        for i in np.flatnonzero(s > t):
            clipped_some += 1
            stop = Fraction(min(float(s[i]), 1.0))
            for a, b in CORNERS[kind]:
                # linear in time, so both ends of [t, s] tell; at s itself d may just cease to separate
                products = []
                for time in (Fraction(float(t[i])), stop):
                    w = (x0[i, a] - x0[i, b]) * (1 - time) + (x1[i, a] - x1[i, b]) * time
                    products.append(sum(exact_d[i] * w / exact_unit[i]))
                # corners are at most 1 in these units, so a separation of 8 says as much as any larger one
                normalised = [min(Fraction(separation) / side, 8) for side in exact_unit[i]]
                beyond = sum(abs(exact_d[i]) * normalised)
                assert products[0] > beyond
                assert products[1] > beyond or (s[i] < 2 and products[1] == beyond)
    assert clipped_some > 60


# Powers of two by which the axes are scaled: exact, but products of such lengths underflow and overflow.
_SCALES = {"as_drawn": (0, 0, 0), "small": (-900, -900, -900), "mixed": (700, -537, -530)}


@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("separation", "scale"), [(0.0, "as_drawn"), (2.0**-10, "as_drawn"), (0.0, "small"), (0.0, "mixed")]
)
def test_volume_and_facets_clip_no_contact(separation, scale, kind, real):
    rng = np.random.default_rng(43)
    advanced = {"volume": 0, "facet": 0}
    for family in _CLIP_FAMILIES:
        points = [np.ldexp(p, _SCALES[scale]) for p in FAMILIES[family](kind, 30, rng)]
        exact = exact_tois(kind, *points, separation)
        _, by_volume, by_facet, _ = clip_times(kind, points, real, separation, np.ones((30, 3)), np.zeros(30))
        for i, truth in enumerate(exact):
            for time in (by_volume[i], *by_facet[i]):
                # 2: certainly free to the end
                assert not (truth.hit and (time >= 2 or truth.late(float(time))))
        advanced["volume"] += (by_volume > 0).sum()
        advanced["facet"] += (by_facet.max(axis=1) > 0).sum()
    assert min(advanced.values()) > 40


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("t_end", [1.0, 0.3])
@pytest.mark.parametrize(
    ("separation", "scale"), [(0.0, "as_drawn"), (2.0**-10, "as_drawn"), (0.0, "small"), (0.0, "mixed")]
)
@pytest.mark.parametrize("test", ["volume", "sides"])
def test_cull_drops_no_contact(test, separation, scale, t_end, kind):
    rng = np.random.default_rng(44)
    num_dropped = 0
    for family in ("random", "one_plane", "parallel_edges", *_CLIP_FAMILIES):
        points = [np.ldexp(p, _SCALES[scale]) for p in FAMILIES[family](kind, 100, rng)]
        num_dropped += dropped(kind, points, exact_tois, separation, t_end, test=test).sum()
    assert num_dropped > 10 or scale != "as_drawn"


@pytest.mark.parametrize("kind", KINDS)
def test_sides_leave_a_point_on_a_side_open(kind):
    """A point at two fifths of a side touches it; the projections across the side are nothing but rounding."""
    rng = np.random.default_rng(45)
    n = 4000
    p0 = rng.integers(-(2**49), 2**49, (n, 3))  # sums of these are exact
    g = rng.integers(-(2**40), 2**40, (n, 3))
    far = rng.integers(-(2**49), 2**49, (n, 3))
    on_side = p0 + 2 * g
    side = [p0, p0 + 5 * g]
    points = [on_side, *side, far] if kind == "vertex-face" else [on_side, far, *side]
    x = np.stack(points, axis=1).astype(np.float64)
    for width in WIDTHS:
        assert not culled(kind, x, x, width, test="sides").any()


@cache
def make_end_probe():
    module = wp.get_module("test_rounding.end")
    wp.set_module_options({"enable_backward": False, "fuse_fp": False}, module=module)

    @wp.kernel(module=module)
    def end_probe(
        # in
        a: wp.array[wp.vec3d],
        b: wp.array[wp.vec3d],
        t: wp.array[wp.float64],
        # out
        ends: wp.array2d[wp.vec3d],
    ):
        i = wp.tid()
        box = end_box(a[i], b[i], t[i])
        ends[i, 0] = box.lower
        ends[i, 1] = box.upper

    return end_probe


@pytest.mark.parametrize("exponent", [0, 1000, -1070])
def test_box_at_the_end_of_a_shorter_step_holds_the_point(exponent):
    rng = np.random.default_rng(46)
    n = 3000
    a, b = (np.ldexp(rng.standard_normal((n, 3)), exponent) for _ in range(2))
    b[::3] = np.nextafter(a[::3], np.inf)
    a[1::7] *= 1e-9
    t = rng.random(n) ** rng.integers(1, 20, n)
    ends, points = wp.empty((n, 2), dtype=wp.vec3d), [wp.array(x, dtype=wp.vec3d) for x in (a, b)]
    wp.launch(make_end_probe(), dim=n, inputs=[*points, wp.array(t, dtype=wp.float64)], outputs=[ends])
    x, y, s = exactly(a), exactly(b), exactly(t)[:, None]
    lower, upper = ends.numpy().swapaxes(0, 1)
    at = x + s * (y - x)
    assert (exactly(lower) <= at).all() and (at <= exactly(upper)).all() and (lower < upper).sum() > n


def test_constants_cover_the_steps():
    # the sums of roundings that the docstring counts, in units of u
    assert PROJECTION_ROOT > 1.001 * (1 + 3)
    assert PROJECTION_PATCH > 1.001 * (5 + 3)
    assert VOLUME >= 13 + 9
    assert MOVING * PROJECTION_ROOT > 1.001 * (1 + 3 + 3 + 1)
    assert MOVING * PROJECTION_PATCH > 1.001 * (5 + 3 + 3 + 1)
    # step 5: the absolute term is far below any rounding of a normalised number, and far above an underflow
    for real, tiny in TINY.items():
        assert np.finfo(FLOATS[real.__name__]).tiny * 2**20 < tiny < UNIT_ROUNDOFF[real] ** 2
