"""Numbers that count their roundings, and the kernels' own files executed on them (`House`), or on arrays of NumPy.

A counted number is what exact arithmetic gives, a polynomial in atoms with the unit roundoff u to the first order, and
beside it what rounding may have taken, in u: ``lost``, a polynomial in the magnitudes of the atoms, and ``common``, the
roundings of the number as a whole. An atom is a number of the input, or what is no polynomial of such: a magnitude, a
maximum, a root, a reciprocal. A sum of exact numbers is an atom as soon as it is a factor: it has one rounding, whatever
cancels. Products of roundings are left out; a bound has to be larger by `SECOND_ORDER`.
"""

import ast
import builtins
import re
import types
from collections.abc import Callable, Iterator
from fractions import Fraction
from math import comb, isqrt, prod
from pathlib import Path
from typing import Any

import numpy as np
from ccd_warp import kernels

SECOND_ORDER = 1.001
_BESIDE_ROUNDING = 2.0**-60  # the absolute terms of step 5
_FOLDER = Path(kernels.__file__).parent
_PARAMETERS = {"width": 1, "norm": "maximum", "only_method": "", "with_facets": True, "dimension": 3, "end": "list"}
_PARAMETERS |= {"with_lists": False, "is_thick": False, "in_warps": False, "real": "float64"}


class Cancels(ArithmeticError):
    """A sum has no error relative to itself."""


class Atom:
    """A factor of monomials, by name; it may cover others, which it is not less than in magnitude."""

    def __init__(self, name: str, value: Callable | None = None, **more: Any) -> None:
        self.name, self.value = name, value or (lambda at: at[name])
        self.is_positive, self.is_power, self.parameter = more.pop("positive", False), more.pop("power", False), None
        self.covers, self.size, self.of = more.pop("covers", frozenset()), more.pop("size", None), more.pop("of", ())

    def __lt__(self, other: "Atom") -> bool:
        return self.name < other.name

    def __repr__(self) -> str:
        return self.name


U = Atom("u", lambda at: 0)
_made: dict[tuple, Atom] = {}


def joined(a: dict, b: dict, factor: Fraction = Fraction(1)) -> dict:
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


def plain(a: dict) -> dict:
    """The part without u."""
    return {m: c for m, c in a.items() if U not in m}


def first_order(a: dict) -> dict:
    """The part with u, divided by it."""
    return {tuple(x for x in m if x is not U): c for m, c in a.items() if U in m}


def scaled(a: dict, factor: Any) -> dict:
    return {m: c * factor for m, c in a.items() if c * factor}


def value(a: dict, at: dict) -> Fraction:
    """A polynomial at given numbers, without rounding."""
    return sum((c * prod((x.value(at) for x in m), start=Fraction(1)) for m, c in a.items()), Fraction(0))


def _root(x: Fraction) -> Fraction:
    return Fraction(isqrt(int(x * 2**400)), 2**200)


class Number:
    def __init__(self, exact: dict, size: dict | None = None, lost: dict | None = None, common: Any = 0, unit: Any = 0):
        self.exact, self.lost, self.common, self.unit = exact, lost or {}, Fraction(common), Fraction(unit)
        self.size = {m: abs(c) for m, c in plain(exact).items()} if size is None else size
        self.underflows: dict = {}  # in units of what a product loses where it is subnormal

    def total(self) -> dict:
        """All that rounding may have taken."""
        return joined(self.lost, self.size, self.common)

    def is_constant(self) -> bool:
        return all(set(m) <= {U} for m in self.exact)

    def as_atom(self) -> "Number":
        """Where nothing but whole roundings is lost, a sum as a factor of its own."""
        flat = plain(self.exact)
        if self.lost or len(flat) < 2 or flat != self.exact:
            return self
        return Number({(_atom("sum", flat),): Fraction(1)}, None, None, self.common, self.unit)

    def relative(self) -> Fraction:
        """Roundings of the number as a whole; its terms may only lose where all are positive."""
        worst = Fraction(0)
        for m, c in self.lost.items():
            terms = [x for x in m if not x.is_positive]
            if any(terms.count(x) % 2 for x in terms) or self.exact.get(m, 0) <= 0:
                raise Cancels(m)
            worst = max(worst, c / self.exact[m])
        return worst + self.common

    def is_power_of_two(self) -> bool:
        (m, c), *others = self.exact.items() or [((), Fraction(3))]
        c = abs(c)
        is_power = c.numerator & (c.numerator - 1) == 0 and c.denominator & (c.denominator - 1) == 0
        return not others and is_power and all(x.is_power for x in m) and not self.total()

    def _plus(self, other: Any, sign: int) -> "Number":
        b = numeral(other)
        if not b.exact and not b.size:
            return self
        if not self.exact and not self.size:
            return b if sign > 0 else -b
        if self is b and sign > 0:
            r = Number(scaled(self.exact, 2), scaled(self.size, 2), scaled(self.lost, 2), self.common, self.unit)
            r.underflows = scaled(self.underflows, 2)
            return r
        unit = max(self.unit, b.unit)
        r = Number(joined(self.exact, b.exact, Fraction(sign)), joined(self.size, b.size), None, unit, unit)
        r.lost, r.underflows = joined(self.total(), b.total()), joined(self.underflows, b.underflows)
        return r

    def __add__(self, other: Any) -> "Number":
        return self._plus(other, 1)

    __radd__ = __add__

    def __sub__(self, other: Any) -> "Number":
        b = numeral(other)
        if self.exact == {(): 1} and len(b.exact) == 1:
            (monomial,) = b.exact
            if len(monomial) == 1 and monomial[0].parameter and not b.total():  # a weight of its own
                _, rest, is_dyadic = monomial[0].parameter
                return Number({(rest,): Fraction(1)}, None, None, 0 if is_dyadic else b.unit, b.unit)
        return self._plus(b, -1)

    def __rsub__(self, other: Any) -> "Number":
        return numeral(other) - self

    def __neg__(self) -> "Number":
        r = Number(scaled(self.exact, -1), self.size, self.lost, self.common, self.unit)
        r.underflows = self.underflows
        return r

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Vector):
            return NotImplemented
        a, b = self.as_atom(), numeral(other).as_atom()
        unit = max(a.unit, b.unit)
        is_exact = a.is_power_of_two() or b.is_power_of_two()
        r = Number(times(a.exact, b.exact), times(a.size, b.size))
        r.lost = joined(times(a.lost, b.size), times(a.size, b.lost))
        r.common, r.unit = a.common + b.common + (0 if is_exact else unit), unit
        r.underflows = joined(times(a.underflows, b.size), times(a.size, b.underflows))
        is_constant = a.is_power_of_two() and a.is_constant() or b.is_power_of_two() and b.is_constant()
        r.underflows = joined(r.underflows, {} if is_constant else {(): Fraction(1)})
        return r

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> "Number":
        a, b = self.as_atom(), numeral(other)
        assert b.exact == plain(b.exact), "a quotient by what is enlarged"
        ((m, c), *others) = b.exact.items()
        if not others and all(x.is_power for x in m) and b.is_power_of_two():
            return a * Number({tuple(_atom("1/", {(x,): Fraction(1)}, is_power=True) for x in m): 1 / c})
        inverse, unit = {(_atom("1/", b.exact),): Fraction(1)}, max(a.unit, b.unit)
        r = Number(times(a.exact, inverse), times(a.size, inverse), times(a.lost, inverse), 0, unit)
        r.common = a.common + b.relative() + unit
        return r

    def __rtruediv__(self, other: Any) -> "Number":
        return numeral(other) / self

    def __pow__(self, n: int) -> "Number":
        return self if n == 1 else self * self ** (n - 1)

    def __lt__(self, other: Any) -> Any:
        return compared("<", self, numeral(other))

    def __le__(self, other: Any) -> Any:
        return compared("<=", self, numeral(other))

    def __gt__(self, other: Any) -> Any:
        return compared("<", numeral(other), self)

    def __ge__(self, other: Any) -> Any:
        return compared("<=", numeral(other), self)

    def __abs__(self) -> "Number":
        if len(self.as_atom().exact) == 1:
            ((m, c),) = self.as_atom().exact.items()
            r = Number({tuple(sorted(map(magnitude_of, m))): abs(c)}, None, None, self.common, self.unit)
            r.lost = scaled(self.lost, 1)
        elif self.is_constant():
            return self
        else:
            flat = plain(self.exact)
            r = Number({(_atom("abs", flat, size=self.size),): Fraction(1)}, None, self.lost, self.common, self.unit)
            if self.lost:
                r.lost, r.common = self.total(), Fraction(0)
        r.underflows = self.underflows
        return r


def numeral(x: Any) -> Number:
    if isinstance(x, Number):
        return x
    return Number({(): Fraction(x)} if x else {})


def _atom(kind: str, a: dict, size: dict | None = None, is_power: bool = False) -> Atom:
    """The atom that stands for a sum, its magnitude, root or reciprocal."""
    key = kind, frozenset(a.items())
    if key not in _made:
        text = kind + "(" + " + ".join(f"{c}·{m}" for m, c in sorted(a.items(), key=str)) + ")"
        of = {"sum": lambda x: x, "abs": abs, "1/": lambda x: 1 / x, "root": _root}[kind]
        is_positive = all(c > 0 and all(x.is_positive for x in m) for m, c in a.items())
        _made[key] = Atom(text, lambda at: of(value(a, at)), positive=kind in ("abs", "root") or is_positive)
        _made[key].is_power, _made[key].size = is_power, size
    return _made[key]


def magnitude_of(x: Atom) -> Atom:
    if x.is_positive:
        return x
    if ("of", x) not in _made:
        _made["of", x] = Atom(f"|{x}|", lambda at: abs(x.value(at)), positive=True, covers=frozenset({x}), size=x.size)
    return _made["of", x]


def root(x: Number) -> Number:
    """A square root: half of what is lost under it, and one rounding more."""
    assert x.exact == plain(x.exact)
    atom = _atom("root", x.exact)
    return Number({(atom,): Fraction(1)}, None, None, x.relative() / 2 + x.unit, x.unit)


def extreme(a: Number, b: Number, is_greatest: bool) -> Number:
    """The greater or the lesser of two numbers, as an atom."""
    if a.exact == b.exact:
        return a
    of, which = (a, b), max if is_greatest else min
    atoms = [m[0] for x in of for m, c in x.exact.items() if len(x.exact) == 1 and len(m) == 1 and c == 1]
    covers = frozenset(atoms).union(*(x.covers for x in atoms)) if is_greatest else frozenset()
    key = "extreme", is_greatest, frozenset(frozenset(x.exact.items()) for x in of)
    atom = _made.setdefault(key, Atom(f"{which.__name__} {len(_made)}"))
    atom.covers, atom.of, atom.is_positive = covers, of, len(atoms) == 2 and all(x.is_positive for x in atoms)
    atom.value = lambda at: which(value(x.exact, at) for x in of)
    r = Number({(atom,): Fraction(1)}, unit=max(a.unit, b.unit))
    try:
        r.common = max(a.relative(), b.relative())
    except Cancels:
        lost = a.total(), b.total()
        r.lost = {m: max(x.get(m, Fraction(0)) for x in lost) for m in {**lost[0], **lost[1]}}
    return r


def given(x: Number) -> Number:
    """A computed number as one of its own: what it lost is judged elsewhere."""
    (atom,) = ((_atom("sum", x.exact, size=x.size),) if len(x.exact) > 1 else next(iter(x.exact)))
    return Number({(atom,): Fraction(1)}, unit=x.unit)


# ---- Choices: each by itself ----


class Comparison:
    """A comparison outside of `paths`, for the greater or lesser of two numbers."""

    def __init__(self, a: Number, b: Number) -> None:
        self.of = a, b


class _Path:
    def __init__(self, decisions: list[bool], known: Callable) -> None:
        self.decisions, self.taken, self.conditions, self.known = decisions, 0, [], known

    def decide(self, relation: str, a: Number, b: Number) -> bool:
        for text, c, d, outcome in self.conditions:
            if text == relation and c.exact == a.exact and d.exact == b.exact:
                return outcome
        outcome = self.known(relation, a, b)
        if outcome is None:
            if self.taken == len(self.decisions):
                self.decisions.append(True)
            outcome = self.decisions[self.taken]
            self.taken += 1
        self.conditions.append((relation, a, b, outcome))
        return outcome


_path: list[_Path] = []


def compared(relation: str, a: Number, b: Number) -> Any:
    if a.exact == b.exact:
        return relation == "<="
    if a.is_constant() and b.is_constant():
        x, y = a.exact.get((), 0), b.exact.get((), 0)
        return x < y if relation == "<" else x <= y
    return _path[-1].decide(relation, a, b) if _path else Comparison(a, b)


def paths(function: Callable, known: Callable = lambda *_: None) -> Iterator[tuple[list, Any]]:
    """What a function gives for each outcome of its comparisons, and those; some outcomes may be known."""
    decisions: list[bool] = []
    while True:
        _path.append(_Path(decisions, known))
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
    names = {x.parameter[0] for m in a for x in m}
    degree = {n: max(sum(x.parameter[0] == n for x in m) for m in a) for n in names}
    for n in names:
        raised: dict = {}
        for m, c in a.items():
            missing = degree[n] - sum(x.parameter[0] == n for x in m)
            t, rest = next((x, x.parameter[1]) for k in a for x in k if x.parameter[0] == n)
            for i in range(missing + 1):
                key = tuple(sorted(m + (t,) * i + (rest,) * (missing - i)))
                raised[key] = raised.get(key, 0) + c * comb(missing, i)
        a = raised
    least = {n: min(x for m in a for x in m if x.parameter[0] == n) for n in names}
    return max(c / prod(comb(degree[n], m.count(least[n])) for n in names) for m, c in a.items())


def in_magnitudes(a: dict, covering: set[Atom] = frozenset()) -> dict:
    """A polynomial above it in magnitudes, those of weights apart, with the atoms that cover others in their place."""
    rows: dict = {}
    for m, c in a.items():
        weights = tuple(sorted(x for x in m if x.parameter))
        rest = [next((y for y in covering if x in y.covers), magnitude_of(x)) for x in m if not x.parameter]
        row = rows.setdefault(tuple(sorted(rest)), {})
        row[weights] = row.get(weights, 0) + abs(c)
    return {m: _bernstein(row) for m, row in rows.items()}


def expanded(a: dict) -> dict:
    """A polynomial with the sizes of all atoms that have one in the place of these."""
    r: dict = {}
    for m, c in a.items():
        term = {(): c}
        for x in m:
            term = times(term, {(x,): Fraction(1)} if x.size is None else expanded(x.size))
        r = joined(r, term)
    return r


def share(lost: dict, bound: dict) -> float:
    """How much of a bound is taken by what is lost, on the term on which that is most.

    Of a magnitude what its own bound does not cover is that of the terms that it is made of.
    """
    lost = {m: c for m, c in lost.items() if c > _BESIDE_ROUNDING}
    covering = {x for m in bound for x in m if x.covers}
    covered = frozenset().union(*(x.covers for x in covering))
    composite = {m for m in {**lost, **bound} if any(x.size and x not in covered for x in m)}
    left = {m: c - bound.get(m, 0) for m, c in lost.items() if m in composite and c > bound.get(m, 0)}
    lost = joined({m: c for m, c in lost.items() if m not in composite}, expanded(left))
    above = in_magnitudes({m: c for m, c in bound.items() if m not in composite})
    taken = in_magnitudes(lost, covering)
    return max((float(c / above[m]) if m in above else np.inf for m, c in taken.items()), default=0.0)


# ---- The kernels' own files ----


class Vector:
    def __init__(self, *of: Any) -> None:
        self.of = list(of or (numeral(0),) * 3)

    x, y, z = (property(lambda s, k=k: s.of[k], lambda s, v, k=k: s.of.__setitem__(k, v)) for k in range(3))

    def __getitem__(self, k: int) -> Any:
        return self.of[k]

    def __setitem__(self, k: int, x: Any) -> None:
        self.of[k] = x

    def each(self, f: Callable, *others: "Vector") -> "Vector":
        return Vector(*(f(*x) for x in zip(self.of, *(o.of for o in others), strict=True)))

    def __add__(self, b: "Vector") -> "Vector":
        return self.each(lambda x, y: x + y, b)

    def __sub__(self, b: "Vector") -> "Vector":
        return self.each(lambda x, y: x - y, b)

    def __mul__(self, k: Any) -> "Vector":
        return self.each(lambda x: x * k)

    def __rmul__(self, k: Any) -> "Vector":
        return self.each(lambda x: k * x)

    def __truediv__(self, k: Any) -> "Vector":
        return self.each(lambda x: x / k)

    def __neg__(self) -> "Vector":
        return self.each(lambda x: -x)


def dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return Vector(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


class Function:
    """A function of the kernels, of which overloads are told apart by vectors and numbers."""

    def __init__(self, function: Callable, before: "Function | None") -> None:
        self.overloads, self.scope = [*(before.overloads if before else ()), function], function.__globals__

    def __call__(self, *args: Any) -> Any:
        for function in self.overloads:
            kinds = list(function.__annotations__.values())
            if len(self.overloads) == 1 or all(
                isinstance(x, Vector) == (k is Vector) for x, k in zip(args, kinds, strict=False)
            ):
                return function(*args)
        raise TypeError(args)


class Real:
    """A floating-point type."""

    def __init__(self, house: "House", name: str) -> None:
        self.house, self.__name__ = house, name

    def __call__(self, x: Any = 0.0) -> Any:
        if self.house.dtype is not None:
            return x.astype(self.house.dtype) if isinstance(x, np.ndarray) else self.house.dtype(x)
        unit = self.house.units[self.__name__]
        if isinstance(x, Number) and x.unit:
            if unit > x.unit:  # rounded to fewer digits
                name = f"narrowed({x.exact})"
                exact = x.exact
                atom = _made.setdefault((name,), Atom(name, lambda at: value(exact, at), size=x.size))
                x = x if len(x.exact) == 1 else Number({(atom,): Fraction(1)}, None, x.total())
                r = Number(x.exact, x.size, x.lost, x.common + unit, unit)
                r.underflows = {(): Fraction(1)}
                return r
            r = Number(x.exact, x.size, x.lost, x.common, unit)
            r.underflows = x.underflows
            return r
        if isinstance(x, Number):
            constant = x.exact.get((), Fraction(0))
            is_exact = (constant * 2**20).denominator == 1 or not constant
            return Number(x.exact, None, None, 0 if is_exact else unit)
        exact = Fraction(x) if np.isfinite(x) else Fraction(2) ** 1024
        simple = exact.limit_denominator(2 * 10**11)
        if simple != exact and float(simple) == x:
            return Number({(): simple}, None, None, unit)
        near = Fraction(round(exact * 2**20), 2**20) if abs(x) < 2**20 else exact
        more = (exact - near) * 2**53
        if near and more and more.denominator == 1 and abs(more) < 2**12:
            return Number({(): near, (U,): more})
        return Number({(): exact} if exact else {})


class House:
    """The kernels' files, executed as plain Python: on counted numbers, or on arrays with a dtype.

    Args:
        real: Precision of the iteration.
        dtype: Of the arrays, or None.
        cuts: Variables of functions that are numbers of their own as soon as they are set, and to be judged as such.
        edits: Files by name, each with a text and what stands in its place.
    """

    def __init__(self, real: str = "float64", dtype: Any = None, cuts: Any = (), edits: Any = ()) -> None:
        self.real, self.dtype, self.cuts, self.edits = real, dtype, dict(cuts), dict(edits)
        self.units = {"float64": Fraction(1), "float32": Fraction(2**29)}
        if real == "float32":
            self.units = {"float64": Fraction(1, 2**29), "float32": Fraction(1)}
        self.types = {name: Real(self, name) for name in self.units}
        self.loaded: dict = {}
        self.cut: dict[str, Number] = {}  # by the name of the variable
        self.num_scales = 0

    def load(self, name: str, **parameters: Any) -> Any:
        """A file by name, as in ``pair.volume``."""
        parameters = {**_PARAMETERS, "real": self.real, **parameters}
        key = name, *(v if isinstance(v, str | int) else v.__name__ for v in parameters.values())
        if key in self.loaded:
            return self.loaded[key]
        module = self.loaded[key] = types.ModuleType(name)
        source = (_FOLDER / f"{name.replace('.', '/')}.py").read_text(encoding="utf-8")
        if name in self.edits:
            text, new = self.edits[name]
            assert text in source, f"{text} is not in {name}"
            source = source.replace(text, new)
        tree = ast.parse(source)
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                for variable in self.cuts.get((name, node.name), ()):
                    self._cut_after(node, variable)

        def imported(what: str, scope: Any = None, local: Any = None, wanted: Any = (), level: int = 0) -> Any:
            if level == 0:
                return self.warp() if what == "warp" else builtins.__import__(what, scope, local, wanted, level)
            folder = name.split(".")[:-1]
            path = [*folder[: len(folder) - level + 1], *filter(None, what.split("."))]
            if path == ["template"]:
                return types.SimpleNamespace(specialised=lambda n, **p: self.load(n, **{"real": "float64", **p}))
            if path == ["parameters"]:
                real = parameters["real"]
                return types.SimpleNamespace(**parameters | {"real": self.types.get(getattr(real, "__name__", real))})
            if (_FOLDER / "/".join(path)).is_dir():
                return types.SimpleNamespace(**{w: self.load(".".join([*path, w]), **parameters) for w in wanted})
            return self.load(".".join(path), **parameters)

        module.__dict__["__builtins__"] = {**vars(builtins), "__import__": imported}
        module.__dict__["cut_"] = self._cut
        exec(compile(ast.fix_missing_locations(tree), name, "exec"), module.__dict__)
        if name == "pair.rounding":
            one = Number({(U,): Fraction(1)})
            of = {t: Number(scaled(one.exact, self.units[t.__name__])) for t in self.types.values()}
            if self.dtype is None:
                module.UNIT_ROUNDOFF = of
                module.EIGHTH_UP = 0.125 * (1.0 + module.SAGITTA * of[self.types["float64"]])
        if name == "pair.simd":
            module.func = module.rare = self._function
            if self.dtype is not None:
                module.bits_of = lambda m: int(np.any(m))
        if name in ("pair.rounding", "pair.lane_scale") and self.dtype is None:
            module.inverse_power_of_two = self._power
        return module

    def _cut_after(self, function: ast.FunctionDef, variable: str) -> None:
        for k, node in reversed(list(enumerate(function.body))):
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == variable:
                function.body.insert(k + 1, ast.parse(f"{variable} = cut_({variable!r}, {variable})").body[0])
                return
        raise LookupError(f"{variable} is not set in {function.name}")

    def _cut(self, name: str, x: Any) -> Any:
        self.cut[name] = x
        if isinstance(x, Vector):
            return Vector(*(number(name + k, unit=x.x.unit) for k in "xyz"))
        atom = Atom(name, lambda at: value(x.exact, at), positive=True)
        return Number({(atom,): Fraction(1)}, unit=x.unit)

    def _power(self, x: Any) -> Number:
        self.num_scales += 1
        atom = Atom(f"scale {self.num_scales}", lambda at: Fraction(1, 4), positive=True, power=True)
        return Number({(atom,): Fraction(1)}, unit=self.units["float64"])

    def _function(self, f: Callable | None = None, **_: Any) -> Any:
        if f is None:
            return self._function
        before = f.__globals__.get(f.__name__) if "<locals>" not in f.__qualname__ else None
        is_same = isinstance(before, Function) and before.scope is f.__globals__
        return Function(f, before if is_same else None)

    def _native(self, snippet: str) -> Callable:
        """A function of C++ whose last line returns an expression; others cannot be called."""
        scope = dict.fromkeys(("lanes", "mask", "of_lanes", "of_mask"), lambda x: x)
        scope |= {"fabs": abs, "choose": self.choose, "opposite": lambda m: ~m if isinstance(m, np.ndarray) else not m}

        def expression() -> str:
            text = re.sub(r"\(Lanes\)|\(Mask\)", "", snippet[snippet.rindex("return ") + 7 :].rpartition(";")[0])
            text = re.sub(r"\bx\b", "a", re.sub(r"\by\b", "b", text))
            text = re.sub(r"^(\w+)\((.+) \? (.+) : (.+)\)$", r"\1(choose(\2, \3, \4))", text)
            return re.sub(r"!(\w+\(m\))", r"opposite(\1)", text)

        def decorate(f: Callable) -> Any:
            names = f.__code__.co_varnames[: f.__code__.co_argcount]
            native = types.FunctionType(f.__code__, f.__globals__, f.__name__)
            made = self._function(native)
            made.overloads[-1] = lambda *args: eval(expression(), scope, dict(zip(names, args, strict=True)))
            made.overloads[-1].__annotations__ = f.__annotations__
            return made

        return decorate

    def choose(self, m: Any, a: Any, b: Any) -> Any:
        if isinstance(a, Vector):
            return a.each(lambda x, y: self.choose(m, x, y), b)
        if isinstance(m, Comparison):
            assert {id(a), id(b)} == {id(x) for x in m.of}, "a choice outside of paths"
            return extreme(a, b, m.of[0] is b)
        return np.where(m, a, b) if isinstance(m, np.ndarray) else a if m else b

    def _reduced(self, is_greatest: bool) -> Callable:
        def of_two(a: Any, b: Any) -> Any:
            if isinstance(a, int) and isinstance(b, int):
                return max(a, b) if is_greatest else min(a, b)
            return self.choose(b < a if is_greatest else a < b, a, b)

        def reduced(a: Any, b: Any = None) -> Any:
            if b is None:
                return of_two(of_two(a[0], a[1]), a[2])
            return a.each(of_two, b) if isinstance(a, Vector) else of_two(a, b)

        return reduced

    def root(self, x: Any) -> Any:
        return root(x) if isinstance(x, Number) else np.sqrt(x)

    def warp(self) -> Any:
        """What the files know as Warp."""
        if not hasattr(self, "_warp"):
            identity, wp = (lambda x: x), types.ModuleType("warp")
            self._warp = wp

            def other(name: str) -> Any:
                return _Anything

            def struct(cls: type) -> type:
                def make(self_: Any) -> None:
                    for field, kind in cls.__annotations__.items():
                        setattr(self_, field, kind() if kind is not _Anything else None)

                cls.__init__ = make
                return cls

            vars(wp).update(self.types, struct=struct, constant=identity, static=identity, func=self._function)
            vars(wp).update(func_native=self._native, kernel=self._function, where=self.choose, sqrt=self.root)
            vars(wp).update(dict.fromkeys(("uint32", "int32", "int64", "uint64"), int), bool=bool, inf=float("inf"))
            vars(wp).update(dict.fromkeys(("vec3d", "vec4d", "vec2d"), Vector), max=self._reduced(True), floor=np.floor)
            vars(wp).update(min=self._reduced(False), dot=dot, cross=cross, nan=float("nan"), __getattr__=other)
            wp.abs = lambda x: x.each(abs) if isinstance(x, Vector) else abs(x)
            wp.cast = lambda x, _: x
            wp.length = lambda x: self.root(dot(x, x))
            wp.cw_mul = lambda a, b: a.each(lambda x, y: x * y, b)
            vector = lambda length, dtype: Vector if length == 3 else _Anything  # noqa: E731
            wp.types = types.SimpleNamespace(vector=vector, matrix=lambda **_: _Anything)
        return self._warp


class _Anything:
    """What no function that is executed asks for."""

    def __class_getitem__(cls, _: Any) -> Any:
        return cls

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def __call__(self, *args: Any, **_: Any) -> Any:
        return args[0] if args else self


# ---- Numbers of the input ----


def number(name: str, roundings: Any = 0, *, unit: Any = 1, positive: bool = False) -> Number:
    atom = _made.setdefault(("input", name, positive), Atom(name, positive=positive))
    return Number({(atom,): Fraction(1)}, None, None, roundings, unit)


def vector(name: str, roundings: Any = 0, **more: Any) -> Vector:
    return Vector(*(number(name + k, roundings, **more) for k in "xyz"))


def parameter(name: str, *, is_dyadic: bool = False) -> Number:
    """A number in [0, 1], whose difference from 1 is an atom, too."""
    x = number(name, positive=True)
    (atom,) = next(iter(x.exact))
    if atom.parameter is None:
        rest = Atom(f"1-{name}", lambda at: 1 - at[name], positive=True)
        atom.parameter, rest.parameter = (name, rest, is_dyadic), (name, atom, is_dyadic)
    return x
