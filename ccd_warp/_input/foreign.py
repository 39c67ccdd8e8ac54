"""Arrays of other libraries: what they are, and on which device."""

from typing import Any

import numpy as np
import warp as wp

from ccd_warp._input.arguments import on_one_line

# Device types of DLPack: the CPU, and host memory that CUDA has pinned or manages.
_HOST_MEMORY = (1, 3, 13)


def is_device_array(value: Any) -> bool:
    """Whether a value is an array of Warp, or of a library other than NumPy that supports DLPack."""
    return isinstance(value, wp.array) or (speaks_dlpack(value) and not isinstance(value, np.ndarray))


def speaks_dlpack(value: Any) -> bool:
    """Whether a value is an array that can be shared, and not a class of such arrays."""
    return hasattr(value, "__dlpack__") and not isinstance(value, type)


def is_of_jax(value: Any) -> bool:
    """Whether a value is an array of JAX."""
    return type(value).__module__.partition(".")[0] in ("jax", "jaxlib")


def reason_of(error: Exception) -> str:
    """The error message of another library on one line, and what was expected."""
    return f"{on_one_line(str(error))}; expected one that can"


def place_of(value: Any, name: str) -> tuple[int, int]:
    """Type and index of the device of an array, in the numbering of DLPack."""
    try:
        kind, index = value.__dlpack_device__()
    except Exception as error:  # whatever the other library raises
        raise ValueError(f"{name} is a {type(value).__name__} that cannot be shared: {reason_of(error)}") from error
    return int(kind), int(index)


def on_host(value: Any, name: str) -> Any:
    """The value as NumPy can read it in place; arrays of other libraries must not be on a GPU.

    Raises:
        ValueError: If it is an array on a GPU, or one that NumPy cannot read, as a tensor that requires a gradient.
    """
    if is_device_array(value) and place_of(value, name)[0] not in _HOST_MEMORY:
        raise ValueError(
            f"{name} is a {type(value).__name__} on a GPU; expected an array on the host, "
            f"or CollisionPipeline.launch, which takes arrays on its device"
        )
    if isinstance(value, wp.array):
        return value.numpy()
    if not is_device_array(value):
        return value
    try:
        return np.asarray(value)
    except Exception as error:  # whatever the other library raises
        raise ValueError(f"{name} is a {type(value).__name__} that cannot be shared: {reason_of(error)}") from error
