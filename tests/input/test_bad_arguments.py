"""Every argument of every public call refuses what it cannot be, by its name, with what is expected; then calls go on.

What a call takes is in `every_call`, and values that no argument expects are in `hostile`. The tables here say what is
expected of an argument, which further values are wrong, and which arguments contradict each other.
"""

import copy
import inspect
import pickle
import re
from dataclasses import is_dataclass
from pathlib import Path

import every_call as of
import hostile
import numpy as np
import pytest
import trimesh
import warp as wp
from every_call import END, EVERY_CALL, FACE, MESH, PIPELINE, POSES, START, TRIANGLE, run

import ccd_warp as ccd
from ccd_warp import viz

REAL, NONE, TEXTS = ("fraction", "longdouble", "float16"), ("None",), ("text", "text with a null")
ZERO, FLAG, BIG = (*REAL, "negative zero"), ("bool", "numpy bool"), ("int beyond float64",)
FLAGS, NUMBERS = (*FLAG, "0-d bool array"), ("0-d float64 array", "0-d int64 array")
NO_BODIES, EMPTY = ("empty list", "empty dict"), ("empty list", "nested empty list")
PATH = "a path, as text or a pathlib.Path|a name that ends in .ply"
OPTIONAL_PAIRS = "a mapping from what is paired, such as 'bodies' or 'edge_edge', to pairs, or contacts or proximities"
CELLS = "cells by type, tetra, hexahedron, wedge, pyramid, triangle or quad, or quadratic"
OF_TRIMESH = "a trimesh.Trimesh, Path3D, PointCloud or Scene"
LENGTH, COUNT = "a finite length of at least 0", "a positive integer"
DEVICE = r"an array of Warp|float32|vec3f|one of them|an array that can be written to|cuda:\d, where"
ROWS = r"(shape )?\(6, 3\) one row a vertex of the mesh|both vertices_t0 and vertices_t1, or neither|" + DEVICE
POINTS = r"(float64 of )?(shape )?\(n, [234], [23]\)|a NumPy array"
WITH_PATHS = ("rigid_ccd", "RigidMotion", "RigidMotion of a twist", "RigidMotion.from_scalar_first")
FRACTION = r"a fraction in \[0, 1\], or such fractions of shape \(2,\)"

# What is expected of an argument, or of one of a call; values that are wrong beside those of `hostile`, and those of
# `hostile` that are right.
ARGUMENTS = {
    **{"tolerance": ("a finite number above 0", [0.0, -1e-6], REAL), "broad_phase": ("'tree' or 'hash'", ["grid"], ())},
    **{"minimum_separation": ("a finite number of at least 0", [-1.0], ZERO), "gradient": ("a ToiGradient", [], ())},
    **{"minimum_distance": (LENGTH, [-1e-9, [0.1]], ZERO), "precision": ("'float64' or 'float32'", ["float16"], ())},
    "start_gap_fraction": ("'hold', a number between 0 and 1, or None", [0.0, 1.0], (*REAL, "None")),
    "start_gap_fraction of rigid_ccd": ("'hold'(, a number between 0 and 1,)? or None", [1.0], NONE),
    **{"t_max": (r"a number in [\[(]0, 1\]", [1.5, -0.1], ZERO), "max_iterations": (COUNT, [0, 1.0, 2**31], ())},
    **{"length_scale": ("a finite length above 0, or None", [0.0], (*REAL, "None")), "shape": (OF_TRIMESH, [], ())},
    **{"method": ("'clipping' or 'bisection'", ["newton"], ()), "device": ("one of '", ["abacus"], NONE)},
    **{"num_threads": (COUNT, [0, 1.5, 1025], NONE), "max_work": (COUNT, [0, 1.5], BIG)},
    **{"memory_limit": (COUNT, [0, 1.5], (*BIG, "None"))},
    **{"max_pairs": (COUNT, [0, 2**28 + 1], NONE), "max_contacts": (COUNT, [0, 1.5], NONE)},
    **{"max_rounds": ("an integer of at least 3", [2], ()), "num_rounds": ("an integer of at least 3", [2, 101], ())},
    **{"count": (COUNT, [0], ()), "exclusion_rings": (COUNT, [0], BIG)},
    "pair_kinds": ("a list of 'vertex_face', 'edge_edge', 'p", [[], "vertex_face", ["vertex"]], NONE),
    "inflation": ("a finite length that is not negative", [np.zeros(2)], ZERO),
    **{"distance": (LENGTH, ["near", [0.1]], ZERO), "search_radius": ("a finite length above 0", [0.0, [0.1]], REAL)},
    **{"per": ("one of 'scene', 'world', 'body', 'vertex'", ["face"], ())},
    **{"safety": ("a number between 0 and 1", [0.0, 1.0], REAL), "check_start": ("True or False", ["yes", 2], FLAG)},
    "unique": ("True or False", ["yes", 2], FLAG),
    **{"mesh": ("a CollisionMesh|the mesh first", [[START]], ()), "motion": ("a RigidMotion", [POSES], NONE)},
    "vertices_t1": (r"(shape )?\(6, 3\) like vertices_t0|both vertices_t0 and vertices_t1|" + DEVICE, [], ()),
    **{"vertices_t1 of launch of displacements": ("one of them", [], NONE), "displacements": (DEVICE, [], ())},
    "vertices_t1 of mesh_ccd beside a static body": (r"(shape )?(\(n, 3\)|\(6, 3\) like .* or \(3, 3\))", [], ()),
    **{"displacements of CollisionPipeline.launch": ("one of them", [], NONE)},
    **{"vertices of CollisionPipeline.reserve": (ROWS, [], NONE), "colour": ("'vertex_toi' or 'body'", ["red"], ())},
    "vertices of CollisionMesh.from_volume": (r"(shape )?\(n, 3\)|indices in \[0, 0\)", [], ()),
    "vertices of body 0": (r"(shape )?\(n, 3\)|positions|indices in \[0, 0\)", [], ()),
    "faces of body 0": (rf"(shape )?\(n, 3\)|integers|{CELLS}", [[[0.0, 1, 2]], [[0, 1]]], EMPTY),
    "edges of body 0": (r"(shape )?\(n, 2\)", [[[0, 1, 2]]], EMPTY),
    "bodies of CollisionMesh.from_arrays": (r"a list of \(vertices, f|a pair|at least one|\d+, one a", [], ()),
    "bodies of CollisionMesh.from_trimesh": (OF_TRIMESH + "|at least one body", ["ball.ply", trimesh.Trimesh], ()),
    "others of CollisionMesh.from_volume": (r"\d+, one a body|a list of bodies|a pair \(vertices, faces\)", [], ()),
    "others of CollisionMesh.from_instances": (rf"{OF_TRIMESH}|\d+, one a body", [], ()),
    "cells": (rf"(integers and shape )?\(n, corners\)|{CELLS}", [3], ()),
    "static": ("a list of (body|paths)|body indices in|a path", [[3], [-1], [True], 0], (*NONE, *NO_BODIES)),
    "kinematic": ("a list of body indices|body indices in", [["lid"]], (*NONE, *NO_BODIES)),
    "rigid": ("a list of body indices|body indices in", [[2]], (*NONE, *NO_BODIES)),
    "self_collision": ("a bool or one bool a body", [1, [0, 1]], FLAGS),
    "codimensional_points": (r"a bool or (one bool a body|\(2,\))", [1, [0], [True, False, True]], FLAGS),
    "body_pairs": (r"pairs of bodies that .*bool and shape \(2, 2\)", [np.ones((2, 2))], (*NONE, *EMPTY)),
    "exclude_pairs": (OPTIONAL_PAIRS, [[[0, 1]], {"edge_edge"}], (*NONE, "empty dict")),
    "exclude_pairs of CollisionMesh.excluding": (OPTIONAL_PAIRS, [[[0, 1]]], ("empty dict",)),
    "names": (r"\d, one a body|(a list of|printable) texts", ["cloth", ["cloth", 7]], (*NONE, "array of texts")),
    "vertex_world": (r"integers and (shape )?\(6,\)", [np.zeros(6)], NONE),
    "radius": (f"{LENGTH}, or an array of these|a number, shape|real numbers", [-1.0], (*ZERO, *NONE, *NUMBERS)),
    "poses_t0": (r"shape \(B, 7\), position and quaternion", [], ()),
    "poses_t1": (r"shape \(B, 7\), position and quaternion|the poses at the end of the step, or twist", [], ()),
    "poses_t1 of RigidMotion of a twist": (r"shape \(B, 7\), position and quaternion", [], NONE),
    "pivot": (r"shape \(3,\) or \(2, 3\), in the bodies' frames", [], NONE),
    "twist": (r"shape \(B, 6\), linear part first, then angular", [], NONE),
    "twist of RigidMotion of a twist": (r"shape \(B, 6\)|the poses at the end of the step, or twist", [], ()),
    "t": (FRACTION + "|real numbers", [1.5, -1e-300, [0.5]], ZERO),
    "within": ("a finite length of at least 0|real numbers", [-1e-300, [0.5], [0.0, np.inf]], ZERO),
    "t of to_pyvista": (r"a number in \[0, 1\]", [1.5], ZERO),
    "points": (r"(shape )?\(n, 3\)|\(0,\), as many as points", [], ()),
    **{"body": (r"\(3,\), as many as points|shape \(n,\)", [], ()), "result": ("a MeshResult", [], ())},
    "result of to_pyvista": ("a MeshResult", [], NONE),
    "camera": ("three finite numbers, not all 0", [(0, 0, 0), "left"], NONE),
    "size": (r"width and height in \[150, 4000\] pixels", [(10, 10), 7], ()),
    **dict.fromkeys(["vertices_t0", "positions", "vertices"], (ROWS, [], ())),
    **dict.fromkeys(["t_max of draw_step", "t_max of render_step"], (r"a number in \(0, 1\]", [1.5, 0.0], REAL)),
    **dict.fromkeys(["point", "normal"], (r"\(3,\)|3 numbers", [], ())),
    **dict.fromkeys(["points_t0", "points_t1"], (POINTS, [np.zeros((2, 3, 5))], ())),
    **dict.fromkeys(["progress", "surface", "split"], ("True or False", [], FLAG)),
    **{f"path of {call}": ("'linear' or 'screw'", ["arc"], ()) for call in WITH_PATHS},
    "name": ("a text", [], (*TEXTS, "empty text")),
    "displacement": ("the name of a field", [], (*NONE, *TEXTS, "empty text")),
    "paths": (rf"{PATH}|a path, or a list of paths", [], ()),
    **dict.fromkeys(["path", "start_path", "end_path"], (PATH, [], ())),
}


@pytest.fixture(autouse=True)
def no_drawing(request, monkeypatch):
    """Nothing is drawn, and what is written to a name alone goes where the calls' files are."""
    if "Picture.save" in request.node.name:
        pytest.importorskip("PIL", reason="the extra viz is not installed")

    def draw(*_):
        raise of.Drawn

    for module, name in ((viz, "drawn"), (viz._export, "import_pyvista")):
        monkeypatch.setattr(module, name, draw)
    monkeypatch.chdir(of.FOLDER.name)


def check_refusal(error, words, phrase=""):
    """One line that names the argument, and says what was expected."""
    text = str(error)
    kind = IndexError if "an index" in text else TypeError if "trimesh.Trimesh" in text else ValueError
    assert isinstance(error, kind) and all(word in text for word in words), f"{type(error).__name__}: {text}"
    assert re.search(f"expected ({phrase}|one without a mask)", text) and "\n" not in text and len(text) < 400, text


def leaves(result, name=""):
    """The arrays and plain values that a result consists of, but for times, by where they are."""
    result = result.numpy() if isinstance(result, wp.array) else result
    if isinstance(result, (ccd.CollisionMesh, ccd.Proximities)):
        parts = result.__getstate__()
    elif isinstance(result, (ccd.DeviceContacts, ccd.RigidMotion)):
        parts = vars(result.to_host() if isinstance(result, ccd.DeviceContacts) else result)
        parts = {key: value for key, value in parts.items() if not key.startswith("_")}
    elif is_dataclass(result):
        left_out = ("timings", "counts", "_step", "_find_shortening")
        parts = {key: value for key, value in vars(result).items() if key not in left_out}
        parts |= {"shortened_by": result.shortened_by} if isinstance(result, ccd.LineSearchResult) else {}
    elif isinstance(result, (tuple, list, ccd.FrameSequence)):
        parts = dict(enumerate(result))
    elif isinstance(result, dict):
        parts = result
    else:
        return {} if isinstance(result, ccd.CollisionPipeline) else {name: result}
    return {at: leaf for key, part in parts.items() for at, leaf in leaves(part, f"{name}.{key}").items()}


def arrays_of(result):
    """All arrays of a result."""
    return [leaf for leaf in leaves(result).values() if isinstance(leaf, np.ndarray)]


def check_same(result, expected):
    found, truth = leaves(result), leaves(expected)
    assert found.keys() == truth.keys()
    for name, leaf in truth.items():
        assert getattr(found[name], "dtype", None) == getattr(leaf, "dtype", None), name
        np.testing.assert_array_equal(found[name], leaf, err_msg=name)


EVERY = [(call, argument) for call, (_, arguments) in EVERY_CALL.items() for argument in arguments]
# What a message calls an argument that has parts.
NAMES = {"bodies": "bod", "others": "", "vertices of body 0": "of body 0", "vertices": ""}
OPTIONS = ccd.MeshOptions.__optional_keys__ | {"inflation", "distance", "search_radius", "unique", "per"}
OPTIONS |= {"safety", "max_rounds"}
IS_PATH = {"path", "start_path", "end_path", "paths", "faces", "static"}


@pytest.mark.filterwarnings("ignore::UserWarning")  # of NumPy, of values that are about to be refused
@pytest.mark.parametrize(("call", "argument"), EVERY)
def test_what_an_argument_cannot_be_is_refused_by_its_name_and_the_next_call_works(call, argument):
    function, arguments = EVERY_CALL[call]
    phrase, wrong, right = ARGUMENTS.get(f"{argument} of {call}") or ARGUMENTS[argument]
    expected = run(function, arguments)
    for name, value in (hostile.values() | dict(enumerate(wrong))).items():
        if name in ("text", "array of texts", "long list") and argument in IS_PATH and not call.startswith("Coll"):
            continue  # are paths
        try:
            result = run(function, arguments, {argument: value})
        except Exception as error:
            assert name not in right, f"{name}: {error}"
            words = [NAMES.get(argument, argument)]
            if type(value) in (int, float, str) and name in range(len(wrong)) and words[0] == argument:
                words = [f"{argument} is {value!r}"]
            if call in ccd.__all__ and argument in OPTIONS and "motion is given" not in str(error):
                assert str(error).startswith(f"{call}: "), error
            check_refusal(error, words, phrase)
        else:
            assert name in right, f"{name} is taken"
            if name in ZERO:
                check_same(result, run(function, arguments, {argument: 0.0 if name == "negative zero" else 0.5}))
    check_same(run(function, arguments), expected)


ARRAYS = [
    (call, name)
    for call, (_, arguments) in EVERY_CALL.items()
    for name, value in arguments.items()
    if type(value) is np.ndarray and (value.ndim > 1 or value.dtype.kind == "i")
    if call not in ("render_step", "draw_step")  # which read what `to_pyvista` does
]
ON_DEVICE = ("launch", "points_at")  # which read arrays where they are
ANY_LENGTH = {f"{name} of body 0" for name in ("vertices", "faces", "edges")} | {"points_t0", "points", "faces"}
ANY_LENGTH |= {"poses_t0", "poses_t1", "twist", "vertices of CollisionMesh.from_volume"}


@pytest.mark.parametrize(("call", "argument"), ARRAYS)
def test_an_array_in_another_form_gives_the_same_answer_and_what_is_not_such_numbers_is_named(call, argument):
    function, arguments = EVERY_CALL[call]
    array, is_on_device = arguments[argument], any(word in call for word in ON_DEVICE)
    own = {NAMES.get(argument, argument)}
    own |= {"vertices_t1"} if is_on_device else set()
    expected = run(function, arguments)
    if is_on_device:
        expected = [a.copy() for a in arrays_of(expected)]  # which the next launch writes to

    def check(made, word=None):
        """The same answer, or with a word a refusal that says it."""
        try:
            result = run(function, arguments, {argument: made})
        except Exception as error:
            assert word is not None or is_on_device, error
            assert any(name in str(error) for name in own), error
            check_refusal(error, [] if is_on_device else [word], "")
        else:
            assert word is None, f"{made!r} is taken"
            check_same(arrays_of(result) if is_on_device else result, expected)

    for made in hostile.same(array, Path(of.FOLDER.name)):
        check(made)
    for made, word in hostile.hidden(array):
        is_number = type(made) is np.ndarray and made.dtype in (np.float32, np.float64)
        if not (is_on_device and is_number):
            check(made, word)
    any_length = {argument, f"{argument} of {call}"} & ANY_LENGTH
    for made in (array[..., :1], array[None, None], *([] if any_length else [array[:-1]])):
        check(made, f"shape {made.shape}")


HANDED_ON = ("launch", "CollisionMesh.frame", "to_host")  # these give their arrays back


@pytest.mark.parametrize("call", [call for call in EVERY_CALL if not any(word in call for word in HANDED_ON)])
def test_nothing_that_is_returned_is_the_memory_of_an_argument(call):
    function, arguments = EVERY_CALL[call]
    given = [array for value in arguments.values() if type(value) in (np.ndarray, list) for array in arrays_of(value)]
    assert not any(np.shares_memory(a, b) for a in arrays_of(run(function, {}, arguments)) for b in given)


def put(array, index, value):
    """A copy of an array with another value."""
    array = np.array(array)
    array[index] = value
    return array


TWO, WORLDS, MATRICES = np.tile(np.eye(7)[6], (2, 1)), np.tile(np.eye(7)[6], (3, 2, 1)), np.tile(np.eye(4), (2, 1, 1))
OF_THREE = {"poses_t0": WORLDS, "poses_t1": WORLDS}
REST, LIFTED, FLOOR = [0.0, 0, 0, 0, 0, 0, 1], [0, 0, 1, 0, 0, 0, 1], ccd.HalfSpace([0.0, 0, 0], [0.0, 0, 1])
BARS = ccd.CollisionMesh.from_arrays([([[0.0, 0], [1, 0]], [[0, 1]])] * 2, rigid=[0, 1])
COPIES = MESH.replicate(3)
OF_COPIES = ccd.mesh_ccd(COPIES, COPIES.vertices, COPIES.vertices)
THICK = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (TRIANGLE, FACE)], radius=0.1)
THICK_FRAMES = {"mesh": THICK, "vertices_t0": THICK.vertices, "vertices_t1": THICK.vertices}
BOXES, FIXED = (ccd.CollisionMesh.from_trimesh([trimesh.creation.box()] * 2, rigid=[0, 1], static=x) for x in ([], [0]))
OF_WORLDS = dict.fromkeys(["vertices_t0", "vertices_t1"], BOXES.vertices)
OF_WORLDS["motion"] = ccd.RigidMotion(np.tile([REST, [9, *REST[1:]]], (7, 1, 1)), twist=np.ones((7, 2, 6)))  # apart
MOVED = {"mesh": of.MESH_AND_STATIC, "vertices_t1": END + 1}
PAIR, LAUNCHED = wp.zeros((1, 4), dtype=wp.vec3d), PIPELINE.launch(START, END)
# Arguments that do not fit each other, or a mesh: by the call what is changed, and the message.
TOGETHER = {
    "mesh_ccd": [
        ({"mesh": COPIES, "vertices_t0": np.zeros((6, 3, 3))}, r"\(6, 3, 3\); expected .*, or \(3, 6, 3\), with"),
        ({"minimum_distance": 1.0, "minimum_separation": 0.1}, "minimum_distance is 1.0 and minimum_separation is 0.1"),
        ({"memory_limit": 1}, r"memory_limit is 1 bytes; expected at least \d+"),
        ({"motion": of.MOTION}, "no body of the mesh is rigid"),
        (OF_WORLDS | {"mesh": FIXED}, "motion moves body 0 in world 0, which is static"),
        (OF_WORLDS | {"mesh": BOXES, "vertices_t1": BOXES.vertices + 1e-3}, "vertices_t1 has another row for vertex 0"),
        (OF_WORLDS | {"mesh": BOXES, "check_start": True}, r"check_start is True .*replicate\(7\)"),
        (OF_WORLDS | {"mesh": BOXES, "method": "bisection"}, "method is 'bisection'"),
    ],
    **{
        call: [
            (MOVED, r"vertex 0 of body 1 \(ball\), which is static, by 1.7.* kinematic=\['ball'\] in place of static="),
            (MOVED | {"vertices_t1": put(END, (5, 1), np.nextafter(3, 4))}, r"vertex 2 of body 1 \(ball\), .* by 4"),
            (MOVED | {"vertices_t0": put(END, 5, np.nan)}, r"vertices_t0 holds nan in row 5 \(vertex 2 of ball\); exp"),
            (MOVED | {"vertices_t1": put(END, 2, np.nan)}, r"vertices_t1 holds nan in row 2 \(vertex 2 of cloth\)"),
            (MOVED | {"vertices_t1": END[:4]}, r"vertices_t1 has shape \(4, 3\); expected \(6, 3\) .* or \(3, 3\)"),
            (THICK_FRAMES | {"minimum_separation": 0.1}, "minimum_separation is 0.1 and the mesh has a radius of"),
        ]
        for call in ("mesh_ccd beside a static body", "collision_free_step", "is_step_collision_free", "line_search")
    },
    "find_candidates": [(MOVED, r"vertex 0 of body 1 \(ball\), which is static, by 1")],
    "CollisionPipeline": [({"mesh": THICK, "minimum_separation": 0.1}, "0.1 and the mesh has a radius of up to 0.1")],
    **{
        call: [({"vertices_t1": END.astype(np.float32)}, "vertices_t1 has dtype vec3f; expected vec3d like vertices_t")]
        for call in ("CollisionPipeline.launch", "DeviceContacts.points_at")
    },
    "vertex_face_ccd": [
        ({"points_t0": PAIR}, "points_t1 is a ndarray; expected a array like points_t0"),
        ({"points_t0": wp.zeros((1, 4), dtype=wp.vec3f), "points_t1": PAIR}, "points_t0 has dtype vec3f and shape"),
        ({"points_t0": PAIR, "points_t1": wp.zeros((3, 4), dtype=wp.vec3d)}, r"has shape \(3, 4\); expected \(1, 4\)"),
    ],
    "point_point_ccd": [({"minimum_distance": 1.0, "minimum_separation": 0.1}, "is 0.1; expected one")],
    "rigid_ccd": [
        ({"poses_t0": [REST], "poses_t1": [REST], "within": 0}, "poses_t0 is of 1 body; expected 2 bodies, those"),
        ({"poses_t0": [REST], "poses_t1": [REST]}, r"within has shape \(2,\); .* such lengths of shape \(1,\)"),
        ({"mesh": COPIES, "poses_t0": [REST] * 2, "poses_t1": [REST] * 2}, "poses_t0 is of 2 bodies; expected 6"),
        ({"mesh": BARS, "poses_t0": [REST] * 2, "poses_t1": [REST, LIFTED]}, "takes body 1 out of the plane of the"),
    ],
    "RigidMotion": [
        ({"path": "screw", "pivot": [0, 0, 0]}, r"pivot is \[0, 0, 0\]; expected none with path='screw'"),
        ({"poses_t1": POSES[1] * [[1] * 7, [1, 1, 1, 0, 0, 0, 0]]}, "quaternion of length 0 for body 1"),
        (OF_THREE | {"pivot": np.zeros((3, 3))}, r"\(3,\) or \(2, 3\) or \(3, 2, 3\)"),
        (OF_THREE | {"within": [0.5]}, r"a finite length of at least 0, or such .* \(3"),
        (OF_THREE | {"within": put(np.zeros((3, 2)), (2, 1), -1)}, "within is -1.0 for body 1 of world 2"),
        ({"within": [0, np.nan]}, "within is nan for body 1; expected"),
        ({"within": np.inf}, "within is inf; expected a finite length"),
        *(
            ({"poses_t0": start, "poses_t1": end}, message)
            for start, end, message in [
                (np.eye(4), TWO, r"poses_t0 has shape \(4, 4\); expected shape .* or \(B, 4, 4\)"),
                (WORLDS, WORLDS[:2], "poses_t1 is of 2 bodies in each of 2 worlds; expected 2 bodies in each of 3 wor"),
                (WORLDS, TWO, "poses_t1 is of 2 bodies; expected 2 bodies in each of 3 worlds like poses_t0"),
                (WORLDS, put(WORLDS, (2, 1, 5), -np.inf), "poses_t1 holds -inf for body 1 of world 2; expected finite"),
                (TWO, put(MATRICES, (1, 3, 0), 0.5), r"poses_t1 has the bottom row \[0.5, 0.0, 0.0, 1.0\] for body 1"),
                (TWO, put(MATRICES, (1, 0, 0), 1.01), "holds no rotation for body 1: .* 0.0201 .* at most 1e-06"),
                (put(MATRICES, (1, 0, 1), 2e-6), TWO, "poses_t0 holds no rotation for body 1: .* are 2e-06 from"),
                (put(MATRICES, (0, 0, 0), 1e200), TWO, "poses_t0 holds no rotation for body 0: .* are inf from"),
                (put(MATRICES, (1, 0, 0), -1), TWO, "poses_t0 holds a reflection for body 1, with determinant -1"),
                (*(put(TWO, (1, 0), x) for x in (-1.7e308, 1.7e308)), "velocity of the motion holds .* for body 1"),
            ]
        ),
    ],
    "RigidMotion.from_scalar_first": [
        ({"poses_t0": MATRICES}, r"poses_t0 has shape \(2, 4, 4\); expected .* quaternion w x y z, scalar first"),
        ({"poses_t1": put(TWO, (1, 6), 0)}, "0 for body 1; .*w x y z, scalar first"),
        ({"poses_t1": None, "twist": put(np.zeros((2, 6)), (0, 4), 1e6)}, "body 0 by 1e.06 rad; .*divide it"),
    ],
    "RigidMotion of a twist": [
        ({"twist": [REST[:6]]}, "twist is of 1 body; expected 2 bodies like poses_t0"),
        ({"twist": put(np.zeros((2, 6)), (1, 5), -1e6)}, "twist turns body 1 by 1e.06 rad; expected less than 1e.06"),
        *(
            ({"poses_t0": start, "poses_t1": end, "twist": put(np.zeros((*start.shape[:-1], 6)), at, value)}, message)
            for start, end, at, value, message in [
                (TWO, TWO, (1, 0), 0.5, "ends 0.5 and 0 rad away from poses_t1 for body 1; expected the same pose"),
                (WORLDS, WORLDS, (2, 0, 4), 3e-6, "ends 0 and 3e-06 rad .* body 0 of world 2"),
                (WORLDS, None, (2, 1, slice(3, 6)), 1.7e308, "turns body 1 of world 2 by inf rad"),
                (put(TWO, (0, 0), 1.7e308), None, (0, 0), 1.7e308, "the end of twist holds inf for"),
            ]
        ),
    ],
    "CollisionMesh.from_arrays": [
        ({"kinematic": [1]}, r"static and kinematic both hold body 1 \(cable\); expected it in one of them"),
        ({"static": ["bal"]}, r"static holds 'bal'; expected body indices in \[0, 2\) or names of bodies"),
        ({"static": [False, True]}, r"static holds False; .*; of one flag a body np.flatnonzero\(static\)"),
        ({"body_pairs": [[True, False], [True, True]]}, r"differs at \(0, 1\) and \(1, 0\), body 0 \(face\) and"),
        ({"body_pairs": {"bodies": [("face", "cable")]}}, r"is {'bodies.*; expected pairs .* as \[\(0, 1\)\]"),
        ({"body_pairs": [("face", "lid")]}, "body_pairs holds 'lid'; expected indices or names of the mesh's bodies"),
        ({"body_pairs": [(0, 2)]}, r"body_pairs holds body 2 in row 0; expected an index in \[0, 2\)"),
        ({"body_pairs": [(1, 1)]}, r"body_pairs holds body 1 \(cable\) with itself; expected pairs of two bodies"),
        ({"body_pairs": [(1, 0), (0, 1)]}, r"\[\[1, 0\], \[0, 1\]\], by flags no two bodies and by pairs both; exp"),
        ({"names": ["cloth", "cloth"]}, "names holds 'cloth' twice; expected a name of its own"),
        ({"names": ["cloth", "a\nb"]}, r"names holds 'a\\nb'; expected printable texts"),
        ({"vertex_world": [-1, 0, 0, 0, 0, 0]}, "holds -1; expected worlds from 0 on, below the number of vertices, 6"),
        ({"vertex_world": [0, 0, 1, 0, 0, 0]}, r"vertex_world gives face 0 of face worlds \[0, 0, 1\]; expected one"),
    ],
    "CollisionMesh.replicate": [({"count": 10**9}, "count is 1000000000; expected at most")],
    "CollisionMesh.excluding": [({"exclude_pairs": LAUNCHED.contacts}, r"or contacts or proximities .*to_host\(\)")],
    "draw_step": [(THICK_FRAMES | {"result": OF_COPIES}, r"result\.vertex_toi has shape \(18,\); expected \(6,\)")],
    "render_step": [
        ({"path": "step.jpg"}, "must end in .png"),
        ({"path": "none/step.png"}, "does not exist"),
        ({"mesh": "step.png"}, r"mesh is .*; expected the mesh first.*vertices_t1, result, path\)"),
    ],
}


@pytest.mark.parametrize(("call", "changed", "message"), [(call, *row) for call in TOGETHER for row in TOGETHER[call]])
def test_arguments_that_do_not_fit_are_refused_together(call, changed, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    function, arguments = EVERY_CALL[call]
    with pytest.raises(ValueError, match=message):
        run(function, arguments, changed)
    assert not list(tmp_path.iterdir())


SEGMENT, EDGE, EYE = np.array([[-1.0, 0], [1.0, 0]]), [[0, 1]], (np.eye(3), FACE)
NAMED = {"codimensional_points": True, "names": ["sheet", "bead"]}
SHEET_AND_BEAD = [EYE, (np.array([[0.2, 0.2, 1.0]]), FACE[:0])]
A_C_D = [EYE, EYE, (np.zeros((2, 3)), FACE[:0])]
# Bodies that make no mesh, with options; and the message.
MESHES = [
    ([], {}, "bodies is empty; expected at least one body"),
    *(
        (bodies, {"static": FACE}, "body 0 is a .*expected a pair .*, all bodies in one list: from_arrays")
        for bodies in (EYE, EYE[0], EYE[0].tolist())
    ),
    (EYE, {"names": ["cloth"]}, "body 0 is a ndarray; .*all bodies in one list"),
    *(
        ([body], {}, f"{words}; expected {expected}")
        for body, words, expected in [
            ((np.eye(5, 3), [[0, 1, 7]]), "faces of body 0 holds index 7", r"indices in \[0, 5\)"),
            ((np.eye(5, 3), [[0, 1, -1]]), "faces of body 0 holds index -1", r"indices in \[0, 5\)"),
            (np.eye(3), "body 0 is a ndarray", r"a pair \(vertices, faces\) or a triple \(vertices, faces, edges"),
            ((*EYE, [[0, 3]]), "edges of body 0 holds index 3", r"indices in \[0, 3\)"),
            ((SEGMENT, [], EDGE), r"body 0 is in the plane and has 3 arrays", r"a pair \(vertices, edges\)"),
            ((SEGMENT, {"tetra": [[0, 1, 1, 1]]}), r"has shape \(2, 2\)", r"\(n, 3\)"),
            (ccd.HalfSpace([0, 0, 0], [0, 0, 1]), "bodies holds half-spaces alone", "at least one body with vertices"),
        ]
    ),
    ([EYE, (np.eye(3), [[0, 1, 7]])], {"names": ["cloth", "ball"]}, r"faces of body 1 \(ball\) holds index 7"),
    *(
        ([(np.eye(8, 3), {kind: cells})], {}, message)
        for kind, cells, message in [
            ("tetra", [[0, 1, 2, 3], [1, 0, 2, 3]], "holds two cells of the vertices"),
            ("tetra", [[0, 1, 2, k] for k in (4, 5, 6)], r"has 3 cells at the side \[0, 2, 1, 1\]; expected at most"),
            ("tetra", [[0, 1, 2, 300]], r"holds index 300; expected indices in \[0, 8\)"),
            ("tetra", np.zeros((0, 4), dtype=int), "cells in place of faces of body 0 are none"),
            ("tetra", [[0.0, 1.0, 2.0, 3.0]], "expected integers"),
            ("tetra14", np.zeros((1, 14), dtype=int), "holds the type 'tetra14'; expected cells by type"),
        ]
    ),
    ([(SEGMENT, EDGE), EYE], {}, "body 1 has 3 columns and those of body 0 2; expected all"),
    ([EYE] * 3 + [FLOOR], {"rigid": [3]}, "rigid holds body 3, a half-space"),
    ([EYE, FLOOR], {"radius": [0.1, 0.2]}, r"radius holds 0.2 for body 1; expected 0, as a half-space has no"),
    ([(np.eye(3)[:n], FACE[:0]) for n in (0, 2)], {"radius": [1, 2]}, "as many entries as there are bodies"),
    *(
        (SHEET_AND_BEAD, NAMED | {"radius": radius}, f"radius {message}")
        for radius, message in [
            ([0.1], r"has shape \(1,\); expected a number, shape \(2,\), one a body, or \(4,\), one a vertex"),
            ([0.1, -0.2], "holds -0.2 in entry 1; expected finite lengths of at least 0"),
            ([0, 0, np.inf, 0], "holds inf in entry 2 of sheet"),
        ]
    ),
    *(
        ([EYE, ccd.HalfSpace(*given)], {"names": ["cloth", "floor"]}, message)
        for given, message in [
            (([0, 0, 0], [0.0, 0, 0]), r"normal of body 1 \(floor\) is \[0.0, 0.0, 0.0\]; expected a direction"),
            (([0, -np.inf, 0], [0, 0, 1]), r"point of body 1 \(floor\) is \[0.0, -inf, 0.0\]; expected finite"),
            (([0, 0], [0, 1]), r"point of body 1 \(floor\) has shape \(2,\); expected \(3,\)"),
        ]
    ),
    *(
        (A_C_D, {"codimensional_points": True, "names": list("acd"), "exclude_pairs": {key: pairs}}, message)
        for key, pairs, message in [
            ("edges", [[0, 1]], r"has the key 'edges'; expected 'bodies', 'vertices', .* or 'vertex_plane'"),
            ("edge_edge", [[0, 6]], r"\['edge_edge'\] holds edge 6 in row 0; expected an index in \[0, 6\)"),
            ("vertex_face", [[0, 1], [-1, 0]], r"\['vertex_face'\] holds vertex -1 in row 1; expected .* \[0, 8\)"),
            ("vertex_face", [[0, 1], [1, 4]], r"\['vertex_face'\] holds face 4 in row 1; expected .* \[0, 2\)"),
            ("bodies", [[0, 3]], r"\['bodies'\] holds body 3 in row 0; expected an index in \[0, 3\)"),
            ("bodies", [["a", "c"], ["a", "b"]], r"\['bodies'\] holds 'b'; expected indices or names of the mesh's"),
            ("bodies", ["ac"], r"\['bodies'\] is 'ac'; expected pairs of body indices or names"),
            ("bodies", [[0, True], [0, 1.5]], r"\['bodies'\] has dtype float64; expected integers"),
            ("vertices", 3, r"\['vertices'\] is 3; expected integers and shape \(k, 2\)"),
            ("edge_edge", np.broadcast_to(np.int8(0), (2**27 + 1, 2)), "has 134217729 pairs; expected at most"),
            ("point_point", [[6, 7], [0, 6]], r"\['point_point'\] holds 0 in row 1; expected a codimensional point"),
            ("point_segment", [[6, 0]], r"\['point_segment'\] holds 0 in row 0; expected a codimensional edge"),
        ]
    ),
]


@pytest.mark.parametrize(("bodies", "options", "message"), MESHES)
def test_a_mesh_that_cannot_be_is_refused_with_what_was_expected(bodies, options, message):
    with pytest.raises(ValueError, match=message):
        ccd.CollisionMesh.from_arrays(bodies, **options)


# What is asked of an object that does not have it.
ALONE = ccd.Contacts(**vars(of.RESULT.contacts))
SEPARATED, SHORT = ccd.CollisionPipeline(MESH, minimum_separation=0.1), ccd.CollisionPipeline(MESH, t_max=0.5)
COPIERS = (copy.copy, copy.deepcopy, pickle.dumps)
NO_BOUNDS = "minimum_separation is 0.1; expected 0, and minimum_distance"
ASKED = [
    *((name, lambda name=name: getattr(ALONE, name), "made of arrays alone") for name in ("points", "bodies")),
    *((name, lambda name=name: getattr(ALONE, name)(), "made of arrays alone") for name in ("unique", "toi_gradient")),
    ("contact", lambda: ALONE[len(ALONE)], "index is 2; expected one of 2 contacts"),
    ("pair", lambda: ccd.find_proximity(MESH, START, 9.0)[0], "index is 0; expected a slice, a mask or a list"),
    ("crossing", lambda: ccd.find_intersections(MESH, START)[0], "index is 0; expected a slice, a mask or a list"),
    ("is_regular", lambda: LAUNCHED.is_regular(), "the launch was not recorded; expected one inside a"),
    ("to_host", lambda: LAUNCHED.to_host(START), "vertices_t1 is None; expected both"),
    *((f.__name__, lambda f=f: f(PIPELINE), "CollisionPipeline cannot be copied or pickled; copy or") for f in COPIERS),
    ("pickle", lambda: pickle.dumps(LAUNCHED), r"LaunchResult cannot be copied or pickled; .* to_host\(\) returns"),
    ("copy", lambda: copy.copy(LAUNCHED.contacts), "DeviceContacts cannot be copied or pickled"),
    ("motion", lambda: ccd.line_search(BOXES, **OF_WORLDS), r"14 rows .* mesh.replicate\(7\)"),
    ("t", lambda: ccd.RigidMotion(WORLDS, WORLDS).at([0.5]), r"\(1,\); .* fractions of shape \(2,\) or \(3, 2\)"),
    ("t", lambda: ccd.RigidMotion(WORLDS, WORLDS).at(np.full((3, 2), 2.0)), "t is 2.0 for body 0 of world 0"),
    ("t_max", lambda: SHORT.line_search(START, END), r"t_max is 0\.5; expected 1"),
    ("bounds", lambda: SEPARATED.displacement_bounds(START, 0.1), NO_BOUNDS),
    ("gradient", lambda: ccd.vertex_face_ccd(PAIR, PAIR).toi_gradient(PAIR, PAIR), "gradients of NumPy arrays"),
    ("path", lambda: viz.Picture(np.zeros((2, 3, 3), np.uint8)).__fspath__(), r"no file; expected picture\.save"),
]


@pytest.mark.parametrize(("what", "ask", "message"), ASKED)
def test_what_is_asked_of_an_object_that_does_not_have_it_is_refused(what, ask, message):
    kind = IndexError if what == "contact" else TypeError if "index" in message or "copied" in message else ValueError
    with pytest.raises(kind, match=message):
        ask()


def many_pairs(call):
    """A pair function of NumPy's points, of which a graph would hold the values that they have now."""
    function, arguments = EVERY_CALL[call]
    return function(*(np.repeat(arguments[end], 100, axis=0) for end in ("points_t0", "points_t1")))


FRESH, ON_DEVICE_T0 = ccd.CollisionPipeline(MESH), wp.array(START, dtype=wp.vec3d)
NEAR = PIPELINE.launch_proximity(ON_DEVICE_T0, 0.1)
# What a graph that is being captured cannot hold, and the message.
IN_CAPTURE = [
    (lambda: FRESH.launch(ON_DEVICE_T0, ON_DEVICE_T0), r"call reserve\(\) before the capture"),
    (lambda: FRESH.launch_proximity(ON_DEVICE_T0, 0.1), "^a graph is being captured, and this launch was not called"),
    (lambda: FRESH.reserve(), "a graph is being captured"),
    (lambda: PIPELINE.mesh_ccd(START, END), "a graph is being captured"),
    (lambda: ccd.collision_free_step(MESH, START, END), "a graph is being captured"),
    (lambda: ccd.CollisionPipeline(ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE)])), "a graph is being captured"),
    *(
        (lambda call=call: many_pairs(call), "(?i)captur.*(warp|device)")
        for call in EVERY_CALL
        if re.fullmatch("[a-z]+_[a-z]+_ccd", call)
    ),
    (lambda: NEAR.unique(), r"ask for proximities\.unique once before"),
]


@pytest.mark.parametrize(("ask", "message"), IN_CAPTURE)
def test_what_a_graph_cannot_hold_is_refused_while_it_is_captured(ask, message):
    with pytest.raises(RuntimeError, match=message), wp.ScopedCapture():
        ask()


def test_every_public_function_is_among_those_tried():
    tried = {}
    for function, arguments in EVERY_CALL.values():
        tried.setdefault(function.__qualname__, set()).update(arguments)
    left_out = (ccd.FrameSequence, ccd.LaunchResult)
    for public in (getattr(part, name) for part in (ccd, viz) for name in part.__all__):
        members = vars(public) if isinstance(public, type) and public not in left_out else {}
        names = [name for name in members if not name.startswith("_")]
        functions = [getattr(public, name) for name in names] + [public] * inspect.isfunction(public)
        for function in filter(callable, functions):
            if parameters := of.parameters_of(function):
                assert {*parameters} <= tried[function.__qualname__], function


def test_a_pipeline_stays_as_it_is_when_the_caller_changes_what_it_was_made_of():
    pipeline = ccd.CollisionPipeline(MESH, pair_kinds=(kinds := ["vertex_face"]), minimum_separation=0.1)
    expected = pipeline.mesh_ccd(START, END)
    kinds[0] = "point_point"
    check_same(pipeline.mesh_ccd(START, END), expected)
    layout = START.copy()
    pipeline.reserve(vertices=layout)
    launched = [a.copy() for a in arrays_of(pipeline.launch(START, END))]
    layout *= 1000.0
    pipeline.reserve(vertices=None)
    for a, b in zip(arrays_of(pipeline.launch(START, END)), launched, strict=True):
        np.testing.assert_array_equal(a, b)
