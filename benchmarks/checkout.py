"""The folders of this checkout; the oracle and the hard cases, which are those of the tests, become importable."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
sys.path += [str(ROOT / "tests" / "helpers"), str(ROOT / "tests")]
