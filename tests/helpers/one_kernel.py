"""A kernel that is loaded as a new process does, and ways in which files of kernels are damaged."""

import warp as wp

from ccd_warp._runtime.kernel_cache import load_or_repair


@wp.kernel(module="unique", enable_backward=False)
def double(begin: int, values: wp.array[float]):
    values[begin + wp.tid()] *= 2.0


# What a file with an ending holds instead.
DAMAGE = {
    "half an object": (".o", lambda content: content[: len(content) // 2]),
    "an object of zeros": (".o", lambda content: bytes(len(content))),
    "no metadata": (".meta", lambda content: b""),
}


def load_anew():
    """Load the kernel as a new process does, and launch it."""
    double.module.unload()
    with wp.ScopedDevice("cpu"):
        load_or_repair(double, wp.get_device("cpu"), None)
        values = wp.full(2, 1.0, dtype=float)
        wp.launch(double, dim=1, inputs=[1], outputs=[values])
        assert values.numpy().tolist() == [1.0, 2.0]
