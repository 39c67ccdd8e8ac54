"""Options of every query, validated once, on construction."""

import numbers
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from ccd_warp._arguments import check_choice, check_count, check_items, check_real, shown
from ccd_warp._launch import start_warp
from ccd_warp._status import PairKind
from ccd_warp._threads import default_num_threads
from ccd_warp.kernels import narrow_phase

DEFAULT_TOLERANCE = 1e-6
DEFAULT_MAX_ITERATIONS = 10_000
DEFAULT_MAX_WORK = 5_000_000
MOST_THREADS = 1024  # far beyond what brings anything: a step gets no more threads than there are cores

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
        self._keep_real("tolerance", "a finite number above 0", lambda x: x > 0)
        self._keep_real("minimum_separation", "a finite number of at least 0", lambda x: x >= 0)
        self._keep_real("start_gap_fraction", "a number between 0 and 1, or None", lambda x: 0 < x < 1)
        self._keep_real("t_max", "a number in [0, 1]", lambda x: 0 <= x <= 1)
        check_count("max_iterations", self.max_iterations, 2**31 - 1)
        check_count("max_work", self.max_work, 2**63 - 1)
        self._keep_real("length_scale", "a finite length above 0, or None", lambda x: x > 0)
        check_choice("precision", self.precision, _PRECISIONS)
        check_choice("method", self.method, _METHODS)
        if self.memory_limit is not None:
            check_count("memory_limit", self.memory_limit, 2**63 - 1)
        if self.pair_kinds is not None:
            # a tuple of our own: the caller may change his list, or has given an iterator, which can be read only once
            object.__setattr__(self, "pair_kinds", _validated_kinds(self.pair_kinds))
        if self.num_threads is not None:
            check_count("num_threads", self.num_threads, MOST_THREADS)

    def _keep_real(self, name: str, expected: str, is_valid: Callable[[float], bool]) -> None:
        """Check a number and keep it as a float; None is left where it is the default."""
        value = getattr(self, name)
        if value is not None or getattr(type(self), name) is not None:
            object.__setattr__(self, name, check_real(name, value, expected, is_valid))

    @property
    def kinds(self) -> tuple[PairKind, ...]:
        """Kinds of pairs to look at, in their order."""
        return tuple(PairKind) if self.pair_kinds is None else tuple(self.pair_kinds)  # type: ignore[arg-type]

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
        raise ValueError(f"device is {shown(device)}; expected one of {names}") from error
    if of_arrays is not None and resolved != of_arrays:
        raise ValueError(f"device is {shown(device)}; expected {of_arrays.alias!r}, where the arrays are, or None")
    return resolved


def _validated_kinds(values: Any) -> tuple[PairKind, ...]:
    """Kinds by themselves, their names or their numbers, each once and in their order, or a ValueError."""
    names = {kind.name.lower(): kind for kind in PairKind}
    expected = f"a list of {', '.join(map(repr, names))}"
    given = check_items("pair_kinds", values, expected)
    chosen = set()
    for value in given:
        is_number = isinstance(value, numbers.Integral) and not isinstance(value, (bool, np.bool_))
        chosen.add(names.get(value) if isinstance(value, str) else int(value) if is_number else None)
    if not chosen or not chosen <= set(PairKind):
        raise ValueError(f"pair_kinds is {shown(given)}; expected {expected}")
    return tuple(kind for kind in PairKind if kind in chosen)
