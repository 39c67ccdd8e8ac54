"""Random slides and partings: a slider that keeps its height above a ground, or gains some, in frames turned at random.

The ground is a sheet of eight faces below the plane z = 0, which it touches: flat, or falling on one side of its middle
line or on both, or on all sides of its middle; or a valley along that line. What slides, a particle, a segment or a
triangle, has its lowest vertices at a height h, all of them above what touches the plane, so no pair is nearer than h
at any time, while something is at h from the start. Half of the segments and triangles have a side that is parallel to
an edge of the ground.
"""

import numpy as np

import ccd_warp as ccd

FACES = np.array([f for i in (0, 1, 3, 4) for f in ([i, i + 3, i + 1], [i + 1, i + 3, i + 4])])
GROUND = 9  # its vertices
FLAT, FALLING, RIDGE, APEX, VALLEY = range(5)
SLIDERS = {"particle": 1, "segment": 2, "triangle": 3}


def _ground(rng, count, kind):
    """Vertices [n, 9, 3], and the normal of the side beyond the middle line [n, 3]."""
    v = np.zeros((count, 3, 3, 3))
    v[..., 0], v[..., 1] = np.arange(-1, 2)[:, None], np.arange(-1, 2)
    jitter = rng.uniform(-0.3, 0.3, (count, 3, 3, 2)) * rng.choice([0, 1], (count, 1, 1, 1))
    jitter[:, 1, :, 0] = 0
    jitter[kind == APEX, 1, 1] = 0
    v[..., :2] += jitter
    angle = np.where(rng.random(count) < 0.3, 10.0 ** -rng.uniform(0, 12, count), rng.uniform(0.05, 1.3, count))
    angle = np.where(kind == RIDGE, rng.uniform(0.1, 1.3, count), angle) * np.where(kind == VALLEY, 1, -1)
    angle = np.where(kind == VALLEY, np.maximum(angle, 0.05), np.where((kind == FLAT) | (kind == APEX), 0, angle))
    v[..., 2] += np.tan(angle)[:, None, None] * np.maximum(v[..., 0], 0)
    v[..., 2] += (kind == RIDGE)[:, None, None] * (np.tan(angle)[:, None, None] * np.maximum(-v[..., 0], 0))
    lower = rng.uniform(0.05, 1, (count, 3, 3))
    lower[:, 1, 1] = 0
    v[..., 2] -= (kind == APEX)[:, None, None] * lower
    return v.reshape(count, 9, 3), np.stack([-np.sin(angle), 0 * angle, np.cos(angle)], -1)


def drawn_slides(rng, count, slider, distance, kinds):
    """Start and end of ``count`` worlds, [n, 9 + m, 3] each."""
    m, every = SLIDERS[slider], np.arange(count)
    kind = rng.choice(kinds, count)
    ground, normal = _ground(rng, count, kind)
    height = distance * np.where(rng.random(count) < 0.3, 1.0, 10.0 ** -rng.uniform(0, 6, count))
    # the shape: a triangle about its centre, or what is less
    turn = rng.uniform(0, 2 * np.pi, (count, 1)) + np.arange(m) * (2 * np.pi / m) + rng.uniform(-0.9, 0.9, (count, m))
    shape = np.stack([np.cos(turn), np.sin(turn)], -1) * rng.uniform(0.2, 1, (count, m, 1))
    if m > 1:
        is_parallel = rng.random(count) < 0.5
        face, k = FACES[rng.integers(0, 4, count)], rng.integers(0, 3, count)
        edge = (ground[every, face[every, k]] - ground[every, face[every, (k + 1) % 3]])[:, :2]
        edge = np.where(np.isin(kind, [RIDGE, APEX])[:, None], [0, 1], edge)
        shape[is_parallel, 1] = shape[is_parallel, 0] + (edge * rng.uniform(0.3, 2, (count, 1)))[is_parallel]
        shape -= np.where(rng.random((count, 1, 1)) < 0.5, shape.mean(1, keepdims=True), 0)
    over = np.isin(kind, [RIDGE, APEX])
    low, high = shape.min(1), shape.max(1)
    half = np.where(over[:, None], [0.65, 0.65], [0.28, 0.65])
    fits = np.minimum(1, half / np.maximum((high - low) / 2, 1e-9)).min(1)
    shape *= (fits * 10.0 ** -rng.uniform(0, 1.5, count))[:, None, None]
    low, high = shape.min(1), shape.max(1)
    centre = np.where(over[:, None], 0, [-0.35, 0]) + (half - (high - low) / 2) * rng.uniform(-1, 1, (count, 2))
    weights = rng.dirichlet(np.ones(m), count)
    on_top = -(weights[..., None] * shape).sum(1)  # a point of the shape over the ridge or the apex
    on_top[:, 1] += (kind == RIDGE) * rng.uniform(-0.4, 0.4, count)
    p = np.zeros((count, m, 3))
    p[..., :2] = shape + np.where(over[:, None], on_top, centre - (low + high) / 2)[:, None]
    tilt = rng.uniform(0, 0.5, (count, m)) * (rng.random((count, m)) < 0.3) * ~over[:, None]
    p[..., 2] = height[:, None] + tilt - tilt.min(1, keepdims=True)
    motion = np.zeros((count, m, 3))
    a = rng.uniform(0, 2 * np.pi, count)
    length = 10.0 ** -rng.uniform(-0.4, 3, count)
    motion[..., 0], motion[..., 1] = (length * np.cos(a))[:, None], (length * np.sin(a))[:, None]
    is_valley = kind == VALLEY
    along = is_valley & (rng.random(count) < 0.5)
    motion[along, :, 0] = 0
    motion[is_valley, :, 0] = -np.abs(motion[is_valley, :, 0])
    deforms = ~is_valley & (rng.random(count) < 0.3)
    motion[deforms, :, :2] += (0.3 * length[:, None, None] * rng.normal(size=(count, m, 2)))[deforms]
    parts = rng.random(count) < 0.3
    rise = rng.uniform(0, 1, (count, m)) * (10.0 ** -rng.uniform(0, 12, (count, 1))) * length[:, None]
    rise = np.where(deforms[:, None], rise, rise[:, :1])
    motion[parts, :, 2] += rise[parts]
    # in a valley it starts as far from the other side, or farther
    lack = height - (p * normal[:, None]).sum(-1).min(1)
    p[..., 0] -= (is_valley * np.maximum(lack, 0) / np.maximum(-normal[:, 0], 0.04))[:, None]
    start = np.concatenate([ground, p], 1)
    end = start.copy()
    end[:, GROUND:] += motion
    return start, end


def slides_just_beyond(seed, count, slider, norm, share):
    """Pipeline, start and end of slides, whose nearest pair starts by a share of its distance beyond it."""
    rng = np.random.default_rng(seed)
    starts, ends = drawn_slides(rng, count, slider, 0.02, [FLAT, FALLING] if slider == "particle" else range(4))
    turn = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    for start, end in zip(starts @ turn, ends @ turn, strict=True):
        bodies = [(start[:GROUND], FACES), (start[GROUND:], *_slider(slider))]
        form = {"static": [0], "self_collision": False, "codimensional_points": slider == "particle"}
        mesh = ccd.CollisionMesh.from_arrays(bodies, **form)
        distance = ccd.find_proximity(mesh, start, 0.5).distance.min() * (1 - share)
        options = {norm: distance}
        if norm == "radius":
            mesh, options = ccd.CollisionMesh.from_arrays(bodies, **form, radius=distance / 2), {}
        yield ccd.CollisionPipeline(mesh, device="cpu", **options), start, end


def _slider(slider):
    """The primitives of what slides, of which there are one each."""
    none = np.zeros((0, 3), dtype=int)
    return {"particle": (none,), "segment": (none, [[0, 1]]), "triangle": ([[0, 1, 2]],)}[slider]


def slides_of(seed, count, slider, norm, scale=1.0, *, distance=0.02, drifts=False, offset=0.0, is_plane=False):
    """Pipeline, start and end of slides; ``norm`` is the option that says the distance, ``drifts`` moves the ground.

    With ``is_plane`` the ground is a half-space, one for all worlds, out of which half of what parts rises.
    """
    rng, options = np.random.default_rng(seed), {}
    # a particle stands on no ridge; and the nearest points of a box are not above each other, but within a face
    kinds = [FLAT, FALLING, VALLEY] if slider == "particle" or norm == "minimum_separation" else range(5)
    start, end = drawn_slides(rng, count, slider, distance, [FLAT] if is_plane else kinds)
    if drifts:
        end += rng.normal(size=(count, 1, 3)) * rng.choice([0, 1e-3, 1], (count, 1, 1))
    if is_plane:
        rises = (rng.random(count) < 0.5) & ((end - start)[:, GROUND:, 2].min(axis=1) > 1e-6)
        start[rises, GROUND:, 2] -= 2 * distance
        end[rises, GROUND:, 2] -= 2 * distance
    turn = np.linalg.qr(rng.normal(size=(1 if is_plane else count, 3, 3)))[0]
    start, end = (scale * (x @ turn) + offset for x in (start, end))
    bodies, radius = [(start[0, :GROUND], FACES), (start[0, GROUND:], *_slider(slider))], scale * distance / 2
    if is_plane:  # which has no radius
        bodies[0], radius = ccd.HalfSpace(np.full(3, offset), turn[0, 2]), 2 * radius
        start, end = start[:, GROUND:], end[:, GROUND:]
    if norm != "radius":
        options[norm] = distance * (scale if norm == "minimum_distance" else 1.0)
    mesh = ccd.CollisionMesh.from_arrays(
        bodies,
        static=[] if drifts or is_plane else [0],
        self_collision=False,
        codimensional_points=slider == "particle",
        radius=radius if norm == "radius" else None,
    ).replicate(count)
    if norm == "minimum_separation":
        options["length_scale"] = scale
    options |= {"max_pairs": 100 * count, "max_contacts": 50 * count}
    return ccd.CollisionPipeline(mesh, device="cpu", **options), start, end
