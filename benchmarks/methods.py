"""The methods that are compared: ours, the plain bisection, the peers, the univariate cubic, the test at both ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import checkout  # noqa: F401
import numpy as np
import warp as wp
from distance_queries import SOLVE
from univariate import ends_ccd, univariate_ccd

import ccd_warp as ccd
from ccd_warp._runtime.threads import default_num_threads

KINDS = ("vertex-face", "edge-edge")
OURS, REFERENCE = "ours float64", "Tight-Inclusion"
PEERS = (REFERENCE, "additive CCD")
CUBIC, ENDS = "cubic, closed form", "both ends"
# What tables and pictures show, on one thread.
SHOWN = (OURS, "ours float32", "plain bisection", *PEERS, CUBIC, ENDS)
DEFAULT_TOLERANCE = 1e-6
BISECTION_ITERATIONS = 100_000


@dataclass(frozen=True)
class Answer:
    """Times of impact of a batch, and which of them a limit cut short (None where the method has no limit)."""

    toi: np.ndarray
    limited: np.ndarray | None = None


@dataclass(frozen=True)
class Method:
    """One method.

    Attributes:
        name: Name in every table and figure.
        group: "ours", "ablation", "peer" or "baseline".
        solve: Batch solver (kind, points_t0, points_t1, tolerance, separation, length_scale) to :class:`Answer`; None
            for a peer that is called query by query.
        peer: Name in :mod:`peers`, or None.
        has_separation: Whether it supports a minimum separation.
        note: What it is, and how the comparison is not like for like.
    """

    name: str
    group: str
    note: str
    solve: Callable[..., Answer] | None = None
    peer: str | None = None
    has_separation: bool = True


def _ours(
    precision: str, threads: int | None, device: str, method: str = "clipping", **options: int
) -> Callable[..., Answer]:
    def solve(
        kind: str,
        points_t0: np.ndarray,
        points_t1: np.ndarray,
        tolerance: float,
        separation: float,
        length_scale: float | None,
    ) -> Answer:
        result = SOLVE[kind](
            points_t0,
            points_t1,
            tolerance=tolerance,
            minimum_separation=separation,
            length_scale=length_scale,
            precision=precision,
            method=method,
            device=device,
            num_threads=threads,
            **options,
        )
        return Answer(result.toi, np.asarray(result.status) >= ccd.CCDStatus.ITERATION_LIMIT)

    return solve


def _baseline(ccd_of: Callable[..., np.ndarray]) -> Callable[..., Answer]:
    def solve(kind: str, points_t0: Any, points_t1: Any, tolerance: float, _: float, scale: float | None) -> Answer:
        return Answer(ccd_of(kind, points_t0, points_t1, tolerance=tolerance, length_scale=scale))

    return solve


def all_methods(devices: list[str]) -> list[Method]:
    """Every method, ours on each of the devices ("cpu", "cuda:0", …)."""
    threads = default_num_threads()
    methods = []
    for precision in ("float64", "float32"):
        one = "The public call from NumPy arrays, conversion included."
        methods.append(Method(f"ours {precision}", "ours", f"{one} One thread.", _ours(precision, 1, "cpu")))
        if threads > 1:
            name = f"ours {precision}, {threads} threads"
            methods.append(Method(name, "ours", f"The same on {threads} threads.", _ours(precision, threads, "cpu")))
        for device in devices:
            if device != "cpu":
                note = f"The same on {wp.get_device(device).name}, copies to it and back included."
                methods.append(Method(f"ours {precision}, {device}", "ours", note, _ours(precision, None, device)))
    note = (
        "Ablation: the literature's inclusion test on boxes and its bisection, in our kernel, one thread, with "
        f"ten times our limit of iterations ({BISECTION_ITERATIONS:,}). Where it reaches the limit its toi is early, "
        "so that its errors grow again at small tolerances."
    )
    bisection = _ours("float64", 1, "cpu", "bisection", max_iterations=BISECTION_ITERATIONS)
    methods.append(Method("plain bisection", "ablation", note, bisection))
    note = (
        "ipctk.tight_inclusion, raw: no rescaling of its toi, no refinement at zero. One call a query; the cost of a "
        "Python call, measured on a query that is decided at once, is subtracted."
    )
    methods.append(Method(REFERENCE, "peer", note, peer="tight_inclusion"))
    note = (
        "ipctk.AdditiveCCD, called as Tight-Inclusion. It has no tolerance: it stops where the gap has shrunk to a "
        "fraction of that at the start, and the tolerance of the sweep is that fraction (conservative_rescaling = "
        "1 − tolerance), so its toi cannot be had unscaled and is early by about that share of the approach. Where it "
        "says hit at nan, the query is undecided, like one that was stopped. Its minimum separation is Euclidean, "
        "another question than ours, and is not compared."
    )
    methods.append(Method("additive CCD", "peer", note, peer="additive", has_separation=False))
    note = (
        "Univariate: the roots of the coplanarity cubic in closed form and both ends of the step, each tested for a "
        "distance within the tolerance, a Euclidean distance; its error is over the contacts that it finds. Vectorised "
        "NumPy; a compiled loop would be faster."
    )
    methods.append(Method(CUBIC, "baseline", note, _baseline(univariate_ccd), has_separation=False))
    note = "The discrete test: is the distance within the tolerance at t = 0, or at t = 1. NumPy, as the cubic."
    methods.append(Method(ENDS, "baseline", note, _baseline(ends_ccd), has_separation=False))
    return methods


def check_devices(devices: list[str] | None) -> list[str]:
    """The devices to measure: those asked for, or the CPU and every GPU.

    Raises:
        ValueError: If there is no such device.
    """
    present = [device.alias for device in wp.get_devices()]
    for device in devices or []:
        if device not in present:
            raise ValueError(f"devices holds {device!r}; expected some of {', '.join(present)}")
    return list(devices) if devices else present
