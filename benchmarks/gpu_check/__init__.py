"""The first minutes on a GPU: ``python -m ccd_warp.benchmarks.gpu_check --output DIR``, see ``docs/cuda.md``.

It needs nothing but the package itself, and pytest for one stage, and fetches nothing.
"""
