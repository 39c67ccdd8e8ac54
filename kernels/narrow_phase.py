"""Narrow phase: earliest time of impact of one pair for each thread, for every pair kind and both precisions.

A thread forms the corners of its pair's patch (differences first, in float64), normalises each axis by a power of two,
and advances the whole patch; only a pair whose advance is slow is subdivided.
"""

from types import SimpleNamespace

import warp as wp

from .advance import CONTACT, FREE, LIMIT, SLOW, make_advance
from .answer import make_answer
from .atomics import atomic_min_int64, claim, claim_int
from .bisection import make_bisection
from .closest_point import make_closest_point
from .contacts import ContactList, normal_at
from .facets import make_facets
from .interrupts import is_stopped
from .minima import CONTACTS_OVERFLOW, FOUND, OPEN, Minima, flag_world, lower_pair
from .once import once
from .pair_key import pair_of
from .patch import VERTEX_FACE, make_patch
from .points import Corners as Corners64
from .points import (
    Points,
    corners,
    is_stationary,
    longest_side,
    magnitude,
    points_of,
    relative_motion,
    row_points,
    scaled,
    total,
)
from .query import BISECTION, CLIPPING, make_query
from .rounding import (
    LARGEST,
    PROJECTION_PATCH,
    PROJECTION_ROOT,
    RELATIVE,
    TINY,
    UNIT_ROUNDOFF,
    inverse_power_of_two,
)
from .status import (
    STATUS_COLLISION,
    STATUS_INITIAL_CONTACT,
    STATUS_INVALID,
    STATUS_ITERATION_LIMIT,
    STATUS_NO_COLLISION,
)
from .subdivide import make_subdivide
from .volume import make_volume

# A separation beyond any corner, in normalised units; small enough for every product in float32.
_FAR = wp.constant(wp.float64(2.0**60))

# A toi below this may be so small only because the gap is lost in the rounding of a float32 motion.
_LOST_TOI = wp.constant(wp.float64(2.0**-20))

vec3d = wp.vec3d


@once
def make_narrow_phase(real) -> SimpleNamespace:
    """Kernels for one floating-point type of the iteration; positions are always float64."""
    vec3 = wp.types.vector(length=3, dtype=real)
    types = make_patch(real)
    Patch = types.Patch
    Problem = types.Problem
    Corners = types.Corners
    Options = make_query(real).Options
    share_of_work = make_query(real).share_of_work
    advance = make_advance(real).advance
    with_volume = make_volume(real).with_volume
    point_of = make_advance(real).point_of
    closest_weights = make_closest_point(real).closest_weights
    corners_at = make_facets(real).corners_at
    bisect = make_bisection(real).bisect
    Answer = make_answer(real).Answer
    subdivide = make_subdivide(real).subdivide
    parameters = make_answer(real).parameters
    root_bound = wp.constant(real(PROJECTION_ROOT * UNIT_ROUNDOFF[real]))
    patch_bound = wp.constant(real(PROJECTION_PATCH * UNIT_ROUNDOFF[real]))
    start_gap_share = make_facets(real).start_gap_share
    round_down = wp.constant(real(1.0 - RELATIVE * UNIT_ROUNDOFF[real]))
    round_up = wp.constant(real(1.0 + RELATIVE * UNIT_ROUNDOFF[real]))
    tiny = wp.constant(real(TINY[real]))

    @wp.func
    def normalised(c: Corners64, s: vec3d) -> Corners:
        """Corners in normalised units (rounding, step 2)."""
        r = Corners()
        r.w00 = vec3(wp.cw_mul(c.w00, s))
        r.w01 = vec3(wp.cw_mul(c.w01, s))
        r.w10 = vec3(wp.cw_mul(c.w10, s))
        r.w11 = vec3(wp.cw_mul(c.w11, s))
        r.q = vec3(wp.cw_mul(c.q, s))
        r.r = vec3(wp.cw_mul(c.r, s))
        return r

    @wp.struct
    class Outcome:
        """The reported result of a pair."""

        toi: wp.float64
        status: int
        parameters: wp.vec2d
        gap: wp.float64
        width: wp.float64
        iterations: int

    @wp.struct
    class Normalised:
        """A pair in normalised units."""

        patch: Patch
        problem: Problem
        size: vec3  # largest corner, per axis
        unit: vec3d  # length of a normalised unit, per axis
        is_valid: bool

    @wp.func
    def normalise(kind: int, points_t0: Points, points_t1: Points, options: Options) -> Normalised:
        """Form the corners and scale each axis by a power of two (rounding, steps 1 and 2)."""
        n = Normalised()
        c0 = corners(kind, points_t0)
        c1 = corners(kind, points_t1)
        sums = total(c0) + total(c1)
        one = wp.float64(1.0)
        smaller = wp.float64(1.0 / 1024.0)
        pre = vec3d(one, one, one)
        if not (sums[0] <= LARGEST and sums[1] <= LARGEST and sums[2] <= LARGEST):
            # an overflow, or NaN in the input: try again with the axes that overflowed at 1/1024 of their size
            for k in range(3):
                if not sums[k] <= LARGEST:
                    pre[k] = smaller
            c0 = corners(kind, scaled(points_t0, pre))
            c1 = corners(kind, scaled(points_t1, pre))
            sums = total(c0) + total(c1)
        n.is_valid = sums[0] <= LARGEST and sums[1] <= LARGEST and sums[2] <= LARGEST
        if n.is_valid:
            # lengths are scaled by 1/1024 as well where the points or their box come near overflow
            shrink = wp.min(wp.min(pre[0], pre[1]), pre[2])
            scale = options.length_scale * shrink
            if scale <= wp.float64(0.0):
                scale = longest_side(points_t0, points_t1)
                if shrink < one or not scale <= LARGEST:
                    shrink = smaller
                    small = vec3d(smaller, smaller, smaller)
                    scale = longest_side(scaled(points_t0, small), scaled(points_t1, small))
            delta_length = wp.min(options.tolerance * scale, LARGEST)
            separation_length = wp.min(options.minimum_separation * scale, LARGEST)
            m = wp.max(magnitude(c0), magnitude(c1))
            s = vec3d()
            is_cut = bool(False)
            for k in range(3):
                # an axis on which the patch is smaller than the tolerance is not magnified beyond the tolerance
                unit = pre[k] / shrink
                s[k] = inverse_power_of_two(wp.max(m[k], delta_length * unit))
                n.unit[k] = one / s[k] / pre[k]
                # corners are below 4 in these units, so a separation or tolerance above _FAR has the effect of _FAR
                length = wp.min(separation_length * unit * s[k], _FAR)
                is_cut = is_cut or length == _FAR
                n.problem.separation[k] = real(length) * round_up
                length = wp.min(delta_length * unit * s[k], _FAR)
                n.problem.delta[k] = real(length)
            n.size = vec3(wp.cw_mul(m, s))
            n.problem.error = root_bound * n.size + vec3(tiny, tiny, tiny)
            n.problem.delta = n.problem.delta + real(2.0) * n.problem.error
            n.problem.has_separation = separation_length > wp.float64(0.0)
            n.patch.t0 = normalised(c0, s)
            n.patch.t1 = normalised(c1, s)
            n.patch.is_face = kind == VERTEX_FACE
            n.patch.is_triangle = kind == VERTEX_FACE
            n.patch.narrowing = wp.where(kind == VERTEX_FACE, real(0.0), real(1.0))
            if options.start_gap_fraction > wp.float64(0.0) and n.problem.has_separation and not is_cut:
                share = start_gap_share(n.patch.t0, n.patch.is_face, n.problem)
                share = wp.max(share * real(options.start_gap_fraction), real(0.0)) * round_down
                if share < real(1.0):
                    n.problem.separation = share * n.problem.separation
                    n.problem.has_separation = share > real(0.0)
            n.problem = with_volume(n.problem, n.patch.t0, n.patch.t1)
        return n

    @wp.func
    def gap_of(point: vec3, n: Normalised) -> wp.float64:
        """Upper bound of the gap (L∞) beyond the separation at a point of the patch, as a length."""
        gap = wp.float64(0.0)
        for k in range(3):
            # the separation was rounded up, and the point carries the errors of a corner and of its interpolation
            beyond = wp.abs(point[k]) + real(3.0) * n.problem.error[k] - round_down * n.problem.separation[k]
            if beyond > real(0.0):
                gap = wp.max(gap, wp.float64(beyond) * n.unit[k])
        return gap

    @wp.func
    def to_lengths(n: Normalised) -> vec3:
        """Factors that convert corners to lengths, up to a factor common to all axes."""
        largest = wp.max(wp.max(n.unit[0], n.unit[1]), n.unit[2])
        if largest <= LARGEST:
            return vec3(n.unit / largest)
        return vec3(real(1.0), real(1.0), real(1.0))

    @wp.func
    def solve(kind: int, n: Normalised, options: Options, max_iterations: int) -> Outcome:
        """Earliest toi of one pair, inf if none."""
        outcome = Outcome()
        outcome.toi = wp.float64(wp.inf)
        outcome.status = STATUS_NO_COLLISION
        if not n.is_valid:
            outcome.toi = wp.float64(0.0)
            outcome.status = STATUS_INVALID
            outcome.gap = wp.float64(wp.inf)
            outcome.width = options.t_max
        else:
            answer = Answer()
            patch_error = patch_bound * n.size + vec3(tiny, tiny, tiny)
            if options.method == BISECTION:
                n.problem.error = patch_error
                n.problem.delta = n.problem.delta + real(2.0) * n.problem.error
                answer = bisect(kind, n.patch, n.problem, options.t_end, max_iterations, options.stop)
            else:
                reached = advance(n.patch, n.problem, real(0.0), options.t_end, max_iterations)
                if reached.outcome == SLOW:
                    n.problem.error = patch_error
                    n.problem.delta = n.problem.delta + real(2.0) * n.problem.error
                    left = max_iterations - reached.iterations
                    answer = subdivide(kind, n.patch, n.problem, reached.t, options.t_end, left, options.stop)
                    answer.iterations += reached.iterations
                else:
                    answer.toi = reached.t
                    answer.iterations = reached.iterations
                    if reached.outcome == CONTACT:
                        answer.status = STATUS_COLLISION
                    elif reached.outcome == LIMIT:
                        answer.status = STATUS_ITERATION_LIMIT
                    answer.point = reached.point
                    answer.parameters = parameters(
                        kind, real(0.0), real(1.0), real(0.0), real(1.0), reached.wb, reached.wc, reached.from_w11
                    )
            outcome.iterations = answer.iterations
            if answer.status != STATUS_NO_COLLISION and wp.float64(answer.toi) <= options.t_max:
                outcome.toi = wp.float64(answer.toi)
                outcome.status = answer.status
                outcome.width = wp.float64(answer.width)
                is_open = answer.status != STATUS_COLLISION
                if not is_open and answer.toi == real(0.0):
                    outcome.status = STATUS_INITIAL_CONTACT
                if is_open or n.problem.has_separation:
                    # the toi is the earliest time still open, on any sub-patch; or the point is one within the
                    # separation, which need not be the closest
                    c = corners_at(n.patch, answer.toi)
                    s = to_lengths(n)
                    wb, wc, from_w11 = closest_weights(
                        wp.cw_mul(s, c.w00),
                        wp.cw_mul(s, c.w01),
                        wp.cw_mul(s, c.w10),
                        wp.cw_mul(s, c.w11),
                        n.patch.is_triangle,
                    )
                    answer.parameters = parameters(kind, real(0.0), real(1.0), real(0.0), real(1.0), wb, wc, from_w11)
                    if is_open:
                        answer.point = point_of(c, wb, wc, from_w11)
                        outcome.width = options.t_max - outcome.toi
                outcome.parameters = answer.parameters
                outcome.gap = gap_of(answer.point, n)
        return outcome

    def own_module(name: str):
        """A Warp module for each kernel, so that a scene compiles only those that it launches."""
        module = wp.get_module(f"ccd_warp.{name}.{real.__name__}")
        wp.set_module_options({"enable_backward": False, "fuse_fp": False, "max_unroll": 1}, module=module)
        return module

    @wp.kernel(module=own_module("points_toi"))
    def points_toi(
        begin: int,
        # in
        kind: int,
        points_t0: wp.array2d[vec3d],
        points_t1: wp.array2d[vec3d],
        options: Options,
        # out
        toi: wp.array[wp.float64],
        status: wp.array[wp.int32],
        parameters: wp.array[wp.vec2d],
        gap: wp.array[wp.float64],
        width: wp.array[wp.float64],
        iterations: wp.array[wp.int32],
    ):
        """Solve pairs given by their points, shape [n, 4], [n, 3] or [n, 2]."""
        i = begin + wp.tid()
        if is_stopped(options.stop):
            return
        n = normalise(kind, row_points(points_t0, i), row_points(points_t1, i), options)
        outcome = solve(kind, n, options, options.max_iterations)
        toi[i] = outcome.toi
        status[i] = outcome.status
        parameters[i] = outcome.parameters
        gap[i] = outcome.gap
        width[i] = outcome.width
        iterations[i] = outcome.iterations

    @wp.func
    def next_pair(k: wp.int64, chunk: int, num_solvers: int) -> wp.int64:
        """The pair that a solver takes after pair k: the next one of its chunk, or the first of its next chunk."""
        if (k + wp.int64(1)) % wp.int64(chunk) == wp.int64(0):
            return k + wp.int64(1) + wp.int64(num_solvers - 1) * wp.int64(chunk)
        return k + wp.int64(1)

    @wp.func
    def cap_of_round(options: Options, is_second: int, num_open: wp.int64) -> int:
        """Iterations of each pair: in the second round its share of the work left to the open pairs, 0 without any."""
        if is_second != 0:
            if num_open == wp.int64(0):
                return 0
            return share_of_work(options, num_open)
        return wp.min(options.first_iterations, options.max_iterations)

    @wp.func
    def key_in_round(key: wp.int64, is_second: int) -> wp.int64:
        """The key of a pair; below 0 in the second round for those that the first has not marked as open."""
        if is_second != 0:
            return ~key
        return key

    @wp.kernel(module=own_module("solve_pairs"))
    def solve_pairs(
        begin: int,
        # in
        num_solvers: int,
        chunk: int,
        kind: int,
        counts: wp.array2d[wp.int64],
        pairs: wp.array[wp.int64],
        first_corners: wp.array[wp.vec3i],
        second_corners: wp.array[wp.vec3i],
        vertices_t0: wp.array[vec3d],
        vertices_t1: wp.array[vec3d],
        options: Options,
        is_second: int,  # 1: the second round, of the pairs that the first has marked as open
        only_moving: int,  # 1: a stationary pair is not solved, so it may touch
        gaps_moved: wp.float64,  # above 0: a toi near 0 is raised to the time in which the pair moves by this many gaps
        # out
        minima: Minima,
        contacts: ContactList,
    ):
        """Solve the pairs of a solver, which are every ``num_solvers``-th chunk; lower the minima, list the contacts.

        The first round marks each pair that it leaves open by the complement of its key.
        """
        count = wp.min(counts[kind, FOUND], wp.int64(pairs.shape[0]))
        cap = cap_of_round(options, is_second, counts[kind, OPEN])
        if cap == 0:
            return
        following = wp.int64(begin + wp.tid()) * wp.int64(chunk)
        while following < count:
            k = following
            following = next_pair(k, chunk, num_solvers)
            if is_stopped(options.stop):
                return
            key = key_in_round(pairs[k], is_second)
            if key < wp.int64(0):
                continue
            pair = pair_of(key)
            first = first_corners[pair[0]]
            second = second_corners[pair[1]]
            a = points_of(kind, first, second, vertices_t0)
            b = points_of(kind, first, second, vertices_t1)
            outcome = Outcome()
            outcome.status = STATUS_NO_COLLISION
            is_needed = bool(True)
            if only_moving != 0:
                is_needed = not is_stationary(a, b)
            if is_needed:
                outcome = solve(kind, normalise(kind, a, b, options), options, cap)
            if outcome.status == STATUS_ITERATION_LIMIT and is_second == 0 and cap < options.max_iterations:
                pairs[k] = ~key
                claim(counts, kind, OPEN, 1)
            elif outcome.status != STATUS_NO_COLLISION:
                toi = outcome.toi
                if gaps_moved > wp.float64(0.0) and toi < _LOST_TOI:
                    motion = relative_motion(a, b)
                    if gaps_moved * outcome.gap < motion:
                        toi = wp.max(toi, gaps_moved * outcome.gap / motion)
                lower_pair(minima, first, second, wp.cast(toi, wp.int64))
                n = claim_int(contacts.count, 0)
                if n < contacts.toi.shape[0]:
                    contacts.kind[n] = kind
                    contacts.primitives[n] = pair
                    contacts.toi[n] = outcome.toi
                    contacts.status[n] = outcome.status
                    contacts.parameters[n] = outcome.parameters
                    contacts.gap[n] = outcome.gap
                    contacts.width[n] = outcome.width
                    contacts.normal[n] = normal_at(
                        kind, first, second, vertices_t0, vertices_t1, outcome.toi, outcome.parameters
                    )
                else:
                    flag_world(minima, first[0], CONTACTS_OVERFLOW)

    @wp.kernel(module=own_module("pairs_bound"))
    def pairs_bound(
        begin: int,
        # in
        num_solvers: int,
        chunk: int,
        kind: int,
        counts: wp.array2d[wp.int64],
        pairs: wp.array[wp.int64],
        first_corners: wp.array[wp.vec3i],
        second_corners: wp.array[wp.vec3i],
        vertices_t0: wp.array[vec3d],
        vertices_t1: wp.array[vec3d],
        options: Options,
        is_second: int,
        # out
        least_bits: wp.array[wp.int64],
        open_toi: wp.array[wp.float64],
    ):
        """Like ``solve_pairs``, for the least toi alone; that of a pair left open is written beside its key.

        A pair is left out if the first step of its advance shows that its toi is no less than the least one. Its
        solution begins with the same step, so the least toi does not depend on the order of the pairs. As integers, the
        bits of two non-negative numbers compare as the numbers do.
        """
        count = wp.min(counts[kind, FOUND], wp.int64(pairs.shape[0]))
        cap = cap_of_round(options, is_second, counts[kind, OPEN])
        if cap == 0:
            return
        following = wp.int64(begin + wp.tid()) * wp.int64(chunk)
        while following < count:
            k = following
            following = next_pair(k, chunk, num_solvers)
            if is_stopped(options.stop):
                return
            key = key_in_round(pairs[k], is_second)
            if key < wp.int64(0):
                continue
            pair = pair_of(key)
            first = first_corners[pair[0]]
            second = second_corners[pair[1]]
            a = points_of(kind, first, second, vertices_t0)
            b = points_of(kind, first, second, vertices_t1)
            n = normalise(kind, a, b, options)
            is_later = bool(False)
            if n.is_valid and options.method == CLIPPING:
                reached = advance(n.patch, n.problem, real(0.0), options.t_end, 1)
                is_later = reached.outcome == FREE or wp.cast(wp.float64(reached.t), wp.int64) >= least_bits[0]
            if not is_later:
                outcome = solve(kind, n, options, cap)
                if outcome.status == STATUS_ITERATION_LIMIT and is_second == 0 and cap < options.max_iterations:
                    pairs[k] = ~key
                    open_toi[k] = outcome.toi
                    claim(counts, kind, OPEN, 1)
                else:
                    atomic_min_int64(least_bits, 0, wp.cast(outcome.toi, wp.int64))

    return SimpleNamespace(
        normalise=normalise,
        points_toi=points_toi,
        solve_pairs=solve_pairs,
        pairs_bound=pairs_bound,
    )
