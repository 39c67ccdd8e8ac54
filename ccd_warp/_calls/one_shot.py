"""The one-shot functions: the positions of a mesh at both ends of a step in, earliest times of impact out."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from typing import Any, Literal, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ccd_warp._calls.pipeline import CollisionPipeline
from ccd_warp._engine.host.candidates import Candidates
from ccd_warp._engine.host.line_search import DEFAULT_MAX_ROUNDS, DEFAULT_SAFETY
from ccd_warp._results.intersections import Intersections
from ccd_warp._results.line_search_result import LineSearchResult
from ccd_warp._results.proximities import Proximities
from ccd_warp._results.results import MeshResult
from ccd_warp._rigid.motion import RigidMotion
from ccd_warp._rigid.poses import shown_bodies
from ccd_warp._runtime.display import counted
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._scene.input.arguments import Per, check_instance
from ccd_warp._scene.input.option_types import (
    CandidateOptions,
    DisplacementOptions,
    IntersectionOptions,
    LineSearchOptions,
    MeshOptions,
    ProximityOptions,
)
from ccd_warp._scene.input.options import options_of
from ccd_warp._scene.mesh import CollisionMesh


def find_candidates(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    inflation: float = 0.0,
    *,
    motion: RigidMotion | None = None,
    **options: Unpack[CandidateOptions],
) -> Candidates:
    """Find the pairs of primitives whose swept axis-aligned boxes overlap.

    The box of a primitive encloses its vertices at both ends of the step, is enlarged by ``inflation`` on every side,
    rounded outward, and is closed: boxes that only touch overlap. Where the mesh has radii, the box of each vertex also
    grows by the largest radius of the primitives that contain it. The collision filter of the mesh excludes pairs that
    share a vertex, pairs of bodies that are all static or kinematic, pairs within a body whose self-collision is off,
    and pairs excluded by ``body_pairs``, ``exclude_pairs``, ``exclusion_rings`` or ``vertex_world``.

    Four kinds of pair suffice: vertex-face, edge-edge, codimensional point with codimensional edge, and two
    codimensional points; and vertices with the planes of half-spaces, where there are any. The sets that collide
    otherwise are faces, codimensional edges and codimensional points. All are convex.
    The distance of two convex sets A and B, in any norm, is the distance of the origin from the polytope A - B, and the
    nearest point lies on its boundary while they do not touch. For two faces, or a face and a codimensional edge, that
    boundary consists of differences (vertex) - (face) and (edge) - (edge), and where A - B is flat these cover all of
    it. Two codimensional edges form an edge-edge pair, and a codimensional point and a face form a vertex-face pair. A
    codimensional point and an edge of a face need no pair, because the edge is part of the face and no nearer. A vertex
    of an edge and a codimensional edge need none either, because the vertex is part of its own edge. What remains are
    codimensional points with codimensional edges and with each other; these pairs are searched only where the mesh has
    such primitives. Because pairs that share a vertex are excluded, a cable that folds back on itself at a joint is not
    detected by the two segments of that joint, just as two faces with a common edge meet only through their other
    vertices.

    In the plane the sets that collide are edges and codimensional points, and the boundary of A - B consists of
    differences (vertex) - (edge) alone: every vertex is tested against every edge, and codimensional points against
    each other.

    Args:
        mesh: The bodies.
        vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3], [W, V / W, 3] of W worlds of
            one size, or [V, 2] in the plane.
        vertices_t1: End positions, shape [V, 3], in which static bodies are where they start; or those of the moving
            vertices only, shape [V_moving, 3].
        inflation: Enlargement of every box on every side, a length in the unit of the mesh, finite and not negative.
        motion: How the rigid bodies turn, as in :func:`mesh_ccd`. The boxes then hold their arcs, slice by slice where
            a body turns by more than 0.2 radians, and a pair whose boxes overlap in a slice is found. Pairs of several
            slices are in lexicographic order.
        **options: Options of :class:`ccd_warp.CandidateOptions`.

    Returns:
        The pairs, in an order that depends only on the mesh, the positions and ``inflation``. On CUDA
        and with ``broad_phase="hash"`` this is the lexicographic order of the indices, which
        :meth:`ccd_warp.Candidates.sorted` gives in any case.

    Raises:
        ValueError: If the positions do not match the mesh or are not finite, a static body moves, or ``inflation`` or
            an option is out of its range.
        TypeError: If there is no such option.

    References:
        Karras 2012, "Maximizing parallelism in the construction of BVHs, octrees, and k-d trees" (boxes along a
        space-filling curve); Ericson 2005, "Real-time collision detection", section 6 (bounding volume hierarchies)
        and section 7 (grids); Eitz and Lixu 2007, "Hierarchical spatial hashing for real-time collision detection".

    Guarantee: every pair that passes the filter and whose boxes overlap is found, exactly once, and no other pair. The
    boxes of two primitives that come within ``inflation`` of each other (L∞) during the step overlap; where there are
    radii, those of two that come within ``inflation`` and both radii.
    """
    checked_options = options_of("find_candidates", CandidateOptions, options, others=["inflation", "motion"])
    with CollisionPipeline._borrowed(mesh, checked_options) as pipeline:
        return pipeline.find_candidates(vertices_t0, vertices_t1, inflation, motion=motion)


def find_intersections(
    mesh: CollisionMesh, positions: ArrayLike, **options: Unpack[IntersectionOptions]
) -> Intersections:
    """Find the pairs of primitives that touch or pass through each other at one time, exactly.

    Continuous collision detection finds surfaces that meet in a step. Where they meet at its start already, it reports
    toi 0, and where an edge is through the inside of a face, neither end near it, nothing at all. This function says
    whether a start is sound.

    All primitives are closed: what touches in a point counts. In space the pairs are, as :class:`IntersectionKind` has
    them, vertices in faces and edges that meet, in any position (surfaces that overlap in a plane have such pairs); a
    codimensional point on a codimensional edge, and two codimensional points in one place; and edges that pass through
    the inside of a face, from one side to the other. In the plane they are vertices on edges, points in one place, and
    edges that cross. The pairs of the first kinds are those that CCD has at toi 0; ``is_crossing`` of the result tells
    the others.

    Pairs that share a vertex are left out, and so are those that the collision filter of the mesh excludes, as in
    :func:`find_candidates`; ``exclude_pairs`` excludes an edge through a face by its bodies or vertices. Nothing is
    lost by the first: two faces that share vertices, and where they meet have anything else in common than these
    vertices and the edge between them, have a pair of other primitives that is found. So a mesh without intersections
    and with no pairs excluded is embedded. Of two codimensional edges with a common vertex only their ends in the plane
    are tested. One body inside another, with surfaces apart, is no intersection. Radii of the mesh play no part: what
    intersects are the surfaces and curves themselves, without their thickness.

    Args:
        mesh: The bodies.
        positions: Positions of all vertices, float, same length unit as the mesh, shape [V, 3], [W, V / W, 3] of W
            worlds of one size, or [V, 2] in the plane.
        **options: Options of :class:`ccd_warp.IntersectionOptions`.

    Returns:
        The pairs with their common points, by kind and then in lexicographic order.

    Raises:
        ValueError: If the positions do not match the mesh or are not finite, an option is out of its range, or
            ``memory_limit`` is too small; the message then says the least that suffices.
        TypeError: If there is no such option.

    References:
        Shewchuk 1997, "Adaptive precision floating-point arithmetic and fast robust geometric predicates" (the
        filter); Guigue, Devillers 2003, "Fast and robust triangle-triangle overlap test using orientation predicates".

    Guarantee: every pair that passes the filter and intersects is found, exactly once, and no other pair, for all
    finite positions. Float64 decides where a bound on its errors allows it, and integer arithmetic everything else.
    """
    checked_options = options_of("find_intersections", IntersectionOptions, options)
    with CollisionPipeline._borrowed(mesh, checked_options) as pipeline:
        return pipeline.find_intersections(positions)


def find_proximity(
    mesh: CollisionMesh,
    positions: ArrayLike,
    distance: float,
    *,
    unique: bool = False,
    **options: Unpack[ProximityOptions],
) -> Proximities:
    """Find the pairs of primitives within a Euclidean distance of each other at one time, with their closest points.

    For forces of contact and repulsion, cohesion, or the neighbours of particles. The kinds of pairs are those of
    :func:`find_candidates`, and so is the collision filter; the two points in which surfaces that are apart are closest
    belong to such a pair. One and the same proximity often shows in several pairs, as a closest point may lie on the
    rim of a face or at the end of an edge: :meth:`Proximities.unique` keeps each once, and so does ``unique=True``,
    which never gathers the others.

    Args:
        mesh: The bodies. Where they have radii, those of both primitives are added to ``distance``.
        positions: Positions of all vertices, float, same length unit as the mesh, shape [V, 3], [W, V / W, 3] of W
            worlds of one size, or [V, 2] in the plane.
        distance: Largest distance of a pair, a length in the unit of the positions, finite and at least 0.
        unique: Whether to keep each two closest features once, and count the pairs that have them.
        **options: Options of :class:`ccd_warp.ProximityOptions`.

    Returns:
        The pairs, by kind and then in lexicographic order; equal in every bit for every number of threads, memory limit
        and broad phase.

    Raises:
        ValueError: If the positions do not match the mesh or are not finite, ``distance`` or an option is out of its
            range, or ``memory_limit`` is too small; the message then says the least that suffices.
        TypeError: If there is no such option.

    References:
        Ericson 2005, "Real-time collision detection", section 5.1 (closest points).

    Guarantee: every pair that passes the filter and whose distance is at most ``distance`` (plus radii) is found,
    exactly once, and no pair that is farther apart by more than 3e-15 of its size. The distance that is reported is
    exact to within 1e-15 of that size, whatever the shape of the primitives and however far they are from the origin.
    Among subnormal numbers the unit counts besides: no pair is farther apart by more than 2⁻¹⁰⁶⁹, and the distance is
    exact to within 2⁻¹⁰⁷⁴.
    """
    checked_options = options_of("find_proximity", ProximityOptions, options, others=["distance", "unique"])
    with CollisionPipeline._borrowed(mesh, checked_options) as pipeline:
        return pipeline.find_proximity(positions, distance, unique=unique)


def displacement_bounds(
    mesh: CollisionMesh, positions: ArrayLike, search_radius: float, **options: Unpack[DisplacementOptions]
) -> NDArray[np.float64]:
    """For each vertex a length by which it may move, along any path, without a collision.

    A pair shares what is between its primitives: the bound of a vertex is half the distance from one of its primitives
    to the nearest primitive outside its filter, less ``minimum_distance`` and radii, and all of it where the other one
    is static. A kinematic body counts as one that moves: its vertices have bounds as well, within which its motion has
    to stay, or nothing is certain. What is farther away than ``search_radius`` counts as just that far, so no bound is
    above half of it; it is the whole of it where a single body moves, or one in each world, and does not collide with
    itself. One call serves several iterations of a solver, until a vertex reaches its bound.

    Args:
        mesh: The bodies.
        positions: Positions of all vertices, float, same length unit as the mesh, shape [V, 3], [W, V / W, 3] of W
            worlds of one size, or [V, 2] in the plane.
        search_radius: Distance beyond which nothing counts as near, a length, finite and above 0. A few times the
            longest displacement is enough; the time grows with the number of pairs within it.
        **options: Options of :class:`ccd_warp.DisplacementOptions`.

    Returns:
        The bounds, lengths, float64, shape [V]. They are 0 for vertices of static bodies, which do not move, and for
        those of pairs that touch, or are within ``minimum_distance``, already; inf for those that take no part.

    Raises:
        ValueError: If the positions do not match the mesh or are not finite, ``search_radius`` or an option is out of
            its range, or ``memory_limit`` is too small; the message then says the least that suffices.
        TypeError: If there is no such option.

    References:
        Chen et al. 2025, "Offset geometric contact" (displacements that are bounded per vertex).

    Guarantee: if every vertex stays closer to its position than its bound, or where that is 0 does not move, no pair
    that passes the mesh's filter comes to touch (or within ``minimum_distance`` plus radii), by whatever paths they
    move. Bounds are rounded down.
    """
    checked_options = options_of("displacement_bounds", DisplacementOptions, options, others=["search_radius"])
    with CollisionPipeline._borrowed(mesh, checked_options) as pipeline:
        return pipeline.displacement_bounds(positions, search_radius)


def mesh_ccd(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    *,
    motion: RigidMotion | None = None,
    check_start: bool = False,
    **options: Unpack[MeshOptions],
) -> MeshResult:
    """Earliest times of impact in a step: of the scene, per vertex, per body, and of every contact.

    Args:
        mesh: The bodies; see :class:`ccd_warp.CollisionMesh`.
        vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3], [W, V / W, 3] of W worlds of
            one size, or [V, 2] in the plane.
        vertices_t1: End positions, shape [V, 3], in which static bodies are where they start; or those of the moving
            vertices only, shape [V_moving, 3].
        motion: How rigid bodies turn, whose rows are in their own frames: a pose for each body in ``rigid`` of the
            mesh, and for no others.
        check_start: Whether to look for surfaces that cross at the start, too, in about as much time as the step takes:
            ``start`` of the result has the intersections, and a ``RuntimeWarning`` says of which bodies edges pass
            through faces.
        **options: Options of :class:`ccd_warp.MeshOptions`.

    Returns:
        The result, NumPy arrays. Where pairs touch at the start already, with toi 0 and the status ``INITIAL_CONTACT``,
        its ``pairs_at_start`` has their number and bodies, and its text says so. Where surfaces cross at the start, an
        edge through the inside of a face, there is no contact: ``check_start``, or :func:`find_intersections`, tells.

    Raises:
        ValueError: If an option is out of its range, the positions do not match the mesh or are not finite, a static
            body moves, or ``memory_limit`` is too small; the message then says the least that suffices.
        TypeError: If there is no such option.

    References:
        Wang et al. 2021, section 4 (narrow phase); see :func:`ccd_warp.find_candidates` for the broad phase.

    Guarantee: that of :mod:`ccd_warp`, for every pair that passes the mesh's filter (vertex-face, edge-edge and, where
    the mesh has codimensional primitives or half-spaces, point-segment, point-point and vertex-plane): no toi that
    covers the pair is late, and ``inf`` is certain.
    """
    checked_options = options_of("mesh_ccd", MeshOptions, options, others=["motion", "check_start"])
    with CollisionPipeline._borrowed(mesh, checked_options) as pipeline:
        return pipeline.mesh_ccd(vertices_t0, vertices_t1, motion=motion, check_start=check_start)


def rigid_ccd(
    mesh: CollisionMesh,
    poses_t0: ArrayLike,
    poses_t1: ArrayLike | None = None,
    *,
    path: Literal["linear", "screw"] = "linear",
    pivot: ArrayLike | None = None,
    twist: ArrayLike | None = None,
    within: ArrayLike = 0.0,
    **options: Unpack[MeshOptions],
) -> MeshResult:
    """Earliest times of impact of bodies that are all rigid, and turn: what :func:`mesh_ccd` finds with a ``motion``.

    Every body moves from one pose to the other, by the path that :class:`ccd_warp.RigidMotion` describes, and the
    vertices of the mesh stand in the frames of their bodies. None collides with itself.

    Args:
        mesh: The bodies, as built for any other call; ``rigid`` of the mesh plays no part here.
        poses_t0: Poses at t = 0, position and quaternion **x y z w**, one for each body that has vertices, static ones
            included, [B, 7], or matrices, [B, 4, 4]; of W worlds of one mesh, or of those of
            :meth:`CollisionMesh.replicate`, [W, B, 7]. :class:`ccd_warp.RigidMotion` says what else it takes, as of
            the following.
        poses_t1: Poses at t = 1; those of static bodies are the same.
        path: "linear" or "screw".
        pivot: Points about which the bodies turn, in their own frames.
        twist: In place of ``poses_t1``, motion in the whole step, linear part first.
        within: How far points of the bodies may be from these paths, a length, or one for each body.
        **options: Options of :class:`ccd_warp.MeshOptions`.

    Returns:
        The result, as of :func:`mesh_ccd`.

    Raises:
        ValueError: If a pose, a shape or an option is not as described, a static body moves, or ``memory_limit`` is too
            small.
        TypeError: If there is no such option.

    Guarantee: that of :mod:`ccd_warp`, for the trajectories of :class:`ccd_warp.RigidMotion`, on which vertices move on
    arcs: no toi is late, and ``inf`` is certain.
    """
    checked_options = options_of("rigid_ccd", MeshOptions, options, others=["path", "pivot", "twist", "within"])
    motion = RigidMotion(poses_t0, poses_t1, path=path, pivot=pivot, twist=twist, within=within)
    check_instance("mesh", mesh, CollisionMesh)
    bodies = mesh._all_rigid
    count, worlds = int(bodies.rigid.sum()), motion.num_worlds if mesh.num_worlds > 1 else 1
    if motion.num_bodies * worlds != count:
        is_of_worlds = motion.turns.ndim == 1 and mesh.num_worlds == 1 and motion.num_bodies % count == 0
        further = "; those of several worlds have an axis of worlds in front" if is_of_worlds else ""
        raise ValueError(
            f"poses_t0 is of {shown_bodies(motion.turns.shape)}; expected {counted(count, 'body', 'bodies')}, those of "
            f"the mesh but half-spaces, static ones included{further}"
        )
    with CollisionPipeline._borrowed(bodies, checked_options) as pipeline:
        return pipeline.mesh_ccd(bodies.vertices, bodies.vertices, motion=motion)


@text_completed_by(mesh_ccd)
def collision_free_step(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    *,
    motion: RigidMotion | None = None,
    check_start: bool = False,
    **options: Unpack[MeshOptions],
) -> float:
    """Largest step fraction that is certain to be free of collisions.

    Args:
        check_start: Whether to look for surfaces that cross at the start, too, as in :func:`mesh_ccd`. Where some do, a
            ``RuntimeWarning`` says so, once for a mesh and the bodies that cross; the fraction stays what it is, that
            of all that does not cross yet.
        **options: Options of :class:`ccd_warp.MeshOptions`. By default what starts within its distance may part and
            slide, and comes no closer (``start_gap_fraction``).

    Returns:
        A fraction of the step in [0, t_max], dimensionless; t_max if there is certainly no collision, 0 if bodies touch
        at the start, or approach each other from within their distance.

    Guarantee: that of :mod:`ccd_warp`: no pair that passes the mesh's filter, of any kind that :func:`mesh_ccd` checks,
    touches before the returned fraction, or comes within its distance, or, where one of its vertices was closer than
    that to something at the start, closer than it was (less 1.2e-13 of the size and motion of the pair).
    """
    checked_options = options_of("collision_free_step", MeshOptions, options, others=["motion", "check_start"])
    with CollisionPipeline._borrowed(mesh, checked_options) as pipeline:
        return pipeline.collision_free_step(vertices_t0, vertices_t1, motion=motion, check_start=check_start)


@text_completed_by(mesh_ccd)
def is_step_collision_free(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    *,
    motion: RigidMotion | None = None,
    check_start: bool = False,
    **options: Unpack[MeshOptions],
) -> bool:
    """Whether a step is certain to be free of collisions from its start to its end, both included.

    A fraction of :func:`collision_free_step` cannot say this: it is t_max where nothing touches, and also where the
    first contact is at t_max itself.

    Args:
        check_start: Whether surfaces that cross at the start count, too: a step is not free where an edge is through
            the inside of a face at its start, which no contact shows. A ``RuntimeWarning`` says of which bodies, once
            for a mesh.

    Returns:
        True if no pair touches (or comes within the minimum separation) in [0, t_max]. False if a pair touches, or
        comes so close that this cannot be excluded; with ``check_start`` also if surfaces cross at the start.

    Guarantee: True is certain, for every pair that passes the mesh's filter, of any kind that :func:`mesh_ccd` checks.
    """
    checked_options = options_of("is_step_collision_free", MeshOptions, options, others=["motion", "check_start"])
    with CollisionPipeline._borrowed(mesh, checked_options) as pipeline:
        return pipeline.is_step_collision_free(vertices_t0, vertices_t1, motion=motion, check_start=check_start)


def line_search(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    *,
    per: Per = "scene",
    safety: float = DEFAULT_SAFETY,
    max_rounds: int = DEFAULT_MAX_ROUNDS,
    motion: RigidMotion | None = None,
    check_start: bool = False,
    **options: Unpack[LineSearchOptions],
) -> LineSearchResult[RigidMotion]:
    """Shorten a step until it is certain to be free of collisions: as a whole, or per world, body or vertex.

    Each round computes the toi of every pair that still touches, shortens the displacements of the scene, worlds,
    bodies or vertices involved to ``safety`` times that toi, and the next round checks the shortened step. Shortening
    each vertex once by its own toi would not suffice: another vertex that would have passed behind a moving vertex can
    run into it once it is stopped.

    A search ends at the distance of a pair, and the next one begins there. By default what starts within its distance
    may part and slide, and comes no closer (``start_gap_fraction``). Pairs that touch at the start, with no gap, and
    pairs that press on from within their distance have toi 0. Vertices that share their fraction do not move, and the
    pairs are returned as ``touching``.

    A toi of 0 may also mean that the gap is lost in the rounding of a long motion: in float32, a gap of a millionth of
    the motion. When a toi of 0 first occurs, one round therefore checks the start positions alone. Pairs that touch
    even there are stopped. For the others, and for all vertices that share their fraction, the step is cut to a few
    times the gap, repeatedly, until the gap is resolved or 2⁻³⁰ of the displacement is left. Steps without a toi of 0
    need no additional round.

    Kinematic bodies move as they are told. What one of them hits is shortened as others are, and stopped where the body
    would hit it even if it were stationary, which another round finds out. Then the body passes through it, and the
    pairs are returned as ``struck``.

    Args:
        mesh: The bodies.
        vertices_t0: Start positions, as in :func:`mesh_ccd`.
        vertices_t1: Desired end positions.
        per: Which vertices share one fraction of their displacements. ``"scene"``: all vertices; ``"world"`` and
            ``"body"``: those of each world or body; ``"vertex"``: each vertex has its own fraction.
        safety: Fraction of its toi by which a vertex in contact may move, in (0, 1).
        max_rounds: Largest number of calls of :func:`mesh_ccd`, at least 3; with kinematic bodies there may be one
            more. Where they do not suffice, all vertices of a world move by one fraction, or not at all, and
            ``is_limited`` is set. Bodies and vertices with toi 0 are stopped at once where fewer than 6 rounds are
            left.
        motion: How the rigid bodies turn, as in :func:`mesh_ccd`. They stay rigid: the vertices of each share a
            fraction of its path, and ``motion`` of the result ends with their poses.
        check_start: Whether to look for surfaces that cross at the start, too, as in :func:`mesh_ccd`: ``start`` of the
            result has the intersections. What crosses already is not kept from moving.
        **options: Options of :class:`ccd_warp.LineSearchOptions`: all options of :func:`mesh_ccd` except ``t_max``.

    Returns:
        The end positions of the shortened step, and the fractions by which the vertices move.

    Raises:
        ValueError: If an option is out of its range, the positions do not match the mesh or are not finite, or a static
            body moves.
        TypeError: If there is no such option.

    References:
        Li et al. 2020, "Incremental potential contact", section 5 (one fraction for the scene).

    Guarantee: while every vertex moves on a straight line from ``vertices_t0`` to ``vertices`` of the result, no pair
    that passes the mesh's filter touches, or comes within its distance, or, where one of its vertices was closer than
    that to something at the start, closer than it was (less 1.2e-13 of the size and motion of the pair); except pairs
    of ``touching``, whose vertices do not move, and of ``struck``, of which the kinematic side alone does. Where
    ``struck`` is empty, no kinematic body passes through anything. Proof: the last round checked exactly these rounded
    positions, and every pair with a free vertex that moves had toi ``inf`` there, which is certain. (After that round
    at most whole worlds were moved back to their start, and with kinematic bodies one more finds what these strike.)
    """
    others = ["per", "safety", "max_rounds", "motion", "check_start"]
    checked_options = options_of("line_search", LineSearchOptions, options, others=others)
    with CollisionPipeline._borrowed(mesh, checked_options) as pipeline:
        further: dict[str, Any] = {"max_rounds": max_rounds, "motion": motion, "check_start": check_start}
        return pipeline.line_search(vertices_t0, vertices_t1, per=per, safety=safety, **further)


for _function in (
    find_candidates,
    find_intersections,
    find_proximity,
    displacement_bounds,
    mesh_ccd,
    collision_free_step,
    is_step_collision_free,
    line_search,
):
    # a pipeline has its options, so none of them is unknown to its methods
    text_completed_by(_function, without=("TypeError",))(getattr(CollisionPipeline, _function.__name__))
