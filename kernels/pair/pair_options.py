"""The options of single pairs: with radii, and where pairs are held, each has a distance of its own.

Otherwise they are those of the query. In the maximum norm pairs have a distance of their own only where the norm says
so; in the Euclidean norm the arrays of radii and holds decide, which are empty where there are none.
"""

import warp as wp

from ..boxes.thickness import distance_of
from ..pair_key import pair_of
from ..parameters import norm, real, width
from ..template import specialised
from .hold import MARGIN, OF_COORDINATES, held_at
from .norm import has_arcs, is_by_pair
from .points import Points, farthest
from .query import Options

if has_arcs(norm):
    Arcs = specialised("pair.arcs", norm=norm, width=width).Arcs
simd = specialised("pair.simd", width=width)
Lanes = simd.Lanes
Index = wp.types.vector(length=width, dtype=wp.int32) if width > 1 else int
lanes = wp.constant(width)
infinite = wp.constant(wp.float64(float("inf")))
margin = wp.constant(wp.float64(MARGIN))
of_coordinates = wp.constant(wp.float64(OF_COORDINATES))

if width > 1:

    @wp.func
    def row_in(rows: Index, lane: int) -> int:
        """The row in a lane."""
        return rows[lane]

    @wp.func
    def with_lane(a: Lanes, lane: int, value: wp.float64) -> Lanes:
        """Lanes, of which one has another value."""
        a[lane] = value
        return a

else:

    @wp.func
    def row_in(rows: Index, lane: int) -> int:
        """The row in a lane."""
        return rows

    @wp.func
    def with_lane(a: Lanes, lane: int, value: wp.float64) -> Lanes:
        """Lanes, of which one has another value."""
        return value


if not is_by_pair(norm):

    @wp.func
    def options_of_pair(options: Options, first: wp.vec3i, second: wp.vec3i) -> Options:
        """The options of a pair, given by the vertices of its primitives."""
        return options

    @wp.func
    def options_of_rows(
        options: Options,
        pairs: wp.array[wp.int64],
        rows: Index,
        first_corners: wp.array[wp.vec3i],
        second_corners: wp.array[wp.vec3i],
    ) -> Options:
        """The options of the pair in each lane, given by its place in the list of keys."""
        return options

    LaneOptions = Options
else:

    @wp.func
    def options_of_pair(options: Options, first: wp.vec3i, second: wp.vec3i) -> Options:
        """The options of a pair, given by the vertices of its primitives."""
        options.minimum_separation = distance_of(options.minimum_separation, options.radius, first, second)
        held = held_at(options.hold, first, second)
        if held < infinite:
            options.minimum_separation = wp.min(options.minimum_separation, held)
            options.margin = margin
        return options

    @wp.func
    def of_key(
        key: wp.int64, first_corners: wp.array[wp.vec3i], second_corners: wp.array[wp.vec3i], options: Options
    ) -> Options:
        """The options of a pair; the key of an open pair is its complement."""
        pair = pair_of(wp.where(key < wp.int64(0), ~key, key))
        return options_of_pair(options, first_corners[pair[0]], second_corners[pair[1]])

    @wp.func
    def are_equal(options: Options) -> bool:
        """Whether all pairs have the options of the query, as where they are not those of a mesh."""
        return options.radius.shape[0] == 0 and options.hold.shape[0] == 0

    if width == 1 and not has_arcs(norm):
        LaneOptions = Options

        @wp.func
        def held_lanes(options: LaneOptions) -> wp.uint32:
            """Bits of the lanes whose pairs are held."""
            return wp.where(options.margin > wp.float64(0.0), wp.uint32(1), wp.uint32(0))

        @wp.func
        def without_margin(
            separation: wp.float64, size: wp.float64, points_t0: Points, points_t1: Points, options: LaneOptions
        ) -> wp.float64:
            """A separation less the margin of a held pair of a size."""
            if options.margin > wp.float64(0.0):
                size += of_coordinates * farthest(points_t0, points_t1)
                return wp.max(separation - options.margin * size, wp.float64(0.0))
            return separation

        @wp.func
        def options_of_rows(
            options: Options,
            pairs: wp.array[wp.int64],
            row: int,
            first_corners: wp.array[wp.vec3i],
            second_corners: wp.array[wp.vec3i],
        ) -> LaneOptions:
            """The options of a pair, given by its place in the list of keys."""
            if are_equal(options):
                return options
            return of_key(pairs[row], first_corners, second_corners, options)

    else:

        @wp.struct
        class LaneOptions:
            """What the lanes take of the options of a query, with a distance for the pair in each lane."""

            tolerance: wp.float64
            minimum_separation: Lanes
            held: wp.uint32  # bits of the lanes whose pairs are held
            start_gap_fraction: wp.float64
            length_scale: wp.float64
            t_end: real
            method: int
            if has_arcs(norm):
                sagitta: simd.Vec3  # how far the points of the pair may be from their chords
                arcs: Arcs

        @wp.func
        def held_lanes(options: LaneOptions) -> wp.uint32:
            """Bits of the lanes whose pairs are held."""
            return options.held

        @simd.func
        def without_margin(
            separation: Lanes, size: Lanes, points_t0: Points, points_t1: Points, options: LaneOptions
        ) -> Lanes:
            """A separation less the margin of a held pair of a size, in each lane."""
            if options.held != wp.uint32(0):
                size = size + of_coordinates * farthest(points_t0, points_t1)
                less = simd.greatest(separation - margin * size, wp.float64(0.0))
                return simd.select(simd.mask_of(options.held), less, separation)
            return separation

        @wp.func
        def options_of_rows(
            options: Options,
            pairs: wp.array[wp.int64],
            rows: Index,
            first_corners: wp.array[wp.vec3i],
            second_corners: wp.array[wp.vec3i],
        ) -> LaneOptions:
            """The options of the pair in each lane, given by its place in the list of keys."""
            own = LaneOptions()
            own.tolerance = options.tolerance
            distances = simd.spread(options.minimum_separation)
            held = wp.uint32(0)
            if not are_equal(options):
                for k in range(lanes):
                    of_pair = of_key(pairs[row_in(rows, k)], first_corners, second_corners, options)
                    distances = with_lane(distances, k, of_pair.minimum_separation)
                    if of_pair.margin > wp.float64(0.0):
                        held = held | (wp.uint32(1) << wp.uint32(k))
            own.minimum_separation = distances
            own.held = held
            own.start_gap_fraction = options.start_gap_fraction
            own.length_scale = options.length_scale
            own.t_end = options.t_end
            own.method = options.method
            return own
