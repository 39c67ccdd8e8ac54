"""Values that no argument expects, and arrays in disguise: what `test_hostile_arguments` throws at every function."""

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


def _recursive_list():
    values = []
    values.append(values)
    return values


# By name, so that a failure says which; made anew for each call.
VALUES = {
    "None": lambda: None,
    "empty list": lambda: [],
    "empty dict": lambda: {},
    "nested empty list": lambda: [[]],
    "object": object,
    "class": lambda: np.ndarray,
    "function": lambda: len,
    "text": lambda: "text",
    "empty text": lambda: "",
    "text with a null": lambda: "a\0b",
    "bytes": lambda: b"\x00",
    "bool": lambda: True,
    "numpy bool": lambda: np.True_,
    "0-d float array": lambda: np.array(0.5),
    "0-d int array": lambda: np.array(1),
    "0-d bool array": lambda: np.array(True),
    "huge int": lambda: 10**400,
    "huge negative int": lambda: -(10**400),
    "int that cannot be written out": lambda: 10**5000,
    "int beyond float64": lambda: 2**53 + 1,
    "largest uint64": lambda: np.uint64(2**64 - 1),
    "minus one": lambda: -1,
    "nan": lambda: float("nan"),
    "inf": lambda: float("inf"),
    "minus inf": lambda: -np.inf,
    "negative zero": lambda: -0.0,
    "numpy nan": lambda: np.float32("nan"),
    "a third": lambda: Fraction(1, 3),
    "fraction": lambda: Fraction(1, 2),
    "decimal": lambda: Decimal("0.5"),
    "rounded longdouble": lambda: np.longdouble(1) / 3,
    "longdouble beyond float64": lambda: np.longdouble(10) ** 400,
    "longdouble": lambda: np.longdouble("0.5"),
    "float16": lambda: np.float16(0.5),
    "complex": lambda: 0.5 + 0j,
    "set": lambda: {0, "a"},
    "generator": lambda: (k for k in ("x", 0.5)),
    "ragged list": lambda: [[1.0, 2.0], [3.0]],
    "list of unhashables": lambda: [{}, []],
    "recursive list": _recursive_list,
    "long list": lambda: ["spam"] * 100_000,
    "masked": lambda: np.ma.masked,
    "masked array": lambda: np.ma.array([0, 1], mask=[False, True]),
    "object array": lambda: np.array([object(), None], dtype=object),
    "structured array": lambda: np.zeros(2, dtype=[(f"field_{k}", "f8") for k in range(30)]),
    "array of texts": lambda: np.array(["a", "b"]),
    "array of dates": lambda: np.array(["2020-01-01"], dtype="datetime64[D]"),
    "raises as array": RaisesAsArray,
    "raises as text": RaisesAsText,
}


def _masked(array):
    return np.ma.array(array)


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


def _strided(array):
    return np.repeat(array, 2, axis=-1)[..., ::2]


def _replaced(array, value, dtype):
    array = array.astype(dtype)
    array.flat[-1] = value
    return array


# The same numbers in another form. All hold whole numbers below 100, which every dtype here holds.
SAME = {
    "list": lambda a, _: a.tolist(),
    "tuple": lambda a, _: tuple(a.tolist()),
    "list of arrays": lambda a, _: list(a),
    "byte order": lambda a, _: a.astype(a.dtype.newbyteorder()),
    "strided": lambda a, _: _strided(a),
    "reversed memory": lambda a, _: a[::-1].copy()[::-1],
    "column order": lambda a, _: np.asfortranarray(a),
    "read-only": lambda a, _: _read_only(a),
    "memory-mapped": _memory_mapped,
    "without a mask": lambda a, _: _masked(a),
    "of another library": lambda a, _: HasArray(a),
}
SAME_REALS = {
    dtype: lambda a, _, dtype=dtype: a.astype(dtype)
    for dtype in ("float16", "float32", "longdouble", "int8", "int32", "int64", "uint8", "uint64")
} | {"list of ints and floats": lambda a, _: [*a[:-1].tolist(), a[-1].astype(int).tolist()]}
SAME_INTEGERS = {dtype: lambda a, _, dtype=dtype: a.astype(dtype) for dtype in ("int8", "uint16", "uint64")}

# Numbers that are hidden, or not what they would be read as; a word of the message that says so.
OTHER = {
    "with a mask": (lambda a: _with_mask(a), "masked"),
    "list of masked rows": (lambda a: [*a[:-1], _with_mask(a[-1])], "masked"),
    "complex": (lambda a: a.astype(complex), "complex128"),
    "texts": (lambda a: a.astype(str), "<U"),
    "objects": (lambda a: a.astype(object), "object"),
    "structure": (lambda a: np.zeros(a.shape, dtype=[("x", "f8")]), "[('x', '<f8')]"),
    "dates": (lambda a: a.astype("datetime64[s]"), "datetime64"),
}
OTHER_REALS = {
    "bools": (lambda a: a.astype(bool), "bool"),
    "int64 beyond float64": (lambda a: _replaced(a, 2**53 + 1, "int64"), str(2**53 + 1)),
    "negative int64 beyond float64": (lambda a: _replaced(a, -(2**63) + 1, "int64"), str(-(2**63) + 1)),
    "uint64 beyond float64": (lambda a: _replaced(a, 2**64 - 1, "uint64"), str(2**64 - 1)),
    "list of floats and an int beyond float64": (
        lambda a: [*a[:-1].tolist(), _replaced(a[-1], 2**53 + 1, object).tolist()],
        str(2**53 + 1),
    ),
    "nan": (lambda a: _replaced(a, np.nan, "float64"), "nan"),
    "inf": (lambda a: _replaced(a, np.inf, "float32"), "inf"),
}
if np.finfo(np.longdouble).nmant > 52:
    OTHER_REALS |= {
        "rounded longdouble": (lambda a: _replaced(a, np.longdouble(1) / 3, "longdouble"), "0.33333333333333333"),
        "longdouble beyond float64": (lambda a: _replaced(a, np.longdouble(10) ** 400, "longdouble"), "e+400"),
    }
OTHER_INTEGERS = {
    "floats": (lambda a: a.astype(float), "float64"),
    "uint64 beyond int64": (lambda a: _replaced(a, 2**64 - 1, "uint64"), str(2**64 - 1)),
}
