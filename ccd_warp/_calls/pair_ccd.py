"""Earliest time of impact of batches of primitive pairs."""

from __future__ import annotations  # ArrayLike, written out, would fill a screen of help()

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar, Unpack, overload

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ccd_warp._calls.small_batch import (
    CAPACITY,
    MANY_SOLVERS,
    OUTPUTS,
    borrowed_batch,
    give_back,
    table_inputs,
    table_outputs,
)
from ccd_warp._results.placed import Placed
from ccd_warp._results.touch import Touch
from ccd_warp._runtime.display import counted
from ccd_warp._runtime.lanes import narrow_phase_on, queued_kernels
from ccd_warp._runtime.launch import Execution, load
from ccd_warp._runtime.pair_queue import launch_queued, new_queue
from ccd_warp._runtime.status import CCDStatus, PairKind
from ccd_warp._runtime.tape import wants_gradient
from ccd_warp._runtime.texts import text_completed_by
from ccd_warp._runtime.threads import StopFlag
from ccd_warp._scene.input.arrays import (
    SupportsDLPack,
    are_few_and_finite,
    as_array,
    as_float64,
    check_both_finite,
    is_device_array,
)
from ccd_warp._scene.input.interop import DeviceArray, as_warp
from ccd_warp._scene.input.option_types import PairOptions
from ccd_warp._scene.input.options import Options, naming, options_of, resolve_device
from ccd_warp.kernels.narrow_phase.sinks import TABLE
from ccd_warp.kernels.step.contacts import lift, mark_finite
from ccd_warp.kernels.step.minima import NUM_COUNTS
from ccd_warp.kernels.step.pair_list import PairList

if TYPE_CHECKING:
    from ccd_warp._results.toi_gradient import ToiGradient

# The arrays of a result: those of NumPy, or of Warp.
_ArrayT = TypeVar("_ArrayT", NDArray[Any], wp.array)


@dataclass(frozen=True)
class PairResult(Placed, Generic[_ArrayT]):
    """Result of a batch of pairs: NumPy arrays for NumPy input.

    For arrays of Warp, or of a library that supports DLPack (PyTorch, JAX, CuPy), the result holds Warp arrays on the
    same device. The result can be passed on without a copy, as in
    ``torch.from_dlpack(result.toi)``. A call with such arrays can be captured in a graph, which writes to the arrays of
    the result: keep the result as long as the graph.

    Attributes:
        toi: Earliest time of impact in [0, t_max], inf if there is certainly none; float64, shape [n].
        status: How the result was obtained (:class:`ccd_warp.CCDStatus`), int32, shape [n].
        parameters: (u, v) of the closest point at toi (with a minimum separation, closest in the Euclidean norm),
            float64, shape [n, 2]: barycentric coordinates of f1 and f2 for vertex-face, positions along the first and
            the second edge for edge-edge, (u, 0) with the position u along the segment for point-segment. 0 where toi
            is inf.
        gap: Upper bound of the gap (L∞) beyond the minimum separation at toi, in the length unit of the points,
            float64, shape [n]; 0 where toi is inf. With a minimum distance the gap beyond it, Euclidean.
        width: Width in time of the reported box: the gap is attained somewhere in [toi, toi + width]. With the default
            method it is 0, except up to t_max where a limit was reached; float64, shape [n].
        iterations: Iterations that the pair took (clips and sub-patches, or boxes of the bisection), int32, shape [n].
    """

    toi: _ArrayT
    status: _ArrayT
    parameters: _ArrayT
    gap: _ArrayT
    width: _ArrayT
    iterations: _ArrayT

    def __post_init__(self) -> None:
        """Leave the slot empty until `_of` fills it: of few pairs one more assignment is 1 % of the call."""

    @property
    def hit(self) -> _ArrayT:
        """True where toi is finite, bool, shape [n]."""
        if isinstance(self.toi, np.ndarray):
            return np.isfinite(self.toi)
        device = self.toi.device
        assert device is not None
        hit: wp.array = wp.empty(self.toi.shape, dtype=wp.bool, device=device)
        load(mark_finite, device)
        wp.launch(mark_finite, len(hit), inputs=[self.toi], outputs=[hit], device=device, record_tape=False)
        return hit

    def toi_gradient(self, points_t0: ArrayLike, points_t1: ArrayLike) -> ToiGradient:
        """How each toi changes with the points of its pair at both ends of the step.

        Nothing of it is computed before. A separation that is a multiple of the size of each pair is a fixed length in
        it.

        Args:
            points_t0: Start positions, those of the call, of which the result holds no copy.
            points_t1: End positions, those of the call.

        Raises:
            ValueError: If the positions are not such as the call takes, or not of as many pairs, if the result is of
                arrays on a device or was made of arrays alone, or with a number as ``start_gap_fraction``.
        """
        from ccd_warp._gradients.toi_slopes import of_pairs  # its kernels are loaded by those who ask for gradients

        call = getattr(self, "_place", None)
        if call is None or not isinstance(self.toi, np.ndarray):
            raise ValueError("a PairResult has gradients of NumPy arrays that a pair function has returned")
        kind, options = call
        ends = [_validated_points(kind, x, f"points_t{k}") for k, x in enumerate((points_t0, points_t1))]
        for k, end in enumerate(ends):
            if (len(end), end.shape) != (len(self.toi), ends[0].shape):
                raise ValueError(
                    f"points_t{k} has shape {end.shape}; expected those of the call, {len(self.toi)} pairs"
                )
        check_both_finite(ends[0], ends[1], ("points_t0", "points_t1"), row_name="pair")
        query = _touch(options).query(is_planar=ends[0].shape[2] == 2)
        return of_pairs(query, kind, (ends[0], ends[1]), self.toi, self.status)

    def __getstate__(self) -> dict[str, Any]:
        call = getattr(self, "_place", None)
        place = call and (call[0], replace(call[1], device=None))  # a device stays where it is
        return {**vars(self), "_place": place}

    def __repr__(self) -> str:
        pairs = counted(len(self.toi), "pair", "pairs")
        if not isinstance(self.toi, np.ndarray):
            return f"PairResult({pairs}, arrays on {self.toi.device})"
        toi = float(self.toi.min(initial=np.inf))
        hits = f"{np.count_nonzero(self.hit):,} touching, earliest toi={toi!r}" if np.isfinite(toi) else "none touching"
        return f"PairResult({pairs}, {hits})"


# What a pair function takes: what makes an array of NumPy, and what is one on a device.
_Host = NDArray[Any] | Sequence[Any]
_Device = wp.array | SupportsDLPack
Points = ArrayLike | DeviceArray


class _PairFunction(Protocol):
    """A pair function for a type checker: NumPy arrays or lists give NumPy arrays, other arrays give Warp arrays."""

    @overload  # type: ignore[overload-overlap]  # a NumPy array, too, has DLPack
    def __call__(self, points_t0: _Host, points_t1: _Host, **options: Unpack[PairOptions]) -> PairResult[NDArray]: ...

    @overload
    def __call__(
        self, points_t0: _Device, points_t1: _Device, **options: Unpack[PairOptions]
    ) -> PairResult[wp.array]: ...


def _of_either_array(function: Callable[..., PairResult]) -> _PairFunction:
    return function


@_of_either_array
def vertex_face_ccd(points_t0: Points, points_t1: Points, **options: Unpack[PairOptions]) -> PairResult:
    """Earliest time of impact of vertex-face pairs whose points move on straight lines.

    Args:
        points_t0: Start positions of v, f0, f1, f2, in one length unit, shape [n, 4, 3]; or a Warp array of vec3d,
            shape [n, 4]. Arrays of Warp or with DLPack must be float64 and contiguous, and are
            read in place, but for few pairs on the CPU.
        points_t1: End positions, of the same type and shape.
        **options: Options of :class:`ccd_warp.PairOptions`.

    Returns:
        toi, status, parameters, gap, width and iterations of each pair.

    Raises:
        ValueError: If an option is out of its range, a shape or dtype does not match, or a coordinate is not finite.
        TypeError: If there is no such option.

    References:
        Wang et al. 2021, "A large-scale benchmark and an inclusion-based algorithm for continuous collision detection",
        sections 3 and 4; Snyder 1992, "Interval analysis for computer graphics". The rounding analysis is in
        ``ccd_warp.kernels.pair.rounding``.

    Guarantee: that of :mod:`ccd_warp`: no toi is late, and ``inf`` is certain.
    """
    return _points_ccd(PairKind.VERTEX_FACE, points_t0, points_t1, options)


@_of_either_array
@text_completed_by(vertex_face_ccd)
def edge_edge_ccd(points_t0: Points, points_t1: Points, **options: Unpack[PairOptions]) -> PairResult:
    """Earliest time of impact of edge-edge pairs whose points move on straight lines.

    Args:
        points_t0: Start positions of ea0, ea1, eb0, eb1, in one length unit, shape [n, 4, 3]; or a Warp array of vec3d,
            shape [n, 4].
    """
    return _points_ccd(PairKind.EDGE_EDGE, points_t0, points_t1, options)


@_of_either_array
@text_completed_by(vertex_face_ccd)
def point_segment_ccd(points_t0: Points, points_t1: Points, **options: Unpack[PairOptions]) -> PairResult:
    """Earliest time of impact of points and segments that move on straight lines, in 2D or 3D.

    In 3D a point meets a segment only by coincidence; with a minimum separation the pair is what cables and particles
    need.

    Args:
        points_t0: Start positions of p, a, b, in one length unit, shape [n, 3, 2] or [n, 3, 3]; or a Warp array of
            vec2d or vec3d, shape [n, 3].
    """
    return _points_ccd(PairKind.POINT_SEGMENT, points_t0, points_t1, options)


@_of_either_array
@text_completed_by(vertex_face_ccd)
def point_point_ccd(points_t0: Points, points_t1: Points, **options: Unpack[PairOptions]) -> PairResult:
    """Earliest time of impact of pairs of points that move on straight lines, in 2D or 3D.

    Two points meet only by coincidence; with a minimum separation the pair is what particles need.

    Args:
        points_t0: Start positions of p, q, in one length unit, shape [n, 2, 2] or [n, 2, 3]; or a Warp array of vec2d
            or vec3d, shape [n, 2].
    """
    return _points_ccd(PairKind.POINT_POINT, points_t0, points_t1, options)


_STATUS = 1  # position of the status among the outputs
_LIMIT, _INVALID = int(CCDStatus.ITERATION_LIMIT), int(CCDStatus.INVALID)
# A thread with more pairs than this may take long: some 0.4 s if all of them reach the limit of the first round.
_LONG_PART = 1 << 11
_WORTH_A_THREAD = 1000
# Points of a pair, and the dimensions in which a kind is defined.
_POINTS = {
    PairKind.VERTEX_FACE: (4, (3,)),
    PairKind.EDGE_EDGE: (4, (3,)),
    PairKind.POINT_SEGMENT: (3, (2, 3)),
    PairKind.POINT_POINT: (2, (2, 3)),
}


def _points_ccd(kind: PairKind, points_t0: Points, points_t1: Points, keywords: PairOptions) -> PairResult:
    function = f"{kind.name.lower()}_ccd"
    options = options_of(function, PairOptions, keywords)
    on_device = is_device_array(points_t0)
    if is_device_array(points_t1) != on_device:
        raise ValueError(
            f"points_t1 is a {type(points_t1).__name__}; expected a {type(points_t0).__name__} like points_t0"
        )
    if on_device:
        return _device_arrays_ccd(function, kind, points_t0, points_t1, options)
    device = resolve_device(options.device)
    if device.is_capturing:
        raise RuntimeError(
            "a graph is being captured, and the results of NumPy arrays would be read before it is replayed; "
            "pass Warp arrays, and keep the result as long as the graph"
        )
    a = _validated_points(kind, points_t0, "points_t0")
    b = _validated_points(kind, points_t1, "points_t1")
    if b.shape != a.shape:
        raise ValueError(f"points_t1 has shape {b.shape}; expected {a.shape} like points_t0")
    is_finite = are_few_and_finite(a, b)  # of many pairs the solver finds out
    a, b = _in_3d(a), _in_3d(b)
    if device.is_cpu and 0 < len(a) <= CAPACITY:
        results = _solve_few(kind, a, b, options, device)
    else:
        arrays: list[wp.array] = [
            wp.array(x, dtype=wp.vec3d, shape=x.shape[:2], device=device, copy=False) for x in (a, b)
        ]
        results = [array.numpy() for array in vars(_solve(kind, arrays[0], arrays[1], options, device)).values()]
    if not is_finite and np.count_nonzero(results[_STATUS] == _INVALID):
        check_both_finite(a, b, ("points_t0", "points_t1"), row_name="pair")
    return PairResult(*results)._of((kind, options))


def _device_arrays_ccd(function: str, kind: PairKind, points_t0: Any, points_t1: Any, options: Options) -> PairResult:
    """The result of pairs in arrays of Warp, or of a library that supports DLPack."""
    points_t0, points_t1 = as_warp(points_t0, "points_t0"), as_warp(points_t1, "points_t1")
    with naming(function):
        device = resolve_device(options.device, points_t0.device)
    a, b = _as_points(kind, points_t0, "points_t0"), _as_points(kind, points_t1, "points_t1")
    if points_t1.device != device:
        raise ValueError(f"points_t1 is on {points_t1.device.alias}; expected {device.alias} like points_t0")
    if points_t1.shape != points_t0.shape:
        raise ValueError(f"points_t1 has shape {points_t1.shape}; expected {points_t0.shape} like points_t0")
    if device.is_cpu and not device.is_capturing and 0 < a.shape[0] <= CAPACITY:
        results = _solve_few(kind, np.asarray(a), np.asarray(b), options, device)
        out = PairResult(*map(_shared, results, OUTPUTS.values()))
    else:
        out = _solve(kind, a, b, options, device)
    if wants_gradient(points_t0, points_t1):
        from ccd_warp._gradients.pair_tape import record_pairs  # its kernels are loaded where they are needed

        record_pairs(
            Execution(device, options.threads),
            _touch(options),
            kind,
            [points_t0, points_t1],
            [a, b],
            out.toi,
            out.status,
        )
    return out


def _touch(options: Options) -> Touch:
    """What counts as touching."""
    return Touch.of(options, options.length_scale, is_euclidean=options.norm.is_ball)


def _solve_few(
    kind: PairKind, points_t0: np.ndarray, points_t1: np.ndarray, options: Options, device: wp.Device
) -> list[np.ndarray]:
    """Solve so few pairs on the CPU that packing the launch would take a good part of the time."""
    count = len(points_t0)
    parts = 1 if count < 2 * _WORTH_A_THREAD else min(options.threads, count // _WORTH_A_THREAD)
    is_long = count > _LONG_PART * parts
    stop = StopFlag(device) if is_long else None
    packed = (
        options.of_first_round
        if stop is None
        else options.for_kernel(options.length_scale, max_iterations=options.first_iterations, stop=stop.array)
    )
    key = (kind, options.real, options.norm)
    batch = borrowed_batch(key, device, points_t0.shape[1], packed, count)
    results = batch.solve(points_t0, points_t1, packed, parts, stop)
    give_back(batch)
    is_open = _open_pairs(results[_STATUS], options)
    if is_open is not None:
        _solve_open(kind, points_t0, points_t1, results, is_open, options, device)
    return results


def _solve(kind: PairKind, points_t0: wp.array, points_t1: wp.array, options: Options, device: wp.Device) -> PairResult:
    """Launch the solver; on the CPU in two rounds, the second for the pairs that the first leaves open."""
    is_one_round = device.is_cuda or device.is_capturing  # the host or the graph does not know which pairs are open
    first = int(options.max_iterations) if is_one_round else options.first_iterations
    out = _launch(kind, points_t0, points_t1, options, first, device)
    is_open = None if is_one_round else _open_pairs(out.status.numpy(), options)
    if is_open is not None:
        results = [array.numpy() for array in vars(out).values()]
        _solve_open(kind, points_t0.numpy(), points_t1.numpy(), results, is_open, options, device)
    return out


def _open_pairs(status: np.ndarray, options: Options) -> np.ndarray | None:
    """Which pairs the first round left open, or None where there are none."""
    if options.first_iterations == options.max_iterations:
        return None
    is_open = status == _LIMIT
    return is_open if np.count_nonzero(is_open) else None


def _solve_open(
    kind: PairKind,
    points_t0: np.ndarray,
    points_t1: np.ndarray,
    results: list[np.ndarray],
    is_open: np.ndarray,
    options: Options,
    device: wp.Device,
) -> None:
    """The second round: solve the pairs that the first left open, and overwrite their results."""
    open_t0: wp.array = wp.array(points_t0[is_open], dtype=wp.vec3d, device=device)
    open_t1: wp.array = wp.array(points_t1[is_open], dtype=wp.vec3d, device=device)
    solved = _launch(kind, open_t0, open_t1, options, int(options.max_iterations), device)
    for array, new in zip(results, vars(solved).values(), strict=True):
        array[is_open] = new.numpy()


def _launch(
    kind: PairKind,
    points_t0: wp.array,
    points_t1: wp.array,
    options: Options,
    max_iterations: int,
    device: wp.Device,
) -> PairResult:
    """Launch the solver, and return the arrays to which it writes."""
    count = points_t0.shape[0]
    out = PairResult(**{name: wp.empty(count, dtype=dtype, device=device) for name, dtype in OUTPUTS.items()})
    is_first = max_iterations == options.first_iterations
    is_long = not is_first or count > _LONG_PART * options.threads
    stop = StopFlag(device) if is_long and not device.is_capturing else None
    packed = options.for_kernel(options.length_scale, max_iterations, stop.array if stop else None)
    execution = Execution(device, options.threads, stop)
    outputs = table_outputs((points_t0, points_t1), vars(out))
    if execution.is_cuda:
        counts: wp.array = wp.zeros((int(kind) + 1, NUM_COUNTS), dtype=wp.int64, device=device)
        queue = new_queue(count, device, keeps_contacts=False)
        inputs = [*table_inputs(kind, packed, count, counts), PairList(), queue]
        kernels = queued_kernels(options.real, options.norm, TABLE, is_clipping=options.is_clipping)
        launch_queued(execution, kernels, count, inputs, outputs)
        return out
    narrow_phase = narrow_phase_on(device, options.real, options.norm)
    kernel, chunk = narrow_phase.solve_pairs, narrow_phase.chunk_of_table
    execution.launch(
        kernel,
        -(-count // chunk),
        inputs=[MANY_SOLVERS, chunk, TABLE, *table_inputs(kind, packed, count)],
        outputs=outputs,
        grain=max(1, _WORTH_A_THREAD // chunk) if is_first else 1,
        is_long=lambda: is_long,
    )
    return out


def _shared(array: np.ndarray, dtype: type) -> wp.array:
    """A Warp array on the CPU in the memory of a NumPy array, in a fifth of the time of the constructor."""
    shared: Any = object.__new__(wp.array)
    shared.__dict__.update(_like(dtype, len(array)))
    shared.ptr = ctypes.addressof(ctypes.c_char.from_buffer(array.data))
    shared._ref = array  # keeps the memory alive
    return shared  # type: ignore[no-any-return]


@lru_cache(maxsize=32)
def _like(dtype: type, count: int) -> dict[str, Any]:
    """What a Warp array on the CPU says of itself, but for its memory."""
    return vars(wp.array(ptr=1, dtype=dtype, shape=(count,), device="cpu", copy=False))


def _in_3d(points: np.ndarray) -> np.ndarray:
    """Points in 2D with z = 0 appended; points in 3D unchanged."""
    if points.shape[2] == 3:
        return points
    return np.concatenate([points, np.zeros((*points.shape[:2], 1))], axis=2)


def _expected_shapes(kind: PairKind) -> str:
    points, dimensions = _POINTS[kind]
    return " or ".join(f"(n, {points}, {dimension})" for dimension in dimensions)


def _validated_points(kind: PairKind, points: Any, name: str) -> np.ndarray:
    """Pairs of a kind as a C-ordered float64 array, whose values may still not be finite."""
    count, dimensions = _POINTS[kind]
    array = points if type(points) is np.ndarray else as_array(points, name, f"shape {_expected_shapes(kind)}")
    if array.ndim != 3 or array.shape[1] != count or array.shape[2] not in dimensions:
        raise ValueError(f"{name} has shape {array.shape}; expected {_expected_shapes(kind)}")
    return as_float64(array, name, row_name="pair")


def _as_points(kind: PairKind, points: wp.array, name: str) -> wp.array:
    """A Warp array as vec3d of shape [n, points], without a copy unless its points are two-dimensional."""
    count, dimensions = _POINTS[kind]
    if points.ndim == 2 and points.shape[1] == count:
        if points.dtype == wp.vec3d:
            return points
        if points.dtype == wp.vec2d and 2 in dimensions:
            device = points.device
            assert device is not None
            lifted = wp.empty(points.shape, dtype=wp.vec3d, device=device)
            load(lift, device)
            wp.launch(lift, dim=points.shape, inputs=[points], outputs=[lifted], device=device, record_tape=False)
            return lifted
    if points.dtype == wp.float64 and points.ndim == 3 and points.shape[1:] == (count, 3) and points.is_contiguous:
        return wp.array(ptr=points.ptr, dtype=wp.vec3d, shape=points.shape[:2], device=points.device, copy=False)
    vectors = " or ".join(f"vec{dimension}d" for dimension in dimensions)
    raise ValueError(
        f"{name} has dtype {points.dtype.__name__} and shape {points.shape}; "
        f"expected {vectors} and (n, {count}), or contiguous float64 and (n, {count}, 3)"
    )
