"""The exact oracles as tests ask them, whose answers in an earlier run are looked up; and contacts as a table."""

import algebraic
import distance_oracle
import exact_toi
import numpy as np
import oracle
import oracle_contact
import oracle_corners
from kept import kept

_MODULES = (algebraic, exact_toi, oracle, oracle_contact, oracle_corners)
exact_tois = kept(oracle.exact_tois, *_MODULES)
exact_distance_tois = kept(distance_oracle.exact_distance_tois, *_MODULES, distance_oracle)


def rows(contacts):
    """Contacts as a mapping from kind and primitives to toi."""
    keys = np.column_stack([contacts.kind, contacts.primitives]).tolist()
    return dict(zip(map(tuple, keys), contacts.toi.tolist(), strict=True))
