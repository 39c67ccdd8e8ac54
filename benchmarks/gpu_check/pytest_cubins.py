"""A plugin of pytest, with which the tests find the cubins that the check was given."""

from ccd_warp.benchmarks.gpu_check import precompile

precompile.use_named()
