"""Structs of kernels that are tables: the types of their columns, and one made of arrays."""

from collections.abc import Mapping
from typing import Any

import warp as wp


def dtypes_of(struct: Any) -> dict[str, Any]:
    """The types of the columns of a table by name: of its arrays with one index, but for the number of rows."""
    return {name: field.type.dtype for name, field in struct.vars.items() if name != "count" and field.type.ndim == 1}


def struct_of(struct: Any, arrays: Mapping[str, wp.array]) -> Any:
    """A struct of these arrays; fields that are not named are empty."""
    packed = struct()
    for name, array in arrays.items():
        setattr(packed, name, array)
    return packed
