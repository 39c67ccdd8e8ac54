"""The exact oracles as tests ask them, whose answers in an earlier run are looked up."""

import algebraic
import distance_oracle
import exact_toi
import oracle
import oracle_contact
import oracle_corners
from kept import kept
from laws.truth import NAMES, Pairs

_MODULES = (algebraic, exact_toi, oracle, oracle_contact, oracle_corners)
exact_tois = kept(oracle.exact_tois, *_MODULES)
exact_distance_tois = kept(distance_oracle.exact_distance_tois, *_MODULES, distance_oracle)


def exact_contacts(mesh, start, end):
    """When pairs touch that may meet and have a vertex that moves: (kind, first, second) to the exact toi."""
    pairs, moved = Pairs(mesh), (start != end).any(axis=1)
    found = {}
    for kind, of_kind in enumerate(pairs.of_kinds):
        of_kind = of_kind[moved[pairs.corners(kind, of_kind)].any(axis=1)]
        corners = pairs.corners(kind, of_kind)
        times = exact_tois(NAMES[kind], start[corners], end[corners]) if len(corners) else []
        found |= {(kind, *pair): time for pair, time in zip(of_kind.tolist(), times, strict=True) if time.hit}
    return found
