"""Half-spaces on the command line: ``--half-space X,Y,Z,NX,NY,NZ``, with ``NAME=`` before it for a name."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ccd_warp._files.frames import Body, make_body
from ccd_warp._half_space import HalfSpace
from ccd_warp._input.messages import InputError, printable


def half_space_bodies(given: Sequence[str]) -> list[Body]:
    """A body for each half-space, called "half-space" where it has no name.

    Raises:
        ValueError: If a text does not hold six numbers, a point and a normal.
    """
    bodies = []
    for text in given:
        name, _, numbers = text.rpartition("=")
        try:
            x, y, z, *normal = map(float, numbers.split(","))
            nx, ny, nz = normal
        except ValueError:
            expected = "X,Y,Z,NX,NY,NZ, a point and a normal, or NAME=X,Y,Z,NX,NY,NZ"
            raise InputError(f"--half-space {printable(text)}: expected {expected}") from None
        none = np.zeros((0, 3))
        body = make_body(name or "half-space", none, None, none, is_static=True)
        bodies.append(replace(body, half_space=HalfSpace([x, y, z], [nx, ny, nz])))
    return bodies
