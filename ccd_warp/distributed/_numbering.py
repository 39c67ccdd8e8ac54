"""One number for each vertex, edge and face of the whole mesh: what a rank does with what others sent it. Without MPI.

Every id, and every edge and face by one of its vertices, has a home: a rank that receives what all ranks say of it, and
answers each of them. Homes hold consecutive ranges, so that what they number follows the order of the whole mesh:
vertices by id, edges by (max, min) and faces by their sorted vertices, as numbers. No rank sees more than its range.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Ids that each rank shows the others, from which the ranges of the homes are chosen.
NUM_SAMPLES = 256


def id_samples(ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Some ids of a rank, evenly spaced in their order."""
    if len(ids) <= NUM_SAMPLES:
        return np.sort(ids)
    ordered = np.partition(ids, (np.arange(NUM_SAMPLES) * len(ids)) // NUM_SAMPLES)
    return ordered[(np.arange(NUM_SAMPLES) * len(ids)) // NUM_SAMPLES]


def splitters(samples: NDArray[np.int64], num_ranks: int) -> NDArray[np.int64]:
    """The first id of each home but the first, from the samples of all ranks."""
    ordered = np.unique(samples)
    if len(ordered) == 0:
        return np.arange(1, num_ranks)
    return ordered[(np.arange(1, num_ranks) * len(ordered)) // num_ranks]


def home_of(first: NDArray[np.int64], values: NDArray[np.int64]) -> NDArray[np.intp]:
    """The home of each value, given the first value of each home but the first."""
    return np.searchsorted(first, values, side="right")


def by_destination(destination: NDArray[np.integer], num_ranks: int) -> list[NDArray[np.intp]]:
    """For each rank the items that go to it, ascending."""
    order = np.argsort(destination, kind="stable")
    ends = np.cumsum(np.bincount(destination, minlength=num_ranks))
    return [part.astype(np.intp) for part in np.split(order, ends[:-1])]


@dataclass(frozen=True)
class VertexHome:
    """What a home says of the vertices of its range.

    Attributes:
        ids: The ids, ascending.
        place: For each copy that was sent, the place of its id among these.
        owner: Rank that owns each of them.
        first: For each of them the first copy.
    """

    ids: NDArray[np.int64]
    place: NDArray[np.intp]
    owner: NDArray[np.int64]
    first: NDArray[np.intp]


def vertices_at_home(
    ids: NDArray[np.int64], ranks: NDArray[np.int64], owned: NDArray[np.int64], attributes: dict[str, NDArray[np.int64]]
) -> VertexHome:
    """Bring the copies of vertices together.

    Args:
        ids: Id of each copy.
        ranks: Rank that holds it, ascending.
        owned: 1 where that rank says that it owns the vertex, 0 where not, -1 where it leaves this open.
        attributes: What all copies of a vertex must agree in, by the name of the argument.

    Raises:
        ValueError: If they do not, or a vertex has no owner or several.
    """
    unique, first, place = np.unique(ids, return_index=True, return_inverse=True)
    for name, values in attributes.items():
        differs = values != values[first][place]
        if differs.any():
            k = int(np.argmax(differs))
            f = int(first[place[k]])
            raise ValueError(
                f"{name} of vertex id {ids[k]} differs between ranks {ranks[f]} and {ranks[k]}; "
                f"expected the same on all ranks that hold it"
            )
    owner = ranks[first]  # copies come in the order of the ranks, so this is the lowest
    if (owned >= 0).any():
        count = np.bincount(place, weights=owned == 1, minlength=len(unique))
        if (count != 1).any():
            k = int(np.argmax(count != 1))
            raise ValueError(f"owned is set for vertex id {unique[k]} on {int(count[k])} ranks; expected one")
        owner = np.empty(len(unique), dtype=np.int64)
        owner[place[owned == 1]] = ranks[owned == 1]
    return VertexHome(unique, place, owner, first)


def check_bodies_follow(ids: NDArray[np.int64], bodies: NDArray[np.int64]) -> None:
    """Check that the vertices of a body follow one another by id.

    Raises:
        ValueError: If not.
    """
    falls = np.flatnonzero(bodies[1:] < bodies[:-1])
    if len(falls):
        k = int(falls[0])
        raise ValueError(
            f"bodies gives vertex id {ids[k]} body {bodies[k]} and the next, {ids[k + 1]}, body {bodies[k + 1]}; "
            f"expected bodies that ascend with the ids"
        )


@dataclass(frozen=True)
class PrimitiveHome:
    """What a home says of the edges or faces of its range.

    Attributes:
        number: For each copy that was sent, the number of its primitive in the range where this copy is the one that
            counts, and -1 elsewhere.
        count: Number of primitives.
        representative: The copy that counts, for each primitive in order.
    """

    number: NDArray[np.int64]
    count: int
    representative: NDArray[np.intp]


def edges_at_home(edges: NDArray[np.int64], is_of_face: NDArray[np.bool_]) -> tuple[PrimitiveHome, NDArray[np.bool_]]:
    """Bring the copies of edges together, rows (min, max) in the order of the ranks; the first copy counts.

    Returns:
        The edges by (max, min), and for each whether it belongs to no face of any rank.
    """
    keys = _keys(edges)
    order = np.argsort(keys, kind="stable")  # quick, as those of a rank come in order
    group, representative = _groups(keys[order][:, None], order)
    of_face = np.zeros(len(representative), dtype=bool)
    of_face[group[is_of_face[order]]] = True
    return _home(representative, len(edges)), ~of_face


def faces_at_home(faces: NDArray[np.int64]) -> PrimitiveHome:
    """Bring the copies of faces together, rows of vertices in the order of the ranks.

    Copies are faces of the same three vertices. Where they have them in different orders, the first in lexicographic
    order counts, wherever it is, so that the result does not depend on which rank holds which copy.
    """
    ordered = np.sort(faces, axis=1)
    order = np.lexsort((*faces.T[::-1], *ordered.T[::-1]))
    _, representative = _groups(ordered[order], order)
    return _home(representative, len(faces))


def _groups(rows: NDArray[np.int64], order: NDArray[np.intp]) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """The group of each of the sorted rows, and the first copy of each group."""
    is_first = np.ones(len(rows), dtype=bool)
    is_first[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return np.cumsum(is_first, dtype=np.int64) - 1, order[is_first]


def _home(representative: NDArray[np.intp], num_copies: int) -> PrimitiveHome:
    number = np.full(num_copies, -1, dtype=np.int64)
    number[representative] = np.arange(len(representative))
    return PrimitiveHome(number, len(representative), representative)


def edges_of_faces(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The distinct edges (min, max) of faces, without pairs (a, a)."""
    pairs = np.concatenate([faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    keys = _keys(pairs[pairs[:, 0] != pairs[:, 1]])
    keys.sort()
    is_first = np.ones(len(keys), dtype=bool)
    is_first[1:] = keys[1:] != keys[:-1]
    keys = keys[is_first]
    return np.stack([keys & 0xFFFFFFFF, keys >> 32], axis=1)


def _keys(pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """A number for each pair of numbers below 2**31, by the larger and then by the smaller."""
    return np.maximum(pairs[:, 0], pairs[:, 1]) << 32 | np.minimum(pairs[:, 0], pairs[:, 1])
