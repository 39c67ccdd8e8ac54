"""When the hull of moving corners first contains the origin, or comes near it, by signs of integer polynomials.

Without separation (`contact`): {t : 0 in K(t)} is closed, and whether t belongs to it depends only on the signs of
finitely many polynomials; it starts at 0 or at a root of one of them. If det(P, Q, R) is not identically zero, its
roots are the only candidates, since contact makes the three dependent. Otherwise every V_i lies in one plane through
the origin, and the candidates are the roots of one component of the products V_i x V_j, and of V_i . V_j where that
product vanishes for all t.

With separation d > 0 (`separated_contact`): the origin becomes the cube [-d, d]^3, and K(t) + cube is a polytope of
full dimension whose facet normals are among e_k, edge x e_k and Q x R. While a normal separates it from the origin
there is no contact, so the search jumps to the first root of that normal's corner polynomials, and tests again.
"""

from __future__ import annotations

from algebraic import ZERO, Poly, Root, trimmed, unit_roots, variations_on_unit_interval
from oracle_corners import PAIRS, TRIANGLES, Line, component, difference, dot, times_line, total

# ---- Without separation ----------------------------------------------------------------------------------------------


class _Products:
    """The polynomials V_i x V_j and V_i . V_j of one query, formed when they are first asked for."""

    def __init__(self, corners: list[Line]) -> None:
        self.corners = corners
        self.cache: dict[tuple[int, int, int], Poly] = {}

    def get(self, i: int, j: int, k: int) -> Poly:
        """Component k of V_i x V_j, or V_i . V_j for k = 3; i <= j."""
        key = (i, j, k)
        poly = self.cache.get(key)
        if poly is None:
            a, b = self.corners[i], self.corners[j]
            poly = self.cache[key] = dot(a, b) if k == 3 else component(a, b, k)
        return poly


def _member(kind: str, products: _Products, t: Root) -> bool:
    """Whether 0 is in K(t), given that the corners and the origin lie in one plane at t.

    The products V_i x V_j are all parallel then, so that the component k in which one of them is not zero tells the
    sign, and the vanishing, of all of them.
    """
    k = -1
    signs = {}
    for i, j in PAIRS[kind]:
        sign = 0
        if k >= 0:
            sign = t.sign_of(products.get(i, j, k))
        elif i != j:
            for m in range(3):
                sign = t.sign_of(products.get(i, j, m))
                if sign:
                    k = m
                    break
        # Parallel corners: the origin is on their segment iff they do not point to the same side of it.
        if sign == 0 and t.sign_of(products.get(i, j, 3)) <= 0:
            return True
        signs[i, j] = sign
    # No side of a triangle holds the origin: it is inside iff it sees the three sides turn the same way.
    return any(signs[i, j] == signs[j, m] == -signs[i, m] != 0 for i, j, m in TRIANGLES[kind])


def contact(kind: str, corners: list[Line]) -> Root | None:
    """Earliest t in [0, 1] with 0 in K(t), exactly; None where there is none."""
    products = _Products(corners)
    if len(corners) > 2:
        p = corners[0]
        q = difference(corners[1], p)
        r = difference(corners[-1], p)
        det = total(times_line(component(q, r, k), p, k) for k in range(3))
        if any(det):
            return next((t for t in unit_roots(det) if _member(kind, products, t)), None)
    if _member(kind, products, ZERO):
        return ZERO
    # The corners stay in a plane through the origin, so all V_i x V_j that do not vanish for all t are multiples of one
    # another: a component that is not identically zero in one of them is so in none of them.
    k = -1
    critical = []
    for i, j in PAIRS[kind]:
        cross = ()
        for m in range(3) if k < 0 else (k,):
            cross = products.get(i, j, m)
            if any(cross):
                k = m
                break
        if any(cross):
            critical.append(cross)
        elif i == j:
            # V . V = 0 iff every component vanishes; the one that is not identically zero has the simple root.
            line = corners[i]
            critical.append(next((x for x in zip(*line, strict=True) if any(x)), (0,)))
        else:
            critical.append(products.get(i, j, 3))
    best = None
    for poly in critical:
        if not any(poly):
            continue
        for t in unit_roots(poly):
            if best is not None and t.compare(best) >= 0:
                break
            if _member(kind, products, t):
                best = t
                break
    return best


# ---- With separation -------------------------------------------------------------------------------------------------


def _edges(corners: list[Line]) -> list[Line]:
    if len(corners) == 1:
        return []
    edges = [difference(corners[1], corners[0])]
    if len(corners) > 2:
        edges.append(difference(corners[-1], corners[0]))
    if len(corners) == 3:
        edges.append(difference(corners[2], corners[1]))
    return edges


def facet_normals(corners: list[Line], dimension: int) -> list[tuple[tuple[Poly, Poly, Poly], tuple[int, ...]]]:
    """Facet normals of K(t) + cube, as polynomials, each with the corners among which n . V takes all its values."""
    every = tuple(range(len(corners)))
    normals = []
    for k in range(dimension):
        normals.append((tuple((1,) if m == k else (0,) for m in range(3)), every))
    for index, edge in enumerate(_edges(corners)):
        # Both ends of an edge have the same product with its normals.
        if len(corners) == 4:
            ends = (0, 2)
        elif len(corners) == 3:
            ends = ((0, 2), (0, 1), (0, 1))[index]
        else:
            ends = (0,)
        for k in range(3) if dimension == 3 else (2,):
            i, j = (k + 1) % 3, (k + 2) % 3
            n: list[Poly] = [(0, 0)] * 3
            n[i] = (edge[0][j], edge[1][j])
            n[j] = (-edge[0][i], -edge[1][i])
            normals.append((tuple(n), ends))
    if len(corners) > 2:
        q, r, *_ = _edges(corners)
        normals.append((tuple(component(q, r, k) for k in range(3)), (0,)))
    return normals


def _corner_polynomials(
    normal: tuple[Poly, Poly, Poly], ends: tuple[int, ...], corners: list[Line], d: int, dimension: int
) -> list[Poly]:
    """n . (V_i - d s) over the corners and the sign patterns s: n separates iff all are > 0 or all are < 0."""
    degree = len(normal[0])
    polys = []
    offsets = {(0,) * (degree + 1)}
    for k in range(dimension):
        if any(normal[k]):
            step = (*(d * c for c in normal[k]), 0)
            offsets = {tuple(map(sign, o, step)) for o in offsets for sign in (int.__add__, int.__sub__)}
    for i in ends:
        product = [0] * (degree + 1)
        for k in range(dimension):
            x0, x1 = corners[i][0][k], corners[i][1][k]
            for m, c in enumerate(normal[k]):
                product[m] += c * x0
                product[m + 1] += c * x1
        polys.extend(tuple(map(int.__add__, product, o)) for o in offsets)
    return polys


def separated_contact(corners: list[Line], d: int, dimension: int) -> Root | None:
    """Earliest t in [0, 1] at which K(t) is within L-infinity distance d > 0 of the origin; None where it never is."""
    t = ZERO
    normals = facet_normals(corners, dimension)
    families: list[list[Poly] | None] = [None] * len(normals)
    order = list(range(len(normals)))
    satisfied = 0
    while satisfied < len(order):
        index = order[satisfied]
        family = families[index]
        if family is None:
            family = families[index] = _corner_polynomials(*normals[index], corners, d, dimension)
        first = t.sign_of(family[0])
        if first == 0 or any(t.sign_of(poly) != first for poly in family):
            satisfied += 1
            continue
        # This normal separates until the first of its polynomials vanishes. It holds from then on for a while at
        # least, so the next round asks the other normals first.
        earliest = None
        for poly in map(trimmed, family):
            if earliest is not None:
                # With one root in (0, 1) at most, equal signs at t and at the earliest root so far leave none between.
                few = len(poly) < 3 or variations_on_unit_interval(poly) < 2
                if few and earliest.sign_of(poly) == first:
                    continue
            for root in unit_roots(poly):
                if earliest is not None and root.compare(earliest) >= 0:
                    break
                if root.compare(t) > 0:
                    earliest = root
                    break
        if earliest is None:
            return None
        t = earliest
        order.append(order.pop(satisfied))
        satisfied = 0
    return t
