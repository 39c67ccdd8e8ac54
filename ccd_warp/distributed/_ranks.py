"""The ranks of a communicator: collective calls in which an error of one rank becomes the error of all."""

from __future__ import annotations

import hashlib
import pickle
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partialmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Exceptions that all ranks raise as they are; any other becomes a RuntimeError.
_KEPT = (ValueError, TypeError, MemoryError, RuntimeError, KeyboardInterrupt)
# What an agreement reduces: the lowest rank that has failed, the call twice, and the values.
_NUM_SLOTS, _FIRST_VALUE = 8, 3


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


@dataclass
class Sent:
    """What a rank has sent to others.

    Attributes:
        num_bytes: Bytes of its messages.
        num_messages: Messages.
        num_reductions: Reductions over all ranks; each takes about as many messages as the number of ranks has bits.
    """

    num_bytes: int = 0
    num_messages: int = 0
    num_reductions: int = 0


class _Duplicate:
    """The communicator of our own for one of the caller's: one for all its meshes, as MPI has few to give."""

    _key: int | None = None

    def __init__(self, comm: Any) -> None:
        self.comm, self.num_pipelines = comm.Dup(), 0
        comm.Set_attr(self._key, self)

    @classmethod
    def of(cls, comm: Any) -> _Duplicate:
        """That of a communicator, made by its first mesh, collectively."""
        cls._key = mpi().Comm.Create_keyval() if cls._key is None else cls._key
        return comm.Get_attr(cls._key) or cls(comm)


class Ranks:
    """A communicator of our own with the same ranks, and what we ask of it.

    Every collective call begins with an agreement: one small reduction, which tells whether a rank has failed. A rank
    that fails goes to its next agreement, too, so that all meet there and raise the same error. Between an agreement
    and the call that it stands before nothing can fail but MPI itself. Ctrl-C is noted, and is an error of its rank at
    its next agreement. An agreement also compares what the ranks call, so that those that call different functions
    raise an error and do not wait for each other.

    Attributes:
        rank: Number of this rank.
        size: Number of ranks.
        local_rank: Number of this rank among those of its machine.
        local_size: Number of ranks of its machine.
        sent: What this rank has sent in the present call.
    """

    def __init__(self, comm: Any) -> None:
        self.mpi = MPI = mpi()
        if not isinstance(comm, MPI.Intracomm):
            raise TypeError(f"comm is {type(comm).__name__}; expected an intracommunicator of mpi4py")
        self._duplicate = _Duplicate.of(comm)
        self.comm = self._duplicate.comm
        self.rank, self.size = comm.Get_rank(), comm.Get_size()
        local = comm.Split_type(MPI.COMM_TYPE_SHARED)
        self.local_rank, self.local_size = local.Get_rank(), local.Get_size()
        local.Free()
        self.sent, self._is_interrupted = Sent(), False

    def next_pipeline(self) -> int:
        """The number of a new pipeline among all of the caller's communicator."""
        self._duplicate.num_pipelines += 1
        return self._duplicate.num_pipelines

    def agree(self, *values: float, error: BaseException | None = None) -> list[float]:
        """The least of each of a few numbers over all ranks, or the error of the lowest rank that has one."""
        if error is None and self._is_interrupted:
            error, self._is_interrupted = KeyboardInterrupt("interrupted"), False
        mine = np.full(_NUM_SLOTS, np.inf)
        mine[0] = self.size if error is None else self.rank
        mine[1:_FIRST_VALUE] = self._code, -self._code
        mine[_FIRST_VALUE : _FIRST_VALUE + len(values)] = values
        least = np.empty(_NUM_SLOTS)
        self.comm.Allreduce(mine, least, op=self.mpi.MIN)
        self.sent.num_reductions += 1
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
        if rank == self.rank and error is not None and not isinstance(error, (Exception, KeyboardInterrupt)):
            raise _agreed(error)  # the end of the program, which is that of this rank
        raise agreed from (error if rank == self.rank else None)

    @contextmanager
    def together(self, call: str) -> Iterator[None]:
        """A collective call, with what must be the same on all ranks: where one fails, all raise its error."""
        self._call = call
        self._code = float(int.from_bytes(hashlib.sha256(call.encode()).digest()[:6], "big"))
        with self._interrupts_noted():
            try:
                yield
            except BaseException as error:
                if not getattr(error, "_is_agreed", False):
                    self.agree(error=error)
                raise
            self.agree()

    @contextmanager
    def _interrupts_noted(self) -> Iterator[None]:
        """A block in which Ctrl-C waits for an agreement; a handler of the program's own is left as it is."""
        own, is_main = signal.default_int_handler, threading.current_thread() is threading.main_thread()
        if not is_main or signal.getsignal(signal.SIGINT) is not own:
            yield
            return
        signal.signal(signal.SIGINT, lambda *_: setattr(self, "_is_interrupted", True))
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, own)
            is_late, self._is_interrupted = self._is_interrupted, False
            if is_late:  # after the last agreement, so that the others do not learn of it
                signal.raise_signal(signal.SIGINT)

    def _reduced(self, op: str, values: NDArray[Any]) -> NDArray[Any]:
        """The sums, minima or maxima of arrays of equal length and type."""
        values = np.asarray(values, order="C")
        result = np.empty_like(values)
        self.agree()
        self.comm.Allreduce(values, result, op=getattr(self.mpi, op))
        self.sent.num_reductions += 1
        return result

    total, least, most = partialmethod(_reduced, "SUM"), partialmethod(_reduced, "MIN"), partialmethod(_reduced, "MAX")

    def every(self, values: NDArray[Any]) -> NDArray[Any]:
        """The arrays of all ranks, one after the other; they may differ in length but not in type and columns."""
        return np.concatenate(self.swap([values] * self.size))

    def at_root(self, values: NDArray[Any]) -> NDArray[Any]:
        """The arrays of all ranks, one after the other, on rank 0; an empty one on the others."""
        return np.concatenate(self.swap([values, *[values[:0]] * (self.size - 1)]))

    def swap(self, arrays: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
        """Send an array to every rank and get one from each; empty ones are not sent.

        All arrays have the type of the first, and as many columns.
        """
        arrays = [np.ascontiguousarray(array) for array in arrays]
        lengths, coming = np.array([len(array) for array in arrays]), np.empty(self.size, dtype=np.int64)
        self.agree()
        self.comm.Alltoall(lengths, coming)
        # what comes may not fit into memory, and then nothing is sent
        received = [np.empty((int(n), *arrays[0].shape[1:]), dtype=arrays[0].dtype) for n in coming]
        self.exchange(dict(enumerate(arrays)), dict(enumerate(received)))
        received[self.rank] = arrays[self.rank]
        return received

    def exchange(self, sent: dict[int, NDArray[Any]], received: dict[int, NDArray[Any]]) -> None:
        """Send arrays to other ranks, and receive arrays of known sizes from others; empty ones are not sent."""
        self.agree()
        to, begun = [r for r, a in sent.items() if r != self.rank and a.size], []
        begun += [self.comm.Irecv(a, source=r) for r, a in received.items() if r != self.rank and a.size]
        begun += [self.comm.Isend(sent[r], dest=r) for r in to]
        self.mpi.Request.Waitall(begun)
        self.sent.num_bytes += sum(sent[r].nbytes for r in to)
        self.sent.num_messages += len(to)


def _agreed(error: BaseException) -> BaseException:
    """An error that all ranks raise, so that none has to tell the others."""
    error._is_agreed = True  # type: ignore[attr-defined]
    return error
