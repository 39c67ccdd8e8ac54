"""What is near at one time, judged by exact distances over all pairs."""

import pickle

import numpy as np
import pytest
import scenes
import warp as wp
from distance_oracle import exact_distance
from emulated.steps import STEPS
from exact_proximity import HALF_SPACES, SCENES, check_proximities, few, size_of
from hard_cases import FAMILIES
from launches import on_device
from scenes import FACE, TRIANGLE

import ccd_warp as ccd

KIND = ccd.PairKind
FIELDS = ("kind", "primitives", "parameters", "distance", "direction", "features")
NO_FACES = np.zeros((0, 3), dtype=int)


def check_same(found, expected):
    """Two results are equal in every bit."""
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def rows_of(found):
    """The pairs as (kind, first, second)."""
    return [(KIND(k), *pair) for k, pair in zip(found.kind.tolist(), found.primitives.tolist(), strict=True)]


# --- against all pairs ---


@pytest.mark.parametrize("scene", SCENES)
def test_the_pairs_and_their_distances_are_those_of_exact_arithmetic(scene, device):
    mesh = SCENES[scene]()
    total = 0
    for distance, broad_phase in ((0.04, "tree"), (0.1, "hash")):
        found = ccd.find_proximity(mesh, mesh.vertices, distance, broad_phase=broad_phase, device=device)
        total += check_proximities(mesh, mesh.vertices, distance, found)
    assert total > 30


def hard_pairs(kind, corners, rng):
    """Pairs of all families of hard cases, and pairs on a lattice in which points are nearly in one place."""
    families = [x for family in FAMILIES.values() for x in family(kind, 4, rng)]
    points = rng.integers(0, 3, (80, corners, 3)).astype(float)
    for pair in points:
        for i, j in rng.integers(0, corners, (rng.integers(1, 4), 2)):
            pair[i] = pair[j] + rng.integers(-2, 3, 3) * 2.0 ** -rng.integers(30, 54)
    return np.concatenate([*families, points])


@pytest.mark.parametrize(
    "kind", [kind for kind in KIND if kind != KIND.VERTEX_PLANE], ids=lambda kind: kind.name.lower()
)
def test_distances_of_hard_pairs_and_bounds_are_exact_to_the_last_digits_of_their_size(kind):
    rng = np.random.default_rng(int(kind))
    name = kind.name.lower().replace("_", "-")
    pairs = hard_pairs(name, {KIND.POINT_SEGMENT: 3, KIND.POINT_POINT: 2}.get(kind, 4), rng)
    count, corners, _ = pairs.shape
    bodies = []
    for points in pairs:
        if kind == KIND.EDGE_EDGE:
            bodies += [(points[:2], NO_FACES, [[0, 1]]), (points[2:], NO_FACES, [[0, 1]])]
        else:
            rest = points[1:]
            other = {4: (rest, FACE), 3: (rest, NO_FACES, [[0, 1]]), 2: (rest, NO_FACES)}[corners]
            bodies += [(points[:1], NO_FACES), other]
    world = np.repeat(np.arange(count), corners)
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=kind != KIND.EDGE_EDGE, vertex_world=world)
    found = ccd.find_proximity(mesh, mesh.vertices, 1e300, pair_kinds=[kind])
    assert found.world.tolist() == list(range(count))  # each pair is in a world of its own, and none is left out
    bounds = ccd.displacement_bounds(mesh, mesh.vertices, 1e300, pair_kinds=[kind]).reshape(count, corners)
    assert (bounds == bounds[:, :1]).all()
    rows = zip(pairs, found.distance, found.direction, bounds[:, 0], strict=True)
    for points, distance, direction, bound in rows:
        largest = np.abs(points).max()
        size = 0.0 if largest == 0.0 else largest * size_of(points / largest)
        exact = exact_distance(name, points, points, 0.0)
        assert abs(distance - exact) <= 1e-15 * size
        assert abs(np.linalg.norm(direction) - (distance > 0)) <= 1e-15
        assert exact - 3e-15 * size - 1e-300 <= 2 * bound <= exact


def test_a_gap_of_a_millionth_is_measured_a_hundred_million_away_from_the_origin():
    rng = np.random.default_rng(3)
    faces, points = 1e8 + rng.uniform(-1, 1, (40, 3, 3)), []
    for face in faces:
        normal = np.cross(face[1] - face[0], face[2] - face[0])
        points.append(rng.dirichlet(np.ones(3)) @ face + 1e-6 * normal / np.linalg.norm(normal))
    bodies = [body for p, f in zip(points, faces, strict=True) for body in ((p[None], NO_FACES), (f, FACE))]
    mesh = ccd.CollisionMesh.from_arrays(
        bodies, codimensional_points=True, vertex_world=np.repeat(np.arange(40), 4), self_collision=False
    )
    assert check_proximities(mesh, mesh.vertices, 2e-6, ccd.find_proximity(mesh, mesh.vertices, 2e-6)) > 20


@pytest.mark.parametrize("scale", [1.0, 2.0**-520, 2.0**500])
def test_a_pair_exactly_at_the_distance_is_found_and_one_beyond_it_is_not(scale):
    mesh = ccd.CollisionMesh.from_arrays(
        [([[0.0, 0, 0]], NO_FACES), ([[3.0, 4, 12]], NO_FACES)], codimensional_points=True
    )
    x = scale * mesh.vertices
    assert ccd.find_proximity(mesh, x, 13 * scale).distance.tolist() == [13 * scale]
    assert len(ccd.find_proximity(mesh, x, 13 * scale * (1 - 4e-15))) == 0
    assert len(ccd.find_proximity(mesh, x, 1e308)) == 1


@pytest.mark.parametrize("per", ["body", "vertex"])
def test_radii_of_both_primitives_are_added_to_the_distance(per):
    radius = [0.01, 0.05] if per == "body" else np.random.default_rng(5).uniform(0, 0.06, 54)
    mesh = few(static=[1], radius=radius)
    found = ccd.find_proximity(mesh, mesh.vertices, 0.01)
    check_proximities(mesh, mesh.vertices, 0.01, found)
    assert len(found) > 2 * len(ccd.find_proximity(few(static=[1]), mesh.vertices, 0.01))


def test_points_of_a_launch_are_those_of_surfaces_with_the_radii_that_it_had(device):
    of_mesh, later = np.random.default_rng(5).uniform(0, 0.06, (2, 54))
    mesh, now = (few(half_spaces=HALF_SPACES, radius=radius) for radius in (of_mesh, later))
    pipeline = ccd.CollisionPipeline(mesh, device=device)
    pipeline.radius.assign(later)
    found = pipeline.launch_proximity(on_device(mesh.vertices, device), 0.05).to_host()
    check_proximities(now, mesh.vertices, 0.05, found)
    centres = (found.weights[..., None] * mesh.vertices[found.vertices]).sum(axis=1)  # of the primitives themselves
    of_bodies = found.kind != int(ccd.PairKind.VERTEX_PLANE)
    assert np.allclose(centres[of_bodies], (found.distance[:, None] * found.direction)[of_bodies], atol=1e-14)


# --- what a pair says ---


def test_a_vertex_near_the_common_edge_of_two_faces_is_one_proximity_in_several_pairs():
    roof = [[0.0, 0, 0], [2, 0, 0], [1, -1, -0.5], [1, 1, -0.5]]
    needle = [[1, 0, 0.25], [1, 0.1, 3], [1, -0.1, 3]]
    mesh = ccd.CollisionMesh.from_arrays([(roof, [[0, 1, 2], [0, 1, 3]]), (needle, FACE)])
    ridge = mesh.edges.tolist().index([0, 1])
    found = ccd.find_proximity(mesh, mesh.vertices, 0.3)
    assert rows_of(found) == [
        (KIND.VERTEX_FACE, 4, 0),
        (KIND.VERTEX_FACE, 4, 1),
        (KIND.EDGE_EDGE, ridge, mesh.edges.tolist().index([4, 5])),
        (KIND.EDGE_EDGE, ridge, mesh.edges.tolist().index([4, 6])),
    ]
    assert found.distance.tolist() == [0.25] * 4
    # v, f0 and f1 span the closest features of the first pair, and the ridge with one end of the edge those of the last
    assert found.features.tolist()[::3] == [1 + 2 + 4, 1 + 2 + 4]
    assert found.direction.tolist() == [[0, 0, 1]] * 2 + [[0, 0, -1]] * 2
    once = found.unique()
    assert rows_of(once) == [(KIND.VERTEX_FACE, 4, 0)]
    assert once.points.tolist() == [[[1, 0, 0.25], [1, 0, 0]]] and once.weights.tolist() == [[1, -0.5, -0.5, 0]]
    assert once.vertices.tolist() == [[4, 0, 1, 2]] and once.bodies.tolist() == [[1, 0]] and once.world.tolist() == [0]


def test_unique_keeps_each_two_vertices_and_each_vertex_and_edge_once():
    mesh, x, _ = STEPS["every kind of pair"].make()
    found = ccd.find_proximity(mesh, x, 0.1)

    def features(proximities):
        spanned = []
        rows = zip(proximities.vertices, proximities.features, proximities.kind, strict=True)
        for vertices, bits, kind in rows:
            chosen = [int(v) if bits >> k & 1 else None for k, v in enumerate(vertices)]
            cut = 1 if kind == int(KIND.VERTEX_FACE) else 2
            spanned.append(frozenset(frozenset(side) - {None} for side in (chosen[:cut], chosen[cut:])))
        return spanned

    every, once = features(found), features(found.unique())
    assert len(once) < len(every) and len({*once}) == len(once) and {*once} == {*every}
    inside = [each for each in every if sum(map(len, each)) == 4]
    assert len({*inside}) == len(inside)  # one pair alone can have the inside of a face, or of two edges


def test_weights_and_direction_are_the_derivative_of_the_distance():
    mesh = few(6)
    x = mesh.vertices
    found = ccd.find_proximity(mesh, x, 0.1)
    found = found[found.distance > 0.01]
    moves = np.random.default_rng(0).standard_normal(x.shape)
    slopes = np.einsum("mk,mkd,md->m", found.weights, moves[found.vertices], found.direction)
    step = 1e-6
    row = {r: k for k, r in enumerate(rows_of(found))}
    moved = ccd.find_proximity(mesh, x + step * moves, 0.11)
    for r, distance in zip(rows_of(moved), moved.distance, strict=True):
        if r in row:  # the second derivative is at most the square of the moves over the least distance
            assert distance == pytest.approx(found.distance[row[r]] + step * slopes[row[r]], abs=1e-8)
    assert len(row) > 50


def test_what_is_in_one_place_has_distance_zero_and_no_direction():
    mesh, x = scenes.stacked(0.0, 0.0)
    x[5] = x[0]
    found = ccd.find_proximity(mesh, x, 0.0)
    at_vertex = found[(found.vertices[:, 0] == 0) & (found.kind == int(KIND.VERTEX_FACE))]
    assert len(at_vertex) == 1 and at_vertex.distance[0] == 0 and (at_vertex.direction == 0).all()
    assert (found.distance < 1e-15).all()


def test_a_choice_of_pairs_a_copy_and_the_text():
    mesh, x = scenes.stacked(0.0, 0.1)
    found = ccd.find_proximity(mesh, x, 0.2)
    chosen = found[found.distance < 0.11]
    check_same(pickle.loads(pickle.dumps(chosen)), chosen)
    assert len(found[[]]) == 0 and len(found[:3]) == 3
    assert repr(found).startswith(f"Proximities({len(found)} pairs: {len(found)} of body 0 and body 1; the least dist")
    assert repr(found[:0]) == "Proximities(no pair)" and "vertex-face" in found._repr_html_()
    with pytest.raises(TypeError, match=r"^index is 0; expected a slice, a mask or a list of indices$"):
        found[0]


def test_a_vertex_in_a_half_space_is_below_its_plane_by_its_depth():
    ground = ccd.HalfSpace([0, 0, 1], [0, 0, 5])
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), ground], radius=[0.25, 0.0])
    x = mesh.vertices + [0, 0, 1.5] * np.arange(3)[:, None]
    found = ccd.find_proximity(mesh, x, 0.25)
    assert rows_of(found) == [(KIND.VERTEX_PLANE, 0, 0), (KIND.VERTEX_PLANE, 1, 0)]
    assert found.distance.tolist() == [-1.0, 0.5] and found.direction.tolist() == [[0, 0, 1]] * 2
    assert found.points[:, 1, 2].tolist() == [1.0, 1.0] and found.bodies.tolist() == [[0, 1]] * 2
    assert rows_of(found.unique()) == rows_of(found) and found.weights.tolist() == [[1, 0, 0, 0]] * 2


# --- what results do not depend on ---


def test_the_positions_of_the_caller_may_change_afterwards():
    mesh, x = scenes.stacked(0.0, 0.1)
    found = ccd.find_proximity(mesh, x, 0.2)
    expected = ccd.find_proximity(mesh, x, 0.2).points
    x += 1.0
    np.testing.assert_array_equal(found.points, expected)


# --- on the device ---


def launched(pipeline, x, distance, device="cpu", dtype=wp.vec3d):
    result = pipeline.launch_proximity(on_device(x, device, dtype), distance)
    assert result.flags.numpy()[0] == 0
    return result.to_host()


def test_vertices_bodies_and_worlds_of_what_is_near_are_on_the_device(device):
    mesh = few(half_spaces=HALF_SPACES, vertex_world=[1] * 27 + [0] * 27)
    pipeline = ccd.CollisionPipeline(mesh, device=device)
    result = pipeline.launch_proximity(on_device(mesh.vertices, device), 0.1)
    host, count = result.to_host(), len(result.to_host())
    order = np.lexsort((*result.primitives.numpy()[:count].T[::-1], result.kind.numpy()[:count]))
    assert {*host.world} == {0, 1} and {*host.kind} == {*ccd.PairKind}
    for name in ("vertices", "weights", "normal", "bodies", "world"):
        assert np.array_equal(getattr(result, name).numpy()[:count][order], getattr(host, name))
    assert result.world is result.world


@pytest.mark.parametrize("scene", SCENES)
def test_what_is_unique_on_the_device_is_so_on_the_host(scene, device):
    mesh = SCENES[scene]()
    pipeline = ccd.CollisionPipeline(mesh, device=device)
    x = on_device(mesh.vertices, device, wp.vec3d if mesh.dimension == 3 else wp.vec2d)
    for distance in (0.1, 0.0):
        result = pipeline.launch_proximity(x, distance)
        pairs = np.column_stack([result.kind.numpy(), result.primitives.numpy()])[result.unique().numpy()]
        once = result.to_host().unique()
        assert np.array_equal(pairs[np.lexsort(pairs.T[::-1])], np.column_stack([once.kind, once.primitives]))
        assert len(once) < len(result.to_host()) or distance == 0.0


def test_a_graph_holds_what_a_force_needs():
    mesh, x, _ = STEPS["every kind of pair"].make()
    pipeline, array = ccd.CollisionPipeline(mesh, max_pairs=20_000, max_contacts=20_000), on_device(0.9 * x)

    def launch():
        result = pipeline.launch_proximity(array, 0.1)
        return result, result.unique(), result.weights, result.normal, result.vertices

    result = pipeline.launch_proximity(array, 0.1)
    with pytest.raises(RuntimeError, match=r"ask for proximities\.unique once before"), wp.ScopedCapture(device="cpu"):
        result.unique()
    launch()
    with wp.ScopedCapture(device="cpu") as capture:
        result, *columns = launch()
    for positions in (x, 1.1 * x, 100.0 * x):
        array.assign(positions)
        wp.capture_launch(capture.graph)
        is_unique, weights, normal, vertices = (column.numpy() for column in columns)
        force, expected = np.zeros((2, *x.shape))
        np.add.at(force, vertices[is_unique], weights[is_unique][..., None] * normal[is_unique][:, None])
        once = ccd.find_proximity(mesh, positions, 0.1).unique()
        np.add.at(expected, once.vertices, once.weights[..., None] * once.normal[:, None])
        assert is_unique.sum() == len(once)
        np.testing.assert_allclose(force, expected, rtol=0, atol=1e-12)  # sums in another order


def test_the_first_search_comes_before_the_capture():
    pipeline, x = ccd.CollisionPipeline(few()), on_device(few().vertices)
    with pytest.raises(RuntimeError, match=r"^a graph is being captured, and this launch was not called before"):
        with wp.ScopedCapture(device="cpu"):
            pipeline.launch_proximity(x, 0.05)


def test_pairs_beyond_a_capacity_are_told_by_a_flag_and_found_after_reserve():
    mesh, x, _ = STEPS["worlds in one place"].make()
    expected = ccd.find_proximity(mesh, x, 0.1)
    array = on_device(x)
    for capacities, flag in (({"max_pairs": 100}, "PAIRS_OVERFLOW"), ({"max_contacts": 100}, "CONTACTS_OVERFLOW")):
        pipeline = ccd.CollisionPipeline(mesh, **capacities)
        result = pipeline.launch_proximity(array, 0.1)
        assert ccd.LaunchFlag(int(result.flags.numpy()[0])) == ccd.LaunchFlag[flag]
        assert result.world_flags.numpy().any()
        assert {*rows_of(result.to_host())} < {*rows_of(expected)}
        pipeline.reserve(max_pairs=20_000, max_contacts=20_000)
        check_same(launched(pipeline, x, 0.1), expected)


def test_a_coordinate_that_is_not_finite_is_flagged_in_its_world_and_costs_the_pairs_of_its_vertex_alone():
    mesh, x, _ = STEPS["worlds in one place"].make()
    pipeline = ccd.CollisionPipeline(mesh, max_pairs=20_000, max_contacts=20_000)
    expected = ccd.find_proximity(mesh, x, 0.1)
    for value in (np.nan, np.inf):
        bad = x.copy()
        bad[4, 1] = value
        result = pipeline.launch_proximity(on_device(bad), 0.1)
        flags = result.world_flags.numpy()
        assert flags[mesh.vertex_world[4]] == ccd.LaunchFlag.INVALID_INPUT and np.count_nonzero(flags) == 1
        lost = (expected.vertices == 4).any(axis=1)
        check_same(result.to_host(), expected[~lost])
        with pytest.raises(ValueError, match=r"^positions"):
            ccd.find_proximity(mesh, bad, 0.1)


def test_a_launch_after_one_with_a_bad_argument_writes_to_the_same_arrays():
    mesh, x = scenes.stacked(0.0, 0.1)
    pipeline = ccd.CollisionPipeline(mesh)
    first = pipeline.launch_proximity(on_device(x), 0.2)
    for bad in (on_device(x[:-1]), x[:, :2].copy(), None):
        with pytest.raises(ValueError, match=r"^positions "):
            pipeline.launch_proximity(bad, 0.2)
    assert pipeline.launch_proximity(on_device(x), 0.2) is first
    assert repr(first) == "DeviceProximities(up to 4,096 pairs on cpu; to_host() reads them)"
    with pytest.raises(TypeError, match="cannot be copied or pickled"):
        pickle.dumps(first)


def test_static_bodies_have_a_row_in_the_positions_of_a_launch():
    mesh, x, _ = scenes.sheet_over_floor()
    pipeline = ccd.CollisionPipeline(mesh)
    with pytest.raises(ValueError, match=f"^positions has 81 rows; expected {len(x)}, one a vertex$"):
        pipeline.launch_proximity(on_device(x[mesh.moving_vertices]), 0.2)


def test_among_subnormal_numbers_the_unit_counts_besides():
    rng, unit = np.random.default_rng(0), 2.0**-1074
    for size in (20, 300, 5000):
        whole = [rng.integers(0, size, (24, 3)).astype(float) for _ in range(2)]
        faces = np.arange(24).reshape(-1, 3)
        exact, mesh = (ccd.CollisionMesh.from_arrays([(s * x, faces) for x in whole]) for s in (1.0, unit))
        distance = float(size // 4)
        truth, found = (
            ccd.find_proximity(exact, exact.vertices, size),
            ccd.find_proximity(mesh, mesh.vertices, distance * unit),
        )
        of_pair = {(k, *p): d for k, p, d in zip(truth.kind, truth.primitives.tolist(), truth.distance, strict=True)}
        rows = [(k, *p) for k, p in zip(found.kind, found.primitives.tolist(), strict=True)]
        assert len(rows) > 5 and {row for row, d in of_pair.items() if d < distance - 1e-9} <= {*rows}
        of_rows = np.array([of_pair[row] for row in rows])
        assert of_rows.max() <= distance + 2.0**5 and np.abs(found.distance / unit - of_rows).max() <= 1.0


def test_the_thin_end_of_a_cable_keeps_the_radius_of_its_thick_end_from_the_ground():
    cable = ([[0.0, 0.0, 0.05], [1.0, 0.0, 0.5], [2.0, 0.0, 0.5]], np.empty((0, 3), dtype=int), [[0, 1], [1, 2]])
    ground = ccd.HalfSpace([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    mesh = ccd.CollisionMesh.from_arrays([cable, ground], radius=[0.0, 0.1, 0.0])
    assert ccd.find_proximity(mesh, mesh.vertices, 0.0).primitives.tolist() == [[0, 0]]
    assert ccd.displacement_bounds(mesh, mesh.vertices, 1.0)[0] == 0.0
