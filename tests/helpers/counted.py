"""Numbers that count their roundings, and the kernels' own files executed on them, or on arrays of NumPy (`House`).

A counted number has, at each of many drawn inputs, its value in exact arithmetic, by how many unit roundoffs u the code
means to differ from that (as in a product by 1 + 8u), and how many u rounding may have taken on the way: a running
error analysis to the first order. The inputs (`drawn`) are drawn so that each term of a formula outweighs the others
in some of them, as the terms of a bound are held one by one. A vector is a number with three rows of values.
"""

import builtins
import functools
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
from ccd_warp.kernels import parameters, template

_compared: list[tuple] = []  # the numbers that were compared


class Axes:
    """The components of a vector by name."""

    x, y, z = (property(lambda s, k=k: s[k]) for k in range(3))


class Rows(Axes, np.ndarray):
    """An array that may be a vector: three rows."""


@dataclass(eq=False)
class Number(Axes):
    """A number, or a vector, at all inputs; all but the value in u."""

    value: Any  # in exact arithmetic
    shift: Any = 0.0  # what it is meant to be above its value
    lost: Any = 0.0  # what rounding may have taken
    unit: float = 0.0  # unit roundoff of its type; 0 for a constant, which takes the type of what it meets
    __array_ufunc__ = None  # arrays leave products with numbers to these

    def each(self, f: Callable, *others: "Number") -> "Number":
        """A number whose fields are a function of those of numbers."""
        parts = [np.broadcast_arrays(x.value, x.shift, x.lost) for x in (self, *others)]
        return Number(*map(f, *parts), max(x.unit for x in (self, *others)))

    def __getitem__(self, k: int) -> "Number":
        return self.each(lambda x: x[k])

    def before_last(self) -> Any:
        """What was lost before the last operation, which was rounded."""
        return self.lost - self.unit * np.abs(self.value)

    def is_zero(self) -> bool:
        return self.unit == 0 and not np.any(self.value) and not np.any(self.shift)

    def is_power(self) -> bool:
        """Whether it is a power of two."""
        return not np.any(self.shift) and np.all(np.frexp(np.abs(self.value))[0] == 0.5)

    def result(self, value: Any, slope: Any, is_exact: bool, b: Any = 0.0, slope_b: Any = 0.0) -> "Number":
        """What an operation gives whose derivatives by this and by another number are known."""
        b = numeral(b)
        shift, lost = self.shift * slope + b.shift * slope_b, self.lost * np.abs(slope) + b.lost * np.abs(slope_b)
        unit = max(self.unit, b.unit)
        return Number(value, shift, lost if is_exact else lost + unit * np.abs(value), unit)

    def __add__(self, other: Any) -> "Number":
        b = numeral(other)
        return self.result(self.value + b.value, 1, self is b or self.is_zero() or b.is_zero(), b, 1)

    def __mul__(self, other: Any) -> "Number":
        b = numeral(other)
        return self.result(self.value * b.value, b.value, self.is_power() or b.is_power(), b, self.value)

    def __truediv__(self, other: Any) -> "Number":
        b = numeral(other)
        with np.errstate(all="ignore"):
            value = self.value / b.value
            return self.result(value, 1 / b.value, b.is_power(), b, -value / b.value)

    def __pow__(self, n: float) -> "Number":
        return self.result(np.power(self.value, n), n * np.power(self.value, n - 1.0), False)

    def __neg__(self) -> "Number":
        return self.result(-self.value, -1, True)

    def __abs__(self) -> "Number":
        return choose(np.asarray(self.value) < 0, -self, self)

    __radd__, __rmul__, __sub__ = __add__, __mul__, lambda a, b: a + -numeral(b)
    __rsub__, __rtruediv__ = (lambda a, b: numeral(b) - a), (lambda a, b: numeral(b) / a)
    __lt__, __gt__ = (lambda a, b: compare(operator.lt, a, b)), (lambda a, b: compare(operator.gt, a, b))
    __le__, __ge__ = (lambda a, b: compare(operator.le, a, b)), (lambda a, b: compare(operator.ge, a, b))


def numeral(x: Any) -> Number:
    return x if isinstance(x, Number) else Number(float(x))


def compare(relation: Callable, a: Any, b: Any) -> Any:
    """An outcome for each input, or one for all of them."""
    a, b = numeral(a), numeral(b)
    _compared.append((a, b))
    outcome = np.asarray(relation(a.value, b.value))
    return outcome.flat[0] if outcome.all() == outcome.any() else outcome


def comparisons(function: Callable, *args: Any) -> tuple[Any, list[tuple]]:
    """What a function gives, and the numbers that it compared."""
    _compared.clear()
    return function(*args), list(_compared)


def choose(m: Any, a: Any, b: Any) -> Any:
    """One or the other, by a mask."""
    if not isinstance(m, np.ndarray):
        return a if m else b
    if not isinstance(a, Number) and not isinstance(b, Number):
        return np.where(m, a, b).view(Rows)
    return numeral(a).each(lambda x, y: np.where(m, x, y), numeral(b))


def vector(*of: Any) -> Any:
    """A vector of its components."""

    def stacked(*of):
        return np.stack(np.broadcast_arrays(*map(np.atleast_1d, of)))

    x, y, z = of or (0.0,) * 3
    if not any(isinstance(a, Number) for a in of):
        return stacked(x, y, z).view(Rows)
    return numeral(x).each(stacked, numeral(y), numeral(z))


def is_vector(x: Any) -> bool:
    return np.ndim(getattr(x, "value", x)) == 2


def dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Any, b: Any) -> Any:
    return vector(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


# ---- Numbers of the input ----

# Kinds of inputs, so many of each: all of similar size; of each vector an axis, and some vectors, far above the rest;
# besides that, alike at both ends of the step; with parallel sides.
_EACH = 6000
_SIMILAR, _APART, _ALIKE, _PARALLEL = range(4)
_SMALL = 2.0**-40


def drawn(name: str, axes: int = 1, *, unit: float = 1.0, lost: float = 0.0) -> Number:
    """A number, or with three axes a vector, that has lost so much of itself."""
    alike = {_ALIKE: re.sub(r"\.[01]", "", name), _PARALLEL: name.replace("q.", "r.")}
    blocks = []
    for kind in range(4):
        rng = np.random.default_rng([kind, *alike.get(kind, name).encode()])
        x = rng.uniform(0.5, 1, (axes, _EACH)) * rng.choice([-1, 1], (axes, _EACH))
        if kind in (_APART, _ALIKE) and axes > 1:
            x *= np.where(rng.integers(3, size=_EACH) == np.arange(3)[:, None], 1, _SMALL)
            x *= np.where(rng.random(_EACH) < 0.3, _SMALL, 1)
        elif kind != _SIMILAR:
            x *= np.where(rng.random((axes, _EACH)) < 0.3, _SMALL, 1)
        blocks.append(x)
    x = np.squeeze(np.concatenate(blocks, axis=1))
    return Number(x, 0.0, lost * np.abs(x), unit)


def drawn_time(name: str, unit: float = 1.0) -> Number:
    """A number between 0 and 1, near an end of that in some inputs."""
    rng = np.random.default_rng([*name.encode()])
    x = rng.choice([_SMALL, 1 - _SMALL, 0.5, 0.25], 4 * _EACH)
    return Number(np.where(rng.random(4 * _EACH) < 0.4, rng.uniform(0.01, 0.99, 4 * _EACH), x), unit=unit)


# ---- The kernels' own files ----


def _function(f: Callable | None = None, **_: Any) -> Any:
    """A function of the kernels, of which overloads are told apart by vectors and numbers."""
    if f is None:
        return _function
    kinds = [kind is vector for name, kind in f.__annotations__.items() if name != "return"]
    overloads = {**getattr(f.__globals__.get(f.__name__), "overloads", {}), tuple(kinds): f}

    def call(*args: Any) -> Any:
        return overloads[tuple(map(is_vector, args))](*args) if len(overloads) > 1 else f(*args)

    call.overloads = overloads
    return call


def _native(snippet: str) -> Callable:
    """A function in C++ that returns an expression of its arguments; others cannot be called."""
    text = re.sub(r"\(Lanes\)|\(Mask\)", "", snippet.rpartition("return ")[2].rpartition(";")[0]).replace("!", "~")
    text = re.sub(r"\((.+) \? (.+) : (.+)\)$", r"(choose(\1, \2, \3))", text)
    scope = dict.fromkeys(("lanes", "mask", "of_lanes", "of_mask"), lambda x: x) | {"fabs": abs, "choose": choose}

    def decorate(f: Callable) -> Callable:
        @functools.wraps(f)
        def native(*args: Any) -> Any:
            names = (*f.__code__.co_varnames, "x", "y")
            return eval(text, scope, dict(zip(names, args * 2, strict=False)))

        return _function(native)

    return decorate


def _extreme(relation: Callable) -> Callable:
    def of(a: Any, b: Any = None) -> Any:
        return of(of(a[0], a[1]), a[2]) if b is None else choose(relation(a, b), a, b)

    return of


# What the files know as Warp, beside its types; of anything else no function that is executed makes use.
_WARP = {"func": _function, "kernel": _function, "func_native": _native}
_WARP |= {"struct": lambda _: SimpleNamespace, "where": choose}
_WARP |= dict.fromkeys(("constant", "static", "cast"), lambda x, *_: x) | {"inf": np.inf, "nan": np.nan}
_WARP |= dict.fromkeys(("int32", "int64", "uint64"), int) | {"uint32": np.uint32, "bool": np.bool_}
_WARP |= {"dot": dot, "cross": cross, "sqrt": lambda x: x**0.5, "length": lambda x: dot(x, x) ** 0.5, "abs": abs}
_WARP |= {"max": _extreme(operator.gt), "min": _extreme(operator.lt), "floor": np.floor, "vec3d": vector}
_WARP |= {"types.vector": lambda length, dtype: vector if length == 3 else MagicMock()}


class House:
    """The kernels' files, executed as plain Python: on counted numbers, or on arrays with a dtype.

    Args:
        real: Precision of the iteration, whose unit roundoff is u.
        dtype: Of the arrays, or None.
    """

    def __init__(self, real: str = "float64", dtype: Any = None) -> None:
        self.dtype, self.loaded = dtype, {}
        units = {"float64": 1.0, "float32": 2.0**29}
        self.units = {name: unit / units[real] for name, unit in units.items()}
        self.types = {name: self._real(name) for name in units}
        self.parameters = vars(parameters) | {"real": self.types[real]}
        self.warp = MagicMock(**self.types, **_WARP)

    def _real(self, name: str) -> Callable:
        """A floating-point type."""
        unit = self.units[name]

        def real(x: Any = 0.0) -> Any:
            if self.dtype is not None:
                with np.errstate(over="ignore"):
                    return x.astype(self.dtype) if isinstance(x, np.ndarray) else self.dtype(x)
            if isinstance(x, Number):
                rounding = unit * np.abs(x.value) * bool(0 < x.unit < unit)  # to fewer digits
                return Number(x.value, x.shift, x.lost + rounding, unit if x.unit else 0)
            is_exact = not np.isfinite(x) or np.frexp(x)[0] * 2**24 % 1 == 0
            return Number(float(x), 0.0, 0.0 if is_exact else unit * abs(x))

        real.__name__ = name
        return real

    def power(self, x: Number) -> Number:
        """A power of two, by which x is below 1."""
        return Number(np.ldexp(1.0, -np.frexp(x.value)[1]), unit=self.units["float64"])

    def load(self, name: str, **values: Any) -> Any:
        """A file by name, as in ``pair.volume``."""
        values = self.parameters | values
        if name == "parameters":
            return SimpleNamespace(**values)
        if name == "template":
            of = self.parameters | {"real": self.types["float64"]}
            return SimpleNamespace(specialised=lambda n, **p: self.load(n, **of | p))
        wanted = sorted(template._parameters_of(name))
        key = name, *(getattr(values[n], "__name__", values[n]) for n in wanted)
        if key in self.loaded:
            return self.loaded[key]
        module = self.loaded[key] = ModuleType(name)

        def imported(what: str, scope: Any = None, local: Any = None, wanted: Any = (), level: int = 0) -> Any:
            if level == 0:
                return self.warp if what == "warp" else builtins.__import__(what, scope, local, wanted, level)
            found = {n: self.load(m, **values) for n, m in template._modules(name, level, what, wanted).items()}
            return found[""] if "" in found else SimpleNamespace(**found)

        vars(module).update(__builtins__={**vars(builtins), "__import__": imported})
        exec(template._read(name)[1], vars(module))
        if name == "pair.simd":
            module.func = module.rare = _function
            module.bits_of = lambda m: int(np.any(m))
        if self.dtype is None and name in ("pair.rounding", "pair.lane_scale"):
            module.inverse_power_of_two = self.power
        if self.dtype is None and name == "pair.rounding":
            module.UNIT_ROUNDOFF = {t: Number(0.0, self.units[t.__name__]) for t in self.types.values()}
            for name_of in ("TINY", "SQUARE_UNDERFLOW"):  # far below all inputs
                setattr(module, name_of, dict.fromkeys(self.types.values(), 2.0**-900))
        return module
