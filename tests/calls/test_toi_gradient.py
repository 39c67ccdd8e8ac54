"""Gradients of times of impact against differences of exact ones, and where there is none."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from hard_cases import FAMILIES
from toi_scenes import SOLVE, scene
from toi_truth import difference, exact_times

import ccd_warp as ccd

# Kind, dimension, distance, and whether it is Euclidean.
CASES = [
    *(("vertex-face", 3, d, e) for d, e in ((0.0, False), (0.05, True), (0.05, False))),
    *(("edge-edge", 3, d, e) for d, e in ((0.0, False), (0.05, True), (0.05, False))),
    *(("point-segment", 2, d, e) for d, e in ((0.0, False), (0.1, True), (0.1, False))),
    *((kind, 3, 0.3, e) for kind in ("point-segment", "point-point") for e in (True, False)),
    *(("point-point", 2, 0.1, e) for e in (True, False)),
]


def options_of(distance, is_euclidean):
    return {"minimum_distance": distance} if is_euclidean else {"minimum_separation": distance, "length_scale": 1.0}


def predicted(gradient, moves):
    """First-order change of toi, and the sum of the magnitudes of its terms."""
    terms = [g * dx for g, dx in zip((gradient.start, gradient.end), moves[:2], strict=True)]
    of_distance = gradient.distance * moves[2]
    change = sum(term.sum(axis=(1, 2)) for term in terms) + of_distance
    return change, sum(np.abs(term).sum(axis=(1, 2)) for term in terms) + np.abs(of_distance)


def rows(gradient, chosen):
    return replace(gradient, **{name: x[chosen] for name, x in vars(gradient).items() if x is not None})


def random_regular(kind, dimension, distance, is_euclidean, count, seed=1):
    """Random pairs that touch, and their gradients, of which all must be regular."""
    solve, points = SOLVE[kind]
    rng = np.random.default_rng(seed)
    start, end = rng.standard_normal((2, 64 * count, points, dimension))
    result = solve(start, end, **options_of(distance, is_euclidean))
    touches = np.flatnonzero(result.hit & (result.toi > 0))[:count]
    gradient = result.toi_gradient(start, end)
    assert gradient.is_regular[touches].all() and not gradient.is_regular[~result.hit].any()
    assert len(touches) == count
    return rng, (start[touches], end[touches]), rows(gradient, touches)


def errors(kind, dimension, distance, is_euclidean, count, move=1e-10):
    """Relative errors against central differences of the exact toi along random moves of points and distance."""
    rng, ends, gradient = random_regular(kind, dimension, distance, is_euclidean, count)
    moves = [move * rng.standard_normal(x.shape) for x in ends]
    of_distance = move * rng.standard_normal() if distance else 0.0
    change, made = difference(kind, ends, moves, distance, is_euclidean, of_distance)
    return np.abs(change / predicted(gradient, made)[0] - 1.0)


@pytest.mark.parametrize(("kind", "dimension", "distance", "is_euclidean"), CASES)
def test_random_pairs_agree_with_differences_of_the_exact_toi(kind, dimension, distance, is_euclidean):
    found = errors(kind, dimension, distance, is_euclidean, 5)
    assert np.median(found) < 1e-13 and found.max() < 1e-9  # the truncation of a difference is some 1e-20 of its size


@pytest.mark.long
@pytest.mark.parametrize("move", [1e-9, 1e-12])
@pytest.mark.parametrize(("kind", "dimension", "distance", "is_euclidean"), CASES)
def test_many_random_pairs_agree_with_differences_of_the_exact_toi(kind, dimension, distance, is_euclidean, move):
    found = errors(kind, dimension, distance, is_euclidean, 3000, move)
    print(
        f"{kind} {dimension} {distance} {is_euclidean} {move}: median {np.median(found):.1e}, worst {found.max():.1e}"
    )
    # the worst are those whose directions cancel, or that nearly graze
    assert np.median(found) < 1e-9 and np.quantile(found, 0.99) < 1e-9


@pytest.mark.parametrize("scale", [1e-100, 1e100])
def test_gradients_scale_with_the_length_unit(scale):
    for kind, dimension, distance, is_euclidean in CASES[:6]:
        _, (start, end), gradient = random_regular(kind, dimension, distance, is_euclidean, 5)
        options = {"minimum_distance": distance * scale}
        if not is_euclidean:
            options = {"minimum_separation": distance, "length_scale": scale}
        scaled = SOLVE[kind][0](start * scale, end * scale, **options)
        found = scaled.toi_gradient(start * scale, end * scale)
        assert found.is_regular.all()
        for name in ("start", "end", "distance"):
            np.testing.assert_allclose(getattr(found, name) * scale, getattr(gradient, name), rtol=1e-9, atol=1e-12)


def test_pairs_far_from_the_origin_have_the_gradients_of_the_same_pairs_at_it():
    _, (start, end), _ = random_regular("edge-edge", 3, 0.05, True, 5)
    start, end = (np.round(x * 2**20) / 2**20 for x in (start, end))  # exact at both places
    near, far = (
        ccd.edge_edge_ccd(start + at, end + at, minimum_distance=0.05).toi_gradient(start + at, end + at)
        for at in (0, 2.0**20)
    )
    assert near.is_regular.all() and far.is_regular.all()
    np.testing.assert_allclose(far.start, near.start, rtol=1e-9, atol=1e-12)


HARD = [
    "slivers",
    "needle_against_needle",
    "mixed_sizes",
    "tiny_motion",
    "lattice",
    "parallel_edges",
    "one_ulp_neighbours",
]


def one_sided_errors(kind, ends, gradient, distance, is_euclidean, directions=4):
    """Least error of each pair, of the sum of the terms, over moves to one side, from large to small ones."""
    rng = np.random.default_rng(3)
    size = np.ptp(np.concatenate(ends, axis=1), axis=1).max(axis=1)[:, None, None]
    best = np.full(len(size), np.inf)
    for move in np.repeat([1e-9, -1e-9, 1e-12, -1e-12, 1e-14, -1e-14], directions):
        moves = [move * size * rng.standard_normal(x.shape) for x in ends]
        change, made = difference(kind, ends, moves, distance, is_euclidean, one_sided=True)
        expected, terms = predicted(gradient, made)
        error = np.abs(change - expected) / np.maximum(terms, 1e-300)
        best = np.fmin(best, error)
    return best


@pytest.mark.long
@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("distance", [0.0, 0.03])
def test_hard_pairs_have_the_derivative_to_one_side_or_none(name, distance):
    for kind, is_euclidean in (("vertex-face", True), ("edge-edge", False)):
        start, end = FAMILIES[name](kind, 24, np.random.default_rng(7), 3)
        result = SOLVE[kind][0](start, end, **options_of(distance, is_euclidean and distance > 0))
        gradient = result.toi_gradient(start, end)
        chosen = np.flatnonzero(gradient.is_regular)
        if len(chosen):
            ends = (start[chosen], end[chosen])
            found = one_sided_errors(kind, ends, rows(gradient, chosen), distance, is_euclidean)
            # moves that leave the border of a primitive have no contact
            assert np.median(found) < 1e-5 and np.mean(found < 1e-2) > 0.6, (kind, found)


def test_a_vertex_that_falls_on_the_border_of_a_face_has_the_derivative_of_moves_into_it():
    start = np.array([[[0.5, 0.0, 1.0], [0, 0, 0], [1, 0, 0], [0, 1, 0]]])  # over the edge from f0 to f1
    end = start - [[[0, 0, 2.0], [0, 0, 0], [0, 0, 0], [0, 0, 0]]]
    gradient = ccd.vertex_face_ccd(start, end).toi_gradient(start, end)
    assert gradient.is_regular.all()
    np.testing.assert_allclose(gradient.start[0, :, 2], [0.25, -0.125, -0.125, 0.0], atol=1e-15)
    np.testing.assert_array_equal(gradient.start[0, :, :2], 0.0)
    inward = [1e-9 * np.array([[[0, 1.0, 1.0], [0, 0, 0.5], [0, 0, 0], [0, 0, 0]]]), np.zeros((1, 4, 3))]
    change, made = difference("vertex-face", (start, end), inward, 0.0, False, one_sided=True)
    np.testing.assert_allclose(predicted(gradient, made)[0], change, rtol=1e-8)


@pytest.mark.parametrize("options", [{"minimum_distance": 0.1}, {"minimum_separation": 0.1, "length_scale": 1.0}])
def test_parallel_edges_over_each_other_have_a_derivative_to_one_side(options):
    start = np.array([[[0.0, 0.02, 1.0], [1.0, 0.02, 1.0], [0.3, 0.0, 0.0], [1.4, 0.0, 0.0]]])
    end = start - [[[0, 0, 2.0], [0, 0, 2.0], [0, 0, 0], [0, 0, 0]]]
    gradient = ccd.edge_edge_ccd(start, end, **options).toi_gradient(start, end)
    assert gradient.is_regular.all()
    found = one_sided_errors("edge-edge", (start, end), gradient, 0.1, "minimum_distance" in options, directions=6)
    assert found.max() < 1e-5


def irregular(kind, start, end, **options):
    """The toi of one pair that must have no gradient."""
    start, end = np.asarray(start, dtype=float)[None], np.asarray(end, dtype=float)[None]
    result = SOLVE[kind][0](start, end, **options)
    gradient = result.toi_gradient(start, end)
    assert not gradient.is_regular.any() and len(gradient) == 1
    assert not any(np.any(x) for x in (gradient.start, gradient.end, gradient.distance))
    return result.toi[0]


FACE_POINTS = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def test_what_touches_at_the_start_or_at_the_end_has_no_gradient():
    up, down = [[0.2, 0.2, 1.0], *FACE_POINTS], [[0.2, 0.2, -1.0], *FACE_POINTS]
    assert irregular("vertex-face", [[0.2, 0.2, 0.0], *FACE_POINTS], down) == 0
    assert irregular("vertex-face", up, [[0.2, 0.2, 0.0], *FACE_POINTS]) <= 1
    assert irregular("vertex-face", up, down, t_max=0.5) <= 0.5
    assert irregular("vertex-face", up, [[0.2, 0.2, 0.5], *FACE_POINTS]) == np.inf
    assert irregular("point-point", [[0, 0, 0.05], [0, 0, 0]], [[0, 0, -1], [0, 0, 0]], minimum_distance=0.1) == 0


def test_what_only_grazes_has_no_gradient():
    # a segment in the plane turns back at the moment when it touches; the path is a parabola
    start, end = FAMILIES["double_root"]("edge-edge", 16, np.random.default_rng(1), 3)
    result = ccd.edge_edge_ccd(start, end)
    assert result.hit.any() and not result.toi_gradient(start, end).is_regular.any()
    # a point passes another at exactly the distance
    assert np.isfinite(
        irregular("point-point", [[-1, 0.25, 0], [0, 0, 0]], [[1, 0.25, 0], [0, 0, 0]], minimum_distance=0.25)
    )


def test_a_toi_that_jumps_has_no_gradient():
    assert np.isfinite(irregular("point-point", [[-1.0, 0], [0, 0]], [[1.0, 0], [0, 0]]))
    assert np.isfinite(
        irregular("point-segment", [[-1, 0.5, 0], [0, 0, 0], [0, 1, 0]], [[1, 0.5, 0], [0, 0, 0], [0, 1, 0]])
    )
    # in the plane of the face, and edges in one plane
    assert np.isfinite(irregular("vertex-face", [[-1, 0.2, 0], *FACE_POINTS], [[1, 0.2, 0], *FACE_POINTS]))
    edges = [[-1, 0, 0], [-1, 1, 0], [0, 0, 0], [1, 0, 0]]
    assert np.isfinite(irregular("edge-edge", edges, [[2, 0, 0], [2, 1, 0], *edges[2:]]))


def test_pairs_that_pass_by_within_their_tolerance_have_no_gradient():
    start, end = FAMILIES["random_colliding"]("vertex-face", 400, np.random.default_rng(1), 3)
    start[:, 0] += 1e-3  # some then pass by, at a distance that the tolerance does not tell from a contact
    end[:, 0] += 1e-3
    result = ccd.vertex_face_ccd(start, end, tolerance=0.1, length_scale=1.0, method="bisection")
    passes = result.hit & np.array([time is None for time in exact_times("vertex-face", start, end, 0.0, False)])
    assert passes.any() and not result.toi_gradient(start, end).is_regular[passes].any()


def test_a_pair_at_a_limit_has_no_gradient():
    rng = np.random.default_rng(4)
    start, end = rng.standard_normal((2, 200, 4, 3))
    result = ccd.edge_edge_ccd(start, end, method="bisection", max_iterations=20, tolerance=1e-9)
    limited = result.status == ccd.CCDStatus.ITERATION_LIMIT
    assert limited.any() and not result.toi_gradient(start, end).is_regular[limited].any()


@pytest.mark.parametrize("options", [{"precision": "float32"}, {"tolerance": 1e-3}])
def test_a_toi_that_is_early_has_the_gradient_of_the_exact_one(options):
    _, (start, end), gradient = random_regular("vertex-face", 3, 0.05, True, 5)
    found = ccd.vertex_face_ccd(start, end, minimum_distance=0.05, **options).toi_gradient(start, end)
    assert found.is_regular.all()
    np.testing.assert_allclose(found.start, gradient.start, rtol=1e-9, atol=1e-12)


# --- meshes ---


def by_pair(contacts):
    return {
        (kind, *pair): k
        for k, (kind, pair) in enumerate(zip(contacts.kind.tolist(), contacts.primitives.tolist(), strict=True))
    }


@pytest.mark.parametrize("with_radii", [False, True])
def test_contacts_of_a_mesh_agree_with_differences_of_their_tois(with_radii):
    mesh, start, end = scene()
    if with_radii:
        mesh, start, end = scene(radius=np.linspace(0.0, 0.02, mesh.num_vertices))
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=0.1, device="cpu")
    contacts = pipeline.mesh_ccd(start, end).contacts
    gradient = contacts.toi_gradient()
    moves = 1e-7 * np.random.default_rng(5).standard_normal((2, *start.shape))
    late, early = (pipeline.mesh_ccd(start + s * moves[0], end + s * moves[1]).contacts for s in (1, -1))
    places = [by_pair(late), by_pair(early)]
    found = set()
    for (kind, *pair), k in by_pair(contacts).items():
        at = [place.get((kind, *pair)) for place in places]
        if gradient.is_regular[k] and None not in at:
            expected = late.toi[at[0]] - early.toi[at[1]]
            vertices = gradient.vertices[k]
            change = 2 * ((gradient.start[k] * moves[0][vertices]).sum() + (gradient.end[k] * moves[1][vertices]).sum())
            assert change == pytest.approx(expected, rel=1e-5, abs=1e-12), (kind, pair)
            found.add(kind)
    assert found == {*ccd.PairKind}
    assert gradient.is_regular.mean() > 0.8


def test_gradients_follow_their_contacts():
    mesh, start, end = scene()
    contacts = ccd.mesh_ccd(mesh, start, end, minimum_distance=0.1, device="cpu").contacts
    gradient = contacts.toi_gradient()
    again = pickle.loads(pickle.dumps(contacts))[3:7].toi_gradient()
    for name, values in vars(again).items():
        np.testing.assert_array_equal(values, getattr(gradient, name)[3:7])
    launched = ccd.CollisionPipeline(mesh, minimum_distance=0.1, device="cpu").launch(start, end).to_host().contacts
    for name, values in vars(launched.toi_gradient()).items():
        np.testing.assert_array_equal(values, getattr(gradient, name))
    assert len(contacts[:0].toi_gradient()) == 0 and "regular" in repr(gradient)


def test_a_mesh_in_the_plane_has_gradients_in_the_plane():
    line = np.array([[0.0, 0], [1, 0.1], [2, 0]])
    mesh = ccd.CollisionMesh.from_arrays(
        [(line, [[0, 1], [1, 2]]), ([[0.6, 1.0]], np.zeros((0, 2), dtype=int))], codimensional_points=True
    )
    end = mesh.vertices - [0, 1] * (mesh.vertex_body == 1)[:, None] * 2.0
    contacts = ccd.mesh_ccd(mesh, mesh.vertices, end, device="cpu").contacts
    gradient = contacts.toi_gradient()
    assert gradient.start.shape == (len(contacts), 4, 2) and gradient.is_regular.all() and len(contacts) == 1
    change = (gradient.start[0, 0] + gradient.end[0, 0]) @ [0.1, 1.0]
    assert change == pytest.approx(0.99 / 2.0)


# --- bad use ---


def test_who_asks_for_gradients_that_are_not_known_is_told_why():
    mesh, start, end = scene()
    contacts = ccd.mesh_ccd(mesh, start, end, minimum_distance=0.1, device="cpu").contacts
    with pytest.raises(ValueError, match="arrays alone"):
        ccd.Contacts(**vars(contacts)).toi_gradient()
    place = contacts._place
    held = ccd.Contacts(**vars(contacts))._of(replace(place, touch=None))
    with pytest.raises(ValueError, match="do not know the positions"):
        held.toi_gradient()
    points = np.random.default_rng(0).standard_normal((2, 3, 4, 3))
    result = ccd.vertex_face_ccd(*points, minimum_separation=0.1, start_gap_fraction=0.5)
    with pytest.raises(ValueError, match=r"start_gap_fraction is 0\.5; expected 'hold' or None"):
        result.toi_gradient(*points)
    result = ccd.vertex_face_ccd(*points)
    with pytest.raises(ValueError, match=r"points_t1 has shape \(2, 4, 3\)"):
        result.toi_gradient(points[0], points[1, :2])
    with pytest.raises(ValueError, match="points_t0 has shape"):
        result.toi_gradient(points[0, :2], points[1, :2])
    on_device = ccd.vertex_face_ccd(*(wp.array(x, dtype=wp.vec3d, device="cpu") for x in points))
    with pytest.raises(ValueError, match="NumPy arrays"):
        on_device.toi_gradient(*points)
    assert pickle.loads(pickle.dumps(result)).toi_gradient(*points).is_regular.shape == (3,)
