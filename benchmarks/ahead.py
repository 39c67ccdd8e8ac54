"""Figures in which another method is ahead of ours, from the raw figures."""

from __future__ import annotations

from ccd_warp.benchmarks.methods import SHORT
from ccd_warp.benchmarks.numbers import OURS, bound, error_of, error_text, is_peer, rows_of, set_name, time_text
from ccd_warp.benchmarks.scene_sections import SMALL_CALLS, SMALL_PEERS, pair_name, scene_name

_ERRORS = {"median": "median", "p99": "99th percentile of the", "max": "largest"}


def places_ahead(raw: dict) -> list[tuple[str, str, str]]:
    """Every figure in which another method is ahead of ours in float64 on one thread: place, kind, sentence."""
    found = []
    for section, name_of in (("sweep", set_name), ("cases", lambda u: f"{u['family']} {SHORT[u['kind']]}")):
        for unit in raw[section]:
            by = rows_of(unit)
            ours = by[OURS]
            at = f"at {unit['tolerance']:.0e}" if section == "sweep" else ""
            for name, row in by.items():
                if name.startswith("ours") or not row["queries"]:
                    continue
                place = f"{name_of(unit)}, {name}"
                faults = [f"{row[k]} {k}" for k in ("missed", "late") if row[k]]
                but = f", with {' and '.join(faults)}" if faults else ""
                if row["seconds"] < ours["seconds"] or (is_peer(row) and row["below_resolution"]):
                    errors = [error_text(error_of(r, "p99")) for r in (row, ours)]
                    text = (
                        f"{bound(row)}{time_text(row['seconds'])} a query (99 % of errors below {errors[0]}{but}), "
                        f"ours {time_text(ours['seconds'])} ({errors[1]})"
                    )
                    found.append((place, "time", f"{at} {text}".strip()))
                if (same := row.get("ours_on_the_same")) is None:
                    continue
                for key, words in _ERRORS.items():
                    a, b = error_of(same, key), error_of(row, key)
                    if a is not None and b is not None and b < a:
                        text = f"{words} error {error_text(b)}{but}, of ours {error_text(a)}"
                        found.append((place, "error", f"{at} {text}".strip()))
                if row["phantom"] < same["phantom"]:
                    text = f"{row['phantom']} phantoms{but}, ours {same['phantom']}"
                    found.append((place, "phantoms", f"{at} {text}".strip()))
    for row in raw["steps"]:
        for name, ratio in row["ratio"].items():
            if ratio < 1:
                found.append((scene_name(row), name, f"`{name}` takes {1 / ratio:.2f} times the time of the peer"))
    for row in raw.get("small", []):
        for peer in SMALL_PEERS:
            for name in SMALL_CALLS:
                if (ratio := row["seconds"][name] / row["seconds"][peer]) > 1:
                    found.append((f"{scene_name(row)}, {peer}", "time", f"`{name}` takes {ratio:.1f} times its time"))
    for row in raw.get("pairs", []):
        ratio = row["seconds"]["ours"] / row["seconds"][SMALL_PEERS[1]]
        if ratio > 1:
            found.append(("a call with one pair", "time", f"{pair_name(row)}: {ratio:.0f} times additive CCD's"))
    return found


def ahead(raw: dict) -> list[str]:
    """Where a peer is ahead, one line for each place and kind of figure."""
    groups: dict[tuple[str, str], list[str]] = {}
    for place, figure, text in places_ahead(raw):
        groups.setdefault((place, figure), []).append(text)
    lines = []
    for (place, _), texts in groups.items():
        more = f"; and {len(texts) - 1} more of the kind" if len(texts) > 1 else ""
        lines.append(f"- {place}: {texts[0]}{more}")
    return lines or ["- Nowhere in this run."]
