// The rounds in which the default method begins, for a point and a segment in the plane: kernels/lane_solver.py,
// lane_advance.py, lane_closest.py and inclusion.py. The library takes several pairs through them at once, in the lanes
// of the processor; no lane looks at another, so here there is one.
//
// In one plane the volume vanishes. A first round clips with the direction of the closest point alone, a later one with
// the widest facet (facets.js) too. kernels/lane_touch.py is left out: it searches for a point of the patch within the
// separation box where the closest point is not, and without a separation the closest point of a pair whose gap is down
// to rounding is within the tolerance.
"use strict";

const FIRST_ROUNDS = 2;
const LATER_ROUNDS = 8; // at most
const ROUND_FACET_STEPS = 4; // clips in a row with the widest facet in a round
const FLOOR = 8.0; // rounding bounds of a gap that may consist of rounding errors only
const NEAR = 128.0; // and of one after which the clip of the round leads to the contact

const isWithin = (v, size) => AXES.every((k) => Math.abs(v[k]) <= size[k]);

/** x clamped to [0, 1], 0 for NaN: for the weight on a segment without length. */
function unitInterval(x) {
  const y = x > 0.0 ? x : 0.0;
  return y < 1.0 ? y : 1.0;
}

/** The point of the segment that is closest to the origin, its weight of b, and a direction to clip with. */
function closestOf(corners) {
  const side = minus(corners.b, corners.a);
  const weight = unitInterval(-dot(corners.a, side) / dot(side, side));
  const point = mix(corners.a, corners.b, weight);
  // keep the direction where the gap is far smaller than the segment: orthogonal to it
  const along = dot(point, side) / (dot(side, side) + TINY);
  const isInside = weight > 0.0 && weight < 1.0;
  return { weight, point, direction: isInside ? map(point, (x, k) => x - along * side[k]) : point };
}

/** Time up to which one corner stays beyond `off`, NEVER if until the end; -1 if it is not beyond it at `t`. */
function clipCorner(a, b, off, t) {
  const crossing = (a - off) / (a - b);
  if (b > off && (a > off || crossing * ROUND_UP < t)) return NEVER;
  return a > off && !(b > off) ? Math.min(NEVER, crossing * ROUND_DOWN) : -1.0;
}

/** Time s >= t such that a constant direction separates the segment from the origin on [t, s); NEVER if to the end. */
function clipDirection(d, problem, t) {
  const { start, end } = problem.patch;
  const off = dot(magnitudes(d), problem.error) * ROUND_UP;
  const times = ["a", "b"].map((w) => clipCorner(dot(d, start[w]), dot(d, end[w]), off, t));
  const s = Math.min(...times);
  return Math.max(...magnitudes(d)) >= TINY_DIRECTION && s > t ? s : t;
}

/** The clips of one round from time t on: a list with the time up to which each separates. */
function clipsOfRound(problem, corners, near, facet, t) {
  const clips = [{ name: "closest", to: clipDirection(near.direction, problem, t) }];
  // in the units of the points, to draw it
  clips[0].direction = map(near.direction, (x, k) => x / problem.unit[k]);
  if (facet !== null && facet.slack > 0.0) {
    const times = clipFacet(problem.patch, problem, facet.name, t, 1.0, ROUND_FACET_STEPS);
    clips.push(...times.map((to) => ({ name: facet.name, to })));
  }
  return clips;
}

/**
 * Up to `count` rounds from time `reached.t` on; one that gains nothing is the last.
 *
 * Invariant: the pair is free of contact on [0, t). The outcome is "free", "contact", or null if the pair stays open.
 */
function advanceRounds(problem, reached, count, withFacets) {
  const floor = map(problem.error, (e) => FLOOR * e);
  const contactSize = map(floor, (f, k) => f + (problem.tolerance[k] + problem.error[k] + problem.error[k]));
  let isOpen = true;
  for (let round = 0; round < count && isOpen; round++) {
    reached.iterations += 1;
    const { t } = reached;
    const corners = cornersAt(problem.patch, t);
    const near = closestOf(corners);
    const facet = withFacets ? widestFacet(corners, problem, NEAR) : null;
    const clips = clipsOfRound(problem, corners, near, facet, t);
    const s = Math.max(...clips.map((clip) => clip.to));
    const nearby = map(problem.error, (e) => NEAR * e);
    const isNear = facet === null ? isWithin(near.direction, nearby) : facet.isAtFloor;
    if (!(s > 1.0) && isNear) {
      // where the clips have led; what rounding hides at the start stays there
      const stays = t <= 0.0 && isWithin(near.direction, floor);
      const there = cornersAt(problem.patch, stays ? t : s);
      const point = mix(there.a, there.b, near.weight);
      if (isWithin(point, contactSize)) {
        Object.assign(reached, { outcome: "contact", weight: near.weight, point });
        if (stays) break;
      }
    }
    for (const clip of clips) {
      if (clip.to > reached.t) {
        reached.clips.push({ ...clip, from: reached.t, u0: 0.0, u1: 1.0 });
        reached.t = clip.to;
      }
    }
    if (s > 1.0) reached.outcome = "free";
    if (reached.outcome !== null) break;
    isOpen = s > t;
    reached.bounds.push(s);
  }
}

/** All rounds of a pair: where they end, every clip, and the bound after each. */
function runRounds(problem, maxSteps) {
  const reached = { t: 0.0, outcome: null, iterations: 0, weight: 0.0, point: null, clips: [], bounds: [0.0] };
  advanceRounds(problem, reached, Math.min(maxSteps, FIRST_ROUNDS), false);
  if (reached.outcome === null) advanceRounds(problem, reached, Math.min(maxSteps - FIRST_ROUNDS, LATER_ROUNDS), true);
  return reached;
}
