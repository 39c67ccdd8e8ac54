"""What is found at one time, and which boxes overlap, in drawn scenes: as brute force over all pairs finds it."""

import itertools

import numpy as np
import pytest
from scenes import with_static_at_rest

import ccd_warp as ccd
from laws.asked import SEEDS, kinds_of, scene_of
from laws.calls import OF_SEARCH
from laws.outputs import different, outputs_of, rows_of
from laws.scenes import drawn
from laws.truth import candidates, check_sides, displacement_bounds, intersections, plane_value, proximities

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")


def features_of(found, row):
    """The closest features of a pair, each the vertices that span it; None where no other pair can have them."""
    kind, bits = int(found.kind[row]), int(found.features[row])
    if kind == ccd.PairKind.VERTEX_PLANE or (kind == ccd.PairKind.EDGE_EDGE and bits == 15):
        return None
    spanned, cut = [bits >> k & 1 for k in range(4)], 1 if kind == ccd.PairKind.VERTEX_FACE else 2
    sides = (zip(found.vertices[row, of].tolist(), spanned[of], strict=True) for of in (slice(cut), slice(cut, 4)))
    return frozenset(frozenset(vertex for vertex, is_spanned in side if is_spanned) for side in sides)


def first_of_features(found):
    """The first row of each two features, and how many rows have them, in the order of these rows."""
    first = {}
    for row in range(len(found)):
        features = features_of(found, row) or row
        first[features] = first.get(features, (row, 0))[0], first.get(features, (row, 0))[1] + 1
    return np.array([*first.values()], dtype=int).reshape(-1, 2).T


def check_unique(found, mesh, x, distance, **options):
    """Of what was found, the first row of each two features is what is unique, and how many have them."""
    first, shared_by = first_of_features(found)
    for once in (found.unique(), ccd.find_proximity(mesh, x, distance, unique=True, **options)):
        assert rows_of(once) == rows_of(found[first]) and once.shared_by.tolist() == shared_by.tolist()
        assert (once.parameters == found.parameters[first]).all() and (once.points == found.points[first]).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_candidates_are_the_pairs_whose_boxes_overlap(seed):
    scene, mesh, start, end, pairs = scene_of(seed)
    met = pairs.with_planes[: 3 * (mesh.radius is None)].tolist()  # of some the plane is where the enlarged boxes end
    values = [float(plane_value(mesh, k, start[v], start)) / 2 / np.abs(mesh.planes.normals[k]).sum() for v, k in met]
    for inflation in (0.0, 0.25 * scene.size, scene.size / 50, *(value for value in values if value >= 0)):
        expected = candidates(pairs, start, end, inflation)
        for broad_phase in ("tree", "hash"):
            options = scene.only(*OF_SEARCH) | {"broad_phase": broad_phase}
            found = [*vars(ccd.find_candidates(mesh, start, end, inflation, **options).sorted()).values()]
            for kind, pairs_found, expected_pairs in zip(ccd.PairKind, found, expected, strict=True):
                is_asked = kind in kinds_of(scene)
                assert [*map(tuple, pairs_found.tolist())] == (expected_pairs if is_asked else []), kind


def of_any_size(mesh, start, end, seed):
    """A step on a lattice, of any size or many sizes, far away, or with a vertex that flies away."""
    rng, size = np.random.default_rng(seed), max(np.abs([start, end]).max(initial=0.0), 1e-300)
    x, y = (np.clip(np.nan_to_num(values / size), -1, 1) for values in (start, end))
    if seed % 5 == 0:
        x, y = (np.round(8 * values) / 16 for values in (x, y))
    elif seed % 5 == 1:
        x, y = rng.choice([0.0, 5e-324, 1e-310, 1e-150, 1e150, 1.7e308]) * np.stack([x, y])
    elif seed % 5 == 2:
        x, y = 10.0 ** -rng.uniform(0, rng.choice([3, 20, 250]), (len(x), 1)) * np.stack([x, y])
    elif seed % 5 == 3:
        x, y = np.stack([x, y]) + rng.choice([1e7, 1e10, 1e100]) * rng.choice([-1, 1], x.shape[1])
    else:
        y = np.where(np.arange(len(y))[:, None] == rng.integers(len(y)), rng.choice([1e6, 1e15, 1e300]), y)
    return x, with_static_at_rest(mesh, x, y)


@pytest.mark.parametrize("seed", SEEDS)
def test_both_broad_phases_find_the_same_of_any_size(seed):
    scene, mesh, start, end, pairs = scene_of(seed)
    start, end = of_any_size(mesh, start, end, seed)
    expected, answers = candidates(pairs, start, end, 0.0), []
    for broad_phase in ("tree", "hash"):
        found = ccd.find_candidates(mesh, start, end, broad_phase=broad_phase).sorted()
        assert [[*map(tuple, of_kind.tolist())] for of_kind in vars(found).values()] == expected
        given = scene.options | {"broad_phase": broad_phase}
        of_step = [call(mesh, start, end, **given) for call in (ccd.mesh_ccd, ccd.collision_free_step)]
        answers.append(outputs_of(tuple(of_step)))
    assert different(*answers) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_near_and_how_far_vertices_may_move(seed):
    scene, mesh, start, end, pairs = scene_of(seed)
    distance, kept = scene.size / 16, scene.size / 128
    for x in (start, end):
        found = ccd.find_proximity(mesh, x, distance, **scene.only(*OF_SEARCH))
        near = {key: row for key, row in proximities(pairs, x, distance).items() if key[0] in kinds_of(scene)}
        rows = rows_of(found)
        must = {key for key, (exact, radii, _) in near.items() if exact <= distance + radii}
        may = {key for key, (exact, radii, size) in near.items() if exact <= distance + radii + 2e-15 * size}
        assert rows == sorted({*rows}) and must <= {*rows} <= may
        exact, radii, size = np.array([near[row] for row in rows]).reshape(-1, 3).T
        # 1e-15 of the size is what is promised; points add the roundings of positions and weights
        assert (np.abs(found.distance - exact) <= 1e-15 * size).all()
        check_sides(found, pairs)
        spans = (found.features[:, None] >> np.arange(4) & 1 == 1) == (found.weights != 0)
        assert spans[found.kind <= int(ccd.PairKind.EDGE_EDGE)].all()
        of_weights = (
            np.einsum("mk,mkd->md", found.weights, x[found.vertices]) - found.distance[:, None] * found.direction
        )
        is_close = np.linalg.norm(of_weights, axis=1) <= 4e-15 * (size + np.abs(x).max())
        assert is_close[found.kind != int(ccd.PairKind.VERTEX_PLANE)].all()
        between = found.points[:, 0] - found.points[:, 1] - (found.distance - radii)[:, None] * found.direction
        assert (np.linalg.norm(between, axis=1) <= 4e-15 * (size + np.abs(x).max())).all()
        check_unique(found, mesh, x, distance, **scene.only(*OF_SEARCH))
        if "pair_kinds" not in scene.options:
            bounds = ccd.displacement_bounds(mesh, x, distance, minimum_distance=kept, **scene.only(*OF_SEARCH))
            expected, largest = displacement_bounds(pairs, x, distance, kept)
            expected[~pairs.takes_part & ~np.isin(np.arange(len(x)), mesh.planes.vertices)] = np.inf
            lost = 2e-15 * largest + 2.0**-50 * np.where(expected < np.inf, expected, 0.0)  # steps 15 and 16
            assert (bounds <= expected).all() and (bounds >= expected - lost).all()


@pytest.mark.long
@pytest.mark.parametrize("begin", range(160, 2160, 100))
def test_what_is_unique_in_many_more_scenes(begin):
    num_shared = 0
    for seed in range(begin, begin + 100):
        scene = drawn(seed)
        mesh, *ends = scene.make()
        for x, distance in itertools.product(ends, (scene.size / 16, scene.size / 4)):
            found = ccd.find_proximity(mesh, x, distance, **scene.only(*OF_SEARCH))
            check_unique(found, mesh, x, distance, **scene.only(*OF_SEARCH))
            num_shared += len(found) - len(found.unique())
    assert num_shared > 1000


def in_few_places(x, seed):
    """Vertices in few planes and lines, where the last bit decides, of any size; of a large scene none."""
    rng, steps = np.random.default_rng(seed), np.round(3.0 * (x - x.min(initial=0.0)) / max(np.ptp(x), 1e-300))
    ways = steps, 0.1 * steps + 0.3, steps + 2.0**-52 * rng.integers(-1, 2, x.shape)
    return [ways[seed % 3] * rng.choice([1.0, 1e-300, 1e-160, 1e300])] * (len(x) < 100)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_intersects(seed):
    _, mesh, start, end, pairs = scene_of(seed)
    for x in (start, end, *in_few_places(start, seed)):
        found = ccd.find_intersections(mesh, x)
        assert rows_of(found) == intersections(pairs, x)
        assert (found.num_crossing, found.num_touching) == (found.is_crossing.sum(), (~found.is_crossing).sum())
