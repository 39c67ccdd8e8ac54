"""Lengths that hardly mean what they say: positions that blow up, and a distance of many edges."""

import warnings

import numpy as np
import pytest
import scenes
import warp as wp

import ccd_warp as ccd

AT_START, HIDDEN = ccd.CCDStatus.INITIAL_CONTACT, ccd.CCDStatus.ROUNDING_LIMIT


def two_sheets(height=0.3, **arguments):
    """Two sheets of 32 faces, one above the other."""
    vertices, faces = scenes.sheet(4)
    bodies = [(vertices, faces), (vertices + [0.0, 0.0, height], faces)]
    return ccd.CollisionMesh.from_arrays(bodies, names=["floor", "sheet"], **arguments)


def with_one_at(x, size):
    """Positions of which one vertex of the sheet is far away."""
    x = x.copy()
    x[25 + 7] = size
    return x


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("size", [1e15, 1e20, 1e30])
def test_a_vertex_that_blows_up_is_named_where_rounding_hides_all_gaps(size, precision):
    mesh = two_sheets()
    start, end = mesh.vertices, with_one_at(mesh.vertices, size)
    with pytest.warns(RuntimeWarning, match=r"so toi is 0: vertex 32 \(vertex 7 of sheet\) is 1e"):
        result = ccd.mesh_ccd(mesh, start, end, precision=precision)
    assert result.toi == 0.0 and {*result.contacts.status.tolist()} == {int(HIDDEN)}
    assert not result.pairs_at_start and result.counts.num_contacts_at_limit == len(result.contacts)
    place = f"vertex 32 (vertex 7 of sheet) is {size:.3g} from the others at the end"
    assert f"rounding hides the gaps of {len(result.contacts)} pairs at the start, with toi 0: {place}" in repr(result)


def test_a_step_of_0_says_that_positions_blow_up():
    for is_at_start in (False, True):
        mesh = two_sheets()  # a mesh that has warned once does not warn again
        far = with_one_at(mesh.vertices, 1e20)
        frames = (far if is_at_start else mesh.vertices, far)
        with pytest.warns(RuntimeWarning, match="is 1e[+]20 from the others at the") as warned:
            assert ccd.collision_free_step(mesh, *frames) == 0.0
        assert warned[0].filename == __file__


@pytest.mark.parametrize("option", [{}, {"minimum_distance": 0.1}, {"minimum_separation": 0.1}])
def test_pairs_that_touch_at_the_start_do_so_wherever_others_end(option):
    mesh = two_sheets(height=0.05 if option else 0.0)
    with pytest.warns(RuntimeWarning, match="hides gaps at the start"):
        contacts = ccd.mesh_ccd(mesh, mesh.vertices, with_one_at(mesh.vertices, 1e20), **option).contacts
    at_rest = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, **option).contacts
    at_start = contacts[contacts.status == AT_START]
    assert len(at_start) and (at_rest.status == AT_START).all()
    assert np.array_equal(at_start.kind, at_rest.kind)
    assert np.array_equal(at_start.primitives, at_rest.primitives)
    assert ((contacts.status == AT_START) | (contacts.status == HIDDEN)).all()


def test_a_launch_flags_what_rounding_hides():
    mesh = two_sheets().replicate(2)
    end = mesh.vertices.copy()
    end[50 + 32] = 1e20
    pipeline = ccd.CollisionPipeline(mesh, device="cpu")
    found = pipeline.launch(mesh.vertices, end).to_host()
    limit = ccd.LaunchFlag.ROUNDING_LIMIT
    assert found.flags == limit and found.world_flags.tolist() == [0, limit]
    assert (found.contacts.status == HIDDEN).all() and found.world_toi.tolist() == [np.inf, 0.0]
    # what the first pass of a line search cannot tell, a shorter step shows
    assert pipeline.launch_line_search(mesh.vertices, end).to_host().flags == 0


@pytest.mark.parametrize("function", [ccd.vertex_face_ccd, ccd.edge_edge_ccd])
@pytest.mark.parametrize("count", [1, 9])
def test_a_pair_whose_motion_blows_up_is_not_in_contact(function, count):
    start = np.array([[0.2, 0.2, 0.5], [0, 0, 0], [1, 0, 0], [0, 1, 0]])
    end = start * [1e20, -3e20, 1e20]
    touching = start * [1, 1, 0] if function is ccd.vertex_face_ccd else np.zeros((4, 3))
    for points, status in ((start, HIDDEN), (touching, AT_START)):
        pairs = [np.tile(x, (count, 1, 1)) for x in (points, end)]
        result = function(*pairs, length_scale=1.0, device="cpu")
        assert (result.toi == 0.0).all() and (result.status == status).all()


def test_a_vertex_far_along_a_plane_is_not_in_contact_with_it():
    mesh = ccd.CollisionMesh.from_arrays([*two_sheet_bodies(), ccd.HalfSpace([0, 0, -1.0], [1.0, 2.0, 3.0])])
    start = with_one_at(mesh.vertices, [2e20, -1e20, 10.0])
    with pytest.warns(RuntimeWarning, match="from the others at the start"):
        contacts = ccd.mesh_ccd(mesh, start, start, pair_kinds=["vertex_plane"]).contacts
    assert contacts.primitives.tolist() == [[32, 0]] and contacts.status.tolist() == [int(HIDDEN)]


def two_sheet_bodies():
    vertices, faces = scenes.sheet(4)
    return [(vertices, faces), (vertices + [0.0, 0.0, 0.3], faces)]


@pytest.mark.parametrize("thickness", ["distance", "separation", "radius"])
def test_a_distance_of_many_edges_is_named_and_answered_without_the_search(thickness):
    mesh = two_sheets(radius=2.5 if thickness == "radius" else None)
    of_separation = {"minimum_separation": 5.0, "length_scale": 1.0}
    options = {"distance": {"minimum_distance": 5.0}, "separation": of_separation, "radius": {}}[thickness]
    name = "distance of a pair, radii included," if thickness == "radius" else "distance at which pairs touch"
    sentence = f"^the {name} is 5, 20 times the median edge of 0.25; neighbours are within it: exclusion_rings of"
    end = mesh.vertices + [0.0, 0.0, 0.1]
    pipeline = ccd.CollisionPipeline(mesh, start_gap_fraction=None, **options)
    with pytest.warns(RuntimeWarning, match=sentence) as warned:
        assert pipeline.collision_free_step(mesh.vertices, end) == 0.0
    assert not any(pipeline.counts.num_after_cull.values())
    assert len(warned) == 1 and warned[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the pipeline has said so
        assert not pipeline.is_step_collision_free(mesh.vertices, end)
        assert not any(pipeline.counts.num_after_cull.values())
        assert pipeline.mesh_ccd(mesh.vertices, end).toi == 0.0
        assert any(pipeline.counts.num_after_cull.values())


@pytest.mark.parametrize("thickness", ["distance", "separation", "radius", "radius on the device"])
def test_a_distance_of_three_edges_is_named_once_by_every_call_on_host_and_device(thickness):
    radius = {"radius": 0.375, "radius on the device": 0.0}.get(thickness)
    mesh = two_sheets(radius=radius)
    of_separation = {"minimum_separation": 0.75, "length_scale": 1.0}
    options = {"distance": {"minimum_distance": 0.75}, "separation": of_separation}.get(thickness, {})
    start, end = mesh.vertices, mesh.vertices + [0.0, 0.0, 0.1]
    calls = {
        "collision_free_step": lambda pipeline: pipeline.collision_free_step(start, end),
        "launch": lambda pipeline: pipeline.launch(start, end),
        "launch_line_search": lambda pipeline: pipeline.launch_line_search(start, end.copy()),
        "reserve": lambda pipeline: pipeline.reserve(),
        "reserve for positions": lambda pipeline: pipeline.reserve(vertices=start),
    }
    if thickness == "radius on the device":
        del calls["collision_free_step"]
    for share, is_said in ((1.0, True), (0.99, False)):  # of three edges
        for call in calls.values():
            pipeline = ccd.CollisionPipeline(two_sheets(radius=radius) if is_said else mesh, device="cpu", **options)
            if thickness == "radius on the device":
                pipeline.radius.fill_(0.375 * share)
            with warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always")
                for _ in range(2):
                    call(pipeline)
                    calls["launch"](pipeline)
            assert len(warned) == is_said
            if is_said:
                assert "is 0.75, 3 times the median edge of 0.25" in str(warned[0].message)
                assert warned[0].filename == __file__
        mesh = two_sheets(radius=None if radius is None else 0.99 * radius)
        options |= {name: 0.99 * value for name, value in options.items() if name != "length_scale"}


def test_a_launch_looks_at_its_own_positions_and_at_those_of_moving_vertices():
    for form in ("whole", "moving", "float32", "array", "in the plane"):
        vertices, faces = scenes.sheet(4)
        if form == "in the plane":
            edges = ccd.CollisionMesh.from_arrays([(vertices, faces)]).edges
            mesh = ccd.CollisionMesh.from_arrays([(9.0 * vertices[:, :2], edges)])
        else:
            bodies = [(9.0 * vertices, faces), (9.0 * vertices - [0, 0, 99], faces)]
            mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1] if form == "moving" else [])
        x = (mesh.vertices / 9.0)[mesh.moving_vertices if form == "moving" else slice(None)]
        x = x.astype(np.float32) if form == "float32" else x
        x = wp.array(x, dtype=wp.vec3d, device="cpu") if form == "array" else x.copy()
        pipeline = ccd.CollisionPipeline(mesh, device="cpu", minimum_distance=0.8)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            pipeline.reserve()
        with pytest.warns(RuntimeWarning, match=r"is 0\.8, 3\.2 times the median edge of 0\.25"):
            pipeline.launch(x, x)


def test_a_first_launch_with_a_distance_and_no_rows_looks_at_none():
    vertices, faces = scenes.sheet(2)
    for bodies, static in ([(np.zeros((0, 3)), faces[:0])], []), ([(vertices, faces)], [0]):
        mesh = ccd.CollisionMesh.from_arrays(bodies, static=static)
        pipeline = ccd.CollisionPipeline(mesh, device="cpu", minimum_distance=1e-3)
        assert pipeline.launch(np.zeros((0, 3)), np.zeros((0, 3))).to_host().toi == np.inf


@pytest.mark.parametrize("per", ["scene", "vertex"])
def test_a_line_search_at_a_distance_of_many_edges_takes_one_round(per):
    mesh = two_sheets(static=[0])
    end = mesh.vertices + [0, 0, 0.1] * (mesh.vertex_body == 1)[:, None]
    strict = {"minimum_distance": 5.0, "start_gap_fraction": None}
    with pytest.warns(RuntimeWarning, match="20 times the median edge"):
        found = ccd.line_search(mesh, mesh.vertices, end, per=per, **strict)
        contacts = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, minimum_distance=5.0).contacts
    assert found.num_rounds == 1 and found.fraction == 0.0 and np.array_equal(found.vertices, mesh.vertices)
    assert found.vertex_fraction.tolist() == [1.0] * 25 + [0.0] * 25
    assert np.array_equal(found.touching.primitives, contacts.primitives)


@pytest.mark.filterwarnings("ignore:the distance at which pairs touch")
@pytest.mark.parametrize("per", ["scene", "vertex"])
def test_a_holding_line_search_at_a_distance_of_many_edges_finds_the_holds_first(per, monkeypatch):
    mesh = two_sheets(static=[0])
    start, falls = mesh.vertices, (mesh.vertex_body == 1)[:, None]
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=5.0)
    for end, fraction in ((start + [0, 0, 0.1] * falls, 1.0), (start - [0.1, 0.1, 0.0] * start * falls, 0.0)):
        early = pipeline.line_search(start, end, per=per)
        with monkeypatch.context() as patched:
            patched.setattr(ccd.CollisionPipeline, "_reaches_neighbours", lambda *_: False)
            late = pipeline.line_search(start, end, per=per)
        assert early.num_rounds == late.num_rounds
        assert early.fraction == late.fraction == fraction
        np.testing.assert_array_equal(early.vertices, late.vertices)
        np.testing.assert_array_equal(early.touching.primitives, late.touching.primitives)


def test_nothing_is_said_where_neighbours_are_excluded_or_there_are_none(recwarn):
    vertices, faces = scenes.sheet(4)
    mesh = ccd.CollisionMesh.from_arrays([(vertices, faces)], exclusion_rings=9)
    assert ccd.collision_free_step(mesh, mesh.vertices, mesh.vertices, minimum_distance=2.0) == 1.0
    mesh = two_sheets(height=10.0, self_collision=False)
    assert ccd.collision_free_step(mesh, mesh.vertices, mesh.vertices, minimum_distance=5.0) == 1.0
    assert not recwarn.list


def frames_that_blow_up(mesh, count):
    """Steps of which each has one vertex farther away than the one before, so that no two are described alike."""
    return [(mesh.vertices, with_one_at(mesh.vertices, 1e20 * (k + 1))) for k in range(count)]


@pytest.mark.parametrize("form", ["pipeline", "function"])
def test_a_loop_of_steps_warns_once_and_each_result_still_says_what_is_odd(form):
    mesh = two_sheets()
    call = ccd.CollisionPipeline(mesh).mesh_ccd if form == "pipeline" else lambda *frames: ccd.mesh_ccd(mesh, *frames)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        results = [call(*frames) for frames in frames_that_blow_up(mesh, 4)]
    assert [str(each.message).partition(":")[0].split()[0] for each in warned] == ["rounding"]
    for k, result in enumerate(results):
        assert {*result.contacts.status.tolist()} == {int(HIDDEN)}
        assert f"is {1e20 * (k + 1):.3g} from the others at the end" in repr(result)


def test_another_pipeline_and_another_oddity_are_warned_of():
    mesh = two_sheets()
    (frames,) = frames_that_blow_up(mesh, 1)
    tilted = mesh.vertices + [0.01, 0.02, -1.0] * (mesh.vertex_body * (mesh.vertices[:, 0] + 0.1))[:, None]
    for _ in range(2):
        pipeline = ccd.CollisionPipeline(mesh)
        with pytest.warns(RuntimeWarning, match="rounding at the size"):
            assert pipeline.mesh_ccd(*frames).toi == 0.0
        with pytest.warns(RuntimeWarning, match="pass through each other: [0-9]+ of floor and sheet") as warned:
            starts = [pipeline.mesh_ccd(tilted, tilted, check_start=True).start for _ in range(2)]
        assert len(warned) == 1 and starts[0].num_crossing == starts[1].num_crossing > 0


def test_a_warning_that_is_an_error_is_raised_each_time():
    mesh = two_sheets()
    pipeline = ccd.CollisionPipeline(mesh)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        for frames in frames_that_blow_up(mesh, 2):
            with pytest.raises(RuntimeWarning, match="rounding at the size"):
                pipeline.mesh_ccd(*frames)
