"""Every public call with arguments that it takes, made from its signature: what tests of bad arguments change."""

import functools
import inspect
import tempfile
import typing
from pathlib import Path

import numpy as np
import trimesh

import ccd_warp as ccd
from ccd_warp import viz
from ccd_warp._files.ply import write_ply

TRIANGLE = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]])
FACE = np.array([[0, 1, 2]])
CABLE = np.array([[1.0, 1, 5], [2, 1, 5], [3, 3, 9]])
MESH = ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), (CABLE, FACE[:0], [[0, 1]])], codimensional_points=True)
BODIES = [(TRIANGLE, FACE), (CABLE, FACE[:0])]
MESH_AND_STATIC = ccd.CollisionMesh.from_arrays(BODIES, static=[1], names=["cloth", "ball"])
START = np.concatenate([TRIANGLE, CABLE])
END = START + np.repeat([[0.0, 0, 8], [0, 0, 0]], 3, axis=0)
POINTS_T0 = np.concatenate([CABLE[:1], TRIANGLE])[None]
POINTS_T1 = POINTS_T0 + [[[0.0, 0, 0], [0, 0, 8], [0, 0, 8], [0, 0, 8]]]
RESULT = ccd.mesh_ccd(MESH, START, END)
PIPELINE = ccd.CollisionPipeline(MESH)
POSES = np.array([[[0.0, 0, 0, 0, 0, 0, 1], [1, 2, 3, 0, 1, 0, 1]], [[0, 0, 4, 0, 0, 1, 1], [1, 2, 3, 1, 1, 0, 2]]])
MOTION = ccd.RigidMotion(*POSES)

# What a parameter of a name is given, wherever a call takes it and says nothing else.
VALUES = {
    **{"tolerance": 1e-6, "minimum_separation": 0.0, "minimum_distance": 0.0, "start_gap_fraction": None, "t_max": 1.0},
    **{"max_iterations": 1000, "length_scale": None, "precision": "float64", "method": "clipping", "device": None},
    **{"num_threads": 1, "max_work": 1000, "broad_phase": "hash", "pair_kinds": None, "memory_limit": None},
    **{"mesh": MESH, "vertices_t0": START, "vertices_t1": END, "positions": START, "vertices": START, "motion": None},
    **{"inflation": 0.0, "distance": 0.1, "search_radius": 0.1, "check_start": False, "per": "scene", "safety": 0.5},
    **{"unique": True, "max_rounds": 16, "num_rounds": 4, "max_pairs": 4096, "max_contacts": 4096, "count": 2},
    **{"bodies": BODIES, "others": [(CABLE, FACE[:0])], "cells": {"triangle": FACE}},
    **{"static": [1], "kinematic": [], "rigid": [], "self_collision": True, "codimensional_points": False},
    **{"body_pairs": None, "exclusion_rings": 1, "exclude_pairs": {"bodies": [(0, 1)]}, "names": ["face", "cable"]},
    **{"vertex_world": np.zeros(6, dtype=int), "radius": np.full(6, 0.125), "point": np.zeros(3)},
    **{"normal": np.array([0.0, 0, 1]), "poses_t0": POSES[0], "poses_t1": POSES[1], "path": "linear", "pivot": None},
    **{"twist": None, "within": np.zeros(2), "t": 0.5},
    "gradient": ccd.ToiGradient(*np.zeros((2, 0, 4, 3)), np.zeros(0), np.zeros(0, bool)),
    **{"points_t0": POINTS_T0, "points_t1": POINTS_T1, "progress": False},
    **{"surface": False, "split": False, "displacement": None},
    **{"result": RESULT, "camera": None, "colour": "body", "size": (900, 300)},
    **{"displacements": None, "k": 0},
}


def parameters_of(function):
    """Names of all that a function takes, the options of its typed dictionary included."""
    names = []
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.kind == parameter.VAR_KEYWORD:
            hints = typing.get_type_hints(function.__init__ if isinstance(function, type) else function)
            names += typing.get_args(hints[name])[0].__optional_keys__
        elif name not in ("self", "name" if function.__name__ == "frame" else ""):  # a word for messages
            names.append(name)
    return sorted(names)


def _arrays_of_a_body(**parts):
    """A mesh of one body, by its arrays."""
    return ccd.CollisionMesh.from_arrays([tuple(parts[f"{name} of body 0"] for name in ("vertices", "faces", "edges"))])


@functools.wraps(ccd.HalfSpace, updated=())
def _half_space(**parts):
    """A mesh with a half-space, whose numbers are checked there."""
    return ccd.CollisionMesh.from_arrays([(TRIANGLE, FACE), ccd.HalfSpace(**parts)])


@functools.wraps(ccd.CollisionPipeline.reserve)
def _reserve(**capacities):
    """What a launch writes to what was reserved."""
    PIPELINE.reserve(**capacities)
    return PIPELINE.launch(START, END)


class Drawn(Exception):
    """Drawing was about to begin: all arguments were taken."""


def run(function, arguments, changed=()):
    """The result, with arrays of its own to write to but those that are changed; None where only drawing is left."""
    own = {name: np.array(value) if type(value) is np.ndarray else value for name, value in arguments.items()}
    try:
        return function(**own | dict(changed))
    except Drawn:
        return None


def _every_call(folder):
    """Each public call by its name: the function, and arguments that it takes."""
    start, end = folder / "0.ply", folder / "1.ply"
    write_ply(start, START, FACE)
    write_ply(end, END, FACE)
    launched = ccd.CollisionPipeline(MESH).launch(START, END)
    of_files = {"start_path": start, "end_path": end, "paths": [start, end], "static": [start]}
    solids = [trimesh.Trimesh(TRIANGLE, FACE), trimesh.PointCloud(CABLE)]
    calls = {}

    def add(*functions, title="", **others):
        for function in functions:
            values = {n: others[n] if n in others else VALUES[n] for n in parameters_of(function)}
            calls[title or function.__qualname__] = (function, values)

    add(ccd.vertex_face_ccd, ccd.edge_edge_ccd, ccd.vertex_face_ccd(POINTS_T0, POINTS_T1).toi_gradient)
    add(ccd.point_segment_ccd, points_t0=POINTS_T0[:, :3, :2], points_t1=POINTS_T1[:, :3, :2])
    add(ccd.point_point_ccd, points_t0=POINTS_T0[:, :2], points_t1=POINTS_T1[:, :2])
    add(ccd.find_candidates, ccd.find_intersections, ccd.find_proximity, ccd.displacement_bounds, ccd.mesh_ccd)
    add(ccd.collision_free_step, ccd.is_step_collision_free, ccd.line_search, ccd.CollisionPipeline)
    add(ccd.mesh_ccd, title="mesh_ccd beside a static body", mesh=MESH_AND_STATIC)
    add(ccd.rigid_ccd, poses_t1=POSES[0] + 0.25)
    add(ccd.CollisionMesh.from_arrays, ccd.CollisionMesh.from_volume, vertices=TRIANGLE)
    add(ccd.CollisionMesh.from_trimesh, bodies=solids)
    add(ccd.CollisionMesh.from_instances, shape=solids[0], count=1, others=solids[1:])
    body = {"vertices of body 0": START, "faces of body 0": FACE, "edges of body 0": np.array([[3, 4], [4, 5]])}
    calls["arrays of a body"] = _arrays_of_a_body, body
    add(_half_space, _reserve, MESH.replicate, MESH.frame, MESH.frames)
    add(MESH.excluding, exclude_pairs={"edge_edge": [[0, 1]]})
    add(ccd.RigidMotion, pivot=np.array([[0.0, 5, 0], [1, 0, 2]]))
    add(ccd.RigidMotion, title="RigidMotion of a twist", poses_t1=None, twist=np.arange(12.0).reshape(2, 6))
    add(ccd.RigidMotion.from_scalar_first, MOTION.shortened, MOTION.at)
    add(MOTION.gradient_by_poses, MOTION.gradient_by_twist)
    add(PIPELINE.launch, PIPELINE.launch_proximity, PIPELINE.launch_displacement_bounds)
    add(PIPELINE.launch, title="launch of displacements", vertices_t1=None, displacements=END - START)
    add(PIPELINE.launch_line_search, PIPELINE.line_search, PIPELINE.mesh_ccd, PIPELINE.collision_free_step)
    add(PIPELINE.is_step_collision_free, PIPELINE.find_candidates, PIPELINE.find_intersections)
    add(PIPELINE.find_proximity, PIPELINE.displacement_bounds)
    add(launched.to_host, launched.contacts.to_host, launched.contacts.points_at)
    add(viz.render_step, viz.Picture(np.zeros((2, 3, 3), dtype=np.uint8)).save, path=folder / "a.png")
    add(viz.draw_step, viz.to_pyvista)
    add(ccd.read_frames, ccd.read_sequence, **of_files)
    return calls


FOLDER = tempfile.TemporaryDirectory()  # of files that calls read and write, removed at the end
EVERY_CALL = _every_call(Path(FOLDER.name))
