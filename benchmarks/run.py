"""Measures, and writes the raw figures: a CSV file for each part.

    pip install -e '.[test,cuda-tools,rigid-peers]'
    python benchmarks/run.py --all                                   # all, and the pages: an hour on two cores
    python benchmarks/run.py --quick --output quick                  # all parts in small: minutes
    python benchmarks/run.py steps small --output benchmarks/results # some parts again
    python benchmarks/run.py --stale                                 # whose figures are of other code

`report.py` draws pictures and writes tables from these. Figures are those of a commit: where files have changed since,
only --quick measures. Peers that are not installed are left out of `rigid`; the other parts need ipctk. A part is
written when it is complete: after Ctrl-C the same command with the parts that are left goes on. Published queries and
frames are read from --data, or from the folder of CCD_WARP_DATA. Tables of a GPU are those of `gpu_times.py`.
"""

if __name__ == "__main__":  # processes of the peers import this file, and nothing more
    from parts import main

    main(__doc__)
