"""What is formed in float64, in the precision of the iteration: numbers, corners in normalised units, the volume."""

import warp as wp

from ..parameters import real, width
from ..template import specialised
from .patch import Corners, Volume
from .simd import Lanes, Vec3, vec
from .volume import bounded

simd64 = specialised("pair.simd", width=width)
Corners64 = specialised("pair.patch", width=width).Corners
coefficients_of = specialised("pair.volume", width=width).coefficients_of

if real == wp.float64:

    @wp.func
    def narrowed(x: simd64.Lanes) -> Lanes:
        """Lanes in the precision of the iteration."""
        return x

    @wp.func
    def widened(x: Lanes) -> simd64.Lanes:
        """Lanes in float64."""
        return x

elif width == 1:

    @wp.func
    def narrowed(x: simd64.Lanes) -> Lanes:
        """Lanes in the precision of the iteration."""
        return wp.float32(x)

    @wp.func
    def widened(x: Lanes) -> simd64.Lanes:
        """Lanes in float64."""
        return wp.float64(x)

else:
    typed = f"""
    typedef double Wide __attribute__((ext_vector_type({width})));
    typedef float Narrow __attribute__((ext_vector_type({width})));
    Wide wide;
    Narrow narrow;
"""

    narrowed_snippet = (
        typed
        + f"""
    __builtin_memcpy(&wide, &x, sizeof(wide));
    narrow = __builtin_convertvector(wide, Narrow);
    wp::vec_t<{width}, float> r;
    __builtin_memcpy(&r, &narrow, sizeof(narrow));
    return r;
"""
    )

    @wp.func_native(narrowed_snippet)
    def narrowed(x: simd64.Lanes) -> Lanes:
        """Lanes in the precision of the iteration."""
        ...

    widened_snippet = (
        typed
        + f"""
    __builtin_memcpy(&narrow, &x, sizeof(narrow));
    wide = __builtin_convertvector(narrow, Wide);
    wp::vec_t<{width}, double> r;
    __builtin_memcpy(&r, &wide, sizeof(wide));
    return r;
"""
    )

    @wp.func_native(widened_snippet)
    def widened(x: Lanes) -> simd64.Lanes:
        """Lanes in float64."""
        ...


@wp.func
def narrowed(a: simd64.Vec3) -> Vec3:
    return vec(narrowed(a.x), narrowed(a.y), narrowed(a.z))


@wp.func
def normalised(c: Corners64, s: simd64.Vec3) -> Corners:
    """Corners in normalised units (rounding, step 2)."""
    r = Corners()
    r.w00 = narrowed(simd64.scaled(c.w00, s))
    r.w01 = narrowed(simd64.scaled(c.w01, s))
    r.w10 = narrowed(simd64.scaled(c.w10, s))
    r.w11 = narrowed(simd64.scaled(c.w11, s))
    r.q = narrowed(simd64.scaled(c.q, s))
    r.r = narrowed(simd64.scaled(c.r, s))
    return r


if real == wp.float64:

    @wp.func
    def volume_between(
        c0: Corners64,
        c1: Corners64,
        s: simd64.Vec3,
        t0: Corners,
        t1: Corners,
        separation: Vec3,
        has_separation: bool,
    ) -> Volume:
        """The volume beyond a separation, of corners at both ends, and of the same in normalised units."""
        return bounded(coefficients_of(t0, t1), t0, t1, separation, has_separation)

else:

    @wp.func
    def in_units(c: Corners64, s: simd64.Vec3) -> Corners64:
        """What the volume takes of corners, in normalised units."""
        r = Corners64()
        r.w00 = simd64.scaled(c.w00, s)
        r.q = simd64.scaled(c.q, s)
        r.r = simd64.scaled(c.r, s)
        return r

    @wp.func
    def volume_between(
        c0: Corners64,
        c1: Corners64,
        s: simd64.Vec3,
        t0: Corners,
        t1: Corners,
        separation: Vec3,
        has_separation: bool,
    ) -> Volume:
        """The volume beyond a separation, of corners at both ends, and of the same in normalised units."""
        f = coefficients_of(in_units(c0, s), in_units(c1, s))
        r = Volume()
        r.b0 = narrowed(f.b0)
        r.b1 = narrowed(f.b1)
        r.b2 = narrowed(f.b2)
        r.b3 = narrowed(f.b3)
        r.normal_t0 = narrowed(f.normal_t0)
        r.normal_mid = narrowed(f.normal_mid)
        r.normal_t1 = narrowed(f.normal_t1)
        return bounded(r, t0, t1, separation, has_separation)
