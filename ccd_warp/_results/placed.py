"""Tables that know more than their arrays."""

from typing import Any, Self


class Placed:
    """Keeps what a table knows besides its arrays in a slot, so that ``vars()`` gives the arrays alone.

    It is a ``ContactPlace`` of `contact_place`, of pairs on a device a ``DeviceStep``, of a result of pair functions
    what they were asked, of gradients ``TurningPoints``. These modules import this one and know the types.
    """

    __slots__ = ("_place",)
    _place: Any

    def __post_init__(self) -> None:
        object.__setattr__(self, "_place", None)

    def _of(self, place: Any) -> Self:
        """The same table, which knows this place from now on."""
        object.__setattr__(self, "_place", place)
        return self

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_place": self._place}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)
