"""The narrow phase on CUDA: three kernels, with a queue between them for the pairs that each leaves open, and one more.

A thread takes one pair, and a warp waits for the slowest of its pairs. So the first kernel makes only the first rounds,
which settle most pairs that do not touch; the second the later rounds of `lane_solver`, which settle most contacts; and
the last one, for few pairs, runs the solver for single pairs. Each is small: the registers and the stack of the rare
ways do not burden the common ones. A pair gets the answer, in every bit, that the kernels of `narrow_phase` give on the
CPU: it goes through the same functions in the same order.

The second kernel takes the open pairs of the queue, which are without gaps. It leaves those that stay open in their
places and marks the others as settled; these are so many that the last kernel mostly finds a pair or none for each
warp. Of a pair of points in contact within a separation the second kernel finds a point and not the closest one, so the
last one completes it.

In the last kernel a warp works on one pair (`whole_warp`), so that a pair far from settled holds up the launch less,
and no other pair at all; its threads look for its next pair, each in another place. The boxes of the bisection cannot
be shared: it has a last kernel of its own, in which a thread solves a pair, so that nothing else reserves memory for
its stack.

Where contacts are kept, these kernels take the pairs of two kinds, and put what they find of a contact into the queue.
A fourth one, in which all threads of a warp have a contact, lowers the minima and lists it (`pair_contacts`).
"""

from typing import Any

from ..parameters import norm, real
from ..template import specialised
from .sinks import BOUND, CONTACTS, TABLE

on_arcs = norm.has_arcs
templates = {"norm": norm, "real": real}
place_contacts = specialised("narrow_phase.place_contacts", **templates, only_method="clipping").place_contacts


def stage_of(sink: int, stage: str) -> Any:
    """The kernel of a stage of a sink."""
    only_method = "bisection" if stage == "bisection" else "clipping"
    values = {"only_method": only_method, "sink": sink, "stage": stage}
    return specialised("narrow_phase.queued_stage", **templates, **values).solve_pairs


def stages_of(sink: int) -> dict[str, Any]:
    """The kernels of a sink by their stages, in the order of their launches; on arcs nothing is bisected."""
    stages = "first", "later", "last", "bisection"
    return {stage: stage_of(sink, stage) for stage in stages if not (on_arcs and stage == "bisection")}


points_toi = {} if on_arcs else stages_of(TABLE)
solve_pairs = stages_of(CONTACTS) | {"placed": place_contacts}
pairs_bound = stages_of(BOUND)
by_sink = {TABLE: points_toi, CONTACTS: solve_pairs, BOUND: pairs_bound}
