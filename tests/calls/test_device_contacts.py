"""Contacts of a launch, asked on the device where they are, of which bodies and worlds, and which come first."""

import numpy as np
import pytest
import warp as wp
from launches import on_device
from scenes import FACE, NO_FACES, cloth_and_ball_in_worlds, named_cloth_and_ball

import ccd_warp as ccd

NAMES = ("points", "vertices", "weights", "bodies", "world")
OPTIONS = {"length_scale": 1.0, "device": "cpu"}


def moving_step():
    """The cloth and the ball of `named_cloth_and_ball`, of which none is static."""
    mesh, start, end = named_cloth_and_ball()
    bodies = [(start[:169], mesh.faces[mesh.face_body == 0]), (start[169:], mesh.faces[mesh.face_body == 1] - 169)]
    return ccd.CollisionMesh.from_arrays(bodies, names=mesh.names), start, end


def check(result, *positions):
    """All that the contacts say on the device is what they say on the host, bit for bit, in the order by toi."""
    expected = result.contacts.to_host(*positions).sorted_by_toi()
    order = result.contacts.order_by_toi().numpy()
    assert np.array_equal(np.sort(order), np.arange(len(result.contacts.kind)))
    first = order[: len(expected)]
    for name in ("toi", "primitives", "kind"):
        np.testing.assert_array_equal(getattr(result.contacts, name).numpy()[first], getattr(expected, name))
    for name in NAMES:
        array = getattr(result.contacts, name)
        if name == "points" and positions:
            array = result.contacts.points_at(*(on_device(x) for x in positions))
        assert array.device == result.toi.device and len(array) == len(result.contacts.kind)
        assert array.numpy()[first].tobytes() == getattr(expected, name).tobytes(), name
    return expected


def thick_step():
    """The same with radii."""
    mesh, start, end = named_cloth_and_ball()
    bodies = [(start[mesh.vertex_body == b], mesh.faces[mesh.face_body == b] - 169 * b) for b in (0, 1)]
    radius = np.random.default_rng(1).uniform(0, 0.02, len(start))
    return ccd.CollisionMesh.from_arrays(bodies, static=[1], names=mesh.names, radius=radius), start, end


@pytest.mark.parametrize(
    "make", [named_cloth_and_ball, moving_step, thick_step], ids=["static ball", "moving ball", "with radii"]
)
@pytest.mark.parametrize("dtype", [wp.vec3d, wp.vec3f], ids=["float64", "float32"])
def test_contacts_on_the_device_say_what_those_on_the_host_say(make, dtype, device):
    mesh, start, end = make()
    pipeline = ccd.CollisionPipeline(mesh, length_scale=1.0, device=device)
    x, y = (on_device(v, device, dtype) for v in (start, end))
    assert len(check(pipeline.launch(x, y))) > 1000
    result = pipeline.launch(x, displacements=on_device(end - start, device, dtype))
    assert len(check(result)) > 1000
    x.zero_()
    y.zero_()
    assert len(check(pipeline.launch(x, y)))  # the rows of earlier contacts lie behind


def test_worlds_are_told_apart():
    _, mesh, start, end = cloth_and_ball_in_worlds()
    pipeline = ccd.CollisionPipeline(mesh, **OPTIONS)
    found = check(pipeline.launch(start, end))
    assert set(found.world.tolist()) == {0, 1}
    result = pipeline.launch(start, end)
    at = result.contacts.points_at(start, end[:, :25].copy()).numpy()  # with an axis of worlds, moving vertices alone
    assert np.array_equal(at[: len(found)], result.contacts.points.numpy()[: len(found)])


def test_particles_have_their_vertices_twice():
    bodies = [([[0.0, 0, 0], [4, 0, 0]], NO_FACES, [[0, 1]]), ([[1.0, 0, 1], [0, 5, 0], [2, 5, 0]], NO_FACES)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, codimensional_points=True)
    end = mesh.vertices.copy()
    end[2] -= [0, 0, 2]
    end[3] += [2, 0, 0]
    found = check(ccd.CollisionPipeline(mesh, **OPTIONS).launch(mesh.vertices, end))
    assert found.vertices.tolist() == [[2, 2, 0, 1], [3, 3, 4, 4]]


@pytest.mark.parametrize("dtype", [wp.vec3d, wp.vec3f], ids=["float64", "float32"])
@pytest.mark.parametrize("per", ["scene", "body", "vertex"])
def test_what_stopped_a_line_search_is_found_on_the_device(per, dtype):
    found = 0
    for seed in range(6, 10):
        start, end = np.random.default_rng(seed).uniform(-1, 1, (2, 60, 3)) + (1e4 if dtype is wp.vec3d else 0.0)
        mesh = ccd.CollisionMesh.from_arrays([(start[k : k + 3], FACE) for k in range(0, 60, 3)])
        pipeline = ccd.CollisionPipeline(mesh, **OPTIONS)
        for safety in (1 - 1e-12, 1 - 1e-15):  # what is lost in the rounding of positions touches in the last pass
            x, y = (on_device(v, dtype=dtype) for v in (start, end))
            found += len(check(pipeline.launch_line_search(x, y, per=per, safety=safety, num_rounds=3)))
    assert found


def test_points_can_be_those_of_other_positions():
    mesh, start, end = named_cloth_and_ball()
    result = ccd.CollisionPipeline(mesh, **OPTIONS).launch(start, end)
    above = [0.0, 0.0, 1.0]
    check(result, start + above, end + above)
    x, y = (on_device(v, dtype=wp.vec3f) for v in (start + above, (end + above)[mesh.moving_vertices]))
    points = result.contacts.points_at(x, y)
    order = result.contacts.order_by_toi().numpy()[: result.contacts.count.numpy()[0]]
    expected = result.contacts.to_host(x.numpy(), y.numpy()).sorted_by_toi().points
    assert points.numpy()[order].tobytes() == expected.tobytes()
    assert result.contacts.points_at(x, y) is points
    for x, y, message in (
        (start[mesh.moving_vertices], end, f"vertices_t0 has {len(mesh.moving_vertices)} rows; expected {len(start)}"),
        (start, end[:-1], f"vertices_t1 has {len(end) - 1} rows; expected"),
        (start, end.astype(np.float32), "vertices_t1 has dtype vec3f; expected vec3d like vertices_t0"),
        (start, None, "vertices_t1 is a NoneType; expected an array"),
    ):
        with pytest.raises(ValueError, match=message):
            result.contacts.points_at(x, y)


def test_the_first_question_is_asked_before_the_capture():
    mesh, start, end = named_cloth_and_ball()
    result = ccd.CollisionPipeline(mesh, **OPTIONS).launch(start, end)
    questions = {name: lambda name=name: getattr(result.contacts, name) for name in NAMES}
    questions["order_by_toi"] = result.contacts.order_by_toi
    x, y = on_device(start), on_device(end)
    questions["points_at"] = lambda: result.contacts.points_at(x, y)
    for name, ask in questions.items():
        message = rf"a graph is being captured; ask for contacts\.{name}\b.* once before the capture"
        with pytest.raises(RuntimeError, match=message), wp.ScopedCapture(device="cpu"):
            ask()
    check(result)


def test_contacts_beyond_the_capacity_are_left_out():
    mesh, start, end = named_cloth_and_ball()
    pipeline = ccd.CollisionPipeline(mesh, **OPTIONS, max_contacts=100, num_threads=1)
    result = pipeline.launch(start, end)
    assert result.contacts.count.numpy()[0] > 100 and len(check(result)) == 100
    assert all(len(getattr(result.contacts, name)) == 100 for name in NAMES)


def test_nothing_is_allocated_or_launched_for_those_who_do_not_ask(monkeypatch):
    mesh, start, end = named_cloth_and_ball()
    pipeline = ccd.CollisionPipeline(mesh, **OPTIONS, max_contacts=12345)
    made, launched = [], []
    empty, launch = wp.empty, wp.launch
    monkeypatch.setattr(wp, "empty", lambda shape, *a, **k: (made.append(shape), empty(shape, *a, **k))[1])
    monkeypatch.setattr(wp, "launch", lambda kernel, *a, **k: (launched.append(kernel.key), launch(kernel, *a, **k))[1])
    result = pipeline.launch(start, end)
    assert made.count(12345) == len(vars(result.contacts)) - 1 and not any("fill_points" in key for key in launched)
    before, launched[:] = len(made), []
    points = result.contacts.points
    assert made[before:] == [12345]
    assert all("fill_points" in key for key in launched)
    before = len(made)
    assert result.contacts.points is points and len(made) == before
    assert result.contacts.count.numpy()[0] > 0


def test_contacts_that_know_no_positions_or_no_mesh_say_so():
    mesh, start, end = named_cloth_and_ball()
    pipeline = ccd.CollisionPipeline(mesh, **OPTIONS)
    result = pipeline.reserve()
    with pytest.raises(ValueError, match=r"contacts\.points are not known, as no launch has read positions"):
        _ = result.contacts.points
    alone = ccd.DeviceContacts(**vars(pipeline.launch(start, end).contacts))
    for ask in (*(lambda name=name: getattr(alone, name) for name in NAMES), alone.order_by_toi):
        with pytest.raises(ValueError, match="contacts were made of arrays alone; expected those of a launch"):
            ask()


def test_contacts_of_one_toi_come_in_the_order_of_the_host():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    falling = [(corners + [3.0 * k, 0, 1], FACE) for k in range(40)]
    lying = [(corners + [3.0 * k, 0, 0], FACE) for k in range(40)]
    mesh = ccd.CollisionMesh.from_arrays([*falling, *lying], static=range(40, 80))
    end = mesh.vertices - [0, 0, 2]
    found = check(ccd.CollisionPipeline(mesh, **OPTIONS).launch(mesh.vertices, end))
    assert len(np.unique(found.toi)) < len(found) // 4
