"""The options of all functions: names, types and meaning, each defined once. The defaults are those of `Options`."""

from collections.abc import Iterable
from typing import Literal, TypedDict

import warp as wp

from ccd_warp._runtime.status import PairKind

Precision = Literal["float64", "float32"]
Method = Literal["clipping", "bisection"]
BroadPhase = Literal["tree", "hash"]
PairKindName = Literal["vertex_face", "edge_edge", "point_segment", "point_point", "vertex_plane"]


# Disjoint parts of the public definitions below: a type checker rejects a key that comes from two bases.
class _Solver(TypedDict, total=False):
    tolerance: float
    minimum_separation: float
    start_gap_fraction: float | Literal["hold"] | None
    max_iterations: int
    length_scale: float | None
    precision: Precision
    method: Method


class _Distance(TypedDict, total=False):
    minimum_distance: float


class _End(TypedDict, total=False):
    t_max: float


class _Search(TypedDict, total=False):
    broad_phase: BroadPhase
    pair_kinds: Iterable[PairKind | PairKindName] | None


class _Work(TypedDict, total=False):
    max_work: int


class _Memory(TypedDict, total=False):
    memory_limit: int | None


class _Resources(TypedDict, total=False):
    device: wp.DeviceLike
    num_threads: int | None


class MeshOptions(_Solver, _Distance, _End, _Search, _Work, _Memory, _Resources, total=False):
    """Options of :func:`mesh_ccd`, :func:`collision_free_step` and :class:`CollisionPipeline`: all options.

    This is the table of all options; :class:`PairOptions`, :class:`LineSearchOptions` and :class:`CandidateOptions`
    contain some of them, with the same meaning. To annotate a dictionary of options:
    ``options: MeshOptions = {"t_max": 0.5}``.

    Attributes:
        tolerance: Largest gap (L∞) that counts as contact where the pair cannot be proved separate cheaply, as a
            multiple of ``length_scale``, above 0. Default: ``1e-6``.
        minimum_separation: Distance (L∞) at which a pair counts as touching, as a multiple of ``length_scale``, at
            least 0. Default: ``0.0``.
        minimum_distance: Euclidean distance at which a pair counts as touching, a length in the unit of the positions,
            at least 0. Unlike ``minimum_separation`` it is the same in every direction, so turning a scene changes
            nothing, and ``length_scale`` plays no part. Only one of the two can be above 0. The radii of a mesh, which
            are distances, too, are added to it. Default: ``0.0``.
        start_gap_fraction: What a pair keeps that starts within its distance, in either norm. With ``"hold"`` the calls
            that shorten a step (line searches and :func:`collision_free_step`) let it part and slide, and come no
            closer: a pair keeps the least of its distance and of how near its vertices were to anything at the start,
            less 1.2e-13 of its size and motion. What tells collisions (:func:`mesh_ccd`,
            :func:`is_step_collision_free`, ``launch`` and the pair functions) is strict all the same: such a pair has
            toi 0. With None every call is strict. With a number in (0, 1) every call reduces the separation of a pair
            to at most this fraction of its gap at the start; gaps then shrink by it each time. What touches at the
            start, with a gap of 0, has no positive step in any case, but for a vertex over a half-space, which
            ``"hold"`` lets leave. Default: ``"hold"``.
        t_max: End of the step that is checked, in [0, 1]. Default: ``1.0``.
        max_iterations: Limit of the work on a pair; at the limit its toi is early, never late, and its status says so.
            Default: ``10000``.
        max_work: Limit of the work on a step: iterations that the pairs of a kind may take in total after the first
            round, in which each pair may take 256 (4,096 with ``method="bisection"``). Where they would take more, all
            pairs still open get an equal share, and those that reach it have the same status as at ``max_iterations``.
            The share depends only on the pairs, so results are reproducible. Default: ``5000000``.
        length_scale: Length that ``tolerance`` and ``minimum_separation`` are multiples of, above 0. None stands for
            that of the mesh, the longest side of the box around its vertices (``CollisionMesh.length_scale``), which is
            the same in every step; in the pair functions for that of the box around the motion of each pair. Scaling a
            scene, or a pair, by a power of two then changes no bit of its toi. Default: ``None``.
        precision: Precision of the iteration, ``"float64"`` or ``"float32"``. Differences are always formed in float64.
            Default: ``"float64"``.
        method: ``"clipping"``, or for comparison ``"bisection"``, the plain inclusion bisection of the literature.
            Default: ``"clipping"``.
        broad_phase: How pairs whose boxes overlap are found: with ``"tree"``, a tree of boxes, or ``"hash"``, a spatial
            hash. No result depends on it but the order of candidates. Default: ``"tree"``.
        pair_kinds: Kinds of pairs to check (:class:`PairKind` or their names, as ``["vertex_face"]``); None stands for
            all that the mesh can form. Default: ``None``.
        memory_limit: Bytes that the step may take besides its input, including its contacts. Pairs that do not fit are
            processed in batches; no result depends on it. None stands for what the boxes need, and 1 GiB for the pairs.
            Default: ``None``.
        device: Warp device, or its name, as ``"cpu"`` or ``"cuda:0"``. None stands for the device of the arrays if they
            are on one, and otherwise for Warp's current device. Default: ``None``.
        num_threads: Number of threads on the CPU, at most 1,024; None stands for one for each core. No result depends
            on it. Default: ``None``.
    """


class PairOptions(_Solver, _Distance, _End, _Resources, total=False):
    """Options of the pair functions: those of :class:`MeshOptions` that do not concern a mesh.

    They are ``tolerance``, ``minimum_separation``, ``minimum_distance``, ``start_gap_fraction``, ``t_max``,
    ``max_iterations``, ``length_scale``, ``precision``, ``method``, ``device`` and ``num_threads``.
    """


class LineSearchOptions(_Solver, _Distance, _Search, _Work, _Memory, _Resources, total=False):
    """Options of :func:`line_search`: those of :class:`MeshOptions` except ``t_max``, as it covers whole steps."""


class CandidateOptions(_Search, _Resources, total=False):
    """Options of :func:`find_candidates`: some of :class:`MeshOptions`.

    They are ``broad_phase``, ``pair_kinds``, ``device`` and ``num_threads``.
    """


class IntersectionOptions(_Memory, _Resources, total=False):
    """Options of :func:`find_intersections`: ``memory_limit``, ``device`` and ``num_threads`` of :class:`MeshOptions`.

    The pairs that are found come on top of ``memory_limit``, which bounds the boxes and the pairs that are tested at a
    time.
    """


class ProximityOptions(_Search, _Memory, _Resources, total=False):
    """Options of :func:`find_proximity`: some of :class:`MeshOptions`.

    They are ``broad_phase``, ``pair_kinds``, ``memory_limit``, ``device`` and ``num_threads``. The pairs that are found
    come on top of ``memory_limit``, which bounds the boxes and the pairs that are measured at a time.
    """


class DisplacementOptions(_Distance, _Search, _Memory, _Resources, total=False):
    """Options of :func:`displacement_bounds`: those of :class:`ProximityOptions`, and ``minimum_distance``."""
