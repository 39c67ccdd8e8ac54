"""The options of all calls: names, types and meaning, each once. Their defaults are those of `Options`."""

from collections.abc import Iterable
from typing import Literal, TypedDict

import warp as wp

from ccd_warp._status import PairKind

Precision = Literal["float64", "float32"]
Method = Literal["clipping", "bisection"]
PairKindName = Literal["vertex_face", "edge_edge", "point_segment", "point_point"]


# Disjoint parts of the public definitions below: a type checker refuses a key that comes from two bases.
class _Solver(TypedDict, total=False):
    tolerance: float
    minimum_separation: float
    start_gap_fraction: float | None
    max_iterations: int
    length_scale: float | None
    precision: Precision
    method: Method


class _End(TypedDict, total=False):
    t_max: float


class _Search(TypedDict, total=False):
    pair_kinds: Iterable[PairKind | PairKindName] | None


class _Limits(TypedDict, total=False):
    max_work: int
    memory_limit: int | None


class _Place(TypedDict, total=False):
    device: wp.DeviceLike
    num_threads: int | None


class MeshOptions(_Solver, _End, _Search, _Limits, _Place, total=False):
    """Options of :func:`mesh_ccd`, :func:`collision_free_step` and :class:`CollisionPipeline`: all that there are.

    The table of all options; :class:`PairOptions`, :class:`LineSearchOptions` and :class:`CandidateOptions` hold some
    of them, with the same meaning. To annotate a dictionary of options: ``options: MeshOptions = {"t_max": 0.5}``.

    Attributes:
        tolerance: Largest gap (L∞) that counts as contact where a pair cannot be told apart cheaply, as a multiple of
            ``length_scale``, above 0. Default: ``1e-6``.
        minimum_separation: Distance (L∞) at which a pair counts as touching, as a multiple of ``length_scale``, at
            least 0. Default: ``0.0``.
        start_gap_fraction: In (0, 1), or None. Where a pair starts closer than the minimum separation, or close to it,
            its separation is this fraction of its start gap at most: its toi is then positive, unless it touches at
            the start (``CCDStatus.INITIAL_CONTACT``), when there is no positive step. Default: ``None``.
        t_max: End of the step that is checked, in [0, 1]. Default: ``1.0``.
        max_iterations: Limit of the work on a pair; at the limit its toi is early, never late, and its status says so.
            Default: ``10000``.
        max_work: Limit of the work on a step: iterations that the pairs of a kind may take in all once each has had
            its first 256. Where they would take more, all that are still open get an equal share, and those that reach
            it are marked as at ``max_iterations``. The share depends on the pairs alone, so results stay the same.
            Default: ``5000000``.
        length_scale: Length that ``tolerance`` and ``minimum_separation`` are multiples of, above 0. None stands for
            the longest side of the box around the whole motion, in the pair functions for that of each pair around its
            own; scaling a scene, or a pair, by a power of two then changes no bit of its toi. Default: ``None``.
        precision: ``"float64"`` or ``"float32"``, of the iteration. Differences are always formed in float64.
            Default: ``"float64"``.
        method: ``"clipping"``, or ``"bisection"``: the literature's plain inclusion bisection, for comparison.
            Default: ``"clipping"``.
        pair_kinds: Kinds of pairs to look for (:class:`PairKind` or their names, as ``["vertex_face"]``); None stands
            for all that the mesh can form. Default: ``None``.
        memory_limit: Bytes that the step may take beside its input, its contacts included. Where the pairs do not fit
            they come in batches; no result depends on it. None stands for what the boxes need, and 1 GiB for the
            pairs. Default: ``None``.
        device: Warp device, or its name, as ``"cpu"`` or ``"cuda:0"``. None stands for that of the arrays where they
            are on a device, and for Warp's current one. Default: ``None``.
        num_threads: Threads on the CPU, at most 1,024; None stands for one a core. No result depends on it.
            Default: ``None``.
    """


class PairOptions(_Solver, _End, _Place, total=False):
    """Options of the pair functions: those of :class:`MeshOptions` but what concerns a mesh.

    They are ``tolerance``, ``minimum_separation``, ``start_gap_fraction``, ``t_max``, ``max_iterations``,
    ``length_scale``, ``precision``, ``method``, ``device`` and ``num_threads``.
    """


class LineSearchOptions(_Solver, _Search, _Limits, _Place, total=False):
    """Options of :func:`line_search`: those of :class:`MeshOptions` but ``t_max``, for it looks at whole steps."""


class CandidateOptions(_Search, _Place, total=False):
    """Options of :func:`find_candidates`: ``pair_kinds``, ``device`` and ``num_threads`` of :class:`MeshOptions`."""
