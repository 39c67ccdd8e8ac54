"""Numbers that count their roundings, and the kernels' own files executed on them, or on arrays of NumPy (`House`).

A counted number has, at each of many drawn inputs, its value in exact arithmetic, by how many unit roundoffs u the code
means to differ from that (as in a product by 1 + 8u), and how many u rounding may have taken on the way: a running
error analysis to the first order. The inputs (`number`) are drawn so that each term of a formula outweighs the others
in some of them, as the terms of a bound are held one by one.
"""

import builtins
import operator
import re
import types
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp import kernels

_FOLDER = Path(kernels.__file__).parent
_compared: list[tuple] = []  # the numbers that were compared


class Number:
    """A number at all inputs; all but the value in u.

    Args:
        value: In exact arithmetic.
        shift: What it is meant to be above its value.
        lost: What rounding may have taken.
        last: The part of that which the last operation took.
        unit: Unit roundoff of its type; 0 for a constant, which takes the type of what it meets.
        is_power: Whether it is a power of two.
        is_dyadic: Whether its difference from 1 is exact.
    """

    __array_ufunc__ = None  # arrays leave products with numbers to these

    def __init__(self, value, shift=0.0, lost=0.0, last=0.0, unit=0.0, is_power=False, is_dyadic=False):
        self.value, self.shift, self.lost, self.last, self.unit = value, shift, lost, last, unit
        is_constant_power = unit == 0 and not np.any(shift) and np.all(np.frexp(np.abs(value))[0] == 0.5)
        self.is_power, self.is_dyadic = is_power or bool(is_constant_power), is_dyadic

    def rounded(self, unit: float) -> "Number":
        last = unit * np.abs(self.value)
        return Number(self.value, self.shift, self.lost + last, last, unit)

    def is_zero(self) -> bool:
        return self.unit == 0 and not np.any(self.value) and not np.any(self.shift)

    def plus(self, other: Any) -> "Number":
        a, b = self, numeral(other)
        if a.is_zero() or b.is_zero():
            return b if a.is_zero() else a
        r = Number(a.value + b.value, a.shift + b.shift, a.lost + b.lost)
        return r.rounded(0 if a is b else max(a.unit, b.unit))

    def minus(self, other: Any) -> "Number":
        b = numeral(other)
        r = self.plus(-b)
        return Number(r.value, unit=r.unit) if b.is_dyadic else r

    def by(self, other: Any) -> Any:
        if isinstance(other, Vector):
            return NotImplemented
        a, b = self, numeral(other)
        r = Number(
            a.value * b.value,
            a.shift * b.value + a.value * b.shift,
            a.lost * np.abs(b.value) + np.abs(a.value) * b.lost,
            unit=max(a.unit, b.unit),
        )
        return r if a.is_power or b.is_power else r.rounded(r.unit)

    def over(self, other: Any) -> "Number":
        b = numeral(other)
        with np.errstate(all="ignore"):
            square = b.value * b.value
            inverse = Number(1 / b.value, -b.shift / square, b.lost / square, 0.0, b.unit, is_power=True)
            r = self * inverse
            return r if b.is_power else r.rounded(max(self.unit, b.unit))

    def root(self) -> "Number":
        value = np.sqrt(self.value)
        return Number(value, self.shift / (2 * value), self.lost / (2 * value)).rounded(self.unit)

    def __pow__(self, n: int) -> "Number":
        return self if n == 1 else self * self ** (n - 1)

    def __neg__(self) -> "Number":
        return Number(-self.value, -self.shift, self.lost, self.last, self.unit, self.is_power)

    def __abs__(self) -> "Number":
        return choose(np.asarray(self.value) < 0, -self, self)

    __add__, __sub__, __mul__, __truediv__, __radd__, __rmul__ = plus, minus, by, over, plus, by
    __rsub__, __rtruediv__ = (lambda s, o: numeral(o).minus(s)), (lambda s, o: numeral(o).over(s))
    __lt__, __gt__ = (lambda s, o: compare(operator.lt, s, o)), (lambda s, o: compare(operator.gt, s, o))
    __le__, __ge__ = (lambda s, o: compare(operator.le, s, o)), (lambda s, o: compare(operator.ge, s, o))


def numeral(x: Any) -> Number:
    return x if isinstance(x, Number) else Number(float(x))


def compare(relation: Callable, a: Any, b: Any) -> Any:
    """An outcome for each input, or one for all of them."""
    a, b = numeral(a), numeral(b)
    _compared.append((a, b))
    outcome = np.asarray(relation(a.value, b.value))
    return bool(outcome.flat[0]) if outcome.all() == outcome.any() else outcome


def comparisons(function: Callable, *args: Any) -> tuple[Any, list[tuple]]:
    """What a function gives, and the numbers that it compared."""
    _compared.clear()
    return function(*args), list(_compared)


def choose(m: Any, a: Any, b: Any) -> Any:
    """One or the other, by a mask."""
    if isinstance(a, Vector):
        return a.each(lambda x, y: choose(m, x, y), b)
    if not isinstance(m, np.ndarray):
        return a if m else b
    if not isinstance(a, Number) and not isinstance(b, Number):
        return np.where(m, a, b)
    a, b = numeral(a), numeral(b)
    fields = (np.where(m, getattr(a, n), getattr(b, n)) for n in ("value", "shift", "lost", "last"))
    return Number(*fields, max(a.unit, b.unit), a.is_power and b.is_power)


class Vector:
    __array_ufunc__ = None

    def __init__(self, *of: Any) -> None:
        self.of = list(of or (numeral(0),) * 3)

    x, y, z = (property(lambda s, k=k: s.of[k], lambda s, v, k=k: s.of.__setitem__(k, v)) for k in range(3))

    def __getitem__(self, k: int) -> Any:
        return self.of[k]

    def each(self, f: Callable, *others: "Vector") -> "Vector":
        return Vector(*(f(*x) for x in zip(self.of, *(o.of for o in others), strict=True)))

    def __neg__(self) -> "Vector":
        return self.each(operator.neg)

    __add__, __sub__ = (lambda a, b: a.each(operator.add, b)), (lambda a, b: a.each(operator.sub, b))
    __mul__, __rmul__ = (lambda a, k: a.each(lambda x: x * k)), (lambda a, k: a.each(lambda x: k * x))


def dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Any, b: Any) -> Vector:
    return Vector(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


# ---- Numbers of the input ----

# Kinds of inputs, so many of each: all of similar size; of each vector an axis, and some vectors, far above the rest;
# besides that, alike at both ends of the step; with parallel sides.
_EACH = 6000
_SIMILAR, _APART, _ALIKE, _PARALLEL = range(4)
_SMALL = 2.0**-40


def number(name: str, roundings: float = 0, *, unit: float = 1.0, positive: bool = False) -> Number:
    """A number that is itself so many roundings off; of the component of a vector the name ends with its axis."""
    blocks = []
    for kind in range(4):
        alike = (
            re.sub(r"\.[01]", "", name) if kind == _ALIKE else name.replace("q.", "r.") if kind == _PARALLEL else name
        )
        rng = np.random.default_rng([kind, *alike.encode()])
        x = rng.uniform(0.5, 1, _EACH) * rng.choice([-1, 1], _EACH)
        if kind in (_APART, _ALIKE) and alike[-1] in "xyz" and len(alike) > 1:
            of_vector = np.random.default_rng([kind, *alike[:-1].encode()])
            x *= np.where(of_vector.integers(3, size=_EACH) == "xyz".index(alike[-1]), 1, _SMALL)
            x *= np.where(of_vector.random(_EACH) < 0.3, _SMALL, 1)
        elif kind != _SIMILAR:
            x *= np.where(rng.random(_EACH) < 0.3, _SMALL, 1)
        blocks.append(x)
    x = np.concatenate(blocks)
    x = np.abs(x) if positive else x
    return Number(x, 0.0, roundings * np.abs(x), roundings * np.abs(x), unit)


def vector(name: str, roundings: float = 0, **more: Any) -> Vector:
    return Vector(*(number(name + k, roundings, **more) for k in "xyz"))


def parameter(name: str, *, is_dyadic: bool = False) -> Number:
    """A number between 0 and 1, near an end of that in some inputs."""
    rng = np.random.default_rng([*name.encode()])
    x = rng.choice([_SMALL, 1 - _SMALL, 0.5, 0.25], 4 * _EACH)
    x = np.where(rng.random(4 * _EACH) < 0.4, rng.uniform(0.01, 0.99, 4 * _EACH), x)
    return Number(x, unit=1.0, is_dyadic=is_dyadic)


def given(x: Any) -> Any:
    """A computed number, or vector, as one of the input: what it lost is judged elsewhere."""
    return x.each(given) if isinstance(x, Vector) else Number(x.value, unit=x.unit)


# ---- The kernels' own files ----


class Function:
    """A function of the kernels, of which overloads are told apart by vectors and numbers."""

    def __init__(self, function: Callable, scope: dict) -> None:
        before = scope.get(function.__name__)
        self.overloads = [*(before.overloads if getattr(before, "scope", 0) is scope else ()), function]
        self.scope = scope

    def __call__(self, *args: Any) -> Any:
        for function in self.overloads:
            kinds = function.__annotations__.values()
            alike = (isinstance(x, Vector) == (k is Vector) for x, k in zip(args, kinds, strict=False))
            if len(self.overloads) == 1 or all(alike):
                return function(*args)
        raise TypeError(args)


class Real:
    """A floating-point type."""

    def __init__(self, house: "House", name: str) -> None:
        self.house, self.__name__ = house, name

    def __call__(self, x: Any = 0.0) -> Any:
        dtype, unit = self.house.dtype, self.house.units[self.__name__]
        if dtype is not None:
            with np.errstate(over="ignore"):
                return x.astype(dtype) if isinstance(x, np.ndarray) else dtype(x)
        if isinstance(x, Number):
            if x.unit and x.unit < unit:  # rounded to fewer digits
                return x.rounded(unit)
            return Number(x.value, x.shift, x.lost, x.last, unit, x.is_power) if x.unit else x
        near = round(x * 2**20) / 2**20 if abs(x) < 2**20 else x
        shift = (x - near) * 2**53
        if near and 0 < abs(shift) < 2**12:  # 1 + 32u, written as a number
            return Number(near, shift * self.house.units["float64"])
        is_exact = not np.isfinite(x) or np.frexp(x)[0] * 2**24 % 1 == 0
        return Number(float(x), 0.0, 0.0 if is_exact else unit * abs(x))


class _Anything:
    """What no function that is executed asks for."""

    def __class_getitem__(cls, _: Any) -> Any:
        return cls

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def __call__(self, *args: Any, **_: Any) -> Any:
        return args[0] if args else self


@cache
def _compiled(name: str) -> types.CodeType:
    return compile((_FOLDER / f"{name.replace('.', '/')}.py").read_text(encoding="utf-8"), name, "exec")


class House:
    """The kernels' files, executed as plain Python: on counted numbers, or on arrays with a dtype.

    Args:
        real: Precision of the iteration, whose unit roundoff is u.
        dtype: Of the arrays, or None.
    """

    def __init__(self, real: str = "float64", dtype: Any = None) -> None:
        self.dtype, self.loaded = dtype, {}
        self.units = {"float64": 1.0, "float32": 2.0**29}
        self.units = {name: unit / self.units[real] for name, unit in self.units.items()}
        self.types = {name: Real(self, name) for name in self.units}
        self.parameters = {n: x for n, x in vars(kernels.parameters).items() if n[0] != "_" and n not in ("Any", "wp")}
        self.parameters["real"] = self.types[real]
        self.warp = self._warp()

    def load(self, name: str, **values: Any) -> Any:
        """A file by name, as in ``pair.volume``."""
        values = {**self.parameters, **values}
        key = name, str([getattr(x, "__name__", x) for x in values.values()])
        if key in self.loaded:
            return self.loaded[key]
        module = self.loaded[key] = types.ModuleType(name)

        def imported(what: str, scope: Any = None, local: Any = None, wanted: Any = (), level: int = 0) -> Any:
            if level == 0:
                return self.warp if what == "warp" else builtins.__import__(what, scope, local, wanted, level)
            folder = name.split(".")[:-1]
            path = [*folder[: len(folder) - level + 1], *filter(None, what.split("."))]
            if path == ["template"]:
                of = {**self.parameters, "real": self.types["float64"]}
                return types.SimpleNamespace(specialised=lambda n, **p: self.load(n, **of | p))
            if (_FOLDER / "/".join(path)).is_dir():
                return types.SimpleNamespace(**{w: self.load(".".join([*path, w]), **values) for w in wanted})
            return types.SimpleNamespace(**values) if path == ["parameters"] else self.load(".".join(path), **values)

        vars(module).update(__builtins__={**vars(builtins), "__import__": imported})
        exec(_compiled(name), vars(module))
        if name == "pair.rounding" and self.dtype is None:
            module.UNIT_ROUNDOFF = {t: Number(0.0, self.units[t.__name__]) for t in self.types.values()}
            for name_of in ("TINY", "SQUARE_UNDERFLOW"):  # far below all inputs
                setattr(module, name_of, dict.fromkeys(self.types.values(), 2.0**-900))
        if name == "pair.simd":
            module.func = module.rare = self._function
            module.bits_of = lambda m: int(np.any(m))
        if name in ("pair.rounding", "pair.lane_scale") and self.dtype is None:
            module.inverse_power_of_two = self.power
        return module

    def power(self, x: Number) -> Number:
        return Number(np.ldexp(1.0, -np.frexp(x.value)[1]), unit=self.units["float64"], is_power=True)

    def _function(self, f: Callable | None = None, **_: Any) -> Any:
        return self._function if f is None else Function(f, {} if "<locals>" in f.__qualname__ else f.__globals__)

    def _native(self, snippet: str) -> Callable:
        """A function in C++ that returns an expression of its arguments; others cannot be called."""
        text = re.sub(r"\(Lanes\)|\(Mask\)", "", snippet.rpartition("return ")[2].rpartition(";")[0])
        text = re.sub(r"\bx\b", "a", re.sub(r"\by\b", "b", text))
        text = re.sub(r"^(\w+)\((.+) \? (.+) : (.+)\)$", r"\1(choose(\2, \3, \4))", text)
        text = re.sub(r"!(\w+\(m\))", r"opposite(\1)", text)
        scope = dict.fromkeys(("lanes", "mask", "of_lanes", "of_mask"), lambda x: x)
        scope |= {"fabs": abs, "choose": choose, "opposite": lambda m: ~m if isinstance(m, np.ndarray) else not m}

        def decorate(f: Callable) -> Function:
            def native(*args: Any) -> Any:
                return eval(text, scope, dict(zip(f.__code__.co_varnames, args, strict=False)))

            native.__name__, native.__annotations__ = f.__name__, f.__annotations__
            return Function(native, f.__globals__)

        return decorate

    def _extreme(self, relation: Callable) -> Callable:
        def of_two(a: Any, b: Any) -> Any:
            return choose(relation(a, b), a, b)

        def of(a: Any, b: Any = None) -> Any:
            if b is None:
                return of_two(of_two(a[0], a[1]), a[2])
            return a.each(of_two, b) if isinstance(a, Vector) else of_two(a, b)

        return of

    def _warp(self) -> Any:
        """What the files know as Warp."""
        wp, identity = types.ModuleType("warp"), lambda x, *_: x

        def struct(cls: type) -> type:
            def make(new: Any) -> None:
                for field, kind in cls.__annotations__.items():
                    setattr(new, field, kind() if kind is not _Anything else None)

            cls.__init__ = make
            return cls

        def root(x: Any) -> Any:
            return x.root() if isinstance(x, Number) else np.sqrt(x)

        vars(wp).update(self.types, struct=struct, func=self._function, kernel=self._function, func_native=self._native)
        vars(wp).update(dict.fromkeys(("uint32", "int32", "int64", "uint64"), int), bool=bool, where=choose)
        vars(wp).update(dict.fromkeys(("vec3d", "vec4d", "vec2d"), Vector), inf=float("inf"), nan=float("nan"))
        vars(wp).update(dict.fromkeys(("constant", "static", "cast"), identity), dot=dot, cross=cross, sqrt=root)
        vars(wp).update(max=self._extreme(operator.gt), min=self._extreme(operator.lt))
        vars(wp).update(abs=lambda x: x.each(abs) if isinstance(x, Vector) else abs(x), floor=np.floor)
        wp.length = lambda x: root(dot(x, x))
        wp.types = types.SimpleNamespace(
            vector=lambda length, dtype: Vector if length == 3 else _Anything, matrix=_Anything
        )
        wp.__getattr__ = lambda _: _Anything
        return wp
