"""Line searches on a tape of Warp: gradients of the shortened positions by both ends and by radii."""

import numpy as np
import pytest
import warp as wp
from scenes import FACE, TRIANGLE
from toi_scenes import array, random_scene, scene, taped, thick_scene

import ccd_warp as ccd

PER = ("scene", "world", "body", "vertex")


def pipeline_of(mesh, **options):
    return ccd.CollisionPipeline(mesh, device="cpu", tolerance=1e-12, **options)


def gradients(pipeline, given, of_result, **search):
    """Shortened positions, the gradients of their sum with these weights by all arrays, and which are regular."""
    tape, result = taped(lambda: pipeline.launch_line_search(*given[:2], **search))
    assert len(tape.launches) == 1
    given[1].grad.assign(of_result)
    shortened = given[1].numpy().copy()
    tape.backward()
    return shortened, [x.grad.numpy().copy() for x in given], result.is_regular().numpy()


def worst_error(pipeline, start, end, size=1e-7, **search):
    """Largest relative error of directional derivatives against differences of what is regular; nan if nothing is."""
    rng = np.random.default_rng(1)
    weights = rng.standard_normal(start.shape)
    radius = [] if pipeline.radius is None else [pipeline.radius]
    for x in radius:
        x.requires_grad = True
    given, values = [array(start), array(end), *radius], [start, end, *(x.numpy().copy() for x in radius)]
    *_, is_regular = gradients(pipeline, given, weights, **search)
    weights[~is_regular] = 0.0
    for x, value in zip(given, values, strict=True):
        x.assign(value)
        x.grad.zero_()
    shortened, found, _ = gradients(pipeline, given, weights, **search)
    for x in radius:
        x.requires_grad = False
    if not is_regular.any():
        return np.nan

    def total(*inputs):
        for x, new in zip(radius, inputs[2:], strict=True):
            x.assign(new)
        ends = [array(x, requires_grad=False) for x in inputs[:2]]
        pipeline.launch_line_search(*ends, **search)
        return (weights * ends[1].numpy()).sum()

    assert total(*values) == (weights * shortened).sum()  # the bits of a search without a tape
    errors = []
    for _ in range(2):
        moves = [size * rng.standard_normal(x.shape) for x in values]
        for move in moves[2:]:
            move[values[2] == 0] = 0.0  # a radius cannot be negative
        late, early = (total(*(x + s * dx for x, dx in zip(values, moves, strict=True))) for s in (1, -1))
        change = 2.0 * sum((g * dx).sum() for g, dx in zip(found, moves, strict=True))
        errors.append(abs(change / (late - early) - 1.0))
    return max(errors)


@pytest.mark.parametrize("per", PER)
def test_gradients_of_all_kinds_of_pairs_agree_with_differences(per):
    for make in (scene, thick_scene):
        mesh, start, end = make()
        assert worst_error(pipeline_of(mesh, minimum_distance=0.1), start, end, per=per) < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("per", PER)
def test_many_scenes_agree_with_differences(per):
    scenes = [random_scene(seed) for seed in range(200)]
    errors = np.array([worst_error(pipeline_of(mesh, **options), *ends, per=per) for mesh, *ends, options in scenes])
    errors = errors[~np.isnan(errors)]
    print(f"{len(errors)} scenes {per}: median {np.median(errors):.1e}, worst {np.sort(errors)[-3:]}")
    # differences of positions in float64 have some eight digits
    assert len(errors) > 160 and np.median(errors) < 1e-7 and max(errors) < 1e-4


def falling(height=1.0, **options):
    """A triangle over another, and where it would fall to."""
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (TRIANGLE + [0, 0, height], FACE)], **options)
    end = mesh.vertices - [0, 0, 2.0 * height] * (mesh.vertex_body == 1)[:, None]
    return mesh, mesh.vertices.copy(), end


@pytest.mark.parametrize("form", ["moving rows", "components", "float32", "worlds"])
def test_gradients_follow_the_form_of_the_input(form):
    mesh, start, end = falling(static=[0])
    moving = mesh.moving_vertices
    if form == "worlds":
        mesh = mesh.replicate(2)
        start, end = np.tile(start, (2, 1)), np.tile(end, (2, 1))
        moving = mesh.moving_vertices
    of_result = np.where(mesh.vertex_body % 2 == 1, 1.0, 0.0)[:, None] * [0.0, 0, 1]
    pipeline = pipeline_of(mesh, minimum_distance=0.1)
    given = [array(start), array(end)]
    # the height after it: 1 - 0.9 (1 - 0.1), by heights of the upper triangle
    shortened, expected, is_regular = gradients(pipeline, given, of_result, per="world", safety=0.9)
    np.testing.assert_allclose(shortened[moving, 2], 0.19, rtol=1e-9)
    assert is_regular.all() and is_regular.shape == (mesh.num_vertices,)
    first = moving[:3]
    np.testing.assert_allclose(expected[0][first, 2].sum() + expected[1][first, 2].sum(), 3 - 2.7, rtol=1e-6)
    if form == "worlds":
        np.testing.assert_array_equal(expected[0][:6], expected[0][6:])
        given = [array(x.reshape(2, 6, 3)) for x in (start, end)]
        of_result, expected = of_result.reshape(2, 6, 3), [x.reshape(2, 6, 3) for x in expected]
    elif form == "moving rows":
        given, of_result = [array(x[moving]) for x in (start, end)], of_result[moving]
        expected = [x[moving] for x in expected]
    else:
        dtype = wp.float32 if form == "float32" else wp.float64
        given = [array(x, dtype) for x in (start, end)]
    _, found, _ = gradients(pipeline, given, of_result, per="world", safety=0.9)
    for x, gradient in zip(found, expected, strict=True):
        np.testing.assert_allclose(x, gradient, rtol=1e-5 if form == "float32" else 1e-12, atol=1e-6)


def test_a_step_of_a_part_of_the_gap_has_no_derivative_and_says_so():
    mesh, start, end = falling(2.0**-20)  # whose toi is lost in the rounding of the motion in float32
    end[3:, 2] = -1.0
    pipeline = ccd.CollisionPipeline(mesh, device="cpu", precision="float32", start_gap_fraction=None)
    given = [array(start), array(end)]
    shortened, found, is_regular = gradients(pipeline, given, np.ones_like(start))
    fraction = (shortened - start)[3, 2] / (end - start)[3, 2]
    assert 0.0 < fraction < 0.25 * 2.0**-20
    assert not is_regular.any() and not np.any(found)


def test_what_is_pressed_together_stays_where_it_starts_and_has_the_derivative_of_that():
    mesh, start, end = falling(0.05)  # within its distance at the start
    given = [array(start), array(end)]
    shortened, found, is_regular = gradients(pipeline_of(mesh, minimum_distance=0.1), given, np.ones_like(start))
    np.testing.assert_array_equal(shortened[3:], start[3:])
    np.testing.assert_array_equal(found[0], 1.0)
    assert not is_regular.any() and not found[1].any()


def sliding(height):
    """A triangle slides up from a floor, within its distance, to a wall; elsewhere one falls on another."""
    floor, wall = [[-10.0, -10, 0], [0.5, 0, 0], [-10, 10, 0]], [[1.0, -3, -1], [1, 3, -1], [1, 0, 3]]
    slider = [[0.0, 0, height], [-0.2, 0.1, height], [-0.2, -0.1, height]]
    far = TRIANGLE + [40.0, 0, 0]
    above = 0.5 * TRIANGLE + [[40.0, 0, 1], [40, 0, 1.1], [40, 0, 1.2]]
    mesh = ccd.CollisionMesh.from_arrays([(x, FACE) for x in (floor, wall, slider, far, above)])
    throw = np.array([[0.0, 0, 0], [0, 0, 0], [2, 0, 0.1], [0, 0, 0], [0, 0, -2]])
    return mesh, mesh.vertices.copy(), mesh.vertices + throw[mesh.vertex_body]


@pytest.mark.parametrize("per", ["body", "vertex"])
@pytest.mark.parametrize("height", [0.05, 0.1 - 2.0**-52])  # which is within it by a rounding
def test_what_is_held_on_its_way_has_no_derivative_and_says_so_while_all_else_has(per, height):
    mesh, start, end = sliding(height)
    given, of_height = [array(start), array(end)], np.ones_like(start) * [0, 0, 1.0]
    pipeline = pipeline_of(mesh, minimum_distance=0.1)
    shortened, found, is_regular = gradients(pipeline, given, of_height, per=per)
    np.testing.assert_allclose(
        shortened[6, 0], 0.9 * (1.0 - height), rtol=1e-9
    )  # it keeps from the wall what it kept before
    np.testing.assert_allclose(shortened[12, 2], 0.19, rtol=1e-9)
    np.testing.assert_array_equal(is_regular[6:], mesh.vertex_body[6:] != 2)
    assert not any(x[mesh.vertex_body == 2].any() for x in found)
    assert worst_error(pipeline, start, end, per=per) < 1e-6


@pytest.mark.parametrize("per", ["body", "vertex"])
def test_what_meets_positions_without_a_derivative_has_none(per):
    mesh, *ends, options = random_scene(23)
    assert worst_error(pipeline_of(mesh, **options), *ends, per=per) < 1e-6


def test_what_touches_at_the_end_of_the_step_has_no_derivative_and_says_so():
    mesh, start, end = falling()
    end[3:, 2] = 0.0
    given = [array(start), array(end)]
    shortened, found, is_regular = gradients(pipeline_of(mesh), given, np.ones_like(start))
    np.testing.assert_allclose(shortened[3:, 2], 0.1, rtol=1e-9)
    assert not is_regular.any() and not np.any(found)


def test_who_asks_for_flags_of_what_was_not_recorded_or_is_not_there_is_told():
    mesh, start, end = falling()
    pipeline = pipeline_of(mesh)
    with pytest.raises(ValueError, match="the launch was not recorded; expected one inside a"):
        pipeline.launch_line_search(array(start), array(end)).is_regular()
    _, result = taped(lambda: pipeline.launch_line_search(array(start), array(end)))
    for per in ("scene", "edge"):
        with pytest.raises(ValueError, match=f"per is '{per}'"):
            result.is_regular(per)


def test_kinematic_bodies_pass_their_gradient_through():
    mesh, start, end = falling(kinematic=[1])
    given, of_result = [array(start), array(end)], np.ones_like(start)
    shortened, found, _ = gradients(pipeline_of(mesh), given, of_result)
    np.testing.assert_array_equal(shortened, end)
    np.testing.assert_array_equal(found[1][3:], 1.0)


def test_vertices_that_take_no_part_leave_gradients_numbers():
    """A face falls on another beside vertices that are at no number."""
    mesh, start, end = falling()
    _, expected, _ = gradients(pipeline_of(mesh), [array(start), array(end)], np.ones_like(start), per="body")
    rows = np.array([1, 2, 3, 5, 6, 7])
    x, y = np.full((2, 8, 3), np.nan)
    x[rows], y[rows] = start, end
    bodies = [(x[:4], [[1, 2, 3]]), (x[4:], [[1, 2, 3]])]
    of_result = np.zeros_like(x)
    of_result[rows] = 1.0
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    _, found, is_regular = gradients(pipeline_of(mesh), [array(x), array(y)], of_result, per="body")
    for of_rows, of_all in zip(expected, found, strict=True):
        np.testing.assert_array_equal(of_all[rows], of_rows)
        assert np.isfinite(of_all).all() and is_regular.all()


def test_a_graph_holds_both_passes_of_a_line_search():
    mesh, start, end = falling()
    pipeline, of_result = pipeline_of(mesh), np.ones_like(start)
    given, kept = [array(start), array(end)], []
    _, expected, _ = gradients(pipeline, given, of_result, per="body")
    weights = array(of_result, requires_grad=False)

    def both():
        given[0].grad.zero_()
        tape, result = taped(lambda: pipeline.launch_line_search(*given, per="body"))
        wp.copy(given[1].grad, weights)
        tape.backward()
        kept.extend([tape, result.is_regular()])

    with wp.ScopedCapture(device="cpu") as capture:
        both()
    touching = start * [1.0, 1, 0]
    for values, is_regular in ((touching, [False] * 6), (start, [True] * 6)):
        given[0].assign(values)
        given[1].assign(end)
        wp.capture_launch(capture.graph)
        np.testing.assert_array_equal(kept[1].numpy(), is_regular)
    for x, gradient in zip(given, expected, strict=True):
        np.testing.assert_array_equal(x.grad.numpy(), gradient)


def test_who_gives_an_end_without_a_gradient_is_told_to():
    mesh, start, end = falling()
    pipeline = pipeline_of(mesh)
    with wp.Tape(), pytest.raises(ValueError, match="vertices_t1 does not require a gradient"):
        pipeline.launch_line_search(array(start), array(end, requires_grad=False))
    shared = pipeline_of(mesh, minimum_distance=0.1, start_gap_fraction=0.5)
    with wp.Tape(), pytest.raises(ValueError, match="expected 'hold' or None for gradients"):
        shared.launch_line_search(array(start), array(end))


def test_contacts_of_any_pass_that_have_no_gradient_are_flagged_and_have_one_after_reserve():
    mesh, start, end = scene()
    pipeline = pipeline_of(mesh, minimum_distance=0.1, max_contacts=1)
    result = pipeline.launch_line_search(start, end.copy(), per="vertex")
    assert result.flags.numpy()[0] == 0 and result.to_host().num_contacts > 1  # the last pass lists none
    given = [array(start), array(end)]
    _, result = taped(lambda: pipeline.launch_line_search(*given, per="vertex"))
    assert result.flags.numpy()[0] == ccd.LaunchFlag.CONTACTS_OVERFLOW
    pipeline.reserve(max_contacts=2 * result.to_host().num_contacts)
    given = [array(start), array(end)]
    _, result = taped(lambda: pipeline.launch_line_search(*given, per="vertex"))
    assert result.flags.numpy()[0] == 0
