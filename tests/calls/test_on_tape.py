"""Tois and line searches on a tape of Warp: forms of the input, what is recorded, kept and flagged, and bad use."""

import warnings

import numpy as np
import pytest
import warp as wp
from laws.calls import EVERY_PER
from scenes import FACE, TRIANGLE, falling, two_of_every_kind
from toi_scenes import array, taped

import ccd_warp as ccd


def pipeline_of(mesh, **options):
    return ccd.CollisionPipeline(mesh, **{"minimum_distance": 0.1, "tolerance": 1e-12} | options)


def warnings_of(call):
    """What a call warns of."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        call()
    return [str(warning.message) for warning in said]


def pulled(tape, result, given, end_grad=None):
    """Gradients of a sum over all finite tois, or of positions with these weights, by all arrays."""
    tape.zero()
    if end_grad is not None:
        given[1].grad.assign(end_grad)
    else:
        for name in ("world_toi", "body_toi", "vertex_toi"):
            values = getattr(result, name)
            weights = np.cos(np.arange(len(values)) + len(name))
            values.grad.assign(np.where(np.isfinite(values.numpy()), weights, 0.0))
    tape.backward()
    return [x.grad.numpy().copy() for x in given]


def gradients(pipeline, given):
    """Gradients of the tois of a launch by all arrays."""
    tape, result = taped(lambda: pipeline.launch(*given[:2]))
    assert len(tape.launches) == 1
    return pulled(tape, result, given)


def searched(pipeline, given, weights, **search):
    """Shortened positions, their gradients with these weights by all arrays, and which are regular."""
    tape, result = taped(lambda: pipeline.launch_line_search(*given[:2], **search))
    assert len(tape.launches) == 1
    shortened = given[1].numpy().copy()
    return shortened, pulled(tape, result, given, weights), result.is_regular().numpy()


def scene(**options):
    """All kinds of pairs: two bodies, one of which falls on the other and on two half-spaces, one of them moving."""
    planes = [ccd.HalfSpace([0, 0, -0.35], [0.1, 0.2, 2.0]), ccd.HalfSpace([0, 0, -0.5], [0, 0.1, 1.0])]
    mesh = two_of_every_kind(*planes, **{"kinematic": [3]} | options)
    fall, amount = (np.array(x)[mesh.vertex_body, None] for x in ([0.3, 0.75, 0.0, -0.1], [0.05, 0.05, 0, 0]))
    noise = np.random.default_rng(2).standard_normal(mesh.vertices.shape)
    return mesh, mesh.vertices.copy(), mesh.vertices - fall * [0, 0, 1] + amount * noise


FORMS = {  # of positions of all vertices, by which of them move
    "moving rows": lambda x, moving: x[moving],
    "components": lambda x, _: x,
    "worlds": lambda x, _: x.reshape(2, len(x) // 2, 3),
}


@pytest.mark.parametrize("dtype", [wp.vec3d, wp.vec3f])
@pytest.mark.parametrize("form", [*FORMS, "displacements"])
def test_gradients_follow_the_form_of_the_input(dtype, form):
    mesh, start, end = (falling if form == "worlds" else scene)(static=[0])
    end = np.where((mesh.vertex_body == 0)[:, None], start, end)
    if form == "worlds":
        mesh, start, end = mesh.replicate(2), np.tile(start, (2, 1)), np.tile(end, (2, 1))
    start, end = (x.astype(np.float64 if dtype is wp.vec3d else np.float32) for x in (start, end))
    pipeline, tolerance = pipeline_of(mesh), 1e-9 if dtype is wp.vec3d else 1e-4
    ends, weights = [array(start, dtype), array(end, dtype)], np.random.default_rng(0).standard_normal(start.shape)
    of_start, of_end = gradients(pipeline, ends)
    assert np.abs(of_start).max() > 0.1
    if form == "displacements":
        given = [array(start, dtype), array(end - start, dtype)]
        tape, result = taped(lambda: pipeline.launch(given[0], displacements=given[1]))
        found, expected, tolerance = pulled(tape, result, given), [of_start + of_end, of_end], 1e-4
    else:
        change = lambda x: FORMS[form](x, mesh.moving_vertices)  # noqa: E731
        of_form = wp.dtype_from_numpy(start.dtype) if form == "components" else dtype
        search, launch = ([array(change(x), of_form) for x in (start, end)] for _ in range(2))
        shortened, of_search, _ = searched(pipeline, ends, weights, per="world")
        again, of_again, _ = searched(pipeline, search, change(weights), per="world")
        np.testing.assert_array_equal(again, change(shortened))
        found, expected = gradients(pipeline, launch) + of_again, map(change, (of_start, of_end, *of_search))
    for x, y in zip(found, expected, strict=True):
        np.testing.assert_allclose(x, y, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("per", EVERY_PER)
def test_line_searches_change_as_their_gradients_say(per):
    """Differences of the shortened positions themselves, by both ends and radii, of what is regular."""
    mesh, *ends = scene(radius=np.linspace(0.0, 0.02, 17))
    pipeline, rng = pipeline_of(mesh), np.random.default_rng(1)
    values, weights = [*ends, mesh.radius], rng.standard_normal(ends[0].shape)
    given = [array(ends[0]), array(ends[1]), pipeline.radius]

    def shortened(*values):
        for x, value in zip(given, values, strict=True):
            x.assign(value)
        pipeline.launch_line_search(*given[:2], per=per)
        return given[1].numpy().copy()

    given[2].requires_grad = True
    is_regular = searched(pipeline, given, weights, per=per)[2]
    weights[~is_regular] = 0.0
    given[1].assign(ends[1])
    taped_places, found, _ = searched(pipeline, given, weights, per=per)
    for x in given:
        x.requires_grad = False
    assert is_regular.any() and np.array_equal(shortened(*values), taped_places)
    moves = [1e-7 * rng.standard_normal(x.shape) for x in values]
    moves[2][values[2] == 0] = 0.0  # a radius cannot be negative
    late, early = (shortened(*(x + s * dx for x, dx in zip(values, moves, strict=True))) for s in (1, -1))
    change = 2.0 * sum((g * dx).sum() for g, dx in zip(found, moves, strict=True))
    assert change == pytest.approx((weights * (late - early)).sum(), rel=1e-6)


def test_equal_tois_pass_their_gradient_to_the_first_contact():
    falls = [(0.1 * TRIANGLE + [0.22 * k - 0.33, 0.0, 1.0], FACE) for k in range(4)]  # all meet the floor at once
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), *falls], self_collision=False)
    given = [array(mesh.vertices), array(mesh.vertices - [0, 0, 2.0] * (mesh.vertex_body > 0)[:, None])]
    tape, result = taped(lambda: pipeline_of(mesh, minimum_distance=0.01).launch(*given))
    result.toi.grad.fill_(1.0)
    tape.backward()
    contacts, expected = result.to_host().contacts, np.zeros((len(mesh.vertices), 3))
    first, gradient = int(contacts.toi.argmin()), contacts.toi_gradient()
    np.add.at(expected, gradient.vertices[first], gradient.start[first])
    assert gradient.is_regular[first] and (contacts.toi == contacts.toi[first]).sum() > 1
    np.testing.assert_allclose(given[0].grad.numpy(), expected, atol=1e-14)


def test_tapes_that_are_alive_together_have_gradients_of_their_own():
    """Also two launches on one tape; arrays of a call are overwritten, and earlier tapes have been dropped."""
    mesh, start, end = scene()
    steps = [(start, end), (end, start), (start, 0.5 * (start + end)), (start, start + 1.3 * (end - start))]
    expected = [gradients(pipeline_of(mesh), [*map(array, step)]) for step in steps]
    pipeline = pipeline_of(mesh)
    for order in ((0, 1, 2, 3), (3, 0, 2, 3), (0, 0)):
        alive, given = [], [[*map(array, steps[k])] for k in order]
        for two in zip(given[::2], given[1::2], strict=True):
            tape, results = taped(lambda two=two: [pipeline.launch(*ends) for ends in two])
            alive += [(tape, result, ends) for result, ends in zip(results, two, strict=True)]
        given[0][0].fill_(1.0)
        for k, each in reversed([*zip(order, alive, strict=True)]):
            assert np.array_equal(pulled(*each), expected[k])


@pytest.mark.parametrize("is_search", [False, True])
def test_a_graph_holds_both_passes(is_search):
    mesh, start, end = falling()
    pipeline, given, kept = pipeline_of(mesh), [array(start), array(end)], []
    weights, call = array(np.ones_like(start)), pipeline.launch_line_search if is_search else pipeline.launch

    def both():
        tape, result = taped(lambda: call(*given))
        wp.copy(given[1].grad, weights) if is_search else result.toi.grad.fill_(1.0)
        tape.backward()
        kept.append((tape, result))

    def run(call, start):
        for x, value in zip(given, (start, end), strict=True):
            x.assign(value)
            x.grad.zero_()
        call()
        return [x.grad.numpy().copy() for x in given]

    expected = run(both, start)  # loads the kernels
    with wp.ScopedCapture(device=given[0].device) as capture:
        both()
    elsewhere, again = (run(lambda: wp.capture_launch(capture.graph), start * s) for s in ([1.0, 1, 0], 1.0))
    assert not np.array_equal(elsewhere[0], expected[0]) and np.array_equal(again, expected)


PAIRS = [("vertex_face", 4, 3), ("edge_edge", 4, 3), ("point_segment", 3, 2), ("point_point", 2, 3)]


@pytest.mark.parametrize("case", PAIRS)
def test_pair_functions_on_a_tape_have_the_gradients_of_their_results(case):
    solve, points, dimension = getattr(ccd, f"{case[0]}_ccd"), *case[1:]
    ends = np.random.default_rng(0).standard_normal((2, 200, points, dimension))
    expected = solve(*ends, minimum_distance=0.3).toi_gradient(*ends)
    one = int(expected.is_regular.argmax())
    for dtype in (wp.vec3d, wp.float64) if dimension == 3 else (wp.vec2d,):
        for rows in (slice(200), slice(one, one + 1)):
            given = [array(x[rows], dtype) for x in ends]
            tape, result = taped(lambda g=given: solve(*g, minimum_distance=0.3))
            assert len(tape.launches) == 1 and expected.is_regular[one]
            result.toi.grad.fill_(2.0)
            tape.backward()
            found = [x.grad.numpy() for x in given]
            np.testing.assert_allclose(found, [2.0 * expected.start[rows], 2.0 * expected.end[rows]], rtol=1e-14)


def sliding(height):
    """A triangle slides up from a floor, within its distance, to a wall; elsewhere one falls on another."""
    floor, wall = [[-10.0, -10, 0], [0.5, 0, 0], [-10, 10, 0]], [[1.0, -3, -1], [1, 3, -1], [1, 0, 3]]
    slider, far = [[0.0, 0, height], [-0.2, 0.1, height], [-0.2, -0.1, height]], TRIANGLE + [40.0, 0, 0]
    above = 0.5 * TRIANGLE + [[40.0, 0, 1], [40, 0, 1.1], [40, 0, 1.2]]
    mesh = ccd.CollisionMesh.from_arrays([(x, FACE) for x in (floor, wall, slider, far, above)])
    throw = np.array([[0.0, 0, 0], [0, 0, 0], [2, 0, 0.1], [0, 0, 0], [0, 0, -2]])
    return mesh, mesh.vertices.copy(), mesh.vertices + throw[mesh.vertex_body]


def test_line_searches_say_what_of_them_has_no_derivative():
    """Shortened heights or places, and flags: of what is pressed, ends in contact, is cut short, or slides."""
    close, ends, tiny = falling(0.05), falling(), falling(2.0**-20)  # within the distance; at the end; rounded away
    ends[2][3:, 2], tiny[2][3:, 2] = 0.0, -1.0
    single = {"precision": "float32", "start_gap_fraction": None, "minimum_distance": 0.0, "tolerance": 1e-6}

    def search(mesh, start, end, weights=(1.0, 1, 1), options={}, **search):  # noqa: B006
        given, weights = [array(start), array(end)], np.ones_like(start) * weights
        return searched(pipeline_of(mesh, **options), given, weights, **search)

    cases = (close, {}, 0.0, 0.0), (ends, {"minimum_distance": 0.0}, 0.9, 0.9), (tiny, single, 1e-12, 0.25 * 2.0**-20)
    for step, options, least, most in cases:
        (_, start, end), (shortened, found, is_regular) = step, search(*step, options=options)
        fraction = (shortened - start)[3, 2] / (end - start)[3, 2]
        assert least * (1 - 1e-9) <= fraction <= most * (1 + 1e-9)
        assert not is_regular.any() and not np.any(found[1])
        np.testing.assert_array_equal(found[0], 1.0 if fraction == 0 else 0.0)
    for per, height in (("body", 0.05), ("vertex", 0.1 - 2.0**-52)):
        shortened, found, is_regular = search(*sliding(height), (0, 0, 1.0), per=per)
        # it keeps from the wall what it kept before
        np.testing.assert_allclose([shortened[6, 0], shortened[12, 2]], [0.9 * (1.0 - height), 0.19], rtol=1e-9)
        np.testing.assert_array_equal(is_regular[6:], np.arange(6, 15) > 8)
        assert not any(x[6:9].any() for x in found)
    step = falling(kinematic=[1])  # goes all the way
    shortened, found, _ = search(*step)
    assert np.array_equal(shortened, step[2]) and (found[1][3:] == 1.0).all()


def test_vertices_that_take_no_part_leave_gradients_numbers():
    """A face falls on another beside vertices that are at no number."""
    mesh, start, end = falling()
    _, expected, _ = searched(pipeline_of(mesh), [array(start), array(end)], np.ones_like(start), per="body")
    rows = np.array([1, 2, 3, 5, 6, 7])
    x, y, weights = np.full((8, 3), np.nan), np.full((8, 3), np.nan), np.zeros((8, 3))
    x[rows], y[rows], weights[rows] = start, end, 1.0
    mesh = ccd.CollisionMesh.from_arrays([(x[:4], [[1, 2, 3]]), (x[4:], [[1, 2, 3]])])
    _, found, is_regular = searched(pipeline_of(mesh), [array(x), array(y)], weights, per="body")
    assert np.isfinite(found).all() and is_regular.all()
    np.testing.assert_array_equal(np.array(found)[:, rows], expected)


def test_contacts_of_any_pass_that_have_no_gradient_are_flagged_and_have_one_after_reserve():
    mesh, start, end = scene()
    pipeline = pipeline_of(mesh, max_contacts=1)
    result = pipeline.launch_line_search(start, end.copy(), per="vertex")
    assert result.flags.numpy()[0] == 0 and result.to_host().num_contacts > 1  # the last pass lists none
    for flag in (ccd.LaunchFlag.CONTACTS_OVERFLOW, 0):
        given = [array(start), array(end)]
        tape, result = taped(lambda g=given: pipeline.launch_line_search(*g, per="vertex"))
        assert result.flags.numpy()[0] == flag
        said = warnings_of(tape.backward)
        assert len(said) == (wp.get_device().is_cpu and bool(flag)) and all(
            "is none, and adds 0; reserve" in text for text in said
        )
        pipeline.reserve(max_contacts=2 * result.to_host().num_contacts)


def test_a_launch_that_overflows_and_its_backward_pass_say_so_once():
    mesh, start, end = scene()
    pipeline, is_said = pipeline_of(mesh, max_pairs=1), wp.get_device().is_cpu
    for count in (int(is_said), 0):
        given, made = [array(start), array(end)], []
        said = warnings_of(lambda x=given, m=made: m.extend(taped(lambda: pipeline.launch(*x))))
        tape, result = made
        most = result.num_pairs.numpy()[:4].max()
        assert len(said) == count and all(f"reserve(max_pairs={2 * most})" in text for text in said)
        said = warnings_of(lambda t=tape, r=result: t.backward(r.toi))
        assert len(said) == count and all("PAIRS_OVERFLOW" in text for text in said)
        assert result.toi.numpy()[0] == 0.0 and not given[1].grad.numpy().any()
    finder, x = ccd.CollisionPipeline(mesh, max_contacts=1), array(start, requires_grad=False)
    said = warnings_of(lambda: [finder.launch_proximity(x, 0.4) for _ in range(2)])
    assert sum("max_contacts is 1," in text for text in said) == is_said


def test_nothing_is_recorded_where_no_gradient_is_asked_for():
    mesh, start, end = scene()
    pipeline, (x, y) = pipeline_of(mesh), (array(values, requires_grad=False) for values in (start, end))
    points = array(np.random.default_rng(0).standard_normal((3, 4, 3)), requires_grad=False)
    for call in (
        lambda: pipeline.launch(x, y).contacts.points,
        lambda: pipeline.launch_proximity(x, 0.1).to_host(),
        lambda: pipeline.launch_displacement_bounds(x, 0.1),
        lambda: pipeline.launch_line_search(x, wp.clone(y)),
        lambda: ccd.vertex_face_ccd(points, points).hit,
    ):
        assert not taped(call)[0].launches


def test_who_asks_for_what_has_no_gradient_is_told_why():
    mesh, start, end = scene()
    ends, points = [array(start), array(end)], np.random.default_rng(0).standard_normal((2, 3, 4, 3))
    pipeline, shared = pipeline_of(mesh), pipeline_of(mesh, start_gap_fraction=0.5)
    thick = pipeline_of(scene(radius=np.linspace(0.0, 0.02, 17))[0])
    thick.radius.requires_grad = True
    motion = ccd.RigidMotion([[0, 0, 0, 0, 0, 0, 1.0]], twist=np.ones((1, 6)))
    turns = ccd.CollisionPipeline(ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE)], rigid=[0]))
    halved = ccd.vertex_face_ccd(*points, minimum_separation=0.1, start_gap_fraction=0.5)
    without, none = array(end, requires_grad=False), "finds no times of impact"
    for call, message in (
        (lambda: shared.launch(*ends), "expected 'hold' or None for gradients"),
        (lambda: shared.launch_line_search(*ends), "expected 'hold' or None for gradients"),
        (lambda: pipeline.launch_line_search(ends[0], without), "vertices_t1 does not require a gradient"),
        (lambda: pipeline.mesh_ccd(*(x.to("cpu") for x in ends)), "vertices_t0 requires a gradient"),
        (lambda: pipeline.launch_proximity(ends[0], 0.1), f"positions requires a gradient .* {none}"),
        (lambda: pipeline.launch_displacement_bounds(ends[0], 0.1), f"positions requires a gradient .* {none}"),
        (lambda: thick.launch_proximity(without, 0.1), f"radius requires a gradient .* {none}"),
        (lambda: turns.launch(*2 * [array(TRIANGLE)], motion=motion), r"not recorded.*gradient_by_poses\(\)"),
        (lambda: pipeline.launch_line_search(*ends).is_regular("edge"), "per is 'edge'"),
        (lambda: halved.toi_gradient(*points), r"start_gap_fraction is 0\.5; expected 'hold' or None"),
        (lambda: ccd.vertex_face_ccd(*points).toi_gradient(points[0], points[1, :2]), r"has shape \(2, 4, 3\)"),
        (lambda: ccd.vertex_face_ccd(*points).toi_gradient(*points[:, :2]), "points_t0 has shape"),
    ):
        with wp.Tape(), pytest.raises(ValueError, match=message):
            call()
