"""Half-spaces on the command line: ``--half-space X,Y,Z,NX,NY,NZ``, with ``NAME=`` before it for a name."""

from collections.abc import Sequence

from ccd_warp._files.frames import Body
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
        bodies.append(Body.of_half_space(name or "half-space", HalfSpace([x, y, z], [nx, ny, nz])))
    return bodies
