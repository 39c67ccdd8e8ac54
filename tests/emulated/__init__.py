"""The CUDA side of the library without a GPU: the CUDA source that Warp generates, run on threads of the CPU."""

import pytest

from emulated.build import compiler

MARKS = [
    pytest.mark.emulated,
    pytest.mark.skipif(compiler() is None, reason="no C++ compiler found: apt-get install g++, or set CXX"),
]
