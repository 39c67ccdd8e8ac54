"""What options and filters make of a step, by the mesh functions and by `launch`: each is seen to have its effect."""

import numpy as np
import pytest
import trimesh
from exact import exact_tois
from launches import CAPACITIES, check_same, on_device
from oracles import corners_of, exact_contacts
from scenes import FACE, crowd, sheet, single, soup, stacked

import ccd_warp as ccd

SOLVERS = {ccd.PairKind.VERTEX_FACE: ccd.vertex_face_ccd, ccd.PairKind.EDGE_EDGE: ccd.edge_edge_ccd}


def solved(mesh, start, end, device, **options):
    """The result of `mesh_ccd`, once `launch` and `collision_free_step` have said the same."""
    options = {"length_scale": 1.0, "device": device} | options
    result = ccd.mesh_ccd(mesh, start, end, **options)
    pipeline = ccd.CollisionPipeline(mesh, **options, **CAPACITIES)
    check_same(pipeline.launch(on_device(start, device), on_device(end, device)), result)
    step = ccd.collision_free_step(mesh, start, end, **options)
    # pairs that are free up to its bound may be left out, so the step may be larger by the tolerance of a toi
    assert min(result.toi, 1.0) - 1e-6 <= step <= min(result.toi, 1.0)
    return result


def rows(contacts):
    """Contacts as a dictionary from kind and primitives to toi."""
    keys = np.column_stack([contacts.kind, contacts.primitives]).tolist()
    return {tuple(key): toi for key, toi in zip(keys, contacts.toi.tolist(), strict=True)}


def check_against_pairs(mesh, start, end, result, **options):
    """Each contact has the toi of its pair alone; of what is no contact and may touch, exact arithmetic says no."""
    candidates = ccd.find_candidates(mesh, start, end)
    found = rows(result.contacts)
    for kind, pairs in zip(SOLVERS, (candidates.vertex_face, candidates.edge_edge), strict=True):
        name = kind.name.lower().replace("_", "-")
        ours = result.contacts.kind == kind
        corners = corners_of(mesh, kind, result.contacts.primitives[ours])
        alone = SOLVERS[kind](start[corners], end[corners], length_scale=1.0, **options)
        np.testing.assert_array_equal(result.contacts.toi[ours], alone.toi)
        exact = exact_tois(name, start[corners], end[corners])
        assert not any(e.late(float(toi)) for e, toi in zip(exact, result.contacts.toi[ours], strict=True))
        others = np.array([pair for pair in pairs.tolist() if (int(kind), *pair) not in found]).reshape(-1, 2)
        corners = corners_of(mesh, kind, others)
        assert not any(e.hit for e in exact_tois(name, start[corners], end[corners]))


# --- method ---


@pytest.mark.parametrize("seed", range(2))
def test_bisection_of_a_crowd(device, precision, seed):
    mesh, start, end = crowd(np.random.default_rng(seed), 60, 0.2)
    options = {"method": "bisection", "tolerance": 1e-4, "precision": precision}
    result = solved(mesh, start, end, device, **options)
    check_against_pairs(mesh, start, end, result, **options)
    clipped = solved(mesh, start, end, device, **options | {"method": "clipping"})
    assert len(result.contacts) > 20 and result.contacts.toi.tobytes() != clipped.contacts.toi.tobytes()
    # both are early by what the tolerance allows at the speeds of the scene, about one
    assert result.toi == pytest.approx(clipped.toi, abs=1e-2)


def test_bisection_that_is_cut_short_is_early_and_says_so(device):
    mesh, start, end = crowd(np.random.default_rng(2), 60, 0.2)
    whole = solved(mesh, start, end, device, method="bisection")
    cut = solved(mesh, start, end, device, method="bisection", max_iterations=20)
    assert (cut.contacts.status == ccd.CCDStatus.ITERATION_LIMIT).any()
    early, late = rows(cut.contacts), rows(whole.contacts)
    assert early.keys() >= late.keys() and all(early[key] <= late[key] for key in late)
    assert sum(early[key] for key in late) < sum(late.values())


# --- start_gap_fraction ---


# Where faces stay parallel, bisection gets to its limit of iterations at a tolerance much finer.
@pytest.mark.parametrize(("method", "tolerance"), [("clipping", 1e-6), ("bisection", 1e-2)])
def test_body_closer_than_the_separation_comes_closer_by_the_fraction(device, precision, method, tolerance):
    mesh, start = stacked(0.0, 0.125)
    end = start - [0, 0, 1.0] * (mesh.vertex_body == 1)[:, None]
    options = {"minimum_separation": 0.5, "precision": precision, "method": method, "tolerance": tolerance}
    assert solved(mesh, start, end, device, **options).toi == 0.0
    fraction = options | {"start_gap_fraction": 0.25}
    # it falls by 1 a step, and a quarter of the gap is left; float32 lowers that share by a rounding
    accuracy = 2 * tolerance if precision == "float64" else max(2 * tolerance, 1e-5)
    assert solved(mesh, start, end, device, **fraction).toi == pytest.approx(0.75 * 0.125, abs=accuracy)


def test_body_that_starts_farther_away_keeps_the_whole_separation(device, precision):
    mesh, start = stacked(0.0, 4.0)
    end = start - [0, 0, 4.0] * (mesh.vertex_body == 1)[:, None]
    options = {"minimum_separation": 0.5, "start_gap_fraction": 0.25, "precision": precision}
    assert solved(mesh, start, end, device, **options).toi == pytest.approx(3.5 / 4.0, abs=1e-5)


def test_fraction_of_the_start_gap_in_a_crowd(device):
    mesh, start, end = crowd(np.random.default_rng(3), 60, 0.2)
    options = {"minimum_separation": 0.05, "start_gap_fraction": 0.5}
    result = solved(mesh, start, end, device, **options)
    check_against_pairs(mesh, start, end, result, **options)
    touching, fraction, separated = (
        rows(r.contacts)
        for r in (solved(mesh, start, end, device), result, solved(mesh, start, end, device, minimum_separation=0.05))
    )
    assert touching.keys() < fraction.keys() < separated.keys()
    assert all(separated[key] <= fraction[key] for key in fraction)
    assert all(fraction[key] <= touching[key] for key in touching)
    assert sum(separated[key] == 0 < fraction[key] for key in fraction) > 20


# --- filters ---


def without(contacts, is_left_out):
    """Contacts but those that a filter leaves out, of which there are some."""
    kept = {key: toi for key, toi in rows(contacts).items() if not is_left_out(*key)}
    assert 0 < len(kept) < len(contacts)
    return kept


def test_pair_of_bodies_that_may_not_collide(device):
    rng = np.random.default_rng(6)
    bodies = [soup(rng, n, 0.3) for n in (30, 20, 25)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=[False, True, False])
    start = mesh.vertices
    end = start + 0.3 * rng.standard_normal(start.shape)
    every = solved(mesh, start, end, device)
    first = int(np.argmin(every.contacts.toi))
    corners = corners_of(mesh, every.contacts.kind[first], every.contacts.primitives[first : first + 1])
    pair = set(mesh.vertex_body[corners[0]].tolist())
    assert len(pair) == 2
    allowed = np.ones((3, 3), dtype=bool)
    allowed[tuple(pair)] = allowed[tuple(pair)[::-1]] = False
    filtered = ccd.CollisionMesh.from_arrays(bodies, self_collision=[False, True, False], body_pairs=allowed)
    result = solved(filtered, start, end, device)

    def is_left_out(kind, *primitives):
        return set(mesh.vertex_body[corners_of(mesh, kind, [primitives])[0]].tolist()) == pair

    assert rows(result.contacts) == without(every.contacts, is_left_out)
    assert result.toi > every.toi


@pytest.mark.parametrize("rings", [2, 3])
def test_sheet_that_crumples_without_its_neighbours(device, rings):
    vertices, faces = sheet(8)
    mesh = single(vertices, faces)
    end = vertices + 0.3 * np.random.default_rng(7).standard_normal(vertices.shape)
    every = solved(mesh, vertices, end, device)
    joined = np.eye(len(vertices), dtype=int)
    joined[mesh.edges[:, 0], mesh.edges[:, 1]] = joined[mesh.edges[:, 1], mesh.edges[:, 0]] = 1
    near = np.linalg.matrix_power(joined, rings - 1) > 0

    def is_left_out(kind, *primitives):
        corners = corners_of(mesh, kind, [primitives])[0]
        split = 1 if kind == ccd.PairKind.VERTEX_FACE else 2
        return near[np.ix_(corners[:split], corners[split:])].any()

    filtered = ccd.CollisionMesh.from_arrays([(vertices, faces)], exclusion_rings=rings)
    result = solved(filtered, vertices, end, device)
    assert rows(result.contacts) == without(every.contacts, is_left_out)
    assert result.toi > every.toi


# --- line searches ---


def searched(mesh, start, wished, device, per, **options):
    """End positions of `line_search` and of `launch_line_search`, both of which are free by exact arithmetic."""
    options = {"length_scale": 1.0, "device": device} | options
    on_host = ccd.line_search(mesh, start, wished, per=per, **options).vertices
    vertices_t0, vertices_t1 = on_device(start, device), on_device(wished, device)
    pipeline = ccd.CollisionPipeline(mesh, **options, **CAPACITIES)
    pipeline.launch_line_search(vertices_t0, vertices_t1, per=per)
    ends = on_host, vertices_t1.numpy()
    assert not any(exact_contacts(mesh, start, end) for end in ends)
    return ends


@pytest.mark.parametrize("per", ["scene", "world", "body", "vertex"])
@pytest.mark.parametrize("seed", range(2))
def test_line_search_by_bisection(device, per, seed):
    rng = np.random.default_rng(seed)
    mesh = ccd.CollisionMesh.from_arrays([(rng.uniform(-1, 1, (3, 3)), FACE) for _ in range(6)])
    start, wished = mesh.vertices, mesh.vertices + rng.uniform(-1, 1, mesh.vertices.shape)
    options = {"tolerance": 1e-4}
    bisected = searched(mesh, start, wished, device, per, method="bisection", **options)
    clipped = searched(mesh, start, wished, device, per, **options)
    for ours, theirs in zip(bisected, clipped, strict=True):
        assert (ours != start).any() and (ours != wished).any() and (ours != theirs).any()
        # both are early by what the tolerance allows at the speeds of the scene, about one
        np.testing.assert_allclose(ours, theirs, atol=1e-2)


@pytest.mark.parametrize("per", ["scene", "world", "body", "vertex"])
def test_line_search_from_a_start_closer_than_the_separation(device, precision, per):
    mesh, start = stacked(0.0, 0.125)
    wished = start - [0, 0, 1.0] * (mesh.vertex_body == 1)[:, None]
    options = {"minimum_separation": 0.5, "precision": precision}
    for end in searched(mesh, start, wished, device, per, **options):
        assert end[3:].max() == start[3:].max() if per == "vertex" else (end == start).all()
    for end in searched(mesh, start, wished, device, per, start_gap_fraction=0.25, **options):
        # a quarter of the gap is left, less the safety of 0.9
        assert (start - end)[3:, 2].min() == pytest.approx(0.9 * 0.75 * 0.125, abs=1e-5)


# --- the unit of lengths, and counts ---


def falling_by(height):
    """A triangle that falls on another from one above it: mesh, start and end positions, 2.1 long at the start."""
    mesh, start = stacked(0.0, 1.0)
    return mesh, start, start - [0, 0, height] * (mesh.vertex_body == 1)[:, None]


@pytest.mark.parametrize("height", [1.5, 4.0, 100.0])
def test_default_separation_is_the_same_however_far_the_body_falls(device, height):
    mesh, start, end = falling_by(height)
    unit = float(np.ptp(mesh.vertices, axis=0).max())
    assert mesh.length_scale == unit
    options = {"minimum_separation": 0.1, "device": device}
    result = ccd.mesh_ccd(mesh, start, end, **options)
    assert result.toi == pytest.approx((1.0 - 0.1 * unit) / height, abs=1e-5)
    explicit = ccd.mesh_ccd(mesh, start, end, length_scale=unit, **options)
    assert result.contacts.toi.tobytes() == explicit.contacts.toi.tobytes()
    pipeline = ccd.CollisionPipeline(mesh, **options)
    check_same(pipeline.launch(on_device(start, device), on_device(end, device)), result)
    pipeline.reserve(vertices=2.0 * mesh.vertices)  # where trees are laid out changes no length
    check_same(pipeline.launch(on_device(start, device), on_device(end, device)), result)


def test_sheet_over_a_ball_that_moves_away_is_free_for_every_trial_step(device):
    ball = trimesh.creation.icosphere(subdivisions=2)
    sheet = np.array([[-1, -1, 1.005], [1, -1, 1.005], [1, 1, 1.005], [-1, 1, 1.005]], dtype=float)
    mesh = ccd.CollisionMesh.from_arrays([(sheet, [[0, 1, 2], [0, 2, 3]]), (ball.vertices, ball.faces)])
    for trial in (0.1, 1.0, 5.0, 10.0, 100.0):
        end = mesh.vertices - [0, 0, trial] * (mesh.vertex_body == 1)[:, None]
        options = {"minimum_separation": 1e-3, "device": device}
        assert ccd.collision_free_step(mesh, mesh.vertices, end, **options) == 1.0
        result = ccd.CollisionPipeline(mesh, **options).launch(on_device(mesh.vertices, device), on_device(end, device))
        assert result.toi.numpy()[0] == np.inf


def test_mesh_whose_vertices_coincide_has_the_unit_1(device):
    corners = np.zeros((3, 3))
    mesh = ccd.CollisionMesh.from_arrays([(corners, [[0, 1, 2]]), (corners, [[0, 1, 2]])])
    assert mesh.length_scale == 1.0
    _, start, end = falling_by(4.0)
    options = {"minimum_separation": 0.1, "device": device}
    result = ccd.mesh_ccd(mesh, start[:6], end[:6], **options)
    explicit = ccd.mesh_ccd(mesh, start[:6], end[:6], length_scale=1.0, **options)
    assert result.contacts.toi.tobytes() == explicit.contacts.toi.tobytes()
    assert ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, device=device).toi == 0.0
    frames = on_device(mesh.vertices, device), on_device(mesh.vertices, device)
    assert ccd.CollisionPipeline(mesh, device=device).launch(*frames).toi.numpy()[0] == 0.0


def test_counts_after_a_launch_are_those_of_the_last_call_on_the_host(device):
    mesh, start, end = crowd(np.random.default_rng(3), 60, 0.2)
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device, **CAPACITIES)
    vertices_t0, vertices_t1 = on_device(start, device), on_device(end, device)
    result = pipeline.launch(vertices_t0, vertices_t1)
    assert pipeline.counts == ccd.Counts() and pipeline.timings == {}
    on_host = pipeline.mesh_ccd(start, end)
    counts, timings = pipeline.counts, pipeline.timings
    assert counts.num_candidates[ccd.PairKind.EDGE_EDGE] > 0
    vertices_t1.assign(start)
    pipeline.launch(vertices_t0, vertices_t1)
    pipeline.launch_line_search(vertices_t0, vertices_t1)
    assert pipeline.counts is counts and pipeline.timings is timings
    # a launch has counts of its own, on the device
    vertices_t1.assign(end)
    pipeline.launch(vertices_t0, vertices_t1)
    for kind in SOLVERS:
        assert result.num_pairs.numpy()[kind] == on_host.counts.num_after_cull[kind] > 0
    assert result.contacts.count.numpy()[0] == len(on_host.contacts)
