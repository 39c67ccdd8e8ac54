"""Every argument of every public function meets every value of `hostile`: taken exactly, or refused by its name."""

import copy
import inspect
import pickle
import typing
from dataclasses import is_dataclass

import hostile
import numpy as np
import pytest
import warp as wp
from daily import marked
from every_call import (
    CABLE,
    END,
    EVERY,
    FACE,
    MESH,
    PIPELINE,
    RESULT,
    START,
    TRIANGLE,
    Anywhere,
    Drawn,
    every_call,
    run,
    written,
)

import ccd_warp as ccd
from ccd_warp import datasets, viz
from ccd_warp._engine.mesh.rings import vertex_rings


@pytest.fixture(autouse=True)
def no_drawing(monkeypatch):
    """Nothing is drawn, no window opened."""

    def draw():
        raise Drawn

    monkeypatch.setattr(viz, "drawing_without_display", draw)
    monkeypatch.setattr(viz, "import_pyvista", draw)
    monkeypatch.setattr(viz._export, "import_pyvista", draw)


@pytest.fixture(scope="module")
def calls(tmp_path_factory):
    return written(tmp_path_factory.mktemp("data"))


REALS = {"tolerance", "minimum_separation", "minimum_distance", "start_gap_fraction", "t_max", "length_scale"}
REALS |= {"inflation", "safety", "t", "radius", "distance", "search_radius"}
OPTIONAL = {
    *(
        "start_gap_fraction",
        "length_scale",
        "device",
        "num_threads",
        "pair_kinds",
        "memory_limit",
        "max_pairs",
        "camera",
    ),
    *("max_contacts", "body_pairs", "vertex_world", "truth", "kind", "vertices", "names", "exclude_pairs", "radius"),
    *("displacement", "faces", "pivot", "twist", "motion", "links", "axis", "base", "packages"),
}
TEXTS = {"name", "displacement"}
REQUIRED = {("excluding", "exclude_pairs"), ("Queries", "kind"), ("write_truth", "truth"), ("frame", "vertices")}
REQUIRED |= {("from_volume", "vertices"), ("RigidMotion of a twist", "twist"), ("edges_by_max", "faces")}
REQUIRED |= {("Joint", "kind"), ("Joint", "axis")}
PATHS = {"mesh_path", "poses_path", "path", "folder", "start_path", "end_path", "paths"}
# What is no mistake: the value has the meaning that the documentation gives it.
FLAGS = {"check_start", "self_collision", "codimensional_points", "progress", "surface", "split"}
TAKEN = {
    "None": OPTIONAL,
    "negative zero": {"minimum_separation", "minimum_distance", "t_max", "inflation", "t", "radius", "distance"},
    "fraction": REALS,
    "longdouble": REALS,
    "float16": REALS,
    "empty list": {"static", "kinematic", "rigid", "faces of body 0", "edges of body 0"},
    "nested empty list": {"faces of body 0", "edges of body 0"},
    "empty dict": {"static", "kinematic", "rigid", "packages", "exclude_pairs"},
    "bool": FLAGS,
    "numpy bool": FLAGS,
    "0-d float array": {"radius"},
    "0-d int array": {"radius"},
    "0-d bool array": FLAGS - {"progress", "check_start", "surface", "split"},
    "int beyond float64": {"memory_limit", "exclusion_rings", "max_work", "max_bytes"},
    "minus one": {"i"},
    "text": TEXTS,
    "empty text": TEXTS,
    "text with a null": TEXTS,
    "array of texts": {"names"},
}
EXCEPTIONS = REQUIRED | {("render_step", "t_max"), ("draw_step", "t_max")}


def is_taken(name, call, argument):
    if (call, argument) == ("rigid_ccd", "start_gap_fraction"):
        return name == "None"
    if call == "Joint" and argument in ("name", "parent", "child"):
        return name in ("text", "text with a null")
    if (name, call, argument) == ("None", "to_pyvista", "result"):
        return True
    if (call, argument) in EXCEPTIONS and name in ("None", "negative zero"):
        return False
    return argument in TAKEN.get(name, ())


# What a message calls an argument that has parts.
NAMES = {"bodies": "bod", "others": "", "from_volume vertices": "of body 0", "vertices of body 0": "of body 0"}


def _check_refusal(error, name, *words):
    text = str(error)
    kind = IndexError if name == "i" and "an index" in text else ValueError
    if "trimesh.Trimesh" in text:  # what from_trimesh does not know is of a wrong type
        kind = TypeError
    assert isinstance(error, kind), f"{type(error).__name__}: {text}"
    for word in (name, "expected", *words):
        assert word in text, text
    assert "\n" not in text and len(text) < 400, text


def _parts(result):
    """What a result consists of, but for times."""
    if isinstance(result, ccd.CollisionMesh):
        return result.__getstate__()
    if isinstance(result, ccd.CollisionPipeline):
        return {}
    if isinstance(result, ccd.DeviceContacts):
        return vars(result.to_host())
    if isinstance(result, (ccd.RigidMotion, ccd.AffineMotion)):
        return vars(result)
    if is_dataclass(result):
        return {name: value for name, value in vars(result).items() if name not in ("timings", "_step")}
    if isinstance(result, dict):
        return result
    return dict(enumerate(result)) if isinstance(result, (tuple, list)) else None


def _arrays(result):
    """All arrays of a result."""
    if isinstance(result, wp.array):
        return [result.numpy()]
    if isinstance(result, np.ndarray):
        return [result]
    return [array for part in (_parts(result) or {}).values() for array in _arrays(part)]


def _check_same(result, expected):
    if isinstance(expected, (np.ndarray, wp.array)):
        (result,), (expected,) = _arrays(result), _arrays(expected)
        assert result.dtype == expected.dtype
        np.testing.assert_array_equal(result, expected)
    elif _parts(expected) is not None:
        assert _parts(result).keys() == _parts(expected).keys()
        for name, part in _parts(expected).items():
            _check_same(_parts(result)[name], part)
    else:
        assert result == expected


@pytest.mark.filterwarnings("ignore::UserWarning")  # of NumPy, of values that are about to be refused
@pytest.mark.parametrize(("call", "argument"), EVERY)
def test_what_no_argument_expects_is_refused_by_its_name(calls, call, argument, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    function, arguments = calls[call]
    for name, make in hostile.VALUES.items():
        if name == "text" and (argument in {*PATHS, "truth"} or (call, argument) == ("read_sequence", "faces")):
            continue  # is a path
        if name in ("array of texts", "long list") and call.startswith("read_") and argument in ("static", "paths"):
            continue  # are paths
        try:
            result = run(function, arguments | {argument: make()})
        except Exception as error:
            assert not is_taken(name, call, argument), f"{name}: {error}"
            _check_refusal(error, NAMES.get(f"{call} {argument}", NAMES.get(argument, argument)))
        else:
            assert is_taken(name, call, argument), f"{name} is taken"
            plain = {"fraction": 0.5, "longdouble": 0.5, "float16": 0.5, "negative zero": 0.0}
            if name in plain:
                _check_same(result, run(function, arguments | {argument: plain[name]}))


def test_every_public_argument_is_among_those_tried(calls):
    functions = [getattr(ccd, name) for name in ccd.__all__] + [getattr(datasets, name) for name in datasets.__all__]
    functions += [getattr(viz, name) for name in viz.__all__ if name != "drawing_without_display"]
    functions += [viz.Picture.save, datasets.Queries.id, datasets.Queries.joined]
    owners = (ccd.CollisionMesh, ccd.CollisionPipeline, ccd.RigidMotion, ccd.AffineMotion)
    functions += [member for owner in owners for member in _methods(owner)]
    outputs = {
        ccd.CandidateOptions,
        ccd.BodyOptions,
        ccd.Candidates,
        ccd.Contact,
        ccd.Contacts,
        ccd.Counts,
        ccd.DeviceContacts,
        ccd.DeviceDisplacements,
        ccd.DeviceProximities,
        ccd.DisplacementOptions,
        ccd.FrameSequence,
        ccd.Frames,
        ccd.FrameSequence,
        ccd.HostLaunchResult,
        ccd.IntersectionKind,
        ccd.IntersectionOptions,
        ccd.Intersections,
        ccd.LaunchResult,
        ccd.LineSearchOptions,
        ccd.ToiGradient,
        ccd.LineSearchResult,
        ccd.MeshOptions,
        ccd.MeshResult,
        ccd.PairOptions,
        ccd.Planes,
        ccd.Proximities,
        ccd.ProximityOptions,
        ccd.Robot,
        ccd.PoseSequence,
        viz.Picture,
    }
    outputs |= {ccd.PairResult, ccd.CCDStatus, ccd.LaunchFlag, ccd.PairKind, datasets.SimulationStep, ccd.CollisionMesh}
    tried = {}
    for function, arguments in calls.values():
        tried.setdefault(function.__qualname__, set()).update(arguments)
    for function in functions:
        if callable(function) and function not in outputs:
            parameters = _parameters(function) - {"self"}
            # `name` of `frame` is a word for messages; `borrowed` serves the one-shot functions
            assert parameters - {"name"} <= tried.get(function.__qualname__, set()), function.__qualname__


def _parameters(function):
    """Names of all that a function takes, the options of its typed dictionary included."""
    parameters = inspect.signature(function).parameters.values()
    names = {p.name for p in parameters if p.kind != p.VAR_KEYWORD}
    for p in parameters:
        if p.kind == p.VAR_KEYWORD:
            hints = typing.get_type_hints(function.__init__ if isinstance(function, type) else function)
            (kind,) = typing.get_args(hints[p.name])
            names |= kind.__optional_keys__
    return names


def _methods(owner):
    public = [getattr(owner, name) for name in vars(owner) if not name.startswith("_") and name != "borrowed"]
    return [member for member in public if inspect.isroutine(member)]


FRAME_CALLS = [  # launches take arrays where they are, and are among the device's
    call
    for call, (_, arguments) in every_call(Anywhere()).items()
    if "vertices_t0" in arguments and not call.startswith("launch")
]
PAIR_CALLS = ["vertex_face_ccd", "edge_edge_ccd", "point_segment_ccd", "point_point_ccd"]
HOST_REALS = [
    *((call, argument) for call in FRAME_CALLS for argument in ("vertices_t0", "vertices_t1")),
    *((call, argument) for call in PAIR_CALLS for argument in ("points_t0", "points_t1")),
    *(("arrays of a body", "vertices of body 0"), ("frame", "vertices"), ("reserve", "vertices")),
    *((call, argument) for call in ("RigidMotion", "from_scalar_first") for argument in ("poses_t0", "poses_t1")),
    *(("RigidMotion", "pivot"), ("RigidMotion of a twist", "twist"), ("positions_t0", "points")),
    *(("AffineMotion", "affine_t0"), ("AffineMotion", "affine_t1")),
]
HOST_INTEGERS = [
    *(
        ("arrays of a body", "faces of body 0"),
        ("arrays of a body", "edges of body 0"),
        ("from_arrays", "vertex_world"),
    ),
    *(("edges_by_max", "faces"), ("write_boxes", "ids"), ("positions_t0", "body")),
]
DEVICE_REALS = [
    *(("launch", "vertices_t0"), ("launch", "vertices_t1"), ("launch of displacements", "displacements")),
    *(("launch_line_search", "vertices_t0"), ("launch_line_search", "vertices_t1")),
    *(("write_queries", "points_t0"), ("write_queries", "points_t1")),
]


IN_OTHER_FORMS = HOST_REALS + HOST_INTEGERS


# What `render_step` draws is what `draw_step` does.
@pytest.mark.parametrize(
    ("call", "argument"), marked(IN_OTHER_FORMS, [case for case in IN_OTHER_FORMS if case[0] != "render_step"])
)
def test_the_same_numbers_in_another_form_give_the_same_answer(calls, call, argument, tmp_path):
    function, arguments = calls[call]
    array = arguments[argument]
    expected = run(function, arguments)
    forms = hostile.SAME_REALS if array.dtype.kind == "f" else hostile.SAME_INTEGERS
    makes = [*hostile.SAME.values(), *forms.values()]
    if call in ("render_step", "draw_step"):  # a picture takes as long as a hundred calls, and reads what they read
        makes = makes[::4]
    for make in makes:
        result = run(function, arguments | {argument: make(array, tmp_path)})
        if call != "edges_by_max":  # has the dtype of its argument
            _check_same(result, expected)


@pytest.mark.parametrize(("call", "argument"), HOST_REALS + HOST_INTEGERS)
def test_numbers_that_would_be_hidden_or_changed_are_refused(calls, call, argument):
    function, arguments = calls[call]
    array = arguments[argument]
    others = hostile.OTHER_REALS if array.dtype.kind == "f" else hostile.OTHER_INTEGERS
    for name, (make, word) in (hostile.OTHER | others).items():
        if (call, name) in {("edges_by_max", "uint64 beyond int64"), ("write_boxes", "uint64 beyond int64")}:
            continue  # takes any integers
        with pytest.raises(ValueError) as caught:
            run(function, arguments | {argument: make(array)})
            pytest.fail(f"{name} is taken")
        _check_refusal(caught.value, argument, word)


@pytest.mark.parametrize(("call", "argument"), DEVICE_REALS)
def test_arrays_that_are_read_where_they_are_give_the_same_answer_or_are_refused(calls, call, argument, tmp_path):
    function, arguments = calls[call]
    array = arguments[argument]
    expected = [a.copy() for a in _arrays(run(function, arguments))]
    for make in [*hostile.SAME.values(), *hostile.SAME_REALS.values()]:
        try:
            result = run(function, arguments | {argument: make(array, tmp_path)})
        except Exception as error:
            _check_refusal(
                error, "vertices_t1" if argument == "vertices_t0" and "vertices_t1" in str(error) else argument
            )
        else:
            for a, b in zip(_arrays(result), expected, strict=True):
                np.testing.assert_array_equal(a, b)
    for make, _ in [*hostile.OTHER.values(), *hostile.OTHER_REALS.values()]:
        other = make(array)
        is_plain = type(other) is np.ndarray and other.dtype in (np.float32, np.float64)
        if is_plain and "launch" in call:
            continue  # no number: the launch says so by a flag
        with pytest.raises(ValueError) as caught:
            run(function, arguments | {argument: other})
        _check_refusal(caught.value, argument)


# ---- What is given stays the caller's --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "call", [*PAIR_CALLS, "find_candidates", "mesh_ccd", "from_arrays", "arrays of a body", "contact_points"]
)
def test_nothing_that_is_returned_is_the_memory_of_an_argument(calls, call):
    function, arguments = calls[call]
    given = [array for value in arguments.values() for array in _arrays(value)]
    if "mesh" in arguments:
        given += [START, END]
    for array in _arrays(function(**arguments)):
        for other in given:
            assert not np.shares_memory(array, other)


def test_mesh_stays_as_it_is_when_the_caller_changes_what_it_was_made_of():
    bodies = [(TRIANGLE.copy(), FACE.astype(np.int32)), (CABLE.copy(), FACE[:0], np.array([[0, 1]], dtype=np.int32))]
    others = {
        "static": np.array([1]),
        "self_collision": np.array([True, False]),
        "codimensional_points": np.array([True, True]),
        "body_pairs": np.ones((2, 2), dtype=bool),
        "vertex_world": np.zeros(6, dtype=np.int32),
        "radius": np.full(6, 0.125),
    }
    mesh = ccd.CollisionMesh.from_arrays(bodies, **others)
    before = copy.deepcopy(mesh)
    for array in [array for body in bodies for array in body] + list(others.values()):
        array[...] = 0
    _check_same(mesh, before)


def test_pipeline_stays_as_it_is_when_the_caller_changes_his_list_of_kinds():
    kinds = ["vertex_face"]
    pipeline = ccd.CollisionPipeline(MESH, pair_kinds=kinds, device="cpu")
    expected = pipeline.mesh_ccd(START, END)
    kinds[0] = "point_point"
    _check_same(pipeline.mesh_ccd(START, END), expected)


def test_kinds_can_come_from_a_generator():
    kinds = [ccd.PairKind.VERTEX_FACE, "edge_edge"]
    result = ccd.mesh_ccd(MESH, START, END, pair_kinds=(kind for kind in kinds), device="cpu")
    _check_same(result, ccd.mesh_ccd(MESH, START, END, pair_kinds=kinds, device="cpu"))


def test_what_is_reserved_stays_as_it_is_when_the_caller_changes_his_positions():
    pipeline = ccd.CollisionPipeline(MESH, minimum_separation=0.1, device="cpu")
    layout = START.copy()
    expected = [a.copy() for a in _arrays(_launched(pipeline, layout))]
    layout *= 1000.0
    for a, b in zip(_arrays(_launched(pipeline, None)), expected, strict=True):
        np.testing.assert_array_equal(a, b)


def _launched(pipeline, layout):
    pipeline.reserve(vertices=layout)
    return pipeline.launch(START, END)


# ---- One by one ------------------------------------------------------------------------------------------------------


def test_a_number_of_rings_beyond_the_mesh_costs_what_the_mesh_costs():
    bodies = [_grid(6)]
    huge, whole = (ccd.CollisionMesh.from_arrays(bodies, exclusion_rings=n) for n in (10**12, 36))
    start = bodies[0][0]
    end = start * [1.0, 1.0, -1.0] + [0.0, 0.0, 1.0]
    assert len(ccd.find_candidates(huge, start, end, inflation=9.0, device="cpu").edge_edge) == 0
    _check_same(
        ccd.find_candidates(huge, start, end, inflation=9.0, device="cpu"),
        ccd.find_candidates(whole, start, end, inflation=9.0, device="cpu"),
    )


@pytest.mark.parametrize("rings", [2, 3, 7, 8, 30, 35, 36, 37])
def test_rings_hold_what_so_many_edges_lead_to(rings):
    vertices, faces = _grid(5)
    lonely = np.concatenate([vertices, vertices[:11]])  # and vertices that no edge leads to
    mesh = ccd.CollisionMesh.from_arrays([(lonely, faces, [[26, 27], [27, 28]])], exclusion_rings=rings)
    begin, rows = vertex_rings(mesh)
    distance = np.full((36, 36), 99)
    np.fill_diagonal(distance, 0)
    distance[tuple(mesh.edges.T)] = distance[tuple(mesh.edges.T[::-1])] = 1
    for k in range(36):
        distance = np.minimum(distance, distance[:, k : k + 1] + distance[k])
    for vertex in range(36):
        row = rows[begin[vertex] : begin[vertex + 1]]
        np.testing.assert_array_equal(row, np.flatnonzero(distance[vertex] < rings))


@pytest.mark.parametrize("rings", [3, 10**9])
def test_rings_that_take_too_much_memory_say_which_number_to_lower(rings, monkeypatch):
    monkeypatch.setattr("ccd_warp._engine.mesh.rings._MOST_VERTICES", 100)
    mesh = ccd.CollisionMesh.from_arrays([_grid(6)], exclusion_rings=rings)
    with pytest.raises(
        ValueError, match=rf"exclusion_rings is {rings}, which leaves out more than .*; expected a lower"
    ):
        ccd.mesh_ccd(mesh, mesh.vertices, mesh.vertices + 1.0, device="cpu")


def _grid(n):
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()[:, None]
    faces = np.concatenate([corner + [0, 1, n], corner + [1, n + 1, n]])
    return np.stack([x.ravel(), y.ravel(), (x * y % 3).ravel()], axis=1).astype(float), faces


def test_as_many_threads_as_allowed_give_the_same_answer():
    _check_same(ccd.mesh_ccd(MESH, START, END, num_threads=1024, device="cpu"), RESULT)


@pytest.mark.parametrize("is_used", [False, True])
@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda mesh: pickle.loads(pickle.dumps(mesh))])
def test_a_copied_mesh_is_read_only_and_works(copied, is_used):
    mesh = ccd.CollisionMesh.from_arrays(
        [(TRIANGLE, FACE), (CABLE, FACE[:0])], static=[1], body_pairs=np.ones((2, 2), bool)
    )
    expected = ccd.mesh_ccd(copy.deepcopy(mesh), START, END, device="cpu")
    if is_used:
        ccd.mesh_ccd(mesh, START, END, device="cpu")
    other = copied(mesh)
    _check_same(other, mesh)
    for array in _arrays(other):
        assert not array.flags.writeable
    with pytest.raises(AttributeError, match="cannot assign"):
        other.faces = FACE
    _check_same(ccd.mesh_ccd(other, START, END, device="cpu"), expected)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_pipeline_says_how_to_get_another(copied):
    with pytest.raises(TypeError, match=r"cannot be copied or pickled; copy or pickle its mesh .*, and build another"):
        copied(PIPELINE)


def test_options_that_come_as_numbers_of_other_types_are_those_numbers():
    options = {"tolerance": np.longdouble(2) ** -20, "minimum_separation": np.float32(0.125), "t_max": np.float16(1)}
    plain = {name: float(value) for name, value in options.items()}
    _check_same(
        ccd.mesh_ccd(MESH, START, END, device="cpu", **options), ccd.mesh_ccd(MESH, START, END, device="cpu", **plain)
    )
