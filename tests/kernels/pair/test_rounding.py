"""Attack on the rounding analysis of `kernels/pair/rounding.py`: inputs searched to make (actual error / bound) large.

A Warp kernel evaluates the intermediate quantities of each step by calling the same functions as the solver. A
reference computes them from the input points alone. The search climbs with the reference in extended precision, which
is fast and eleven bits better than float64; what it ends with is judged in exact rational arithmetic. A ratio of 1 or
more breaks the guarantee; one that stays below 0.1 says that the bound is lazy.
The largest ratios are recorded as properties of the tests.
"""

from functools import cache
from itertools import combinations, pairwise

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.boxes.boxes import end_box
from ccd_warp.kernels.pair.norm import OWN_BOX_NORM
from ccd_warp.kernels.pair.rounding import (
    MOVING,
    PROJECTION_PATCH,
    PROJECTION_ROOT,
    RESTRICTION,
    TINY,
    UNIT_ROUNDOFF,
    VOLUME,
)
from ccd_warp.kernels.pair.single_points import row_points
from ccd_warp.kernels.template import specialised
from exact import exact_tois
from hard_cases import FAMILIES
from numpy.lib.recfunctions import structured_to_unstructured
from rounding_samples import CORNERS, FLOATS, KINDS, POINTS, REALS, SIDES, cross, drawn, exactly, rational, struct


@cache
def make_probe(real):
    """A kernel that writes the intermediate quantities of the solver, and when the clips that it is built of end."""
    vec3, vec4, vec14 = (wp.types.vector(length=n, dtype=real) for n in (3, 4, 14))
    # of inclusion, the functions for one lane; the laws compare those for several with them
    patch, query, solver, sub_patch, inclusion, volume, advance, moving_clip, facets = (
        specialised(f"pair.{name}", real=real, norm=OWN_BOX_NORM)
        for name in "patch query solver sub_patch inclusion volume advance moving_clip facets".split()
    )
    Options, Corners, corners_at, Hull = query.Options, patch.Corners, patch.corners_at, volume.Hull
    normalise, sub_corners, crossing = solver.normalise, sub_patch.sub_corners, moving_clip.crossing
    clip, clip_corner, offset = inclusion.clip, inclusion.clip_corner, inclusion.offset
    hull_crossing, restrict, separation_offset = volume.crossing, volume.restrict, volume.separation_offset
    reach_of = volume.reach_of
    advance_volume, direction, clip_facet = advance.advance_volume, facets.direction, facets.clip_facet
    half, num_clips = wp.constant(real(0.5)), wp.constant(12)
    module = wp.get_module(f"test_rounding.{real.__name__}")
    # the options of the solver's own module
    wp.set_module_options({"enable_backward": False, "fuse_fp": False, "max_unroll": 1}, module=module)
    # a direction d, control points h; a facet is its side and axis
    Given = struct("Given", [("d margin", vec3), ("h", vec4), ("u v t x", real), ("facet", wp.vec2i)])
    # Corners of the root at both ends of the step; corner (u, v) of the sub-patch at both ends, and at time t; of a
    # moving facet the directions at times t and x, and the Bernstein coefficients of its product with corner w00; where
    # clips end: along d from t on, by the volume, by each facet.
    fields = [("unit", wp.vec3d), ("corners_t0 corners_t1", Corners), ("size sub_t0 sub_t1 sub_at", vec3)]
    fields += [("root_dot sub_dot offset clip volume_bound hull zero", real), ("volume", vec4), ("clips", vec14)]
    fields += [("normal_t0 normal_mid normal_t1 separation d_t d_x moving", vec3)]
    Found = struct("Found", [*fields, ("restricted separation_offset reach", Hull)])

    @wp.kernel(module=module)
    def probe(kind: int, x0: POINTS, x1: POINTS, options: Options, given: wp.array[Given], out: wp.array[Found]):
        i = wp.tid()
        n = normalise(kind, row_points(x0, i), row_points(x1, i), options)
        start, end = n.patch.t0, n.patch.t1
        f, separation, error = n.problem.volume, n.problem.separation, n.problem.error
        g = given[i]
        h = g.h
        s = Found()
        s.unit = n.unit
        s.size = n.size
        s.corners_t0 = start
        s.corners_t1 = end
        sub_t0 = sub_corners(start, g.u, g.u, g.v, g.v)
        sub_t1 = sub_corners(end, g.u, g.u, g.v, g.v)
        s.sub_t0 = sub_t0.w00
        s.sub_t1 = sub_t1.w00
        s.sub_at = corners_at(sub_t0, sub_t1, g.t).w00
        s.root_dot = wp.dot(g.d, start.w00)
        s.sub_dot = wp.dot(g.d, sub_t0.w00)
        s.offset = offset(g.d, g.margin)
        s.clip = clip_corner(h[0], h[1], h[2], real(0.0))
        s.volume = vec4(f.b0, f.b1, f.b2, f.b3)
        s.restricted = restrict(f, g.t, g.x)
        s.volume_bound = f.bound
        s.normal_t0 = f.normal_t0
        s.normal_mid = f.normal_mid
        s.normal_t1 = f.normal_t1
        s.separation = separation
        s.separation_offset = separation_offset(f, separation, g.t, g.x)
        s.reach = restrict(reach_of(f, separation), g.t, g.x)
        hull = Hull()
        hull.c0 = h[0]
        hull.c1 = h[1]
        hull.c2 = h[2]
        hull.c3 = h[3]
        s.hull = hull_crossing(hull)
        s.zero = crossing(h[0], h[1], h[2])
        c_t = corners_at(start, end, g.t)
        c_x = corners_at(start, end, g.x)
        number = real(3 * g.facet[0] + 3 + g.facet[1])
        d_t = direction(number, c_t)
        d_x = direction(number, c_x)
        s.d_t = d_t
        s.d_x = d_x
        mixed = half * (wp.dot(d_t, c_x.w00) + wp.dot(d_x, c_t.w00))
        s.moving = vec3(wp.dot(d_t, c_t.w00), mixed, wp.dot(d_x, c_x.w00))
        s.clips[0] = clip(g.d, error + separation, g.t, start, end, n.patch.is_triangle)
        s.clips[1] = advance_volume(n.problem, real(0.0), real(1.0))
        for k in range(12):
            s.clips[2 + k] = clip_facet(start, end, separation, error, real(k), real(0.0), real(1.0), num_clips)
        out[i] = s

    return Options, Given, Found, probe


# ---- The reference, in any arithmetic --------------------------------------------------------------------------------

_SLACK, ENDS = 1.001, ("vertices_t0", "vertices_t1")  # the slack of steps 2 and 3


def extended(values: np.ndarray) -> np.ndarray:
    return np.asarray(values).astype(np.longdouble)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def permanent_cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sum of the magnitudes of the products of a cross product."""
    turned = [abs(a[..., i] * b[..., j]) + abs(a[..., j] * b[..., i]) for i, j in ((1, 2), (2, 0), (0, 1))]
    return np.stack(turned, axis=-1)


def blossom(b: list, parameters: tuple) -> np.ndarray:
    """Multilinear form of a polynomial in Bernstein form: one interpolation a parameter."""
    for s in parameters:
        b = [(1 - s) * low + s * high for low, high in pairwise(b)]
    return b[0]


class Sample:
    """Inputs, the kernel's outputs, and the exact quantities, all in one arithmetic; steps give their error and bound.

    Each of shape [n] or [n, components].
    """

    def __init__(self, kind: str, inputs: dict, out: np.ndarray, unit_roundoff: float, convert) -> None:
        self.u, self.u64 = (convert(np.array(u))[()] for u in (unit_roundoff, UNIT_ROUNDOFF[wp.float64]))
        self.constant = lambda x: convert(np.array(x))[()]
        self.found = lambda name: convert(plain(out[name]))
        self.d, self.margin, self.h, *points = (convert(inputs[x]) for x in ("d", "margin", "h", *ENDS))
        self.weights = [convert(inputs[name])[:, None] for name in ("u", "v", "t", "x")]
        unit, self.m = self.found("unit"), self.found("size")
        # (corner, side) as in kernels/pair/patch.py, from the definition of each pair kind
        self.corners = [[(p[:, i] - p[:, j]) / unit for i, j in (*CORNERS[kind], (0, 3))[:4]] for p in points]
        self.sides = [[(p[:, i] - p[:, j]) / unit for i, j in SIDES[kind]] for p in points]

    def error_bound(self, factor: float) -> np.ndarray:
        """E of a projection."""
        return self.constant(factor) * self.u * self.m

    def sub_corner(self, frame: int) -> np.ndarray:
        u, v, _, _ = self.weights
        w00, w01, w10, w11 = self.corners[frame]
        return (1 - u) * ((1 - v) * w00 + v * w01) + u * ((1 - v) * w10 + v * w11)

    def volume(self) -> list[np.ndarray]:
        """Bernstein coefficients of P·(Q×R)."""
        (p0, *_), (p1, *_) = self.corners
        n0, mixed, n1 = self.normals()
        inner = dot(p1, n0) + 2 * dot(p0, mixed), dot(p0, n1) + 2 * dot(p1, mixed)
        return [dot(p0, n0), *(x / 3 for x in inner), dot(p1, n1)]

    def normals(self) -> list[np.ndarray]:
        (q0, r0), (q1, r1) = self.sides
        return [cross(q0, r0), (cross(q0, r1) + cross(q1, r0)) / 2, cross(q1, r1)]

    def largest_sides(self) -> tuple[np.ndarray, np.ndarray]:
        return tuple(np.maximum(abs(a), abs(b)) for a, b in zip(*self.sides, strict=True))

    def restricted(self) -> list[np.ndarray]:
        t, x = (w[:, 0] for w in self.weights[2:])
        return [blossom(self.volume(), (t,) * (3 - k) + (x,) * k) for k in range(4)]

    def step_2_difference_and_normalisation(self):
        found = np.concatenate([self.found(name)[:, :12] for name in ("corners_t0", "corners_t1")], axis=1)
        exact = np.concatenate([*self.corners[0], *self.corners[1]], axis=1)
        return abs(found - exact), self.constant(_SLACK) * self.u * abs(found)

    def step_3_corner_of_a_sub_patch(self):
        error = [abs(self.found(f"sub_t{frame}") - self.sub_corner(frame)) for frame in range(2)]
        return np.concatenate(error, axis=1), np.concatenate([self.error_bound(5 * _SLACK)] * 2, axis=1)

    def step_4_projection_of_the_root(self):
        error = abs(self.found("root_dot") - dot(self.d, self.corners[0][0]))
        return error, dot(abs(self.d), self.error_bound(PROJECTION_ROOT))

    def step_4_projection_of_a_sub_patch(self):
        error = abs(self.found("sub_dot") - dot(self.d, self.sub_corner(0)))
        return error, dot(abs(self.d), self.error_bound(PROJECTION_PATCH))

    def step_6_offset(self):
        # what rounding took of the factor 1 + 8u
        exact = dot(abs(self.d), self.margin)
        return (1 + 8 * self.u) * exact - self.found("offset"), 8 * self.u * exact

    def step_7_time_of_a_clip(self):
        a, b, offset, _ = self.h.T
        falls = (a > offset) & (b <= offset)
        exact = (a - offset) / np.where(falls, a - b, 1)
        error = np.where(falls, self.found("clip") - (1 - 8 * self.u) * exact, 0)
        return error, np.where(falls, 8 * self.u * exact, 1)

    def step_8_corner_at_a_time(self):
        exact = blossom([self.sub_corner(0), self.sub_corner(1)], (self.weights[2],))
        return abs(self.found("sub_at") - exact), self.error_bound(8 * _SLACK)

    def step_9_volume(self):
        p = np.maximum(abs(self.corners[0][0]), abs(self.corners[1][0]))
        exact = np.stack(self.volume(), axis=1)
        bound = self.constant(13) * self.u64 * dot(p, permanent_cross(*self.largest_sides()))[:, None]
        return abs(self.found("volume") - exact), bound + (self.u - self.u64) * abs(exact).max(axis=1)[:, None]

    def step_9_volume_on_an_interval(self):
        error = abs(self.found("restricted") - np.stack(self.restricted(), axis=1))
        return error, np.stack([self.found("volume_bound")] * 4, axis=1)

    def step_9_normal(self):
        found = np.concatenate([self.found(f"normal_{at}") for at in ("t0", "mid", "t1")], axis=1)
        bound = (14 * self.u64 + self.u) * permanent_cross(*self.largest_sides())
        return abs(found - np.concatenate(self.normals(), axis=1)), np.concatenate([bound] * 3, axis=1)

    def _beyond(self, name: str, support: list[np.ndarray]):
        """The volume's magnitude beyond the separation may not be overestimated by more than the bound."""
        restricted = self.found("restricted")
        sign = np.where(restricted[:, 0] < 0, -1, 1)
        exact = np.stack([sign * f - o for f, o in zip(self.restricted(), support, strict=True)], axis=1)
        return sign[:, None] * restricted - self.found(name) - exact, np.stack([self.found("volume_bound")] * 4, axis=1)

    def _support(self, normals: list[np.ndarray]) -> list[np.ndarray]:
        a = [dot(self.found("separation"), abs(normal)) for normal in normals]
        return [a[0], (a[0] + 2 * a[1]) / 3, (2 * a[1] + a[2]) / 3, a[2]]

    def step_9_separation(self):
        t, x = self.weights[2:]
        normals = [blossom(self.normals(), (t,) * (2 - k) + (x,) * k) for k in range(3)]
        return self._beyond("separation_offset", self._support(normals))

    def step_9_reach(self):
        t, x = (w[:, 0] for w in self.weights[2:])
        of_step = self._support(self.normals())
        return self._beyond("reach", [blossom(of_step, (t,) * (3 - k) + (x,) * k) for k in range(4)])

    # The factor 1 - 12u covers eleven roundings between a crossing and a time; the functions measured here make fewer.
    def _first_crossing(self, last: int, found: np.ndarray):
        """Of the segments between control points from above 0 to 0 or below, as a fraction of all."""
        h, times = self.h.T, []
        for i, j in combinations(range(last + 1), 2):
            falls = (h[i] > 0) & (h[j] <= 0)
            times.append(i + (j - i) * np.where(falls, h[i] / np.where(falls, h[i] - h[j], 1), 5))
        exact = np.where(h[0] > 0, np.minimum.reduce(times), 9)
        fraction = np.where(exact < last + 1, exact / self.constant(last), 1)
        return np.where(exact < last + 1, found - fraction, 0), 12 * self.u * fraction

    def step_9_crossing_of_the_hull(self):
        return self._first_crossing(3, self.found("hull"))

    def step_10_crossing_of_a_facet(self):
        return self._first_crossing(2, self.found("zero"))

    def step_10_moving_facet(self):
        d_t, d_x = self.found("d_t"), self.found("d_x")
        w_t, w_x = (blossom([c[0] for c in self.corners], (y,)) for y in self.weights[2:])
        exact = [dot(d_t, w_t), (dot(d_t, w_x) + dot(d_x, w_t)) / 2, dot(d_x, w_x)]
        o_t, o_x = (dot(abs(d), self.error_bound(MOVING * PROJECTION_ROOT)) for d in (d_t, d_x))
        return abs(self.found("moving") - np.stack(exact, axis=1)), np.stack([o_t, (o_t + o_x) / 2, o_x], axis=1)


STEPS = [name for name in vars(Sample) if name.startswith("step_")]

# ---- The search ------------------------------------------------------------------------------------------------------


def plain(values: np.ndarray) -> np.ndarray:
    """A field as numbers; where nothing falls, the place at which it falls is no number."""
    values = structured_to_unstructured(values) if values.dtype.names else values
    return np.where(np.isfinite(values), values, 0.0)


def ratio_of(error: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """Largest error over its bound, per sample; an error where no bound is left counts as inf."""
    error, bound = (np.reshape(x, (len(error), -1)) for x in (error, bound))
    ratio = (error / np.where(bound > 0, bound, 1)).astype(np.float64)
    return np.where(bound > 0, ratio, np.where(error > 0, np.inf, 0.0)).max(axis=1)


def as_taken(inputs: dict, real: str) -> dict:
    """Inputs as the kernel sees them: what enters in the precision of the iteration is rounded to it."""
    taken = inputs | {name: inputs[name].astype(FLOATS[real]).astype(np.float64) for name in ("d", "margin", "h")}
    taken["t"], taken["x"] = np.sort([inputs["t"].astype(FLOATS[real]), inputs["x"].astype(FLOATS[real])], axis=0)
    return taken


def mutated(inputs: dict, real: str, rng: np.random.Generator) -> dict:
    """A child of each sample: a few numbers with mantissa bits turned, signs turned, or drawn anew."""
    n, bits, child = len(inputs["u"]), 52 if real == "float64" else 23, {}
    fresh = drawn(n, rng)
    for name, old in inputs.items():
        each = (n, *[1] * (old.ndim - 1))
        pick = rng.random(old.shape) < 2.0 ** -rng.integers(1, 6, each)
        if name in ("u", "v", "facet"):
            child[name] = np.where(rng.random(each) < 0.1, fresh[name], old)
            continue
        exponent = np.frexp(old)[1] - 1 - rng.integers(1, bits + 1, old.shape)
        turned = old + rng.choice([-1, 1], old.shape) * np.ldexp(1.0, exponent)
        if name not in ("t", "x", "margin"):
            turned = np.where(rng.random(old.shape) < 0.1, -old, turned)
        child[name] = np.where(pick, np.where(rng.random(old.shape) < 0.15, fresh[name], turned), old)
    return child | {name: np.clip(child[name], 0, 1) for name in ("t", "x")}


def evaluated(kind: str, inputs: dict, real: str, separation: float) -> np.ndarray:
    """What the kernel writes, by name; inputs that are not given are 0."""
    Options, Given, Found, probe = make_probe(REALS[real])
    options = Options()
    options.length_scale, options.tolerance, options.minimum_separation = 1.0, 1e-300, separation
    options.t_max = options.t_end = 1.0
    given = np.zeros(len(inputs["vertices_t0"]), dtype=Given.numpy_dtype())
    for field in given.dtype.names:
        given[field] = inputs.get(field, 0)
    x = [wp.array(inputs[name], dtype=wp.vec3d) for name in ENDS]
    out = wp.zeros(len(given), dtype=Found)
    wp.launch(probe, len(given), [KINDS[kind], *x, options, wp.array(given, dtype=Given)], outputs=[out])
    return out.numpy()


def searched(kind: str, real: str, *, samples: int, generations: int, seed: int) -> dict[str, float]:
    """The largest ratio of each step that the climb finds, judged in exact arithmetic."""
    rng = np.random.default_rng(seed)

    def ratios(inputs: dict, convert) -> np.ndarray:
        out, each = evaluated(kind, inputs, real, 0.125), len(inputs["u"]) // len(STEPS)
        found = []
        for k, name in enumerate(STEPS):
            own = slice(k * each, (k + 1) * each)
            given = {field: values[own] for field, values in inputs.items()}
            sample = Sample(kind, given, out[own], UNIT_ROUNDOFF[REALS[real]], convert)
            with np.errstate(all="ignore"):
                found.append(ratio_of(*getattr(sample, name)()))
        return np.concatenate(found)

    parents = as_taken(drawn(samples * len(STEPS), rng), real)
    best, half = ratios(parents, extended), samples // 2
    for generation in range(generations):
        child = as_taken(mutated(parents, real, rng), real)
        found = ratios(child, extended)
        for field, values in child.items():
            parents[field][found > best] = values[found > best]
        best = np.maximum(found, best)
        # row k has the samples of step k, from the worst to the best
        order = np.argsort(best.reshape(-1, samples)) + samples * np.arange(len(STEPS))[:, None]
        if generation % 10 == 9:
            # the worse half starts again from the better one
            for values in (*parents.values(), best):
                values[order[:, :half]] = values[order[:, -half:]]
    top = order[:, -6:].ravel()
    judged = ratios({field: values[top] for field, values in parents.items()}, exactly)
    return dict(zip(STEPS, judged.reshape(-1, 6).max(axis=1).tolist(), strict=True))


# Of these only what is too little counts, and they are rounded up.
_ABOVE = ("step_9_separation", "step_9_reach")


@pytest.mark.parametrize("real", REALS)
def test_bounds_hold_and_are_not_lazy(real, record_property):
    found = [searched(kind, real, samples=192, generations=24, seed=41) for kind in KINDS]
    largest = {name: max(ratios[name] for ratios in found) for name in STEPS}
    record_property("largest_ratio", largest)
    assert {name: x for name, x in largest.items() if not (x > 0.1 or name in _ABOVE) or x >= 1} == {}
    assert min(largest[name] for name in _ABOVE) > 0


# ---- The clips: every time that they report is certainly free --------------------------------------------------------

_CLIP_FAMILIES = ("random_colliding", "lattice", "slivers", "tiny_motion", "mixed_axis_scales", "one_ulp_neighbours")


every_kind, every_real = pytest.mark.parametrize("kind", KINDS), pytest.mark.parametrize("real", REALS)


def clip_times(kind: str, points: tuple, real: str, separation: float, **given) -> tuple[np.ndarray, np.ndarray]:
    """Times that each clip reports, and the normalised unit of each axis."""
    out = evaluated(kind, dict(zip(ENDS, points, strict=True)) | given, real, separation)
    return out["clips"].astype(np.float64), out["unit"]


@every_real
@every_kind
@pytest.mark.parametrize("separation", [0.0, 2.0**-10])
def test_clip_is_a_lower_bound(separation, kind, real):
    rng, clipped_some = np.random.default_rng(42), 0
    for family in _CLIP_FAMILIES:
        points = FAMILIES[family](kind, 60, rng)
        start, end = ([p[:, i] - p[:, j] for i, j in CORNERS[kind]] for p in points)
        t = rng.choice([0.0, 0.25, 0.5], 60)
        # a direction that separates at t in general, as the closest pair's does: the mean corner, and noise
        size = np.maximum(np.abs(start).max(axis=0), np.abs(end).max(axis=0)) + 1e-300
        d = np.mean(start, axis=0) * (1 - t[:, None]) + np.mean(end, axis=0) * t[:, None]
        d = (d / size + rng.normal(0, 0.1, d.shape)).astype(FLOATS[real]).astype(np.float64)
        times, unit = clip_times(kind, points, real, separation, d=d, t=t)
        exact_d, exact_unit, x0, x1 = (exactly(a) for a in (d, unit, *points))
        for i in np.flatnonzero(times[:, 0] > t):
            clipped_some += 1
            # corners are at most 1 in these units, so a separation of 8 says as much as any larger one
            beyond = sum(abs(exact_d[i]) * [min(rational(separation) / side, 8) for side in exact_unit[i]])
            for a, b in CORNERS[kind]:
                # linear in time, so both ends of [t, s] tell; at s itself d may just cease to separate
                w0, w1 = x0[i, a] - x0[i, b], x1[i, a] - x1[i, b]
                ends = rational(t[i]), rational(min(times[i, 0], 1.0))
                first, last = (sum(exact_d[i] * (w0 + s * (w1 - w0)) / exact_unit[i]) for s in ends)
                assert first > beyond and (last > beyond or (times[i, 0] < 2 and last == beyond))
    assert clipped_some > 60


# Powers of two by which the axes are scaled: exact, but products of such lengths underflow and overflow.
@every_real
@every_kind
@pytest.mark.parametrize(("separation", "scale"), [(0.0, 0), (2.0**-10, 0), (0.0, -900), (0.0, (700, -537, -530))])
def test_volume_and_facets_clip_no_contact(separation, scale, kind, real):
    rng, advanced = np.random.default_rng(43), 0
    for family in _CLIP_FAMILIES:
        points = [np.ldexp(p, scale) for p in FAMILIES[family](kind, 30, rng)]
        times = clip_times(kind, points, real, separation)[0][:, 1:]
        for truth, reported in zip(exact_tois(kind, *points, separation), times.tolist(), strict=True):
            # 2: certainly free to the end
            assert not any(truth.hit and (time >= 2 or truth.late(time)) for time in reported)
        advanced += np.array([(times[:, 0] > 0).sum(), (times[:, 1:].max(axis=1) > 0).sum()])
    assert advanced.min() > 40


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
    at = blossom([exactly(a), exactly(b)], (exactly(t)[:, None],))
    assert (exactly(lower) <= at).all() and (at <= exactly(upper)).all() and (lower < upper).sum() > n


def test_constants_cover_the_steps():
    # the sums of roundings that the docstring counts, in units of u
    for projection, roundings in ((PROJECTION_ROOT, 1), (PROJECTION_PATCH, 5)):
        assert projection > 1.001 * (roundings + 3) and MOVING * projection > 1.001 * (roundings + 3 + 3 + 1)
    assert VOLUME >= 13 + 9 and RESTRICTION > 1.001 * (1 + 9)
    # step 5: the absolute term is far below any rounding of a normalised number, and far above an underflow
    for real, tiny in TINY.items():
        assert np.finfo(FLOATS[real.__name__]).tiny * 2**20 < tiny < UNIT_ROUNDOFF[real] ** 2
