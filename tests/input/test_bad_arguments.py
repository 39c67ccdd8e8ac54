"""A table of bad arguments and of what the message says of each: argument, value, message; tried on every call.

That each argument of every function refuses what is no such thing at all is tested in `test_hostile_arguments`.
"""

import math

import numpy as np
import pytest
from every_call import END, EVERY, FACE, START, written

import ccd_warp as ccd

HALF = START[:, :2]
WITH_NAN, WITH_INF = (np.where(np.arange(6)[:, None] == 4, value, START) for value in (np.nan, np.inf))
LENGTH = "a finite length of at least 0"
# Of calls that take the argument: all of them, or those that are named.
FRAMES = ["find_candidates", "mesh_ccd", "collision_free_step", "is_step_collision_free", "line_search", "frames"]
FRAMES += [f"pipeline.{call}" for call in FRAMES[1:5]]
ONE_TIME = ["find_intersections", "find_proximity", "displacement_bounds", "launch_proximity"]
PAIRS = ["vertex_face_ccd", "edge_edge_ccd"]
OF_CALLS = [
    # --- options ---
    ("tolerance", 0.0, "tolerance is 0.0; expected a finite number above 0", None),
    ("tolerance", -1e-6, "tolerance is -1e-06", None),
    ("tolerance", np.nan, "tolerance is nan", None),
    ("tolerance", "fine", "tolerance is 'fine'", None),
    ("minimum_separation", -1.0, "minimum_separation is -1.0; expected a finite number of at least", None),
    ("minimum_separation", np.inf, "minimum_separation is inf", None),
    *(
        ("minimum_distance", value, f"minimum_distance .*expected {LENGTH}", None)
        for value in (-1e-9, math.nan, math.inf, -math.inf, "1", None, True, [0.1], 1 + 0j)
    ),
    ("start_gap_fraction", 1.0, "start_gap_fraction is 1.0; expected 'hold', a number between 0 and 1", None),
    ("method", "newton", "method is 'newton'; expected 'clipping' or 'bisection'", None),
    ("t_max", 1.5, r"t_max is 1.5; expected a number in [\[\(]0, 1\]", None),
    ("t_max", -0.1, "t_max is -0.1", None),
    ("max_iterations", 0, "max_iterations is 0; expected a positive integer", None),
    ("max_iterations", 1.5, "max_iterations is 1.5", None),
    ("length_scale", 0.0, "length_scale is 0.0; expected a finite length above 0", None),
    ("precision", "float16", "precision is 'float16'; expected 'float64' or 'float32'", None),
    ("device", "abacus", "device is 'abacus'; expected one of 'cpu'", None),
    ("num_threads", 0, "num_threads is 0; expected a positive integer", None),
    ("num_threads", 1.5, r"num_threads is 1\.5", None),
    ("num_threads", 10**6, "num_threads is 1000000; expected a positive integer up to 1024", None),
    ("memory_limit", 0, "memory_limit is 0; expected a positive integer", None),
    ("memory_limit", 1.5, "memory_limit is 1.5", None),
    ("broad_phase", "grid", "broad_phase is 'grid'; expected 'tree' or 'hash'", None),
    ("broad_phase", None, "broad_phase is None; expected 'tree' or 'hash'", None),
    ("pair_kinds", [], r"pair_kinds is \[\]; expected a list of 'vertex_face', 'edge_edge'", None),
    ("pair_kinds", "vertex_face", "pair_kinds is 'vertex_face'; expected a list", None),
    ("pair_kinds", ["vertex"], r"pair_kinds is \['vertex'\]", None),
    # --- beside the options ---
    ("mesh", [START], r"mesh is .*; expected a CollisionMesh", FRAMES[:5]),
    *(
        ("inflation", value, "inflation is .*; expected a finite length that is not negative", None)
        for value in (-1.0, np.nan, np.inf, "1", np.zeros(2), 10**400)
    ),
    *(
        ("distance", value, f"distance is .*; expected {LENGTH}", None)
        for value in (-1.0, np.nan, np.inf, None, "near", [0.1], np.array([0.1, 0.2]), True, 1j)
    ),
    *(
        ("search_radius", value, "search_radius is .*; expected a finite length above 0$", None)
        for value in (0.0, -1.0, np.nan, np.inf, None, "far", [0.1], True)
    ),
    ("per", "face", "per is 'face'; expected one of 'scene', 'world', 'body', 'vertex'", None),
    ("safety", 1.0, "safety is 1.0; expected a number between 0 and 1", None),
    ("safety", float("nan"), "safety is nan", None),
    ("max_rounds", 2, "max_rounds is 2; expected an integer of at least 3", None),
    ("num_rounds", 2, "num_rounds is 2; expected an integer of at least 3", None),
    ("max_pairs", 0, "max_pairs is 0; expected a positive integer", None),
    ("max_pairs", 2**29, "max_pairs is 536870912; expected a positive integer up to 268435456", None),
    ("max_contacts", 1.5, "max_contacts is 1.5; expected a positive integer", None),
    ("vertices", np.full((6, 3), np.nan), "vertices holds nan in row 0", ["reserve"]),
    ("size", (10, 10), r"size is \(10, 10\); expected width and height in \[150, 4000\]", None),
    ("size", 7, "size is 7", None),
    ("camera", (0, 0, 0), r"camera is \(0, 0, 0\); expected three finite numbers", None),
    ("camera", "left", "camera is 'left'", None),
    ("colour", "red", "colour is 'red'; expected 'vertex_toi' or 'body'", None),
    # --- positions of a mesh ---
    ("vertices_t0", START[:-1], r"vertices_t0 has shape \(5, 3\); expected \(6, 3\)", FRAMES),
    ("vertices_t0", WITH_INF, "vertices_t0 holds inf in row 4.*; expected finite values", FRAMES),
    ("vertices_t1", END[:-1], r"vertices_t1 has shape \(5, 3\); expected \(6, 3\) like vertices_t0", FRAMES),
    ("vertices_t1", END[:, :2], r"vertices_t1 has shape \(6, 2\); expected \(6, 3\) like vertices_t0", FRAMES),
    ("vertices_t1", WITH_NAN, "vertices_t1 holds nan in row 4.*; expected finite values", FRAMES),
    (
        "positions",
        START[:-1],
        r"positions has shape \(5, 3\); expected \(6, 3\) one row a vertex of the mesh",
        ONE_TIME[:3],
    ),
    ("positions", HALF, r"positions has shape \(6, 2\)", ONE_TIME[:3]),
    ("positions", WITH_NAN, "positions .*nan", ONE_TIME[:3]),
    ("positions", WITH_INF, "positions .*inf", ONE_TIME[:3]),
    ("positions", START.astype(complex), "positions", ONE_TIME),
    ("positions", None, "positions", ONE_TIME),
    # --- positions of a launch ---
    ("vertices_t1", None, "neither of vertices_t1 and displacements is given; expected one of them", ["launch"]),
    ("vertices_t0", START[:2], "vertices_t0 has 2 rows; expected 6, one a vertex", ["launch"]),
    ("vertices_t1", END.astype(np.float32), "vertices_t1 has dtype vec3f; expected vec3d like vertices_t0", ["launch"]),
    ("vertices_t0", START.astype(int), "vertices_t0 has dtype int64; expected float32 or float64", ["launch"]),
    ("vertices_t1", END[::-1], r"vertices_t1 has strides \(-24, 8\); expected a contiguous array", ["launch"]),
    ("vertices_t0", np.eye(6)[:, :3], r"vertices_t0 has strides \(48, 8\); expected a contiguous array", ["launch"]),
    (
        "vertices_t0",
        START.tolist(),
        "vertices_t0 is a list; expected an array of Warp, NumPy, or with DLPack",
        ["launch"],
    ),
    (
        "vertices_t0",
        START.ravel(),
        r"vertices_t0 has dtype float64 and shape \(18,\); expected vec3f or vec3d and \(n,\)",
        ["launch"],
    ),
    ("vertices_t1", END, "both of vertices_t1 and displacements is given", ["launch of displacements"]),
    # --- points of pairs ---
    ("points_t0", np.zeros((2, 3, 3)), r"points_t0 has shape \(2, 3, 3\); expected \(n, 4, 3\)", PAIRS),
    ("points_t1", np.zeros((2, 4)), r"points_t1 has shape \(2, 4\); expected \(n, 4, 3\)", PAIRS),
    ("points_t1", np.zeros((3, 4, 3)), r"points_t1 has shape \(3, 4, 3\); expected \(1, 4, 3\) like points_t0", PAIRS),
    ("points_t0", np.zeros((1, 4, 3), complex), "points_t0 has dtype complex128; expected real numbers", PAIRS),
    ("points_t0", [[1, 2], [3]], "points_t0 is not an array", PAIRS),
    ("points_t0", np.full((1, 4, 3), np.nan), "points_t0 holds nan in pair 0; expected finite values", PAIRS),
    ("points_t1", np.full((1, 4, 3), -np.inf), "points_t1 holds -inf in pair 0; expected finite values", PAIRS),
]


@pytest.fixture(scope="module")
def calls(tmp_path_factory):
    return written(tmp_path_factory.mktemp("data"))


@pytest.mark.parametrize(("argument", "value", "message", "of"), OF_CALLS)
def test_a_bad_argument_is_named_with_what_was_expected(calls, argument, value, message, of):
    chosen = of or [call for call, taken in EVERY if taken == argument]
    assert chosen
    for name in chosen:
        function, arguments = calls[name]
        with pytest.raises(ValueError, match=message) as caught:
            function(**arguments | {argument: value})
            pytest.fail(f"{name} takes it")
        if of is None and getattr(ccd, name, None) is function:
            assert str(caught.value).startswith(f"{name}: "), str(caught.value)


TRIANGLE = (np.eye(3), [[0, 1, 2]])
SEGMENT, EDGE = np.array([[-1.0, 0], [1.0, 0]]), [[0, 1]]
SHEET_AND_BEAD = [TRIANGLE, (np.array([[0.2, 0.2, 1.0]]), FACE[:0])]
OF_BODIES = [
    ([], "bodies is empty; expected at least one body"),
    ([TRIANGLE, (np.eye(5, 3), [[0, 1, 7]])], r"faces of body 1 holds index 7; expected indices in \[0, 5\)"),
    ([(np.eye(5, 3), [[0, 1, -1]])], r"faces of body 0 holds index -1; expected indices in \[0, 5\)"),
    ([(np.zeros((0, 3)), [[0, 1, 2]])], r"faces of body 0 holds index 0; expected indices in \[0, 0\)"),
    ([(np.eye(3), [[0, 1]])], r"faces of body 0 has shape \(1, 2\); expected \(n, 3\)"),
    ([(np.eye(3), [[0.0, 1.0, 2.0]])], "faces of body 0 has dtype float64; expected integers"),
    ([(np.eye(4), [[0, 1, 1]])], r"vertices of body 0 has shape \(4, 4\); expected \(n, 3\)"),
    ([(np.full((3, 3), np.nan), [])], "vertices of body 0 holds nan in row 0; expected finite values"),
    ([(np.eye(3, dtype=complex), [])], "vertices of body 0 has dtype complex128; expected real numbers"),
    ([np.eye(3)], r"body 0 is a ndarray; expected a pair \(vertices, faces\) or a triple \(vertices, faces, edges"),
    ([(*TRIANGLE, [[0, 3]])], r"edges of body 0 holds index 3; expected indices in \[0, 3\)"),
    ([(*TRIANGLE, [[0, 1, 2]])], r"edges of body 0 has shape \(1, 3\); expected \(n, 2\)"),
    ([(*TRIANGLE, [[0.0, 1.0]])], "edges of body 0 has dtype float64; expected integers"),
    # --- in the plane ---
    ([(SEGMENT, EDGE), TRIANGLE], r"body 1 has 3 columns and those of body 0 2; expected all"),
    ([TRIANGLE, (SEGMENT, EDGE)], r"body 0 has 3 columns and those of body 1 2; expected all"),
    ([(SEGMENT, [[0, 1, 1]])], r"edges of body 0 has shape \(1, 3\); expected \(n, 2\)"),
    ([(SEGMENT, [], EDGE)], r"body 0 is in the plane and has 3 arrays; expected a pair \(vertices, edges\)"),
    ([(SEGMENT, [[0, 2]])], r"edges of body 0 holds index 2; expected indices in \[0, 2\)"),
    ([(SEGMENT + [np.inf, 0], EDGE)], r"vertices of body 0 holds .* in row 0; expected finite"),
    ([(np.zeros((4, 4)), EDGE)], r"vertices of body 0 has shape \(4, 4\); expected \(n, 3\)"),
]
OF_ONE_BODY = [
    ("codimensional_points", [True, False], r"codimensional_points has shape \(2,\); expected a bool or \(1,\)"),
    ("codimensional_points", [0], r"codimensional_points is \[0\]; expected a bool or one bool a body"),
    ("static", [1], r"static holds 1; expected body indices in \[0, 1\)"),
    ("static", [-1], r"static holds -1; expected body indices in \[0, 1\)"),
    ("static", [True], r"static holds True; expected body indices"),
    ("static", 0, "static is 0; expected a list of body indices"),
    ("self_collision", [True, False], r"self_collision has shape \(2,\); expected a bool or \(1,\)"),
    ("self_collision", 1, "self_collision is 1; expected a bool or one bool a body"),
    ("vertex_world", [0, 0], r"vertex_world has dtype int64 and shape \(2,\); expected integers and \(3,\)"),
    ("vertex_world", [0.0, 0.0, 0.0], "vertex_world has dtype float64"),
    ("vertex_world", [-1, 0, 0], "vertex_world holds -1; expected worlds from 0 on, below the number of vertices, 3"),
    ("vertex_world", [3, 3, 3], "vertex_world holds 3; expected worlds from 0 on, below the number of vertices, 3"),
    ("vertex_world", [0, 0, 1], r"vertex_world gives face 0 worlds \[0, 0, 1\]; expected one"),
    *(
        ("exclude_pairs", value, "exclude_pairs is .*; expected a mapping from what is paired")
        for value in ([[0, 1]], "edge_edge", 3, {"edge_edge"})
    ),
]
OF_TWO_BODIES = [
    ("body_pairs", np.ones((1, 1)), r"body_pairs has dtype float64 and shape \(1, 1\); expected bool and \(2, 2\)"),
    ("body_pairs", [[True, False], [True, True]], r"body_pairs differs at \(0, 1\) and \(1, 0\)"),
    ("exclusion_rings", 0, "exclusion_rings is 0; expected a positive integer"),
    ("names", ["cloth"], "names has 1 entries; expected 2, one a body"),
    ("names", ["cloth", "cloth"], "names holds 'cloth' twice; expected a name of its own"),
    ("names", ["cloth", 7], "names holds 7; expected printable texts"),
    ("names", ["cloth", ""], "names holds ''; expected printable texts"),
    ("names", ["cloth", "a\nb"], r"names holds 'a\\nb'; expected printable texts"),
    ("names", "cloth", "names is 'cloth'; expected a list of texts"),
]
OF_RADIUS = [
    (-1.0, "radius is -1.0; expected a finite length of at least 0"),
    (float("nan"), "radius is nan; expected a finite length"),
    (float("inf"), "radius is inf; expected a finite length"),
    (True, "radius is True; expected a finite length"),
    (1 << 1100, "radius is 1.*that float64 can hold"),
    (2**53 + 1, "without rounding"),
    ("0.1", "radius"),
    ([0.1], r"radius has shape \(1,\); expected a number, shape \(2,\), one a body, or \(4,\), one a vertex"),
    ([[0.1, 0.2]], r"radius has shape \(1, 2\)"),
    ([0.1, -0.2], "radius holds -0.2 in entry 1; expected finite lengths of at least 0"),
    ([0.1, np.nan], "radius holds nan in entry 1"),
    ([0, 0, np.inf, 0], "radius holds inf in entry 2 of sheet"),
    (np.array(-1.0), "radius holds -1.0 in entry 0"),
    ([True, False], "radius has dtype bool"),
    ([1j, 2], "radius has dtype complex128"),
    ([0.1, None], "radius has dtype object"),
    ([[0.1], [0.1, 0.2]], "radius is not an array"),
    (np.ma.array([0.1, 0.2], mask=[0, 1]), "radius is a masked array"),
    ([2**53 + 1, 0.5], "radius holds 9007199254740993 in entry 0"),
]
UP, ORIGIN = [0.0, 0, 1], [0.0, 0, 0]
OF_HALF_SPACES = [
    ((ORIGIN, ORIGIN), r"normal of body 1 \(floor\) is \[0.0, 0.0, 0.0\]; expected a direction"),
    ((ORIGIN, [0, np.nan, 1]), r"normal of body 1 \(floor\) is \[0.0, nan, 1.0\]; expected finite"),
    ((ORIGIN, [0, 0, np.inf]), r"normal of body 1 \(floor\) is \[0.0, 0.0, inf\]; expected finite"),
    (([0, -np.inf, 0], UP), r"point of body 1 \(floor\) is \[0.0, -inf, 0.0\]; expected finite"),
    (([ORIGIN], UP), r"point of body 1 \(floor\) has shape \(1, 3\); expected \(3,\)"),
    (([0, 0], [0, 1]), r"point of body 1 \(floor\) has shape \(2,\); expected \(3,\)"),
    ((ORIGIN, 1.0), r"normal of body 1 \(floor\) is 1.0; expected 3 numbers"),
    ((["a", "b", "c"], UP), r"point of body 1 \(floor\) has dtype .*; expected real numbers"),
]
BODIES_A_C_D = [TRIANGLE, TRIANGLE, (np.zeros((2, 3)), FACE[:0])]
OF_EXCLUDED_PAIRS = [
    ({"edges": [[0, 1]]}, r"has the key 'edges'; expected 'bodies', 'vertices', .* or 'vertex_plane'"),
    ({("edge", "edge"): [[0, 1]]}, r"has the key \('edge', 'edge'\); expected"),
    ({"edge_edge": [[0, 6]]}, r"\['edge_edge'\] holds edge 6 in row 0; expected an index in \[0, 6\)"),
    ({"vertex_face": [[0, 1], [-1, 0]]}, r"\['vertex_face'\] holds vertex -1 in row 1; expected .* \[0, 8\)"),
    ({"vertex_face": [[0, 1], [1, 4]]}, r"\['vertex_face'\] holds face 4 in row 1; expected .* \[0, 2\)"),
    ({"vertex_face": [[0, 2]]}, r"\['vertex_face'\] holds face 2 in row 0; expected .* \[0, 2\)"),
    ({"vertices": [[0, 2**40]]}, r"\['vertices'\] holds vertex 1099511627776 in row 0"),
    ({"bodies": [[0, 3]]}, r"\['bodies'\] holds body 3 in row 0; expected an index in \[0, 3\)"),
    ({"bodies": [["a", "c"], ["a", "b"]]}, r"\['bodies'\] holds 'b'; expected indices or names of the mesh's"),
    ({"bodies": [[0, 1], [2]]}, r"\['bodies'\] is not an array"),
    ({"bodies": "ab"}, r"\['bodies'\] is 'ab'; expected pairs of body indices or names"),
    ({"bodies": ["ac"]}, r"\['bodies'\] is 'ac'; expected pairs of body indices or names"),
    ({"bodies": [[0, True], [0, 1.5]]}, r"\['bodies'\] has dtype float64; expected integers"),
    ({"vertices": [[0, 1, 2]]}, r"\['vertices'\] has shape \(1, 3\); expected \(k, 2\)"),
    ({"vertices": [0, 1]}, r"\['vertices'\] has shape \(2,\); expected \(k, 2\)"),
    ({"vertices": 3}, r"\['vertices'\] is 3; expected integers and shape \(k, 2\)"),
    ({"edge_edge": [[0.0, 1.0]]}, r"\['edge_edge'\] has dtype float64; expected integers"),
    ({"edge_edge": np.broadcast_to(np.int8(0), (2**27 + 1, 2))}, r"has 134217729 pairs; expected at most 134217728"),
    ({"point_point": [[6, 7], [0, 6]]}, r"\['point_point'\] holds 0 in row 1; expected a codimensional point"),
    ({"point_segment": [[6, 0]]}, r"\['point_segment'\] holds 0 in row 0; expected a codimensional edge"),
]


OF_A_MESH = [
    *((bodies, {}, message) for bodies, message in OF_BODIES),
    *(([TRIANGLE], {name: value}, message) for name, value, message in OF_ONE_BODY),
    *(([TRIANGLE, TRIANGLE], {name: value}, message) for name, value, message in OF_TWO_BODIES),
    *(
        (SHEET_AND_BEAD, {"codimensional_points": True, "names": ["sheet", "bead"], "radius": radius}, message)
        for radius, message in OF_RADIUS
    ),
    *(([TRIANGLE, ccd.HalfSpace(*given)], {"names": ["cloth", "floor"]}, message) for given, message in OF_HALF_SPACES),
    ([ccd.HalfSpace(ORIGIN, UP)], {}, "bodies holds half-spaces alone; expected at least one body with vertices"),
    *(
        (BODIES_A_C_D, {"codimensional_points": True, "names": list("acd"), "exclude_pairs": pairs}, message)
        for pairs, message in OF_EXCLUDED_PAIRS
    ),
]


@pytest.mark.parametrize(("bodies", "options", "message"), OF_A_MESH)
def test_a_mesh_that_cannot_be_is_refused_with_what_was_expected(bodies, options, message):
    with pytest.raises(ValueError, match=message):
        ccd.CollisionMesh.from_arrays(bodies, **options)
