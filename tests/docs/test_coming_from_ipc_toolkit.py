"""What docs/coming_from_ipc_toolkit.md says of ipc-toolkit and of this package is what both do."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scenes import soup

import ccd_warp as ccd

ipctk = pytest.importorskip("ipctk", reason="the extra bench is not installed")

PAGE = Path(__file__).resolve().parents[2] / "docs" / "coming_from_ipc_toolkit.md"
FACE = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 2, 0]])
FACES = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)


@pytest.fixture(autouse=True)
def quiet():
    """Without the log line of a start in contact."""
    ipctk.set_logger_level(ipctk.off)
    yield
    ipctk.set_logger_level(ipctk.warn)


def _falling_face(height: float, end: float = -1.0):
    """A small face above a large one, and where it falls to: both meshes, start and end."""
    start = np.vstack([FACE, FACE * 0.1 + [0, 0, height]])
    stop = start.copy()
    stop[3:, 2] = end
    theirs = ipctk.CollisionMesh(start, ipctk.edges(FACES), FACES)
    ours = ccd.CollisionMesh.from_arrays([(start[:3], FACES[:1]), (start[3:], FACES[:1])])
    return theirs, ours, start, stop


def test_edges_have_the_same_numbers():
    ball = trimesh.creation.icosphere(subdivisions=2)
    edges = ipctk.edges(ball.faces.astype(np.int32))
    assert np.array_equal(edges, ccd.CollisionMesh.from_trimesh([ball]).edges)


def test_a_point_meets_a_face_a_cable_or_a_point_here_where_it_is_asked_for():
    def steps(obstacle, edges, faces, asked):
        start = np.vstack([obstacle, [[0.0, 0, 1]]])
        end = start.copy()
        end[-1, 2] = -1
        edges, faces = (np.array(rows, dtype=np.int32).reshape(-1, width) for rows, width in ((edges, 2), (faces, 3)))
        boundary = ipctk.edges(faces) if len(faces) else edges
        theirs = ipctk.CollisionMesh(start, boundary, faces)
        ours = ccd.CollisionMesh.from_arrays([(start, faces, edges)], codimensional_points=asked)
        return ipctk.compute_collision_free_stepsize(theirs, start, end), ccd.collision_free_step(ours, start, end)

    of_edge, of_point = ([[-1.0, 0, 0], [1, 0, 0]], [[0, 1]], []), ([[0.0, 0, 0]], [], [])
    for obstacle in ((FACE, [], [[0, 1, 2]]), of_edge, of_point):
        assert steps(*obstacle, False) == pytest.approx((0.5, 1.0), abs=1e-3)
        assert steps(*obstacle, True) == pytest.approx((0.5, 0.5), abs=1e-3)


@pytest.mark.parametrize(
    ("small", "is_touching", "is_crossing"),
    [
        ([[0, 0, -1], [0, 0, 1], [3, 3, 1]], True, True),
        ([[0, 0, 0], [0, 0, 1], [3, 3, 1]], True, False),
        ([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], True, False),
        ([[0, 0, 1], [0, 0, 2], [3, 3, 1]], False, False),
    ],
)
def test_both_say_where_surfaces_intersect(small, is_touching, is_crossing):
    x = np.vstack([FACE, np.array(small, dtype=float)])
    theirs = ipctk.CollisionMesh(x, ipctk.edges(FACES), FACES)
    found = ccd.find_intersections(ccd.CollisionMesh.from_arrays([(x, FACES)]), x)
    assert ipctk.has_intersections(theirs, x) == (len(found) > 0) == is_touching
    assert found.is_crossing.any() == is_crossing


def _spanned(proximities):
    """The closest features of each pair, as two sets of vertices."""
    features = []
    for vertices, bits, kind in zip(proximities.vertices, proximities.features, proximities.kind, strict=True):
        chosen = [int(v) if bits >> k & 1 else None for k, v in enumerate(vertices)]
        cut = 1 if kind == ccd.PairKind.VERTEX_FACE else 2
        features.append(frozenset(frozenset(side) - {None} for side in (chosen[:cut], chosen[cut:])))
    return features


@pytest.mark.parametrize("seed", range(3))
def test_the_collision_set_holds_each_proximity_once_as_unique_does_and_bounds_are_half_the_safe_distances(seed):
    x, faces = soup(np.random.default_rng(seed), 60, 0.1)
    edges = ipctk.edges(faces).tolist()
    theirs, ours = ipctk.CollisionMesh(x, np.array(edges), faces), ccd.CollisionMesh.from_arrays([(x, faces)])
    collisions, candidates = ipctk.NormalCollisions(), ipctk.Candidates()
    collisions.build(theirs, x, 0.05)
    candidates.build(theirs, x, 0.025)
    expected = [({c.vertex0_id}, {c.vertex1_id}) for c in collisions.vv_collisions]
    expected += [({c.vertex_id}, edges[c.edge_id]) for c in collisions.ev_collisions]
    expected += [({c.vertex_id}, faces[c.face_id].tolist()) for c in collisions.fv_collisions]
    expected += [(edges[c.edge0_id], edges[c.edge1_id]) for c in collisions.ee_collisions]
    near = ccd.find_proximity(ours, x, 0.05)
    once = _spanned(near.unique())
    assert {*once} == {frozenset(map(frozenset, sides)) for sides in expected} and len(once) == len(expected) > 50
    assert near.distance.min() == pytest.approx(collisions.compute_minimum_distance(theirs, x) ** 0.5, rel=1e-9)
    safe = candidates.compute_per_vertex_safe_distances(theirs, x, 0.05, 0.0)
    assert ccd.displacement_bounds(ours, x, 0.05) == pytest.approx(0.5 * safe, abs=1e-15)


def test_static_obstacles_are_left_out_alike():
    theirs, _, start, end = _falling_face(1.0)
    theirs.can_collide = ipctk.make_static_obstacle_filter(0)
    assert ipctk.compute_collision_free_stepsize(theirs, start, end) == 1.0
    both = ccd.CollisionMesh.from_arrays([(start[:3], FACES[:1]), (start[3:], FACES[:1])], static=[0, 1])
    with pytest.raises(ValueError, match=r"which is static, by .* kinematic="):
        ccd.collision_free_step(both, start, end)
    both = ccd.CollisionMesh.from_arrays([(start[:3], FACES[:1]), (start[3:], FACES[:1])], kinematic=[0, 1])
    assert ccd.collision_free_step(both, start, end) == 1.0


def test_pairs_that_share_a_vertex_are_left_out_alike():
    sheet = trimesh.creation.box().subdivide()
    faces = sheet.faces.astype(np.int64)
    theirs = ipctk.CollisionMesh(np.ascontiguousarray(sheet.vertices), ipctk.edges(faces), faces)
    ours = ccd.CollisionMesh.from_arrays([(np.asfortranarray(sheet.vertices), faces)])
    moved = sheet.vertices * 1.01
    found = ipctk.Candidates()
    found.build(theirs, sheet.vertices, moved, 0.0)
    pairs = ccd.find_candidates(ours, sheet.vertices, moved)
    assert {(pair.vertex_id, pair.face_id) for pair in found.fv_candidates} == set(map(tuple, pairs.vertex_face))
    assert not any(vertex in faces[face] for vertex, face in pairs.vertex_face) and len(pairs.vertex_face)


def test_candidates_are_the_same_pairs_with_vertex_and_face_exchanged():
    theirs, ours, start, end = _falling_face(1.0)
    found = ipctk.Candidates()
    found.build(theirs, start, end, 0.0)
    pairs = ccd.find_candidates(ours, start, end)
    assert {(pair.vertex_id, pair.face_id) for pair in found.fv_candidates} == set(map(tuple, pairs.vertex_face))
    contacts = ccd.mesh_ccd(ours, start, end).contacts
    of_face = contacts.primitives[contacts.kind == ccd.PairKind.VERTEX_FACE]
    assert {tuple(pair) for pair in of_face} <= {(pair.vertex_id, pair.face_id) for pair in found.fv_candidates}


@pytest.mark.parametrize("end, is_free", [(1e-9, True), (0.5, True), (0.0, False), (-1.0, False)])
def test_a_free_step_is_true_in_both(end, is_free):
    theirs, ours, start, stop = _falling_face(1.0, end)
    assert ipctk.is_step_collision_free(theirs, start, stop) is is_free
    assert ccd.is_step_collision_free(ours, start, stop, tolerance=1e-12) is is_free


def test_a_start_in_contact_gives_no_step_in_both():
    theirs, ours, start, stop = _falling_face(0.0)
    assert ipctk.compute_collision_free_stepsize(theirs, start, stop) == 0.0
    assert ccd.collision_free_step(ours, start, stop) == 0.0
    statuses = ccd.mesh_ccd(ours, start, stop).contacts.status
    assert (statuses == ccd.CCDStatus.INITIAL_CONTACT).any()


@pytest.mark.parametrize("gap", [1.0, 1e-2, 4e-4, 1e-4, 1e-5])
@pytest.mark.parametrize("rescaling", [0.8, 0.5])
def test_the_options_of_the_page_keep_the_gap_that_ipctk_keeps(gap, rescaling):
    """Theirs bisects to its tolerance, 1e-6 of the motion or of the gap, and stops that much earlier."""
    theirs, ours, start, end = _falling_face(gap)
    narrow = ipctk.TightInclusionCCD(conservative_rescaling=rescaling)
    step = ipctk.compute_collision_free_stepsize(theirs, start, end, narrow_phase_ccd=narrow)
    kept = min(1e-4, (1 - rescaling) * gap)
    assert kept <= gap - step * (1 + gap) <= kept + 1e-6 * (1 + gap)
    options = {"minimum_separation": 1e-4, "start_gap_fraction": 1 - rescaling, "length_scale": 1.0}
    ours_step = ccd.collision_free_step(ours, start, end, **options)
    assert gap - ours_step * (1 + gap) == pytest.approx(kept, rel=1e-6)


def test_additive_ccd_keeps_a_tenth_of_the_gap_and_ours_nothing():
    theirs, ours, start, end = _falling_face(1.0)
    step = ipctk.compute_collision_free_stepsize(theirs, start, end, narrow_phase_ccd=ipctk.AdditiveCCD())
    assert 1 - 2 * step == pytest.approx(0.1)
    assert 1 - 2 * ccd.collision_free_step(ours, start, end) == pytest.approx(0, abs=1e-12)


def test_minimum_distances_are_lengths_there_and_multiples_of_a_length_here():
    theirs, ours, start, end = _falling_face(1.0)
    quick = ipctk.TightInclusionCCD(tolerance=1e-3)  # with the default it takes 13 s for the same distance
    step = ipctk.compute_collision_free_stepsize(theirs, start, end, min_distance=0.1, narrow_phase_ccd=quick)
    assert 1 - 2 * step == pytest.approx(0.1, abs=1e-3)
    step = ccd.collision_free_step(ours, start, end, minimum_separation=0.1, length_scale=1.0)
    assert 1 - 2 * step == pytest.approx(0.1, abs=1e-9)


def _along_the_diagonal():
    """A point that crosses a face at right angles, both oblique to all axes."""
    normal = np.ones(3) / np.sqrt(3)
    side = np.array([1.0, -1, 0]) / np.sqrt(2)
    other = np.cross(normal, side)
    face = 9 * np.array([side - other / 2, -side - other / 2, other])
    return np.vstack([2 * normal, face]), np.vstack([-2 * normal, face])


def test_a_distance_of_the_maximum_norm_is_larger_along_the_diagonal():
    start, end = _along_the_diagonal()
    hit, tight = ipctk.TightInclusionCCD().point_triangle_ccd(*start, *end, min_distance=0.3)
    _, additive = ipctk.AdditiveCCD().point_triangle_ccd(*start, *end, min_distance=0.3)
    ours = ccd.vertex_face_ccd(start[None], end[None], minimum_separation=0.3, length_scale=1.0).toi[0]
    assert hit
    assert 2 - 4 * tight == pytest.approx(0.3 * np.sqrt(3), abs=1e-3)
    assert 2 - 4 * ours == pytest.approx(0.3 * np.sqrt(3), abs=1e-5)
    assert 2 - 4 * additive == pytest.approx(0.3 + 0.1 * 1.7)  # a tenth of what is beyond the distance
    assert ipctk.point_triangle_distance(*start) == pytest.approx(2.0**2)


def test_parameters_are_their_closest_points():
    corner, u, v = FACE[0], FACE[1] - FACE[0], FACE[2] - FACE[0]
    point = corner + 0.2 * u + 0.3 * v
    start, end = np.vstack([point + [0, 0, 1], FACE]), np.vstack([point - [0, 0, 1], FACE])
    assert ipctk.point_triangle_closest_point(point, *FACE) == pytest.approx([0.2, 0.3])
    assert ccd.vertex_face_ccd(start[None], end[None]).parameters[0] == pytest.approx([0.2, 0.3])
    edges = np.array([[-1.0, 0, 0], [3, 0, 0], [0, -1, 1], [0, 4, 1]])
    below = edges - [[0, 0, 0], [0, 0, 0], [0, 0, 2], [0, 0, 2]]
    assert ipctk.edge_edge_closest_point(*edges) == pytest.approx([0.25, 0.2])
    assert ccd.edge_edge_ccd(edges[None], below[None]).parameters[0] == pytest.approx([0.25, 0.2])


def test_no_contact_is_infinity_here():
    """Of theirs only the first of the two values counts then; the second may be any number."""
    start, _ = _along_the_diagonal()
    assert not ipctk.TightInclusionCCD().point_triangle_ccd(*start, *start)[0]
    result = ccd.vertex_face_ccd(start[None], start[None])
    assert result.toi[0] == np.inf and not result.hit[0]


def test_point_and_segment_in_the_plane():
    start = np.array([[0.5, 1.0], [0, 0], [1, 0]])
    end = np.array([[0.5, -1.0], [0, 0], [1, 0]])
    hit, toi = ipctk.TightInclusionCCD().point_edge_ccd(*start, *end)
    assert hit and toi <= 0.5
    assert ccd.point_segment_ccd(start[None], end[None]).toi[0] == pytest.approx(0.5)


def test_defaults_are_those_of_the_page():
    theirs = ipctk.TightInclusionCCD()
    assert (theirs.tolerance, theirs.max_iterations, theirs.conservative_rescaling) == (1e-6, 10_000_000, 0.8)
    assert ipctk.AdditiveCCD().conservative_rescaling == 0.9


def test_every_name_of_ipctk_on_the_page_exists():
    names = (
        "CollisionMesh edges make_static_obstacle_filter Candidates compute_collision_free_stepsize AdditiveCCD "
        "is_step_collision_free TightInclusionCCD point_triangle_distance point_triangle_closest_point "
        "edge_edge_closest_point has_intersections"
    ).split()
    text = PAGE.read_text(encoding="utf-8")
    for name in names:
        assert hasattr(ipctk, name) and name in text, name
    for name in ("point_triangle_ccd", "edge_edge_ccd", "point_edge_ccd", "point_point_ccd"):
        assert hasattr(ipctk.TightInclusionCCD, name) and name in text, name
    assert "True if <b>any</b> collisions occur" in ipctk.is_step_collision_free.__doc__


def test_minimum_distance_is_that_of_additive_ccd_which_stops_before_it():
    rng = np.random.default_rng(5)
    additive = ipctk.AdditiveCCD(conservative_rescaling=0.9)
    shares = []
    for distance in 10.0 ** rng.uniform(-5, -2.3, 12):
        start = (rng.random((120, 1, 3)) + 0.04 * rng.normal(size=(120, 3, 3))).reshape(-1, 3)
        faces = np.arange(len(start), dtype=np.int32).reshape(-1, 3)
        mesh = ccd.CollisionMesh.from_arrays([(start, faces)])
        close = ccd.mesh_ccd(mesh, start, start, minimum_distance=2 * distance).contacts
        others = np.unique(
            [
                mesh.faces[j, 0] if k == 0 else mesh.edges[j, 0]
                for k, (_, j) in zip(close.kind, close.primitives, strict=True)
            ]
        )
        keep = np.setdiff1d(np.arange(120), others.astype(int) // 3)
        start = start.reshape(-1, 3, 3)[keep].reshape(-1, 3)
        faces = faces[: len(keep)]
        end = start + 0.05 * rng.normal(size=start.shape)
        theirs = ipctk.CollisionMesh(start, ipctk.edges(faces), faces)
        step = ipctk.compute_collision_free_stepsize(
            theirs, start, end, min_distance=distance, narrow_phase_ccd=additive
        )
        ours = ccd.CollisionMesh.from_arrays([(start, faces)])
        shares.append(step / ccd.collision_free_step(ours, start, end, minimum_distance=distance))
    # theirs leaves a tenth of the gap by design
    assert max(shares) <= 1.0 and np.median(shares) > 0.8
