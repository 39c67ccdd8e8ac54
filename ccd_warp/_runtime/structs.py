"""Structs of kernels that are tables: the types of their columns, and one made of arrays."""

from collections.abc import Mapping
from typing import Any

import warp as wp


def dtypes_of(struct: Any) -> dict[str, Any]:
    """The types of the columns of a table by name: of its arrays with one index, but for the number of rows."""
    return {name: field.type.dtype for name, field in struct.vars.items() if name != "count" and field.type.ndim == 1}


def on_host(dtype: type) -> tuple[Any, tuple[int, ...]]:
    """The type of NumPy, and the shape of an element, of an array of this type of Warp."""
    return wp.dtype_to_numpy(getattr(dtype, "_wp_scalar_type_", dtype)), tuple(getattr(dtype, "_shape_", ()))


def struct_of(struct: Any, arrays: Mapping[str, wp.array]) -> Any:
    """A struct of these arrays; fields that are not named are empty."""
    packed = struct()
    for name, array in arrays.items():
        setattr(packed, name, array)
    return packed
