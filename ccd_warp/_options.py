"""Options of every query, validated once, on construction."""

import math
import numbers
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from ccd_warp._launch import start_warp
from ccd_warp._status import PairKind
from ccd_warp._threads import default_num_threads
from ccd_warp.kernels import narrow_phase

DEFAULT_TOLERANCE = 1e-6
DEFAULT_MAX_ITERATIONS = 10_000
DEFAULT_MAX_WORK = 5_000_000

_PRECISIONS = {"float64": wp.float64, "float32": wp.float32}
_METHODS = {"clipping": int(narrow_phase.CLIPPING), "bisection": int(narrow_phase.BISECTION)}
# Fields of the struct that the kernels take.
_FIELDS = (
    "tolerance",
    "minimum_separation",
    "start_gap_fraction",
    "length_scale",
    "t_max",
    "t_end",
    "first_iterations",
    "max_iterations",
    "max_work",
    "method",
)
# Iterations of every pair in the first round of a step. Contacts take 2 in the mean; a box of the bisection is cheaper.
_FIRST_ITERATIONS = {"clipping": 256, "bisection": 4096}


@dataclass(frozen=True)
class Options:
    """Validated options; see any public function for their meaning."""

    tolerance: float = DEFAULT_TOLERANCE
    minimum_separation: float = 0.0
    start_gap_fraction: float | None = None
    t_max: float = 1.0
    max_iterations: int = DEFAULT_MAX_ITERATIONS
    max_work: int = DEFAULT_MAX_WORK
    length_scale: float | None = None
    precision: str = "float64"
    method: str = "clipping"
    pair_kinds: Sequence[PairKind | str] | None = None
    memory_limit: int | None = None
    device: Any = None
    num_threads: int | None = None

    def __post_init__(self) -> None:
        _check_real("tolerance", self.tolerance, "a finite number above 0", lambda x: x > 0)
        _check_real("minimum_separation", self.minimum_separation, "a finite number of at least 0", lambda x: x >= 0)
        if self.start_gap_fraction is not None:
            expected = "a number between 0 and 1, or None"
            _check_real("start_gap_fraction", self.start_gap_fraction, expected, lambda x: 0 < x < 1)
        _check_real("t_max", self.t_max, "a number in [0, 1]", lambda x: 0 <= x <= 1)
        check_count("max_iterations", self.max_iterations, 2**31 - 1)
        check_count("max_work", self.max_work, 2**63 - 1)
        if self.length_scale is not None:
            _check_real("length_scale", self.length_scale, "a finite length above 0, or None", lambda x: x > 0)
        if self.precision not in _PRECISIONS:
            raise ValueError(f"precision is {self.precision!r}; expected 'float64' or 'float32'")
        if self.method not in _METHODS:
            raise ValueError(f"method is {self.method!r}; expected 'clipping' or 'bisection'")
        if self.memory_limit is not None:
            check_count("memory_limit", self.memory_limit, 2**63 - 1)
        _ = self.kinds
        if self.num_threads is not None:
            check_count("num_threads", self.num_threads, 2**31 - 1)

    @property
    def kinds(self) -> tuple[PairKind, ...]:
        """Kinds of pairs to look at, in their order."""
        if self.pair_kinds is None:
            return tuple(PairKind)
        names = {kind.name.lower(): kind for kind in PairKind}
        values = [] if isinstance(self.pair_kinds, (str, int)) else list(self.pair_kinds)
        chosen = {names.get(value) if isinstance(value, str) else value for value in values}
        if not chosen or not chosen <= set(PairKind):
            raise ValueError(f"pair_kinds is {self.pair_kinds!r}; expected a list of {', '.join(map(repr, names))}")
        return tuple(kind for kind in PairKind if kind in chosen)

    @property
    def real(self) -> Any:
        """Warp scalar type of the iteration."""
        return _PRECISIONS[self.precision]

    def separation(self, length_scale: float) -> float:
        """The minimum separation, a length."""
        return min(self.minimum_separation * length_scale, float(np.finfo(np.float64).max))

    def rounded_up(self, t: float) -> float:
        """A time in the precision of the iteration, rounded up."""
        if self.precision == "float64":
            return float(t)
        rounded = np.float32(t)
        if float(rounded) < t:
            rounded = np.nextafter(rounded, np.float32(2))
        return float(rounded)

    @property
    def first_iterations(self) -> int:
        """Iterations of every pair in the first round of a step."""
        return min(_FIRST_ITERATIONS[self.method], int(self.max_iterations))

    def share_of_work(self, num_open: int) -> int:
        """Iterations of each pair that the first round left open; ``share_of_work`` in the kernels is the same."""
        return min(max(int(self.max_work) // max(num_open, 1), self.first_iterations), int(self.max_iterations))

    def for_kernel(
        self, length_scale: float | None, max_iterations: int | None = None, stop: wp.array | None = None
    ) -> Any:
        """The options as the struct that the kernels take.

        Args:
            length_scale: Unit of the lengths; without one each pair has its own.
            max_iterations: Limit in place of the option's.
            stop: Flag that ends the kernel.
        """
        values = (
            self.tolerance,
            self.minimum_separation,
            0.0 if self.start_gap_fraction is None else self.start_gap_fraction,
            0.0 if length_scale is None else length_scale,
            self.t_max,
            self.rounded_up(self.t_max),
            self.first_iterations,
            self.max_iterations if max_iterations is None else max_iterations,
            self.max_work,
            _METHODS[self.method],
        )
        if stop is None:
            return _packed_once(self.real, values)
        return _packed(self.real, values, stop)

    @property
    def threads(self) -> int:
        """Threads on the CPU."""
        return default_num_threads() if self.num_threads is None else int(self.num_threads)


def _packed(real: Any, values: tuple[Any, ...], stop: wp.array | None) -> Any:
    """The struct of the kernels, from the values of its fields in their order."""
    options = narrow_phase.make_narrow_phase(real).Options()
    for name, value in zip(_FIELDS, values, strict=True):
        setattr(options, name, value)
    if stop is not None:
        options.stop = stop
    return options


@lru_cache(maxsize=64)
def _packed_once(real: Any, values: tuple[Any, ...]) -> Any:
    """The same without a flag, kept: packing takes a tenth of a call with one pair."""
    return _packed(real, values, None)


def resolve_device(device: Any, of_arrays: Any = None) -> Any:
    """The Warp device to run on: the one asked for, that of the arrays, or Warp's current one."""
    start_warp()
    if device is None:
        return wp.get_device() if of_arrays is None else of_arrays
    try:
        resolved = wp.get_device(device)
    except Exception as error:
        names = ", ".join(repr(d.alias) for d in wp.get_devices())
        raise ValueError(f"device is {device!r}; expected one of {names}") from error
    if of_arrays is not None and resolved != of_arrays:
        raise ValueError(f"device is {device!r}; expected {of_arrays.alias!r}, where the arrays are, or None")
    return resolved


def _check_real(name: str, value: Any, expected: str, is_valid: Any) -> None:
    is_real = isinstance(value, numbers.Real) and not isinstance(value, (bool, np.bool_))
    if not is_real or not math.isfinite(value) or not is_valid(value):
        raise ValueError(f"{name} is {value!r}; expected {expected}")


def check_count(name: str, value: Any, largest: int) -> None:
    """Check a positive integer.

    Raises:
        ValueError: If it is none, or too large.
    """
    is_count = isinstance(value, numbers.Integral) and not isinstance(value, (bool, np.bool_))
    if not is_count or not 1 <= value <= largest:
        limit = f" up to {largest}" if is_count and value > largest else ""
        raise ValueError(f"{name} is {value!r}; expected a positive integer{limit}")
