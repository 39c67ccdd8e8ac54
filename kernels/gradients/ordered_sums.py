"""Sums over parts of a mesh, each in one order whatever the number of threads, so that their bits are the same."""

import warp as wp

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

_ZERO = wp.constant(wp.float64(0.0))


@wp.kernel
def sum_chunks(
    begin: int,
    # in
    values: wp.array[wp.float64],
    order: wp.array[wp.int32],
    chunk_begin: wp.array[wp.int32],  # the first place in the order of each chunk, and the end of the last
    # out
    sums: wp.array[wp.float64],
):
    """Add the values of a chunk."""
    i = begin + wp.tid()
    total = _ZERO
    for k in range(chunk_begin[i], chunk_begin[i + 1]):
        total += values[order[k]]
    sums[i] = total


@wp.kernel
def sum_groups(
    begin: int,
    # in
    chunks: wp.array[wp.float64],
    group_begin: wp.array[wp.int32],  # the first chunk of each group, and the end of the last
    factor: wp.float64,
    # out
    sums: wp.array[wp.float64],
):
    """Add the chunks of a group, times a factor."""
    i = begin + wp.tid()
    total = _ZERO
    for k in range(group_begin[i], group_begin[i + 1]):
        total += chunks[k]
    sums[i] = factor * total
