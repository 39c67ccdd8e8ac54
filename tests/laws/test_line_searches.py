"""What a line search leaves of the way is free, exactly; what parts or slides, and what nothing is near, goes whole."""

from fractions import Fraction

import numpy as np
import pytest
import warp as wp
from scenes import sheet as sheet_of
from slides import SLIDERS, slides_just_beyond, slides_of

import ccd_warp as ccd
from ccd_warp._engine.boxes import some_queries
from ccd_warp._engine.host.contact_step import ContactStep
from laws.asked import SEEDS, kinds_of, near_pairs, scene_of
from laws.calls import EVERY_PER, PRECISIONS
from laws.outputs import rows_of
from laws.scenes import pressed
from laws.truth import NAMES, PLANE, Pairs, PlaneTruth, distances_at, first_times, sizes

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
SAFETY = 0.9


def holds_of(scene, mesh, start, pairs):
    """How near each vertex was at the start to anything within its distance, as a vertex or as an end of an edge.

    As a share of each pair's distance and as a length, [V, 2].
    """
    holds = np.full((mesh.num_vertices, 2), np.inf)
    for kind, _, corners, distances in near_pairs(scene, start, start, pairs):
        if len(corners) and scene.options["start_gap_fraction"] == "hold":
            apart = distances_at(NAMES[kind], start[corners], start[corners], 0 * distances, scene.is_euclidean)
            is_near = apart <= distances
            holders = corners[:, :1] if kind in (0, 2) else corners
            share = np.divide(apart, distances, out=np.ones_like(apart), where=distances > 0)
            both = np.stack([share, apart], axis=1)
            np.minimum.at(holds, holders[is_near], both[is_near, None])
    return holds


def near_on_the_way(scene, start, end, pairs, holds, is_asked):
    """When pairs come nearer than they keep, of those that are asked for by their corners: (kind, *pair) to time."""
    found = {}
    for kind, of_kind, corners, distances in near_pairs(scene, start, end, pairs, holds):
        x, y, at = start[corners], end[corners], is_asked(corners)
        # the margin of what is held, and what a fraction of the gap loses in rounding
        lost = 1.2e-13 * (sizes(x, y) + np.abs(x).max(initial=0.0) / 8)
        if isinstance(scene.options["start_gap_fraction"], float):
            lost = 1e-3 * distances + 2.0**-16 * sizes(x, y)
        if at.any():
            is_held = np.isfinite(holds[corners, 0]).any(axis=1)  # also by a vertex that starts just at its distance
            is_held |= distances < scene.distance + pairs.radii(kind, of_kind)
            keep = np.where(is_held, distances - lost, distances)[at]
            times = first_times(NAMES[kind], x[at], y[at], np.maximum(keep, 0.0), scene.is_euclidean, 1.0)
            found |= {(kind, *pair): t for pair, t in zip(of_kind[at].tolist(), times, strict=True) if t.hit}
    return found


def enters(scene, mesh, start, end, pairs, vertex, plane):
    """Whether a vertex ends nearer to a plane than it keeps."""
    truth, fraction = PlaneTruth(mesh, start, end, vertex, plane), scene.options["start_gap_fraction"]
    distance = scene.distance + float(pairs.radii(PLANE, np.array([[vertex, plane]]))[0])
    if fraction is None:
        return truth.is_late(np.inf, distance, scene.is_euclidean, 1.0)
    share = 1 if fraction == "hold" else Fraction(fraction)
    keep = min(truth.f[0], Fraction(distance) * Fraction(truth.length(scene.is_euclidean)), share * max(truth.f[0], 0))
    return truth.f[1] < keep - (truth.terms + abs(keep)) / 2**30


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_left_of_the_way_is_free(seed):
    scene, mesh, start, end, pairs = scene_of(seed)
    options, holds = scene.without_end(), holds_of(scene, mesh, start, pairs)
    is_free = ~(mesh.static | mesh.kinematic)[mesh.vertex_body]
    shares = {"scene": 0 * mesh.vertex_body, "world": mesh.vertex_world, "body": mesh.vertex_body}
    steps = {name: ccd.mesh_ccd(mesh, start, end, precision=name, **options) for name in PRECISIONS}
    for n, per in enumerate(EVERY_PER):
        precision = PRECISIONS[(seed + n) % 2]
        result = ccd.line_search(mesh, start, end, per=per, safety=SAFETY, precision=precision, **options)
        left, fraction = result.vertices, result.vertex_fraction
        moved = (left != start).any(axis=1)
        by_itself = moved & is_free
        assert not near_on_the_way(scene, start, left, pairs, holds, lambda c, m=by_itself: m[c].any(axis=1))
        struck = near_on_the_way(
            scene, start, left, pairs, holds, lambda c, m=moved, i=by_itself: m[c].any(axis=1) & ~i[c].any(axis=1)
        )
        assert struck.keys() <= {*rows_of(result.struck)}
        for v, k in pairs.with_planes[by_itself[pairs.with_planes[:, 0]]].tolist() if PLANE in kinds_of(scene) else ():
            assert not enters(scene, mesh, start, left, pairs, v, k), (v, k)
        assert not moved[result.touching.vertices].any()
        # what is one is moved as one, to where its fraction says
        scale = np.abs([start, end]).max(initial=0.0)
        assert np.abs(left - start - fraction[:, None] * (end - start)).max(initial=0.0) <= 4e-16 * scale
        assert (fraction[~is_free] == 1).all() and result.fraction == fraction[is_free].min(initial=1.0)
        group = shares.get(per, np.arange(len(start)))
        assert all(len({*fraction[is_free & (group == g)].tolist()}) <= 1 for g in {*group.tolist()})
        # what goes less than its way has the contacts that say why, and nothing else has any
        held, is_short = result.shortened_by, is_free & (fraction < 1)
        shortened = {*group[held.vertices].ravel().tolist()}
        assert result.is_limited or {*group[is_short].tolist()} <= shortened  # else all of a world go by one fraction
        assert is_short[held.vertices].any(axis=1).all()
        if result.num_rounds == 2:
            assert (fraction[held.vertices] == SAFETY * held.toi[:, None]).any(axis=1).all()
        if (toi := steps[precision].toi) == np.inf:
            assert np.array_equal(left, end)
        elif toi > 0 and len(result.struck) == 0:  # it goes as far as the first contact allows, and no farther
            tois = toi, steps["float64"].toi  # as what is within a rounding of its distance is solved
            assert SAFETY * max(tois) >= fraction[is_free].min(initial=1.0)
            assert not {*tois}.isdisjoint(held.toi.tolist())
    whole = ccd.collision_free_step(mesh, start, end, precision=precision, **options)
    reached = near_on_the_way(scene, start, end, pairs, holds, lambda c: (start[c] != end[c]).any(axis=(1, 2)))
    assert not [key for key, time in reached.items() if time.late(whole)]


@pytest.mark.parametrize("seed", range(30))
def test_bodies_of_many_thicknesses_that_press_in_turn_come_no_closer_than_their_distances(seed):
    """No pair below its distance, or below what it was, but for rounding; of what is deep, the share that it has."""
    rng, scene = np.random.default_rng(seed), pressed(seed)
    mesh, start, way = scene.make()
    pairs, x, body, per = Pairs(mesh), start.copy(), mesh.vertex_body, EVERY_PER[seed % 4]
    pipeline = ccd.CollisionPipeline(mesh, max_pairs=1 << 14, max_contacts=1 << 12, **scene.without_end())
    for k in range(100):
        moving = mesh._is_free[body] & (body % 3 == k % 3)
        y = x + moving[:, None] * (way + (k % 8 == 0) * 1e-3 * scene.size * rng.standard_normal(x.shape))
        if k % 4 == 3:
            before, moved = (wp.array(p, dtype=wp.vec3d if mesh.dimension == 3 else wp.vec2d) for p in (x, y))
            flags = pipeline.launch_line_search(before, moved, per=per, num_rounds=8).flags
            assert not flags.numpy()[0] & int(ccd.LaunchFlag.PAIRS_OVERFLOW)
            x = moved.numpy().copy()
        else:
            x = pipeline.line_search(x, y, per=per).vertices
    share, length = holds_of(scene, mesh, start, pairs).min(axis=0, initial=1.0)
    length = min(length, scene.distance + 2.0 * (0.0 if mesh.radius is None else mesh.radius.min()))
    for kind, _, corners, distances in near_pairs(scene, start, x, pairs):
        if len(corners):
            apart = [
                distances_at(NAMES[kind], p[corners], p[corners], 0 * distances, scene.is_euclidean) for p in (start, x)
            ]
            lost = 1e-11 * (sizes(start[corners], x[corners]) + np.abs(x).max() / 8) + 1e-7 * distances
            kept = np.maximum(share * distances, np.minimum(length, distances))
            assert (apart[1] >= np.minimum(kept, apart[0]) - lost).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_what_touches_at_the_start_and_stops_is_listed(seed):
    """Every such pair, of which no vertex is told where to go; nothing else that does not touch on the way."""
    scene, mesh, start, end, _ = scene_of(seed)
    options = scene.without_end() | {"start_gap_fraction": None}
    on_the_way, at_start = (ccd.mesh_ccd(mesh, start, x, **options).contacts for x in (end, start))
    result = ccd.line_search(mesh, start, end, per=EVERY_PER[seed % 4], safety=SAFETY, **options)
    stays = (result.vertices == start).all(axis=1)[on_the_way.vertices].all(axis=1)
    is_told = mesh.kinematic[on_the_way.bodies].any(axis=1)
    stopped = {*rows_of(on_the_way[(on_the_way.toi == 0) & stays & ~is_told])} & {*rows_of(at_start)}
    assert stopped <= {*rows_of(result.touching)} <= {*rows_of(on_the_way)}


def columns_of(contacts):
    return [getattr(contacts, name).tolist() for name in ("kind", "primitives", "toi", "status", "gap")]


def contacts_with(chosen, pipeline, start, end, among=None):
    """The contacts with a chosen vertex, of a search of all or for those of some vertices."""
    contacts = pipeline._on_step(ContactStep, start, end, lambda step: step.of_vertices(among).contacts()).contacts
    return columns_of(contacts[chosen[contacts.vertices].any(axis=1)])


@pytest.mark.parametrize("seed", SEEDS)
def test_a_search_for_pairs_of_some_vertices_finds_all_of_them(seed, monkeypatch):
    scene, mesh, start, end, _ = scene_of(seed)
    chosen = np.random.default_rng(seed).random(mesh.num_vertices) < 0.2
    pipeline, searched = ccd.CollisionPipeline(mesh, **scene.options), []
    for most in (0.0, 1.0):  # as a share of all blocks: search all queries, and as few as it can
        monkeypatch.setattr(some_queries, "_MOST_BLOCKS", most)
        monkeypatch.setattr(some_queries, "_LEAST_BLOCKS", 0)
        result = ccd.line_search(mesh, start, end, per="vertex", safety=SAFETY, **scene.without_end())
        found = contacts_with(chosen, pipeline, start, end, among=chosen)
        searched.append([found, result.vertices.tolist(), columns_of(result.touching)])
    assert searched[0] == searched[1] and searched[0][0] == contacts_with(chosen, pipeline, start, end)


@pytest.mark.parametrize("seed", range(8))
def test_a_search_for_pairs_of_some_vertices_of_sheets_finds_all_of_them(seed, monkeypatch):
    """Boxes of many blocks, of which most are left out; on a lattice, where boxes often meet in a plane."""
    monkeypatch.setattr(some_queries, "_LEAST_BLOCKS", 0)
    rng, (sheet, faces) = np.random.default_rng(seed), sheet_of(32, size=32.0)
    mesh = ccd.CollisionMesh.from_arrays([(sheet, faces), (sheet + [*rng.integers(-3, 4, 2), 2], faces)])
    pipeline, start = (
        ccd.CollisionPipeline(mesh),
        mesh.vertices + [0, 0, 1] * rng.integers(0, 2, (mesh.num_vertices, 1)),
    )
    end = start + rng.choice(7, start.shape, p=[0.03, 0.03, 0.03, 0.82, 0.03, 0.03, 0.03]) - 3.0
    least = [len(contacts_with(np.ones(len(start), dtype=bool), pipeline, start, end)[0])]
    for _ in range(16):
        chosen = np.abs(start[:, :2] - rng.integers(-16, 16, 2)).max(axis=1) <= rng.integers(1, 5)
        found = contacts_with(chosen, pipeline, start, end, among=chosen)
        assert found == contacts_with(chosen, pipeline, start, end)
        least.append(len(found[0]))
    assert least[0] > sum(least[1:]) / 16 > 10


@pytest.mark.parametrize("count", [1000, pytest.param(12000, marks=pytest.mark.long)])
@pytest.mark.parametrize("norm", ["radius", "minimum_distance", "minimum_separation"])
@pytest.mark.parametrize("slider", SLIDERS)
def test_random_slides_and_partings_go_all_the_way_in_any_frame(slider, norm, count):
    """By searches on the host and by launches."""
    cases = {}, {"scale": 1e-3, "offset": 10.0}, {"scale": 1e3, "drifts": True}, {"offset": 10.0}, {"is_plane": True}
    for seed, case in enumerate(cases):
        pipeline, start, end = slides_of(seed, count, slider, norm, **case)
        launched = [wp.array(x.reshape(-1, 3), dtype=wp.vec3d, device="cpu") for x in (start, end)]
        assert not pipeline.launch_line_search(*launched, per="world").flags.numpy().any(), case
        for reached in (pipeline.line_search(start, end, per="world").vertices, launched[1].numpy()):
            assert (reached.reshape(end.shape) != end).any(axis=(1, 2)).sum() <= count // 10_000, case


@pytest.mark.parametrize("share", [2e-14, 1e-12])
@pytest.mark.parametrize("norm", ["radius", "minimum_distance"])
@pytest.mark.parametrize("slider", SLIDERS)
def test_steps_and_searches_alike_let_go_what_starts_a_rounding_beyond_its_distance(slider, norm, share):
    for pipeline, start, end in slides_just_beyond(1, 40, slider, norm, share):
        assert pipeline.collision_free_step(start, end) == 1.0
        assert pipeline.line_search(start, end).fraction == 1.0
