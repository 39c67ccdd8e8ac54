"""The faults that GPU code really has, and the emulated tests that find them."""

from planted.planting import Fault


def _on_device(call: str, scene: str) -> str:
    return f"laws/test_other_ways.py::test_the_device_changes_no_bit[{call}-{scene}]"


# Tests by what they look at: those of one row are run in this order, up to the first that fails.
FINDERS = {
    "functions": ["emulated/test_emulated_kernels.py"],
    "launch": [_on_device("launches", "kinds")],
    "host": [_on_device("steps", "kinds")],
    "host, sheet": [_on_device("steps", "sheet")],
    "hash": [_on_device("launches", "hash"), _on_device("steps", "hash")],
    "needles": ["emulated/test_emulated.py::test_needles_that_cross_at_many_speeds"],
    "at one time": [_on_device("at_one_time", "kinds")],
    "counts": ["emulated/test_emulated.py::test_searches_of_so_many_boxes"],
    "short lists": ["emulated/test_emulated.py::test_replays_with_lists_too_short_for_the_candidates"],
    "solvers": ["emulated/test_emulated.py::test_searches_culls_and_solvers_do_not_race"],
    "overflow": ["emulated/test_emulated.py::test_contacts_beyond_the_capacity_are_missing_from_the_list_alone"],
    "beyond": ["emulated/test_emulated.py::test_more_candidates_than_32_bits_count"],
    "queue": ["kernels/narrow_phase/test_queued_pairs.py::test_threads_get_few_pairs_spread_over_all_warps"],
    "trees": ["kernels/boxes/test_half_warp_tree.py::test_half_warps_fill_the_same_boxes"],
    "pairs": ["laws/test_other_ways.py::test_the_device_changes_no_bit_of_pairs[vertex-face 3-default-float64]"],
    "replays": [_on_device("replays", "worlds")],
}
_ATOMICS, _HALF, _WHOLE = "kernels/atomics.py", "kernels/boxes/half_warp.py", "kernels/narrow_phase/whole_warp.py"
_SEARCH, _WALK = "kernels/search/search_half_warp.py", "kernels/search/search_trees.py"
_GRIDS, _QUEUE = "kernels/boxes/hash_grid.py", "kernels/narrow_phase/queued_pairs.py"
_CULL, _TREE, _STEP = (
    "kernels/search/candidate_cull.py",
    "kernels/boxes/half_warp_tree.py",
    "kernels/step/device_step.py",
)
_STAGES, _DRIVER, _CONTACTS = (
    "ccd_warp/_engine/stages.py",
    "ccd_warp/_engine/device/step.py",
    "kernels/step/contacts.py",
)
_WRITING = "kernels/search/search_types.py"
_ONE_PLACE = ("functions",)
_LATEST = """; bits > 0; bits >>= 1) {
        const auto other = __shfl_xor_sync(0xFFFFFFFFu, t, bits);
        t = t < other ? other : t;
    }
#endif
    return t;
\"""
)
def latest(t: wp.float"""
# fmt: off
PLANTED = [
    # --- atomic operations made plain, or of another size ---
    Fault("minimum of int64 not atomic", _ATOMICS, "atomicMin(p, (long long)value);", "*p = value;", _ONE_PLACE),
    Fault("minimum of int32 not atomic", _ATOMICS, "atomicMin(p, value);", "*p = value;", _ONE_PLACE),
    Fault("flags not set atomically", _ATOMICS, "atomicOr(p, bits);", "*p |= bits;", _ONE_PLACE),
    Fault("a flag replaces the others", _ATOMICS, "atomicOr(p, bits);", "atomicExch(p, bits);", _ONE_PLACE),
    Fault("claim not atomic", _ATOMICS,
          "return (wp::int64)atomicAdd((unsigned long long*)p, (unsigned long long)count);",
          "const long long n = *p; *p = n + count; return n;", _ONE_PLACE),
    Fault("claim of an int not atomic", _ATOMICS, "return atomicAdd(p, 1);", "return (*p)++;", _ONE_PLACE),
    Fault("claim in another row", _ATOMICS, "row * values.strides[0]) + column;", "row * 8) + column;", _ONE_PLACE),
    Fault("minimum of the lower 32 bits", _ATOMICS,
          "if (*(volatile long long*)p > value)", "if (*(volatile int*)p > (int)value)", _ONE_PLACE),
    Fault("maximum in place of a minimum", _ATOMICS, "atomicMin(p, value);", "atomicMax(p, value);", _ONE_PLACE),
    Fault("places of a half warp claimed without an atomic operation", _HALF,
          "first = (long long)atomicAdd(p, (unsigned long long)__popc(lanes));",
          "first = (long long)*p; *p += __popc(lanes);", _ONE_PLACE),
    Fault("first contact of a vertex not atomic", _CONTACTS,
          "atomic_min_int32(vertex_contact, c[k], n)", "vertex_contact[c[k]] = wp.min(vertex_contact[c[k]], n)",
          ("host",)),
    Fault("levels of a spatial hash united without an atomic operation", _GRIDS,
          "set_bits(grid.levels, 0, levels)", "grid.levels[0] = grid.levels[0] | levels", _ONE_PLACE),
    Fault("contacts counted without an atomic operation", "kernels/narrow_phase/pair_outcome.py",
          "n = claim_int(contacts.count, 0)", "n = contacts.count[0]\n    contacts.count[0] = n + 1", ("solvers",)),
    Fault("near pairs counted without an atomic operation", "kernels/at_one_time/proximity.py",
          "n = claim_int(proximities.count, 0)", "n = proximities.count[0]\n    proximities.count[0] = n + 1",
          ("at one time",)),
    Fault("bounds of segments lowered without an atomic operation", "kernels/boxes/rest_order.py",
          "atomic_min_int32(bounds, first / size * 8 + axis, ordered_bits(lower[axis]))",
          "bounds[first / size * 8 + axis] = wp.min(bounds[first / size * 8 + axis], ordered_bits(lower[axis]))",
          ("trees", "launch")),
    # --- lanes of a warp: masks, distances, who leads ---
    Fault("vote of the whole warp", _HALF, "__ballot_sync(0xFFFFu << shift,", "__ballot_sync(0xFFFFFFFFu,", _ONE_PLACE),
    Fault("vote of those who run", _HALF,
          "__ballot_sync(0xFFFFu << shift,", "__ballot_sync(__activemask(),", _ONE_PLACE),
    Fault("vote of the other half", _HALF, "lanes != 0) >> shift & 0xFFFFu", "lanes != 0) & 0xFFFFu", _ONE_PLACE),
    Fault("mask of the lower half", _HALF,
          "threads = 0xFFFFu << (threadIdx.x & 16);", "threads = 0xFFFFu;", _ONE_PLACE),
    Fault("exchange of those who run", _HALF,
          "__shfl_sync(0xFFFFu << shift, first, leader, 16)", "__shfl_sync(__activemask(), first, leader, 16)",
          _ONE_PLACE),
    Fault("the first lane tells what another has claimed", _HALF,
          "__shfl_sync(0xFFFFu << shift, first, leader, 16)", "__shfl_sync(0xFFFFu << shift, first, 0, 16)",
          _ONE_PLACE),
    Fault("one place for all lanes", _HALF, "(unsigned long long)__popc(lanes));", "1ull);", _ONE_PLACE),
    Fault("every lane claims for all", _HALF,
          "if ((int)(threadIdx.x & 15) == leader) {", "if ((int)(threadIdx.x & 15) >= leader) {", _ONE_PLACE),
    Fault("a lane counts itself among those before", _HALF,
          "return __popc(lanes & ((1u << lane) - 1u));", "return __popc(lanes & ((2u << lane) - 1u));", _ONE_PLACE),
    Fault("exchanges from distance 4 on", _HALF, "for (int distance = 8;", "for (int distance = 4;", _ONE_PLACE),
    Fault("greatest for least", _HALF, "other < r[k] ? other", "other > r[k] ? other", _ONE_PLACE),
    Fault("lanes of a quarter warp", _HALF, "return thread & 15;", "return thread & 7;", _ONE_PLACE),
    Fault("latest time of half a warp", _WHOLE, f"bits = 16{_LATEST}64)", f"bits = 8{_LATEST}64)", _ONE_PLACE),
    Fault("latest time of a pair of lanes, float32", _WHOLE,
          f"bits = 16{_LATEST}32)", f"bits = 1{_LATEST}32)", _ONE_PLACE),
    Fault("each lane decides for itself", _WHOLE,
          "return __shfl_sync(0xFFFFFFFFu, (int)is_true, 0) != 0;", "return is_true;", _ONE_PLACE),
    Fault("a warp does not agree before it works together", _QUEUE,
          "                    if items.are_shared:\n                        is_done = agreed(is_done)\n", "",
          _ONE_PLACE),
    Fault("every lane of a warp writes", _QUEUE,
          "items.writes = is_first(solver)", "items.writes = True", ("needles",)),
    # --- who takes what: strides, tails, numbers of threads ---
    Fault("cull that stops one short", _CULL, "wp.min(end, count - n)", "wp.min(end, count - n - 1)", _ONE_PLACE),
    Fault("last half warp culls nothing", _CULL,
          "% HALF_WARP, count, num_threads)", "% HALF_WARP, count - 1, num_threads)", _ONE_PLACE),
    Fault("stride too long", _CULL, "count, num_threads):", "count, num_threads + HALF_WARP):", _ONE_PLACE),
    Fault("stride too short", _CULL, "count, num_threads):", "count, num_threads - HALF_WARP + 1):", _ONE_PLACE),
    Fault("threads for all but the last query", _STAGES,
          "            num_queries * WIDTH,\n", "            num_queries * WIDTH - WIDTH,\n", ("launch",)),
    Fault("too few solvers", "ccd_warp/_runtime/pair_queue.py",
          "solvers = min(most, most_pairs * WARP)", "solvers = min(most, most_pairs)", ("pairs",)),
    Fault("lanes rounded down", _QUEUE, "(count + num_warps - 1) / num_warps)", "count / num_warps)", ("queue",)),
    Fault("items of whole warps", _QUEUE,
          "items.stride = num_warps * lanes", "items.stride = num_warps * _LANES", ("queue",)),
    Fault("second search without the last queries", _SEARCH,
          "search.query.num_boxes, search.part.stride)", "search.query.num_boxes - WIDTH, search.part.stride)",
          ("short lists",)),
    Fault("a block too many", _WALK,
          "((tree.num_boxes - 1) >> (4 * level + 4)) + 1", "(tree.num_boxes >> (4 * level + 4)) + 1", ("counts",)),
    Fault("a block too few", _WALK,
          "((tree.num_boxes - 1) >> (4 * level + 4)) + 1", "wp.max((tree.num_boxes - 2) >> (4 * level + 4), 0) + 1",
          ("counts",)),
    Fault("partners of the own block lost", _WALK,
          "lanes & lanes_after(behind - 1)", "lanes & lanes_after(behind)", ("counts",)),
    Fault("the next partner lost", _SEARCH, "and p > item.own:", "and p > item.own + 1:", ("counts",)),
    Fault("last box of a block below lost", _TREE, "    if n < count:\n", "    if n < count - 1:\n", ("trees",)),
    Fault("a quarter of a row lost", _TREE,
          "for (int k = 0; k < 4; ++k) {\n        const Four four",
          "for (int k = 0; k < 3; ++k) {\n        const Four four", ("trees",)),
    Fault("least for greatest", _TREE, "row % _ROWS < 3, _ONE", "row % _ROWS < 4, _ONE", ("trees",)),
    Fault("boxes of a half warp not united", _TREE, "union = least_together(union)", "union = union", ("launch",)),
    Fault("the end of the last bucket not found", "ccd_warp/_engine/boxes/grids.py",
          "num_buckets = len(grid.cells.bucket_begin)", "num_buckets = len(grid.cells.bucket_begin) - 1", ("hash",)),
    Fault("a radix sort with one bit too few", "ccd_warp/_engine/boxes/grids.py",
          "bits = grid.cells.bucket_bits + 1", "bits = grid.cells.bucket_bits", _ONE_PLACE),
    Fault("a bucket begins after its first box", _GRIDS,
          "if buckets[middle] < b:", "if buckets[middle] <= b:", ("hash",)),
    # --- what is not cleared, not marked, not counted ---
    Fault("stale counters", _STEP, "for column in range(counts.shape[1]):", "for column in range(3):", ("launch",)),
    Fault("contacts counted on", _STEP, "num_contacts[0] = 0\n", "pass\n", ("launch",)),
    Fault("least toi of the step before", _STEP,
          "            m.scene[0] = _INFINITY_BITS\n", "            pass\n", ("replays",)),
    Fault("empty boxes not written", _TREE, "    if block == count - 1:\n", "    if block == count:\n", ("trees",)),
    Fault("static bodies that move not noted", "kernels/step/input_rows.py",
          "is_moved[0] = 1  # until `settle`, when all boxes are up to date", "pass", ("launch",)),
    Fault("a lost mark of overflow", _WRITING,
          "elif part.marks_overflow != 0:", "elif part.marks_overflow > 1:", _ONE_PLACE),
    Fault("short lists not noted", _CULL, "claim(step.counts, 0, ANY_UNLISTED, 1)", "pass", ("short lists",)),
    Fault("branch of a graph by another flag", _DRIVER,
          "is_any_unlisted=self._is_any_unlisted)", "is_any_unlisted=self._is_open)", ("short lists",)),
    Fault("second search culls nothing", _SEARCH,
          "if search.step.counts[search.part.row, CANDIDATES] > wp.int64(search.part.capacity):",
          "if search.step.counts[search.part.row, CANDIDATES] < wp.int64(0):", ("short lists",)),
    Fault("pairs left open not marked", _QUEUE, "pairs[k] = ~pairs[k]\n", "pairs[k] = pairs[k]\n", ("needles",)),
    Fault("the time reached not kept", _QUEUE,
          "    queue.t[n] = t\n    queue.used[n]", "    queue.used[n]", ("pairs", "launch")),
    Fault("full list taken for a short one", _CULL,
          "counts[kind, CANDIDATES] > wp.int64(candidates.shape[0]):",
          "counts[kind, CANDIDATES] >= wp.int64(candidates.shape[0]):", _ONE_PLACE),
    # --- bounds and indices ---
    Fault("one contact beyond the list", "kernels/narrow_phase/pair_outcome.py",
          "if n < contacts.toi.shape[0]:", "if n <= contacts.toi.shape[0]:", ("overflow",)),
    Fault("one candidate beyond the list", _SEARCH,
          "if n < wp.int64(search.keys.shape[0]):\n            search.keys[n]",
          "if n <= wp.int64(search.keys.shape[0]):\n            search.keys[n]", ("short lists",)),
    Fault("a number of candidates of 32 bits", _CULL,
          "count = wp.int32(wp.min(step.counts[kind, CANDIDATES], wp.int64(candidates.shape[0])))",
          "count = wp.min(wp.int32(step.counts[kind, CANDIDATES]), candidates.shape[0])", _ONE_PLACE),
    Fault("the place of a key of 32 bits", _WRITING,
          "if n < wp.int64(keys.shape[0]):\n        keys[n]",
          "if wp.int32(n) < keys.shape[0]:\n        keys[wp.int32(n)]", _ONE_PLACE),
    Fault("the place of a candidate of 32 bits", _SEARCH,
          "if n < wp.int64(search.keys.shape[0]):\n            search.keys[n]",
          "if wp.int32(n) < search.keys.shape[0]:\n            search.keys[wp.int32(n)]", ("beyond",)),
    Fault("the second search compares 32 bits", _SEARCH,
          "if search.step.counts[search.part.row, CANDIDATES] > wp.int64(search.part.capacity):",
          "if wp.int32(search.step.counts[search.part.row, CANDIDATES]) > search.part.capacity:", ("beyond",)),
    Fault("an edge looked up among the vertices", _CONTACTS,
          "    else:  # the number of an edge may be beyond the last vertex\n        first =",
          "    if kind != EDGE_EDGE or pair[0] >= 0:\n        first =", ("host, sheet",)),
]
# fmt: on
