// The moving facets of a point and a segment in the plane: kernels/facets.py.
//
// They are the two axes, and the normal of the segment, which turns with it. Each is a direction d; while d·W > 0 at
// both corners W, the pair is certainly free. Solved for t this is a clip: time jumps to where the direction stops
// separating.
"use strict";

/** A direction at the time of the corners: an axis, or the normal of the segment. */
function directionOf(name, corners) {
  if (name === "x") return [1.0, 0.0];
  if (name === "y") return [0.0, 1.0];
  const side = minus(corners.b, corners.a);
  return [side[1], -side[0]];
}

/** The direction that separates best at one time, if any, its slack, and whether all gaps are down to rounding. */
function widestFacet(corners, problem, floor) {
  const facet = { name: null, slack: 0.0, isAtFloor: true };
  for (const name of ["x", "y", "normal"]) {
    const d = directionOf(name, corners);
    const along = [dot(d, corners.a), dot(d, corners.b)];
    const gap = Math.max(Math.min(...along), -Math.max(...along));
    const m = magnitudes(d);
    const size = m[0] + m[1];
    if (!(size > TINY_DIRECTION)) continue;
    if (gap - floor * dot(m, problem.error) > 0.0) facet.isAtFloor = false;
    // of two with similar slack the first is kept: axes are constant, whereas the segment may vanish
    if (gap / size > facet.slack + 0.01 * facet.slack) {
      facet.slack = gap / size;
      facet.name = name;
    }
  }
  return facet;
}

/**
 * Fraction of an interval at which the steepest line from the first of three control points to another is zero.
 *
 * 2 if none of them falls to zero, -1 if the first is not above it.
 */
function fallOf(h0, h1, h2) {
  if (!(h0 > 0.0)) return -1.0;
  if (h1 > 0.0 && h2 > 0.0) return 2.0;
  return h0 / Math.max(2.0 * (h0 - h1), h0 - h2);
}

/** The times up to which one direction, as it turns, is known to separate from `start` on; NEVER if up to `end`. */
function clipFacet(patch, problem, name, start, end, steps) {
  const margin = map(problem.error, (e) => MOVING * e);
  const offset = (d) => dot(magnitudes(d), margin) * ROUND_UP + TINY * TINY_DIRECTION;
  const times = [];
  let t = start;
  let x = end;
  let early = cornersAt(patch, t);
  let dt = directionOf(name, early);
  const sign = dot(dt, early.a) < 0.0 ? -1.0 : 1.0;
  for (let step = 0; step < steps; step++) {
    if (Math.max(...magnitudes(dt)) < TINY_DIRECTION) break;
    const late = cornersAt(patch, x);
    const dx = directionOf(name, late);
    const ot = offset(dt);
    const ox = offset(dx);
    const falls = ["a", "b"].map((w) => {
      const h0 = sign * dot(dt, early[w]) - ot;
      const h1 = 0.5 * (sign * (dot(dt, late[w]) + dot(dx, early[w]))) - 0.5 * (ot + ox);
      return fallOf(h0, h1, sign * dot(dx, late[w]) - ox);
    });
    const fraction = Math.min(...falls);
    if (!(fraction > 0.0)) break;
    const isClear = fraction > 1.0;
    if (isClear && x >= end) {
      times.push(NEVER);
      break;
    }
    const s = isClear ? x : (t + (x - t) * (fraction * FRACTION_DOWN)) * ROUND_DOWN;
    if (!(s > t)) break;
    times.push(s);
    x = Math.min(end, s + (isClear ? 4.0 : 2.0) * (s - t));
    t = s;
    early = cornersAt(patch, t);
    dt = directionOf(name, early);
  }
  return times;
}
