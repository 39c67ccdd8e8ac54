"""Flags of launches on drawn scenes say, exactly, what is above a capacity, hidden by rounding, or no step at all."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from expected_warnings import OF_ROUNDING

import ccd_warp as ccd
from laws.asked import SEEDS, scene_of
from laws.calls import on_device

pytestmark = [OF_ROUNDING, pytest.mark.filterwarnings("ignore::RuntimeWarning")]
FLAG = ccd.LaunchFlag


def launched(scene, mesh, *ends, **capacities):
    """A launch: its result on the host, its flags, and the number of its contacts."""
    pipeline = replace(scene, capacity=20_000).pipeline(mesh, "float64", **capacities)
    found = pipeline.launch(*map(on_device, ends))
    return found, int(found.flags.numpy()[0]), int(found.contacts.count.numpy()[0])


@pytest.mark.parametrize("seed", SEEDS[::4])
def test_a_capacity_is_flagged_exactly_where_there_is_more(seed):
    scene, mesh, start, end, _ = scene_of(seed)
    whole, flags, count = launched(scene, mesh, start, end)
    contacts, most = whole.to_host().contacts, int(whole.num_pairs.numpy()[:4].max())  # planes take no capacity
    assert flags == FLAG.ROUNDING_LIMIT * (ccd.CCDStatus.ROUNDING_LIMIT in contacts.status) and count == len(contacts)
    for max_pairs, max_contacts in product({most - 1, most} - {-1, 0}, {count - 1, count} - {-1, 0}):
        capacities = {"max_pairs": max_pairs, "max_contacts": max_contacts}
        found, flags_found, count_found = launched(scene, mesh, start, end, **capacities)
        assert found.num_pairs.numpy()[:4].max() == most
        assert bool(flags_found & FLAG.PAIRS_OVERFLOW) == (most > max_pairs)
        assert bool(flags_found & FLAG.CONTACTS_OVERFLOW) == (count_found > max_contacts)
        assert np.bitwise_or.reduce(found.world_flags.numpy()) == flags_found
        tois, whole_tois = (x.vertex_toi.numpy() for x in (found, whole))
        if most > max_pairs:
            assert found.toi.numpy()[0] == 0.0 and count_found <= count
            # with toi 0, and nothing else is: four vertices of each pair at most
            marked = tois != whole_tois
            beyond = np.maximum(found.num_pairs.numpy()[:4] - max_pairs, 0).sum()
            assert not tois[marked].any() and marked.sum() <= 4 * beyond
        else:
            np.testing.assert_array_equal(tois, whole_tois)
            assert flags_found & ~FLAG.CONTACTS_OVERFLOW == flags and count_found == count
