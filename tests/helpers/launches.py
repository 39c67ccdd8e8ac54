"""Launches on the device as tests need them: arrays that go in, arrays that come out, and what they are to equal."""

import numpy as np
import warp as wp

# Capacities that suffice for the scenes of the tests.
CAPACITIES = {"max_pairs": 60_000, "max_contacts": 60_000}


def on_device(x, device="cpu", dtype=wp.vec3d):
    """Positions as an array of Warp."""
    real = np.float64 if dtype is wp.vec3d else np.float32
    return wp.array(np.ascontiguousarray(x, dtype=real), dtype=dtype, device=device)


def host(result):
    """The arrays of a result."""
    names = ("toi", "vertex_toi", "body_toi", "world_toi", "flags", "world_flags")
    return {name: getattr(result, name).numpy() for name in names}


def check_same(result, expected):
    """A launch says what the call on the host says, bit by bit."""
    ours = host(result)
    assert ours["flags"][0] == 0
    assert ours["toi"][0] == expected.toi
    for name in ("vertex_toi", "body_toi", "world_toi"):
        np.testing.assert_array_equal(ours[name], getattr(expected, name))
    assert result.contacts.count.numpy()[0] == len(expected.contacts)
    contacts = result.contacts.to_host()
    for name, values in vars(expected.contacts).items():
        np.testing.assert_array_equal(getattr(contacts, name), values)
