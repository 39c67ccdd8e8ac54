"""The options of a call, validated on construction."""

import difflib
import numbers
import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

import numpy as np
import warp as wp

from ccd_warp._runtime.lazy import lazy_property
from ccd_warp._runtime.quiet import start_warp
from ccd_warp._runtime.status import PairKind
from ccd_warp._runtime.threads import default_num_threads
from ccd_warp._scene.input.arguments import check_choice, check_count, check_items, check_real, shown
from ccd_warp._scene.input.body_options import BodyOptions
from ccd_warp._scene.input.option_types import BroadPhase, MeshOptions, Method, PairKindName, Precision
from ccd_warp.kernels.pair import query
from ccd_warp.kernels.pair.norm import Norm
from ccd_warp.kernels.template import specialised

if TYPE_CHECKING:
    from ccd_warp.kernels.pair.turns import Turns

MOST_THREADS = 1024  # far beyond any use: a step gets no more threads than there are cores

_PRECISIONS: dict[Precision, Any] = {"float64": wp.float64, "float32": wp.float32}
_METHODS: dict[Method, int] = {"clipping": int(query.CLIPPING), "bisection": int(query.BISECTION)}
_BROAD_PHASES = get_args(BroadPhase)
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
# The value of ``start_gap_fraction`` with which what starts within its distance keeps its start distance.
HOLD = "hold"
# Values of these types are immutable; others may change, or be readable only once.
_PLAIN = frozenset((float, int, str, type(None)))
# Iterations of every pair in the first round of a step. A contact takes 2 on average; a box of the bisection is
# cheaper.
_FIRST_ITERATIONS: dict[Method, int] = {"clipping": 256, "bisection": 4096}


@dataclass(frozen=True)
class Options:
    """Validated options with their defaults; :class:`MeshOptions` explains their meaning."""

    tolerance: float = 1e-6
    minimum_separation: float = 0.0
    minimum_distance: float = 0.0
    start_gap_fraction: float | Literal["hold"] | None = "hold"
    t_max: float = 1.0
    max_iterations: int = 10_000
    max_work: int = 5_000_000
    length_scale: float | None = None
    precision: Precision = "float64"
    method: Method = "clipping"
    broad_phase: BroadPhase = "tree"
    pair_kinds: Iterable[PairKind | PairKindName] | None = None
    memory_limit: int | None = None
    device: wp.DeviceLike = None
    num_threads: int | None = None

    def __post_init__(self) -> None:
        self._keep_real("tolerance", "a finite number above 0", lambda x: x > 0)
        self._keep_real("minimum_separation", "a finite number of at least 0", lambda x: x >= 0)
        self._keep_real("minimum_distance", "a finite length of at least 0", lambda x: x >= 0)
        if self.minimum_separation > 0 and self.minimum_distance > 0:
            raise ValueError(
                f"minimum_distance is {shown(self.minimum_distance)} and minimum_separation is "
                f"{shown(self.minimum_separation)}; expected one of them only, or 0 for the other"
            )
        if not (isinstance(self.start_gap_fraction, str) and self.start_gap_fraction == HOLD):
            expected = f"{HOLD!r}, a number between 0 and 1, or None"
            self._keep_real("start_gap_fraction", expected, lambda x: 0 < x < 1)
        self._keep_real("t_max", "a number in [0, 1]", lambda x: 0 <= x <= 1)
        check_count("max_iterations", self.max_iterations, 2**31 - 1)
        check_count("max_work", self.max_work, 2**63 - 1)
        self._keep_real("length_scale", "a finite length above 0, or None", lambda x: x > 0)
        check_choice("precision", self.precision, _PRECISIONS)
        check_choice("method", self.method, _METHODS)
        check_choice("broad_phase", self.broad_phase, _BROAD_PHASES)
        if self.memory_limit is not None:
            check_count("memory_limit", self.memory_limit, 2**63 - 1)
        if self.pair_kinds is not None:
            # stored as a new tuple: the caller may change a list, and an iterator can be read only once
            object.__setattr__(self, "pair_kinds", _validated_kinds(self.pair_kinds))
        if self.num_threads is not None:
            check_count("num_threads", self.num_threads, MOST_THREADS)

    def _keep_real(self, name: str, expected: str, is_valid: Callable[[float], bool]) -> None:
        """Check a number and store it as a float; None is kept where it is the default."""
        value = getattr(self, name)
        if value is not None or isinstance(getattr(type(self), name), float):
            object.__setattr__(self, name, check_real(name, value, expected, is_valid))

    @property
    def is_clipping(self) -> bool:
        """Whether pairs are solved by clips of time."""
        return self.method == "clipping"

    @property
    def kinds(self) -> tuple[PairKind, ...]:
        """Kinds of pairs to check, in their order."""
        if self.pair_kinds is None:
            return tuple(PairKind)
        return cast(tuple[PairKind, ...], self.pair_kinds)  # as `__post_init__` has stored them

    @property
    def real(self) -> Any:
        """Warp scalar type of the iteration."""
        return _PRECISIONS[self.precision]

    @property
    def keeps_start_distances(self) -> bool:
        """Whether what starts within its distance may part and slide, in the calls that shorten a step."""
        return self.start_gap_fraction == HOLD

    @property
    def start_gap_share(self) -> float:
        """The fraction of its gap at the start that a pair keeps at most; 0 where it keeps its separation."""
        return 0.0 if self.start_gap_fraction is None or self.keeps_start_distances else float(self.start_gap_fraction)

    @property
    def norm(self) -> Norm:
        """The norm of the separation, for which kernels are made (``kernels.pair.norm``)."""
        if self.minimum_distance > 0:
            return Norm.EUCLIDEAN
        return Norm.OWN_BOX if self.minimum_separation > 0 else Norm.MAXIMUM

    def separation(self, length_scale: float) -> float:
        """The minimum separation or distance, a length."""
        if self.minimum_distance > 0:
            return self.minimum_distance
        return min(self.minimum_separation * length_scale, sys.float_info.max)

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
        """Iterations of each pair that the first round left open, as in ``share_of_work`` of the kernels."""
        return min(max(int(self.max_work) // max(num_open, 1), self.first_iterations), int(self.max_iterations))

    def for_kernel(
        self,
        length_scale: float | None,
        max_iterations: int | None = None,
        stop: wp.array | None = None,
        radius: wp.array | None = None,
        start_distances: wp.array | None = None,
        turns: "Turns | None" = None,
    ) -> Any:
        """The options as the struct that the kernels take.

        Args:
            length_scale: Unit of the lengths; if None, each pair has its own.
            max_iterations: Limit in place of the option of this name.
            stop: Flag that ends the kernel.
            radius: Radius of each vertex on the device, where the pairs are those of a mesh that has radii.
            start_distances: How near each vertex was to anything at the start, on the device, where that matters.
            turns: How vertices turn in a slice of the step, as the struct of the kernels.
        """
        separation = self.separation(1.0 if length_scale is None else length_scale)
        values = (
            self.tolerance,
            separation,
            self.start_gap_share if turns is None else 0.0,
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
        packed = _packed(self.real, values, stop)
        if radius is not None:
            packed.radius = radius
        if start_distances is not None:
            packed.start_distance = start_distances
        if turns is not None:
            packed.turns = turns
        return packed

    def __getstate__(self) -> dict[str, Any]:
        """The fields, without what is kept with them."""
        return {name: value for name, value in vars(self).items() if name in self.__dataclass_fields__}

    def __hash__(self) -> int:
        return self._hash

    @lazy_property
    def _hash(self) -> int:
        """The hash, of which every step asks several times."""
        return hash(tuple([getattr(self, name) for name in self.__dataclass_fields__]))

    @lazy_property
    def of_first_round(self) -> Any:
        """The struct of :meth:`for_kernel` for the first round of the pair functions, kept with the options."""
        return self.for_kernel(self.length_scale, max_iterations=self.first_iterations)

    @property
    def threads(self) -> int:
        """Threads on the CPU."""
        return default_num_threads() if self.num_threads is None else int(self.num_threads)


def options_of(
    function: str, kind: type[Mapping[str, object]], values: Mapping[str, Any], *, others: Collection[str] = ()
) -> Options:
    """The options of a call.

    Args:
        function: Name of the public function, for the messages.
        kind: Typed dictionary of the options that it takes.
        values: Options of the call.
        others: Its other keyword arguments, which may have been misspelled.

    Raises:
        TypeError: If the function does not take one of them.
        ValueError: If one is out of its range.
    """
    names = kind.__optional_keys__  # type: ignore[attr-defined]
    if not values.keys() <= names:
        name = next(name for name in values if name not in names)
        raise TypeError(_why_not_taken(function, name, {*names, *others}))
    make = _made_once if not values or all(type(value) in _PLAIN for value in values.values()) else _made
    try:
        return make(**values)
    except ValueError as error:
        raise ValueError(f"{function}: {error}") from error.__cause__


class naming:
    """Prefix a ValueError about an option with the name of the public function."""

    def __init__(self, function: str) -> None:
        self._function = function

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: object) -> None:
        if isinstance(error, ValueError):
            raise ValueError(f"{self._function}: {error}") from error.__cause__


def _made(**values: Any) -> Options:
    """Validated options, including the device."""
    options = Options(**values)
    resolve_device(options.device)
    return options


# Cached, because validation takes a tenth of a call with one pair. The cache is typed, because 1 and True are equal
# keys.
_made_once = lru_cache(maxsize=64, typed=True)(_made)


def _why_not_taken(function: str, name: str, names: Collection[str]) -> str:
    """A message for an option that a function does not take."""
    if name in MeshOptions.__optional_keys__:
        return f"{function}() does not take the option {name!r}; mesh_ccd() does"
    of_mesh = "radius" if name == "thickness" else name
    if of_mesh in BodyOptions.__optional_keys__:
        return f"{function}() does not take the option {name!r}; a mesh does: CollisionMesh.from_arrays(…, {of_mesh}=…)"
    closest = difflib.get_close_matches(name, sorted(names), n=1)
    hint = f"did you mean {closest[0]!r}?" if closest else f"expected one of {', '.join(sorted(names))}"
    return f"{function}() got an unexpected option {shown(name)}; {hint}"


def _packed(real: type, values: tuple[Any, ...], stop: wp.array | None) -> Any:
    """The struct of the kernels, from the values of its fields in order."""
    options = specialised("pair.query", real=real).Options()
    for name, value in zip(_FIELDS, values, strict=True):
        setattr(options, name, value)
    if stop is not None:
        options.stop = stop
    return options


@lru_cache(maxsize=64)
def _packed_once(real: type, values: tuple[Any, ...]) -> Any:
    """Options without a flag as a struct, cached: packing takes a tenth of a call with one pair."""
    return _packed(real, values, None)


def resolve_device(device: wp.DeviceLike, of_arrays: wp.Device | None = None) -> wp.Device:
    """The Warp device to run on: the requested one, that of the arrays, or Warp's current one.

    Raises:
        ValueError: If there is no such device, or the arrays are on another.
    """
    start_warp()
    if device is None:
        return wp.get_device() if of_arrays is None else of_arrays
    try:
        if str(device) == "cuda" and not wp.is_cuda_available():
            raise LookupError  # Warp would print errors of a driver that it has not
        resolved = wp.get_device(device)
    except Exception as error:
        names = ", ".join(repr(d.alias) for d in wp.get_devices())
        raise ValueError(f"device is {shown(device)}; expected one of {names}") from error
    if of_arrays is not None and resolved != of_arrays:
        raise ValueError(f"device is {shown(device)}; expected {of_arrays.alias!r}, where the arrays are, or None")
    return resolved


def _validated_kinds(values: object) -> tuple[PairKind, ...]:
    """Kinds given as themselves, by name or by number, each once and in their order, or a ValueError."""
    names = {kind.name.lower(): kind for kind in PairKind}
    expected = f"a list of {', '.join(map(repr, names))}"
    items = check_items("pair_kinds", values, expected)
    kinds = set()
    for value in items:
        is_number = isinstance(value, numbers.Integral) and not isinstance(value, (bool, np.bool_))
        kinds.add(names.get(value) if isinstance(value, str) else int(value) if is_number else None)
    if not kinds or not kinds <= set(PairKind):
        raise ValueError(f"pair_kinds is {shown(items)}; expected {expected}")
    return tuple(kind for kind in PairKind if kind in kinds)
