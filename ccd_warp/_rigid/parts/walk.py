"""The launches of a search for parts that are near: what moves is swept, and the trees of each pair are walked."""

from typing import Any

import warp as wp

from ccd_warp._runtime.launch import Recording, Slot
from ccd_warp.kernels.rigid import part_overlap as kernels

_LONG = 1 << 12  # items, or slices, from which an interrupt would have to wait
# Items on the CPU, and on CUDA, below which the slices of a pair of bodies are divided among several.
_FEW, _FEW_ON_CUDA = 64, 1 << 14


def record_walk(
    recording: Recording,
    trees: Any,
    pairs: wp.array,
    paths: Any,
    num_links: int,
    num_worlds: int,
    found: Any,
    active: wp.array,
    stop: wp.array,
    num_slices: Any,
    t_max: Any,
    reach: Any,
    any_suffices: Any,
) -> None:
    """Record the walk through the trees of these pairs of bodies in each world; the last arguments may be slots."""
    device, num_bodies = recording.device, len(trees.first)
    boxes = [wp.empty((num_worlds, num_bodies), dtype=wp.vec3d, device=device) for _ in range(2)]
    shared = [trees, paths, num_links]
    recording.launch(kernels.sweep_bodies, num_worlds * num_bodies, inputs=[*shared, t_max, reach], outputs=boxes)
    num_pairs = num_worlds * len(pairs)
    num_begins = max(1, (_FEW_ON_CUDA if recording.is_cuda else _FEW) // max(num_pairs, 1))
    num_items = num_pairs * num_begins
    of_slices = [num_slices, num_begins, t_max, reach, any_suffices]

    def is_long() -> bool:
        count = recording.values[num_slices.name] if isinstance(num_slices, Slot) else num_slices
        return bool(max(num_items, count) > _LONG)

    recording.launch(
        kernels.find_overlapping_parts,
        num_items,
        inputs=[pairs, *shared, *boxes, *of_slices, active, stop],
        outputs=[found],
        grain=_FEW,
        parts_per_thread=8,
        is_long=is_long,
    )
