"""Powers of two in lanes of float64, by which pairs are scaled without rounding."""

import warp as wp

from ..parameters import width
from ..template import specialised

simd = specialised("pair.simd", width=width)
bits_type = "" if width == 1 else f" __attribute__((ext_vector_type({width})))"
snippet = f"""{simd.header(wp.float64, width)}
    typedef long long Bits64{bits_type};
    const Lanes a = lanes(x);
    Bits64 bits;
    memcpy(&bits, &a, sizeof(bits));
    const Bits64 mirrored = 2045 - ((bits >> 52) & 0x7FF);
    const Bits64 one = (Bits64)1;
    const Bits64 power = (mirrored < one ? one : mirrored) << 52;
    Lanes r;
    memcpy(&r, &power, sizeof(r));
    return of_lanes(r);
"""


@wp.func_native(snippet)
def inverse_power_of_two(x: simd.Lanes) -> simd.Lanes:
    """Power of two s with 1/2 <= s·x < 1, as in `rounding`."""
    ...


@simd.func
def to_unit_size(a: simd.Vec3) -> simd.Vec3:
    """A vector scaled by a power of two so that its products neither overflow nor underflow."""
    return inverse_power_of_two(simd.greatest_of(simd.magnitude(a))) * a
