"""ipc-toolkit's narrow phases, one Python call a query, in a process of their own that is stopped where one hangs.

The process starts neither Warp nor a kernel of ours; it writes into shared memory, so that no message is sent for a
query. A query that takes longer than the cap is stopped, counts as having taken the cap and has no answer.
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
from ccd_warp.benchmarks.memory import PeakMemory

PEERS = ("tight_inclusion", "additive")


def _solver(peer: str, kind: str) -> Callable[[list[np.ndarray], float, float], tuple[bool, float]]:
    """One query as (points, tolerance, separation) to (hit, toi)."""
    import ipctk

    ipctk.set_logger_level(ipctk.LoggerLevel.off)  # additive CCD warns of every small gap
    if peer == "tight_inclusion":
        # the raw function: no rescaling of toi, no refinement of a toi of zero
        raw = ipctk.tight_inclusion.point_triangle_ccd if kind == "vertex-face" else ipctk.tight_inclusion.edge_edge_ccd

        def tight_inclusion(points: list[np.ndarray], tolerance: float, separation: float) -> tuple[bool, float]:
            hit, toi, _ = raw(*points, min_distance=separation, tolerance=tolerance)
            return hit, toi

        return tight_inclusion

    made: dict[float, Any] = {}

    def additive(points: list[np.ndarray], tolerance: float, separation: float) -> tuple[bool, float]:
        # It has no tolerance: it stops where the gap has shrunk to 1 - conservative_rescaling of that at the start.
        if tolerance not in made:
            made[tolerance] = ipctk.AdditiveCCD(conservative_rescaling=1.0 - tolerance)
        solver = made[tolerance]
        solve = solver.point_triangle_ccd if kind == "vertex-face" else solver.edge_edge_ccd
        return solve(*points, min_distance=separation)

    return additive


def _overhead(solve: Callable, kind: str) -> float:
    """Seconds of a call for a query that is decided at once: two primitives at rest, far apart."""
    x = np.random.default_rng(0).uniform(-1, 1, (4, 3))
    x[2 if kind == "edge-edge" else 1 :, 2] += 100.0
    points = [*x, *x]
    times = []
    for _ in range(1000):
        begin = time.perf_counter()
        solve(points, 1e-3, 0.0)
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def _serve(connection: Any, peer: str, kind: str, queries: Any, shared: tuple) -> None:
    """Loop of the process: takes (positions, seconds or None), answers how many of them were taken."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it, and ends this process
    points_t0, points_t1, tolerances, separation = queries
    toi, seconds, current = (np.frombuffer(array, dtype=dtype) for array, dtype in zip(shared, "ddq", strict=True))
    solve = _solver(peer, kind)
    connection.send(_overhead(solve, kind))
    while True:
        positions, budget = connection.recv()
        points = [[*points_t0[i], *points_t1[i]] for i in positions]  # arrays are made before the clock runs
        memory = PeakMemory()
        taken = 0
        end = time.perf_counter() + (budget if budget is not None else 1e9)
        for i, arguments in zip(positions, points, strict=True):
            begin = time.perf_counter()
            if taken and begin > end:
                break
            current[0] = i
            hit, t = solve(arguments, tolerances[i], separation)
            seconds[i] = time.perf_counter() - begin
            toi[i] = t if hit else np.inf
            taken += 1
        connection.send((taken, memory.bytes()))


@dataclass
class PeerAnswers:
    """What a peer did with the first queries of a set.

    Attributes:
        count: How many queries it took, from the first on.
        capped: Which of them were stopped at the cap.
        toi: Times of impact of all queries of the set; inf where there is none, nan where it was stopped or not asked.
        rounds: Seconds of each query in each pass, shape [rounds, count], call overhead included.
        overhead: Seconds of a Python call that does nothing.
        peak_bytes: Most memory that a pass took; None where unknown.
    """

    count: int = 0
    capped: list[int] = field(default_factory=list)
    toi: np.ndarray = field(default_factory=lambda: np.empty(0))
    rounds: list[np.ndarray] = field(default_factory=list)
    overhead: float = 0.0
    peak_bytes: int | None = None


class Peer:
    """A peer on the queries of one set, in passes over the same first queries."""

    def __init__(
        self,
        peer: str,
        kind: str,
        points_t0: np.ndarray,
        points_t1: np.ndarray,
        tolerances: np.ndarray,
        separation: float,
        cap: float,
    ) -> None:
        self.name, self.kind, self.cap = peer, kind, cap
        self.queries = (points_t0, points_t1, tolerances, separation)
        self.answers = PeerAnswers(toi=np.full(len(points_t0), np.nan))
        # A clean server forks quickly after a stop, and holds no threads whose locks a fork would copy.
        methods = multiprocessing.get_all_start_methods()
        self._context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
        if "forkserver" in methods:
            self._context.set_forkserver_preload(["ccd_warp.benchmarks.peers", "ipctk"])
        n = len(points_t0)
        self._shared = tuple(
            self._context.RawArray(kind, max(1, size))
            for kind, size in ((ctypes.c_double, n), (ctypes.c_double, n), (ctypes.c_longlong, 1))
        )
        self._toi, self._seconds, self._current = (
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
        self.answers.overhead = self._connection.recv()

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None

    def run(self, seconds: float) -> None:
        """One pass: the first takes as many queries as fit the seconds, the others the same again."""
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
            taken = self._take(positions[:500], left)
            if first:
                answers.count += taken
            positions = positions[taken:]
        self._close_pass()

    def _take(self, positions: list[int], budget: float | None) -> int:
        """Have some queries solved; how many were taken, one that was stopped included."""
        if self._process is None:
            self._start()
        self._current[0] = -1
        self._connection.send((positions, budget))
        current, since = -1, time.perf_counter()
        while not self._connection.poll(min(0.05, self.cap / 4)):
            if self._current[0] != current:
                current, since = int(self._current[0]), time.perf_counter()
            elif current >= 0 and time.perf_counter() - since > self.cap:
                self.close()
                self._toi[current], self._seconds[current] = np.nan, self.cap
                self.answers.capped.append(current)
                return positions.index(current) + 1
        try:
            taken, peak = self._connection.recv()
        except EOFError as error:  # it crashed: the query it was at has no answer
            raise RuntimeError(f"{self.name} ended at query {self._current[0]} of a {self.kind} set") from error
        self.answers.peak_bytes = peak if peak is None else max(peak, self.answers.peak_bytes or 0)
        return taken

    def _close_pass(self) -> None:
        answers = self.answers
        answers.toi[: answers.count] = self._toi[: answers.count]
        answers.rounds.append(self._seconds[: answers.count].copy())
