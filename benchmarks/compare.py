"""What became slower or less accurate: python benchmarks/compare.py OLD NEW, two folders that `run.py` has written.

Times of ours are divided by those of the closed-form cubic, which is measured in turn with ours and is always the same
program, so that the speed of the machine cancels. They are the least of the rounds, which noise can only raise. What of
a scene is compared is the ratio to the peer's. The exit status is 1 if anything is worse by more than the threshold.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import raw

CLOCK = "cubic, closed form"
POINT = {"sweep": ["set", "kind", "tolerance"], "cases": ["family", "kind"]}
# A ratio of smaller errors than this is of roundings of a toi near one.
LEAST_ERROR = 1e-14


def queries(folder: Path, part: str) -> pd.DataFrame:
    """Figures of ours by point and method, larger is worse."""
    rows = raw.read(folder, part)
    if not len(rows):
        return pd.DataFrame()
    clock = rows[rows.method == CLOCK].set_index(POINT[part]).seconds_low
    ours = rows[rows.method.str.startswith("ours")].set_index(POINT[part])
    found = pd.DataFrame({"time": ours.seconds_low / clock.reindex(ours.index).to_numpy()})
    for fault in ("missed", "late", "phantom"):
        found[fault] = 1.0 + ours[fault]
    found["error"] = ours["error.p99"].clip(lower=LEAST_ERROR)
    return found.set_index(ours.method, append=True)


def steps(folder: Path) -> pd.DataFrame:
    """Time of a whole step of ours to that of the peer, by scene."""
    rows = raw.read(folder, "steps")
    if not len(rows):
        return rows
    rows = rows.set_index("scene")
    return pd.DataFrame({name: 1.0 / rows[f"ratio.{name}"] for name in ("collision_free_step", "mesh_ccd")})


def main() -> int:
    """Print every figure that became worse, or better, by more than the threshold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--threshold", type=float, default=1.25, help="largest ratio that passes (1.25)")
    options = parser.parse_args()
    ratios = []
    for of in (*(lambda folder, part=part: queries(folder, part) for part in POINT), steps):
        old, new = (of(folder) for folder in (options.old, options.new))
        if len(old) and len(new):
            ratios.append((new / old.reindex(new.index)).stack().dropna())
    if not ratios:
        parser.error("the two runs share no figure")
    for every in ratios:
        if "time" in every.index.get_level_values(-1):  # over the tolerances, whose times scatter
            levels = [name for name in every.index.names[:-1] if name != "tolerance"]
            time = every[every.index.get_level_values(-1) == "time"]
            every = pd.concat([every.drop(time.index), np.exp(np.log(time).groupby(levels).mean())])
        for word, chosen in (
            ("worse", every[every > options.threshold]),
            ("better", every[every < 1 / options.threshold]),
        ):
            print(f"{word}: {len(chosen)} of {len(every)} figures")
            print(
                "\n".join(f"  {' '.join(map(str, np.atleast_1d(key)))}: {ratio:.3g}" for key, ratio in chosen.items())
            )
    return int(any((every > options.threshold).any() for every in ratios))


if __name__ == "__main__":
    sys.exit(main())
