"""The ranks of a communicator: collective calls in which an error of one rank becomes the error of all."""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ccd_warp.distributed._interrupts import Interrupts

# Exceptions that all ranks raise as they are; any other becomes a RuntimeError.
_KEPT = (ValueError, TypeError, MemoryError, RuntimeError, KeyboardInterrupt)
# What an agreement reduces: whether a rank has failed, the call twice, and the values.
_NUM_SLOTS, _FIRST_VALUE = 8, 3
# MPI counts the bytes of a message by a number of 31 bits.
MOST_BYTES = 1 << 30


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


class _Duplicate:
    """The communicator of our own beside one of the caller's: one for all its meshes, as MPI has few to give."""

    _key: int | None = None

    def __init__(self, comm: Any) -> None:
        self.comm = comm.Dup()
        self.num_pipelines = 0

    @classmethod
    def of(cls, comm: Any) -> _Duplicate:
        """That of a communicator, made by its first mesh, collectively."""
        if cls._key is None:
            cls._key = comm.Create_keyval()
        duplicate: _Duplicate | None = comm.Get_attr(cls._key)
        if duplicate is None:
            duplicate = cls(comm)
            comm.Set_attr(cls._key, duplicate)
        return duplicate


class Ranks:
    """A communicator of our own with the same ranks, and what we ask of it.

    Every collective call begins with an agreement: one small reduction, which tells whether a rank has failed. A rank
    that fails goes to its next agreement, too, so that all meet there and raise the same error. Between an agreement
    and the call that it stands before nothing can fail but MPI itself, and Ctrl-C waits. An agreement also compares
    what the ranks call, so that those that call different functions raise an error and do not wait for each other.

    Attributes:
        rank: Number of this rank.
        size: Number of ranks.
        local_rank: Number of this rank among those of its machine.
        local_size: Number of ranks of its machine.
        bytes_sent: Bytes that this rank has sent to others since the last reset, reductions left out.
    """

    def __init__(self, comm: Any, interrupts: Interrupts | None = None) -> None:
        MPI = mpi()
        if not isinstance(comm, MPI.Intracomm):
            raise TypeError(f"comm is {type(comm).__name__}; expected an intracommunicator of mpi4py")
        self.mpi = MPI
        self._duplicate = _Duplicate.of(comm)
        self.comm = self._duplicate.comm
        self.rank, self.size = comm.Get_rank(), comm.Get_size()
        local = comm.Split_type(MPI.COMM_TYPE_SHARED)
        self.local_rank, self.local_size = local.Get_rank(), local.Get_size()
        local.Free()
        self.bytes_sent = 0
        self._interrupts = interrupts or Interrupts()
        self.name_call("DistributedMesh")

    @property
    def default_num_threads(self) -> int:
        """Threads for each rank of a machine, so that they share its cores."""
        return max(1, len(os.sched_getaffinity(0)) // self.local_size)

    def next_pipeline(self) -> int:
        """The number of a new pipeline among all of the caller's communicator, also where one rank has missed some."""
        self._duplicate.num_pipelines = int(self.most(np.array(self._duplicate.num_pipelines))) + 1
        return self._duplicate.num_pipelines

    def name_call(self, call: str) -> None:
        """Say which call follows; all ranks must say the same before the next agreement."""
        self._call = call
        self._code = float(int.from_bytes(hashlib.sha256(call.encode()).digest()[:6], "big"))

    def agree(self, *values: float, error: BaseException | None = None) -> list[float]:
        """The least of each of a few numbers over all ranks, or the error of the lowest rank that has one."""
        mine = np.full(_NUM_SLOTS, np.inf)
        mine[0] = self.size if error is None else self.rank
        mine[1:_FIRST_VALUE] = self._code, -self._code
        mine[_FIRST_VALUE : _FIRST_VALUE + len(values)] = values
        least = np.empty(_NUM_SLOTS)
        with self._interrupts.held():
            self.comm.Allreduce(mine, least, op=self.mpi.MIN)
            if least[0] < self.size or least[1] != -least[2]:
                self._interrupts.hold()  # until the end of the call, as no other rank learns of it any more
            if least[0] < self.size:
                self._raise(int(least[0]), error)
            if least[1] != -least[2]:
                calls = self.comm.allgather(self._call)
                other = next(r for r, call in enumerate(calls) if call != calls[0])
                text = f"rank 0 calls {calls[0]} and rank {other} {calls[other]}; expected one call of all ranks"
                raise _agreed(ValueError(text))
        return least[_FIRST_VALUE : _FIRST_VALUE + len(values)].tolist()

    def _raise(self, rank: int, error: BaseException | None) -> None:
        """Raise the error of a rank everywhere."""
        text = b""
        if rank == self.rank:
            kind = next((kind for kind in _KEPT if isinstance(error, kind)), RuntimeError)
            name = "" if isinstance(error, _KEPT) else f"{type(error).__name__}: "
            text = pickle.dumps((kind.__name__, f"rank {rank}: {name}{str(error) or type(error).__name__}"))
        name, message = pickle.loads(self.comm.bcast(text, root=rank))
        agreed = _agreed({kind.__name__: kind for kind in _KEPT}[name](message))
        if rank != self.rank:
            raise agreed
        if error is not None and not isinstance(error, (Exception, KeyboardInterrupt)):
            raise _agreed(error)  # the end of the program, which is that of this rank
        raise agreed from error

    @contextmanager
    def together(self, call: str | None = None) -> Iterator[None]:
        """A block of a collective call: where it fails on one rank, it raises the same error on all.

        ``call`` says of which, if it is the outermost block.
        """
        with self._interrupts.taken():
            if call is not None:
                self.name_call(call)
            try:
                try:
                    self._interrupts.allow()
                    yield
                    self._interrupts.hold()
                except BaseException:
                    self._interrupts.hold()
                    raise
            except (
                BaseException
            ) as error:  # of the block, or an interrupt before either hold, after which none is raised
                if not getattr(error, "_is_agreed", False):
                    self.agree(error=error)
                raise
            self.agree()

    @contextmanager
    def after_agreement(self) -> Iterator[None]:
        """A collective operation, which no rank begins where one has failed; Ctrl-C waits for its end."""
        with self._interrupts.held():
            self.agree()
            yield

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
        values = np.asarray(values, order="C")
        result = np.empty_like(values)
        with self.after_agreement():
            self.comm.Allreduce(values, result, op=op)
        return result

    def sum_before(self, value: int) -> int:
        """The sum of the values of the ranks below this one."""
        with self.after_agreement():
            return int(self.comm.exscan(int(value)) or 0)

    def every(self, values: NDArray[Any]) -> NDArray[Any]:
        """The arrays of all ranks, one after the other; they may differ in length but not in type and columns."""
        values = np.ascontiguousarray(values)
        row_bytes = values.itemsize * int(np.prod(values.shape[1:], dtype=np.int64))
        byte = self.mpi.BYTE
        with self.after_agreement():
            rows = np.array(self.comm.allgather(len(values)))
            result = np.empty((int(rows.sum()), *values.shape[1:]), dtype=values.dtype)
            counts = rows * row_bytes
            begins = np.concatenate([[0], np.cumsum(counts)[:-1]])
            self.comm.Allgatherv([values, counts[self.rank], byte], [result, counts, begins, byte])
        return result

    def at_root(self, values: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]] | None:
        """Arrays by name, those of all ranks one after the other, on rank 0; None on the others."""
        sent = np.frombuffer(pickle.dumps(values, protocol=5), dtype=np.uint8)
        received = self.swap([sent, *[sent[:0]] * (self.size - 1)])
        if self.rank != 0:
            return None
        parts = [pickle.loads(part.data) for part in received]
        return {name: np.concatenate([part[name] for part in parts]) for name in values}

    def swap(self, arrays: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
        """Send an array to every rank and get one from each; empty ones are not sent.

        All arrays have the type of the first, and as many columns.
        """
        arrays = [np.ascontiguousarray(array) for array in arrays]
        like = arrays[0]
        lengths, coming = np.array([len(array) for array in arrays]), np.empty(self.size, dtype=np.int64)
        with self.after_agreement():
            self.comm.Alltoall(lengths, coming)
        # what comes may not fit into memory, and then nothing is sent
        received = [np.empty((int(n), *like.shape[1:]), dtype=like.dtype) for n in coming]
        byte, requests = self.mpi.BYTE, []
        with self.after_agreement():
            for r in range(self.size):
                if r != self.rank:
                    requests += [self.comm.Irecv([part, byte], source=r) for part in _messages(received[r])]
            for r in range(self.size):
                if r != self.rank:
                    requests += [self.comm.Isend([part, byte], dest=r) for part in _messages(arrays[r])]
                    self.bytes_sent += arrays[r].nbytes
            self.mpi.Request.Waitall(requests)
        received[self.rank] = arrays[self.rank]
        return received


def _messages(array: NDArray[Any]) -> list[NDArray[np.uint8]]:
    """The bytes of an array in parts that a message can hold; none of an empty one."""
    as_bytes = array.reshape(-1).view(np.uint8)
    return [as_bytes[k : k + MOST_BYTES] for k in range(0, len(as_bytes), MOST_BYTES)]


def _agreed(error: BaseException) -> BaseException:
    """An error that all ranks raise, so that none has to tell the others."""
    error._is_agreed = True  # type: ignore[attr-defined]
    return error
