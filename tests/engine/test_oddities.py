"""Lengths that hardly mean what they say: positions that blow up, and a distance of many edges."""

import itertools
import signal
import warnings

import numpy as np
import pytest
import scenes
import trimesh
import warp as wp
from laws.outputs import tois_of

import ccd_warp as ccd

AT_START, HIDDEN = ccd.CCDStatus.INITIAL_CONTACT, ccd.CCDStatus.ROUNDING_LIMIT
SHEET, FACES = scenes.sheet(4)  # of 32 faces, whose median edge is 0.25 long


def two_sheets(height=0.3, *more, **arguments):
    """Two sheets, one above the other."""
    bodies = [(SHEET, FACES), (SHEET + [0.0, 0.0, height], FACES), *more]
    return ccd.CollisionMesh.from_arrays(bodies, names=["floor", "sheet", "plane"][: len(bodies)], **arguments)


def with_one_at(mesh, size):
    """Positions of which one vertex of the sheet is far away."""
    x = mesh.vertices.copy()
    x[25 + 7] = size
    return x


# --- positions that blow up ---


@pytest.mark.parametrize("size", [1e15, 1e20, 1e30])
def test_a_vertex_that_blows_up_is_named_where_rounding_hides_all_gaps(size, precision):
    mesh, frames = two_sheets(), (two_sheets().vertices, with_one_at(two_sheets(), size))
    with pytest.warns(RuntimeWarning, match=r"so toi is 0: vertex 32 \(vertex 7 of sheet\) is 1e"):
        result = ccd.mesh_ccd(mesh, *frames, precision=precision)
    assert result.toi == 0.0 and {*result.contacts.status.tolist()} == {int(HIDDEN)}
    assert not result.pairs_at_start and result.counts.num_contacts_at_limit == len(result.contacts)
    place = f"vertex 32 (vertex 7 of sheet) is {size:.3g} from the others at the end"
    assert f"rounding hides the gaps of {len(result.contacts)} pairs at the start, with toi 0: {place}" in repr(result)
    for start in frames:  # a mesh that has warned once does not warn again
        with pytest.warns(RuntimeWarning, match=r"is 1e\+\d\d from the others at the") as warned:
            assert ccd.collision_free_step(two_sheets(), start, frames[1], precision=precision) == 0.0
        assert warned[0].filename == __file__


@pytest.mark.parametrize("option", [{}, {"minimum_distance": 0.1}, {"minimum_separation": 0.1}])
def test_pairs_that_touch_at_the_start_do_so_wherever_others_end(option):
    mesh = two_sheets(height=0.05 if option else 0.0)
    with pytest.warns(RuntimeWarning, match="hides gaps at the start"):
        contacts = ccd.mesh_ccd(mesh, mesh.vertices, with_one_at(mesh, 1e20), **option).contacts
    at_rest = ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, **option).contacts
    at_start = contacts[contacts.status == AT_START]
    assert (at_rest.status == AT_START).all() and np.isin(contacts.status, [AT_START, HIDDEN]).all()
    assert tois_of(at_start) == tois_of(at_rest) != {}


def test_a_launch_flags_what_rounding_hides():
    mesh, limit = two_sheets().replicate(2), ccd.LaunchFlag.ROUNDING_LIMIT
    end = mesh.vertices.copy()
    end[50 + 32] = 1e20
    pipeline = ccd.CollisionPipeline(mesh)
    found = pipeline.launch(mesh.vertices, end).to_host()
    assert found.flags == limit and found.world_flags.tolist() == [0, limit]
    assert (found.contacts.status == HIDDEN).all() and found.world_toi.tolist() == [np.inf, 0.0]
    # what the first pass of a line search cannot tell, a shorter step shows
    assert pipeline.launch_line_search(mesh.vertices, end).to_host().flags == 0


def test_a_pair_whose_motion_blows_up_is_not_in_contact():
    start = np.array([[0.2, 0.2, 0.5], [0, 0, 0], [1, 0, 0], [0, 1, 0]])
    end = start * [1e20, -3e20, 1e20]
    for function, touching in ((ccd.vertex_face_ccd, start * [1, 1, 0]), (ccd.edge_edge_ccd, 0 * start)):
        for points, status, count in ((start, HIDDEN, 1), (touching, AT_START, 9)):
            result = function(*(np.tile(x, (count, 1, 1)) for x in (points, end)), length_scale=1.0)
            assert (result.toi == 0.0).all() and (result.status == status).all()


def test_a_vertex_far_along_a_plane_is_not_in_contact_with_it():
    mesh = two_sheets(0.3, ccd.HalfSpace([0, 0, -1.0], [1.0, 2.0, 3.0]))
    start = with_one_at(mesh, [2e20, -1e20, 10.0])
    with pytest.warns(RuntimeWarning, match="from the others at the start"):
        contacts = ccd.mesh_ccd(mesh, start, start, pair_kinds=["vertex_plane"]).contacts
    assert contacts.primitives.tolist() == [[32, 0]] and contacts.status.tolist() == [int(HIDDEN)]


def test_a_loop_of_steps_warns_once_of_each_oddity_and_errors_are_raised_each_time():
    mesh, other = two_sheets(), two_sheets()
    tilted = mesh.vertices + [0.01, 0.02, -1.0] * (mesh.vertex_body * (mesh.vertices[:, 0] + 0.1))[:, None]
    first, another = (ccd.CollisionPipeline(mesh) for _ in range(2))
    for call in (first.mesh_ccd, another.mesh_ccd, lambda *frames: ccd.mesh_ccd(other, *frames)):
        with pytest.warns(RuntimeWarning) as warned:
            results = [call(mesh.vertices, with_one_at(mesh, 1e20 * (k + 1))) for k in range(4)]
        assert len(warned) == 1 and str(warned[0].message).startswith("rounding at the size")
        for k, result in enumerate(results):  # each result still says what is odd
            assert f"is {1e20 * (k + 1):.3g} from the others at the end" in repr(result)
    with pytest.warns(RuntimeWarning, match="pass through each other: [0-9]+ of floor and sheet") as warned:
        starts = [first.mesh_ccd(tilted, tilted, check_start=True).start for _ in range(2)]
    assert len(warned) == 1 and starts[0].num_crossing == starts[1].num_crossing > 0
    pipeline = ccd.CollisionPipeline(mesh)
    for k in range(2):
        with warnings.catch_warnings(), pytest.raises(RuntimeWarning, match="rounding at the size"):
            warnings.simplefilter("error", RuntimeWarning)
            pipeline.mesh_ccd(mesh.vertices, with_one_at(mesh, 1e20 * (k + 1)))


# --- a distance of many edges ---


def thick(thickness, distance, **arguments):
    """The two sheets with a distance in one of the forms that it has, and a pipeline's options."""
    radius = {"radius": distance / 2, "radius on the device": 0.0}.get(thickness)
    of_separation = {"minimum_separation": distance, "length_scale": 1.0}
    options = {"distance": {"minimum_distance": distance}, "separation": of_separation}.get(thickness, {})
    return two_sheets(radius=radius, **arguments), options


@pytest.mark.parametrize("thickness", ["distance", "separation", "radius"])
def test_a_distance_of_many_edges_is_named_and_answered_without_the_search(thickness):
    mesh, options = thick(thickness, 5.0)
    name = "distance of a pair, radii included," if thickness == "radius" else "distance at which pairs touch"
    sentence = f"^the {name} is 5, 20 times the median edge of 0.25; neighbours are within it: exclusion_rings of"
    end, pipeline = mesh.vertices + [0.0, 0.0, 0.1], ccd.CollisionPipeline(mesh, start_gap_fraction=None, **options)
    with pytest.warns(RuntimeWarning, match=sentence):
        assert pipeline.collision_free_step(mesh.vertices, end) == 0.0
    assert not any(pipeline.counts.num_after_cull.values())
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the pipeline has said so
        assert not pipeline.is_step_collision_free(mesh.vertices, end)
        assert not any(pipeline.counts.num_after_cull.values())
        assert pipeline.mesh_ccd(mesh.vertices, end).toi == 0.0 < sum(pipeline.counts.num_after_cull.values())


@pytest.mark.parametrize("thickness", ["distance", "radius"])
def test_a_search_for_what_is_near_within_many_edges_is_named_once(thickness):
    mesh, _ = thick(thickness, 0.0 if thickness == "distance" else 0.5)
    pipeline, radii = ccd.CollisionPipeline(mesh), ", radii included," if thickness == "radius" else ""
    sentence = (
        rf"^the distance in which pairs are searched{radii} is 1\.5, 6 times the median edge of 0\.25; neighbours"
    )
    for call in (pipeline.find_proximity, pipeline.displacement_bounds):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            call(mesh.vertices, 0.24)
        pipeline._workspace._said.clear()
        with pytest.warns(RuntimeWarning, match=sentence) as warned:
            for _ in range(2):
                call(mesh.vertices, 1.0 if radii else 1.5)
        assert [each.filename for each in warned] == [__file__]


def test_a_body_with_vertices_in_one_place_as_files_of_stl_have_is_told_once_that_it_touches_itself():
    triangles = SHEET[FACES].reshape(-1, 3) * [1, 1, -0.0]
    corners = np.arange(len(triangles)).reshape(-1, 3)
    apart = [(SHEET + [0, 0, 1], FACES), (triangles, corners)]
    mesh = ccd.CollisionMesh.from_arrays(apart, names=["cloth", "part"])
    sentence = (
        r"^body 1 \(part\) has 71 vertices where another of it is, such .*toi is 0: .*merge_vertices\(\) of trimesh"
    )
    for name in ("mesh_ccd", "collision_free_step", "is_step_collision_free", "line_search"):
        pipeline = ccd.CollisionPipeline(mesh)
        with pytest.warns(RuntimeWarning, match=sentence) as warned:
            for _ in range(2):
                getattr(pipeline, name)(mesh.vertices, mesh.vertices + [0, 0, 0.1])
        assert len(warned) == 1
    part = mesh.vertex_body == 1
    merged = trimesh.Trimesh(triangles, corners, process=False)
    merged.merge_vertices()
    fine = [ccd.CollisionMesh.from_arrays([(merged.vertices, merged.faces)])]
    fine += [ccd.CollisionMesh.from_arrays(apart, **leaving_out) for leaving_out in ({"static": [1]}, {"rigid": [1]})]
    fine += [mesh.excluding({"vertices": np.argwhere(np.triu(np.multiply.outer(part, part)))})]
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        warnings.filterwarnings("ignore", "motion is None")
        for each in fine:  # of which something may touch even so, one sheet on the other
            start = each.vertices * [1, 1, 0]
            assert ccd.mesh_ccd(each, start, start).toi == (np.inf if each.num_bodies == 1 else 0.0)


def test_a_warning_that_is_an_error_hides_no_interrupt(monkeypatch):
    mesh = two_sheets()
    monkeypatch.setattr("ccd_warp._engine.host.plan.HostPlan.play", lambda *_: signal.raise_signal(signal.SIGINT))
    with warnings.catch_warnings(), pytest.raises(KeyboardInterrupt):
        warnings.simplefilter("error")
        ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices, minimum_distance=2.5)


@pytest.mark.parametrize("thickness", ["distance", "separation", "radius", "radius on the device"])
def test_a_distance_of_three_edges_is_named_once_by_every_call_on_host_and_device(thickness):
    x = two_sheets().vertices
    y, is_on_device = x + [0.0, 0.0, 0.1], thickness == "radius on the device"
    calls = [
        lambda pipeline: pipeline.launch(x, y),
        lambda pipeline: pipeline.launch_line_search(x, y.copy()),
        lambda pipeline: pipeline.reserve(),
        lambda pipeline: pipeline.reserve(vertices=x),
        lambda pipeline: pipeline.collision_free_step(x, y),
    ]
    for share, call in itertools.product((1.0, 0.99), calls[: 5 - is_on_device]):  # of three edges
        mesh, options = thick(thickness, 0.75 * share)
        pipeline = ccd.CollisionPipeline(mesh, **options)
        if is_on_device:
            pipeline.radius.fill_(0.375 * share)
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            warnings.filterwarnings("ignore", "a launch has .* in excess")
            for each in (call, calls[0]) * 2:
                each(pipeline)
        assert [each.filename for each in warned] == [__file__] * (share == 1)
        assert share < 1 or "is 0.75, 3 times the median edge of 0.25" in str(warned[0].message)


@pytest.mark.parametrize("form", ["moving float32", "array", "in the plane"])
def test_a_launch_looks_at_its_own_positions_and_at_those_of_moving_vertices(form):
    bodies = [(9.0 * SHEET, FACES), (9.0 * SHEET - [0, 0, 99], FACES)]
    if form == "in the plane":
        bodies = [(9.0 * SHEET[:, :2], ccd.CollisionMesh.from_arrays([(SHEET, FACES)]).edges)]
    mesh = ccd.CollisionMesh.from_arrays(bodies, static=[1] if "moving" in form else [])
    x = (mesh.vertices / 9.0)[mesh.moving_vertices].astype(np.float32 if "32" in form else np.float64)
    x = wp.array(x, dtype=wp.vec3d) if form == "array" else x
    pipeline = ccd.CollisionPipeline(mesh, minimum_distance=0.8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pipeline.reserve()
    with pytest.warns(RuntimeWarning, match=r"is 0\.8, 3\.2 times the median edge of 0\.25"):
        pipeline.launch(x, x)


@pytest.mark.parametrize("per", ["scene", "vertex"])
def test_a_line_search_at_a_distance_of_many_edges_takes_one_round(per):
    mesh = two_sheets(static=[0])
    with pytest.warns(RuntimeWarning, match="20 times the median edge"):
        end, options = mesh.vertices + np.outer(mesh.vertex_body, [0, 0, 0.1]), {"minimum_distance": 5.0}
        found = ccd.line_search(mesh, mesh.vertices, end, per=per, start_gap_fraction=None, **options)
    assert found.num_rounds == 1 and found.fraction == 0.0 and np.array_equal(found.vertices, mesh.vertices)
    assert found.vertex_fraction.tolist() == [1.0] * 25 + [0.0] * 25 and len(found.touching) > 0


def test_nothing_is_said_where_neighbours_are_excluded_or_there_are_none(recwarn):
    no_rows = np.zeros((0, 3))
    apart, alone = two_sheets(10.0, self_collision=False), {"exclusion_rings": 9}
    for mesh, distance in ((ccd.CollisionMesh.from_arrays([(SHEET, FACES)], **alone), 2.0), (apart, 5.0)):
        assert ccd.collision_free_step(mesh, mesh.vertices, mesh.vertices, minimum_distance=distance) == 1.0
    for body, static in (((no_rows, FACES[:0]), []), ((SHEET, FACES), [0])):  # of which a first launch looks at none
        mesh = ccd.CollisionMesh.from_arrays([body], static=static)
        assert ccd.CollisionPipeline(mesh, minimum_distance=1e-3).launch(no_rows, no_rows).to_host().toi == np.inf
    assert not recwarn.list
