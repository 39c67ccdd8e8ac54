"""Names of bodies: their validation, and what messages call a body."""

from collections.abc import Sequence
from typing import Any

from ccd_warp._scene.input.arguments import check_items, on_one_line, shown
from ccd_warp._scene.input.messages import printable


def validated_names(values: Sequence[str] | None, num_bodies: int) -> tuple[str, ...]:
    """One name for each body, "body 0" and so on by default.

    Raises:
        ValueError: If a name is not a printable text, two bodies have the same, or their number is not that of the
            bodies.
    """
    if values is None:
        return tuple(f"body {b}" for b in range(num_bodies))
    names = check_items("names", values, "a list of texts, one a body")
    if len(names) != num_bodies:
        raise ValueError(f"names has {len(names)} entries; expected {num_bodies}, one a body")
    seen: set[str] = set()
    for name in names:
        if not isinstance(name, str) or not name.strip() or not name.isprintable():
            raise ValueError(f"names holds {shown(name)}; expected printable texts, one a body")
        if name in seen:
            raise ValueError(f"names holds {shown(name)} twice; expected a name of its own for each body")
        seen.add(name)
    return tuple(map(str, names))


def distinct_names(names: Sequence[Any]) -> list[str]:
    """Names taken from files and scenes, made printable; of equal ones the second gets the ending " (2)", and so on."""
    distinct: list[str] = []
    taken = set()
    for index, original in enumerate(names):
        name = printable(str(original)) if original is not None and str(original).strip() else f"body {index}"
        number, candidate = 1, name
        while candidate in taken:
            number += 1
            candidate = f"{name} ({number})"
        taken.add(candidate)
        distinct.append(candidate)
    return distinct


def is_default_name(name: str, body: int) -> bool:
    """Whether a body was given no name."""
    return name == f"body {body}"


def body_label(body: int, names: Sequence[str]) -> str:
    """What a message calls a body: by its number, and by its name if it was given one."""
    name = names[body]
    return f"body {body}" if is_default_name(name, body) else f"body {body} ({on_one_line(name)})"


def of_body(body: int, names: Sequence[str]) -> str:
    """What a message adds to a primitive: " of wall", or nothing where the body was given no name."""
    return "" if is_default_name(names[body], body) else f" of {on_one_line(names[body])}"
