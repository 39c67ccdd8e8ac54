"""Operations on sixteen lanes at once, in C++: with `pair_lanes`, the only code that depends on the processor.

Most functions have two versions: a scalar one, which CUDA uses and which serves as the definition, and one in Clang's
portable vector extension, which Clang lowers to the instructions of the processor. The overlap tests have a third for
AVX-512, because Clang by itself uses only half of those registers, which costs 15 % of a search, and so has what
collects candidates, for an instruction that packs the numbers of some lanes, which saves a tenth.
`tests/kernels/boxes/test_lanes.py` compiles every version that the processor can run and compares it with NumPy.

A block is laid out as in `box_tree`: six rows of sixteen numbers for each AABB, three rows of sixteen vertices.
"""

import warp as wp

_SCALAR = "defined(__CUDA_ARCH__) || !defined(__clang__)"
_AVX512 = "defined(__AVX512F__) && __has_builtin(__builtin_ia32_cmpps512_mask)"

_LANES = """
    typedef float Lanes __attribute__((ext_vector_type(16), aligned(4)));
    typedef int Mask __attribute__((ext_vector_type(16)));
    typedef bool Bits __attribute__((ext_vector_type(16)));
    const auto bits = [](Mask m) {
        const Bits set = __builtin_convertvector(m, Bits);
        unsigned short mask;
        __builtin_memcpy(&mask, &set, 2);
        return (unsigned)mask;
    };
"""
# Comparison codes of Intel's manual, whether signalling on NaN or not: <= (2), >= (13), < (1), > (14), not <= (6), not
# >= (9).
_COMPARE = """
    typedef float Lanes __attribute__((vector_size(64)));
    typedef float Row __attribute__((vector_size(64), aligned(4)));
    const auto row = [](const float* x) { return (Lanes)*(const Row*)x; };
    const auto all = [](float x) { return (Lanes){x, x, x, x, x, x, x, x, x, x, x, x, x, x, x, x}; };
#define CCD_AMONG(lanes, a, b, how) \\
    (unsigned)__builtin_ia32_cmpps512_mask(row(a), all(b), how, (unsigned short)(lanes), 4)
#define CCD_COMPARE(a, b, how) CCD_AMONG(0xFFFF, a, b, how)
"""

OVERLAP = {
    "scalar": """
    const float* b = nodes.data + (long long)block * 96;
    const float* q = query_nodes.data + (long long)query_block * 96 + query_lane;
    const float lx = q[0], ly = q[16], lz = q[32], ux = q[48], uy = q[64], uz = q[80];
    unsigned closed = 0, open = 0;
    for (int k = 0; k < 16; ++k) {
        const float bx = b[k], by = b[16 + k], bz = b[32 + k], cx = b[48 + k], cy = b[64 + k], cz = b[80 + k];
        closed |= (unsigned)(bx <= ux && by <= uy && bz <= uz && cx >= lx && cy >= ly && cz >= lz) << k;
        open |= (unsigned)(bx < ux && by < uy && bz < uz && cx > lx && cy > ly && cz > lz) << k;
    }
    return with_open == 0 ? closed : closed | open << 16;
""",
    "vector": _LANES
    + """
    const Lanes* b = (const Lanes*)(nodes.data + (long long)block * 96);
    const float* q = query_nodes.data + (long long)query_block * 96 + query_lane;
    const Lanes lx = (Lanes)q[0], ly = (Lanes)q[16], lz = (Lanes)q[32];
    const Lanes ux = (Lanes)q[48], uy = (Lanes)q[64], uz = (Lanes)q[80];
    const Mask below = (b[0] <= ux) & (b[1] <= uy) & (b[2] <= uz);
    const unsigned closed = bits(below & (b[3] >= lx) & (b[4] >= ly) & (b[5] >= lz));
    if (with_open == 0 || closed == 0)
        return closed;
    return closed | bits((b[0] < ux) & (b[1] < uy) & (b[2] < uz) & (b[3] > lx) & (b[4] > ly) & (b[5] > lz)) << 16;
""",
    "avx512": _COMPARE
    + """
    const float* b = nodes.data + (long long)block * 96;
    const float* q = query_nodes.data + (long long)query_block * 96 + query_lane;
    unsigned closed = CCD_COMPARE(b, q[48], 2) & CCD_COMPARE(b + 16, q[64], 2) & CCD_COMPARE(b + 32, q[80], 2);
    closed &= CCD_COMPARE(b + 48, q[0], 13) & CCD_COMPARE(b + 64, q[16], 13) & CCD_COMPARE(b + 80, q[32], 13);
    if (with_open == 0 || closed == 0)
        return closed;
    unsigned open = CCD_COMPARE(b, q[48], 1) & CCD_COMPARE(b + 16, q[64], 1) & CCD_COMPARE(b + 32, q[80], 1);
    open &= CCD_COMPARE(b + 48, q[0], 14) & CCD_COMPARE(b + 64, q[16], 14) & CCD_COMPARE(b + 80, q[32], 14);
#undef CCD_COMPARE
#undef CCD_AMONG
    return closed | open << 16;
""",
}

MOVING_OVERLAP = {
    "scalar": """
    const int end = 96 * (num_aabbs - 1);
    const float* b = nodes.data + (long long)block * (end + 96);
    const float* c = b + end;
    const float* q = query_nodes.data + (long long)query_block * (end + 96) + query_lane;
    const float* r = q + end;
    unsigned mask = 0;
    for (int k = 0; k < 16; ++k) {
        bool meet = true;
        for (int n = 0; n < 48; n += 16) {
            meet = meet && (b[n + k] <= q[n + 48] || c[n + k] <= r[n + 48]);
            meet = meet && (b[n + 48 + k] >= q[n] || c[n + 48 + k] >= r[n]);
        }
        mask |= (unsigned)meet << k;
    }
    return mask;
""",
    "vector": _LANES
    + """
    const int end = 96 * (num_aabbs - 1);
    const Lanes* b = (const Lanes*)(nodes.data + (long long)block * (end + 96));
    const Lanes* c = b + end / 16;
    const float* q = query_nodes.data + (long long)query_block * (end + 96) + query_lane;
    const float* r = q + end;
    Mask m = (b[0] <= (Lanes)q[48]) | (c[0] <= (Lanes)r[48]);
    m &= (b[1] <= (Lanes)q[64]) | (c[1] <= (Lanes)r[64]);
    m &= (b[2] <= (Lanes)q[80]) | (c[2] <= (Lanes)r[80]);
    m &= (b[3] >= (Lanes)q[0]) | (c[3] >= (Lanes)r[0]);
    m &= (b[4] >= (Lanes)q[16]) | (c[4] >= (Lanes)r[16]);
    m &= (b[5] >= (Lanes)q[32]) | (c[5] >= (Lanes)r[32]);
    return bits(m);
""",
    "avx512": _COMPARE
    + """
    const int end = 96 * (num_aabbs - 1);
    const float* b = nodes.data + (long long)block * (end + 96);
    const float* c = b + end;
    const float* q = query_nodes.data + (long long)query_block * (end + 96) + query_lane;
    const float* r = q + end;
    // lanes that an axis separates in one order at both ends: a comparison among lanes is an "and" that costs nothing
    const auto after = [&](int n) { return CCD_AMONG(CCD_COMPARE(b + n, q[48 + n], 6), c + n, r[48 + n], 6); };
    const auto before = [&](int n) { return CCD_AMONG(CCD_COMPARE(b + 48 + n, q[n], 9), c + 48 + n, r[n], 9); };
#undef CCD_COMPARE
#undef CCD_AMONG
    return 0xFFFFu & ~(after(0) | after(16) | after(32) | before(0) | before(16) | before(32));
""",
}

# Of a query, the lanes of a block that share a vertex with it.
_SHARED = {
    "scalar": """
    const int* c = corners.data + (long long)block * 48;
    const int* q = query_corners.data + (long long)query_block * 48 + query_lane;
    unsigned mask = 0;
    for (int i = 0; i < num_query_corners; ++i)
        for (int j = 0; j < num_corners; ++j)
            for (int k = 0; k < 16; ++k)
                mask |= (unsigned)(c[16 * j + k] == q[16 * i]) << k;
    return mask;
""",
    "vector": _LANES
    + """
    typedef int Row __attribute__((ext_vector_type(16), aligned(4)));
    const Row* c = (const Row*)(corners.data + (long long)block * 48);
    const int* q = query_corners.data + (long long)query_block * 48 + query_lane;
    const int last = num_query_corners * num_corners - 1;
    const auto pair = [=](int n) { return c[n % num_corners] == (Row)q[16 * (n / num_corners)]; };
    const auto least = [=](int n) { return n < last ? n : last; };
    // four pairs of vertices without a branch, the last one again where there are fewer; at one time there are more
    unsigned mask = bits(pair(0) | pair(least(1)) | pair(least(2)) | pair(least(3)));
    for (int n = 4; n <= last; ++n)
        mask |= bits(pair(n));
    return mask;
""",
}


def _of_queries(overlap: dict[str, str]) -> dict[str, str]:
    """Versions of a loop over queries, from those of the overlap test of one."""
    return {
        name: f"""
    const int with_open = 1;
    const auto overlapping = [&](int query_lane) -> unsigned {{{test}}};
    const auto sharing = [&](int query_lane) -> unsigned {{{_SHARED["scalar" if name == "scalar" else "vector"]}}};
    unsigned masks[16], found = 0;  // with stores to an array in between, the block would be loaded for each query
    for (unsigned left = queries; left != 0; left &= left - 1) {{
        const int lane = __builtin_ctz(left);
        const unsigned after = block == own_block ? 0xFFFEu << lane : 0xFFFFu;
        const unsigned both = overlapping(lane), mask = both & targets & after & ~sharing(lane);
        masks[lane] = mask | (both & 0xFFFF0000u);
        found |= (unsigned)(mask != 0) << lane;
    }}
    for (unsigned left = found; left != 0; left &= left - 1)
        partners.data[begin + __builtin_ctz(left)] = masks[__builtin_ctz(left)];
    return found;
"""
        for name, test in overlap.items()
    }


PARTNERS, MOVING_PARTNERS = _of_queries(OVERLAP), _of_queries(MOVING_OVERLAP)

UNITED_VERTEX_AABBS = {
    "scalar": """
    struct alignas(16) Four { float x[4]; };  // one load of CUDA
    const Four* aabbs = (const Four*)vertex_aabbs.data;
    wp::vec_t<8, wp::float32> r;
    for (int half = 0; half < 2; ++half) {
        const Four a = aabbs[2LL * v0 + half], b = aabbs[2LL * v1 + half], c = aabbs[2LL * v2 + half];
        for (int k = 0; k < 4; ++k) {
            const float ab = a.x[k] < b.x[k] ? a.x[k] : b.x[k];
            r[4 * half + k] = ab < c.x[k] ? ab : c.x[k];
        }
    }
    return r;
""",
    "vector": """
    typedef float Aabb __attribute__((ext_vector_type(8), aligned(4)));
    const Aabb a = *(const Aabb*)(vertex_aabbs.data + 8LL * v0);
    const Aabb b = *(const Aabb*)(vertex_aabbs.data + 8LL * v1);
    const Aabb c = *(const Aabb*)(vertex_aabbs.data + 8LL * v2);
    const Aabb ab = a < b ? a : b;
    wp::vec_t<8, wp::float32> r;
    *(Aabb*)&r = ab < c ? ab : c;
    return r;
""",
}

LEAVES = {
    "scalar": """
    const int* c = corners.data + (long long)block * 48;
    for (int f = 0; f < num_aabbs; ++f)
        for (int k = 0; k < 16; ++k) {
            float* p = nodes.data + ((long long)block * num_aabbs + f) * 96 + k;
            for (int m = 0; m < 6; ++m) {
                float r = INFINITY;
                for (int n = 0; n < num_corners && k < count; ++n) {
                    const long long v = c[16 * n + k];
                    const float s = vertex_aabbs.data[8 * (num_aabbs * v + f) + (m < 3 ? m : m + 1)];
                    r = s < r ? s : r;
                }
                p[16 * m] = m < 3 ? r : -r;
            }
        }
""",
    "vector": _LANES
    + """
    typedef float Aabb __attribute__((ext_vector_type(8), aligned(4)));
    const int* c = corners.data + (long long)block * 48;
    const auto aabb = [=](int v) { return (const Aabb*)(vertex_aabbs.data + 8LL * v); };
    const auto least = [](Aabb a, Aabb b) { return b < a ? b : a; };
    if (count > 16)  // there is another block, whose vertices the memory may bring
        for (int k = 0; k < 16 * num_corners; ++k)
            __builtin_prefetch(aabb(num_aabbs * c[48 + k]));
    for (int f = 0; f < num_aabbs; ++f) {
        Aabb rows[12];  // six rows of the first eight boxes, and then of the others
        for (int half = 0; half < 2; ++half) {
            Aabb r[8], s[8], t[8];
            for (int n = 0; n < 8; ++n) {
                const int k = 8 * half + n;
                r[n] = (Aabb)__builtin_inff();
                if (k < count) {
                    r[n] = *aabb(num_aabbs * c[k] + f);
                    if (num_corners > 1)
                        r[n] = least(r[n], *aabb(num_aabbs * c[16 + k] + f));
                    if (num_corners > 2)
                        r[n] = least(r[n], *aabb(num_aabbs * c[32 + k] + f));
                }
            }
            // three rounds, of which each doubles the boxes in a vector
            for (int n = 0; n < 8; n += 2) {
                s[n] = __builtin_shufflevector(r[n], r[n + 1], 0, 8, 1, 9, 4, 12, 5, 13);
                s[n + 1] = __builtin_shufflevector(r[n], r[n + 1], 2, 10, 3, 11, 6, 14, 7, 15);
            }
            for (int n = 0; n < 8; n += 4) {
                t[n] = __builtin_shufflevector(s[n], s[n + 2], 0, 1, 8, 9, 4, 5, 12, 13);
                t[n + 1] = __builtin_shufflevector(s[n], s[n + 2], 2, 3, 10, 11, 6, 7, 14, 15);
                t[n + 2] = __builtin_shufflevector(s[n + 1], s[n + 3], 0, 1, 8, 9, 4, 5, 12, 13);
            }
            for (int m = 0; m < 3; ++m) {
                rows[6 * half + m] = __builtin_shufflevector(t[m], t[m + 4], 0, 1, 2, 3, 8, 9, 10, 11);
                rows[6 * half + m + 3] = -__builtin_shufflevector(t[m], t[m + 4], 4, 5, 6, 7, 12, 13, 14, 15);
            }
        }
        Lanes* p = (Lanes*)(nodes.data + ((long long)block * num_aabbs + f) * 96);
        for (int m = 0; m < 6; ++m)
            p[m] = __builtin_shufflevector(rows[m], rows[m + 6], 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    }
""",
}

UNION = {
    "scalar": """
    const float* b = nodes.data + (long long)block * 96;
    float* p = nodes.data + at;
    for (int k = 0; k < 6; ++k) {
        float m = b[16 * k];
        for (int n = 1; n < 16; ++n) {
            const float x = b[16 * k + n];
            m = (k < 3 ? x < m : x > m) ? x : m;
        }
        p[16 * k] = m;
    }
""",
    "vector": """
    typedef float Lanes __attribute__((ext_vector_type(16), aligned(4)));
    typedef float Half __attribute__((ext_vector_type(8)));
    typedef float Quarter __attribute__((ext_vector_type(4)));
    const Lanes* b = (const Lanes*)(nodes.data + (long long)block * 96);
    float* p = nodes.data + at;
    for (int k = 0; k < 6; ++k) {
        const Lanes row = k < 3 ? b[k] : -b[k];
        const Half h = row.lo < row.hi ? row.lo : row.hi;
        const Quarter q = h.lo < h.hi ? h.lo : h.hi;
        const float x = q[0] < q[1] ? q[0] : q[1], y = q[2] < q[3] ? q[2] : q[3];
        const float m = x < y ? x : y;
        p[16 * k] = k < 3 ? m : -m;
    }
""",
}

vec8f = wp.types.vector(length=8, dtype=wp.float32)


def chosen(versions: dict[str, str]) -> str:
    """The source of a function that selects one of its versions when it is compiled."""
    source = f"#if {_SCALAR}\n{versions['scalar']}"
    if "avx512" in versions:
        source += f"#elif {_AVX512}\n{versions['avx512']}"
    return f"{source}#else\n{versions['vector']}#endif\n"


@wp.func_native(chosen(OVERLAP))
def overlap_mask(
    nodes: wp.array[wp.float32],
    block: int,
    query_nodes: wp.array[wp.float32],
    query_block: int,
    query_lane: int,
    with_open: int,
) -> wp.uint32:
    """Mask of the sixteen boxes of a block that overlap a query box, as closed boxes.

    With ``with_open`` the upper sixteen bits are the mask of those that overlap as open boxes.
    """
    ...


@wp.func_native(chosen(MOVING_OVERLAP))
def moving_overlap_mask(
    nodes: wp.array[wp.float32],
    block: int,
    query_nodes: wp.array[wp.float32],
    query_block: int,
    query_lane: int,
    num_aabbs: int,
) -> wp.uint32:
    """Mask of the sixteen boxes of a block that no axis separates from a query box in the same order at both ends.

    With endpoint AABBs, ``num_aabbs`` 2. A box with a single AABB is that at both ends.
    """
    ...


@wp.func_native(chosen(PARTNERS))
def partner_masks(
    nodes: wp.array[wp.float32],
    corners: wp.array[wp.int32],
    block: int,
    num_corners: int,
    query_nodes: wp.array[wp.float32],
    query_corners: wp.array[wp.int32],
    query_block: int,
    num_query_corners: int,
    queries: wp.uint32,
    targets: wp.uint32,
    own_block: int,
    num_aabbs: int,
    partners: wp.array[wp.int32],
    begin: int,
) -> wp.uint32:
    """Find partners of some queries of a block: those of some targets whose boxes overlap, and that share no vertex.

    All queries at once, as the boxes of the targets then stay in registers, and seven in ten queries have no partner.

    Args:
        nodes: Boxes of the targets.
        corners: Vertices of the targets.
        block: Block of the targets.
        num_corners: Number of vertices of a target.
        query_nodes: Boxes of the queries.
        query_corners: Vertices of the queries.
        query_block: Block of the queries.
        num_query_corners: Number of vertices of a query.
        queries: Lanes of the queries.
        targets: Lanes of the targets.
        own_block: The block in which only those after a query in it are its partners, or -1.
        num_aabbs: AABBs of a box; here one.
        partners: Receives a mask for each query that has partners, at ``begin`` and its lane; its upper sixteen bits
            are the mask of all boxes that overlap its own as open boxes.
        begin: See ``partners``.

    Returns:
        The lanes of queries that have partners.
    """
    ...


@wp.func_native(chosen(MOVING_PARTNERS))
def moving_partner_masks(
    nodes: wp.array[wp.float32],
    corners: wp.array[wp.int32],
    block: int,
    num_corners: int,
    query_nodes: wp.array[wp.float32],
    query_corners: wp.array[wp.int32],
    query_block: int,
    num_query_corners: int,
    queries: wp.uint32,
    targets: wp.uint32,
    own_block: int,
    num_aabbs: int,
    partners: wp.array[wp.int32],
    begin: int,
) -> wp.uint32:
    """Find partners, as `partner_masks` but for the upper bits, by boxes that no axis separates at both ends alike."""
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return __ffs((int)mask) - 1;
#else
    return __builtin_ctz(mask);
#endif
"""
)
def lowest_bit(mask: wp.uint32) -> int:
    """Index of the lowest bit that is set; the mask must not be 0."""
    ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    return __popc(mask);
#else
    return __builtin_popcount(mask);
#endif
"""
)
def number_of_bits(mask: wp.uint32) -> int:
    """Number of bits that are set."""
    ...


@wp.func_native(chosen(UNITED_VERTEX_AABBS))
def united_vertex_aabbs(vertex_aabbs: wp.array[wp.float32], v0: int, v1: int, v2: int) -> vec8f:
    """The union of three vertex AABBs."""
    ...


@wp.func_native(chosen(LEAVES))
def write_leaves(
    vertex_aabbs: wp.array[wp.float32],
    num_aabbs: int,
    corners: wp.array[wp.int32],
    num_corners: int,
    nodes: wp.array[wp.float32],
    block: int,
    count: int,
):
    """Fill a block of level 0 with the boxes of its first ``count`` primitives, and the rest of it with empty boxes.

    The box of a primitive is the union of the AABBs of its vertices.
    """
    ...


@wp.func_native(chosen(UNION))
def write_union(nodes: wp.array[wp.float32], block: int, at: int):
    """Write the union of the sixteen boxes of a block to a place of another block."""
    ...


_EVERY = wp.constant(wp.uint32(0xFFFF))


@wp.func
def lanes_after(lane: int) -> wp.uint32:
    """Mask of the lanes after a lane."""
    return (_EVERY << wp.uint32(lane + 1)) & _EVERY


@wp.func
def lanes_before(count: int) -> wp.uint32:
    """Mask of the first ``count`` lanes, at most all."""
    if count >= 16:
        return _EVERY
    return (wp.uint32(1) << wp.uint32(count)) - wp.uint32(1)


@wp.func
def lanes_between(mask: wp.uint32, first: int, last: int, block: int) -> wp.uint32:
    """Those lanes of a block in a mask whose places are from ``first`` on and before ``last``."""
    result = mask & lanes_before(last - block * 16)
    if first > block * 16:
        result = result & ~lanes_before(first - block * 16)
    return result
