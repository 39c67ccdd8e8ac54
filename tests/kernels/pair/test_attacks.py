"""Attacks on steps 17 and 18 of `kernels/pair/rounding.py`: paths, times and points searched that make an error large.

Vertices are placed by the kernels, and functions of `arcs` and `corotating` go on with them, on arrays (`counted`). The
truth is in extended precision, eleven bits better, from the definition of the paths.
"""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp
from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.pair.rounding import ARC_MOTION, ARC_POINTS, FRAME, PLACE, PLACE_POSITION, SAGITTA
from ccd_warp.kernels.rigid import place_bodies as kernels
from counted import House, Rows

EDGES, UNIT = 1, 2.0**-53
VECTORS = ("omega", "pivot", "start", "velocity", "turning")


def unit_of(q):
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def turned(x, spin, angle):
    """x, turned about an axis by an angle, in whatever precision they have; and how that goes on from x."""
    k, a = spin / np.maximum(np.linalg.norm(spin, axis=1, keepdims=True), 1e-300), angle[:, None]
    across = np.cross(k, x)
    return np.sin(a) * across + 2 * np.sin(a / 2) ** 2 * np.cross(k, across)


def truth(body, x, t):
    """Where a vertex of a body is at a time, from the definition of its path."""
    b, x, t = {k: v.astype(np.longdouble) for k, v in body.items()}, x.astype(np.longdouble), t.astype(np.longdouble)
    theta = np.maximum(np.linalg.norm(b["omega"], axis=1), np.longdouble(1e-300))
    q = unit_of(b["rotation"])
    arm = x - b["pivot"]
    arm = arm + 2 * (q[:, 3:] * np.cross(q[:, :3], arm) + np.cross(q[:, :3], np.cross(q[:, :3], arm)))
    u, a = b["turning"] / theta[:, None], (theta * t)[:, None]
    swing = np.sin(a) * u + 2 * np.sin(a / 2) ** 2 * np.cross(b["omega"] / theta[:, None], u)
    return b["start"] + t[:, None] * b["velocity"] + swing + arm + turned(arm, b["omega"], theta * t)


def vector(v):
    return np.asarray(v).T.view(Rows)


def extended(v):
    return np.asarray(v).T.astype(np.longdouble)


def on_arc(ends, spin, t):
    """A point at a time of the slice between its ends, which are placed already."""
    a, b, v = (x.astype(np.longdouble) for x in ends[:3])
    spin, t = extended(spin), t.astype(np.longdouble)
    theta = np.maximum(np.linalg.norm(spin, axis=1), np.longdouble(1e-300))
    f1 = np.sin(theta * t) / theta - t * np.sin(theta) / theta
    f2 = 2 * (np.sin(theta * t / 2) ** 2 - t * np.sin(theta / 2) ** 2) / theta**2
    return a + t[:, None] * (b - a) + f1[:, None] * v + f2[:, None] * np.cross(spin, v)


@cache
def functions(norm):
    house = House(dtype=np.float64)
    return [house.load(f"pair.{name}", norm=Norm(norm)) for name in ("arcs", "corotating")]


def placed(body, x, t0, t1):
    """Both ends of a slice, the velocity that turns and the slack of a vertex of each body, from the kernels."""
    n = len(x)
    array = lambda v, dtype=wp.vec3d: wp.array(v, dtype=dtype, device="cpu")  # noqa: E731
    empty = lambda dtype: wp.empty(n, dtype=dtype, device="cpu")  # noqa: E731
    paths, ends = kernels.BodyPaths(), kernels.BodyEnds()
    paths.is_rigid, paths.excess = array(np.ones(n), wp.int32), array(np.zeros(n), wp.float64)
    paths.rotation = array(body["rotation"], wp.vec4d)
    for name in VECTORS:
        setattr(paths, name, array(body[name]))
    for name, kind in kernels.BodyEnds.cls.__annotations__.items():
        setattr(ends, name, empty(kind.dtype))
    times = [array(t, wp.float64) for t in (t0, t1)]
    wp.launch(kernels.place_bodies, n, inputs=[0, *times, paths], outputs=[ends], device="cpu")
    no_radius = wp.empty(0, dtype=wp.float64, device="cpu")
    out = [empty(kind) for kind in (wp.vec3d, wp.vec3d, wp.vec3d, *[wp.float64] * 3)]
    inputs = [0, *times, array(np.arange(n), wp.int32), paths, ends, array(x), array(x), no_radius, no_radius]
    wp.launch(kernels.place_vertices, n, inputs=inputs, outputs=out, device="cpu")
    return [a.numpy() for a in out[:4]]


def drawn(n, rng):
    """Two bodies that mostly turn alike, a vertex of the first and two of the second, a slice and a window in it."""

    def vectors(low, high, kept=1.0):
        v = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(low, high, (n, 1)) * (rng.random((n, 1)) < kept)
        return v * np.where(rng.random((n, 3)) < 0.2, 1e-3, 1)

    spans = {
        "omega": (-3, 1.2),
        "pivot": (-3, 2, 0.6),
        "start": (-3, 3),
        "velocity": (-3, 2, 0.6),
        "turning": (-3, 2, 0.5),
    }
    given = {}
    for body in "ab":
        given |= {f"{name}_{body}": vectors(*span) for name, span in spans.items()}
        given[f"rotation_{body}"] = unit_of(rng.normal(size=(n, 4)))
    for name, by in (("omega", 0.1), ("start", 0.01)):
        given[f"{name}_b"] = np.where(
            rng.random((n, 1)) < 0.7, given[f"{name}_a"] * (1 + by * rng.normal(size=(n, 3))), given[f"{name}_b"]
        )
    return given | {f"x{k}": vectors(-3, 2) for k in range(3)} | {f"t{k}": rng.random(n) for k in range(4)}


def ratios(given, norm):
    """What is used of the allowances: of a vertex, of the difference of two on arcs, and in the frame of a body."""
    a, b = ({name: given[f"{name}_{body}"] for name in (*VECTORS, "rotation")} for body in "ab")
    for body in (a, b):  # what turns with a body is across its axis
        along = (body["turning"] * body["omega"]).sum(1) / np.maximum((body["omega"] ** 2).sum(1), 1e-300)
        body["turning"] = body["turning"] - along[:, None] * body["omega"]
    first, last = np.sort([given["t0"], given["t1"]], axis=0)
    most = np.maximum(*(np.linalg.norm(body["omega"], axis=1) for body in (a, b)))
    last = np.minimum(last, first + 0.333 / np.maximum(most, 1e-9)) + 1e-9
    ends = [placed(body, given[x], first, last) for body, x in ((a, "x0"), (b, "x1"), (b, "x2"))]
    of = zip(ends, (a, b, b), ("x0", "x1", "x2"), strict=True)
    vertex = np.maximum.reduce(
        [np.linalg.norm(e[0] - truth(body, given[x], first), axis=1) / e[3] for e, body, x in of]
    )
    arcs, corotating = functions(norm)
    points = [SimpleNamespace(**{f"p{k}": vector(ends[j][i]) for k, j in enumerate((0, 0, 1, 2))}) for i in (0, 1)]
    spins = {
        f"spin_{name}": vector((last - first)[:, None] * body["omega"]) for name, body in zip("ab", (a, b), strict=True)
    }
    turns = SimpleNamespace(**{f"v{k}": vector(ends[j][2]) for k, j in enumerate((0, 0, 1, 2))}, **spins)
    turns.slack = ends[0][3] + np.maximum(ends[1][3], ends[2][3])
    amplitude = arcs.amplitude(EDGES, turns)
    begin, end = np.sort([given["t2"], given["t3"]], axis=0)
    at = [arcs.points_at(EDGES, *points, turns, t) for t in (begin, end)]
    size = (lambda v: np.linalg.norm(v, axis=1)) if norm == "arc_ball" else lambda v: abs(v).max(axis=1)
    exact = [on_arc(e, spins[f"spin_{name}"], end) for e, name in zip(ends, "abb", strict=True)]
    of_arcs = size(extended(at[1].p0) - extended(at[1].p2) - (exact[0] - exact[1]))
    allowed = arcs.error_of(*points, 0.0, amplitude)
    window = corotating.corotating_window(EDGES, *points, turns, *at, begin, end - begin)
    length = last.astype(np.longdouble) - first
    corner = truth(a, given["x0"], first + length * end) - truth(b, given["x2"], first + length * end)
    spin = -(b["omega"].astype(np.longdouble) * length[:, None])
    corner = corner + turned(corner, spin, np.linalg.norm(spin, axis=1) * (end - begin))
    frame = size(extended(window.at_end.p0) - extended(at[0].p3) - corner) / (allowed + turns.slack + window.error)
    across = [np.linalg.norm(extended(x), axis=1) for x in (*spins.values(), turns.v0, turns.v2, turns.v3)]
    sagitta = (
        (across[0] * across[2] + across[1] * np.maximum(across[3], across[4]))
        * (end - begin).astype(np.longdouble) ** 2
        / 8
    )
    used = 1 + (1 - arcs.sagitta(amplitude, end - begin).x / np.maximum(sagitta, 1e-200)) / (SAGITTA * UNIT)
    return {"vertex": vertex, "arcs": of_arcs / allowed, "frame": frame, "sagitta": np.where(sagitta > 1e-150, used, 0)}


def climbed(name, norm, n, generations, seed=1):
    """The largest of one ratio that a climb finds."""
    rng = np.random.default_rng(seed)
    parents = drawn(n, rng)
    if name == "far vertex":  # beside whose position all else is small
        parents |= {f"start_{body}": 1e5 * parents[f"start_{body}"] for body in "ab"}
        name = "vertex"
    best = ratios(parents, norm)[name]
    for generation in range(generations):
        by = 10.0 ** rng.uniform(-9, -0.3, n)
        child = {k: v * (1 + rng.normal(size=v.shape) * by.reshape(n, *[1] * (v.ndim - 1))) for k, v in parents.items()}
        child |= {k: unit_of(v) for k, v in child.items() if k.startswith("rotation")}
        child |= {f"t{k}": np.clip(child[f"t{k}"], 0, 1) for k in range(4)}
        found = ratios(child, norm)[name]
        better = found > best
        best = np.where(better, found, best)
        for k, v in parents.items():
            v[better] = child[k][better]
        if generation % 10 == 9:  # the worse half starts again from the better one
            order = np.argsort(best)
            for v in (*parents.values(), best):
                v[order[: n // 2]] = v[order[n // 2 :]]
    return float(best.max())


# What the climb finds at least, so that a bound that grows is seen, and at most.
@pytest.mark.parametrize(("n", "generations"), [(100, 20), pytest.param(2000, 300, marks=pytest.mark.long)])
@pytest.mark.parametrize(
    ("name", "norm", "least", "most", "constants"),
    [
        ("vertex", "arc_ball", 0.08, 0.3, (PLACE, PLACE_POSITION)),
        ("far vertex", "arc_ball", 0.1, 0.25, (PLACE_POSITION,)),
        ("arcs", "arc_box", 0.15, 1, (ARC_POINTS, ARC_MOTION)),
        ("arcs", "arc_ball", 0.15, 1, (ARC_POINTS, ARC_MOTION)),
        ("frame", "arc_box", 0.01, 0.3, (FRAME,)),
        ("frame", "arc_ball", 0.01, 0.3, (FRAME,)),
        ("sagitta", "arc_ball", 0.03, 1, (SAGITTA,)),
    ],
)
def test_error_is_within_what_the_constants_allow_and_these_are_not_lazy(
    name, norm, least, most, constants, n, generations, record_property
):
    found = climbed(name, norm, n, generations)
    record_property("used", found)
    assert least < found < most, constants
