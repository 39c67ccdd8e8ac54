"""Draws how the cost of a step grows with the scene, from the raw figures of `whole_step.py`.

python benchmarks/plot_growth.py benchmarks/results/whole_step.json docs/figures/growth.png
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def main() -> None:
    source, target = map(Path, sys.argv[1:3])
    raw = json.loads(source.read_text())
    rows, exponents = raw["growth"]["rows"], raw["growth"]["exponents"]
    faces = [row["faces"] for row in rows]
    figure, (time, memory) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    for (name, style), marker in zip(
        {"find_candidates": ":", "collision_free_step": "-", "mesh_ccd": "--"}.items(), "so^", strict=True
    ):
        seconds = [row["seconds"][name] for row in rows]
        time.loglog(faces, seconds, style, marker=marker, color="black", label=f"{name}: faces^{exponents[name]:.2f}")
    time.loglog(faces, [rows[-1]["seconds"]["mesh_ccd"] * n / faces[-1] for n in faces], color="0.7", label="linear")
    time.set(xlabel="faces", ylabel="seconds a step", title="time")
    peak = [row["peak_bytes_above_input"] / 2**20 for row in rows]
    memory.loglog(faces, peak, "-", marker="o", color="black", label=f"faces^{exponents['peak memory']:.2f}")
    memory.loglog(faces, [peak[-1] * n / faces[-1] for n in faces], color="0.7", label="linear")
    memory.set(xlabel="faces", ylabel="MiB above the input, at the peak", title="memory")
    for axes in (time, memory):
        axes.legend(frameon=False)
        axes.grid(alpha=0.3)
    about = raw["machine"]
    figure.suptitle(f"Cloth over a sphere, {about['cores']} cores of {about['cpu']}, {about['date']}", fontsize=9)
    figure.savefig(target, dpi=120)


if __name__ == "__main__":
    main()
