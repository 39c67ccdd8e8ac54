"""The main job on meshes: toi of the scene, per vertex, per body, and the contacts, against exact arithmetic."""

import numpy as np
import pytest
import trimesh
from exact import exact_tois
from hard_cases import FAMILIES
from oracles import corners_of
from published import requires_data, simulation_boxes, simulation_queries, simulation_step
from scenes import with_static_at_rest

import ccd_warp as ccd


def wall(x=5.0):
    """A square wall of two faces across x, larger than the bullet."""
    vertices = np.array([[x, -2, -2], [x, 2, -2], [x, 2, 2], [x, -2, 2]], dtype=float)
    return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False)


def bullet(x=0.5):
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.25)
    mesh.apply_translation([x, 0.1, 0.2])
    return mesh


def bullet_and_wall(**options):
    mesh = ccd.CollisionMesh.from_trimesh([bullet(), wall()], static=[1], **options)
    end = mesh.vertices.copy()
    end[mesh.vertex_body == 0, 0] += 9.0
    return mesh, mesh.vertices, end


def points_of(mesh, result, vertices):
    """Points of the contacts of each kind, [m, 4, 3], [m, 3, 3] or [m, 2, 3]."""
    return {
        kind: np.asarray(vertices)[corners_of(mesh, kind, result.contacts.primitives[result.contacts.kind == kind])]
        for kind in ccd.PairKind
    }


def brute_force_toi(mesh, start, end, t_max=1.0):
    """Exact scene toi over all pairs that pass the filter, in float."""
    body, static = mesh.vertex_body, mesh.static
    faces, edges = mesh.faces, mesh.edges

    def passes(a, b):
        return not (static[a] and static[b]) and (a != b or mesh.self_collision[a])

    vf = [(v, *f) for v in range(len(start)) for f in faces if v not in f and passes(body[v], body[f[0]])]
    ee = [
        (*a, *b)
        for i, a in enumerate(edges)
        for b in edges[i + 1 :]
        if not set(a) & set(b) and passes(body[a[0]], body[b[0]])
    ]
    best = np.inf
    for kind, rows in (("vertex-face", vf), ("edge-edge", ee)):
        index = np.array(rows, dtype=int).reshape(-1, 4)
        exact = exact_tois(kind, start[index], end[index], t_max=t_max)
        best = min([best, *(e.approx for e in exact if e.hit)])
    return best


# --- against the oracle ---


def test_bullet_through_wall(precision, device):
    mesh, start, end = bullet_and_wall()
    result = ccd.mesh_ccd(mesh, start, end, precision=precision, device=device)
    exact = brute_force_toi(mesh, start, end)
    assert exact * (1 - 1e-5) <= result.toi <= exact
    assert ccd.collision_free_step(mesh, start, end, precision=precision, device=device) == result.toi
    # the front of the bullet moves along +x, so the wall's normal at the contacts points back along -x
    first = result.contacts.toi == result.toi
    front = result.contacts.kind[first] == ccd.PairKind.VERTEX_FACE
    np.testing.assert_allclose(result.contacts.normal[first][front], [[-1, 0, 0]] * front.sum(), atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_two_tumbling_boxes_match_brute_force(seed, precision):
    rng = np.random.default_rng(seed)
    boxes = [trimesh.creation.box(extents=rng.uniform(0.5, 1.5, 3)) for _ in range(2)]
    mesh = ccd.CollisionMesh.from_trimesh(boxes)
    start = mesh.vertices + np.where(mesh.vertex_body == 0, -1.2, 1.2)[:, None] * [1, 0.2, 0.1]
    end = start @ trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    end -= np.where(mesh.vertex_body == 0, -1.2, 1.2)[:, None] * [1, 0.2, 0.1]
    result = ccd.mesh_ccd(mesh, start, end, precision=precision)
    exact = brute_force_toi(mesh, start, end)
    assert np.isfinite(exact)
    # float32 leaves a gap of about 1e-5 of the scene, closed at a speed of about one scene a step
    assert exact - (1e-5 if precision == "float64" else 1e-3) <= result.toi <= exact


@requires_data
@pytest.mark.parametrize("scene", ["cloth-funnel", "rod-twist"])
def test_published_step(scene, precision):
    step = simulation_step(scene)
    mesh = ccd.CollisionMesh.from_arrays([(step.vertices_t0, step.faces)])
    result = ccd.mesh_ccd(mesh, step.vertices_t0, step.vertices_t1, precision=precision)
    exact_scene = np.inf
    found = {tuple(row) for row in np.column_stack([result.contacts.kind, result.contacts.primitives]).tolist()}
    first = {"vertex-face": (0, mesh.num_vertices + mesh.num_edges), "edge-edge": (mesh.num_vertices,) * 2}
    for number, kind in enumerate(("vertex-face", "edge-edge")):
        queries = simulation_queries(scene, kind)
        ids = simulation_boxes(scene, kind)[queries.truth] - np.array(first[kind])
        if kind == "edge-edge":
            ids = np.sort(ids, axis=1)
        assert queries.truth.any()
        missing = [row for row in ids.tolist() if (number, *row) not in found]
        assert not missing
        exact = exact_tois(kind, queries.points_t0[queries.truth], queries.points_t1[queries.truth])
        exact_scene = min(exact_scene, *(e.approx for e in exact))
        # contacts that are not among the published collisions are phantoms, or nothing that was published
    assert result.toi <= exact_scene
    assert result.toi >= exact_scene - (1e-9 if precision == "float64" else 1e-2)


def test_every_contact_is_conservative_and_covers_its_vertices_and_bodies(precision):
    mesh, start, end = bullet_and_wall()
    result = ccd.mesh_ccd(mesh, start, end, precision=precision)
    x0, x1 = points_of(mesh, result, start), points_of(mesh, result, end)
    expected_vertex = np.full(mesh.num_vertices, np.inf)
    for kind, name in ((ccd.PairKind.VERTEX_FACE, "vertex-face"), (ccd.PairKind.EDGE_EDGE, "edge-edge")):
        tois = result.contacts.toi[result.contacts.kind == kind]
        exact = exact_tois(name, x0[kind], x1[kind])
        assert len(exact) > 0
        assert not any(e.late(float(t)) for e, t in zip(exact, tois, strict=True))
        pairs = result.contacts.primitives[result.contacts.kind == kind]
        for (a, b), t in zip(pairs, tois, strict=True):
            vertices = [a, *mesh.faces[b]] if name == "vertex-face" else [*mesh.edges[a], *mesh.edges[b]]
            expected_vertex[vertices] = np.minimum(expected_vertex[vertices], t)
    assert (result.vertex_toi == expected_vertex).all()
    expected_body = [expected_vertex[mesh.vertex_body == b].min() for b in range(2)]
    assert result.body_toi.tolist() == expected_body
    assert result.toi == expected_vertex.min() == result.contacts.toi.min()
    assert result.hit


def test_a_vertex_that_reaches_a_face_at_the_end_of_the_step_is_no_free_step(device, precision):
    face = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 2, 0]])
    mesh = ccd.CollisionMesh.from_arrays([(face, [[0, 1, 2]]), (face + [0, 0, 1], [[0, 1, 2]])], static=[0])
    options = {"device": device, "precision": precision, "length_scale": 1.0}
    pipeline = ccd.CollisionPipeline(mesh, **options)
    start = mesh.vertices
    for end_height, is_free in ((1.0, True), (0.25, True), (0.0, False), (-1.0, False)):
        end = start.copy()
        end[3, 2] = end_height
        assert ccd.is_step_collision_free(mesh, start, end, **options) is is_free
        assert pipeline.is_step_collision_free(start, end) is is_free
    end[3, 2] = -1.0
    assert not ccd.is_step_collision_free(mesh, start, end, t_max=0.5, **options)
    assert ccd.is_step_collision_free(mesh, start, end, t_max=0.49, **options)
    assert not ccd.is_step_collision_free(mesh, start, end, t_max=0.49, minimum_separation=0.1, **options)


def test_a_step_that_starts_in_contact_is_not_free(device):
    ball = trimesh.creation.icosphere(subdivisions=1)
    mesh = ccd.CollisionMesh.from_trimesh([ball, ball])
    assert not ccd.is_step_collision_free(mesh, mesh.vertices, mesh.vertices, device=device)


def test_collision_free_step_really_is_free():
    mesh, start, end = bullet_and_wall()
    step = ccd.collision_free_step(mesh, start, end, minimum_separation=1e-3)
    shortened = start + step * (end - start)
    # what is left of the step touches at once; what was taken does not touch at all
    assert np.isinf(ccd.mesh_ccd(mesh, start, shortened).toi)
    assert ccd.collision_free_step(mesh, start, shortened) == 1.0
    assert 0 < step < brute_force_toi(mesh, start, end)


def test_edges_that_touch_beside_axes_of_very_different_scale():
    # one axis of 2^700 beside two near 2^-535: products of the small ones underflow, and the large one magnifies that
    found = 0
    for seed in range(30, 60):
        p0, p1 = FAMILIES["random_colliding"]("edge-edge", 1, np.random.default_rng(seed))
        p0, p1 = (np.ldexp(p, [700, -537, -530])[0] for p in (p0, p1))
        mesh = ccd.CollisionMesh.from_arrays([(p0[k : k + 2], np.zeros((0, 3), int), [[0, 1]]) for k in (0, 2)])
        (exact,) = exact_tois("edge-edge", p0[None], p1[None])
        found += exact.hit
        assert not exact.late(ccd.mesh_ccd(mesh, p0, p1).toi)
        assert not exact.late(ccd.collision_free_step(mesh, p0, p1))
    assert found > 10


# --- what a scene needs ---


def test_static_body_needs_no_end_positions():
    mesh, start, end = bullet_and_wall()
    expected = ccd.mesh_ccd(mesh, start, end).toi
    assert ccd.mesh_ccd(mesh, start, end[mesh.vertex_body == 0]).toi == expected


def test_two_static_bodies_are_never_tested():
    mesh = ccd.CollisionMesh.from_trimesh([bullet(), wall(), wall(5.0)], static=[1, 2])
    end = mesh.vertices.copy()
    result = ccd.mesh_ccd(mesh, mesh.vertices, end)
    # two walls in one place: no pair of them is a candidate
    assert result.counts.num_candidates[ccd.PairKind.VERTEX_FACE] == 0
    assert np.isinf(result.toi)


def test_self_collision_switch():
    cloth = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]], [[0, 1, 2], [3, 4, 5]], process=False
    )
    end = cloth.vertices.copy()
    end[3:, 2] = -1
    on = ccd.CollisionMesh.from_trimesh([cloth])
    off = ccd.CollisionMesh.from_trimesh([cloth], self_collision=False)
    assert ccd.mesh_ccd(on, cloth.vertices, end).toi == pytest.approx(0.5, abs=1e-6)
    result = ccd.mesh_ccd(off, cloth.vertices, end)
    assert np.isinf(result.toi)
    assert not any(result.counts.num_candidates.values())


def test_stationary_scene_and_scene_that_touches_at_the_start():
    mesh, start, _ = bullet_and_wall()
    assert np.isinf(ccd.mesh_ccd(mesh, start, start).toi)
    assert ccd.collision_free_step(mesh, start, start) == 1.0
    touching = start.copy()
    touching[mesh.vertex_body == 0, 0] += 5.0 - start[mesh.vertex_body == 0, 0].max()
    result = ccd.mesh_ccd(mesh, touching, touching)
    assert result.toi == 0.0
    assert result.counts.num_contacts_at_start > 0
    assert ccd.collision_free_step(mesh, touching, touching) == 0.0


def test_minimum_separation_moves_the_toi_by_the_gap():
    mesh, start, end = bullet_and_wall(self_collision=False)  # the bullet's own faces are closer than the separation
    scale = 11.0
    plain = ccd.mesh_ccd(mesh, start, end, length_scale=scale).toi
    apart = ccd.mesh_ccd(mesh, start, end, length_scale=scale, minimum_separation=0.01).toi
    # the bullet moves 9 a step; the L∞ gap to a wall across x is the distance along x
    assert plain - apart == pytest.approx(0.01 * scale / 9.0, abs=1e-6)


def test_t_max_cuts_the_step():
    mesh, start, end = bullet_and_wall()
    toi = ccd.mesh_ccd(mesh, start, end).toi
    assert np.isinf(ccd.mesh_ccd(mesh, start, end, t_max=toi * 0.99).toi)
    assert ccd.collision_free_step(mesh, start, end, t_max=0.25) == 0.25
    assert ccd.mesh_ccd(mesh, start, end, t_max=toi * 1.01).toi == pytest.approx(toi, abs=1e-9)


@pytest.mark.parametrize("exponent", [-300, 300])
def test_power_of_two_scale_changes_no_bit(exponent):
    mesh, start, end = bullet_and_wall()
    a = ccd.mesh_ccd(mesh, start, end)
    scaled = ccd.CollisionMesh.from_arrays([(np.ldexp(mesh.vertices, exponent), mesh.faces)])
    b = ccd.mesh_ccd(scaled, np.ldexp(start, exponent), np.ldexp(end, exponent))
    assert a.contacts.toi.tobytes() == b.contacts.toi.tobytes()
    assert a.contacts.primitives.tobytes() == b.contacts.primitives.tobytes()


def test_empty_body_beside_others():
    empty = (np.zeros((0, 3)), np.zeros((0, 3), dtype=int))
    cube = trimesh.creation.box()
    mesh = ccd.CollisionMesh.from_arrays([empty, (cube.vertices, cube.faces)])
    result = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices)
    assert np.isinf(result.toi)
    assert np.isinf(result.body_toi).all()
    nothing = ccd.CollisionMesh.from_arrays([empty])
    assert np.isinf(ccd.mesh_ccd(nothing, np.zeros((0, 3)), np.zeros((0, 3))).toi)
    assert ccd.collision_free_step(nothing, np.zeros((0, 3)), np.zeros((0, 3))) == 1.0


def test_counts_and_timings_name_every_stage():
    mesh, start, end = bullet_and_wall()
    result = ccd.mesh_ccd(mesh, start, end)
    assert (result.counts.num_bodies, result.counts.num_vertices) == (2, mesh.num_vertices)
    assert sum(result.counts.num_contacts.values()) == len(result.contacts)
    assert set(result.timings) == {"input", "boxes", "pairs", "narrow phase", "gather", "total"}
    assert all(seconds >= 0 for seconds in result.timings.values())


def test_counts_of_a_pipeline_are_of_its_last_call_on_the_host():
    mesh, start, end = bullet_and_wall()
    pipeline = ccd.CollisionPipeline(mesh)
    assert pipeline.counts == ccd.Counts()
    result = pipeline.mesh_ccd(start, end)
    assert pipeline.counts == result.counts and sum(pipeline.counts.num_contacts.values()) > 0
    pipeline.launch(start, end)
    assert pipeline.counts == result.counts
    pipeline.find_candidates(start, end)
    assert pipeline.counts.num_bodies == 2 and pipeline.counts.num_contacts == {}
    assert all(pipeline.counts.num_candidates.values())
    assert pipeline.collision_free_step(start, start + 0.0) >= 0.0
    assert pipeline.counts.num_contacts == {}


def test_a_step_that_cannot_begin_is_counted_too():
    """The search ends with the first pair that touches at the start."""
    mesh, start, _ = bullet_and_wall()
    moves = mesh.vertex_body == 0
    touching = start.copy()
    touching[moves, 0] += start[~moves, 0].min() - start[moves, 0].max()
    pipeline = ccd.CollisionPipeline(mesh)
    assert pipeline.collision_free_step(touching, touching + moves[:, None] * [1.0, 0, 0]) == 0.0
    assert sum(pipeline.counts.num_candidates.values()) > 0 and pipeline.counts.num_batches > 0


# --- cables and particles ---


def test_particles_meet_a_moving_sheet_and_each_other(precision, device):
    sheet = wall(0.0)
    particles = np.array([[0.5, 0.5, 0.25], [-0.75, 0.5, 0.25], [0.5, 1.0, -0.5], [-1.0, 1.0, -0.5], [0.5, 9.0, 9.0]])
    bodies = [(sheet.vertices, sheet.faces), (particles, [])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=[False, True])
    end = mesh.vertices.copy()
    end[:4, 0] += 1.0  # the sheet comes towards +x, through the first particle after 1/2 - separation
    end[5, 0] -= 1.0
    options = {"minimum_separation": 0.0625, "length_scale": 1.0, "precision": precision, "device": device}
    result = ccd.mesh_ccd(mesh, mesh.vertices, end, **options)
    accuracy = 1e-9 if precision == "float64" else 1e-5
    toi = result.vertex_toi[4:]
    # two particles lie in the way of the sheet, and no particle in the way of another
    assert toi[[0, 2]] == pytest.approx([0.4375, 0.4375], abs=accuracy)
    assert np.isinf(toi[[1, 3, 4]]).all()
    assert set(result.contacts.kind.tolist()) == {ccd.PairKind.VERTEX_FACE}
    end[:4] = mesh.vertices[:4]
    end[4] = particles[1]  # through the sheet, to where the second has just left
    end[6] = particles[3]  # through the sheet, into the stationary fourth
    result = ccd.mesh_ccd(mesh, mesh.vertices, end, **options)
    contacts = result.contacts
    meeting = contacts.kind == ccd.PairKind.POINT_POINT
    assert contacts.primitives[meeting].tolist() == [[6, 7]]
    assert contacts.toi[meeting] == pytest.approx((1.5 - 0.0625) / 1.5, abs=accuracy)
    np.testing.assert_allclose(contacts.normal[meeting], [[1, 0, 0]], atol=1e-12)
    assert result.counts.num_contacts[ccd.PairKind.POINT_POINT] == 1 and result.counts.num_codimensional_points == 5
    assert result.toi == ccd.collision_free_step(mesh, mesh.vertices, end, **options)
    assert result.toi == pytest.approx((0.5 - 0.0625) / 1.5, abs=accuracy)


def test_two_cables_cross(precision):
    along_y = np.array([[0, -1, 0], [0, 0.5, 0], [0, 1, 0]], dtype=float)
    along_z = np.array([[2, 0, -1], [2, 0, 0.25], [2, 0, 1]], dtype=float)
    segments = [[0, 1], [1, 2]]
    mesh = ccd.CollisionMesh.from_arrays([(along_y, [], segments), (along_z, [], segments)], static=[0])
    end = with_static_at_rest(mesh, mesh.vertices, mesh.vertices - [4, 0, 0])
    result = ccd.mesh_ccd(mesh, mesh.vertices, end, precision=precision)
    assert result.toi == pytest.approx(0.5, abs=1e-9 if precision == "float64" else 1e-5) and result.toi <= 0.5
    first = result.contacts.toi == result.toi
    assert [[0, 2]] == result.contacts.primitives[first].tolist()
    assert result.contacts.kind[first].tolist() == [ccd.PairKind.EDGE_EDGE]
    np.testing.assert_allclose(np.abs(result.contacts.normal[first]), [[1, 0, 0]], atol=1e-12)
    assert (result.counts.num_codimensional_points, result.counts.num_codimensional_edges) == (0, 4)


def test_particle_passes_a_cable_at_less_than_the_separation(precision):
    cable = np.array([[0, -1, 0], [0.1, 0.2, 0], [0, 1, 0.1]])
    particle = np.array([[-1.0, 0.5, 0.07]])
    bodies = [(cable, [], [[0, 1], [1, 2]]), (particle, [])]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[0], codimensional_points=True)
    end = with_static_at_rest(mesh, mesh.vertices, mesh.vertices + [2, 0, 0])
    options = {"length_scale": 1.0, "precision": precision}
    assert np.isinf(ccd.mesh_ccd(mesh, mesh.vertices, end, **options).toi)
    result = ccd.mesh_ccd(mesh, mesh.vertices, end, minimum_separation=0.05, **options)
    start = mesh.vertices[[3, 1, 2]]
    (exact,) = exact_tois(
        "point-segment", start[None], start[None] + [[2, 0, 0], [0, 0, 0], [0, 0, 0]], separation=0.05
    )
    assert exact.hit and not exact.late(result.toi)
    assert exact.early_by(result.toi) < (1e-9 if precision == "float64" else 1e-4)
    assert result.contacts.kind.tolist() == [ccd.PairKind.POINT_SEGMENT]
    assert result.contacts.primitives.tolist() == [[3, 1]]
    assert (result.vertex_toi == [np.inf, *[result.toi] * 3]).all()
    assert (result.body_toi == result.toi).all()
    (normal,) = result.contacts.normal
    assert np.linalg.norm(normal) == pytest.approx(1) and normal @ (cable[2] - cable[1]) == pytest.approx(0, abs=1e-12)
    # away from the closest point of the cable, in whose box the particle is
    at_toi, (u, _) = particle[0] + [2 * result.toi, 0, 0], result.contacts.parameters[0]
    gap = at_toi - ((1 - u) * cable[1] + u * cable[2])
    assert normal == pytest.approx(gap / np.linalg.norm(gap), abs=1e-12) and normal[0] < -0.8
    assert result.toi == ccd.collision_free_step(mesh, mesh.vertices, end, minimum_separation=0.05, **options)


def test_normal_of_points_that_start_within_the_separation():
    cable, particles = [[0.0, -1, 0], [0, 1, 0]], [[0.25, 0, 0], [0.25, 0.5, 0.25]]
    mesh = ccd.CollisionMesh.from_arrays([(cable, [], [[0, 1]]), (particles, [])], codimensional_points=True)
    for motion in ([0, 0, 0], [0, 0.125, 0]):  # stationary, and sliding along the cable
        end = mesh.vertices + np.array([[0, 0, 0]] * 2 + [motion] * 2)
        contacts = ccd.mesh_ccd(mesh, mesh.vertices, end, minimum_separation=0.5, length_scale=1.0).contacts
        assert contacts.kind.tolist() == [2, 2, 3] and (contacts.toi == 0).all()
        across = [[1, 0, 0], [0.5**0.5, 0, 0.5**0.5], [0, -(0.8**0.5), -(0.2**0.5)]]
        np.testing.assert_allclose(contacts.normal, across, atol=1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_sheet_cables_and_particles_match_brute_force(seed, precision):
    rng = np.random.default_rng(seed)
    sheet = (rng.uniform(-1, 1, (4, 3)), [[0, 1, 2], [0, 2, 3]])
    cable = (rng.uniform(-1, 1, (4, 3)), [], [[0, 1], [1, 2], [2, 3]])
    mixed = (rng.uniform(-1, 1, (9, 3)), [], [[0, 1]])
    mesh = ccd.CollisionMesh.from_arrays([sheet, cable, mixed, mixed], codimensional_points=True)
    start, end = mesh.vertices, rng.uniform(-1, 1, mesh.vertices.shape)
    start = start + np.where(mesh.vertex_body == 3, 0.4, 0.0)[:, None]
    separation = 0.125
    result = ccd.mesh_ccd(mesh, start, end, minimum_separation=separation, length_scale=1.0, precision=precision)
    contacts = result.contacts
    keys = np.column_stack([contacts.kind, contacts.primitives]).tolist()
    assert keys == sorted(keys)
    points, segments = mesh.codimensional_points.tolist(), mesh.codimensional_edges.tolist()
    every = {
        ccd.PairKind.POINT_SEGMENT: [(p, s) for p in points for s in segments],
        ccd.PairKind.POINT_POINT: [(p, q) for p in points for q in points if p < q],
    }
    vertex_toi = np.full(mesh.num_vertices, np.inf)
    for kind in set(ccd.PairKind) - {ccd.PairKind.VERTEX_PLANE}:
        vertices = corners_of(mesh, kind, result.contacts.primitives[result.contacts.kind == kind])
        name = kind.name.lower().replace("_", "-")
        tois = contacts.toi[contacts.kind == kind]
        for row, toi in zip(vertices, tois, strict=True):
            vertex_toi[row] = np.minimum(vertex_toi[row], toi)
        exact = exact_tois(name, start[vertices], end[vertices], separation)
        assert not any(e.late(float(t)) for e, t in zip(exact, tois, strict=True))
        if kind in every:
            index = np.array([[p, *(mesh.edges[q] if name == "point-segment" else [q])] for p, q in every[kind]])
            hits = [e.hit for e in exact_tois(name, start[index], end[index], separation)]
            expected = [pair for pair, hit in zip(every[kind], hits, strict=True) if hit]
            found = list(map(tuple, contacts.primitives[contacts.kind == kind].tolist()))
            assert set(expected) <= set(found)
            assert len(found) == result.counts.num_contacts[kind] <= result.counts.num_candidates[kind]
            assert len(expected) > 0
    assert (result.vertex_toi == vertex_toi).all()


def test_triangle_meshes_and_their_unused_vertices_launch_no_point_kinds():
    cloth = (np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [3, 0, 0], [3, 0, 1]], dtype=float), [[0, 1, 2]])
    mesh = ccd.CollisionMesh.from_arrays([cloth])
    end = mesh.vertices.copy()
    end[3] = end[4]  # the unused vertices meet
    result = ccd.mesh_ccd(mesh, mesh.vertices, end)
    assert np.isinf(result.toi)
    assert result.counts.num_searches.keys() == {ccd.PairKind.VERTEX_FACE, ccd.PairKind.EDGE_EDGE}
    asked = ccd.CollisionMesh.from_arrays([cloth], codimensional_points=True)
    assert ccd.mesh_ccd(asked, mesh.vertices, end).toi == pytest.approx(1.0, abs=1e-6)


def answers(mesh, start, end, **options):
    """What every call says of a step, of vertices a row each, and of all else."""
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", **options)
    result = pipeline.mesh_ccd(start, end, check_start=True)
    launched = pipeline.launch(start, end).to_host()
    near, near_launched = pipeline.find_proximity(start, 0.2), pipeline.launch_proximity(start, 0.2).to_host()
    rows = [result.vertex_toi, launched.vertex_toi, pipeline.displacement_bounds(start, 0.3)]
    rows.append(pipeline.launch_displacement_bounds(start, 0.3).bounds.numpy().copy())
    for per in ("scene", "body", "vertex"):
        found, shortened = pipeline.line_search(start, end, per=per), end.copy()
        pipeline.launch_line_search(start, shortened, per=per)
        rows += [found.vertices, found.vertex_fraction, shortened]
    others = [mesh.length_scale, launched.toi, launched.flags, pipeline.collision_free_step(start, end)]
    others += [getattr(result.contacts, name) for name in ("toi", "points", "normal", "bodies")]
    others += [near.distance, near_launched.distance, result.start.points, pipeline.find_intersections(end).points]
    return rows, [*others, *map(len, vars(pipeline.find_candidates(start, end, 0.01)).values())]


@pytest.mark.parametrize("far", [np.nan, 0.5, 1e300])
@pytest.mark.parametrize(
    "options",
    [
        {"static": ["ball"], "radius": [0.01, 0.02, 0.01, 0.0]},
        {"kinematic": ["cable"], "self_collision": False},
        {"codimensional_points": [False, False, True, False]},
    ],
)
def test_bodies_that_share_a_list_of_nodes_have_the_answers_of_bodies_with_lists_of_their_own(options, far):
    """In map coordinates, each bit of every call on the host and on the device; the other rows are anywhere."""
    rng = np.random.default_rng(0)
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.5)
    parts = [[ball.vertices, ball.faces], [ball.vertices * 0.5 + [0.1, 0, 1], ball.faces]]
    parts.append([[[0.6, 0.1, 0], [0.7, 0, 0.5], [0.8, 0, 0.9]], np.zeros((0, 3), int), [[0, 1], [1, 2]]])
    own = [(np.array(x) + [4e6, 5e5, 0], *primitives) for x, *primitives in parts]
    counts = [len(x) for x, *_ in own]
    first = np.cumsum([0, *counts])
    shared, rows = [], []
    for b, (x, *primitives) in enumerate(own):
        nodes = np.full((first[-1], 3), far)
        nodes[first[b] : first[b + 1]] = x
        shared.append((nodes, *(np.array(each) + first[b] for each in primitives)))
        rows += [b * first[-1] + first[b] + np.arange(counts[b])]
    rows, ground = np.concatenate(rows), ccd.HalfSpace([4e6, 5e5, -0.6], [0, 0.1, 1])
    options = {"names": ["ball", "small", "cable", "ground"], **options}
    alone = ccd.CollisionMesh.from_arrays([*own, ground], **options | {"codimensional_points": False})
    if "codimensional_points" in options:  # then the nodes of the cable's list are particles, so it has its own
        shared[2], rows[-3:] = own[2], 2 * first[-1] + np.arange(3)
    mesh = ccd.CollisionMesh.from_arrays([*shared, ground], **options)
    start = alone.vertices
    moves = rng.standard_normal(start.shape) * 0.05 - [0, 0, 0.6] * (alone.vertex_body != 0)[:, None]
    end = start + moves * ~alone.static[alone.vertex_body][:, None]
    x, y = np.full((2, mesh.num_vertices, 3), far)
    x[rows], y[rows] = start, end
    expected, found = answers(alone, start, end), answers(mesh, x, y)
    assert found[0][0][mesh.unused_vertices].tolist() == [np.inf] * len(mesh.unused_vertices) != []
    for of_rows, of_all in zip(expected[0], found[0], strict=True):
        assert np.array_equal(of_rows, of_all[rows])
    for values, others in zip(expected[1], found[1], strict=True):
        assert np.array_equal(values, others)
    assert np.isinf(found[0][2][mesh.unused_vertices]).all() and np.isinf(found[0][3][mesh.unused_vertices]).all()
    assert len(expected[1][4]) > 5 and expected[1][3] < 1
    copies = ccd.CollisionPipeline(mesh.replicate(2), device="cpu").launch(*(np.tile(each, (2, 1)) for each in (x, y)))
    assert copies.world_toi.numpy().tolist() == [expected[1][1]] * 2 and not copies.flags.numpy()[0]


# --- bad input ---
