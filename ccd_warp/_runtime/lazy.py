"""A property that is computed at its first use and then kept."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

_T = TypeVar("_T")


class lazy_property(Generic[_T]):
    """A property whose value stays with the object, in its ``__dict__``, without a lock.

    `functools.cached_property` of Python 3.11 has one lock for all objects of the class: a thread that computes the
    property of one object blocks threads that use another, and a process forked meanwhile waits forever. Without the
    lock two threads may both compute the value of one object; both then use the value stored first.
    """

    def __init__(self, function: Callable[[Any], _T]) -> None:
        self._function = function
        self._name = function.__name__
        self.__doc__ = function.__doc__

    @overload
    def __get__(self, instance: None, owner: type | None = None) -> "lazy_property[_T]": ...

    @overload
    def __get__(self, instance: object, owner: type | None = None) -> _T: ...

    def __get__(self, instance: object, owner: type | None = None) -> Any:
        """The value; after the first access Python finds it in the object itself."""
        if instance is None:
            return self
        return instance.__dict__.setdefault(self._name, self._function(instance))
