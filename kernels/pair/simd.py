"""Arithmetic on several pairs at once: each number of a pair is a vector with one lane for each pair.

The cull and the first stages of the narrow phase are written once, over a **lane type**: vectors of 8 numbers for
AVX-512, for AVX2 of 4 in float64 and 8 in float32, and plain numbers, a width of 1, everywhere else and on
CUDA. Operators and functions act on each lane by itself and round it as they round a single number, so the result of
a pair depends neither on its lane nor on the width. No lane has a branch of its own: a comparison gives a mask, and
`select` chooses by it.

The operations on vectors are functions in Clang's vector extension; between them LLVM keeps vectors in registers. Warp
resolves the operators +, -, *, /, & and | to functions called ``add``, ``sub``, ``mul``, ``div``, ``bit_and`` and
``bit_or`` where a function can see such names; `func` is `wp.func` with these names in sight. A plain number beside
lanes stands for itself in each of them.
"""

import inspect
import sys
import types
import zlib
from collections.abc import Callable
from typing import Any

import warp as wp

from ..parameters import real, width

_CPP = {wp.float64: "double", wp.float32: "float"}
_MASK_CPP = {wp.float64: "long long", wp.float32: "int"}
_MASK = {wp.float64: wp.int64, wp.float32: wp.int32}


def header(dtype: Any, width: int) -> str:
    """C++ types of lanes and masks, and their conversions from and to Warp's types."""
    if width == 1:
        return f"""
    typedef {_CPP[dtype]} Lanes;
    typedef bool Mask;
    const auto lanes = [](Lanes x) {{ return x; }};
    const auto mask = [](Mask x) {{ return x; }};
    const auto of_lanes = [](Lanes x) {{ return x; }};
    const auto of_mask = [](Mask x) {{ return x; }};
"""
    # vectors pass through memory in name only: LLVM promotes them to registers
    convert = "{{ {0} r; __builtin_memcpy(&r, &x, sizeof(r)); return r; }}"
    lanes, mask = f"wp::vec_t<{width}, {_CPP[dtype]}>", f"wp::vec_t<{width}, wp::{_MASK[dtype].__name__}>"
    return f"""
    typedef {_CPP[dtype]} Lanes __attribute__((ext_vector_type({width})));
    typedef {_MASK_CPP[dtype]} Mask __attribute__((ext_vector_type({width})));
    typedef bool Bits __attribute__((ext_vector_type({width})));
    const auto lanes = [](const {lanes}& x) {convert.format("Lanes")};
    const auto mask = [](const {mask}& x) {convert.format("Mask")};
    const auto of_lanes = [](const Lanes& x) {convert.format(lanes)};
    const auto of_mask = [](const Mask& x) {convert.format(mask)};
"""


def fingerprint() -> str:
    """Digits that change with this file, for the names of modules whose functions use the operators.

    Warp compiles a module anew when a function changes that it finds by name in the source; it does not look for
    operators there.
    """
    return f"{zlib.crc32(inspect.getsource(sys.modules[__name__]).encode()):08x}"


# Warp aligns vectors to their numbers: a load or store of 64 bytes then often touches two lines of the cache. In the
# modules that are built so no array is made of such vectors, and no kernel takes one from the host.
_ALIGNED = """
template <> struct alignas(sizeof({1}) * {0} < 64 ? sizeof({1}) * {0} : 64) wp::vec_t<{0}, {1}> {{
    {1} c[{0}];
    vec_t() : c() {{}}
    vec_t({1} s) {{ for (auto& x : c) x = s; }}
    vec_t(const wp::initializer_array<{0}, {1}>& l) {{ for (int i = 0; i < {0}; ++i) c[i] = l[i]; }}
    {1} operator[](int i) const {{ return c[i]; }}
    {1}& operator[](int i) {{ return c[i]; }}
}};
"""
_NUMBERS = {wp.float64: ("double", "long long"), wp.float32: ("float", "int", "double", "long long")}

head = header(real, width)
aligned = "".join(_ALIGNED.format(width, number) for number in _NUMBERS[real]) if width > 1 else ""
build_options = wp.ModuleBuildOptions(extra_cpu_preamble=aligned)
is_vector = width > 1
Lanes: Any = wp.types.vector(length=width, dtype=real) if is_vector else real
Mask: Any = wp.types.vector(length=width, dtype=_MASK[real]) if is_vector else wp.bool

if is_vector:

    @wp.struct
    class Vec3:
        """A vector in each lane."""

        x: Lanes
        y: Lanes
        z: Lanes

    @wp.func
    def vec(x: Lanes, y: Lanes, z: Lanes) -> Vec3:
        """A vector of its components."""
        r = Vec3()
        r.x = x
        r.y = y
        r.z = z
        return r

else:
    Vec3 = wp.types.vector(length=3, dtype=real)

    @wp.func
    def vec(x: Lanes, y: Lanes, z: Lanes) -> Vec3:
        """A vector of its components."""
        return Vec3(x, y, z)


@wp.func_native(head + "    return of_lanes(lanes(a) + lanes(b));\n")
def add(a: Lanes, b: Lanes) -> Lanes: ...


@wp.func_native(head + "    return of_lanes(lanes(a) - lanes(b));\n")
def sub(a: Lanes, b: Lanes) -> Lanes: ...


@wp.func_native(head + "    return of_lanes(lanes(a) * lanes(b));\n")
def mul(a: Lanes, b: Lanes) -> Lanes: ...


if is_vector:

    @wp.func_native(head + "    return of_lanes(__builtin_elementwise_sqrt(lanes(a)));\n")
    def square_root(a: Lanes) -> Lanes:
        """√a, correctly rounded."""
        ...

else:

    @wp.func
    def square_root(a: Lanes) -> Lanes:
        """√a, correctly rounded."""
        return wp.sqrt(a)


@wp.func_native(head + "    return of_lanes(lanes(a) / lanes(b));\n")
def div(a: Lanes, b: Lanes) -> Lanes: ...


@wp.func_native(head + "    return of_lanes((Lanes)a);\n")
def spread(a: real) -> Lanes:
    """A number in every lane."""
    ...


@wp.func_native(head + "    return of_lanes(-lanes(a));\n")
def minus(a: Lanes) -> Lanes:
    """-a."""
    ...


@wp.func_native(head + f"    return of_lanes({'__builtin_elementwise_abs' if is_vector else 'fabs'}(lanes(a)));\n")
def magnitude(a: Lanes) -> Lanes:
    """|a|."""
    ...


@wp.func_native(head + "    const Lanes x = lanes(a), y = lanes(b);\n    return of_lanes(x < y ? x : y);\n")
def least(a: Lanes, b: Lanes) -> Lanes:
    """The lesser of two; b where one is NaN."""
    ...


@wp.func_native(head + "    const Lanes x = lanes(a), y = lanes(b);\n    return of_lanes(x > y ? x : y);\n")
def greatest(a: Lanes, b: Lanes) -> Lanes:
    """The greater of two; b where one is NaN."""
    ...


@wp.func_native(head + "    return of_mask((Mask)(lanes(a) < lanes(b)));\n")
def is_less(a: Lanes, b: Lanes) -> Mask:
    """a < b."""
    ...


@wp.func_native(head + "    return of_mask((Mask)(lanes(a) <= lanes(b)));\n")
def is_at_most(a: Lanes, b: Lanes) -> Mask:
    """a <= b."""
    ...


@wp.func_native(head + "    return of_mask(mask(m) & mask(n));\n")
def bit_and(m: Mask, n: Mask) -> Mask: ...


@wp.func_native(head + "    return of_mask(mask(m) | mask(n));\n")
def bit_or(m: Mask, n: Mask) -> Mask: ...


@wp.func_native(head + f"    return of_mask({'~' if is_vector else '!'}mask(m));\n")
def opposite(m: Mask) -> Mask:
    """The lanes that are not set; Warp has no name of its own for ~."""
    ...


@wp.func_native(head + "    return of_lanes(mask(m) ? lanes(a) : lanes(b));\n")
def select(m: Mask, a: Lanes, b: Lanes) -> Lanes:
    """a where the mask is set, b elsewhere."""
    ...


# ---- A plain number beside lanes ----

if is_vector:

    @wp.func_native(head + "    return of_lanes(lanes(a) + (Lanes)b);\n")
    def add(a: Lanes, b: real) -> Lanes: ...

    @wp.func_native(head + "    return of_lanes((Lanes)a - lanes(b));\n")
    def sub(a: real, b: Lanes) -> Lanes: ...

    @wp.func_native(head + "    return of_lanes((Lanes)a * lanes(b));\n")
    def mul(a: real, b: Lanes) -> Lanes: ...

    @wp.func_native(head + "    return of_lanes((Lanes)a / lanes(b));\n")
    def div(a: real, b: Lanes) -> Lanes: ...

    @wp.func
    def add(a: real, b: Lanes) -> Lanes:
        return add(b, a)

    @wp.func
    def mul(a: Lanes, b: real) -> Lanes:
        return mul(b, a)

    @wp.func
    def least(a: Lanes, b: real) -> Lanes:
        """The lesser of two; b where one is NaN."""
        return least(a, spread(b))

    @wp.func
    def least(a: real, b: Lanes) -> Lanes:
        """The lesser of two; b where one is NaN."""
        return least(spread(a), b)

    @wp.func
    def greatest(a: Lanes, b: real) -> Lanes:
        """The greater of two; b where one is NaN."""
        return greatest(a, spread(b))

    @wp.func
    def is_less(a: Lanes, b: real) -> Mask:
        """a < b."""
        return is_less(a, spread(b))

    @wp.func
    def is_less(a: real, b: Lanes) -> Mask:
        """a < b."""
        return is_less(spread(a), b)

    @wp.func
    def is_at_most(a: Lanes, b: real) -> Mask:
        """a <= b."""
        return is_at_most(a, spread(b))

    @wp.func
    def is_at_most(a: real, b: Lanes) -> Mask:
        """a <= b."""
        return is_at_most(spread(a), b)

    @wp.func
    def select(m: Mask, a: real, b: Lanes) -> Lanes:
        """a where the mask is set, b elsewhere."""
        return select(m, spread(a), b)

    @wp.func
    def select(m: Mask, a: Lanes, b: real) -> Lanes:
        """a where the mask is set, b elsewhere."""
        return select(m, a, spread(b))


if is_vector:
    to_bits = f"""
    const Bits set = __builtin_convertvector(mask(m), Bits);
    wp::uint32 bits = 0;
    __builtin_memcpy(&bits, &set, sizeof(set));
    return bits & {(1 << width) - 1}u;
"""
    from_bits = f"""
    Mask r;
    for (int k = 0; k < {width}; ++k)
        r[k] = (bits >> k) & 1u ? -1 : 0;
    return of_mask(r);
"""

    @wp.func_native(head + to_bits)
    def bits_of(m: Mask) -> wp.uint32:
        """The lanes whose mask is set, as bits."""
        ...

    @wp.func
    def lane_of(a: Lanes, lane: int) -> real:
        """The number in a lane."""
        return a[lane]

    @wp.func_native(head + from_bits)
    def mask_of(bits: wp.uint32) -> Mask:
        """The mask of the lanes whose bits are set."""
        ...
else:

    @wp.func
    def bits_of(m: Mask) -> wp.uint32:
        """The lanes whose mask is set, as bits."""
        return wp.where(m, wp.uint32(1), wp.uint32(0))

    @wp.func
    def lane_of(a: Lanes, lane: int) -> real:
        """The number in a lane."""
        return a

    @wp.func
    def mask_of(bits: wp.uint32) -> Mask:
        """The mask of the lanes whose bits are set."""
        return bits != wp.uint32(0)


@wp.func
def add(a: Vec3, b: Vec3) -> Vec3:
    return vec(add(a.x, b.x), add(a.y, b.y), add(a.z, b.z))


@wp.func
def sub(a: Vec3, b: Vec3) -> Vec3:
    return vec(sub(a.x, b.x), sub(a.y, b.y), sub(a.z, b.z))


@wp.func
def mul(a: Lanes, b: Vec3) -> Vec3:
    return vec(mul(a, b.x), mul(a, b.y), mul(a, b.z))


if is_vector:

    @wp.func
    def mul(a: real, b: Vec3) -> Vec3:
        return mul(spread(a), b)


@wp.func
def scaled(a: Vec3, b: Vec3) -> Vec3:
    """The products of the components."""
    return vec(mul(a.x, b.x), mul(a.y, b.y), mul(a.z, b.z))


@wp.func
def minus(a: Vec3) -> Vec3:
    """-a."""
    return vec(minus(a.x), minus(a.y), minus(a.z))


@wp.func
def magnitude(a: Vec3) -> Vec3:
    """|a_k|."""
    return vec(magnitude(a.x), magnitude(a.y), magnitude(a.z))


@wp.func
def greatest(a: Vec3, b: Vec3) -> Vec3:
    """The greater of each two components."""
    return vec(greatest(a.x, b.x), greatest(a.y, b.y), greatest(a.z, b.z))


@wp.func
def greatest_of(a: Vec3) -> Lanes:
    """The greatest component."""
    return greatest(a.x, greatest(a.y, a.z))


@wp.func
def least(a: Vec3, b: Vec3) -> Vec3:
    """The lesser of each two components."""
    return vec(least(a.x, b.x), least(a.y, b.y), least(a.z, b.z))


@wp.func
def select(m: Mask, a: Vec3, b: Vec3) -> Vec3:
    """a where the mask is set, b elsewhere."""
    return vec(select(m, a.x, b.x), select(m, a.y, b.y), select(m, a.z, b.z))


@wp.func
def dot(a: Vec3, b: Vec3) -> Lanes:
    """a·b."""
    return add(add(mul(a.x, b.x), mul(a.y, b.y)), mul(a.z, b.z))


@wp.func
def cross(a: Vec3, b: Vec3) -> Vec3:
    """a×b."""
    x = sub(mul(a.y, b.z), mul(a.z, b.y))
    y = sub(mul(a.z, b.x), mul(a.x, b.z))
    return vec(x, y, sub(mul(a.x, b.y), mul(a.y, b.x)))


@wp.func
def is_within(a: Vec3, size: Vec3) -> Mask:
    """Whether a lies in [-size, size]."""
    x = is_at_most(magnitude(a.x), size.x)
    y = is_at_most(magnitude(a.y), size.y)
    return bit_and(bit_and(x, y), is_at_most(magnitude(a.z), size.z))


operators = {"add": add, "sub": sub, "mul": mul, "div": div, "bit_and": bit_and, "bit_or": bit_or}


def func(f: Callable, inline: bool | None = None) -> Any:
    """`wp.func` for a function that uses the operators on lanes."""
    seen = types.FunctionType(f.__code__, {**f.__globals__, **operators}, f.__name__, None, f.__closure__)
    seen.__annotations__ = f.__annotations__
    seen.__doc__, seen.__module__, seen.__qualname__ = f.__doc__, f.__module__, f.__qualname__
    return wp.func(seen, inline=inline)


def rare(f: Callable) -> Any:
    """`func` for a function that is seldom called, and therefore kept out of line."""
    return func(f, inline=False)
