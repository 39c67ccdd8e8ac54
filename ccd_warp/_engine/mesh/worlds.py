"""Where the worlds of a mesh lie in quantized coordinates: each in a cell of a lattice of its own."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# Vertices of a world from which its origin and its unit are chosen, and the number of those farthest away that do not
# count for the unit: a few may be those of a large wall.
_SAMPLES, _FAR = 16, 2
_ANCHORS = 3
# Largest ratio of two units, as a power of two.
_MOST_SIZES = 40
# By how much a cell is larger than most worlds: by a power of two as long as the rest of a float32 leaves bits enough.
_SPARE_BITS, _LEAST_SPARE_BITS, _BITS = 2, 0, 6


class WorldPlaces(NamedTuple):
    """What turns the positions of a world into those seen from its origin, in its unit.

    The origin of a world is at a vertex of it, at the start of a step, plus a vector: so it goes where the world goes.
    Three vertices say where, and the middle one of them counts along each axis, as one may have flown away. They are
    static if any are, so that static bodies have the same boxes in every step.

    Attributes:
        anchor: Vertices of each world, int32, shape [W, 3]; empty if worlds have no origins and are seen as they are.
        origin: Origins from these vertices, float64, shape [W, 3, 3].
        unit: Powers of two, larger for a smaller world, float64, shape [W].
    """

    anchor: NDArray[np.int32]
    origin: NDArray[np.float64]
    unit: NDArray[np.float64]

    @property
    def has_origins(self) -> bool:
        """Whether each world has an origin of its own."""
        return len(self.anchor) > 0

    @property
    def bits(self) -> int:
        """By how many bits the scale is smaller than that of a scene that has all the coordinates."""
        bits = lattice_bits(len(self.unit))
        return bits + max(_LEAST_SPARE_BITS, min(_SPARE_BITS, _BITS - bits)) if self.has_origins else bits

    def seen(
        self, positions: NDArray[np.float64], world: NDArray[np.integer], start: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Positions of vertices of these worlds as seen from their origins, given the start of the step."""
        if not self.has_origins:
            return positions
        with np.errstate(over="ignore", under="ignore"):
            origin = middle_of(np.moveaxis(self.origin[world] + start[self.anchor[world]], -2, 0))
            return in_unit(positions - origin, self.unit[world][..., None])


def middle_of(three: NDArray[np.float64]) -> NDArray[np.float64]:
    """The middle one of three numbers along the first axis, of those that are numbers."""
    a, b, c = three
    return np.fmax(np.fmin(a, b), np.fmin(np.fmax(a, b), c))


def in_unit(lengths: NDArray[np.float64], unit: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths in a unit, none of them infinite, in place."""
    largest = np.finfo(np.float64).max
    lengths *= unit
    return np.clip(lengths, -largest, largest, out=lengths)


def plain_places(num_worlds: int) -> WorldPlaces:
    """Worlds seen as they are; a single one has no cell."""
    num_worlds = num_worlds if num_worlds > 1 else 0
    return WorldPlaces(np.zeros((0, _ANCHORS), dtype=np.int32), np.zeros((0, _ANCHORS, 3)), np.ones(num_worlds))


def place_worlds(
    vertices: NDArray[np.float64],
    world: NDArray[np.int32],
    num_worlds: int,
    is_static: NDArray[np.bool_],
    unused: NDArray[np.int32],
) -> WorldPlaces:
    """Origins and units of worlds, from positions of their vertices; a poor choice costs time only.

    Args:
        vertices: Positions, shape [V, 3].
        world: The world of each vertex.
        num_worlds: Number of worlds.
        is_static: Whether each vertex is one of a static body.
        unused: Vertices that take no part.
    """
    if num_worlds < 2 or len(world) == 0:
        return plain_places(num_worlds)
    takes_part = np.ones(len(world), dtype=bool)
    takes_part[unused] = False
    order = np.argsort(world, kind="stable")
    order = order[takes_part[order]]
    static = order[is_static[order]]
    anchor, num_static = _some_of_each(static, world, num_worlds, _ANCHORS)
    sampled, _ = _some_of_each(order, world, num_worlds, _SAMPLES)
    anchor = np.where(num_static[:, None] > 0, anchor, _some_of_each(order, world, num_worlds, _ANCHORS)[0])
    points = vertices[sampled]
    with np.errstate(over="ignore", under="ignore"):
        centre = np.sort(points, axis=1)[:, _SAMPLES // 2]
        distance = np.abs(0.5 * points - 0.5 * centre[:, None]).max(axis=2)
        half = np.sort(distance, axis=1)[:, _SAMPLES - 1 - _FAR]
        origin = centre[:, None] - vertices[anchor]
    origin[~np.isfinite(origin)] = 0.0
    exponent = np.frexp(half)[1]
    is_extended = half > 0.0
    relative = exponent - int(np.median(exponent[is_extended])) if is_extended.any() else np.zeros_like(exponent)
    relative = np.where(is_extended, np.clip(relative, -_MOST_SIZES, _MOST_SIZES), 0)
    return WorldPlaces(anchor.astype(np.int32), origin, np.ldexp(1.0, -relative))


def _some_of_each(
    vertices: NDArray[np.intp], world: NDArray[np.int32], num_worlds: int, num: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Some of the vertices of each world, given in the order of the worlds, shape [W, num]; and how many there are.

    Those of a world that has none are any, which is no matter, as it has no boxes.
    """
    begin = np.searchsorted(world[vertices], np.arange(num_worlds + 1))
    count = np.diff(begin)
    if len(vertices) == 0:
        return np.zeros((num_worlds, num), dtype=np.intp), count
    places = begin[:-1, None] + count[:, None] * (2 * np.arange(num) + 1) // (2 * num)
    return vertices[np.minimum(places, len(vertices) - 1)], count


def lattice_bits(num_worlds: int) -> int:
    """The number of bits k for which a lattice of 2ᵏ cells on each axis has a cell for each world."""
    return -(-max(num_worlds - 1, 0).bit_length() // 3)


def inner_part(num_worlds: int) -> float:
    """Half of half the side of a cell."""
    return 2.0 ** -(lattice_bits(num_worlds) + 2)


def world_lattice(num_worlds: int) -> NDArray[np.float32]:
    """The middle of the cell of each world in quantized coordinates, in [-1/2, 1/2]; shape [W, 3]."""
    bits = lattice_bits(num_worlds)
    world = np.arange(num_worlds)
    cell = np.stack([world >> (k * bits) & ((1 << bits) - 1) for k in range(3)], axis=1)
    return ((cell + 0.5) * 2.0**-bits - 0.5).astype(np.float32)
