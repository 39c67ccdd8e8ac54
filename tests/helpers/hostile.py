"""Values that no argument expects, and arrays in disguise: what `test_bad_arguments` throws at every function."""

from decimal import Decimal
from fractions import Fraction

import numpy as np


class RaisesAsArray:
    """Refuses to become an array, in its own way."""

    def __array__(self, *_, **__):
        raise RuntimeError("not today")


class RaisesAsText:
    """Cannot even be shown."""

    def __repr__(self):
        raise RuntimeError("not today")


class HasArray:
    """An array of a library that NumPy reads by __array__, as pandas' are."""

    def __init__(self, values):
        self._values = values

    def __array__(self, dtype=None, copy=None):
        return np.array(self._values, dtype=dtype)


def values():
    """By name, so that a failure says which; made anew for each call."""
    recursive = []
    recursive.append(recursive)
    long = np.longdouble
    return {
        **{"None": None, "empty list": [], "empty dict": {}, "nested empty list": [[]], "object": object()},
        **{"class": np.ndarray, "function": len, "text": "text", "empty text": "", "text with a null": "a\0b"},
        **{"bytes": b"\x00", "bool": True, "numpy bool": np.True_, "complex": 0.5 + 0j, "set": {0, "a"}},
        **{f"0-d {x.dtype} array": x for x in (np.array(0.5), np.array(1), np.array(True))},
        **{"huge int": 10**400, "huge negative int": -(10**400), "int that cannot be written out": 10**5000},
        **{"int beyond float64": 2**53 + 1, "largest uint64": np.uint64(2**64 - 1), "minus one": -1},
        **{"nan": np.nan, "inf": np.inf, "minus inf": -np.inf, "negative zero": -0.0, "numpy nan": np.float32("nan")},
        **{"a third": Fraction(1, 3), "fraction": Fraction(1, 2), "decimal": Decimal("0.5"), "longdouble": long("0.5")},
        **{"rounded longdouble": long(1) / 3, "longdouble beyond float64": long(10) ** 400, "float16": np.float16(0.5)},
        **{"generator": (k for k in ("x", 0.5)), "ragged list": [[1.0, 2.0], [3.0]], "list of unhashables": [{}, []]},
        **{"recursive list": recursive, "long list": ["spam"] * 100_000, "array of texts": np.array(["a", "b"])},
        **{"masked": np.ma.masked, "masked array": np.ma.array([0, 1], mask=[False, True])},
        "object array": np.array([object(), None], dtype=object),
        "structured array": np.zeros(2, dtype=[(f"field_{k}", "f8") for k in range(30)]),
        "array of dates": np.array(["2020-01-01"], dtype="datetime64[D]"),
        **{"raises as array": RaisesAsArray(), "raises as text": RaisesAsText()},
    }


def _with_mask(array):
    mask = np.zeros(array.shape, dtype=bool)
    mask.flat[-1] = True
    return np.ma.array(array, mask=mask)


def _memory_mapped(array, folder):
    mapped = np.memmap(folder / "array.bin", dtype=array.dtype, mode="w+", shape=array.shape)
    mapped[...] = array
    return mapped


def _read_only(array):
    array = array.copy()
    array.flags.writeable = False
    return array


def _replaced(array, value, dtype):
    array = array.astype(dtype)
    array.flat[-1] = value
    return array


def same(a, folder):
    """The same numbers in other forms. All hold whole numbers below 100, which every dtype here holds."""
    yield from (a.tolist(), tuple(a.tolist()), list(a), a.astype(a.dtype.newbyteorder()), HasArray(a))
    yield from (np.repeat(a, 2, axis=-1)[..., ::2], a[::-1].copy()[::-1], np.array(a, order="F"), _read_only(a))
    yield from (_memory_mapped(a, folder), np.ma.array(a, copy=True))
    if a.dtype.kind != "f":
        yield from (a.astype(dtype) for dtype in ("int8", "uint16", "uint64"))
        return
    dtypes = ("float16", "float32", "longdouble", "int8", "int32", "int64", "uint8", "uint64")
    yield from (a.astype(dtype) for dtype in dtypes)
    yield [*a[:-1].tolist(), a[-1].astype(int).tolist()]


def hidden(a):
    """Numbers that are hidden, or not what they would be read as, and a word of the message that says so."""
    yield from ((_with_mask(a), "masked"), ([*a[:-1], _with_mask(a[-1])], "masked"), (a.astype(complex), "complex128"))
    yield from ((a.astype(str), "<U"), (a.astype(object), "object"), (a.astype("datetime64[s]"), "datetime64"))
    yield np.zeros(a.shape, dtype=[("x", "f8")]), "[('x', '<f8')]"
    if a.dtype.kind != "f":
        yield from ((a.astype(float), "float64"), (_replaced(a, 2**64 - 1, "uint64"), str(2**64 - 1)))
        return
    yield a.astype(bool), "bool"
    for value, dtype in ((2**53 + 1, "int64"), (-(2**63) + 1, "int64"), (2**64 - 1, "uint64")):
        yield _replaced(a, value, dtype), str(value)
    yield from ((_replaced(a, np.nan, "float64"), "nan"), (_replaced(a, -np.inf, "float32"), "-inf"))
    if np.finfo(np.longdouble).nmant > 52:
        yield _replaced(a, np.longdouble(1) / 3, "longdouble"), "0.33333333333333333"
        yield _replaced(a, np.longdouble(10) ** 400, "longdouble"), "e+400"
