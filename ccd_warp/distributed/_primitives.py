"""Edges and faces of the whole mesh: their numbers, and which rank answers for each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ccd_warp.distributed import _numbering as numbering
from ccd_warp.distributed._homes import Homes


@dataclass(frozen=True)
class Primitives:
    """Primitives that this rank owns: each of the whole mesh belongs to one rank.

    Attributes:
        numbers: Their indices in the whole mesh, int64, shape [n].
        corners: Rows of their vertices on this rank, shape [n, 1 to 3], in the order that counts.
        is_codimensional: Which of them collide as codimensional ones, bool, shape [n].
    """

    numbers: NDArray[np.int64]
    corners: NDArray[np.int64]
    is_codimensional: NDArray[np.bool_]


def numbered_edges(
    homes: Homes,
    numbers: NDArray[np.int64],
    order: NDArray[np.intp],
    faces: NDArray[np.int64],
    listed: NDArray[np.int64],
) -> tuple[Primitives, int]:
    """The edges that this rank owns, and the number of those of the whole mesh; collective.

    Args:
        homes: The homes of numbers of vertices.
        numbers: Number of each vertex on this rank.
        order: Their rows by ascending number.
        faces: Rows of the vertices of the faces that this rank has handed in, shape [f, 3].
        listed: Those of codimensional edges, shape [e, 2].
    """
    # places among the vertices of this rank are ordered as their numbers are
    place = np.empty(len(numbers), dtype=np.int64)
    place[order] = np.arange(len(numbers))
    edges = numbering.edges_of_faces(place[faces])
    alone = np.sort(place[listed], axis=1)
    rows = order[np.concatenate([edges, alone[alone[:, 0] != alone[:, 1]]])]
    copies = np.empty((len(rows), 3), dtype=np.int64)
    copies[:, :2] = numbers[rows]
    copies[:, 2] = np.arange(len(rows)) < len(edges)
    queries = homes.ask(copies, copies[:, 1])
    of_all = queries.rows
    home, is_codimensional = numbering.edges_at_home(of_all[:, :2], of_all[:, 2] == 1)
    flags = np.zeros(len(of_all), dtype=np.int64)
    flags[home.representative] = is_codimensional
    number, count = _numbered(homes, home)
    owned_numbers, flags = queries.answers(np.stack([number, flags], axis=1)).T
    return _owned(owned_numbers, rows, flags == 1), count


def numbered_faces(homes: Homes, numbers: NDArray[np.int64], faces: NDArray[np.int64]) -> tuple[Primitives, int]:
    """The faces that this rank owns, and the number of those of the whole mesh; collective."""
    copies = numbers[faces]
    queries = homes.ask(copies, copies.min(axis=1))
    number, count = _numbered(homes, numbering.faces_at_home(queries.rows))
    owned_numbers = queries.answers(number[:, None])[:, 0]
    return _owned(owned_numbers, faces, np.zeros(len(faces), dtype=bool)), count


def _numbered(homes: Homes, home: numbering.PrimitiveHome) -> tuple[NDArray[np.int64], int]:
    """The number of the primitive of each copy at this home, -1 where another copy counts; and how many there are."""
    before = homes.ranks.sum_before(home.count)
    return np.where(home.number >= 0, home.number + before, -1), int(homes.ranks.total(np.array(home.count)))


def _owned(numbers: NDArray[np.int64], rows: NDArray[np.integer], codimensional: NDArray[np.bool_]) -> Primitives:
    """The primitives for which a home has chosen this rank, given the rows of their vertices."""
    items = np.flatnonzero(numbers >= 0)
    items = items[np.argsort(numbers[items], kind="stable")]
    return Primitives(numbers[items], rows[items].astype(np.int64), codimensional[items])
