"""The ranks of a communicator: collective calls in which an error of one rank becomes the error of all."""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Exceptions that all ranks raise as they are; any other becomes a RuntimeError.
_KEPT = (ValueError, TypeError, MemoryError, RuntimeError)
_NUM_SLOTS = 8


def mpi() -> Any:
    """The module of mpi4py.

    Raises:
        ImportError: If it is not installed; the message says which extra has it.
    """
    try:
        from mpi4py import MPI
    except ImportError as error:
        raise ImportError("ccd_warp.distributed needs mpi4py: pip install 'ccd-warp[mpi]'") from error
    return MPI


class Ranks:
    """A communicator of our own with the same ranks, and what we ask of it.

    Every collective call begins with an agreement: one small reduction, which tells whether a rank has failed. A rank
    that fails goes to its next agreement, too, so that all meet there and raise the same error. Between an agreement
    and the call that it stands before nothing can fail but MPI itself.

    Attributes:
        rank: Number of this rank.
        size: Number of ranks.
        local_rank: Number of this rank among those of its machine.
        local_size: Number of ranks of its machine.
        bytes_sent: Bytes that this rank has sent to others since the last reset, reductions left out.
    """

    def __init__(self, comm: Any) -> None:
        MPI = mpi()
        if not isinstance(comm, MPI.Intracomm):
            raise TypeError(f"comm is {type(comm).__name__}; expected an intracommunicator of mpi4py")
        self.mpi = MPI
        self.comm = comm.Dup()
        self.rank, self.size = comm.Get_rank(), comm.Get_size()
        local = comm.Split_type(MPI.COMM_TYPE_SHARED)
        self.local_rank, self.local_size = local.Get_rank(), local.Get_size()
        local.Free()
        self.bytes_sent = 0

    @property
    def default_num_threads(self) -> int:
        """Threads for each rank of a machine, so that they share its cores."""
        return max(1, len(os.sched_getaffinity(0)) // self.local_size)

    def agree(self, *values: float, error: BaseException | None = None) -> list[float]:
        """The least of each of a few numbers over all ranks, or the error of the lowest rank that has one."""
        mine = np.full(_NUM_SLOTS, np.inf)
        mine[0] = self.size if error is None else self.rank
        mine[1 : 1 + len(values)] = values
        least = np.empty(_NUM_SLOTS)
        self.comm.Allreduce(mine, least, op=self.mpi.MIN)
        if least[0] < self.size:
            self._raise(int(least[0]), error)
        return least[1 : 1 + len(values)].tolist()

    def _raise(self, rank: int, error: BaseException | None) -> None:
        """Raise the error of a rank everywhere."""
        text = b""
        if rank == self.rank:
            kind = next((kind for kind in _KEPT if isinstance(error, kind)), RuntimeError)
            name = "" if isinstance(error, _KEPT) else f"{type(error).__name__}: "
            text = pickle.dumps((kind.__name__, f"rank {rank}: {name}{error}"))
        name, message = pickle.loads(self.comm.bcast(text, root=rank))
        agreed = {kind.__name__: kind for kind in _KEPT}[name](message)
        vars(agreed)["_is_agreed"] = True
        if rank == self.rank:
            raise agreed from error
        raise agreed

    @contextmanager
    def together(self) -> Iterator[None]:
        """A block of a collective call: where it fails on one rank, it raises the same error on all."""
        try:
            yield
        except Exception as error:
            if getattr(error, "_is_agreed", False):
                raise
            self.agree(error=error)
        else:
            self.agree()

    def total(self, values: NDArray[Any]) -> NDArray[Any]:
        """The sums of arrays of equal length and type."""
        return self._reduced(values, self.mpi.SUM)

    def least(self, values: NDArray[Any]) -> NDArray[Any]:
        """The minima of arrays of equal length and type."""
        return self._reduced(values, self.mpi.MIN)

    def most(self, values: NDArray[Any]) -> NDArray[Any]:
        """The maxima of arrays of equal length and type."""
        return self._reduced(values, self.mpi.MAX)

    def _reduced(self, values: NDArray[Any], op: Any) -> NDArray[Any]:
        self.agree()
        values = np.asarray(values, order="C")
        result = np.empty_like(values)
        self.comm.Allreduce(values, result, op=op)
        return result

    def sum_before(self, value: int) -> int:
        """The sum of the values of the ranks below this one."""
        self.agree()
        return int(self.comm.exscan(int(value)) or 0)

    def every(self, values: NDArray[Any]) -> NDArray[Any]:
        """The arrays of all ranks, one after the other; they may differ in length but not in type and columns."""
        self.agree()
        values = np.ascontiguousarray(values)
        rows = np.array(self.comm.allgather(len(values)))
        result = np.empty((int(rows.sum()), *values.shape[1:]), dtype=values.dtype)
        row_bytes = values.itemsize * int(np.prod(values.shape[1:], dtype=np.int64))
        counts = rows * row_bytes
        begins = np.concatenate([[0], np.cumsum(counts)[:-1]])
        byte = self.mpi.BYTE
        self.comm.Allgatherv([values, counts[self.rank], byte], [result, counts, begins, byte])
        return result

    def at_root(self, values: NDArray[Any]) -> NDArray[Any] | None:
        """The arrays of all ranks, one after the other, on rank 0; None on the others."""
        self.agree()
        parts = self.comm.gather(values, root=0)
        return None if parts is None else np.concatenate(parts)

    def swap(self, arrays: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
        """Send an array to every rank and get one from each; empty ones are not sent.

        All arrays have the type of the first, and as many columns.
        """
        self.agree()
        arrays = [np.ascontiguousarray(array) for array in arrays]
        like = arrays[0]
        lengths, coming = np.array([len(array) for array in arrays]), np.empty(self.size, dtype=np.int64)
        self.comm.Alltoall(lengths, coming)
        found = [np.empty((int(n), *like.shape[1:]), dtype=like.dtype) for n in coming]
        byte, requests = self.mpi.BYTE, []
        for r in range(self.size):
            if r != self.rank and len(found[r]):
                requests.append(self.comm.Irecv([found[r], byte], source=r))
        for r in range(self.size):
            if r != self.rank and len(arrays[r]):
                requests.append(self.comm.Isend([arrays[r], byte], dest=r))
                self.bytes_sent += arrays[r].nbytes
        found[self.rank] = arrays[self.rank]
        self.mpi.Request.Waitall(requests)
        return found
