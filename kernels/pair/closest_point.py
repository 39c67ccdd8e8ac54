"""Closest point of a convex patch to the origin: the direction that clips time best, and the parameters reported.

Nothing here carries a guarantee: a direction need only be good, never exact, because `inclusion` tests it at every
corner. The difference vector must keep its direction when the gap is many orders of magnitude smaller than the patch;
therefore it is made orthogonal to its feature a second time, after the cancellation.

`closest_on_patch` computes that vector, once in each step of an advance. Its weights are quotients of products of four
lengths, so on a sliver they lose twice as many digits as the aspect ratio has. `closest_weights` computes the weights
that are reported, once for each pair, and no direction: their point is as close to the origin as the closest point, to
within a few roundings of the size of the patch, whatever its shape.
"""

import warp as wp

from ..parameters import real
from .foot import foot_weights

vec3 = wp.types.vector(length=3, dtype=real)


@wp.func
def closest_on_edge(a: vec3, ab: vec3):
    """Closest point to the origin of the segment a + w·ab, and w."""
    length_squared = wp.dot(ab, ab)
    w = real(0.0)
    if length_squared > real(0.0):
        w = wp.clamp(-wp.dot(a, ab) / length_squared, real(0.0), real(1.0))
    q = a + w * ab
    if w > real(0.0) and w < real(1.0):
        q = q - (wp.dot(q, ab) / length_squared) * ab
    return q, w


@wp.func
def closest_on_triangle(a: vec3, b: vec3, c: vec3):
    """Closest point q to the origin of the triangle, with its weights of b and c (Ericson 2005, section 5.1.5)."""
    ab = b - a
    ac = c - a
    d1 = -wp.dot(ab, a)
    d2 = -wp.dot(ac, a)
    if d1 <= real(0.0) and d2 <= real(0.0):
        return a, real(0.0), real(0.0)
    d3 = -wp.dot(ab, b)
    d4 = -wp.dot(ac, b)
    if d3 >= real(0.0) and d4 <= d3:
        return b, real(1.0), real(0.0)
    d5 = -wp.dot(ab, c)
    d6 = -wp.dot(ac, c)
    if d6 >= real(0.0) and d5 <= d6:
        return c, real(0.0), real(1.0)
    vc = d1 * d4 - d3 * d2
    # d1 - d3 is the squared length of the side: if it is 0, the triangle consists of its other sides
    if vc <= real(0.0) and d1 >= real(0.0) and d3 <= real(0.0) and d1 > d3:
        q, w = closest_on_edge(a, ab)
        return q, w, real(0.0)
    vb = d5 * d2 - d1 * d6
    if vb <= real(0.0) and d2 >= real(0.0) and d6 <= real(0.0):
        q, w = closest_on_edge(a, ac)
        return q, real(0.0), w
    va = d3 * d6 - d5 * d4
    n = wp.cross(ab, ac)
    n_squared = wp.dot(n, n)
    total = va + vb + vc
    if va <= real(0.0) or n_squared <= real(0.0) or total <= real(0.0):
        q, w = closest_on_edge(b, c - b)
        return q, real(1.0) - w, w
    # the computed normal of a sliver is inaccurate: make it orthogonal to a side again
    q = (wp.dot(n, a) / n_squared) * n
    q = q - (wp.dot(q, ab) / wp.dot(ab, ab)) * ab
    return q, wp.max(vb, real(0.0)) / total, wp.max(vc, real(0.0)) / total


@wp.func
def closest_on_patch(w00: vec3, w01: vec3, w10: vec3, w11: vec3, is_triangle: bool):
    """Closest point q of a flat convex patch, its weights of w01 and w10, and whether w11 has the rest (else w00).

    The patch is split along w01-w10; the other half is searched only if the closest point is on that diagonal.
    """
    q, wb, wc = closest_on_triangle(w00, w01, w10)
    from_w11 = False
    if not is_triangle and wb + wc >= real(0.999):
        q2, wb2, wc2 = closest_on_triangle(w11, w01, w10)
        if wp.dot(q2, q2) < wp.dot(q, q):
            q = q2
            wb = wb2
            wc = wc2
            from_w11 = True
    return q, wb, wc, from_w11


@wp.func
def closest_weights(w00: vec3, w01: vec3, w10: vec3, w11: vec3, is_triangle: bool):
    """Weights of the closest point of a triangle or parallelogram of any shape, as `closest_on_patch` gives them.

    If the foot of the perpendicular lies outside, the closest point is on one of the edges that separate it from the
    patch; a patch without area consists of its edges only.
    """
    q = w01 - w00
    r = w10 - w00
    v, u, has_foot = foot_weights(w00, q, r)
    # the edge at v = 1 of a parallelogram is w01-w11; a triangle has w01-w10 in its place
    third = w11
    beyond = v - real(1.0)
    if is_triangle:
        third = w10
        beyond = u + v - real(1.0)
    is_before_u = not has_foot or u < real(0.0)
    is_before_v = not has_foot or v < real(0.0)
    is_beyond_v = not has_foot or beyond > real(0.0)
    is_beyond_u = not is_triangle and (not has_foot or u > real(1.0))
    least = real(wp.inf)
    if is_before_u:
        d, w = closest_on_edge(w00, q)
        least = wp.dot(d, d)
        v = w
        u = real(0.0)
    if is_before_v:
        d, w = closest_on_edge(w00, r)
        if wp.dot(d, d) < least:
            least = wp.dot(d, d)
            v = real(0.0)
            u = w
    if is_beyond_v:
        d, w = closest_on_edge(w01, third - w01)
        if wp.dot(d, d) < least:
            least = wp.dot(d, d)
            v = wp.where(is_triangle, real(1.0) - w, real(1.0))
            u = w
    if is_beyond_u:
        d, w = closest_on_edge(w10, w11 - w10)
        if wp.dot(d, d) < least:
            v = w
            u = real(1.0)
    from_w11 = not is_triangle and u + v > real(1.0)
    if from_w11:
        u, v = real(1.0) - v, real(1.0) - u
    return v, u, from_w11
