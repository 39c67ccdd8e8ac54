"""Arrays of other libraries as Warp arrays, in the same memory."""

from collections.abc import Collection
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ccd_warp._runtime.quiet import start_warp
from ccd_warp._scene.input.arguments import check_unmasked, shown
from ccd_warp._scene.input.arrays import SupportsDLPack, has_dlpack, is_of_jax, place_of, reason_of

# Device types of CUDA in DLPack: memory of a GPU, host memory that CUDA has pinned, and memory that it manages.
_CUDA, _PINNED, _MANAGED = 2, 3, 13
# The stream for which a library should make its array ready, by which it is told not to synchronize at all.
_NO_SYNCHRONIZATION = -1
_VECTORS = {
    3: {wp.float32: wp.vec3f, wp.float64: wp.vec3d},
    2: {wp.float32: wp.vec2f, wp.float64: wp.vec2d},
}


# An array that a launch reads where it is.
DeviceArray = wp.array | NDArray[np.floating[Any]] | SupportsDLPack


def as_warp(value: object, name: str) -> wp.array:
    """A Warp array that shares the memory of an array of Warp, NumPy, or any library that supports DLPack.

    Raises:
        ValueError: If it is not such an array, or cannot be shared.
    """
    if isinstance(value, wp.array):
        return _without_odd_strides(value)
    start_warp()
    if isinstance(value, np.ndarray):
        check_unmasked(name, value)
        if not value.flags.c_contiguous:
            raise ValueError(f"{name} has strides {value.strides}; expected a contiguous array, which needs no copy")
        if value.dtype not in (np.float32, np.float64):
            raise ValueError(f"{name} has dtype {shown(value.dtype)}; expected float32 or float64")
        shared: wp.array = wp.array(value, dtype=wp.dtype_from_numpy(value.dtype), device="cpu", copy=False)
        return _without_odd_strides(shared)
    if not has_dlpack(value):
        raise ValueError(f"{name} is a {type(value).__name__}; expected an array of Warp, NumPy, or with DLPack")
    kind, index = place_of(value, name)
    if kind == _CUDA and index >= wp.get_cuda_device_count():
        names = ", ".join(device.alias for device in wp.get_devices())
        raise ValueError(f"{name} is a {type(value).__name__} on cuda:{index}; expected it on one of {names}")
    try:
        return _without_odd_strides(wp.from_dlpack(_exported(value, kind, index)))
    except Exception as error:  # whatever the other library raises
        raise ValueError(f"{name} is a {type(value).__name__} that cannot be shared: {reason_of(error)}") from error


def _without_odd_strides(array: Any) -> wp.array:
    """The array; a contiguous one in the same memory where strides along axes of length 1 alone are in the way."""
    if array.is_contiguous or array.requires_grad:
        return array  # type: ignore[no-any-return]
    step = wp.types.type_size_in_bytes(array.dtype)
    for length, stride in zip(array.shape[::-1], array.strides[::-1], strict=True):
        if length != 1 and stride != step:
            return array  # type: ignore[no-any-return]
        step *= length
    dense: wp.array = wp.array(ptr=array.ptr, dtype=array.dtype, shape=array.shape, device=array.device, copy=False)
    dense._ref = array  # type: ignore[assignment]  # keeps the memory alive
    return dense


def _exported(value: SupportsDLPack, kind: int, index: int) -> Any:
    """What ``wp.from_dlpack`` can take for an array: itself, or a capsule where Warp would name a wrong stream.

    Warp names its current stream, and the library that owns the array lets that stream wait for its own: it records an
    event there. While the stream is captured into a graph, CUDA refuses to wait for an event from outside the capture,
    and the whole capture is lost. Nothing has to wait then, because nothing reads the array before the graph is
    replayed; who replays it sees to the order.

    References:
        Array API standard, ``__dlpack__``: a stream of -1 says that the producer must not synchronize, and devices
        without streams take None alone.
    """
    if kind == _PINNED:
        return value.__dlpack__(stream=None)  # PyTorch refuses a stream here, because the tensor is on the CPU
    if kind in (_CUDA, _MANAGED) and wp.get_cuda_device(index).is_capturing:
        # JAX takes -1 for the address of a stream; without a stream it waits on the host, and no stream is touched
        return value.__dlpack__(stream=None if is_of_jax(value) else _NO_SYNCHRONIZATION)
    return value


def vector_of(array: np.ndarray) -> Any:
    """The type of Warp of the rows of an array of NumPy, of float32 or float64, shape [n, 3] or [n, 2]."""
    return _VECTORS[array.shape[1]][wp.dtype_from_numpy(array.dtype)]


def check_writable(value: object, name: str) -> None:
    """Check that an array may be written to.

    Raises:
        ValueError: If its library declares it immutable.
    """
    if isinstance(value, wp.array):
        return
    if is_of_jax(value):
        raise ValueError(f"{name} is an array of JAX, which does not change; expected one that can be written to")
    if isinstance(value, np.ndarray) and not value.flags.writeable:
        raise ValueError(f"{name} is read-only; expected an array that can be written to")


def without_worlds(value: Any, name: str, by_world: Collection[tuple[int, int]], dimension: int) -> Any:
    """Positions with an axis of worlds as an array without it, in the same memory; others as they are.

    Args:
        value: Array of vec3f or vec3d, shape [W, n], or of float32 or float64, shape [W, n, 3]; or of another shape.
        name: Name of the argument, for the messages.
        by_world: The accepted (W, n).
        dimension: 3, or 2 in the plane, with vec2f and vec2d.

    Raises:
        ValueError: If it is not an array that can be shared.
    """
    is_array = isinstance(value, (wp.array, np.ndarray)) or has_dlpack(value)
    if not is_array or len(value.shape) not in (2, 3):
        return value
    is_vector = isinstance(value, wp.array) and value.dtype in _VECTORS[dimension].values()
    shape = tuple(value.shape) if is_vector else tuple(value.shape[:2])
    has_axis = len(value.shape) == (2 if is_vector else 3)
    if not has_axis or shape not in by_world or not (is_vector or value.shape[2] == dimension):
        return value
    array: Any = as_warp(value, name)
    if not array.is_contiguous and array.size:
        raise ValueError(f"{name} has strides {array.strides}; expected a contiguous array, which needs no copy")
    if type(value) is np.ndarray:
        return value.reshape(-1, dimension)
    rows = array.shape[0] * array.shape[1]
    return array.reshape(rows if is_vector else (rows, dimension))


def as_positions(value: object, name: str, device: wp.Device, expected: dict[int, str], dimension: int) -> wp.array:
    """Positions as vec3f or vec3d of shape [n], or vec2f or vec2d, sharing the memory of the given array.

    Args:
        value: Array of such vectors, shape [n], or of float32 or float64, shape [n, dimension].
        name: Name of the argument, for the messages.
        device: The device on which it must be.
        expected: Accepted numbers of rows, and what the rows are.
        dimension: 3, or 2 in the plane.

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
    vectors = _VECTORS[dimension]
    if dtype in vectors and array.ndim == 2 and shape[1] == dimension:
        dtype, shape = vectors[dtype], shape[:1]
    if dtype not in vectors.values() or len(shape) != 1:
        raise ValueError(
            f"{name} has dtype {dtype.__name__} and shape {array.shape}; "
            f"expected vec{dimension}f or vec{dimension}d and (n,), or float32 or float64 and (n, {dimension})"
        )
    if shape[0] not in expected:
        rows = " or ".join(f"{count}, {meaning}" for count, meaning in expected.items())
        raise ValueError(f"{name} has {shape[0]} rows; expected {rows}")
    if dtype is array.dtype:
        return array
    if shape[0] == 0:
        return wp.empty(0, dtype=dtype, device=array.device)
    alias: wp.array = wp.array(ptr=array.ptr, dtype=dtype, shape=shape, device=array.device, copy=False)
    alias._ref = array  # type: ignore[assignment]  # keeps the memory alive
    return alias
