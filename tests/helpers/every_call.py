"""Every public function, with arguments that it takes: what tests of bad arguments change one by one."""

import functools
import inspect
import json

import numpy as np
import trimesh

import ccd_warp as ccd
from ccd_warp import datasets, viz

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
SEARCH = {"motion": None, "check_start": False, "per": "scene", "safety": 0.5, "max_rounds": 16}
BODIES = {
    "bodies": [(TRIANGLE, FACE), (CABLE, FACE[:0])],
    "static": [1],
    "kinematic": [],
    "rigid": [],
    "self_collision": True,
    "codimensional_points": False,
    "body_pairs": None,
    "exclusion_rings": 1,
    "exclude_pairs": {"bodies": [(0, 1)]},
    "vertex_world": np.zeros(6, dtype=int),
    "radius": np.full(6, 0.125),
    "names": ["face", "cable"],
}
JOINT = {"name": "turn", "parent": "base", "child": "arm", "kind": "revolute", "axis": [0.0, 0, 1]}
JOINT["origin"] = np.array([1.0, 0, 0, 0, 0, 0, 1])
POSES_OF_MESH = {"poses_t0": np.array([[0.0, 0, 0, 0, 0, 0, 1]] * MESH.num_bodies)}
POSES_OF_MESH["poses_t1"] = POSES_OF_MESH["poses_t0"] + 0.25
NO_GRADIENT = ccd.ToiGradient(*np.zeros((2, 0, 4, 3)), np.zeros(0), np.zeros(0, dtype=bool))
POSES = {
    "poses_t0": np.array([[0.0, 0, 0, 0, 0, 0, 1], [1, 2, 3, 0, 1, 0, 1]]),
    "poses_t1": np.array([[0.0, 0, 4, 0, 0, 1, 1], [1, 2, 3, 1, 1, 0, 2]]),
}
AFFINE = np.array([np.eye(3, 4), np.eye(3, 4) + 3])
PICTURE = viz.Picture(np.zeros((2, 3, 3), dtype=np.uint8))
LAUNCHED = {"motion": None, "vertices_t0": START, "vertices_t1": END}


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


def every_call(folder):
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
        "motion": None,
    }
    return {
        "vertex_face_ccd": (ccd.vertex_face_ccd, _points(0, 1, 2, 3)),
        "edge_edge_ccd": (ccd.edge_edge_ccd, _points(0, 1, 2, 3)),
        "point_segment_ccd": (ccd.point_segment_ccd, _points(0, 1, 2, dimension=2)),
        "point_point_ccd": (ccd.point_point_ccd, _points(0, 1)),
        "find_candidates": (
            ccd.find_candidates,
            FRAMES
            | {
                "inflation": 0.0,
                "motion": None,
                "broad_phase": "hash",
                "pair_kinds": None,
                "device": "cpu",
                "num_threads": 1,
            },
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
        "mesh_ccd": (ccd.mesh_ccd, FRAMES | MESH_OPTIONS | {"motion": None, "check_start": False}),
        "mesh_ccd beside a static body": (ccd.mesh_ccd, FRAMES | {"mesh": MESH_AND_STATIC, "device": "cpu"}),
        "collision_free_step": (
            ccd.collision_free_step,
            FRAMES | MESH_OPTIONS | {"motion": None, "check_start": False},
        ),
        "is_step_collision_free": (
            ccd.is_step_collision_free,
            FRAMES | MESH_OPTIONS | {"motion": None, "check_start": False},
        ),
        "rigid_ccd": (
            ccd.rigid_ccd,
            {"mesh": MESH, "path": "linear", "pivot": None, "twist": None} | POSES_OF_MESH | MESH_OPTIONS,
        ),
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
        "from_instances": (
            ccd.CollisionMesh.from_instances,
            {name: BODIES[name] for name in ("rigid", "body_pairs", "exclude_pairs")}
            | {"shape": trimesh.Trimesh(TRIANGLE, FACE), "count": 1, "others": [trimesh.PointCloud(CABLE)]}
            | {name: BODIES[name] for name in ("static", "names", "radius")},
        ),
        "HalfSpace": (_half_space, {"point": np.zeros(3), "normal": np.array([0.0, 0.0, 1.0])}),
        "RigidMotion": (ccd.RigidMotion, POSES | {"path": "linear", "pivot": np.array([[0.0, 5, 0], [1, 0, 2]])}),
        "RigidMotion of a twist": (
            ccd.RigidMotion,
            {"poses_t0": POSES["poses_t0"], "twist": np.arange(12.0).reshape(2, 6)},
        ),
        "from_scalar_first": (
            ccd.RigidMotion.from_scalar_first,
            POSES | {"path": "linear", "pivot": None, "twist": None},
        ),
        "RigidMotion.shortened": (ccd.RigidMotion(**POSES).shortened, {"t": 0.5}),
        "RigidMotion.gradient_by_poses": (ccd.RigidMotion(**POSES).gradient_by_poses, {"gradient": NO_GRADIENT}),
        "RigidMotion.gradient_by_twist": (ccd.RigidMotion(**POSES).gradient_by_twist, {"gradient": NO_GRADIENT}),
        "RigidMotion.at": (ccd.RigidMotion(**POSES).at, {"t": 0.5}),
        "AffineMotion": (ccd.AffineMotion, {"affine_t0": AFFINE, "affine_t1": 2.0 * AFFINE}),
        "positions_t0": (ccd.AffineMotion(AFFINE, AFFINE).positions_t0, {"points": CABLE, "body": np.array([0, 1, 1])}),
        "positions_t1": (ccd.AffineMotion(AFFINE, AFFINE).positions_t1, {"points": CABLE, "body": np.array([0, 1, 1])}),
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
            {"motion": None, "vertices_t0": START, "vertices_t1": END.copy(), "per": "scene", "safety": 0.5}
            | {"num_rounds": 4},
        ),
        "pipeline.find_candidates": (
            PIPELINE.find_candidates,
            {"vertices_t0": START, "vertices_t1": END, "inflation": 0.0, "motion": None},
        ),
        "pipeline.find_intersections": (PIPELINE.find_intersections, {"positions": START}),
        "pipeline.find_proximity": (PIPELINE.find_proximity, {"positions": START, "distance": 0.1}),
        "pipeline.displacement_bounds": (PIPELINE.displacement_bounds, {"positions": START, "search_radius": 0.1}),
        "launch_displacement_bounds": (
            PIPELINE.launch_displacement_bounds,
            {"positions": START, "search_radius": 0.1},
        ),
        "launch_proximity": (PIPELINE.launch_proximity, {"positions": START, "distance": 0.1}),
        "pipeline.mesh_ccd": (
            PIPELINE.mesh_ccd,
            {"vertices_t0": START, "vertices_t1": END, "motion": None, "check_start": False},
        ),
        "pipeline.collision_free_step": (
            PIPELINE.collision_free_step,
            {"vertices_t0": START, "vertices_t1": END, "motion": None, "check_start": False},
        ),
        "pipeline.is_step_collision_free": (
            PIPELINE.is_step_collision_free,
            {"vertices_t0": START, "vertices_t1": END, "motion": None, "check_start": False},
        ),
        "pipeline.line_search": (PIPELINE.line_search, {"vertices_t0": START, "vertices_t1": END} | SEARCH),
        "render_step": (viz.render_step, picture | {"path": folder / "a.png", "size": (900, 300), "t_max": 1.0}),
        "draw_step": (viz.draw_step, picture | {"size": (900, 300), "t_max": 1.0}),
        "show_step": (viz.show_step, picture),
        "Picture.save": (PICTURE.save, {"path": folder / "a.png"}),
        "to_pyvista": (viz.to_pyvista, FRAMES | {"result": RESULT, "t": 0.0, "motion": None}),
        "contact_points": (viz.contact_points, FRAMES | {"contacts": RESULT.contacts, "motion": None}),
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
        "Joint": (ccd.Joint, JOINT),
        "JointMotion": (ccd.JointMotion, {"joints": [ccd.Joint(**JOINT)], "q0": [0.0], "q1": [1.0], "links": ["arm"]}),
        "read_urdf": (ccd.read_urdf, {"path": folder / "arm.urdf", "base": None, "packages": None}),
        "read_poses": (
            ccd.read_poses,
            {"mesh_path": start, "poses_path": folder / "poses.json", "path": "linear", "static": [], "kinematic": []}
            | {"split": False, "max_bytes": 10**6},
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
                "split": False,
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
                "split": False,
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


def written(folder):
    """The files that calls read, in a folder, and the calls."""
    datasets.write_queries(folder / "a_vf.csv", POINTS_T0, POINTS_T1)
    datasets.write_step(folder / "0.ply", folder / "1.ply", STEP)
    datasets.write_truth(folder / "truth.json", np.array([True]))
    datasets.write_boxes(folder / "boxes.json", np.array([[0, 1]]))
    pose = dict.fromkeys(["t", "body", "px", "py", "pz", "qx", "qy", "qz"], 0) | {"qw": 1}
    (folder / "poses.json").write_text(json.dumps([pose, pose | {"t": 1, "px": 1}]))
    (folder / "arm.urdf").write_text('<robot name="a"><link name="base"/></robot>')
    return every_call(folder)


class Anywhere:
    """A folder that is never looked at, to list the calls by."""

    def __truediv__(self, _):
        return self


EVERY = [(call, argument) for call, (_, arguments) in every_call(Anywhere()).items() for argument in arguments]


def run(function, arguments):
    """The result, with arrays of its own to write to; None where nothing is left but to draw."""
    own = {name: np.array(value) if type(value) is np.ndarray else value for name, value in arguments.items()}
    try:
        return function(**own)
    except Drawn:
        return None
