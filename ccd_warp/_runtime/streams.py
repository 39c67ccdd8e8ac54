"""Launches on CUDA in the order of the stream of another library.

Warp frees an array in the order of the null stream. That stream waits for the streams that Warp makes, but for none
that does not block, as those of PyTorch and JAX: what such a stream still reads would be given away. So launches are on
a stream that blocks, and the streams wait for each other before and after.

While a library captures its stream into a graph, launches are on that stream itself, and Warp is told of the capture:
then it keeps what is freed meanwhile for as long as the graph may need it.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import warp as wp

# An object of Warp for each stream of a library, by device and handle. None is ever dropped: the destructor of one
# takes the stream from Warp's list, and so from all other objects for the same stream.
_streams: dict[tuple[int, int], Any] = {}
_captured_by_libraries: set[Any] = set()


def in_order_of_library(device: wp.Device, handle: int) -> AbstractContextManager[Any]:
    """A block whose launches come after all that a stream has been given, and before what it is given next.

    Args:
        device: A CUDA device of Warp.
        handle: The current stream of another library, as a number; 0 for the null stream.

    Raises:
        RuntimeError: If Warp captures a graph, of which this stream is no part.
    """
    current = device.stream
    library_stream = current if handle == _handle(current) else _stream_of(device, handle)
    if handle and library_stream.is_capturing:  # the null stream cannot be captured
        return _on_captured(library_stream)
    if device.is_capturing:
        raise RuntimeError(
            "Warp captures a graph, of which the current stream of the library is no part; expected launches of the "
            "pipeline in it, or a capture by the library, such as torch.cuda.graph"
        )
    return in_order_with(library_stream)


@contextmanager
def in_order_with(library_stream: Any) -> Iterator[None]:
    """A block whose launches are on a stream that blocks, in the order of two streams that may not block.

    The two are a library's and the current one of its device, on which other launches are. The null stream is also in
    the order of all streams that block.
    """
    current = library_stream.device.stream
    blocking = current if current.is_blocking else library_stream.device.null_stream
    others = {_handle(stream): stream for stream in (current, library_stream)}
    others.pop(_handle(blocking), None)
    for other in others.values():
        blocking.wait_stream(other)
    try:
        with wp.ScopedStream(blocking, sync_enter=False):
            yield
    finally:
        for other in others.values():
            other.wait_stream(blocking)


def in_current_order(device: wp.Device) -> AbstractContextManager[Any]:
    """A block whose launches are on a stream that blocks, in the order of the current one of a device.

    On the CPU, and in a capture, which keeps what is freed, launches are where they are.
    """
    if device.is_cpu or device.is_capturing or device.stream.is_blocking:
        return nullcontext()
    return in_order_with(device.stream)


def is_captured_by_library(stream: Any) -> bool:
    """Whether a stream is captured into a graph of another library, although Warp knows of it."""
    return stream in _captured_by_libraries


def _on_captured(stream: Any) -> AbstractContextManager[Any]:
    """A block whose launches are on a captured stream, which waits for no other: the capture would be lost."""
    if not stream.device.captures:
        return _told_to_warp(stream)
    return nullcontext() if stream is stream.device.stream else wp.ScopedStream(stream, sync_enter=False)


@contextmanager
def _told_to_warp(stream: Any) -> Iterator[None]:
    """A block whose launches are on a stream that a library captures, and in which Warp knows of the capture."""
    try:
        wp.capture_begin(stream=stream, external=True)
    except RuntimeError:  # another object for this stream has gone
        stream = _stream_of(stream.device, _handle(stream), anew=True)
        wp.capture_begin(stream=stream, external=True)
    try:
        _captured_by_libraries.add(stream)
        with wp.ScopedStream(stream, sync_enter=False):
            yield
    finally:
        try:
            wp.capture_end(stream=stream)
        finally:
            _captured_by_libraries.discard(stream)


def _stream_of(device: wp.Device, handle: int, *, anew: bool = False) -> Any:
    """The object of Warp for a stream of a library."""
    if not handle:
        return device.null_stream
    key = device.ordinal, handle
    if anew and key in _streams:
        _streams.pop(key).cuda_stream = None  # which leaves its destructor nothing to do
    if key not in _streams:
        _streams[key] = wp.Stream(device, cuda_stream=handle)
    return _streams[key]


def _handle(stream: Any) -> int:
    return stream.cuda_stream or 0
