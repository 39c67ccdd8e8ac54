"""A recorded launch on the CPU whose arguments stay packed, so that repeating it costs a call of a C function.

Warp packs the arguments of a recorded launch anew whenever it is launched. That takes 2 to 5 µs, where the kernel of a
small step takes half of one.
"""

import ctypes
from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any

import warp as wp


class PackedLaunch:
    """A launch in parts, which threads may run at once, each without Warp.

    How Warp hands bounds and arguments to a kernel is its own affair. So the launch is made once with a stand-in in
    place of the kernel, and what that is given is kept.

    Attributes:
        num_parts: Number of parts.
    """

    def __init__(self, command: wp.Launch, ranges: Sequence[tuple[int, int]]) -> None:
        """The parts are these ranges of items; the first parameter of the kernel is the item with which one begins."""
        self._command = command
        self._ranges, self.num_parts = ranges, len(ranges)
        self._names = [argument.label for argument in command.kernel.adj.args]
        self._arguments: Any = None
        self._parts: list[Callable[[], None]] = []

    def bind(self, index: int, value: Any) -> None:
        """Set the parameter of the kernel at an index."""
        self._command.set_param_at_index(index, value)
        if self._arguments is not None:
            setattr(self._arguments, self._names[index], self._command.params[index + 1])

    def launch(self) -> None:
        """Launch the whole by Warp: on CUDA, and into a graph."""
        self._command.launch()

    def parts(self) -> list[Callable[[], None]]:
        """A function for each part, which launches it; not to be called in a capture, nor by two threads at once.

        A version of Warp that does not call a kernel with a structure of its arguments is asked for the whole launch.
        """
        if not self._parts:
            try:
                self._pack()
            except (AttributeError, LookupError, TypeError, ctypes.ArgumentError):
                self._arguments, self._parts = None, [self._command.launch]
        return self._parts

    def _pack(self) -> None:
        """Let Warp launch with a stand-in for the kernel, once for the bounds of each part."""
        command: Any = self._command
        whole, hooks = command.bounds, command.hooks
        received: list[tuple[Any, Any]] = []
        stand_in: Any = SimpleNamespace(forward=lambda bounds, arguments: received.append((bounds, arguments)))
        try:
            command.hooks = stand_in
            for begin, end in self._ranges:
                command.set_dim(end - begin)
                command.launch()
        finally:
            command.hooks, command.bounds, command.params[0] = hooks, whole, whole
        kernel, (bounds, arguments) = hooks.forward, received[0]
        parts: list[Callable[[], None]] = [partial(kernel, bounds, arguments)]
        for (begin, _), (bounds, _) in zip(self._ranges[1:], received[1:], strict=True):
            parts.append(partial(_launch_from, begin, self._names[0], kernel, bounds, arguments._obj))
        self._arguments, self._parts = arguments._obj, parts


def _launch_from(begin: int, name: str, kernel: Callable[..., None], bounds: Any, arguments: Any) -> None:
    """Launch the part that begins with an item, with a copy of the arguments, as other parts may run meanwhile."""
    own = type(arguments).from_buffer_copy(arguments)
    setattr(own, name, begin)
    kernel(bounds, ctypes.byref(own))
