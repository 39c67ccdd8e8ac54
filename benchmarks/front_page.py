"""The sentences of the README on speed and error, from the raw figures."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import wrap

from ccd_warp.benchmarks.numbers import OURS, PEERS, at_default, bound, error_text, rows_of, time_text

# The sets that others have published; those made here are on the page of the benchmark.
PUBLISHED = ("handcrafted", "simulation")


def speed(raw: dict) -> list[str]:
    """Ours and the fastest peer on the published sets, errors and phantoms of all their queries."""
    units = [rows_of(unit) for unit in at_default(raw) if unit["set"] in PUBLISHED]
    if not units:
        return []
    fastest = min(PEERS, key=lambda name: max(rows[name]["seconds"] for rows in units))
    ours, peer = [rows[OURS] for rows in units], [rows[fastest] for rows in units]
    text = (
        f"On {_total(ours, 'queries'):,} published queries, at tolerance 1e-6 on one thread of a CPU, a query takes "
        f"{_range(ours)} with ours, called with a batch. {fastest[0].upper()}{fastest[1:]} of "
        f"[ipc-toolkit](https://ipctk.xyz), the faster of its two methods, takes {_range(peer)}, called query by query "
        f"from Python with the cost of the call subtracted. {_faults(ours, peer)} The median error of a toi is "
        f"{_error(ours, 'median')} with ours and {_error(peer, 'median')} with the peer, in the worst set, the largest "
        f"error {_error(ours, 'max')} and {_error(peer, 'max')}; {_total(ours, 'phantom')} and "
        f"{_total(peer, 'phantom')} answers are phantoms."
    )
    text += _alone(raw)
    return wrap(text, 120, break_long_words=False, break_on_hyphens=False)


def _alone(raw: dict) -> str:
    """What a call for a single pair costs, where the peer is ahead."""
    pairs = raw.get("pairs") or []
    if not pairs:
        return ""
    names = ("ours", "LBVH, additive")
    ours, peer = (_between([pair["seconds"][name] for pair in pairs]) for name in names)
    return f" A single pair in a call of its own costs ours {ours}, and the peer {peer}."


def _between(seconds: Iterable[float]) -> str:
    low, high = min(seconds := list(seconds)), max(seconds)
    return time_text(low) if time_text(low) == time_text(high) else f"{time_text(low)} to {time_text(high)}"


def _range(rows: list[dict]) -> str:
    return max(bound(row) for row in rows) + _between(row["seconds"] for row in rows)


def _total(rows: list[dict], name: str) -> int:
    return sum(row[name] for row in rows)


def _faults(ours: list[dict], peer: list[dict]) -> str:
    counts = [_total(rows, "missed") + _total(rows, "late") for rows in (ours, peer)]
    if not any(counts):
        return "Neither misses a collision or reports one late."
    return f"Ours misses {counts[0]} collisions and the peer {counts[1]}, late answers included."


def _error(rows: list[dict], name: str) -> str:
    return error_text(max(row["error"][name] for row in rows))
