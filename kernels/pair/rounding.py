"""The rounding analysis of the narrow phase: every constant of every bound is derived here and nowhere else.

Notation. u = 2^-53 (float64) or 2^-24 (float32) is the unit roundoff of the arithmetic, fl(·) a rounded operation,
fl(x∘y) = (x∘y)(1+δ), |δ| ≤ u, plus an absolute error of half the smallest subnormal where a product underflows. An fma
rounds once where the analysis counts twice, so every bound holds with and without contraction. V_i is the exact corner
of a pair at one end of the step (a difference of two input points), W a corner of a sub-patch, k an axis. All lengths
below are in the normalised units of step 2.

1. **Differences.** x and y are the float64 numbers of the input, so they are exact. fl(x - y) = (x - y)(1 + δ) in
   float64; no underflow error (a difference that is subnormal is exact). If it overflows, the axis is scaled by 1/1024
   first: exact up to 2^-1074, negligible beside the 2^1020 or more that overflowed.
2. **Normalisation.** Axis k is multiplied by a power of two s_k with s_k·max|V_k| ≤ 1: exact except for underflow,
   which is part of the absolute term of step 5. In float32 the product is then rounded to float32: one more (1 + δ)
   with u = 2^-24, beside which the 2^-53 of step 1 is covered by the slack of step 4. So
   |V̂_k - V_k| ≤ 1.001·u·|V̂_k|.
3. **Corners of a sub-patch.** W = (1-u)·x + u·y, with x, y = (1-v)·V_a + v·V_b for u, v on a dyadic grid whose
   1-u, 1-v are exact (MAX_SPLITS below). Each of the two levels rounds two products and one sum; weights sum to one:
   |Ŵ_k - W_k| ≤ (1 + 2·2)·1.001·u·M_k, M_k = max|V̂_k| over all corners and both ends of the step.
   The root patch is V̂ itself and has only the error of step 2.
4. **Projection.** a = fl(d·Ŵ): three products, two sums, any order, with or without fma:
   |a - d·Ŵ| ≤ 3·1.001·u·Σ|d_k|·M_k for any vector d of floating-point numbers (d itself approximates nothing, so
   it carries no error). With steps 2 and 3, |a - d·W| ≤ Σ|d_k|·E_k with
   E_k = (1 + 3)·u·M_k → PROJECTION_ROOT = 4.25 u for the root and (5 + 3)·u·M_k → PROJECTION_PATCH = 8.25 u else;
   the quarter covers the factors 1.001 and the roundings of E_k itself.
5. **Underflow.** After normalisation corners are at most 1, sides 2, directions 16 (a side crossed with what one of a
   largest component of one and a side make), so underflows add at most a few hundred halves of a smallest subnormal.
   E_k gets the absolute term TINY, and a direction whose largest component is below TINY_DIRECTION is never used: then
   Σ|d_k|·TINY ≥ TINY·TINY_DIRECTION exceeds all of them together.
6. **Offset.** off = fl(Σ|d_k|·(E_k + separation_k)) is computed with at most five roundings; it is multiplied by
   (1 + 8u), so it is an upper bound of the exact sum.
7. **Time.** d·W(t) is linear in t for fixed (u, v), so d·W(t) ≥ (1-t)·a + t·b - Σ|d_k|·E_k for computed a (t = 0) and
   b (t = 1). It exceeds Σ|d_k|·separation_k, that is, no point of the patch is in contact, while
   (1-t)·a + t·b > off. For a > off ≥ b that holds up to (a-off)/(a-b): two differences and a quotient, three roundings,
   so the quotient times (1 - 8u) is a lower bound (the product's own rounding included). For b > off ≥ a it holds from
   (off-a)/(b-a) times (1 + 8u) on.
8. **Corners at a time.** W(t) is evaluated as (1-t)·W(0) + t·W(1) with 1-t rounded: the weights carry u each, the
   products and the sum u each, on top of step 3: |Ŵ_k(t) - W_k(t)| ≤ (5 + 3)·1.001·u·M_k.
9. **Volume.** b are the Bernstein coefficients of f = P·(Q×R), P a corner, Q and R edges: each a single difference of
   input points, (1 + δ) each, three in a product. With p, q, r the largest magnitudes per axis and T the permanent of
   (p, q, r), the sum of the magnitudes of the six products: inputs 3u, a cross product 2u, the mean of two of them u, a
   dot product 3u, the combination to a coefficient 4u (1/3 is rounded): 13u·T, since the weights sum to one.
   Restriction to [t, x] is three levels of interpolation at 3u each: 9u·T. VOLUME = 25 covers both, the products of
   errors, and the roundings of T. Of float32 the coefficients are those of float64, rounded: with B the largest of them
   in magnitude u·B, and 9u·B by restriction. B is small beside T where corners come near the origin. RESTRICTION = 12
   covers both and their products, and VOLUME times the unit roundoff of float64 T, as that is computed. A clip ends
   where the steepest line from the first control point, c_0, to another falls to zero: at the fraction c_0 / max_j (c_0
   - c_j)·3/j of the interval, which is no later than the first crossing of the hull. Each control point is rounded once
   after the bounds above, when they are subtracted, and with a separation once more before that, so VOLUME covers 13 +
   9 + 1 and RESTRICTION 1 + 9 + 1. Where c_j decides and is positive, it is at most 2/3 c_0, so the difference loses 5u
   by that, and 2u by itself and its factor; c_0 and the quotient 2u; the interval, its share and the factor below 3u:
   that fraction times (1 - 12u), and the sum with t times (1 - 8u), is a lower bound. With a separation the Bernstein
   coefficients of Q×R enter in magnitude, each within 15u of the sum of the magnitudes of its products. Those on [0, 1]
   are within 6u; a cubic above the support that is made of them and restricted with f is off by 9u more, 15u as well.
   What rounding takes of the supports themselves (`support_above`) is within the factor 1 + 8u that they have and the
   one by which the separation is enlarged: they have no slack of their own.
10. **Moving facets.** On [t, x] the direction is the linear interpolation of two given vectors d_t, d_x (which again
   approximate nothing). The Bernstein coefficients d_t·W(t), (d_t·W(x) + d_x·W(t))/2, d_x·W(x) carry the error of step
   8, a dot product, and one more sum: (5 + 3 + 3 + 1)·u·M_k per unit of direction, at most MOVING = 2 times the E_k of
   step 4, for the root as for a sub-patch. A direction may vanish at x, so the offsets get TINY·TINY_DIRECTION, the
   absolute term of step 5. |d_k| is convex in t, so the offsets of both ends interpolate to an upper bound of the
   offset between them. A clip ends as in step 9, at h_0 / max_j (h_0 - h_j)·2/j.
11. **Sides in the cull.** A corner is a rounded difference of input points (1u), a projection adds three roundings,
   the interpolation to an end before 1 three more (step 8, without its sub-patch), and the bound itself four: SIDES =
   16 times the sum of |d_k|·(largest corner on the axis). Underflow of a product is below 2^-1074 per term; the test
   adds 2^-1060. Where a product overflows so does that sum, and nothing is proved.
12. **End of a shorter step.** (1-t)·a + t·b with 1-t rounded: three roundings of the first term, two of the second, and
   the sum: at most 3.1u·max(|a|, |b|); INTERPOLATION = 8 covers the roundings of the bound and of adding it. A product
   that underflows is off by 2^-1074 at most; the box gets 2^-1070.
13. **Euclidean distances.** All axes are scaled by the same power of two s, that of the largest axis, so the ball of
   the distance D stays a ball. Steps 1 to 12 hold as they are: the bounds stay per axis, since a corner on a short axis
   is a small number with the same relative error. The separation is σ = fl(D·s·(1 + SLACK·u)): after its rounding to
   the precision of the iteration and that of the product it is above D·s·(1 + 13u). Cut at 2^60, it is beyond any
   corner; what it loses by underflow is covered by the absolute term of step 5. A length is fl(√(d·d + w)) with w =
   SQUARE_UNDERFLOW, more than the squares lose by underflow: products and sums 4u under the root, which halves them,
   and the root u, at most 3.1u, with the product by σ 4.1u. So σ·|d| as computed is at least D·s·|d|·(1 + 8u), and
   takes the place of Σ|d_k|·separation_k in steps 6, 9 and 10. A norm is convex, so the norms of the Bernstein
   coefficients of a vector are the coefficients of a polynomial above its norm, |n(t)| ≤ Σ B_i(t)·|n_i|, for the normal
   of step 9 as for the direction of step 10. A box of the bisection is discarded where the squared distance of its
   nearest point, each coordinate less twice the bound of step 4, is above σ² + SQUARE_UNDERFLOW: the differences,
   squares and sums lose 5u, and the slack of σ² is 26u. In the cull the length of the normal at any time is at most the
   greatest of those of its Bernstein coefficients, computed from products within 6u of the sums of their magnitudes:
   NORMAL = 16 times the sum of those sums, times the distance, is added.
14. **Thickness.** The distance of a pair is the minimum distance and two radii, D = D_0 + (r_a + r_b), each sum rounded
   up: with s = fl(a + b) and c = s - a the error of s is exactly (a - (s - c)) + (b - c), and where it is positive, s
   becomes the next number above. So D is never below what is asked for, and exact where it can be, for lanes as for
   single pairs. A sum beyond the largest number is infinite and cut as in step 13, beyond every corner. A box grows by
   half the minimum distance and then by its radius, rounded outward each time.
15. **Distance at one time.** The pair is scaled by one power of two, as in step 13. For the difference vector d that
   was found, whatever it is worth, every corner has d·W ≥ a - Σ|d_k|·E_k, a the least computed projection and E_k that
   of step 4 for the root; the patch is the hull of its corners, so (a - Σ|d_k|·E_k)/|d| bounds its distance from below.
   d has its largest component in [1/2, 1), so √(d·d) is within 3.1u; with the difference, the quotient and their
   product that is less than 8u, by which the quotient is lowered. The reciprocal of a power of two is exact, and the
   product with it but for a result below 2^-1022, from which 2^-1070 is subtracted. The distance that is reported is
   |d|. d is a point of the patch: its weights are computed, and its products and sums round by at most 4u·M_k on each
   axis, of which those along the feature are taken out again; and no other point is nearer by more, since a foot off by
   a rounding of M moves the distance by less. A weight is a product with the reciprocal of the square of a side, which
   its uses share: two roundings in place of the one of a quotient move d along the side alone, by u of its length, and
   what is taken out again is a few u, of which that is u². Where the reciprocal of a square is infinite, so is a
   product with it, or NaN: the weight of such a side, shorter than 2^-511, is 0 or 1, either of which is right, and a
   foot on it is not inside. A direction is d times the reciprocal of its length, a rounding more on each axis.
16. **Bounds of displacements.** A pair that is at least L apart is to stay farther apart than m. A vertex that moves by
   less than b moves every point of a primitive by less than the largest b of its vertices, so two sides with b ≤
   (L-m)/2 each, or one with b ≤ L-m beside a static one, leave more than m. m is rounded up and L down; L - m rounds
   once, and the factor 1 - 8u covers it and itself. The half is exact but for a result that is subnormal, from which
   2^-1070 is subtracted, as from half of the search radius (`largest_bound`).
17. **Points on arcs** (`arcs`). Let M be the largest coordinate of the points at both ends of the slice, D that of
   their motions b - a, and turns at most 1/3. f1 is a difference of two series below |ω|²/6, each within 9u of itself,
   so it is off by less than 3u·|ω|², and below |ω|²/15; f2 is below 1/8 and off by less than 2.2u, and ω×V by 2u of
   |ω||V|. So their part of a coordinate is off by less than 3.8u·|ω||V|, and vanishes with ω, whatever V is. The
   straight part rounds a difference, a product and a sum, 3u·D with the bend, and the last sum u·M. The amplitude A of
   both primitives, on the axis on which it is largest, is at least two thirds of the sum of both |ω||V|, as the lengths
   of ω across three axes are 2|ω| together or more. So the two points of a corner are off by less than 2u·M + 6u·D +
   6u·A, at either end of a chord and so between them; the separation grows by ARC_POINTS = 4 of M and ARC_MOTION = 12
   of D + A, which covers √3 times as much, of all three axes of a ball, the sums of the bound and the products of
   errors. At both ends of the slice the points are those that were placed. What V and ω are off by themselves is part
   of the slack (step 18), since both factors are below 1. The amplitude is made of two roots of sums, a product and a
   sum, the sagitta of three products more, 10u; V grows by the slack of step 18, which is far below u times the slack
   itself: SAGITTA = 32. A square that underflows is below SQUARE_UNDERFLOW, which is added under the root; one of ω
   matters for turns alone whose sagitta is less than u² of the velocity. A time in a slice is that of the step less the
   begin of the slice, over its length, and is rounded down by 8u, and a time of the step by 4u, for the length of the
   slice, a product, a sum and this factor: exactly enough, as (1 + u)^4·(1 - 4u) < 1. In the frame of a body
   (`corotating`) the difference of two points is turned: products with factors below 1, cross products and sums, at
   most 12u of it in length: FRAME = 24 times the length of the difference is added to the sagitta. A corner at the end,
   q(begin) + turned(x(end) - q(end)) - p(begin), is made of three points of the second body, and of five roundings, at
   most 5√3·u·M in length: the slacks are added twice more, which are above 24u·M each. A gap beyond the separation of
   chords gets twice what was added to that: it was not asked for, and arcs may bend away.
18. **Bodies on arcs** (`kernels.rigid.place_bodies`). A vertex is at p + v·t + σ1·V + σ2·ω×V + Rot(tω)·R·(X - c), t the
   begin or the end of a slice. Four sums round by u·P each, with P the largest coordinate of p and p + v, and what
   `BodyPaths` states for p is 2u·P; on all axes 6·√3 u·P, and 8·√3 u·P with v of a linear path, which is off by 4u·(2P)
   at most: 24.25 u·P, of which PLACE_POSITION = 24 leaves a quarter to the 40u·|v| of PLACE. Of a screw v is off by
   16u·(|v| + T), T the length of u, as it has the direction of ω, and what u leads to by as much. The product with R
   and with Rot(tω), of quaternions within 10u of unit ones, rounds by 32u·|X - c| at most; the angle tθ, and what it
   was computed from, is off by 12u·tθ, which moves a vertex by that times its distance from the axis. With ρ the sum of
   |X - c|, |c| and the largest coordinate of X, and PLACE = 40 that is PLACE·u·(1 + |ω|/2)(ρ + T + |v|), which covers
   the difference X - c, what `BodyPaths` states for the pivot and for screws, and the products of errors. A vertex that
   does not turn has the error of step 12 on three axes. The products of a vertex, some thirty of them here and in step
   17, lose 2^-1075 each at most where they underflow: the slack gets 2^-1068.
19. **Off a chord by a parabola** (`arc_rounds`). At a share s of a window both points of a corner together are off
    their chords by at most s(1 - s)/2·h²·|x''| = 4s(1 - s)·σ, σ the sagitta of step 17, along any axis; in normalised
    units σ is raised by SLACK·u, which covers its rounding to the precision of the iteration. The volume: the product
    of 4s(1 - s) and Σ B_i(s)·n_i, n_i the supports of σ along the Bernstein coefficients of Q×R, has those of degree
    four (0, n_0, 4/3 n_1, n_2, 0), and the cubic of (0, 4/3 max(n_0, n_1), 4/3 max(n_1, n_2), 0), raised to degree
    four, is above it. It is added to the cubic of the separation in step 9, one rounding more, and 2σ is to the
    separation in the bound there. A direction: with a and b the projections at both ends, a for the one at which the
    corner is beyond the offset (else time runs backward), x = a - off, y = b - off and c = 4·support(σ), rounded up,
    the corner is beyond while x - p·s + c·s² > 0, p = x - y + c. That falls as p grows: x and y are off by u of
    themselves and p by two roundings, so p gets RELATIVE·u·(|x| + |y| + c). It is beyond up to 2x/(p + √(p² - 4xc)),
    which falls as p and the root grow: under it p² and the difference lose 2u·p², and 4xc, with the u of x, is lowered
    by RELATIVE·u, so 2·RELATIVE·u·p² is added, and without a root where the difference is as far below zero. Where c is
    0 the root is p itself. Products that underflow lose less than SQUARE_UNDERFLOW, added as well. x, the root, sum and
    quotient lose 4u: times (1 - 8u), as the difference of it from one, for time that ran backward, times (1 + 8u).

**How each step is held.** *Counted*: its functions are executed, from their files, on numbers that count their
roundings (`tests/kernels/pair/test_counted.py`), at inputs in which each term outweighs the others somewhere; what
comes out is so much of what the constant allows, in units of u, to the first order, and the formulas are compared with
the definitions on the way. Where a step is held *by hand*, its text is all there is, and *by attack* inputs are
searched that make the error large (`tests/kernels/pair/test_attacks.py`).

| step | held | of what is allowed |
|---|---|---|
| 1 | counted | difference 1 of 1 |
| 2 | counted | corner 1 of 1 |
| 3 | counted | corner 5 of 5 |
| 4 | counted | root 4 of 4.25; patch 8 of 8.25 |
| 5 | by hand | |
| 6 | counted | direction 5 of 8; facet 5 of 8; ball 6 of 8 |
| 7 | counted | entered 4 of 8; left 4 of 8 |
| 8 | counted | root 4 of 4; patch 8 of 8 |
| 9 | counted | crossing 14 of 20; volume 20.33 of 25; volume of a separation 21.33 of 25 |
| 9 | counted | restriction 10 of 12; restriction of a separation 11 of 12 |
| 10 | counted | crossing 11 of 20; root 8 of 8.5; patch 12 of 16.5 |
| 11 | counted | sides 7 of 16; volume 17 of 26 |
| 12 | counted | lower 4 of 8; upper 4 of 8 |
| 13 | counted | separation 2 of 3; length 3 of 4; support 6 of 8; cull 4.92 of 16 |
| 14 | by drawn sums in rational arithmetic (`tests/calls/test_thickness.py`) | |
| 15 | counted | projection 4 of 4.25; quotient 6.5 of 8 |
| 16 | counted | shared 4 of 8; alone 3 of 8 |
| 17 | by hand and by attack; times in a slice by hand | |
| 18 | by hand and by attack, sine and cosine by intervals | |
| 19 | by hand | |

Constants are in units of u.
"""

import warp as wp

PROJECTION_ROOT = 4.25
PROJECTION_PATCH = 8.25
MOVING = 2.0
VOLUME = 25.0
RESTRICTION = 12.0
RELATIVE = 8.0
CROSSING = 12.0
SIDES = 16.0
INTERPOLATION = 8.0
SLACK = 16.0
NORMAL = 16.0
ARC_POINTS = 4.0
ARC_MOTION = 12.0
SAGITTA = 32.0
FRAME = 24.0
PLACE_POSITION = 24.0
PLACE = 40.0

# Splits of one parameter, so that u, v, 1-u, 1-v and the midpoints are exact floating-point numbers.
MAX_SPLITS = {wp.float64: 50, wp.float32: 21}
UNIT_ROUNDOFF = {wp.float64: 2.0**-53, wp.float32: 2.0**-24}
# Largest sum of magnitudes that counts as finite; beyond it an axis is scaled down before differences are formed.
LARGEST = wp.constant(wp.float64(2.0**1020))
TINY = {wp.float64: 2.0**-900, wp.float32: 2.0**-90}
# The eighth of a sagitta, h²/8·|x''|, rounded up.
EIGHTH_UP = 0.125 * (1.0 + SAGITTA * UNIT_ROUNDOFF[wp.float64])
# A start distance on an arc is less by this multiple of the error of its points, within which nothing could be proved.
START_DISTANCE_ERRORS = 4.0
SQUARE_UNDERFLOW = {wp.float64: 2.0**-1000, wp.float32: 2.0**-120}
TINY_DIRECTION = {wp.float64: 2.0**-150, wp.float32: 2.0**-50}

_EXPONENT_MASK = wp.constant(wp.int64(0x7FF))
_MANTISSA_BITS = wp.constant(wp.int64(52))
_MIRRORED_EXPONENT = wp.constant(wp.int64(2045))


@wp.func
def inverse_power_of_two(x: wp.float64) -> wp.float64:
    """Power of two s with 1/2 <= s·x < 1 for normal x below 2^1022 (s·x < 4 for every finite x); exact, x >= 0."""
    exponent = (wp.cast(x, wp.int64) >> _MANTISSA_BITS) & _EXPONENT_MASK
    # biased exponent e means x < 2^(e-1022), so s = 2^(1022-e) has biased exponent 2045 - e
    mirrored = wp.clamp(_MIRRORED_EXPONENT - exponent, wp.int64(1), _MIRRORED_EXPONENT)
    return wp.cast(mirrored << _MANTISSA_BITS, wp.float64)
