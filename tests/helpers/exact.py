"""The exact oracles as tests ask them: what was asked in an earlier run is looked up."""

import algebraic
import distance_oracle
import exact_toi
import oracle
import oracle_contact
import oracle_corners
from kept import kept

_MODULES = (algebraic, exact_toi, oracle, oracle_contact, oracle_corners)
exact_tois = kept(oracle.exact_tois, *_MODULES)
exact_distance_tois = kept(distance_oracle.exact_distance_tois, *_MODULES, distance_oracle)
