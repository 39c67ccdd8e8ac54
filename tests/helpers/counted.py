"""Numbers that count their roundings, and the kernels' own files executed on them, or on arrays of NumPy (`House`).

A counted number is what exact arithmetic gives, a polynomial in atoms and, to the first order, in the unit roundoff u.
Beside it is what rounding may have taken, in u: ``lost``, a polynomial in magnitudes, and ``common``, roundings of the
number as a whole. An atom is a number of the input, or what is no polynomial: a magnitude, a maximum, a root, a
reciprocal. A sum of exact numbers is an atom where it is a factor: it has one rounding, whatever cancels in it.
"""

import ast
import builtins
import operator
import re
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import comb, isqrt, prod
from pathlib import Path
from typing import Any

import numpy as np

from ccd_warp import kernels

ONE = Fraction(1)
_BESIDE_ROUNDING = 2.0**-60  # the absolute terms of step 5
_FOLDER = Path(kernels.__file__).parent


@dataclass(eq=False)
class Atom:
    """A factor of monomials; it is not less in magnitude than those that it covers, nor larger than its size."""

    name: str
    value: Callable | None = None
    positive: bool = False
    power: bool = False  # of two
    covers: frozenset = frozenset()
    size: dict | None = None
    of: tuple = ()
    weight: tuple = ()  # the name of a parameter t, and 1 - t if this is t, or t if this is 1 - t

    def __lt__(self, other: "Atom") -> bool:
        return self.name < other.name

    def __repr__(self) -> str:
        return self.name

    def at(self, numbers: dict) -> Fraction:
        return self.value(numbers) if self.value else numbers[self.name]


U = Atom("u", lambda _: 0)
_made: dict[tuple, Atom] = {}


class Cancels(ArithmeticError):
    """A sum has no error relative to itself."""


def joined(a: dict, b: dict, factor: Any = 1) -> dict:
    r = dict(a)
    for m, c in b.items():
        r[m] = r.get(m, 0) + factor * c
    return {m: c for m, c in r.items() if c}


def times(a: dict, b: dict) -> dict:
    r: dict = {}
    for m, c in a.items():
        for n, d in b.items():
            key = tuple(sorted(m + n))
            if key.count(U) < 2:
                r[key] = r.get(key, 0) + c * d
    return {m: c for m, c in r.items() if c}


def scaled(a: dict, factor: Any) -> dict:
    return joined({}, a, factor)


def plain(a: dict) -> dict:
    """The part without u."""
    return {m: c for m, c in a.items() if U not in m}


def first_order(a: dict) -> dict:
    """The part with u, divided by it."""
    return {tuple(x for x in m if x is not U): c for m, c in a.items() if U in m}


def value(a: dict, at: dict) -> Fraction:
    """The part without u at given numbers."""
    return sum((c * prod((x.at(at) for x in m), start=ONE) for m, c in plain(a).items()), Fraction(0))


def atom_of(kind: str, a: dict, size: dict | None = None) -> Atom:
    """The atom that stands for a sum, its magnitude, its root or its reciprocal."""
    key = kind, frozenset(a.items())
    if key not in _made:
        root = lambda x: Fraction(isqrt(int(x * 2**400)), 2**200)  # noqa: E731
        of = {"sum": lambda x: x, "abs": abs, "1/": lambda x: 1 / x, "root": root}[kind]
        is_positive = kind in ("abs", "root") or all(c > 0 and all(x.positive for x in m) for m, c in a.items())
        text = f"{kind}({' + '.join(f'{c} {m}' for m, c in sorted(a.items(), key=str))})"
        _made[key] = Atom(text, lambda at: of(value(a, at)), is_positive, size=size)
    return _made[key]


def magnitude_of(x: Atom) -> Atom:
    if x.positive:
        return x
    of = Atom(f"|{x}|", lambda at: abs(x.at(at)), True, covers=frozenset({x}), size=x.size)
    return _made.setdefault(("magnitude", x), of)


class Number:
    def __init__(self, exact: dict, size: dict | None = None, lost: dict | None = None, common: Any = 0, unit: Any = 0):
        self.exact, self.lost, self.common, self.unit = exact, lost or {}, Fraction(common), Fraction(unit)
        self.size = {m: abs(c) for m, c in plain(exact).items()} if size is None else size

    def total(self) -> dict:
        """All that rounding may have taken."""
        return joined(self.lost, self.size, self.common)

    def is_constant(self) -> bool:
        return all(set(m) <= {U} for m in self.exact)

    def as_atom(self) -> "Number":
        if self.lost or len(self.exact) < 2 or plain(self.exact) != self.exact:
            return self
        return Number({(atom_of("sum", self.exact),): ONE}, None, None, self.common, self.unit)

    def relative(self) -> Fraction:
        """Roundings of the number as a whole; its terms may only lose where all are positive."""
        for m in self.lost:
            if any(m.count(x) % 2 for x in m if not x.positive) or self.exact.get(m, 0) <= 0:
                raise Cancels(m)
        return max((c / self.exact[m] for m, c in self.lost.items()), default=Fraction(0)) + self.common

    def is_power_of_two(self) -> bool:
        (m, c), *others = [*self.exact.items(), ((), Fraction(3))][: max(1, len(self.exact))]
        both = abs(c.numerator), c.denominator
        return not others and all(k & (k - 1) == 0 for k in both) and all(x.power for x in m) and not self.total()

    def plus(self, other: Any, sign: int = 1) -> "Number":
        b = numeral(other)
        if not b.size and not b.exact:
            return self
        if not self.size and not self.exact:
            return b if sign > 0 else -b
        if self is b and sign > 0:  # twice a number
            return Number(scaled(self.exact, 2), scaled(self.size, 2), scaled(self.lost, 2), self.common, self.unit)
        unit, lost = max(self.unit, b.unit), joined(self.total(), b.total())
        return Number(joined(self.exact, b.exact, sign), joined(self.size, b.size), lost, unit, unit)

    def minus(self, other: Any) -> "Number":
        b = numeral(other)
        weight = next(iter(b.exact))[0].weight if len(b.exact) == 1 and next(iter(b.exact)) else ()
        if self.exact == {(): 1} and weight and not b.total():  # a weight of its own
            return Number({(weight[1],): ONE}, None, None, 0 if weight[2] else b.unit, b.unit)
        return self.plus(b, -1)

    def by(self, other: Any) -> Any:
        if isinstance(other, Vector):
            return NotImplemented
        a, b = self.as_atom(), numeral(other).as_atom()
        unit = max(a.unit, b.unit)
        common = a.common + b.common + (0 if a.is_power_of_two() or b.is_power_of_two() else unit)
        lost = joined(times(a.lost, b.size), times(a.size, b.lost))
        return Number(times(a.exact, b.exact), times(a.size, b.size), lost, common, unit)

    def over(self, other: Any) -> "Number":
        a, b = self.as_atom(), numeral(other)
        inverse = {(atom_of("1/", b.exact),): ONE}
        next(iter(inverse))[0].power = b.is_power_of_two()
        unit = max(a.unit, b.unit)
        common = a.common + b.relative() + (0 if b.is_power_of_two() else unit)
        return Number(times(a.exact, inverse), times(a.size, inverse), times(a.lost, inverse), common, unit)

    def __neg__(self) -> "Number":
        return Number(scaled(self.exact, -1), self.size, self.lost, self.common, self.unit)

    def __pow__(self, n: int) -> "Number":
        return self if n == 1 else self * self ** (n - 1)

    def __abs__(self) -> "Number":
        a = self.as_atom()
        if len(a.exact) == 1:
            ((m, c),) = a.exact.items()
            return Number({tuple(sorted(map(magnitude_of, m))): abs(c)}, None, a.lost, a.common, a.unit)
        atom = atom_of("abs", plain(a.exact), a.size)
        return a if a.is_constant() else Number({(atom,): ONE}, None, a.total(), 0, a.unit)

    __add__, __sub__, __mul__, __truediv__, __radd__, __rmul__ = plus, minus, by, over, plus, by
    __rsub__, __rtruediv__ = (lambda s, o: numeral(o).minus(s)), (lambda s, o: numeral(o).over(s))
    __lt__, __gt__ = (lambda s, o: compared("<", s, numeral(o))), (lambda s, o: compared("<", numeral(o), s))
    __le__, __ge__ = (lambda s, o: compared("<=", s, numeral(o))), (lambda s, o: compared("<=", numeral(o), s))


def numeral(x: Any) -> Number:
    return x if isinstance(x, Number) else Number({(): Fraction(x)} if x else {})


def given(x: Number) -> Number:
    """A computed number as one of its own: what it lost is judged elsewhere."""
    atom = atom_of("sum", x.exact, x.size) if len(x.exact) > 1 else next(iter(x.exact))[0]
    return Number({(atom,): ONE}, unit=x.unit)


def root(x: Number) -> Number:
    return Number({(atom_of("root", x.exact),): ONE}, None, None, x.relative() / 2 + x.unit, x.unit)


def extreme(a: Number, b: Number, which: Callable) -> Number:
    """The greater or the lesser of two numbers, as an atom."""
    if a.exact == b.exact:
        return a
    key = which, frozenset(frozenset(x.exact.items()) for x in (a, b))
    atom = _made.setdefault(key, Atom(f"{which.__name__} {len(_made)}"))
    atoms = [m[0] for x in (a, b) for m, c in x.exact.items() if len(x.exact) == len(m) == c == 1]
    atom.of, atom.value = (a, b), lambda at: which(value(x.exact, at) for x in (a, b))
    atom.covers = frozenset(atoms).union(*(x.covers for x in atoms)) if which is max else frozenset()
    atom.positive = len(atoms) == 2 and all(x.positive for x in atoms)
    r = Number({(atom,): ONE}, unit=max(a.unit, b.unit))
    try:
        r.common = max(a.relative(), b.relative())
    except Cancels:
        lost = a.total(), b.total()
        r.lost = {m: max(x.get(m, Fraction(0)) for x in lost) for m in {**lost[0], **lost[1]}}
    return r


# ---- Choices, each by itself ----


@dataclass
class Path:
    """The outcomes of comparisons, some of which are known."""

    decisions: list[bool]
    known: Callable
    conditions: list
    taken: int = 0

    def decide(self, relation: str, a: Number, b: Number) -> bool:
        before = [c[3] for c in self.conditions if c[0] == relation and (c[1].exact, c[2].exact) == (a.exact, b.exact)]
        outcome = before[0] if before else self.known(relation, a, b)
        if outcome is None:
            self.decisions += [True] if self.taken == len(self.decisions) else []
            outcome = self.decisions[self.taken]
            self.taken += 1
        self.conditions.append((relation, a, b, outcome))
        return outcome


_path: list[Path] = []


def compared(relation: str, a: Number, b: Number) -> Any:
    """The outcome on a path; outside of all, what the greater or the lesser of two numbers is recognised by."""
    if a.exact == b.exact:
        return relation == "<="
    if a.is_constant() and b.is_constant():
        return a.exact.get((), 0) < b.exact.get((), 0)
    return _path[-1].decide(relation, a, b) if _path else types.SimpleNamespace(lesser=a, greater=b)


def paths(function: Callable, known: Callable = lambda *_: None) -> Iterator[tuple[list, Any]]:
    """The comparisons of a function and what it gives, for each outcome of those that are not known."""
    decisions: list[bool] = []
    while True:
        _path.append(Path(decisions, known, []))
        try:
            found = _path[-1].conditions, function()
        finally:
            _path.pop()
        yield found
        while decisions and not decisions[-1]:
            decisions.pop()
        if not decisions:
            return
        decisions[-1] = False


# ---- What bounds what ----


def _bernstein(a: dict) -> Fraction:
    """The largest coefficient of a polynomial in weights t and 1 - t, as one of Bernstein."""
    for t in {min(x, x.weight[1]) for m in a for x in m}:
        rest, raised = t.weight[1], {}
        degree = max(m.count(t) + m.count(rest) for m in a)
        for m, c in a.items():
            missing = degree - m.count(t) - m.count(rest)
            for i in range(missing + 1):
                key = tuple(sorted(m + (t,) * i + (rest,) * (missing - i)))
                raised[key] = raised.get(key, 0) + c * comb(missing, i)
        a = {m: c / comb(degree, m.count(t)) for m, c in raised.items()}
    return max(a.values())


def in_magnitudes(a: dict, covering: Any = ()) -> dict:
    """A polynomial above it in magnitudes, without weights, and with atoms that cover others in the place of these."""
    rows: dict = {}
    for m, c in a.items():
        rest = [next((y for y in covering if x in y.covers), magnitude_of(x)) for x in m if not x.weight]
        row = rows.setdefault(tuple(sorted(rest)), {})
        weights = tuple(x for x in m if x.weight)
        row[weights] = row.get(weights, 0) + abs(c)
    return {m: _bernstein(row) for m, row in rows.items()}


def expanded(a: dict) -> dict:
    """A polynomial with sizes in the place of atoms that have one."""
    r: dict = {}
    for m, c in a.items():
        term = {(): c}
        for x in m:
            term = times(term, {(x,): ONE} if x.size is None else expanded(x.size))
        r = joined(r, term)
    return r


def share(lost: dict, bound: dict) -> float:
    """How much of a bound is taken by what is lost, on the term on which that is most; of one below 0 all.

    Of a magnitude what its own bound does not cover is that of the terms that it is made of.
    """
    if min(bound.values(), default=0) < -_BESIDE_ROUNDING:
        return np.inf
    covering = {x for m in bound for x in m if x.covers}
    covered = frozenset().union(*(x.covers for x in covering))
    composite = {m for m in {**lost, **bound} if any(x.size and x not in covered for x in m)}
    left = {m: c - bound.get(m, 0) for m, c in lost.items() if m in composite and c > bound.get(m, 0)}
    lost = joined({m: c for m, c in lost.items() if m not in composite}, expanded(left))
    above = in_magnitudes({m: c for m, c in bound.items() if m not in composite})
    taken = in_magnitudes({m: c for m, c in lost.items() if c > _BESIDE_ROUNDING}, covering)
    return max((float(c / above[m]) if m in above else np.inf for m, c in taken.items()), default=0.0)


# ---- The kernels' own files ----


class Vector:
    __array_ufunc__ = None  # arrays leave products with vectors to these

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


def dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return Vector(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


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
        if isinstance(x, Number) and x.unit < unit and x.unit:  # rounded to fewer digits
            exact, size = x.exact, x.size
            atom = _made.setdefault(
                ("narrowed", str(exact)), Atom(f"narrowed({exact})", lambda at: value(exact, at), size=size)
            )
            x = x if len(exact) == 1 else Number({(atom,): ONE}, None, x.total())
            return Number(x.exact, x.size, x.lost, x.common + unit, unit)
        if isinstance(x, Number):
            is_exact = x.unit or (x.exact.get((), ONE) * 2**20).denominator == 1
            return Number(x.exact, x.size, x.lost, x.common if is_exact else unit, unit if x.unit else 0)
        exact = Fraction(x) if np.isfinite(x) else Fraction(2) ** 1024
        simple = exact.limit_denominator(2 * 10**11)
        if simple != exact and float(simple) == x:
            return Number({(): simple}, None, None, unit)
        near = Fraction(round(exact * 2**20), 2**20) if abs(x) < 2**20 else exact
        more = (exact - near) * 2**53  # of 1 + 32u that is written as a number
        return Number({(): near, (U,): more}) if near and 0 < abs(more) < 2**12 else numeral(exact)


class _Anything:
    """What no function that is executed asks for."""

    def __class_getitem__(cls, _: Any) -> Any:
        return cls

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def __call__(self, *args: Any, **_: Any) -> Any:
        return args[0] if args else self


@cache
def _compiled(name: str, cuts: tuple) -> types.CodeType:
    """A file with variables of functions cut after they are set for the last time."""
    tree = ast.parse((_FOLDER / f"{name.replace('.', '/')}.py").read_text(encoding="utf-8"))
    for function in (f for f in ast.walk(tree) if isinstance(f, ast.FunctionDef)):
        for variable in (x for f, *of in cuts for x in of if f == function.name):
            last = max(k for k, x in enumerate(function.body) if ast.unparse(x).startswith(f"{variable} = "))
            function.body.insert(last + 1, ast.parse(f"{variable} = cut_({variable!r}, {variable})").body[0])
    return compile(ast.fix_missing_locations(tree), name, "exec")


class House:
    """The kernels' files, executed as plain Python: on counted numbers, or on arrays with a dtype.

    Args:
        real: Precision of the iteration.
        dtype: Of the arrays, or None.
        cuts: Names of variables by file and function, which are numbers of their own once they are set.
    """

    def __init__(self, real: str = "float64", dtype: Any = None, cuts: Any = ()) -> None:
        self.dtype, self.cuts, self.loaded = dtype, dict(cuts), {}
        self.units = {"float64": ONE, "float32": Fraction(2**29)}
        self.units = {name: unit / self.units[real] for name, unit in self.units.items()}
        self.types = {name: Real(self, name) for name in self.units}
        self.cut: dict[str, Any] = {}  # what was cut, by the name of the variable
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
        code = _compiled(name, tuple((f, *of) for (file, f), of in self.cuts.items() if file == name))

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

        vars(module).update(__builtins__={**vars(builtins), "__import__": imported}, cut_=self._cut)
        exec(code, vars(module))
        if name == "pair.rounding" and self.dtype is None:
            of = {t: Number({(U,): self.units[t.__name__]}) for t in self.types.values()}
            module.UNIT_ROUNDOFF = of
            module.EIGHTH_UP = 0.125 * (1.0 + module.SAGITTA * of[self.types["float64"]])
        if name == "pair.simd":
            module.func = module.rare = self._function
            module.bits_of = module.bits_of if self.dtype is None else lambda m: int(np.any(m))
        if name in ("pair.rounding", "pair.lane_scale") and self.dtype is None:
            module.inverse_power_of_two = self.power
        return module

    def _cut(self, name: str, x: Any) -> Any:
        self.cut[name] = x
        if isinstance(x, Vector):
            return vector(name, unit=x.x.unit)
        return Number({(Atom(name, lambda at: value(x.exact, at), True),): ONE}, unit=x.unit)

    def power(self, x: Any) -> Number:
        atom = Atom(f"scale {len(_made)}", lambda _: Fraction(1, 4), True, power=True)
        return Number({(atom,): ONE}, unit=self.units["float64"])

    def _function(self, f: Callable | None = None, **_: Any) -> Any:
        return self._function if f is None else Function(f, {} if "<locals>" in f.__qualname__ else f.__globals__)

    def _native(self, snippet: str) -> Callable:
        """A function in C++ that returns an expression of its arguments; others cannot be called."""
        text = re.sub(r"\(Lanes\)|\(Mask\)", "", snippet.rpartition("return ")[2].rpartition(";")[0])
        text = re.sub(r"\bx\b", "a", re.sub(r"\by\b", "b", text))
        text = re.sub(r"^(\w+)\((.+) \? (.+) : (.+)\)$", r"\1(choose(\2, \3, \4))", text)
        text = re.sub(r"!(\w+\(m\))", r"opposite(\1)", text)
        scope = dict.fromkeys(("lanes", "mask", "of_lanes", "of_mask"), lambda x: x)
        scope |= {"fabs": abs, "choose": self.choose, "opposite": lambda m: ~m if isinstance(m, np.ndarray) else not m}

        def decorate(f: Callable) -> Function:
            def native(*args: Any) -> Any:
                return eval(text, scope, dict(zip(f.__code__.co_varnames, args, strict=False)))

            native.__name__, native.__annotations__ = f.__name__, f.__annotations__
            return Function(native, f.__globals__)

        return decorate

    def choose(self, m: Any, a: Any, b: Any) -> Any:
        if isinstance(a, Vector):
            return a.each(lambda x, y: self.choose(m, x, y), b)
        if isinstance(m, types.SimpleNamespace):
            assert {id(a), id(b)} == {id(m.lesser), id(m.greater)}, "a choice outside of paths"
            return extreme(a, b, max if a is m.greater else min)
        return np.where(m, a, b) if isinstance(m, np.ndarray) else a if m else b

    def _extreme(self, is_greatest: bool) -> Callable:
        def of_two(a: Any, b: Any) -> Any:
            return self.choose(b < a if is_greatest else a < b, a, b)

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

        def of_root(x: Any) -> Any:
            return root(x) if isinstance(x, Number) else np.sqrt(x)

        vars(wp).update(self.types, struct=struct, func=self._function, kernel=self._function, func_native=self._native)
        vars(wp).update(dict.fromkeys(("uint32", "int32", "int64", "uint64"), int), bool=bool, where=self.choose)
        vars(wp).update(dict.fromkeys(("vec3d", "vec4d", "vec2d"), Vector), inf=float("inf"), nan=float("nan"))
        vars(wp).update(dict.fromkeys(("constant", "static", "cast"), identity), dot=dot, cross=cross, sqrt=of_root)
        vars(wp).update(max=self._extreme(True), min=self._extreme(False), length=lambda x: of_root(dot(x, x)))
        vars(wp).update(abs=lambda x: x.each(abs) if isinstance(x, Vector) else abs(x), floor=np.floor)
        wp.types = types.SimpleNamespace(
            vector=lambda length, dtype: Vector if length == 3 else _Anything, matrix=_Anything
        )
        wp.__getattr__ = lambda _: _Anything
        return wp


# ---- Numbers of the input ----


def number(name: str, roundings: Any = 0, *, unit: Any = 1, positive: bool = False) -> Number:
    atom = _made.setdefault(("input", name, positive), Atom(name, positive=positive))
    return Number({(atom,): ONE}, None, None, roundings, unit)


def vector(name: str, roundings: Any = 0, **more: Any) -> Vector:
    return Vector(*(number(name + k, roundings, **more) for k in "xyz"))


def parameter(name: str, *, is_dyadic: bool = False) -> Number:
    """A number in [0, 1], whose difference from 1 is an atom, too."""
    x = number(name, positive=True)
    (atom,) = next(iter(x.exact))
    if not atom.weight:
        rest = Atom(f"1-{name}", lambda at: 1 - at[name], True)
        atom.weight, rest.weight = (name, rest, is_dyadic), (name, atom, is_dyadic)
    return x
