"""Warp functions, kernels and structs of ccd_warp: no launch, no allocation, no NumPy."""

import sys
from importlib.machinery import SOURCE_SUFFIXES, FileFinder

from .kept_code import KeptCode

sys.path_importer_cache[__path__[0]] = FileFinder(__path__[0], (KeptCode, SOURCE_SUFFIXES))
