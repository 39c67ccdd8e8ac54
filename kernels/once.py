"""Build functions, kernels and structs once for each set of arguments, by one thread at a time.

Warp's registry of modules is not thread-safe: if two threads define the same kernel at once, one of them gets a kernel
that is registered in no module. A result is kept only when it is complete: a builder that was interrupted runs again.
"""

import gc
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any

# Locked while kernels are defined or compiled. A fork waits for it, so that no child inherits an incomplete registry.
building = threading.RLock()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=building.acquire, after_in_parent=building.release, after_in_child=building.release)


@contextmanager
def uncollected() -> Iterator[None]:
    """Leave the garbage collector out where kernels are defined or compiled, with `building` locked.

    What is made there stays, and is so much that the collector would take a fifth of the time to find it all in use.
    """
    was_enabled = gc.isenabled()
    try:
        gc.disable()
        yield
    finally:
        if was_enabled:
            gc.enable()


def once(make: Callable[..., Any]) -> Callable[..., Any]:
    """Keep what a function returns for its arguments, made by one thread at a time, and not kept after an exception."""
    made: dict[tuple[Any, ...], Any] = {}
    defaults = make.__defaults__ or ()
    num_required = make.__code__.co_argcount - len(defaults)

    @wraps(make)
    def get(*arguments: Any) -> Any:
        """What ``make`` gave for these arguments the first time; defaults count as arguments."""
        if defaults:
            arguments = arguments + defaults[len(arguments) - num_required :]
        if arguments not in made:
            with building, uncollected():
                if arguments not in made:
                    made[arguments] = make(*arguments)
        return made[arguments]

    return get
