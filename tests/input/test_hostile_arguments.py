"""Every argument of every public function meets every value of `hostile`: taken exactly, or refused by its name."""

import copy
import functools
import inspect
import pickle
import typing
from dataclasses import is_dataclass

import hostile
import numpy as np
import pytest
import trimesh
import warp as wp

import ccd_warp as ccd
from ccd_warp import datasets, viz
from ccd_warp._engine.rings import vertex_rings

TRIANGLE = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]])
FACE = np.array([[0, 1, 2]])
CABLE = np.array([[1.0, 1, 5], [2, 1, 5], [3, 3, 9]])
MESH = ccd.CollisionMesh.from_arrays(
    [(TRIANGLE, FACE), (CABLE, np.zeros((0, 3), int), [[0, 1]])], codimensional_points=True
)
MESH_AND_STATIC = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (CABLE, FACE[:0])], static=[1])
START = np.concatenate([TRIANGLE, CABLE])
END = np.concatenate([TRIANGLE + [0.0, 0, 8], CABLE])
POINTS_T0 = np.concatenate([CABLE[:1], TRIANGLE])[None]
POINTS_T1 = POINTS_T0 + [[[0.0, 0, 0], [0, 0, 8], [0, 0, 8], [0, 0, 8]]]
RESULT = ccd.mesh_ccd(MESH, START, END, device="cpu")
PIPELINE = ccd.CollisionPipeline(MESH, device="cpu")
QUERIES = datasets.Queries("a", "vertex-face", POINTS_T0, POINTS_T1, np.array([True]), (("a.csv", 1),))
STEP = datasets.SimulationStep(START, END, FACE.astype(np.int32))

OPTIONS = {
    "tolerance": 1e-6,
    "minimum_separation": 0.0,
    "minimum_distance": 0.0,
    "start_gap_fraction": None,
    "t_max": 1.0,
    "max_iterations": 1000,
    "length_scale": None,
    "precision": "float64",
    "method": "clipping",
    "device": "cpu",
    "num_threads": 1,
}
MESH_OPTIONS = OPTIONS | {"max_work": 1000, "broad_phase": "tree", "pair_kinds": None, "memory_limit": None}
AT_ONE_TIME = {"broad_phase": "hash", "pair_kinds": None, "memory_limit": None, "device": "cpu", "num_threads": 1}
FRAMES = {"mesh": MESH, "vertices_t0": START, "vertices_t1": END}
SEARCH = {"check_start": False, "per": "scene", "safety": 0.5, "max_rounds": 16}
BODIES = {
    "bodies": [(TRIANGLE, FACE), (CABLE, FACE[:0])],
    "static": [1],
    "kinematic": [],
    "self_collision": True,
    "codimensional_points": False,
    "body_pairs": None,
    "exclusion_rings": 1,
    "exclude_pairs": {"bodies": [(0, 1)]},
    "vertex_world": np.zeros(6, dtype=int),
    "radius": np.full(6, 0.125),
    "names": ["face", "cable"],
}
PICTURE = viz.Picture(np.zeros((2, 3, 3), dtype=np.uint8))
LAUNCHED = {"vertices_t0": START, "vertices_t1": END}


def _of_arrays(**parts):
    """A mesh of one body, by its arrays."""
    return ccd.CollisionMesh.from_arrays(
        [(parts["vertices of body 0"], parts["faces of body 0"], parts["edges of body 0"])]
    )


@functools.wraps(ccd.HalfSpace, updated=())
def _half_space(**parts):
    """A mesh with a half-space, whose numbers are checked there."""
    return ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), ccd.HalfSpace(**parts)])


def _points(*rows, dimension=3):
    points = {"points_t0": POINTS_T0[:, list(rows), :dimension], "points_t1": POINTS_T1[:, list(rows), :dimension]}
    return points | OPTIONS


@functools.wraps(ccd.CollisionPipeline.reserve)
def _reserve(**capacities):
    """What a launch writes to what was reserved."""
    PIPELINE.reserve(**capacities)
    return PIPELINE.launch(START, END)


class Drawn(Exception):
    """Drawing was about to begin: all arguments were taken."""


@pytest.fixture(autouse=True)
def no_drawing(monkeypatch):
    """Nothing is drawn, no window opened."""

    def draw():
        raise Drawn

    monkeypatch.setattr(viz, "drawing_without_display", draw)
    monkeypatch.setattr(viz, "import_pyvista", draw)
    monkeypatch.setattr(viz._export, "import_pyvista", draw)


def _calls(folder):
    """Each public function, with arguments that it takes."""
    queries, truth, boxes = folder / "a_vf.csv", folder / "truth.json", folder / "boxes.json"
    start, end = folder / "0.ply", folder / "1.ply"
    picture = {
        "mesh": MESH,
        "vertices_t0": START,
        "vertices_t1": END,
        "result": RESULT,
        "camera": None,
        "colour": "body",
    }
    return {
        "vertex_face_ccd": (ccd.vertex_face_ccd, _points(0, 1, 2, 3)),
        "edge_edge_ccd": (ccd.edge_edge_ccd, _points(0, 1, 2, 3)),
        "point_segment_ccd": (ccd.point_segment_ccd, _points(0, 1, 2, dimension=2)),
        "point_point_ccd": (ccd.point_point_ccd, _points(0, 1)),
        "find_candidates": (
            ccd.find_candidates,
            FRAMES | {"inflation": 0.0, "broad_phase": "hash", "pair_kinds": None, "device": "cpu", "num_threads": 1},
        ),
        "find_intersections": (
            ccd.find_intersections,
            {"mesh": MESH, "positions": START, "memory_limit": None, "device": "cpu", "num_threads": 1},
        ),
        "find_proximity": (
            ccd.find_proximity,
            {"mesh": MESH, "positions": START, "distance": 0.1} | AT_ONE_TIME,
        ),
        "displacement_bounds": (
            ccd.displacement_bounds,
            {"mesh": MESH, "positions": START, "search_radius": 0.1, "minimum_distance": 0.01} | AT_ONE_TIME,
        ),
        "mesh_ccd": (ccd.mesh_ccd, FRAMES | MESH_OPTIONS | {"check_start": False}),
        "mesh_ccd beside a static body": (ccd.mesh_ccd, FRAMES | {"mesh": MESH_AND_STATIC, "device": "cpu"}),
        "collision_free_step": (ccd.collision_free_step, FRAMES | MESH_OPTIONS | {"check_start": False}),
        "is_step_collision_free": (ccd.is_step_collision_free, FRAMES | MESH_OPTIONS | {"check_start": False}),
        "line_search": (ccd.line_search, FRAMES | SEARCH | {k: MESH_OPTIONS[k] for k in MESH_OPTIONS if k != "t_max"}),
        "from_arrays": (ccd.CollisionMesh.from_arrays, BODIES),
        "arrays of a body": (
            _of_arrays,
            {"vertices of body 0": START, "faces of body 0": FACE, "edges of body 0": np.array([[3, 4], [4, 5]])},
        ),
        "from_volume": (
            ccd.CollisionMesh.from_volume,
            {name: value for name, value in BODIES.items() if name != "bodies"}
            | {"vertices": TRIANGLE, "cells": {"triangle": FACE}, "others": [(CABLE, FACE[:0])]},
        ),
        "from_trimesh": (
            ccd.CollisionMesh.from_trimesh,
            BODIES | {"bodies": [trimesh.Trimesh(TRIANGLE, FACE), trimesh.PointCloud(CABLE)]},
        ),
        "HalfSpace": (_half_space, {"point": np.zeros(3), "normal": np.array([0.0, 0.0, 1.0])}),
        "replicate": (MESH.replicate, {"count": 2}),
        "excluding": (MESH.excluding, {"exclude_pairs": {"edge_edge": [[0, 1]]}}),
        "frame": (MESH.frame, {"vertices": START}),
        "frames": (MESH.frames, {"vertices_t0": START, "vertices_t1": END}),
        "CollisionPipeline": (
            ccd.CollisionPipeline,
            {"mesh": MESH} | MESH_OPTIONS | {"max_pairs": 9, "max_contacts": 9},
        ),
        "reserve": (_reserve, {"max_pairs": 4096, "max_contacts": 4096, "vertices": START}),
        "launch": (PIPELINE.launch, LAUNCHED),
        "launch of displacements": (PIPELINE.launch, {"vertices_t0": START, "displacements": END - START}),
        "launch_line_search": (
            PIPELINE.launch_line_search,
            {"vertices_t0": START, "vertices_t1": END.copy(), "per": "scene", "safety": 0.5, "num_rounds": 4},
        ),
        "pipeline.find_candidates": (
            PIPELINE.find_candidates,
            {"vertices_t0": START, "vertices_t1": END, "inflation": 0.0},
        ),
        "pipeline.find_intersections": (PIPELINE.find_intersections, {"positions": START}),
        "pipeline.find_proximity": (PIPELINE.find_proximity, {"positions": START, "distance": 0.1}),
        "pipeline.displacement_bounds": (PIPELINE.displacement_bounds, {"positions": START, "search_radius": 0.1}),
        "launch_displacement_bounds": (
            PIPELINE.launch_displacement_bounds,
            {"positions": START, "search_radius": 0.1},
        ),
        "launch_proximity": (PIPELINE.launch_proximity, {"positions": START, "distance": 0.1}),
        "pipeline.mesh_ccd": (PIPELINE.mesh_ccd, {"vertices_t0": START, "vertices_t1": END, "check_start": False}),
        "pipeline.collision_free_step": (
            PIPELINE.collision_free_step,
            {"vertices_t0": START, "vertices_t1": END, "check_start": False},
        ),
        "pipeline.is_step_collision_free": (
            PIPELINE.is_step_collision_free,
            {"vertices_t0": START, "vertices_t1": END, "check_start": False},
        ),
        "pipeline.line_search": (PIPELINE.line_search, {"vertices_t0": START, "vertices_t1": END} | SEARCH),
        "render_step": (viz.render_step, picture | {"path": folder / "a.png", "size": (900, 300), "t_max": 1.0}),
        "draw_step": (viz.draw_step, picture | {"size": (900, 300), "t_max": 1.0}),
        "show_step": (viz.show_step, picture),
        "Picture.save": (PICTURE.save, {"path": folder / "a.png"}),
        "to_pyvista": (viz.to_pyvista, FRAMES | {"result": RESULT, "t": 0.0}),
        "contact_points": (viz.contact_points, FRAMES | {"contacts": RESULT.contacts}),
        "Queries": (
            datasets.Queries,
            {name: getattr(QUERIES, name) for name in inspect.signature(datasets.Queries).parameters},
        ),
        "Queries.id": (QUERIES.id, {"i": 0}),
        "Queries.joined": (datasets.Queries.joined, {"name": "b", "parts": [QUERIES]}),
        "read_queries": (
            datasets.read_queries,
            {"path": queries, "kind": "vertex-face", "truth": None, "progress": False},
        ),
        "write_queries": (
            datasets.write_queries,
            {"path": queries, "points_t0": POINTS_T0, "points_t1": POINTS_T1, "truth": None},
        ),
        "find_queries": (datasets.find_queries, {"folder": folder, "kind": None, "progress": False}),
        "find_steps": (datasets.find_steps, {"folder": folder}),
        "read_frames": (
            ccd.read_frames,
            {
                "start_path": start,
                "end_path": end,
                "static": [start],
                "kinematic": [],
                "self_collision": True,
                "surface": False,
                "max_bytes": 1000,
            },
        ),
        "read_sequence": (
            ccd.read_sequence,
            {
                "paths": [start, end],
                "static": [start],
                "kinematic": [],
                "self_collision": True,
                "displacement": None,
                "faces": None,
                "surface": False,
                "max_bytes": 1000,
            },
        ),
        "read_step": (datasets.read_step, {"start_path": start, "end_path": end, "max_bytes": 1000}),
        "write_step": (datasets.write_step, {"start_path": start, "end_path": end, "step": STEP}),
        "read_truth": (datasets.read_truth, {"path": truth}),
        "write_truth": (datasets.write_truth, {"path": truth, "truth": np.array([True])}),
        "read_boxes": (datasets.read_boxes, {"path": boxes}),
        "write_boxes": (datasets.write_boxes, {"path": boxes, "ids": np.array([[0, 1]])}),
        "edges_by_max": (datasets.edges_by_max, {"faces": FACE}),
    }


@pytest.fixture(scope="module")
def calls(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    datasets.write_queries(folder / "a_vf.csv", POINTS_T0, POINTS_T1)
    datasets.write_step(folder / "0.ply", folder / "1.ply", STEP)
    datasets.write_truth(folder / "truth.json", np.array([True]))
    datasets.write_boxes(folder / "boxes.json", np.array([[0, 1]]))
    return _calls(folder)


class _Anywhere:
    """A folder that is never looked at, to list the calls by."""

    def __truediv__(self, _):
        return self


EVERY = [(call, argument) for call, (_, arguments) in _calls(_Anywhere()).items() for argument in arguments]

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
    *("displacement", "faces"),
}
TEXTS = {"name", "displacement"}
REQUIRED = {("excluding", "exclude_pairs"), ("Queries", "kind"), ("write_truth", "truth"), ("frame", "vertices")}
REQUIRED |= {("from_volume", "vertices"), ("edges_by_max", "faces")}
PATHS = {"path", "folder", "start_path", "end_path", "paths"}
# What is no mistake: the value has the meaning that the documentation gives it.
FLAGS = {"check_start", "self_collision", "codimensional_points", "progress", "surface"}
TAKEN = {
    "None": OPTIONAL,
    "negative zero": {"minimum_separation", "minimum_distance", "t_max", "inflation", "t", "radius", "distance"},
    "fraction": REALS,
    "longdouble": REALS,
    "float16": REALS,
    "empty list": {"static", "kinematic", "faces of body 0", "edges of body 0"},
    "nested empty list": {"faces of body 0", "edges of body 0"},
    "empty dict": {"static", "kinematic", "exclude_pairs"},
    "bool": FLAGS,
    "numpy bool": FLAGS,
    "0-d float array": {"radius"},
    "0-d int array": {"radius"},
    "0-d bool array": FLAGS - {"progress", "check_start", "surface"},
    "int beyond float64": {"memory_limit", "exclusion_rings", "max_work", "max_bytes"},
    "minus one": {"i"},
    "text": TEXTS,
    "empty text": TEXTS,
    "text with a null": TEXTS,
    "array of texts": {"names"},
}
EXCEPTIONS = REQUIRED | {("render_step", "t_max"), ("draw_step", "t_max")}


def is_taken(name, call, argument):
    if (name, call, argument) == ("None", "to_pyvista", "result"):
        return True
    if (call, argument) in EXCEPTIONS and name in ("None", "negative zero"):
        return False
    return argument in TAKEN.get(name, ())


# What a message calls an argument that has parts.
NAMES = {"bodies": "bod", "others": "", "from_volume vertices": "of body 0", "vertices of body 0": "of body 0"}


def _run(function, arguments):
    """The result, with arrays of its own to write to; None where nothing is left but to draw."""
    own = {name: np.array(value) if type(value) is np.ndarray else value for name, value in arguments.items()}
    try:
        return function(**own)
    except Drawn:
        return None


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
            result = _run(function, arguments | {argument: make()})
        except Exception as error:
            assert not is_taken(name, call, argument), f"{name}: {error}"
            _check_refusal(error, NAMES.get(f"{call} {argument}", NAMES.get(argument, argument)))
        else:
            assert is_taken(name, call, argument), f"{name} is taken"
            plain = {"fraction": 0.5, "longdouble": 0.5, "float16": 0.5, "negative zero": 0.0}
            if name in plain:
                _check_same(result, _run(function, arguments | {argument: plain[name]}))


def test_every_public_argument_is_among_those_tried(calls):
    functions = [getattr(ccd, name) for name in ccd.__all__] + [getattr(datasets, name) for name in datasets.__all__]
    functions += [getattr(viz, name) for name in viz.__all__ if name != "drawing_without_display"]
    functions += [viz.Picture.save, datasets.Queries.id, datasets.Queries.joined]
    functions += [member for owner in (ccd.CollisionMesh, ccd.CollisionPipeline) for member in _methods(owner)]
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
        ccd.LineSearchResult,
        ccd.MeshOptions,
        ccd.MeshResult,
        ccd.PairOptions,
        ccd.Planes,
        ccd.Proximities,
        ccd.ProximityOptions,
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
    for call, (_, arguments) in _calls(_Anywhere()).items()
    if "vertices_t0" in arguments and not call.startswith("launch")
]
PAIR_CALLS = ["vertex_face_ccd", "edge_edge_ccd", "point_segment_ccd", "point_point_ccd"]
HOST_REALS = [
    *((call, argument) for call in FRAME_CALLS for argument in ("vertices_t0", "vertices_t1")),
    *((call, argument) for call in PAIR_CALLS for argument in ("points_t0", "points_t1")),
    *(("arrays of a body", "vertices of body 0"), ("frame", "vertices"), ("reserve", "vertices")),
]
HOST_INTEGERS = [
    *(
        ("arrays of a body", "faces of body 0"),
        ("arrays of a body", "edges of body 0"),
        ("from_arrays", "vertex_world"),
    ),
    *(("edges_by_max", "faces"), ("write_boxes", "ids")),
]
DEVICE_REALS = [
    *(("launch", "vertices_t0"), ("launch", "vertices_t1"), ("launch of displacements", "displacements")),
    *(("launch_line_search", "vertices_t0"), ("launch_line_search", "vertices_t1")),
    *(("write_queries", "points_t0"), ("write_queries", "points_t1")),
]


@pytest.mark.parametrize(("call", "argument"), HOST_REALS + HOST_INTEGERS)
def test_the_same_numbers_in_another_form_give_the_same_answer(calls, call, argument, tmp_path):
    function, arguments = calls[call]
    array = arguments[argument]
    expected = _run(function, arguments)
    forms = hostile.SAME_REALS if array.dtype.kind == "f" else hostile.SAME_INTEGERS
    for make in [*hostile.SAME.values(), *forms.values()]:
        result = _run(function, arguments | {argument: make(array, tmp_path)})
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
            _run(function, arguments | {argument: make(array)})
            pytest.fail(f"{name} is taken")
        _check_refusal(caught.value, argument, word)


@pytest.mark.parametrize(("call", "argument"), DEVICE_REALS)
def test_arrays_that_are_read_where_they_are_give_the_same_answer_or_are_refused(calls, call, argument, tmp_path):
    function, arguments = calls[call]
    array = arguments[argument]
    expected = [a.copy() for a in _arrays(_run(function, arguments))]
    for make in [*hostile.SAME.values(), *hostile.SAME_REALS.values()]:
        try:
            result = _run(function, arguments | {argument: make(array, tmp_path)})
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
            _run(function, arguments | {argument: other})
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
    monkeypatch.setattr("ccd_warp._engine.rings._MOST_VERTICES", 100)
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


def test_a_million_threads_are_refused():
    with pytest.raises(ValueError, match="num_threads is 1000000; expected a positive integer up to 1024"):
        ccd.mesh_ccd(MESH, START, END, num_threads=10**6, device="cpu")


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
