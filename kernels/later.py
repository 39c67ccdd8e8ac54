"""Functions and kernels that Warp reads when they are needed, and not where their file is executed.

A compiled module needs its kernels alone, and of these Warp reads those of a module when one of them is first used. All
functions are read once a module has to be compiled, or its hash is not kept (`ccd_warp._runtime.kept_hashes`), or a
kernel of another package calls one of them: in the order of their definition, as they would be without this file.
"""

import builtins
import linecache
import os
import sys
import threading
from collections.abc import Callable
from functools import update_wrapper
from importlib.util import decode_source
from types import FunctionType, ModuleType
from typing import Any

import warp as wp

# Locked while Warp reads; it may wait for no other lock, as Warp itself has one of its own locked where it asks.
_reading = threading.RLock()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_reading.acquire, after_in_parent=_reading.release, after_in_child=_reading.release)

sources: dict[str, bytes] = {}  # the files that have been executed, as they were then
_functions: list[tuple["LaterFunction", str, tuple[Any, ...], dict[str, Any], FunctionType]] = []
_kernels: dict[str, list["LaterKernel"]] = {}
_is_defining = False


class LaterFunction(wp.Function):
    """A function of Warp, but for what only those need who call it from other code of Warp."""

    def __init__(self, function: FunctionType) -> None:
        self.func = function
        update_wrapper(self, function)

    def __getattr__(self, name: str) -> Any:
        define_functions()
        if type(self) is LaterFunction:  # it is asked for by a function that stands before it
            raise AttributeError(name)
        return getattr(self, name)


class LaterKernel(wp.Kernel):
    """A kernel of Warp that is complete as soon as anything is asked of it, with the others of its module."""

    def __init__(self, function: FunctionType, module: Any, options: dict[str, Any]) -> None:
        self._later = function, module, options
        update_wrapper(self, function)

    def __getattr__(self, name: str) -> Any:
        _, module, _ = self._later
        define_kernels(module.name)
        if type(self) is LaterKernel:
            raise AttributeError(name)
        return getattr(self, name)

    def define(self) -> None:
        """Let Warp read the kernel."""
        function, module, options = self._later
        _show_source(function)
        module.defer_reference_scan = True  # which would read all functions that the kernel calls
        wp.Kernel.__init__(self, function, module=module, options=options)
        update_wrapper(self, function)
        self.__class__ = wp.Kernel


def define_kernels(module: str) -> None:
    """Let Warp read all kernels of a module of its own, of files that have been executed."""
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
                later, decorator, arguments, options, function = _functions[0]
                function.__globals__["wp"] = wp
                _show_source(function)
                # Warp looks in the scope from which its decorator is called for what has the same name
                of_call = {"_wp": wp, "_arguments": arguments, "_options": options, "_function": function}
                is_overload = type(later) is not LaterFunction
                scope = {function.__name__: later} if is_overload else {}
                made = eval(f"_wp.{decorator}(*_arguments, **_options)(_function)", of_call, scope)
                if is_overload:
                    assert made is later, function
                else:
                    later.__dict__ = made.__dict__
                    later.__class__ = wp.Function
                _functions.pop(0)
        finally:
            _is_defining = False


def _defined_later(scope: dict[str, Any], decorator: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
    def decorate(function: FunctionType) -> LaterFunction:
        with _reading:
            other = scope.get(function.__name__)
            later = other if isinstance(other, wp.Function) else LaterFunction(function)
            _functions.append((later, decorator, arguments, options, function))
            if type(later) is not LaterFunction:
                define_functions()
        return later

    return decorate


def _show_source(function: FunctionType) -> None:
    """Have Warp find a file as it was executed, should it have been edited since."""
    path = function.__code__.co_filename
    if linecache.cache.get(path, (0, 0))[1] is not None:
        lines = decode_source(sources[path]).splitlines(keepends=True)
        linecache.cache[path] = (len(sources[path]), None, lines, path)  # without a time, so that none is compared


class _Warp(ModuleType):
    """Warp as the files of these folders import it."""

    def __getattr__(self, name: str) -> Any:
        return getattr(wp, name)

    def func(self, function: FunctionType | None = None, **options: Any) -> Any:
        decorate = _defined_later(sys._getframe(1).f_locals, "func", (), options)
        return decorate(function) if function else decorate

    def func_native(self, *snippets: str, **options: Any) -> Any:
        return _defined_later(sys._getframe(1).f_locals, "func_native", snippets, options)

    def kernel(self, function: FunctionType | None = None, module: Any = None, **options: Any) -> Any:
        given = {name: value for name, value in options.items() if value is not None}

        def decorate(function: FunctionType) -> LaterKernel:
            of = module or wp.get_module(function.__module__)
            kernel = LaterKernel(function, of, given)
            _kernels.setdefault(of.name, []).append(kernel)
            return kernel

        return decorate(function) if function else decorate


_warp = _Warp("warp")


def _import(name: str, *arguments: Any, **named: Any) -> Any:
    return _warp if name == "warp" else builtins.__import__(name, *arguments, **named)


# What the files of these folders are executed with.
BUILTINS = {**vars(builtins), "__import__": _import}
