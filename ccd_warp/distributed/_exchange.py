"""Values of vertices on their way from owners to those who hold copies, and back: one message a neighbour."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp.distributed._ranks import Ranks

_Arrays = Sequence[NDArray[np.float64]]
_Rows = list[NDArray[np.intp]]


class Exchange:
    """Which rows go from each rank to each other one.

    A source row may go to several ranks, and a target row comes from one. Rows that stay on this rank are copied
    without a message.

    Attributes:
        sources: For each rank the rows that go to it.
        targets: For each rank the rows that come from it, in the same order.
    """

    def __init__(self, ranks: Ranks, sources: _Rows, targets: _Rows) -> None:
        self._ranks, self.sources, self.targets = ranks, sources, targets

    def forward(self, sources: _Arrays, targets: _Arrays) -> None:
        """Copy the source rows of arrays, of shape [n] or [n, k], to the target rows of as many others."""
        self._move(sources, self.sources, targets, self.targets, is_back=False)

    def back(self, targets: _Arrays, sources: _Arrays) -> None:
        """Lower the source rows of arrays to the least that their target rows hold in others."""
        self._move(targets, self.targets, sources, self.sources, is_back=True)

    def _move(self, arrays: _Arrays, sent_rows: _Rows, results: _Arrays, rows_of: _Rows, *, is_back: bool) -> None:
        ranks, widths = self._ranks, [math.prod(result.shape[1:]) for result in results]
        others = [r for r in range(ranks.size) if r != ranks.rank]
        items = [_items(array) for array in arrays]
        sent = {r: np.concatenate([of[sent_rows[r]].view(np.float64).ravel() for of in items]) for r in others}
        received = {r: np.empty(sum(widths) * len(rows_of[r])) for r in others}
        ranks.exchange(sent, received)
        for r, rows in enumerate(rows_of):
            parts = [of[sent_rows[r]].view(np.float64) for of in items] if r == ranks.rank else None
            parts = parts or np.split(received[r], np.cumsum([width * len(rows) for width in widths])[:-1])
            for part, result in zip(parts, results, strict=True):
                values = part.reshape(len(rows), *result.shape[1:])
                if is_back:
                    result[rows] = np.minimum(result[rows], values)
                else:
                    _items(result)[rows] = _items(values)


def _items(array: NDArray[np.float64]) -> NDArray[Any]:
    """The rows of a contiguous array as single items, which NumPy picks in less than half the time."""
    return array if array.ndim == 1 else array.view(np.dtype((np.void, array.itemsize * array.shape[1])))[:, 0]
