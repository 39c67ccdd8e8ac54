"""Faults of the CPU's kernels, of the engine, of checks of the input and of readers, and the tests that find them."""

from planted.planting import Fault

PLANTED = [
    # --- one pair ---
    Fault(
        "a coefficient of the volume of another time",
        "kernels/pair/volume.py",
        "dot(t0.w00, n1) + m1 + m1",
        "dot(t0.w00, n1) + m1 + m0",
        ("kernels/narrow_phase/test_narrow_phase.py::test_family",),
    ),
    Fault(
        "a coefficient of the volume not looked at",
        "kernels/pair/volume.py",
        "least(h.c1, least(h.c2, h.c3))",
        "least(h.c1, h.c3)",
        ("kernels/narrow_phase/test_narrow_phase.py::test_family",),
    ),
    Fault(
        "a side of a patch not closest",
        "kernels/pair/closest_point.py",
        "is_before_v = is_flat or v < real(0.0)",
        "is_before_v = is_flat",
        ("kernels/pair/test_closest_point.py::test_slivers",),
    ),
    Fault(
        "a half of a patch lost",
        "kernels/pair/subdivide.py",
        "stack[upper + 1] = nu",
        "stack[upper + 1] = u1",
        ("kernels/narrow_phase/test_narrow_phase.py::test_tolerance",),
    ),
    Fault(
        "no rounding in the offset along a direction",
        "kernels/pair/ball.py",
        "(dot(magnitude(d), error) + norm.support(separation, d)) * round_up",
        "norm.support(separation, d)",
        ("kernels/pair/test_ball_rounding.py::test_offset_is_above_the_exact_one_and_not_lazy",),
    ),
    Fault(
        "the hold of one side alone",
        "kernels/pair/hold.py",
        "return wp.min(of_first, wp.min(hold[second[0]]",
        "return wp.max(of_first, wp.min(hold[second[0]]",
        ("kernels/pair/test_hold.py::test_patch_slides_over_a_mesh_without_losing_height",),
    ),
    # --- boxes ---
    Fault(
        "a world beyond its cell",
        "kernels/boxes/box_tree.py",
        "distance = inner + doublings * (_OUTER * inner)",
        "distance = inner + doublings * inner",
        ("engine/test_worlds.py::test_all_boxes_of_a_world_lie_in_its_cell",),
    ),
    Fault(
        "the radius of the first vertex for that of a primitive",
        "kernels/boxes/thickness.py",
        "wp.max(radius[corners[0]], wp.max(radius[corners[1]], radius[corners[2]]))",
        "radius[corners[0]]",
        ("calls/test_thickness.py::test_every_pair_that_comes_within_its_own_distance_is_found_by_every_way",),
    ),
    Fault(
        "bodies near on two axes of three",
        "kernels/boxes/body_boxes.py",
        "if a[0] <= b[0] and a[1] <= b[1] and a[2] <= b[2]:",
        "if a[0] < b[0] and a[1] < b[1] and a[2] < b[2]:",
        ("kernels/boxes/test_bodies.py::test_bodies_near_another_are_those_of_every_pair_of_boxes",),
    ),
    # --- search ---
    Fault(
        "rings around two vertices of three",
        "kernels/search/collision_filter.py",
        "            is_near(a[0], b, collision_filter)\n            or is_near(a[1], b, collision_filter)\n",
        "            is_near(a[0], b, collision_filter)\n",
        (
            "kernels/at_one_time/test_intersections.py::test_exclusion_rings_leave_out_pairs_of_primitives_that_are_near",
        ),
    ),
    Fault(
        "the last of the listed pairs not found",
        "kernels/search/collision_filter.py",
        "    if low < end:\n        return collision_filter.listed[low] == key",
        "    if low < end - 1:\n        return collision_filter.listed[low] == key",
        ("input/test_excluded_pairs.py::test_candidates_are_all_pairs_but_the_excluded_ones",),
    ),
    Fault(
        "the next partner in the own block lost",
        "kernels/search/search_lanes.py",
        "mask = mask & lanes_after(query_lane)",
        "mask = mask & lanes_after(query_lane + 1)",
        ("kernels/search/test_candidates.py::test_random_soup",),
    ),
    Fault(
        "a tie of quantized coordinates taken for an overlap",
        "kernels/search/search_lanes.py",
        "mask = mask & ~boxes_apart(search, q, block, mask & tied)",
        "mask = mask & ~(boxes_apart(search, q, block, mask & tied) & _NONE)",
        ("kernels/search/test_candidates.py::test_sizes_over_many_orders_of_magnitude",),
    ),
    Fault(
        "a corner that no direction across a side looks at",
        "kernels/search/cull.py",
        "    a = dot(d, c0.w10)\n    beyond = beyond & is_less(bound, a)",
        "    a = dot(d, c0.w01)\n    beyond = beyond & is_less(bound, a)",
        ("kernels/search/test_cull.py::test_no_pair_in_contact_is_free",),
    ),
    # --- narrow phase, step ---
    Fault(
        "no error in the value of a plane",
        "kernels/narrow_phase/planes.py",
        "v.error = _VALUE * (wp.abs(a) + wp.abs(b) + wp.abs(c)) + _ABSOLUTE",
        "v.error = _ABSOLUTE",
        ("calls/test_half_spaces.py::test_random_vertices_meet_planes_in_time_and_no_earlier",),
    ),
    Fault(
        "a normal along the velocity",
        "kernels/step/contact_normal.py",
        "    if wp.dot(n, w) > _ZERO:\n        n = -n\n",
        "",
        (
            "kernels/step/test_contact_normals.py::test_pair_that_touches_without_a_gap_has_a_normal_against_its_velocity",
        ),
    ),
    Fault(
        "a contact on the device where its first vertex is",
        "kernels/step/contact_points.py",
        "points[n] = _HALF * first + _HALF * second",
        "points[n] = first",
        ("calls/test_device_contacts.py::test_contacts_on_the_device_say_what_those_on_the_host_say",),
    ),
    # --- at one time ---
    Fault(
        "an edge beside one side of a face",
        "kernels/at_one_time/intersections.py",
        "if are_opposite(past_ab, past_bc) or are_opposite(past_bc, past_ca) or are_opposite(past_ca, past_ab):",
        "if are_opposite(past_ab, past_bc) or past_ca == 1:",
        ("kernels/at_one_time/test_intersections.py::test_the_pairs_are_those_of_exact_linear_programs",),
    ),
    Fault(
        "both sides of a pair move by all that is between them",
        "kernels/at_one_time/proximity.py",
        "gap = wp.max(_HALF * gap - UNDERFLOW, _ZERO)",
        "gap = wp.max(gap - UNDERFLOW, _ZERO)",
        ("kernels/at_one_time/test_displacement_bounds.py::test_bounds_are_those_of_exact_distances_rounded_down",),
    ),
    # --- engine ---
    Fault(
        "two worlds in one cell",
        "ccd_warp/_engine/worlds.py",
        "world >> (k * bits) & ((1 << bits) - 1)",
        "world >> (k * bits) & ((1 << bits) - 2)",
        ("engine/test_worlds.py::test_all_boxes_of_a_world_lie_in_its_cell",),
    ),
    Fault(
        "a cut block of queries not put in order",
        "ccd_warp/_engine/candidates.py",
        "if is_cut and not self._is_sorted:",
        "if False:",
        ("kernels/search/test_candidate_order.py::test_blocks_of_boxes_that_exceed_the_memory_limit",),
    ),
    Fault(
        "neighbours by one end of an edge",
        "ccd_warp/_engine/topology.py",
        "a, b = np.concatenate([mesh.edges, mesh.edges[:, ::-1]]).T",
        "a, b = np.concatenate([mesh.edges, mesh.edges]).T",
        ("calls/test_thickness.py::test_every_pair_that_comes_within_its_own_distance_is_found_by_every_way",),
    ),
    Fault(
        "a vertex with three neighbours not tested",
        "ccd_warp/_engine/edge_points.py",
        "(num_neighbours <= _MOST_NEIGHBOURS)",
        "(num_neighbours < _MOST_NEIGHBOURS)",
        ("kernels/at_one_time/test_intersections.py::test_the_pairs_are_those_of_exact_linear_programs",),
    ),
    Fault(
        "a face without its last side",
        "ccd_warp/_engine/exact_intersections.py",
        "or along_ab + along_ac > area:",
        "or along_ab + along_ac >= area:",
        ("kernels/at_one_time/test_intersections.py::test_the_pairs_are_those_of_exact_linear_programs",),
    ),
    Fault(
        "a hash searched in one direction",
        "ccd_warp/_engine/grids.py",
        "            if not pair.within:\n",
        "            if False:\n",
        ("calls/test_invariance.py::test_the_broad_phase_changes_no_bit",),
    ),
    Fault(
        "a line search up to the contact",
        "ccd_warp/_engine/line_search.py",
        "fraction[touched] *= safety * bound[touched]",
        "fraction[touched] *= bound[touched]",
        ("engine/test_line_search.py::test_one_body_falls_on_another",),
    ),
    # --- input ---
    Fault(
        "an index one beyond the last",
        "ccd_warp/_input/excluded_pairs.py",
        "is_out = (column < 0) | (column >= count)",
        "is_out = (column < 0) | (column > count)",
        ("input/test_bad_arguments.py::test_a_mesh_that_cannot_be_is_refused_with_what_was_expected",),
    ),
    Fault(
        "a radius that is not finite",
        "ccd_warp/_input/mesh_checks.py",
        "is_invalid = ~(np.isfinite(given) & (given >= 0))",
        "is_invalid = given < 0",
        ("input/test_bad_arguments.py::test_a_mesh_that_cannot_be_is_refused_with_what_was_expected",),
    ),
    Fault(
        "a side between two cells kept",
        "ccd_warp/_input/cells.py",
        "is_outer = count[number[: len(sides)]] == 1",
        "is_outer = count[number[: len(sides)]] >= 1",
        ("input/test_cells.py::test_the_surface_of_cells_of_one_type_is_closed_and_outward",),
    ),
    # --- files ---
    Fault(
        "a vertex too far back",
        "ccd_warp/_files/obj.py",
        "np.repeat(num_above, rows.counts) + corners, corners - 1",
        "np.repeat(num_above, rows.counts) + corners - 1, corners - 1",
        ("files/test_damaged_files.py::test_polygons_become_fans_in_the_order_of_the_file",),
    ),
    Fault(
        "rows beyond those of the header",
        "ccd_warp/_files/ply.py",
        "    if at < len(rows):\n",
        "    if False:\n",
        ("files/test_damaged_files.py::test_line_that_is_missing_or_doubled_is_refused",),
    ),
    Fault(
        "frame 10 before frame 2",
        "ccd_warp/_files/natural.py",
        '(0, int(part), "") if k % 2 else',
        "(0, 0, part) if k % 2 else",
        ("files/test_series_files.py::test_natural_order_is_that_of_a_reader",),
    ),
    # --- threads, ranks ---
    Fault(
        "the error of a task lost",
        "ccd_warp/_runtime/threads.py",
        "        if self._errors:\n            raise self._errors[0]\n",
        "",
        ("calls/test_faults.py::test_call_that_fails_at_any_use_of_warp_is_made_again",),
    ),
    Fault(
        "a box at a cut on one side of it",
        "ccd_warp/distributed/_partition.py",
        "lower[axis].take(items) < cut, upper[axis].take(items) >= cut",
        "lower[axis].take(items) < cut, lower[axis].take(items) >= cut",
        (
            "distributed/test_distributed.py::test_boxes_that_meet_are_both_in_the_region_of_the_lower_corner_of_what_they_share",
        ),
    ),
    Fault(
        "an edge of a face taken for one without",
        "ccd_warp/distributed/_numbering.py",
        "of_face[group[is_of_face[order]]] = True",
        "of_face[group[is_of_face]] = True",
        ("distributed/test_distributed.py::test_an_edge_is_codimensional_only_if_no_rank_has_a_face_with_it",),
    ),
]
