"""Slices of a step: its parts that are searched one after another."""

from typing import NamedTuple


class Slice(NamedTuple):
    """A part of a step.

    Attributes:
        t_begin: Its begin, a time of the step.
        t_end: Its end.
    """

    t_begin: float
    t_end: float

    @staticmethod
    def all(count: int, t_max: float) -> "list[Slice]":
        """So many slices of equal length, of [0, t_max]."""
        ends = [t_max * k / count for k in range(count)] + [t_max]
        return [Slice(*ends[k : k + 2]) for k in range(count)]
