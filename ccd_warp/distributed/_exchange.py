"""Values of vertices on their way from owners to those who hold copies, and back: one message a neighbour."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp.distributed._ranks import Ranks


class Exchange:
    """Which rows go from each rank to each other one, with requests and buffers that are made once.

    A source row may go to several ranks, and a target row comes from one. Rows that stay on this rank are copied
    without a message.

    Attributes:
        sources: For each rank the rows that go to it.
        targets: For each rank the rows that come from it, in the same order.
    """

    def __init__(self, ranks: Ranks, sources: list[NDArray[np.intp]], targets: list[NDArray[np.intp]]) -> None:
        self.sources, self.targets = sources, targets
        self._ranks = ranks
        self._requests: dict[tuple[bool, int], _Requests] = {}
        self._own_sources, self._own_targets = _as_slice(sources[ranks.rank]), _as_slice(targets[ranks.rank])

    @property
    def num_neighbours(self) -> int:
        """Number of ranks to which rows go."""
        return sum(len(rows) > 0 for r, rows in enumerate(self.sources) if r != self._ranks.rank)

    @property
    def num_sent(self) -> int:
        """Number of rows that go to other ranks."""
        return sum(len(rows) for r, rows in enumerate(self.sources) if r != self._ranks.rank)

    def forward(self, pairs: list[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> None:
        """Copy the source rows of arrays to the target rows of others, given as (source, target).

        Arrays have shape [n] or [n, k]; those of one call travel in one message.
        """
        columns = [1 if source.ndim == 1 else source.shape[1] for source, _ in pairs]
        requests = self._of(True, sum(columns))
        for rows, buffer in requests.to_send(self.sources):
            begin = 0
            for (source, _), width in zip(pairs, columns, strict=True):
                part = buffer[begin : begin + width * len(rows)]
                np.take(source, rows, axis=0, out=part.reshape(len(rows), *source.shape[1:]), mode="clip")
                begin += width * len(rows)
        with self._ranks.after_agreement():
            requests.start()
            for source, target in pairs:
                _rows_of(target)[self._own_targets] = _rows_of(source)[self._own_sources]
            requests.wait()
        for rows, buffer in requests.received(self.targets):
            begin = 0
            for (_, target), width in zip(pairs, columns, strict=True):
                part = buffer[begin : begin + width * len(rows)]
                _rows_of(target)[rows] = _rows_of(part.reshape(len(rows), *target.shape[1:]))
                begin += width * len(rows)

    def back(self, values: NDArray[np.float64], result: NDArray[np.float64], op: np.ufunc) -> None:
        """Combine what the target rows hold with the source rows of ``result``.

        ``op`` is np.minimum, np.maximum or np.add. Source rows that also stay on this rank hold nothing yet: the value
        of their target is taken as it is.
        """
        requests = self._of(False, 1)
        for rows, buffer in requests.to_send(self.targets):
            np.take(values, rows, out=buffer, mode="clip")
        with self._ranks.after_agreement():
            requests.start()
            result[self._own_sources] = values[self._own_targets]
            requests.wait()
        for rows, buffer in requests.received(self.sources):
            result[rows] = op(result[rows], buffer)

    def _of(self, is_forward: bool, width: int) -> "_Requests":
        key = (is_forward, width)
        if key not in self._requests:
            out, into = (self.sources, self.targets) if is_forward else (self.targets, self.sources)
            self._requests[key] = _Requests(self._ranks, list(map(len, out)), list(map(len, into)), width)
        return self._requests[key]


def _rows_of(array: NDArray[np.float64]) -> NDArray[Any]:
    """The rows of a contiguous array as single items, which NumPy picks in less than half the time."""
    return array if array.ndim == 1 else array.view(np.dtype((np.void, array.itemsize * array.shape[1])))[:, 0]


def _as_slice(rows: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Rows that follow one another as a slice, which is copied at once."""
    if len(rows) and rows[-1] - rows[0] == len(rows) - 1 and (np.diff(rows) == 1).all():
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows


class _Requests:
    """Persistent requests for so many numbers from and to each neighbour, and their buffers."""

    def __init__(self, ranks: Ranks, sent: list[int], received: list[int], width: int) -> None:
        self._ranks = ranks
        self._all: list[Any] = []  # also if the buffers do not fit into memory
        others = [r for r in range(ranks.size) if r != ranks.rank]
        self._out = {r: np.empty(width * sent[r]) for r in others if sent[r]}
        self._in = {r: np.empty(width * received[r]) for r in others if received[r]}
        self._all += [ranks.comm.Recv_init(buffer, source=r) for r, buffer in self._in.items()]
        self._all += [ranks.comm.Send_init(buffer, dest=r) for r, buffer in self._out.items()]

    def to_send(self, rows: list[NDArray[np.intp]]) -> list[tuple[NDArray[np.intp], NDArray[np.float64]]]:
        return [(rows[r], buffer) for r, buffer in self._out.items()]

    def received(self, rows: list[NDArray[np.intp]]) -> list[tuple[NDArray[np.intp], NDArray[np.float64]]]:
        return [(rows[r], buffer) for r, buffer in self._in.items()]

    def start(self) -> None:
        for request in self._all:
            request.Start()
        self._ranks.bytes_sent += sum(buffer.nbytes for buffer in self._out.values())

    def wait(self) -> None:
        self._ranks.mpi.Prequest.Waitall(self._all)

    def __del__(self) -> None:
        if not self._ranks.mpi.Is_finalized():
            for request in self._all:
                request.Free()
