"""Radii of bodies on the command line: ``--radius R`` for all, ``--radius NAME=R`` for one."""

from collections.abc import Sequence

from ccd_warp._input.messages import InputError, printable


def radii_of(given: Sequence[str], names: Sequence[str], is_half_space: Sequence[bool]) -> list[float] | None:
    """A radius for each body, the last one that is given for it, 0 where there is none; None if none is given.

    One for all bodies is none for half-spaces, which cannot have one.

    Raises:
        ValueError: If a text holds no number, or no body has the name before it.
    """
    if not given:
        return None
    radii = [0.0] * len(names)
    for text in given:
        name, is_of_body, number = text.rpartition("=")  # a name may hold the sign itself
        try:
            radius = float(number)
        except ValueError:
            raise InputError(f"--radius {printable(text)}: expected a number, or NAME=NUMBER for one body") from None
        if is_of_body and name not in names:
            known = ", ".join(map(printable, names[:8])) + (", …" if len(names) > 8 else "")
            raise InputError(f"--radius {printable(text)}: no body has this name; expected one of {known}")
        chosen = [
            each == name if is_of_body else not without for each, without in zip(names, is_half_space, strict=True)
        ]
        radii = [radius if is_chosen else kept for is_chosen, kept in zip(chosen, radii, strict=True)]
    return radii
