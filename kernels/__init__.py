"""Warp functions, kernels and structs of ccd_warp: no launch, no allocation, no NumPy.

A folder for each part of a step: `boxes` and `search` find pairs, `narrow_phase` solves them by the mathematics of
`pair`, `step` holds input and results, and `at_one_time` is what needs no motion.
"""

import sys
from importlib.machinery import SOURCE_SUFFIXES, FileFinder
from pathlib import Path

from .kept_code import KeptCode

for _folder in (Path(__path__[0]), *(path for path in Path(__path__[0]).iterdir() if path.is_dir())):
    sys.path_importer_cache[str(_folder)] = FileFinder(str(_folder), (KeptCode, SOURCE_SUFFIXES))
