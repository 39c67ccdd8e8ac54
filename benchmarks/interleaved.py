"""Every method on one set at one tolerance, in interleaved rounds: time, error, faults, limits, memory."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from accuracy import judged
from distance_queries import size_of as size_of_motion
from memory import PeakMemory
from methods import Answer, Method
from oracle import exact_gap
from peers import Peer
from query_sets import QuerySet
from timing import quartiles


@dataclass(frozen=True)
class Effort:
    """How long to measure.

    Attributes:
        rounds: Number of interleaved repeats.
        batch: Queries of a timed call; smaller sets are tiled.
        seconds: Longest time of a call within this process; a slower method gets only the first queries of the set.
        peer_seconds: Time of a peer's first pass; the other passes repeat it.
        cap: Seconds after which a query of a peer is stopped.
    """

    rounds: int
    batch: int
    seconds: float
    peer_seconds: float
    cap: float


@dataclass
class _Batch:
    """A method within this process, with the queries on which it is timed and judged."""

    method: Method
    queries: QuerySet
    tolerance: float
    count: int
    tile: int
    answer: Answer = field(default_factory=lambda: Answer(np.empty(0)))
    peak_bytes: int | None = None
    rounds: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        points = (self.queries.points_t0[: self.count], self.queries.points_t1[: self.count])
        self.frames = [np.resize(p, (self.tile, *p.shape[1:])) for p in points]

    @classmethod
    def make(cls, method: Method, queries: QuerySet, tolerance: float, effort: Effort) -> _Batch:
        """Determine how many queries fit the time, and answer those."""
        count = min(4, len(queries))
        while True:
            batch = cls(method, queries, tolerance, count, count)
            seconds = min(batch.once(), batch.once())  # the first call also loads kernels and fills caches
            if count == len(queries) or 2 * seconds > effort.seconds:
                break
            count = min(4 * count, len(queries))
        # a call has a fixed cost, so this is an upper bound on the time of a query
        tile = max(count, min(effort.batch, int(count * effort.seconds / max(seconds, 1e-9))))
        batch = cls(method, queries, tolerance, count, tile)
        memory = PeakMemory()
        batch.once()
        batch.peak_bytes = memory.bytes()
        return batch

    def once(self) -> float:
        """Seconds of one call."""
        q = self.queries
        begin = time.perf_counter()
        answer = self.method.solve(q.kind, *self.frames, self.tolerance, q.separation, q.length_scale)
        seconds = time.perf_counter() - begin
        limited = None if answer.limited is None else answer.limited[: self.count]
        self.answer = Answer(answer.toi[: self.count], limited)
        return seconds

    def row(self) -> dict:
        limited = self.answer.limited
        return {
            "method": self.method.name,
            **_speed([seconds / self.tile for seconds in self.rounds]),
            "timed_queries": self.tile,
            **judged(self.queries.exact[: self.count], self.answer.toi),
            "phantom_gap": self._phantom_gap() if self.method.group == "ours" else None,
            "limited": None if limited is None else int(limited.sum()),
            "peak_bytes": self.peak_bytes,
        }

    def _phantom_gap(self) -> float:
        """The largest gap of a phantom at its toi, as a part of the size of the query's motion; 0 without phantoms."""
        q, toi = self.queries, self.answer.toi
        rows = np.flatnonzero(~q.exact.hit[: self.count] & np.isfinite(toi))
        gaps = np.array([exact_gap(q.kind, q.points_t0[i], q.points_t1[i], float(toi[i])) for i in rows])
        sizes = size_of_motion(q.points_t0[rows], q.points_t1[rows])
        return float(((gaps - q.separation * q.unit()[rows]) / sizes).max(initial=0.0))


def _speed(per_query: list[float]) -> dict:
    return {
        "seconds": float(np.median(per_query)),
        "quartiles": quartiles(per_query),
    }


def _peer_row(method: Method, queries: QuerySet, peer: Peer) -> dict:
    """Figures of a peer; a stopped query counts with the time of the cap, and has no answer."""
    answers = peer.answers
    count = answers.count
    answered = answered_by(peer)[:count]
    passes = np.array(answers.rounds)
    floor = answers.resolution
    return {
        "method": method.name,
        **_speed([max(seconds - answers.overhead, floor) for seconds in passes.mean(axis=1)]),
        "below_resolution": bool(np.median(passes.mean(axis=1)) - answers.overhead < floor),
        "median_query_seconds": max(float(np.median(np.median(passes, axis=0))) - answers.overhead, floor),
        "timed_queries": count,
        "call_overhead": answers.overhead,
        "resolution": floor,
        **judged(queries.exact[:count][answered], answers.toi[:count][answered]),
        "limited": len(answers.capped),
        "undecided": int(np.isnan(answers.toi[:count]).sum()) - len(answers.capped),
        "peak_bytes": answers.peak_bytes,
    }


def answered_by(peer: Peer) -> np.ndarray:
    """Which queries of the set a peer has answered, bool, shape [n]: not stopped, and not reported as a hit at nan."""
    return ~np.isnan(peer.answers.toi)


def measure(methods: list[Method], queries: QuerySet, tolerance: float, effort: Effort) -> list[dict]:
    """One row for each method; a method that does not support the set's separation is left out."""
    methods = [m for m in methods if m.has_separation or not queries.separation]
    batches = [_Batch.make(m, queries, tolerance, effort) for m in methods if m.solve is not None]
    peers = {}
    unit = queries.unit()
    try:
        for m in methods:
            if m.peer is not None:
                frames = (queries.points_t0, queries.points_t1)
                separation = queries.separation * (queries.length_scale or 1.0)
                peers[m.name] = Peer(m.peer, queries.kind, *frames, tolerance, unit, separation, effort.cap)
        for _ in range(effort.rounds):
            for batch in batches:
                batch.rounds.append(batch.once())
            for peer in peers.values():
                peer.run(effort.peer_seconds)
    finally:
        for peer in peers.values():
            peer.close()
    rows = {batch.method.name: batch.row() for batch in batches}
    for m in methods:
        if m.name in peers:
            rows[m.name] = _peer_row(m, queries, peers[m.name])
    ours = next((batch for batch in batches if batch.method.group == "ours"), None)
    if ours is not None:
        # the errors of ours on exactly the queries that a peer has answered
        for m in methods:
            if m.name in peers:
                same = np.flatnonzero(answered_by(peers[m.name])[: ours.count])
                rows[m.name]["ours_on_the_same"] = judged(queries.exact[same], ours.answer.toi[same])
    return [rows[m.name] for m in methods]
