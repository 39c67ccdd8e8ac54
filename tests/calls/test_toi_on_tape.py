"""Tois on a tape of Warp: gradients by both ends of a step and by radii, and what is recorded."""

import gc

import numpy as np
import pytest
import warp as wp
from scenes import FACE, TRIANGLE
from toi_scenes import SOLVE, array, random_scene, scene, taped, thick_scene

import ccd_warp as ccd
from ccd_warp._engine.device.kept_check import KeptCheck
from ccd_warp._engine.device.step import DeviceStep

DISTANCE = 0.1
TOIS = ("toi", "world_toi", "body_toi", "vertex_toi")


def weighted(result, weights):
    """A sum over all finite tois; the weights are made at first."""
    total = 0.0
    for name in TOIS:
        values = getattr(result, name).numpy()
        if name not in weights:
            weights[name] = np.where(np.isfinite(values), np.cos(np.arange(len(values)) + len(name)), 0.0)
        total += weights[name] @ np.where(weights[name] != 0, values, 0.0)
    return total


def backward(tape, result, weights):
    """Run the tape backwards from that sum."""
    tape.zero()
    seen = set()
    for name in TOIS:
        values = getattr(result, name)
        if id(values) in seen:  # the toi of a single world is that of the scene
            values.grad.assign(values.grad.numpy() + weights[name])
        else:
            values.grad.assign(weights[name])
        seen.add(id(values))
    tape.backward()


@pytest.mark.parametrize("make", [scene, thick_scene])
def test_gradients_of_a_launch_agree_with_differences(make):
    mesh, start, end = make()
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    given = [array(start), array(end)]
    radius = pipeline.radius
    if radius is not None:
        radius.requires_grad = True
        given.append(radius)
    tape, result = taped(lambda: pipeline.launch(*given[:2]))
    assert len(tape.launches) == 1
    values, weights = [x.numpy().copy() for x in given], {}
    weighted(result, weights)
    backward(tape, result, weights)
    gradient = [x.grad.numpy().copy() for x in given]
    rng = np.random.default_rng(1)
    for _ in range(3):
        moves = [1e-7 * rng.standard_normal(x.shape) for x in values]
        for move in moves[2:]:
            move[values[2] == 0] = 0.0  # a radius cannot be negative
        sums = []
        for sign in (1, -1):
            if radius is not None:
                radius.assign(values[2] + sign * moves[2])
            ends = [array(x + sign * dx, requires_grad=False) for x, dx in zip(values[:2], moves[:2], strict=True)]
            sums.append(weighted(pipeline.launch(*ends), weights))
        change = 2.0 * sum((g * dx).sum() for g, dx in zip(gradient, moves, strict=True))
        assert change == pytest.approx(sums[0] - sums[1], rel=1e-6)


@pytest.mark.long
def test_many_scenes_agree_with_differences():
    errors = []
    for seed in range(200):
        mesh, start, end, options = random_scene(seed)
        pipeline = ccd.CollisionPipeline(mesh, device="cpu", tolerance=1e-12, **options)
        given, weights = [array(start), array(end)], {}
        tape, result = taped(lambda p=pipeline, g=given: p.launch(*g))
        if not np.isfinite(weighted(result, weights)) or not weights["toi"].any():
            continue
        backward(tape, result, weights)
        rng = np.random.default_rng(seed)
        moves = [1e-8 * rng.standard_normal(start.shape) for _ in range(2)]
        ends = [
            [array(x + s * dx, requires_grad=False) for x, dx in zip((start, end), moves, strict=True)] for s in (1, -1)
        ]
        late, early = (weighted(pipeline.launch(*each), weights) for each in ends)
        change = 2.0 * sum((x.grad.numpy() * dx).sum() for x, dx in zip(given, moves, strict=True))
        if change != 0.0 or late != early:  # all that touches does so at the start
            errors.append(abs(change / (late - early) - 1.0) if late != early else np.inf)
    print(f"{len(errors)} scenes: median {np.median(errors):.1e}, worst {np.sort(errors)[-5:]}")
    # differences of tois in float64 have some eight digits
    assert len(errors) > 190 and np.median(errors) < 1e-7 and max(errors) < 1e-4


def test_results_have_the_bits_of_a_launch_without_a_tape():
    mesh, start, end = scene()
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    _, ours = taped(lambda: pipeline.launch(array(start), array(end)))
    ours = ours.to_host()
    theirs = pipeline.launch(array(start), array(end)).to_host()
    for name in ("world_toi", "body_toi", "vertex_toi"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    assert ours.toi == theirs.toi and len(ours.contacts) == len(theirs.contacts)


@pytest.mark.parametrize("dtype", [wp.vec3d, wp.vec3f])
@pytest.mark.parametrize("form", ["all rows", "moving rows", "displacements", "components"])
def test_gradients_follow_the_form_of_the_input(dtype, form):
    mesh, start, end = scene(static=[0])
    end[mesh.vertex_body == 0] = start[mesh.vertex_body == 0]
    real = np.float64 if dtype is wp.vec3d else np.float32
    start, end = start.astype(real), end.astype(real)
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    reference = [array(start, dtype), array(end, dtype)]
    tape, result = taped(lambda: pipeline.launch(*reference))
    weights = {}
    weighted(result, weights)
    backward(tape, result, weights)
    of_start, of_end = (x.grad.numpy() for x in reference)
    assert np.abs(of_start).max() > 0.1 and np.abs(of_start[mesh.vertex_body == 0]).max() > 0.0
    moving = mesh.moving_vertices
    if form == "all rows":
        return
    given, expected = [array(start, dtype), array(end, dtype)], [of_start, of_end]
    if form == "moving rows":
        given, expected = [array(start[moving], dtype), array(end[moving], dtype)], [of_start[moving], of_end[moving]]
    if form == "components":
        given = [array(x, wp.dtype_from_numpy(x.dtype)) for x in (start, end)]
    call = lambda: pipeline.launch(*given)  # noqa: E731
    if form == "displacements":
        given[1] = array(end - start, dtype)
        call, expected = lambda: pipeline.launch(given[0], displacements=given[1]), [of_start + of_end, of_end]
    tape, result = taped(call)
    backward(tape, result, weights)
    for x, gradient in zip(given, expected, strict=True):
        tolerance = 1e-9 if dtype is wp.vec3d and form != "displacements" else 1e-4
        np.testing.assert_allclose(x.grad.numpy(), gradient, rtol=tolerance, atol=tolerance)


def test_equal_tois_pass_their_gradient_to_the_first_contact():
    falling = [
        (0.1 * TRIANGLE + [0.22 * k - 0.33, 0.0, 1.0], FACE) for k in range(4)
    ]  # all their vertices meet the floor at once
    mesh = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), *falling], self_collision=False)
    end = mesh.vertices - [0, 0, 2.0] * (mesh.vertex_body > 0)[:, None]
    given = [array(mesh.vertices), array(end)]
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=0.01, device="cpu")
    tape, result = taped(lambda: pipeline.launch(*given))
    result.toi.grad.fill_(1.0)
    tape.backward()
    contacts = result.to_host().contacts
    first = int(np.flatnonzero(contacts.toi == result.toi.numpy()[0])[0])
    of_contacts = contacts.toi_gradient()
    expected = np.zeros((len(mesh.vertices), 3))
    np.add.at(expected, of_contacts.vertices[first], of_contacts.start[first])
    assert of_contacts.is_regular[first] and (contacts.toi == contacts.toi[first]).sum() > 1
    np.testing.assert_allclose(given[0].grad.numpy(), expected, atol=1e-14)


def test_flags_say_which_tois_have_a_gradient():
    bodies = [(TRIANGLE + [x, 0, z], FACE) for x in (0.0, 10.0, 20.0) for z in (0.0, 1.0)]
    mesh = ccd.CollisionMesh.from_arrays(bodies)
    fall = np.array([0.0, 2.0, 0, 0.5, 0, 0.9])[mesh.vertex_body]
    start, end = mesh.vertices.copy(), mesh.vertices - [0, 0, 1.0] * fall[:, None]
    start[15:, 2] = 0.05  # the last pair is within its distance at the start
    _, result = taped(
        lambda: ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu").launch(array(start), array(end))
    )
    toi = result.body_toi.numpy()
    assert toi[0] == toi[1] < 1.0 and np.isinf(toi[2:4]).all() and not toi[4:].any()
    np.testing.assert_array_equal(result.is_regular("body").numpy(), [True, True, *[False] * 4])
    np.testing.assert_array_equal(result.is_regular().numpy(), [True] * 6 + [False] * 12)
    assert not result.is_regular("scene").numpy() and not result.is_regular("world").numpy()


def test_what_is_overwritten_before_the_backward_pass_does_not_change_it():
    mesh, start, end = scene()
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    given, weights = [array(start), array(end)], {}
    tape, result = taped(lambda: pipeline.launch(*given))
    weighted(result, weights)
    backward(tape, result, weights)
    before = [x.grad.numpy().copy() for x in given]
    values = result.vertex_toi.numpy().copy()
    for x in given:
        x.fill_(1.0)
    pipeline.launch(array(end), array(start))  # writes to the arrays of all launches
    backward(tape, result, weights)
    assert all(np.array_equal(x.grad.numpy(), y) for x, y in zip(given, before, strict=True))
    np.testing.assert_array_equal(result.vertex_toi.numpy(), values)


def test_memory_of_tapes_that_are_dropped_is_used_again_and_that_of_others_is_not():
    mesh, start, end = scene()
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    ends = [end, start, 0.5 * (start + end), end + 0.01, start + 1.3 * (end - start)]  # with few contacts, and many

    def gradient_of(pipeline, end):
        given = [array(start), array(end)]
        tape, result = taped(lambda: pipeline.launch(*given))
        return given, tape, result

    expected = []
    for each in ends:
        given, tape, result = gradient_of(ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu"), each)
        weights = {}
        weighted(result, weights)
        backward(tape, result, weights)
        expected.append(([x.grad.numpy().copy() for x in given], result.is_regular().numpy(), weights))
    assert any(gradient[0].any() for gradient, _, _ in expected)
    kept = []
    for order in (range(5), (4, 0, 3, 1, 2, 4), (0, 0)):
        alive = [(k, gradient_of(pipeline, ends[k])) for k in order]
        kept = kept[::2] + alive[::2]
        del alive
        for k, (given, tape, result) in kept[::-1]:
            gradient, is_regular, weights = expected[k]
            np.testing.assert_array_equal(result.is_regular().numpy(), is_regular)
            backward(tape, result, weights)
            for x, of_x in zip(given, gradient, strict=True):
                np.testing.assert_array_equal(x.grad.numpy(), of_x)


def test_a_tape_that_is_dropped_frees_what_it_keeps_at_once(monkeypatch):
    mesh, start, end = scene()
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    freed = []
    delete = KeptCheck.__del__
    monkeypatch.setattr(KeptCheck, "__del__", lambda check: (freed.append(check.count), delete(check)))
    gc.disable()
    try:
        for call in (pipeline.launch, pipeline.launch_line_search):
            tape, result = taped(lambda c=call: c(array(start), array(end)))
            assert not freed
            tape.backward()
            del tape, result
            assert freed
            freed.clear()
    finally:
        gc.enable()


def test_two_launches_on_one_tape_have_gradients_of_their_own():
    mesh, start, end = scene()
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    given = [array(start), array(end)]
    tape, results = taped(lambda: [pipeline.launch(*given), pipeline.launch(given[1], given[0])])
    assert len(tape.launches) == 2
    for result in results:
        tape.zero()
        result.toi.grad.fill_(1.0)
        tape.backward()
        alone, only = taped(lambda r=result: pipeline.launch(*(given if r is results[0] else given[::-1])))
        both = [x.grad.numpy().copy() for x in given]
        alone.zero()
        only.toi.grad.fill_(1.0)
        alone.backward()
        assert all(np.array_equal(x.grad.numpy(), y) for x, y in zip(given, both, strict=True))


def test_sums_have_the_same_bits_for_every_number_of_threads():
    found = []
    for threads in (1, 2, 2):
        mesh, start, end = scene()
        pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu", num_threads=threads)
        given, weights = [array(start), array(end)], {}
        tape, result = taped(lambda p=pipeline, g=given: p.launch(*g))
        weighted(result, weights)
        backward(tape, result, weights)
        found.append([x.grad.numpy().copy() for x in given])
    for each in found[1:]:
        assert all(np.array_equal(x, y) for x, y in zip(each, found[0], strict=True))


def test_sums_have_the_same_bits_for_every_order_of_the_list(monkeypatch):
    mesh, start, end = scene()
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    given, weights, found = [array(start), array(end)], {}, []
    launch = DeviceStep.launch

    def launch_in_another_order(step, prepared):
        launch(step, prepared)
        contacts = step.result.contacts
        count = int(contacts.count.numpy()[0])
        order = np.random.default_rng(len(found)).permutation(count)
        for name in ("kind", "primitives", "toi", "status", "normal"):
            rows = getattr(contacts, name).numpy()
            rows[:count] = rows[order]

    monkeypatch.setattr(DeviceStep, "launch", launch_in_another_order)
    for _ in range(4):
        tape, result = taped(lambda: pipeline.launch(*given))
        weighted(result, weights)
        backward(tape, result, weights)
        found.append([x.grad.numpy().copy() for x in given])
    for each in found[1:]:
        assert all(np.array_equal(x, y) for x, y in zip(each, found[0], strict=True))


def test_a_graph_holds_both_passes():
    mesh, start, end = scene()
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    given, kept = [array(start), array(end)], []

    def both():
        tape, result = taped(lambda: pipeline.launch(*given))
        result.toi.grad.fill_(1.0)
        tape.backward()
        kept.append((tape, result))

    both()  # loads the kernels
    expected = [x.grad.numpy().copy() for x in given]
    for x in given:
        x.grad.zero_()
    with wp.ScopedCapture(device="cpu") as capture:
        both()
    for x, values in zip(given, (end, start), strict=True):
        x.assign(values)
        x.grad.zero_()
    wp.capture_launch(capture.graph)
    assert not np.array_equal(given[0].grad.numpy(), expected[0])
    for x, values in zip(given, (start, end), strict=True):
        x.assign(values)
        x.grad.zero_()
    wp.capture_launch(capture.graph)
    assert all(np.array_equal(x.grad.numpy(), y) for x, y in zip(given, expected, strict=True))


def test_worlds_and_a_mesh_in_the_plane_have_gradients():
    line, dot = np.array([[0.0, 0], [1, 0.1], [2, 0]]), np.array([[0.6, 1.0]])
    bodies = [(line, [[0, 1], [1, 2]]), (dot, np.zeros((0, 2), dtype=int))]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True).replicate(2)
    speed = np.repeat([2.0, 3.0], 4)
    end = mesh.vertices - np.outer(np.where(mesh.vertex_body % 2 == 1, speed, 0.0), [0, 1])
    given = [array(x, wp.vec2d) for x in (mesh.vertices, end)]
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    tape, result = taped(lambda: pipeline.launch(*given))
    result.world_toi.grad.assign([1.0, 10.0])
    tape.backward()
    t = 0.94 / np.array([2.0, 3.0])
    np.testing.assert_allclose(result.world_toi.numpy(), t, rtol=1e-12)
    dots = np.flatnonzero(mesh.vertex_body % 2 == 1)
    np.testing.assert_allclose(given[0].grad.numpy()[dots, 1], [1, 10] * (1 - t) / [2.0, 3.0], rtol=1e-9)
    np.testing.assert_allclose(given[1].grad.numpy()[dots, 1], [1, 10] * t / [2.0, 3.0], rtol=1e-9)


@pytest.mark.parametrize(
    ("kind", "dimension"), [("vertex-face", 3), ("edge-edge", 3), ("point-segment", 2), ("point-point", 3)]
)
def test_pair_functions_on_a_tape_have_the_gradients_of_their_results(kind, dimension):
    solve, points = SOLVE[kind]
    start, end = np.random.default_rng(0).standard_normal((2, 200, points, dimension))
    expected = solve(start, end, minimum_distance=0.3).toi_gradient(start, end)
    vector = {2: wp.vec2d, 3: wp.vec3d}[dimension]
    for dtype in (vector, wp.float64) if dimension == 3 else (vector,):
        given = [array(x, dtype) for x in (start, end)]
        tape, result = taped(lambda g=given: solve(*g, minimum_distance=0.3))
        assert len(tape.launches) == 1 and expected.is_regular.any()
        result.toi.grad.fill_(2.0)
        tape.backward()
        for x, gradient in zip(given, (expected.start, expected.end), strict=True):
            np.testing.assert_allclose(x.grad.numpy(), 2.0 * gradient, rtol=1e-14)


def test_nothing_is_recorded_where_no_gradient_is_asked_for():
    mesh, start, end = scene()
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    x, y = (array(values, requires_grad=False) for values in (start, end))
    points = [array(values, requires_grad=False) for values in np.random.default_rng(0).standard_normal((2, 3, 4, 3))]

    def calls():
        pipeline.launch(x, y)
        pipeline.mesh_ccd(start, end)
        pipeline.launch_proximity(x, DISTANCE).to_host()
        pipeline.launch_displacement_bounds(x, DISTANCE)
        pipeline.launch(x, y).contacts.order_by_toi()
        pipeline.launch_line_search(x, wp.clone(y))
        pipeline.find_candidates(start, end)
        return ccd.vertex_face_ccd(*points).hit

    tape, _ = taped(calls)
    assert not tape.launches


def test_calls_without_gradients_say_so_on_a_tape():
    mesh, start, end = scene()
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, device="cpu")
    given = [array(start), array(end)]
    shared = ccd.CollisionPipeline(mesh, minimum_distance=DISTANCE, start_gap_fraction=0.5, device="cpu")
    with wp.Tape(), pytest.raises(ValueError, match="expected 'hold' or None for gradients"):
        shared.launch(*given)
    with wp.Tape(), pytest.raises(ValueError, match="vertices_t0 requires a gradient"):
        pipeline.mesh_ccd(*given)
    pipeline.mesh_ccd(*(x.numpy() for x in given))
    for launch in (pipeline.launch_proximity, pipeline.launch_displacement_bounds):
        with wp.Tape(), pytest.raises(ValueError, match=r"positions requires a gradient .* finds no times of impact"):
            launch(given[0], DISTANCE)
    thick = ccd.CollisionPipeline(thick_scene()[0], device="cpu")
    thick.radius.requires_grad = True
    with wp.Tape(), pytest.raises(ValueError, match=r"radius requires a gradient .* finds no times of impact"):
        thick.launch_proximity(array(start, requires_grad=False), DISTANCE)
    integers = wp.zeros((len(start), 3), dtype=wp.int32, device="cpu")
    with wp.Tape(), pytest.raises(ValueError, match="vertices_t0 has dtype int32"):
        pipeline.launch(integers, integers)
    with wp.Tape(), pytest.raises(ValueError, match="points_t0 has dtype int32"):
        ccd.vertex_face_ccd(*2 * [wp.zeros((1, 4, 3), dtype=wp.int32, device="cpu")])
    resting = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE)], rigid=[0])
    motion = ccd.RigidMotion([[0, 0, 0, 0, 0, 0, 1.0]], twist=np.ones((1, 6)))
    with (
        wp.Tape(),
        pytest.raises(ValueError, match=r"a motion is not recorded.* motion.gradient_by_poses\(\)"),
    ):
        ccd.CollisionPipeline(resting, device="cpu").launch(*2 * [array(TRIANGLE)], motion=motion)
