"""ipc-toolkit's narrow phases, one Python call for each query, in a separate process that is stopped if a query hangs.

The process starts neither Warp nor a kernel of ours; it writes into shared memory, so that no message is sent for a
query. A query that takes longer than the cap is stopped, counts with the time of the cap and has no answer. The same
holds for a query that crashes the process.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from memory import PeakMemory, resident

# Number of calls for measuring the cost of a Python call, around every piece of a pass.
_OVERHEAD_CALLS = 60
_PIECE = 500
# Indices in the shared state: the query that runs, and the memory of the process before its piece.
_CURRENT, _MEMORY = 0, 1


def _solver(peer: str, kind: str, tolerance: float) -> Callable[[list[np.ndarray], float, float], tuple[bool, float]]:
    """One query as (points, tolerance, separation) to (hit, toi)."""
    import ipctk

    ipctk.set_logger_level(ipctk.LoggerLevel.off)  # additive CCD warns of every small gap
    is_face = kind == "vertex-face"
    if peer == "tight_inclusion":
        # the raw function: no rescaling of toi, no refinement of a toi of zero
        raw = ipctk.tight_inclusion.point_triangle_ccd if is_face else ipctk.tight_inclusion.edge_edge_ccd

        def tight_inclusion(points: list[np.ndarray], tolerance: float, separation: float) -> tuple[bool, float]:
            hit, toi, _ = raw(*points, min_distance=separation, tolerance=tolerance)
            return hit, toi

        return tight_inclusion

    # It has no tolerance: it stops where the gap has shrunk to 1 - conservative_rescaling of that at the start.
    solver = ipctk.AdditiveCCD(conservative_rescaling=1.0 - tolerance)
    solve = solver.point_triangle_ccd if is_face else solver.edge_edge_ccd

    def additive(points: list[np.ndarray], _: float, separation: float) -> tuple[bool, float]:
        return solve(*points, min_distance=separation)

    return additive


def _far_apart(kind: str) -> list[list[np.ndarray]]:
    """Queries that are decided at once: two stationary primitives, far apart."""
    x = np.random.default_rng(0).uniform(-1, 1, (_OVERHEAD_CALLS, 4, 3))
    x[:, 2 if kind == "edge-edge" else 1 :, 2] += 100.0
    return [[*points, *points] for points in x]


def _serve(connection: Any, peer: str, kind: str, queries: Any, shared: tuple) -> None:
    """Loop of the process: takes (positions, seconds or None), answers (how many were taken, overhead, memory)."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles it, and ends this process
    points_t0, points_t1, tolerance, unit, separation = queries
    toi, seconds, state = (np.frombuffer(array, dtype=dtype) for array, dtype in zip(shared, "ddq", strict=True))
    solve = _solver(peer, kind, tolerance)
    lengths = tolerance * unit
    empty = _far_apart(kind)

    def overhead() -> float:
        times = []
        for points in empty:
            begin = time.perf_counter()
            solve(points, 1e-3, 0.0)
            times.append(time.perf_counter() - begin)
        return float(np.median(times))

    overhead()  # the first calls are slow
    connection.send(None)
    while True:
        positions, budget = connection.recv()
        points = [[*points_t0[i], *points_t1[i]] for i in positions]  # arrays are made before the time is taken
        memory = PeakMemory()
        state[_MEMORY] = memory.before or -1
        cost = [overhead()]
        taken = 0
        end = time.perf_counter() + (budget if budget is not None else 1e9)
        for i, arguments in zip(positions, points, strict=True):
            begin = time.perf_counter()
            if taken and begin > end:
                break
            state[_CURRENT] = i
            hit, t = solve(arguments, lengths[i], separation)
            seconds[i] = time.perf_counter() - begin
            toi[i] = t if hit else np.inf
            taken += 1
        state[_CURRENT] = -1
        cost.append(overhead())
        connection.send((taken, cost, memory.bytes()))


@dataclass
class PeerAnswers:
    """Results of a peer on the first queries of a set.

    Attributes:
        count: Number of queries that it took, from the first on.
        capped: Which of them were stopped at the cap, or crashed the process.
        toi: Times of impact of all queries of the set; inf where there is none, nan where the query was stopped or not
            run, or where the peer returned nan.
        rounds: Seconds of each query in each pass, shape [rounds, count], call overhead included.
        overheads: Seconds of a Python call that does nothing, measured around each piece of each pass.
        peak_bytes: Largest memory that a piece took; None where unknown.
    """

    count: int = 0
    capped: list[int] = field(default_factory=list)
    toi: np.ndarray = field(default_factory=lambda: np.empty(0))
    rounds: list[np.ndarray] = field(default_factory=list)
    overheads: list[float] = field(default_factory=list)
    peak_bytes: int | None = None

    @property
    def overhead(self) -> float:
        """Seconds of a Python call that does nothing."""
        return float(np.median(self.overheads)) if self.overheads else 0.0

    @property
    def resolution(self) -> float:
        """Least time of a query that can be resolved beside the overhead: the spread of the overhead's measurements."""
        if not self.overheads:
            return 0.0
        low, high = np.percentile(self.overheads, [10, 90])
        return max(float(high - low), 0.05 * self.overhead)


class Peer:
    """A peer on the queries of one set, in passes over the same first queries."""

    def __init__(
        self,
        peer: str,
        kind: str,
        points_t0: np.ndarray,
        points_t1: np.ndarray,
        tolerance: float,
        unit: np.ndarray,
        separation: float,
        cap: float,
    ) -> None:
        """``unit`` is the length for each query of which the tolerance is a multiple, shape [n]."""
        self.name, self.kind, self.cap = peer, kind, cap
        self.queries = (points_t0, points_t1, tolerance, unit, separation)
        self.answers = PeerAnswers(toi=np.full(len(points_t0), np.nan))
        # A clean server forks quickly after a stop, and holds no threads whose locks a fork would copy.
        methods = multiprocessing.get_all_start_methods()
        self._context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
        if "forkserver" in methods:
            self._context.set_forkserver_preload(["peers", "ipctk"])
        n = len(points_t0)
        self._shared = tuple(
            self._context.RawArray(number, max(1, size))
            for number, size in ((ctypes.c_double, n), (ctypes.c_double, n), (ctypes.c_longlong, 2))
        )
        self._toi, self._seconds, self._state = (
            np.frombuffer(array, dtype=dtype) for array, dtype in zip(self._shared, "ddq", strict=True)
        )
        self._process: Any = None

    def _start(self) -> None:
        self._connection, theirs = self._context.Pipe()
        self._process = self._context.Process(
            target=_serve, args=(theirs, self.name, self.kind, self.queries, self._shared), daemon=True
        )
        self._process.start()
        theirs.close()
        try:
            self._connection.recv()
        except EOFError as error:
            raise ValueError(
                f"the process of {self.name} ended as it began; is ipctk installed as it should be?"
            ) from error

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None

    def run(self, seconds: float) -> None:
        """Run one pass: the first takes as many queries as fit the seconds, later ones take the same queries."""
        answers = self.answers
        first = not answers.rounds
        capped = set(answers.capped)
        positions = [i for i in range(len(self._toi) if first else answers.count) if i not in capped]
        if self._process is None and positions:
            self._start()
        until = time.perf_counter() + seconds if first else None
        while positions:
            left = None if until is None else until - time.perf_counter()
            if left is not None and left <= 0 and answers.count:
                break
            # Few at a time, so that a stop loses nothing and the arrays of a pass are not all made at once.
            taken = self._take(positions[:_PIECE], left)
            if first:
                answers.count += taken
            positions = positions[taken:]
        answers.toi[: answers.count] = self._toi[: answers.count]
        answers.rounds.append(self._seconds[: answers.count].copy())

    def _take(self, positions: list[int], budget: float | None) -> int:
        """Have some queries solved, and return how many were taken, including a stopped one."""
        if self._process is None:
            self._start()
        self._state[_CURRENT] = -1
        try:
            self._connection.send((positions, budget))
            current, since = -1, time.perf_counter()
            while not self._connection.poll(min(0.05, self.cap / 4)):
                if self._state[_CURRENT] != current:
                    current, since = int(self._state[_CURRENT]), time.perf_counter()
                elif current >= 0 and time.perf_counter() - since > self.cap:
                    return self._stop(positions, current)
            taken, cost, peak = self._connection.recv()
        except (EOFError, OSError):  # the query has crashed the process
            return self._stop(positions, max(int(self._state[_CURRENT]), positions[0]))
        self.answers.overheads += cost
        self._keep_peak(peak)
        return taken

    def _stop(self, positions: list[int], current: int) -> int:
        """Stop the process at a query, which then has no answer, and return how many of the positions were taken."""
        if self._state[_MEMORY] > 0 and self._process.is_alive():
            self._keep_peak(resident("VmHWM", self._process.pid) - int(self._state[_MEMORY]))
        self.close()
        self._toi[current], self._seconds[current] = np.nan, self.cap
        self.answers.capped.append(current)
        return positions.index(current) + 1

    def _keep_peak(self, peak: int | None) -> None:
        if peak is not None:
            self.answers.peak_bytes = max(peak, self.answers.peak_bytes or 0)
