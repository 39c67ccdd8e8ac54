"""Refuse COLLADA files that are damaged: trimesh's reader takes counts that do not agree for other meshes."""

import xml.etree.ElementTree as ET

from ccd_warp._input.messages import InputError


def check_collada(data: bytes) -> None:
    """Refuse a file that is cut, or whose arrays and faces do not hold as many numbers as they say.

    Raises:
        InputError: With what was expected and found.
    """
    for element in ET.fromstring(data).iter():
        kind = _name(element)
        if kind.endswith("_array"):
            _check(element, "values", _numbers(element), int(element.get("count", "-1")))
        elif kind in ("triangles", "polylist"):
            parts = {_name(part): part for part in element}
            count, corners = int(element.get("count", "-1")), [3]
            if kind == "polylist":
                corners = [int(word) for word in (parts["vcount"].text or "").split()]
                _check(element, "polygons", len(corners), count)
                count = 1
            stride = 1 + max(int(part.get("offset", "0")) for part in element)
            _check(element, "indices", _numbers(parts["p"]), count * sum(corners) * stride)


def _name(element: ET.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _numbers(element: ET.Element) -> int:
    return len((element.text or "").split())


def _check(element: ET.Element, what: str, found: int, stated: int) -> None:
    if found != stated:
        raise InputError(f"{_name(element)} {element.get('id', '')!r} holds {found} {what}; it says {stated}")
