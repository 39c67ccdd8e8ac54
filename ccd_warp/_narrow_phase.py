"""Earliest time of impact of batches of primitive pairs."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from ccd_warp._launch import launch
from ccd_warp._options import DEFAULT_MAX_ITERATIONS, DEFAULT_TOLERANCE, Options, resolve_device
from ccd_warp._status import PairKind
from ccd_warp.kernels.narrow_phase import make_narrow_phase


@dataclass(frozen=True)
class PairResult:
    """Result of a batch of pairs: NumPy arrays for NumPy input, Warp arrays on the same device for Warp input.

    Attributes:
        toi: Earliest time of impact, in [0, t_max], or inf: certainly none; float64, shape [n].
        status: How the answer was reached (:class:`ccd_warp.CCDStatus`), int32, shape [n].
        parameters: (u, v) of the closest point at toi, float64, shape [n, 2]: barycentric coordinates of f1 and f2 for
            vertex-face, positions along the first and the second edge for edge-edge. Meaningless where toi is inf.
        iterations: Sub-patches and clips that the pair took, int32, shape [n].
    """

    toi: Any
    status: Any
    parameters: Any
    iterations: Any

    @property
    def hit(self) -> Any:
        """True where toi is finite, bool, shape [n]."""
        if isinstance(self.toi, np.ndarray):
            return np.isfinite(self.toi)
        hit = wp.empty(self.toi.shape, dtype=wp.bool, device=self.toi.device)
        wp.map(wp.isfinite, self.toi, out=hit)
        return hit


def vertex_face_ccd(
    points_t0: ArrayLike,
    points_t1: ArrayLike,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    minimum_separation: float = 0.0,
    t_max: float = 1.0,
    max_iterations: int = DEFAULT_MAX_ITERATIONS,
    length_scale: float | None = None,
    precision: str = "float64",
    device: Any = None,
    num_threads: int | None = None,
) -> PairResult:
    """Earliest time of impact of vertex-face pairs whose points move on straight lines.

    Args:
        points_t0: Start positions of v, f0, f1, f2, in one length unit, shape [n, 4, 3]; or a Warp array of vec3d,
            shape [n, 4].
        points_t1: End positions, likewise.
        tolerance: Largest gap (L∞) that counts as contact where a pair cannot be told apart cheaply, as a multiple of
            ``length_scale``, above 0.
        minimum_separation: Distance (L∞) at which a pair counts as touching, as a multiple of ``length_scale``.
        t_max: End of the step that is checked, in [0, 1].
        max_iterations: Limit of the work on a pair; at the limit the toi is early, never late.
        length_scale: Length that the two multiples refer to. By default each pair has its own: the longest side of the
            box around its motion; scaling a pair by a power of two then changes no bit of its toi.
        precision: ``"float64"`` or ``"float32"``, of the iteration. Differences are always formed in float64.
        device: Warp device; by default that of the arrays, or Warp's current one.
        num_threads: Threads on the CPU; by default one a core. The result does not depend on it.

    Returns:
        toi, status, parameters and iterations of each pair.

    Raises:
        ValueError: If an option is out of its range, a shape or dtype does not match, or a coordinate is not finite.

    References:
        Wang et al. 2021, "A large-scale benchmark and an inclusion-based algorithm for continuous collision detection",
        sections 3 and 4; Snyder 1992, "Interval analysis for computer graphics". The rounding analysis stands in
        ``ccd_warp.kernels.rounding``.

    Guarantee: if the exact trajectories first touch (or come within the minimum separation) at τ ≤ t_max, the reported
    toi is ≤ τ. ``inf`` is certain. A finite toi without a collision is possible only where the L∞ gap falls below
    separation + δ + ε, with δ the tolerance and ε the rounding bound.
    """
    options = Options(
        tolerance, minimum_separation, t_max, max_iterations, length_scale, precision, device, num_threads
    )
    return _points_ccd(PairKind.VERTEX_FACE, points_t0, points_t1, options)


def edge_edge_ccd(
    points_t0: ArrayLike,
    points_t1: ArrayLike,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    minimum_separation: float = 0.0,
    t_max: float = 1.0,
    max_iterations: int = DEFAULT_MAX_ITERATIONS,
    length_scale: float | None = None,
    precision: str = "float64",
    device: Any = None,
    num_threads: int | None = None,
) -> PairResult:
    """Earliest time of impact of edge-edge pairs whose points move on straight lines.

    Args:
        points_t0: Start positions of ea0, ea1, eb0, eb1, in one length unit, shape [n, 4, 3]; or a Warp array of vec3d,
            shape [n, 4].
        points_t1: End positions, likewise.
        tolerance: See :func:`vertex_face_ccd`, as all that follow.
        minimum_separation: Distance (L∞) at which a pair counts as touching.
        t_max: End of the step that is checked.
        max_iterations: Limit of the work on a pair.
        length_scale: Length that the two multiples refer to.
        precision: ``"float64"`` or ``"float32"``.
        device: Warp device.
        num_threads: Threads on the CPU.

    Returns:
        toi, status, parameters and iterations of each pair.

    Raises:
        ValueError: If an option is out of its range, a shape or dtype does not match, or a coordinate is not finite.

    References:
        As of :func:`vertex_face_ccd`.

    Guarantee: if the exact trajectories first touch (or come within the minimum separation) at τ ≤ t_max, the reported
    toi is ≤ τ. ``inf`` is certain. A finite toi without a collision is possible only where the L∞ gap falls below
    separation + δ + ε, with δ the tolerance and ε the rounding bound.
    """
    options = Options(
        tolerance, minimum_separation, t_max, max_iterations, length_scale, precision, device, num_threads
    )
    return _points_ccd(PairKind.EDGE_EDGE, points_t0, points_t1, options)


@dataclass(frozen=True)
class PairArrays:
    """Outputs of a narrow-phase kernel on the device."""

    toi: wp.array
    status: wp.array
    parameters: wp.array
    iterations: wp.array

    @classmethod
    def empty(cls, count: int, device: Any) -> "PairArrays":
        return cls(
            wp.empty(count, dtype=wp.float64, device=device),
            wp.empty(count, dtype=wp.int32, device=device),
            wp.empty(count, dtype=wp.vec2d, device=device),
            wp.empty(count, dtype=wp.int32, device=device),
        )

    def as_list(self) -> list[wp.array]:
        return [self.toi, self.status, self.parameters, self.iterations]


def option_inputs(options: Options, length_scale: float | None) -> list:
    """Options in the order of the kernels' parameters; 0 stands for a pair's own length scale."""
    return [
        options.tolerance,
        options.minimum_separation,
        0.0 if length_scale is None else length_scale,
        options.t_max,
        options.t_end,
        options.max_iterations,
    ]


def _points_ccd(kind: PairKind, points_t0: Any, points_t1: Any, options: Options) -> PairResult:
    from_warp = isinstance(points_t0, wp.array)
    if isinstance(points_t1, wp.array) != from_warp:
        raise ValueError(
            f"points_t1 is a {type(points_t1).__name__}; expected a {type(points_t0).__name__} like points_t0"
        )
    if from_warp:
        x_t0 = _as_points(points_t0, "points_t0")
        x_t1 = _as_points(points_t1, "points_t1")
        device = resolve_device(options.device, points_t0.device)
        if points_t1.device != device:
            raise ValueError(f"points_t1 is on {points_t1.device.alias}; expected {device.alias} like points_t0")
        if x_t1.shape != x_t0.shape:
            raise ValueError(f"points_t1 has shape {points_t1.shape}; expected {points_t0.shape} like points_t0")
    else:
        device = resolve_device(options.device)
        a = _validated_points(points_t0, "points_t0")
        b = _validated_points(points_t1, "points_t1")
        if b.shape != a.shape:
            raise ValueError(f"points_t1 has shape {b.shape}; expected {a.shape} like points_t0")
        x_t0 = wp.array(a, dtype=wp.vec3d, shape=(len(a), 4), device=device, copy=False)
        x_t1 = wp.array(b, dtype=wp.vec3d, shape=(len(b), 4), device=device, copy=False)

    count = x_t0.shape[0]
    out = PairArrays.empty(count, device)
    launch(
        make_narrow_phase(options.real).points_toi,
        count,
        inputs=[int(kind), x_t0, x_t1, *option_inputs(options, options.length_scale)],
        outputs=out.as_list(),
        device=device,
        num_threads=options.threads,
    )
    if from_warp:
        return PairResult(out.toi, out.status, out.parameters, out.iterations)
    return PairResult(out.toi.numpy(), out.status.numpy(), out.parameters.numpy(), out.iterations.numpy())


def _validated_points(points: Any, name: str) -> np.ndarray:
    try:
        array = np.asarray(points)
    except ValueError as error:  # ragged nested lists
        raise ValueError(f"{name} is not an array; expected shape (n, 4, 3)") from error
    if array.ndim != 3 or array.shape[1:] != (4, 3):
        raise ValueError(f"{name} has shape {array.shape}; expected (n, 4, 3)")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} has dtype {array.dtype}; expected real numbers")
    array = np.ascontiguousarray(array, dtype=np.float64)
    finite = np.isfinite(array)
    if not finite.all():
        pair, point, axis = np.argwhere(~finite)[0]
        raise ValueError(f"{name} holds {array[pair, point, axis]} in pair {pair}; expected finite values")
    return array


def _as_points(points: wp.array, name: str) -> wp.array:
    """A Warp array as vec3d of shape [n, 4], without a copy."""
    if points.dtype == wp.vec3d and points.ndim == 2 and points.shape[1] == 4:
        return points
    if points.dtype == wp.float64 and points.ndim == 3 and points.shape[1:] == (4, 3) and points.is_contiguous:
        return wp.array(ptr=points.ptr, dtype=wp.vec3d, shape=(points.shape[0], 4), device=points.device, copy=False)
    raise ValueError(
        f"{name} has dtype {points.dtype.__name__} and shape {points.shape}; "
        "expected vec3d and (n, 4), or contiguous float64 and (n, 4, 3)"
    )
