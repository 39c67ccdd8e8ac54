"""The options of single pairs: with radii or start distances each has a distance of its own.

Otherwise they are those of the query. In the maximum norm pairs have a distance of their own only where the norm says
so; in the Euclidean norm the arrays of both decide, which are empty where there are none.
"""

import warp as wp

from ..boxes.thickness import distance_of
from ..parameters import norm, real, width
from ..step.pair_list import PairList, vertices_of_pair
from ..template import specialised
from .points import Points, farthest
from .query import Options
from .start_distance import MARGIN, OF_COORDINATES, kept_of, start_distance_of

if norm.has_arcs:
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


if not norm.is_by_pair:

    @wp.func
    def options_of_pair(options: Options, first: wp.vec3i, second: wp.vec3i) -> Options:
        """The options of a pair, given by the vertices of its primitives."""
        return options

    @wp.func
    def options_of_rows(options: Options, pairs: PairList, rows: Index) -> Options:
        """The options of the pair in each lane, given by its place in the list."""
        return options

    LaneOptions = Options
else:

    @wp.func
    def options_of_pair(options: Options, first: wp.vec3i, second: wp.vec3i) -> Options:
        """The options of a pair, given by the vertices of its primitives."""
        options.minimum_separation = distance_of(options.minimum_separation, options.radius, first, second)
        at_start = start_distance_of(options.start_distance, first, second)
        if at_start.share < infinite:
            options.minimum_separation = kept_of(at_start, options.minimum_separation)
            options.margin = margin
        return options

    @wp.func
    def options_of_row(options: Options, pairs: PairList, row: int) -> Options:
        """The options of a pair, given by its place in the list."""
        vertices = vertices_of_pair(pairs, row)
        return options_of_pair(options, vertices.first, vertices.second)

    @wp.func
    def are_equal(options: Options) -> bool:
        """Whether all pairs have the options of the query, as where they are not those of a mesh."""
        return options.radius.shape[0] == 0 and options.start_distance.shape[0] == 0

    if width == 1 and not norm.has_arcs:
        LaneOptions = Options

        @wp.func
        def lanes_at_start_distance(options: LaneOptions) -> wp.uint32:
            """Bits of the lanes whose pairs keep their start distance."""
            return wp.where(options.margin > wp.float64(0.0), wp.uint32(1), wp.uint32(0))

        @wp.func
        def without_margin(
            separation: wp.float64, size: wp.float64, points_t0: Points, points_t1: Points, options: LaneOptions
        ) -> wp.float64:
            """A separation less the margin of a pair of a size that keeps its start distance."""
            if options.margin > wp.float64(0.0):
                size += of_coordinates * farthest(points_t0, points_t1)
                return wp.max(separation - options.margin * size, wp.float64(0.0))
            return separation

        @wp.func
        def options_of_rows(options: Options, pairs: PairList, row: int) -> LaneOptions:
            """The options of a pair, given by its place in the list."""
            if are_equal(options):
                return options
            return options_of_row(options, pairs, row)

    else:

        @wp.struct
        class LaneOptions:
            """What the lanes take of the options of a query, with a distance for the pair in each lane."""

            tolerance: wp.float64
            minimum_separation: Lanes
            keeps_start_distance: wp.uint32  # bits of the lanes whose pairs do
            start_gap_fraction: wp.float64
            length_scale: wp.float64
            t_end: real
            method: int
            if norm.has_arcs:
                sagitta: simd.Vec3  # how far the points of the pair may be from their chords
                arcs: Arcs

        @wp.func
        def lanes_at_start_distance(options: LaneOptions) -> wp.uint32:
            """Bits of the lanes whose pairs keep their start distance."""
            return options.keeps_start_distance

        @simd.func
        def without_margin(
            separation: Lanes, size: Lanes, points_t0: Points, points_t1: Points, options: LaneOptions
        ) -> Lanes:
            """A separation less the margin of a pair of a size that keeps its start distance, in each lane."""
            if options.keeps_start_distance != wp.uint32(0):
                size = size + of_coordinates * farthest(points_t0, points_t1)
                less = simd.greatest(separation - margin * size, wp.float64(0.0))
                return simd.select(simd.mask_of(options.keeps_start_distance), less, separation)
            return separation

        @wp.func
        def options_of_rows(options: Options, pairs: PairList, rows: Index) -> LaneOptions:
            """The options of the pair in each lane, given by its place in the list."""
            lane_options = LaneOptions()
            lane_options.tolerance = options.tolerance
            distances = simd.spread(options.minimum_separation)
            keeps_start_distance = wp.uint32(0)
            if not are_equal(options):
                for k in range(lanes):
                    of_pair = options_of_row(options, pairs, row_in(rows, k))
                    distances = with_lane(distances, k, of_pair.minimum_separation)
                    if of_pair.margin > wp.float64(0.0):
                        keeps_start_distance = keeps_start_distance | (wp.uint32(1) << wp.uint32(k))
            lane_options.minimum_separation = distances
            lane_options.keeps_start_distance = keeps_start_distance
            lane_options.start_gap_fraction = options.start_gap_fraction
            lane_options.length_scale = options.length_scale
            lane_options.t_end = options.t_end
            lane_options.method = options.method
            return lane_options
