"""Faults of the CPU's kernels, of the engine, of checks of the input and of readers, and the tests that find them."""

from planted.planting import Fault

_TIMES = "kernels/narrow_phase/test_narrow_phase.py"
_CANDIDATES, _ORDER = "kernels/search/test_candidates.py", "kernels/search/test_candidate_order.py"
_LEFT_OUT, _OPTIONS = "input/test_excluded_pairs.py", "calls/test_step_options.py"
_ONE_TIME = "kernels/at_one_time/test_intersections.py"
PLANTED = [
    # --- one pair ---
    Fault(
        "a coefficient of the volume of another time",
        "kernels/pair/volume.py",
        "dot(t0.w00, n1) + m1 + m1",
        "dot(t0.w00, n1) + m1 + m0",
        (_TIMES,),
    ),
    Fault(
        "a coefficient of the volume not looked at",
        "kernels/pair/volume.py",
        "least(h.c1, least(h.c2, h.c3))",
        "least(h.c1, h.c3)",
        (_TIMES,),
    ),
    Fault(
        "a side of a patch not closest",
        "kernels/pair/closest_point.py",
        "is_before_v = is_flat or v < real(0.0)",
        "is_before_v = is_flat",
        ("kernels/pair/test_closest_point.py",),
    ),
    Fault(
        "a half of a patch lost",
        "kernels/pair/subdivide.py",
        "stack[upper + 1] = nu",
        "stack[upper + 1] = u1",
        (_TIMES,),
    ),
    Fault(
        "no rounding in the offset along a direction",
        "kernels/pair/ball.py",
        "(dot(magnitude(d), error) + norm.support(separation, d)) * round_up",
        "norm.support(separation, d)",
        ("kernels/pair/test_ball_rounding.py",),
    ),
    Fault(
        "the hold of one side alone",
        "kernels/pair/hold.py",
        "return wp.min(of_first, wp.min(hold[second[0]]",
        "return wp.max(of_first, wp.min(hold[second[0]]",
        ("kernels/pair/test_hold.py",),
    ),
    # --- boxes ---
    Fault(
        "an enlarged box not rounded outward",
        "kernels/boxes/boxes.py",
        "wp.max(next_below(x - inflation), -_LARGEST_FINITE)",
        "wp.max(x - inflation, -_LARGEST_FINITE)",
        (_CANDIDATES,),
    ),
    Fault(
        "a world beyond its cell",
        "kernels/boxes/box_tree.py",
        "distance = inner + doublings * (_OUTER * inner)",
        "distance = inner + doublings * inner",
        ("engine/test_worlds.py",),
    ),
    Fault(
        "the radius of the first vertex for that of a primitive",
        "kernels/boxes/thickness.py",
        "wp.max(radius[corners[0]], wp.max(radius[corners[1]], radius[corners[2]]))",
        "radius[corners[0]]",
        ("calls/test_thickness.py",),
    ),
    Fault(
        "a box of three cells in one",
        "kernels/boxes/hash_grid.py",
        "covered[1] <= 1 and covered[2] <= 1",
        "covered[1] <= 2 and covered[2] <= 2",
        ("kernels/search/test_broad_phase.py",),
    ),
    Fault(
        "bodies near on two axes of three",
        "kernels/boxes/body_boxes.py",
        "if a[0] <= b[0] and a[1] <= b[1] and a[2] <= b[2]:",
        "if a[0] < b[0] and a[1] < b[1] and a[2] < b[2]:",
        ("kernels/boxes/test_bodies.py",),
    ),
    # --- search ---
    Fault(
        "rings around two vertices of three",
        "kernels/search/collision_filter.py",
        "            is_near(a[0], b, collision_filter)\n            or is_near(a[1], b, collision_filter)\n",
        "            is_near(a[0], b, collision_filter)\n",
        (
            "kernels/search/test_candidates.py",
            "engine/test_step.py",
            "calls/test_pipeline.py",
            "kernels/at_one_time/test_intersections.py",
        ),
    ),
    Fault(
        "the last of the listed pairs not found",
        "kernels/search/collision_filter.py",
        "    if low < end:\n        return collision_filter.listed[low] == key",
        "    if low < end - 1:\n        return collision_filter.listed[low] == key",
        (_LEFT_OUT,),
    ),
    Fault(
        "the next partner in the own block lost",
        "kernels/search/search_lanes.py",
        "mask = mask & lanes_after(query_lane)",
        "mask = mask & lanes_after(query_lane + 1)",
        (_CANDIDATES,),
    ),
    Fault(
        "a tie of quantized coordinates taken for an overlap",
        "kernels/search/search_lanes.py",
        "mask = mask & ~boxes_apart(search, q, block, mask & tied)",
        "mask = mask & ~(boxes_apart(search, q, block, mask & tied) & _NONE)",
        (_CANDIDATES,),
    ),
    Fault(
        "a corner that no direction across a side looks at",
        "kernels/search/cull.py",
        "    a = dot(d, c0.w10)\n    beyond = beyond & is_less(bound, a)",
        "    a = dot(d, c0.w01)\n    beyond = beyond & is_less(bound, a)",
        ("kernels/search/test_cull.py",),
    ),
    Fault(
        "the cull of a whole step for a part of it",
        "kernels/search/cull.py",
        "        b2 = s * t0 + t_end * t1\n",
        "        b2 = t1\n",
        ("kernels/pair/test_rounding.py", "kernels/pair/test_ball_rounding.py", "calls/test_step_options.py"),
    ),
    # --- narrow phase, step ---
    Fault(
        "no error in the value of a plane",
        "kernels/narrow_phase/planes.py",
        "v.error = _VALUE * (wp.abs(a) + wp.abs(b) + wp.abs(c)) + _ABSOLUTE",
        "v.error = _ABSOLUTE",
        ("calls/test_half_spaces.py",),
    ),
    Fault(
        "a normal along the velocity",
        "kernels/step/contact_normal.py",
        "    if wp.dot(n, w) > _ZERO:\n        n = -n\n",
        "",
        ("kernels/step/test_contact_normals.py",),
    ),
    Fault(
        "a contact on the device where its first vertex is",
        "kernels/step/contact_points.py",
        "points[n] = _HALF * first + _HALF * second",
        "points[n] = first",
        ("calls/test_device_contacts.py",),
    ),
    # --- at one time ---
    Fault(
        "an edge beside one side of a face",
        "kernels/at_one_time/intersections.py",
        "if are_opposite(past_ab, past_bc) or are_opposite(past_bc, past_ca) or are_opposite(past_ca, past_ab):",
        "if are_opposite(past_ab, past_bc) or past_ca == 1:",
        (_ONE_TIME,),
    ),
    Fault(
        "both sides of a pair move by all that is between them",
        "kernels/at_one_time/proximity.py",
        "gap = wp.max(_HALF * gap - UNDERFLOW, _ZERO)",
        "gap = wp.max(gap - UNDERFLOW, _ZERO)",
        ("kernels/at_one_time/test_displacement_bounds.py",),
    ),
    Fault(
        "no hold for the second of two edges",
        "kernels/at_one_time/start_holds.py",
        "if kind == EDGE_EDGE or kind == POINT_POINT:",
        "if kind == POINT_POINT:",
        ("kernels/pair/test_hold.py",),
    ),
    # --- engine ---
    Fault(
        "two worlds in one cell",
        "ccd_warp/_engine/worlds.py",
        "world >> (k * bits) & ((1 << bits) - 1)",
        "world >> (k * bits) & ((1 << bits) - 2)",
        ("engine/test_worlds.py",),
    ),
    Fault(
        "a cut block of queries not put in order",
        "ccd_warp/_engine/candidates.py",
        "if is_cut and not self._is_sorted:",
        "if False:",
        (_ORDER,),
    ),
    Fault(
        "neighbours by one end of an edge",
        "ccd_warp/_engine/topology.py",
        "a, b = np.concatenate([mesh.edges, mesh.edges[:, ::-1]]).T",
        "a, b = np.concatenate([mesh.edges, mesh.edges]).T",
        ("calls/test_thickness.py",),
    ),
    Fault(
        "a vertex with three neighbours not tested",
        "ccd_warp/_engine/edge_points.py",
        "(num_neighbours <= _MOST_NEIGHBOURS)",
        "(num_neighbours < _MOST_NEIGHBOURS)",
        (_ONE_TIME,),
    ),
    Fault(
        "a face without its last side",
        "ccd_warp/_engine/exact_intersections.py",
        "or along_ab + along_ac > area:",
        "or along_ab + along_ac >= area:",
        (_ONE_TIME,),
    ),
    Fault(
        "a hash searched in one direction",
        "ccd_warp/_engine/grids.py",
        "            if not pair.within:\n",
        "            if False:\n",
        ("kernels/search/test_broad_phase.py",),
    ),
    Fault(
        "a line search up to the contact",
        "ccd_warp/_engine/line_search.py",
        "fraction[touched] *= safety * bound[touched]",
        "fraction[touched] *= bound[touched]",
        ("engine/test_line_search.py",),
    ),
    Fault(
        "the earliest of the open pairs forgotten",
        "ccd_warp/_engine/host_step.py",
        "is_earlier = toi < bound",
        "is_earlier = toi > bound",
        ("engine/test_line_search.py", "calls/test_pipeline.py", "calls/test_step_options.py"),
    ),
    # --- input ---
    Fault(
        "an index one beyond the last",
        "ccd_warp/_input/excluded_pairs.py",
        "is_out = (column < 0) | (column >= count)",
        "is_out = (column < 0) | (column > count)",
        (_LEFT_OUT,),
    ),
    Fault(
        "a radius that is not finite",
        "ccd_warp/_input/mesh_checks.py",
        "is_invalid = ~(np.isfinite(given) & (given >= 0))",
        "is_invalid = given < 0",
        ("calls/test_thickness.py",),
    ),
    Fault(
        "a side between two cells kept",
        "ccd_warp/_input/cells.py",
        "is_outer = count[number[: len(sides)]] == 1",
        "is_outer = count[number[: len(sides)]] >= 1",
        ("input/test_cells.py",),
    ),
    # --- files ---
    Fault(
        "a vertex too far back",
        "ccd_warp/_files/obj.py",
        "np.repeat(num_above, rows.counts) + corners, corners - 1",
        "np.repeat(num_above, rows.counts) + corners - 1, corners - 1",
        ("files/test_damaged_files.py", "cli/test_cli.py", "files/test_bodies_of_files.py"),
    ),
    Fault(
        "rows beyond those of the header",
        "ccd_warp/_files/ply.py",
        "    if at < len(rows):\n",
        "    if False:\n",
        ("files/test_damaged_files.py",),
    ),
    Fault(
        "frame 10 before frame 2",
        "ccd_warp/_files/natural.py",
        '(0, int(part), "") if k % 2 else',
        "(0, 0, part) if k % 2 else",
        ("files/test_series_files.py",),
    ),
    # --- threads, ranks ---
    Fault(
        "the error of a task lost",
        "ccd_warp/_runtime/threads.py",
        "        if self._errors:\n            raise self._errors[0]\n",
        "",
        ("calls/test_faults.py",),
    ),
    Fault(
        "a box at a cut on one side of it",
        "ccd_warp/distributed/_partition.py",
        "lower[axis].take(items) < cut, upper[axis].take(items) >= cut",
        "lower[axis].take(items) < cut, lower[axis].take(items) >= cut",
        ("distributed/test_distributed.py",),
    ),
    Fault(
        "an edge of a face taken for one without",
        "ccd_warp/distributed/_numbering.py",
        "of_face[group[is_of_face[order]]] = True",
        "of_face[group[is_of_face]] = True",
        ("distributed/test_distributed.py",),
    ),
]
