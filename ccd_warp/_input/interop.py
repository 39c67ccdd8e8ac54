"""Arrays of other libraries as Warp arrays, in the same memory."""

from typing import Any

import numpy as np
import warp as wp

from ccd_warp._input.arguments import check_unmasked, on_one_line, shown
from ccd_warp._runtime.launch import start_warp

# Device types of DLPack: CUDA; and the CPU, and host memory that CUDA has pinned or manages.
_CUDA = 2
_HOST_MEMORY = (1, 3, 13)
_VECTORS = {wp.float32: wp.vec3f, wp.float64: wp.vec3d}


def is_device_array(value: Any) -> bool:
    """Whether a value is an array of Warp, or of a library that speaks DLPack, other than NumPy."""
    return isinstance(value, wp.array) or (_speaks_dlpack(value) and not isinstance(value, np.ndarray))


def _speaks_dlpack(value: Any) -> bool:
    """Whether it is an array that can be shared; the class of one has the same names."""
    return hasattr(value, "__dlpack__") and not isinstance(value, type)


def _reason(error: Exception) -> str:
    """What another library says, in a line, and what it should be able to do."""
    return f"{on_one_line(str(error))}; expected one that can"


def as_warp(value: Any, name: str) -> wp.array:
    """A Warp array in the memory of an array of Warp, NumPy, or any library that speaks DLPack.

    Raises:
        ValueError: If it is no such array, or does not let itself be shared.
    """
    if isinstance(value, wp.array):
        return value
    start_warp()
    if isinstance(value, np.ndarray):
        check_unmasked(name, value)
        if not value.flags.c_contiguous:
            raise ValueError(f"{name} has strides {value.strides}; expected a contiguous array, which needs no copy")
        if value.dtype not in (np.float32, np.float64):
            raise ValueError(f"{name} has dtype {shown(value.dtype)}; expected float32 or float64")
        return wp.array(value, dtype=wp.dtype_from_numpy(value.dtype), device="cpu", copy=False)
    if not _speaks_dlpack(value):
        raise ValueError(f"{name} is a {type(value).__name__}; expected an array of Warp, NumPy, or with DLPack")
    kind, index = _place(value, name)
    if kind == _CUDA and index >= wp.get_cuda_device_count():
        names = ", ".join(device.alias for device in wp.get_devices())
        raise ValueError(f"{name} is a {type(value).__name__} on cuda:{index}; expected it on one of {names}")
    try:
        return wp.from_dlpack(value)  # type: ignore[return-value]
    except Exception as error:  # whatever the other library raises
        raise ValueError(f"{name} is a {type(value).__name__} that cannot be shared: {_reason(error)}") from error


def _place(value: Any, name: str) -> tuple[int, int]:
    """Type and index of the device of an array, as DLPack counts them."""
    try:
        kind, index = value.__dlpack_device__()
    except Exception as error:  # whatever the other library raises
        raise ValueError(f"{name} is a {type(value).__name__} that cannot be shared: {_reason(error)}") from error
    return int(kind), int(index)


def on_host(value: Any, name: str) -> Any:
    """What NumPy reads where it is: arrays of other libraries too, unless they are on a GPU.

    Raises:
        ValueError: If they are.
    """
    if is_device_array(value) and _place(value, name)[0] not in _HOST_MEMORY:
        raise ValueError(
            f"{name} is a {type(value).__name__} on a GPU; expected an array on the host, "
            f"or CollisionPipeline.launch, which takes arrays on its device"
        )
    return value.numpy() if isinstance(value, wp.array) else value


def check_writable(value: Any, name: str) -> None:
    """Check that an array may be written to.

    Raises:
        ValueError: If its library says that it does not change.
    """
    if isinstance(value, wp.array):
        return
    if type(value).__module__.partition(".")[0] in ("jax", "jaxlib"):
        raise ValueError(f"{name} is an array of JAX, which does not change; expected one that can be written to")
    if isinstance(value, np.ndarray) and not value.flags.writeable:
        raise ValueError(f"{name} is read-only; expected an array that can be written to")


def as_positions(value: Any, name: str, device: Any, expected: dict[int, str]) -> wp.array:
    """Positions as vec3f or vec3d of shape [n], in the memory of the array given.

    Args:
        value: Array of vec3f or vec3d, shape [n], or of float32 or float64, shape [n, 3].
        name: Name of the argument, for the messages.
        device: Where it has to be.
        expected: Numbers of rows that will do, and what these are.

    Returns:
        The array.

    Raises:
        ValueError: If the array is of another kind, device, shape or layout.
    """
    array: Any = as_warp(value, name)
    if array.device != device:
        raise ValueError(f"{name} is on {array.device.alias}; expected {device.alias}, where the pipeline is")
    if not array.is_contiguous and array.size:
        raise ValueError(f"{name} has strides {array.strides}; expected a contiguous array, which needs no copy")
    dtype, shape = array.dtype, array.shape
    if dtype in _VECTORS and array.ndim == 2 and shape[1] == 3:
        dtype, shape = _VECTORS[dtype], shape[:1]
    if dtype not in _VECTORS.values() or len(shape) != 1:
        raise ValueError(
            f"{name} has dtype {dtype.__name__} and shape {array.shape}; "
            f"expected vec3f or vec3d and (n,), or float32 or float64 and (n, 3)"
        )
    if shape[0] not in expected:
        rows = " or ".join(f"{count}, {meaning}" for count, meaning in expected.items())
        raise ValueError(f"{name} has {shape[0]} rows; expected {rows}")
    if dtype is array.dtype:
        return array
    if shape[0] == 0:
        return wp.empty(0, dtype=dtype, device=array.device)
    alias: wp.array = wp.array(ptr=array.ptr, dtype=dtype, shape=shape, device=array.device, copy=False)
    alias._ref = array  # type: ignore[assignment]  # keeps the memory
    return alias
