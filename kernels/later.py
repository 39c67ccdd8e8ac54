"""Functions and kernels that Warp reads when they are needed, and not where their file is executed.

Where a module is compiled, its kernels alone are needed. Warp reads those of a module as soon as anything is asked of
one of them, and all functions as soon as anything is asked of one: where a module has to be hashed or compiled, or code
of somebody else calls it. They are read in the order in which they are defined.
"""

import builtins
import linecache
import os
import sys
import threading
from functools import update_wrapper
from importlib.util import decode_source
from types import FunctionType, ModuleType
from typing import Any

import warp as wp

sources: dict[str, bytes] = {}  # the files that have been executed, as they were then

# Locked where Warp reads; no other lock is waited for meanwhile, as Warp may have one of its own locked when it asks.
_reading = threading.RLock()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_reading.acquire, after_in_parent=_reading.release, after_in_child=_reading.release)

_kernels: dict[str, list["LaterKernel"]] = {}
_functions: list["_Definition"] = []
_is_defining = False


class LaterKernel(wp.Kernel):
    """A kernel of Warp that becomes complete when it is asked for anything."""

    def __init__(self, function: FunctionType, module: Any, options: dict[str, Any]) -> None:
        self.of_later = function, module, options
        update_wrapper(self, function)

    def __getattr__(self, name: str) -> Any:
        define_kernels(self.of_later[1].name)
        if type(self) is LaterKernel:
            raise AttributeError(name)
        return getattr(self, name)

    def define(self) -> None:
        """Let Warp read the kernel."""
        function, module, options = self.of_later
        _show_source(function)
        module.defer_reference_scan = True  # which would read all functions that the kernel calls
        super().__init__(function, module=module, options=options)
        update_wrapper(self, function)
        self.__class__ = wp.Kernel


class LaterFunction(wp.Function):
    """A function of Warp that becomes complete when it is asked for anything."""

    def __init__(self, function: FunctionType) -> None:
        self.func = function
        update_wrapper(self, function)

    def __getattr__(self, name: str) -> Any:
        define_functions()
        if type(self) is LaterFunction:  # asked for by one that stands above it, for which it is not there yet
            raise AttributeError(name)
        return getattr(self, name)


class _Definition:
    """A decorated function, or an overload of one, with Warp's decorator and the arguments of that."""

    def __init__(self, decorator: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> None:
        self.decorator, self.arguments, self.options = decorator, arguments, options
        # Warp looks for an overload in the scope of the caller of its decorator
        self.scope = sys._getframe(2).f_locals

    def __call__(self, function: FunctionType) -> wp.Function:
        self.function, other = function, self.scope.get(function.__name__)
        del self.scope
        self.later = other if isinstance(other, wp.Function) else LaterFunction(function)
        with _reading:
            _functions.append(self)
            if type(self.later) is not LaterFunction:
                define_functions()
        return self.later

    def define(self) -> None:
        """Let Warp read the function."""
        function, later = self.function, self.later
        _show_source(function)
        is_first = type(later) is LaterFunction
        names = {"decorator": getattr(wp, self.decorator), "definition": self}
        scope = {} if is_first else {function.__name__: later}
        module = wp.get_module(function.__module__)
        if is_first:
            module.mark_modified = _nothing  # no kernel that was hashed knows the function
        try:
            made = eval("decorator(*definition.arguments, **definition.options)(definition.function)", names, scope)
        finally:
            vars(module).pop("mark_modified", None)
        if is_first:
            later.__dict__ = made.__dict__
            later.__class__ = wp.Function


def define_kernels(module: str) -> None:
    """Let Warp read the kernels of a module of its own, of files that have been executed."""
    with _reading:
        kernels = _kernels.get(module, [])
        while kernels:
            kernels[0].define()
            kernels.pop(0)


def define_functions() -> None:
    """Let Warp read all functions of files that have been executed."""
    global _is_defining
    with _reading:
        if _is_defining:
            return
        _is_defining = True
        try:
            while _functions:
                _functions[0].define()
                _functions.pop(0)
        finally:
            _is_defining = False


def _nothing() -> None:
    pass


def _show_source(function: FunctionType) -> None:
    """Have Warp find a file as it was executed, should it have been edited since, and itself by its name there."""
    function.__globals__["wp"] = wp
    path = function.__code__.co_filename
    if path in sources and linecache.cache.get(path, (0, 0))[1] is not None:
        lines = decode_source(sources[path]).splitlines(keepends=True)
        linecache.cache[path] = (len(sources[path]), None, lines, path)  # without a time to be compared


class _Warp(ModuleType):
    """Warp as the files of these folders see it while they are executed."""

    def __getattr__(self, name: str) -> Any:
        return getattr(wp, name)

    def func(self, function: FunctionType | None = None, *, inline: bool | None = None) -> Any:
        """`wp.func`."""
        definition = _Definition("func", (), {"inline": inline})
        return definition(function) if function else definition

    def func_native(self, snippet: str) -> Any:
        """`wp.func_native`."""
        return _Definition("func_native", (snippet,), {})

    def kernel(
        self,
        function: FunctionType | None = None,
        *,
        module: Any = None,
        enable_backward: bool | None = None,
        grid_stride: bool | None = None,
        cuda_max_registers: int | None = None,
    ) -> Any:
        """`wp.kernel`."""
        arguments = {
            "enable_backward": enable_backward,
            "grid_stride": grid_stride,
            "cuda_max_registers": cuda_max_registers,
        }
        options = {name: value for name, value in arguments.items() if value is not None}

        def decorate(function: FunctionType) -> LaterKernel:
            of = module or wp.get_module(function.__module__)
            kernel = LaterKernel(function, of, options)
            _kernels.setdefault(of.name, []).append(kernel)
            return kernel

        return decorate(function) if function else decorate


_warp = _Warp(wp.__name__)


def _import(name: str, *others: Any) -> Any:
    return _warp if name == wp.__name__ else builtins.__import__(name, *others)


BUILTINS = {**vars(builtins), "__import__": _import}
