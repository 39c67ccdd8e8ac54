"""The one-shot calls: two frames of a mesh in, earliest times of impact out."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

from typing import Unpack

from numpy.typing import ArrayLike

from ccd_warp._engine.candidates import Candidates
from ccd_warp._engine.line_search import DEFAULT_MAX_ROUNDS, DEFAULT_SAFETY, LineSearchResult, Per
from ccd_warp._input.option_types import CandidateOptions, LineSearchOptions, MeshOptions
from ccd_warp._input.options import options_of
from ccd_warp._mesh import CollisionMesh
from ccd_warp._pipeline import CollisionPipeline
from ccd_warp._results import MeshResult


def find_candidates(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    inflation: float = 0.0,
    **options: Unpack[CandidateOptions],
) -> Candidates:
    """Find the pairs of primitives whose swept axis-aligned boxes overlap.

    The box of a primitive encloses its vertices at both ends of the step, grows by ``inflation`` on every side, rounded
    outward, and is closed: boxes that only touch overlap. Left out are pairs that share a vertex, pairs of two static
    bodies, pairs within a body whose self-collision is off, and what ``body_pairs`` and ``exclusion_rings`` of the mesh
    leave out.

    Four kinds of pair are enough: vertices with faces, edges with edges, codimensional points with codimensional edges, and loose
    points with each other. What collides are faces, codimensional edges and codimensional points: convex sets, two of which, A and B,
    are as far apart in any norm as the origin is from the polytope A - B, which is at its boundary while they do not
    touch. For two faces, or a face and a codimensional edge, that boundary consists of differences (vertex) - (face) and
    (edge) - (edge), and where A - B is flat these cover all of it. Two codimensional edges are an edge-edge pair as they stand,
    a codimensional point and a face a vertex-face pair. So a codimensional point and an edge of a face need no pair: the edge is part
    of the face and no nearer. Nor do a vertex of an edge and a codimensional edge: the vertex is part of its own edge. Loose
    points with codimensional edges, and with each other, are all that is left, and are looked for only where they exist.
    Because pairs that share a vertex are left out, a cable that folds back on itself at a joint is not noticed by the
    two segments of that joint, as two faces with a common edge meet only through their other vertices.

    Args:
        mesh: The bodies.
        vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3].
        vertices_t1: End positions, shape [V, 3], where rows of static bodies are not read; or of the moving vertices
            only, shape [V_moving, 3].
        inflation: Growth of every box on every side, a length in the unit of the mesh, finite and not negative.
        **options: Options of :class:`ccd_warp.CandidateOptions`.

    Returns:
        The pairs, in an order that depends on the mesh, the frames and ``inflation`` alone; on CUDA it is that of the
        indices, which :meth:`ccd_warp.Candidates.sorted` gives anywhere.

    Raises:
        ValueError: If the frames do not match the mesh, a value that is read is not finite, or ``inflation`` or an
            option is out of its range.
        TypeError: If there is no such option.

    References:
        Karras 2012, "Maximizing parallelism in the construction of BVHs, octrees, and k-d trees" (boxes along a
        space-filling curve); Ericson 2005, "Real-time collision detection", section 6 (bounding volume hierarchies).

    Guarantee: every pair whose boxes overlap is found, exactly once, and no other pair. The boxes of two primitives
    that come within ``inflation`` of each other (L∞) during the step overlap.
    """
    chosen = options_of("find_candidates", CandidateOptions, options, others=["inflation"])
    with CollisionPipeline.borrowed(mesh, chosen) as pipeline:
        return pipeline.find_candidates(vertices_t0, vertices_t1, inflation)


def mesh_ccd(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    **options: Unpack[MeshOptions],
) -> MeshResult:
    """Earliest times of impact of a step: of the scene, per vertex, per body, and of every contact.

    Args:
        mesh: The bodies; see :class:`ccd_warp.CollisionMesh`.
        vertices_t0: Start positions, float, same length unit as the mesh, shape [V, 3].
        vertices_t1: End positions, shape [V, 3], where rows of static bodies are not read; or of the moving vertices
            only, shape [V_moving, 3].
        **options: Options of :class:`ccd_warp.MeshOptions`.

    Returns:
        The result, NumPy arrays.

    Raises:
        ValueError: If an option is out of its range, the frames do not match the mesh, or hold non-finite values; or if
            ``memory_limit`` is too small, with the least that works.
        TypeError: If there is no such option.

    References:
        Wang et al. 2021, section 4 (narrow phase); see :func:`ccd_warp.find_candidates` for the broad phase.

    Guarantee: that of :mod:`ccd_warp`, of every pair that passes the mesh's filter (vertex-face, edge-edge, and where
    the mesh has codimensional primitives point-segment and point-point): no toi that covers the pair is late, ``inf`` is
    certain.
    """
    chosen = options_of("mesh_ccd", MeshOptions, options)
    with CollisionPipeline.borrowed(mesh, chosen) as pipeline:
        return pipeline.mesh_ccd(vertices_t0, vertices_t1)


def collision_free_step(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    **options: Unpack[MeshOptions],
) -> float:
    """Largest step fraction that is certain to be free of collisions.

    Args:
        mesh: The bodies.
        vertices_t0: Start positions, as in :func:`mesh_ccd`.
        vertices_t1: End positions, likewise.
        **options: Options of :class:`ccd_warp.MeshOptions`. With ``start_gap_fraction`` the step is positive where the
            minimum separation alone would make it 0.

    Returns:
        A fraction of the step in [0, t_max], dimensionless: t_max if there is certainly no collision, 0 if bodies touch
        at the start.

    Raises:
        ValueError: If an option is out of its range, the frames do not match the mesh, or hold non-finite values; or if
            ``memory_limit`` is too small, with the least that works.
        TypeError: If there is no such option.

    References:
        Wang et al. 2021, section 4.

    Guarantee: that of :mod:`ccd_warp`: no pair that passes the mesh's filter, of any kind that :func:`mesh_ccd` looks
    at, touches (or comes within the minimum separation) before the returned fraction.
    """
    chosen = options_of("collision_free_step", MeshOptions, options)
    with CollisionPipeline.borrowed(mesh, chosen) as pipeline:
        return pipeline.collision_free_step(vertices_t0, vertices_t1)


def line_search(
    mesh: CollisionMesh,
    vertices_t0: ArrayLike,
    vertices_t1: ArrayLike,
    *,
    per: Per = "scene",
    safety: float = DEFAULT_SAFETY,
    max_rounds: int = DEFAULT_MAX_ROUNDS,
    **options: Unpack[LineSearchOptions],
) -> LineSearchResult:
    """Shorten a step until it is certain to be free of collisions: as a whole, by bodies, or vertex by vertex.

    A round takes the toi of every pair that still touches, shortens the displacements of its scene, bodies or vertices
    to ``safety`` times it, and looks again, at the shortened step. Shortening each vertex by its own toi alone would
    not do: a vertex that is stopped leaves one that would have passed behind it to run into it.

    Pairs that touch at the start, or are within the minimum separation there, have toi 0, and what shares their
    fraction does not move; they come back as ``touching``. With ``start_gap_fraction`` those that are only close may
    move.

    A toi of 0 may also mean that the gap is lost beside so long a motion: in float32, a millionth of it. So the first
    time that there is one, a round looks at the start positions alone. What touches even there is stopped; for the
    others, and what shares their fraction, the step is cut to a few times the gap, again and again, until the gap shows
    or a 2^30th of the displacement is left. Steps without a toi of 0 take no round more for it.

    Args:
        mesh: The bodies.
        vertices_t0: Start positions, as in :func:`mesh_ccd`.
        vertices_t1: End positions wished for.
        per: ``"scene"``: all vertices move by one fraction of their displacements; ``"world"`` and ``"body"``: those of
            each by one; ``"vertex"``: each vertex by its own.
        safety: Share of its toi that what touches may move, in (0, 1).
        max_rounds: Most calls of :func:`mesh_ccd`, at least 3; where they do not do, all vertices of a world move by
            one fraction, or not at all, and ``is_limited`` says so. Bodies and vertices with toi 0 are stopped at once
            where fewer than 6 rounds are left.
        **options: Options of :class:`ccd_warp.LineSearchOptions`: those of :func:`mesh_ccd`, all but ``t_max``.

    Returns:
        The end positions that can be taken, and the fractions that led there.

    Raises:
        ValueError: If an option is out of its range, the frames do not match the mesh, or hold non-finite values.
        TypeError: If there is no such option.

    References:
        Li et al. 2020, "Incremental potential contact", section 5 (one fraction for the scene).

    Guarantee: while every vertex moves on a straight line from ``vertices_t0`` to ``vertices`` of the result, no pair
    that passes the mesh's filter touches (or comes within the minimum separation), except pairs of ``touching``, whose
    vertices do not move. Proof: the last round ran :func:`mesh_ccd` on these very positions, as they are rounded, and
    every pair with a vertex that moves had toi ``inf`` there, which is certain. (After it at most whole worlds were put
    back to their start.)
    """
    chosen = options_of("line_search", LineSearchOptions, options, others=["per", "safety", "max_rounds"])
    with CollisionPipeline.borrowed(mesh, chosen) as pipeline:
        return pipeline.line_search(vertices_t0, vertices_t1, per=per, safety=safety, max_rounds=max_rounds)
