"""What is near at one time, and how far vertices may move: hard pairs, what a pair says, and launches that overflow."""

import pickle

import numpy as np
import pytest
from distance_oracle import exact_distance
from hard_cases import FAMILIES
from hard_contacts import first_of_pair
from laws.calls import on_device
from laws.outputs import different, outputs_of, rows_of
from oracle import exact_gap
from scenes import FACE, NO_FACES, crowd_of_all_kinds, pairs_in_worlds, stacked

import ccd_warp as ccd
from ccd_warp._results import shared_features

KIND = ccd.PairKind
CORNERS = {KIND.VERTEX_FACE: 4, KIND.EDGE_EDGE: 4, KIND.POINT_SEGMENT: 3, KIND.POINT_POINT: 2}


def crowd(**arguments):
    """Three bodies of faces, cables and particles, close together: mesh and positions."""
    return crowd_of_all_kinds(np.random.default_rng(4), count=3, **arguments)[:2]


def check_same(found, expected):
    assert different(outputs_of(found), outputs_of(expected)) == []


# --- hard pairs ---


def hard_pairs(kind, each, rng):
    """Of all families, and with points nearly in one place; as they are, or 1e-12 of their size to tenfold apart."""
    name, corners = kind.name.lower().replace("_", "-"), CORNERS[kind]
    points = rng.integers(0, 3, (20 * each, corners, 3)).astype(float)
    for pair in points:
        for i, j in rng.integers(0, corners, (rng.integers(1, 4), 2)):
            exponent = rng.integers(30, 54)
            if rng.random() < 0.3:  # so near the origin that squares of sides underflow
                pair[j], exponent = 0.0, rng.integers(505, 545)
            pair[i] = pair[j] + rng.integers(-2, 3, 3) * 2.0**-exponent
    pairs = np.concatenate([*(x for family in FAMILIES.values() for x in family(name, each, rng)), points])
    mesh, moved = pairs_in_worlds(name, pairs, pairs)[0], pairs.copy()
    found = ccd.find_proximity(mesh, mesh.vertices, 1e300, pair_kinds=[kind])
    direction = np.where(found.distance[:, None] > 0, found.direction, rng.standard_normal((len(pairs), 3)))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    apart = 10 ** rng.uniform(-12, 1, len(pairs)) * np.ptp(pairs, axis=1).max(axis=1)
    moved[:, first_of_pair(name)] += ((apart - found.distance)[:, None] * direction)[:, None]
    return name, np.concatenate([pairs, moved])


@pytest.mark.parametrize("each", [4, pytest.param(610, marks=pytest.mark.long)])  # 610: 100,040 pairs
@pytest.mark.parametrize("kind", CORNERS, ids=lambda kind: kind.name.lower())
def test_distances_of_hard_pairs_and_bounds_are_exact_to_the_last_digits_of_their_size(kind, each):
    """In worlds; bounds of displacements, and start distances in both norms."""
    (name, pairs), of_kind = hard_pairs(kind, each, np.random.default_rng(int(kind))), {"pair_kinds": [kind]}
    mesh = pairs_in_worlds(name, pairs, pairs)[0]
    found = ccd.find_proximity(mesh, mesh.vertices, 1e300, **of_kind)
    assert found.world.tolist() == list(range(len(pairs)))  # none is left out
    bounds = ccd.displacement_bounds(mesh, mesh.vertices, 1e300, **of_kind).reshape(len(pairs), -1)
    assert (bounds == bounds[:, :1]).all()
    least = [2 * bounds[:, 0]]
    for far in ({"minimum_distance": 1e300}, {"minimum_separation": 1.0, "length_scale": 1e300}):
        starts = ccd.CollisionPipeline(mesh, **far, **of_kind)._start_distances()
        share, length = starts.of(mesh.vertices).reshape(len(pairs), -1, 2)[:, 0].T
        kept, lost = share * 1e300, 1e-15 * length  # of shares that may be subnormal
        assert ((length - lost - 2e-23 <= kept) & (kept <= length + lost)).all()
        least.append(length)
    exact = np.array([[measure(name, x, x, 0.0) for measure in (exact_distance, exact_gap)] for x in pairs])
    apart = pairs[:, :, None] - pairs[:, None]
    longest = np.maximum(np.abs(apart).max(axis=(1, 2, 3)), 1e-300)  # by which squares neither overflow nor vanish
    size = longest * np.linalg.norm(apart / longest[:, None, None, None], axis=3).max(axis=(1, 2))
    assert (np.abs(found.distance - exact[:, 0]) <= 1e-15 * size).all()
    assert (np.abs(np.linalg.norm(found.direction, axis=1) - (found.distance > 0)) <= 1e-15).all()
    for bound, truth in zip(least, exact[:, [0, 0, 1]].T, strict=True):
        assert (bound <= truth).all()
        assert (bound >= truth - 3.5e-15 * size - 1e-300).all()


def test_a_pair_exactly_at_the_distance_is_found_and_one_beyond_it_is_not():
    points = [([[0.0, 0, 0]], NO_FACES), ([[3.0, 4, 12]], NO_FACES)]
    mesh = ccd.CollisionMesh.from_arrays(points, codimensional_points=True)
    for scale in (1.0, 2.0**-520, 2.0**500):
        distances = 13 * scale, 13 * scale * (1 - 4e-15), 1e308
        near = [ccd.find_proximity(mesh, scale * mesh.vertices, distance) for distance in distances]
        assert near[0].distance.tolist() == [13 * scale] and [*map(len, near)] == [1, 0, 1]


def test_among_subnormal_numbers_the_unit_counts_besides():
    rng, unit, faces = np.random.default_rng(0), 2.0**-1074, np.arange(24).reshape(-1, 3)
    for size in (20, 300, 5000):
        whole = [rng.integers(0, size, (24, 3)).astype(float) for _ in range(2)]
        exact, mesh = (ccd.CollisionMesh.from_arrays([(s * x, faces) for x in whole]) for s in (1.0, unit))
        distance = float(size // 4)
        truth = ccd.find_proximity(exact, exact.vertices, size)
        found = ccd.find_proximity(mesh, mesh.vertices, distance * unit)
        of_pair = dict(zip(rows_of(truth), truth.distance, strict=True))
        assert len(found) > 5 and {row for row, d in of_pair.items() if d < distance - 1e-9} <= {*rows_of(found)}
        of_rows = np.array([of_pair[row] for row in rows_of(found)])
        assert of_rows.max() <= distance + 2.0**5 and np.abs(found.distance / unit - of_rows).max() <= 1.0


# --- what a pair says ---


def test_a_vertex_near_the_common_edge_of_two_faces_is_one_proximity_in_several_pairs():
    roof = [[0.0, 0, 0], [2, 0, 0], [1, -1, -0.5], [1, 1, -0.5]]
    needle = [[1, 0, 0.25], [1, 0.1, 3], [1, -0.1, 3]]
    mesh = ccd.CollisionMesh.from_arrays([(roof, [[0, 1, 2], [0, 1, 3]]), (needle, FACE)])
    found = ccd.find_proximity(mesh, mesh.vertices, 0.3)
    assert [row[0] for row in rows_of(found)] == [KIND.VERTEX_FACE] * 2 + [KIND.EDGE_EDGE] * 2
    assert found.distance.tolist() == [0.25] * 4
    # v, f0 and f1 span the closest features of the first pair, and the ridge with one end of the edge those of the last
    assert found.features.tolist()[::3] == [1 + 2 + 4, 1 + 2 + 4]
    assert found.direction.tolist() == [[0, 0, 1]] * 2 + [[0, 0, -1]] * 2
    once = found.unique()
    assert rows_of(once) == [(KIND.VERTEX_FACE, 4, 0)]
    assert once.points.tolist() == [[[1, 0, 0.25], [1, 0, 0]]] and once.weights.tolist() == [[1, -0.5, -0.5, 0]]
    assert once.vertices.tolist() == [[4, 0, 1, 2]] and once.bodies.tolist() == [[1, 0]] and once.world.tolist() == [0]


def test_features_with_one_hash_are_told_apart(monkeypatch):
    found, bits = ccd.find_proximity(*crowd(), 0.1), shared_features.index_bits
    once, num_vertices = found.unique(), found.mesh.num_vertices
    hash_bits = 63 - bits(num_vertices) - bits(len(found))
    # vertices take nearly all bits of a key, so that one is left for the hash
    monkeypatch.setattr(shared_features, "index_bits", lambda n: bits(n) + (n == num_vertices) * (hash_bits - 1))
    again = found.unique()
    check_same(again, once)
    assert again.shared_by.tolist() == once.shared_by.tolist() and max(again.shared_by) > 2


def test_a_choice_of_pairs_a_copy_and_the_text():
    mesh, x = stacked(0.0, 0.1)
    found = ccd.find_proximity(mesh, x, 0.2)
    chosen, points = found[found.distance < 0.11], found.points.copy()
    check_same(pickle.loads(pickle.dumps(chosen)), chosen)
    assert repr(found).startswith(f"Proximities({len(found)} pairs: {len(found)} of body 0 and body 1; the least dist")
    assert repr(found[:0]) == "Proximities(no pair)" and "vertex-face" in found._repr_html_()
    x += 1.0  # the caller's positions may change afterwards
    np.testing.assert_array_equal(found.points, points)
    with pytest.raises(AttributeError, match="no attribute 'kinds'"):
        _ = found.kinds


# --- on the device ---


def test_pairs_beyond_a_capacity_are_told_by_a_flag_bound_by_zero_and_found_after_reserve():
    mesh, x = crowd()
    expected, bounds, array = ccd.find_proximity(mesh, x, 0.1), ccd.displacement_bounds(mesh, x, 0.1), on_device(x)
    for capacities, flag in (({"max_pairs": 20}, "PAIRS_OVERFLOW"), ({"max_contacts": 20}, "CONTACTS_OVERFLOW")):
        pipeline = ccd.CollisionPipeline(mesh, **capacities)
        result = pipeline.launch_proximity(array, 0.1)
        assert ccd.LaunchFlag(int(result.flags.numpy()[0])) == ccd.LaunchFlag[flag] and result.world_flags.numpy().any()
        assert {*rows_of(result.to_host())} < {*rows_of(expected)}
        found = pipeline.launch_displacement_bounds(array, 0.1).to_host()
        assert ((found == bounds) | (found == 0)).all() and ("max_contacts" in capacities or (found < bounds).any())
        pipeline.reserve(max_pairs=20_000, max_contacts=20_000)
        check_same(pipeline.launch_proximity(array, 0.1).to_host(), expected)
        assert np.array_equal(pipeline.launch_displacement_bounds(array, 0.1).to_host(), bounds)


def test_a_coordinate_that_is_not_finite_costs_its_world_alone():
    mesh, x = crowd(vertex_world=[1] * 27 + [0] * 54)
    pipeline = ccd.CollisionPipeline(mesh, max_pairs=20_000, max_contacts=20_000)
    expected, bounds = ccd.find_proximity(mesh, x, 0.1), ccd.displacement_bounds(mesh, x, 0.1)
    for value in (np.nan, np.inf):
        bad = np.where(np.arange(len(x))[:, None] == 4, value, x)
        for launch in (pipeline.launch_proximity, pipeline.launch_displacement_bounds):
            result = launch(on_device(bad), 0.1)
            assert result.world_flags.numpy().tolist() == [0, ccd.LaunchFlag.INVALID_INPUT]
            found = result.to_host()
            if launch == pipeline.launch_proximity:
                check_same(found, expected[~(expected.vertices == 4).any(axis=1)])
            else:
                np.testing.assert_array_equal(found, np.where(mesh.vertex_world == 1, 0.0, bounds))
        with pytest.raises(ValueError, match=r"^positions"):
            ccd.find_proximity(mesh, bad, 0.1)


def test_particles_among_more_half_spaces_than_vertices_are_listed_in_order():
    particles, normals = np.random.default_rng(0).normal(size=(2, 1000, 3))
    bodies = [(particles[:20], []), *(ccd.HalfSpace(-3.0 * n / np.linalg.norm(n), n) for n in normals)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True)
    found = ccd.find_proximity(mesh, mesh.vertices, 10.0)
    rows = np.column_stack([found.kind, found.primitives]).tolist()
    assert len(rows) == 20 * 1000 + 20 * 19 // 2 and rows == sorted(rows)
