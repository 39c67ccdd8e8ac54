"""How threads of a device share the pairs of a queue."""

import numpy as np
import warp as wp
from ccd_warp.kernels.narrow_phase.queued_launch import items_of


def test_threads_get_few_pairs_spread_over_all_warps():
    @wp.kernel(module="unique", enable_backward=False)
    def take(num_solvers: int, count: int, taken: wp.array[wp.int32], lanes_used: wp.array[wp.int32]):
        items = items_of(wp.tid(), num_solvers, count, False)
        lanes_used[0] = items.stride / (num_solvers / 32)
        following = items.first
        while following < count:
            wp.atomic_add(taken, following, 1)
            following += items.stride

    for num_solvers, count, lanes in (
        *((128, count, lanes) for count, lanes in ((0, 0), (3, 1), (5, 2), (127, 32), (1000, 32))),
        (32, 40, 32),
    ):
        taken, used = (wp.zeros(n, dtype=wp.int32, device="cpu") for n in (max(count, 1), 1))
        wp.launch(take, dim=num_solvers, inputs=[num_solvers, count], outputs=[taken, used], device="cpu")
        assert np.array_equal(taken.numpy()[:count], np.ones(count)) and used.numpy()[0] == lanes
