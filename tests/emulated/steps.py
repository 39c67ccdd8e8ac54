"""Steps for every part of the library: small scenes that have what a part is for, made anew for each device."""

from typing import Any

import numpy as np
import scenes
from hard_cases import FAMILIES
from laws.calls import Made, StepCase

import ccd_warp as ccd

# A separation without holds, whose kernels in the maximum norm are those of radii but for the norm.
STRICT: dict[str, Any] = {"minimum_separation": 0.004, "start_gap_fraction": None}
# Options with which needles are hard.
_NEEDLES: dict[str, Any] = {"tolerance": 1e-15, "length_scale": 1.0}


def _crowd(num_faces: int = 150, size: float = 0.1) -> Made:
    return scenes.crowd(np.random.default_rng(21), num_faces, size)


def _every_kind(half_spaces: tuple[ccd.HalfSpace, ...] = (), **arguments: Any) -> Made:
    """Faces, cables and particles, which form pairs of all kinds, in three bodies, and half-spaces."""
    rng = np.random.default_rng(22)
    vertices, faces, edges = scenes.cables_and_particles(rng, 14, 0.1)
    bodies = [(vertices + 0.05 * k, faces, edges) for k in range(3)]
    mesh = ccd.CollisionMesh.from_arrays([*bodies, *half_spaces], **{"codimensional_points": True, **arguments})
    start = mesh.vertices
    moves = 0.15 * rng.standard_normal(start.shape) * ~mesh.static[mesh.vertex_body][:, None]
    return mesh, start, start + moves


def _thick(**arguments: Any) -> Made:
    """Every kind of pair, one body static, with radii that differ within primitives; some are 0."""
    vertices = np.arange(3 * len(scenes.cables_and_particles(np.random.default_rng(22), 14, 0.1)[0]))
    radius = 0.03 * np.random.default_rng(28).random(len(vertices)) * (vertices % 3)
    return _every_kind(static=[1], radius=radius, **arguments)


def _with_vertices_of_no_face() -> Made:
    """The same without particles, whose places are no numbers, beside a static body that has some."""
    mesh, start, end = _every_kind(static=[1], codimensional_points=False)
    start, end = start.copy(), end.copy()
    start[mesh.unused_vertices] = end[mesh.unused_vertices] = np.nan
    return mesh, start, end


def _between_walls() -> Made:
    """The same on a ground and beside a wall; some vertices start in the solid, and some pairs are excluded."""
    walls = ccd.HalfSpace([0, 0, 0.1], [0.1, 0, 2]), ccd.HalfSpace([0.8, 0, 0], [-1, 1e-3, 0])
    excluded = {"bodies": [(0, 3)], "vertex_plane": [(v, 0) for v in range(140, 180)]}
    return _every_kind(walls, static=[2], exclude_pairs=excluded)


def _with_kinematic() -> Made:
    """The same with a kinematic body, a static one and a ground that moves as it is told."""
    return _every_kind((ccd.HalfSpace([0, 0, 0.1], [0.1, 0, 2]),), static=[2], kinematic=[1, 3])


def _turning() -> Made:
    """The same with a body that turns beside a static one, one that does not keep its shape, and a ground."""
    return _every_kind((ccd.HalfSpace([0, 0, 0.1], [0.1, 0, 2]),), static=[1], rigid=[0])


def _in_plane(**arguments: Any) -> Made:
    rng = np.random.default_rng(23)
    k = np.arange(60)
    bodies = [
        (rng.random((60, 2)), np.stack([k[:-1], k[1:]], axis=1)),
        (rng.random((40, 2)), np.zeros((0, 2), dtype=int)),
        (rng.random((30, 2)), rng.permutation(30).reshape(-1, 2)),
    ]
    mesh = ccd.CollisionMesh.from_arrays(bodies, **arguments)
    moves = 0.1 * rng.standard_normal(mesh.vertices.shape) * ~mesh.static[mesh.vertex_body][:, None]
    return mesh, mesh.vertices, mesh.vertices + moves


def _squeezed_tube() -> Made:
    """Needles whose pairs are searched in a frame of their own, beside a face."""
    mesh = ccd.CollisionMesh.from_arrays([scenes.tube(800), (scenes.TRIANGLE, scenes.FACE)])
    end = mesh.vertices - [0.5, 0.0, 0.0]
    end[:1600] = scenes.squeezed(mesh.vertices[:1600], 0.6)
    return mesh, mesh.vertices, end


def _in_worlds() -> Made:
    _, mesh, start, end = scenes.cloth_and_ball_in_worlds(6)
    return mesh, start.reshape(-1, 3), end.reshape(-1, 3)


def _worlds_in_one_place() -> Made:
    """Worlds of different sizes, whose vertices are mixed up, with a scene that touches itself in each."""
    rng = np.random.default_rng(24)
    parts = [scenes.soup(rng, count, 0.15) for count in (30, 80, 5, 50)]
    mesh = ccd.CollisionMesh.from_arrays(
        parts, vertex_world=np.repeat([2, 0, 3, 1], [len(vertices) for vertices, _ in parts])
    )
    return mesh, mesh.vertices, mesh.vertices + 0.2 * rng.standard_normal(mesh.vertices.shape)


def _excluding() -> Made:
    """Every kind of excluded pairs, by which the search takes lists along."""
    mesh, start, end = _every_kind(exclusion_rings=2)
    pairs = ccd.find_candidates(mesh, start, end, num_threads=1).sorted()
    every_third = {name: values[::3] for name, values in vars(pairs).items() if len(values)}
    return mesh.excluding({**every_third, "bodies": [(0, 2)], "vertices": [(0, 130), (7, 250), (3, 20)]}), start, end


def _with_a_giant(**arguments: Any) -> Made:
    """A face a thousand times as large as the others, among them."""
    mesh, start, end = _crowd(120)
    giant = 1000 * scenes.TRIANGLE + [0.1, 0.2, 0.5]
    both = ccd.CollisionMesh.from_arrays([(start, mesh.faces), (giant, scenes.FACE)], **arguments)
    end = np.concatenate([end, giant + [0, 0, 0.01]])
    return both, both.vertices, scenes.with_static_at_rest(both, both.vertices, end)


def _in_one_place() -> Made:
    """Bodies of which two each may meet, so few that the trees are sorted by them first."""
    rng, number = np.random.default_rng(30), np.arange(12) // 2
    bodies = [scenes.soup(rng, 40, 0.15) for _ in number]
    mesh = ccd.CollisionMesh.from_arrays(bodies, self_collision=False, body_pairs=number[:, None] == number)
    return mesh, mesh.vertices, mesh.vertices + 0.1 * rng.standard_normal(mesh.vertices.shape)


def _bodies_far_apart() -> Made:
    """Bodies without self-collision, of which few come near another."""
    ball, faces = scenes.sheet(3, 0.3)
    places = np.random.default_rng(25).uniform(-2, 2, (40, 3))
    mesh = ccd.CollisionMesh.from_arrays([(ball + place, faces) for place in places], self_collision=False)
    moves = np.repeat(np.random.default_rng(26).uniform(-0.5, 0.5, (40, 3)), len(ball), axis=0)
    return mesh, mesh.vertices, mesh.vertices + moves


def _pile_at_rest() -> Made:
    """Bodies that touch at the start, and hardly move."""
    mesh, start = scenes.stacked(0.0, 0.0, 0.01, 0.01, 1e-9, 0.5)
    return mesh, start, start + 1e-3 * np.random.default_rng(27).standard_normal(start.shape)


def _needles() -> Made:
    """Needles that cross each other, each in a world of its own: most take more iterations than a first round has."""
    start, end = FAMILIES["needle_against_needle"]("edge-edge", 400, np.random.default_rng(0))
    solved = ccd.edge_edge_ccd(start, end, **_NEEDLES)
    chosen = np.argsort(-solved.iterations)[:20]
    return scenes.pairs_in_worlds("edge-edge", start[chosen], end[chosen])


def _in_a_plane_at_rest() -> Made:
    """Faces that slide over each other without a gap, and a body that does not move at all."""
    vertices, faces = scenes.sheet(4)
    mesh = ccd.CollisionMesh.from_arrays([(vertices + [0, 0, z], faces) for z in (0.0, 0.0, 0.3)])
    moves = np.repeat([[0.3, 0.1, 0.0], [0, 0, 0], [0, 0, -0.6]], len(vertices), axis=0)
    return mesh, mesh.vertices, mesh.vertices + moves


_BODY_PAIRS = ~np.eye(3, dtype=bool)
_BODY_PAIRS[0, 1] = _BODY_PAIRS[1, 0] = False

STEPS = {
    "crowd": StepCase(_crowd, {}, is_thorough=True),
    "sheet over a static ball": StepCase(scenes.sheet_over_ball, {}),
    "every kind of pair": StepCase(_every_kind, STRICT),
    "every kind, one body static": StepCase(lambda: _every_kind(static=[1]), STRICT, is_thorough=True),
    "in the plane": StepCase(_in_plane, {"minimum_separation": 0.003}),
    "in the plane, one body static": StepCase(lambda: _in_plane(static=[0]), {}),
    "worlds": StepCase(_in_worlds, {}),
    "worlds in one place": StepCase(_worlds_in_one_place, {}),
    "excluded pairs": StepCase(_excluding, {}),
    "rings": StepCase(lambda: _every_kind(exclusion_rings=3), {}),
    "body pairs, self-collision of one": StepCase(
        lambda: _every_kind(body_pairs=_BODY_PAIRS, self_collision=[True, False, False]), {}
    ),
    "bodies far apart": StepCase(_bodies_far_apart, {}),
    "a giant face": StepCase(_with_a_giant, {}),
    "a static giant face": StepCase(lambda: _with_a_giant(static=[1]), {}),
    "contact at the start": StepCase(_pile_at_rest, {"start_gap_fraction": 0.5, "minimum_separation": 0.02}),
    "sheets that slide over each other": StepCase(_in_a_plane_at_rest, {}),
    "t_max": StepCase(_crowd, {"t_max": 0.37}),
    "t_max of 0": StepCase(_every_kind, {"t_max": 0.0}),
    "tolerance, length_scale": StepCase(_crowd, {"tolerance": 1e-3, "length_scale": 0.3, "minimum_separation": 0.01}),
    "bisection": StepCase(lambda: _crowd(60, 0.15), {"method": "bisection"}),
    "few iterations": StepCase(_crowd, {"max_iterations": 3}),
    "little work": StepCase(_needles, {**_NEEDLES, "max_work": 10_000}),
    "little work for the bisection": StepCase(_needles, {**_NEEDLES, "max_work": 100_000, "method": "bisection"}),
    "spatial hash": StepCase(lambda: _every_kind(static=[1]), {"broad_phase": "hash", **STRICT}),
    "spatial hash, excluded pairs": StepCase(_excluding, {"broad_phase": "hash"}),
    "half-spaces": StepCase(_between_walls, STRICT),
    "kinematic bodies": StepCase(_with_kinematic, STRICT),
    "pair kinds": StepCase(_every_kind, {"pair_kinds": ["vertex_face", "point_segment"]}),
    "one thread": StepCase(_crowd, {"num_threads": 1}),
    "trees of four levels": StepCase(lambda: scenes.crowd(np.random.default_rng(29), 1500, 0.02, 0.02), {}),
    "bodies that may not meet": StepCase(_in_one_place, {}),
    "needles side by side": StepCase(_squeezed_tube, {}),
    "vertices of no face": StepCase(_with_vertices_of_no_face, {}),
}
# Meshes with radii, for which the Euclidean kernels are compiled: by the calls that need each of these, and no others.
THICK = {
    "radii": StepCase(_thick, {"minimum_distance": 0.004}),
    "radii, spatial hash, excluded pairs": StepCase(
        lambda: _thick(exclude_pairs={"bodies": [(0, 2)], "vertices": [(0, 130), (7, 250), (3, 20)]}),
        {"broad_phase": "hash"},
    ),
    "bodies that turn": StepCase(_turning, {}),
    "bodies that turn, a distance": StepCase(_turning, {"minimum_distance": 0.004, "broad_phase": "hash"}),
}
