"""The options of single pairs: with radii each has a distance of its own, otherwise they are those of the query."""

from types import SimpleNamespace

import warp as wp

from .norm import THICK_NORM
from .once import once
from .pair_key import pair_of
from .query import make_query
from .simd import make_simd
from .thickness import distance_of


@once
def make_pair_options(real, width: int, norm: str) -> SimpleNamespace:
    """Structs and functions for one floating-point type of the iteration, a number of lanes and a norm."""
    Options = make_query(real).Options
    Lanes = make_simd(wp.float64, width).Lanes
    Index = wp.types.vector(length=width, dtype=wp.int32) if width > 1 else int
    lanes = wp.constant(width)

    if norm != THICK_NORM:

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

        return SimpleNamespace(LaneOptions=Options, options_of_pair=options_of_pair, options_of_rows=options_of_rows)

    @wp.func
    def of_key(
        key: wp.int64, first_corners: wp.array[wp.vec3i], second_corners: wp.array[wp.vec3i], options: Options
    ) -> wp.float64:
        """Distance of a pair; the key of an open pair is its complement."""
        pair = pair_of(wp.where(key < wp.int64(0), ~key, key))
        return distance_of(options.minimum_separation, options.radius, first_corners[pair[0]], second_corners[pair[1]])

    @wp.func
    def with_distance(options: Options, distance: wp.float64) -> Options:
        """The options of a query with a distance of its own."""
        options.minimum_separation = distance
        return options

    @wp.func
    def options_of_pair(options: Options, first: wp.vec3i, second: wp.vec3i) -> Options:
        """The options of a pair, given by the vertices of its primitives."""
        return with_distance(options, distance_of(options.minimum_separation, options.radius, first, second))

    if width == 1:
        LaneOptions = Options

        @wp.func
        def options_of_rows(
            options: Options,
            pairs: wp.array[wp.int64],
            row: int,
            first_corners: wp.array[wp.vec3i],
            second_corners: wp.array[wp.vec3i],
        ) -> LaneOptions:
            """The options of a pair, given by its place in the list of keys."""
            return with_distance(options, of_key(pairs[row], first_corners, second_corners, options))

    else:

        @wp.struct
        class LaneOptions:
            """What the lanes take of the options of a query, with a distance for the pair in each lane."""

            tolerance: wp.float64
            minimum_separation: Lanes
            start_gap_fraction: wp.float64
            length_scale: wp.float64
            t_end: real
            method: int

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
            distances = Lanes()
            for k in range(lanes):
                distances[k] = of_key(pairs[rows[k]], first_corners, second_corners, options)
            own.minimum_separation = distances
            own.start_gap_fraction = options.start_gap_fraction
            own.length_scale = options.length_scale
            own.t_end = options.t_end
            own.method = options.method
            return own

    return SimpleNamespace(LaneOptions=LaneOptions, options_of_pair=options_of_pair, options_of_rows=options_of_rows)
