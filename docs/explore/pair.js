// A point p and a segment a-b in the plane, each point on a straight line from its place at t = 0 to that at t = 1.
//
// This file, bisection.js, facets.js, rounds.js and clipping.js are the library's kernels for this one kind of pair,
// operation by operation: here kernels/points.py, solver.py (normalise) and patch.py (corners_at). The constants are derived in
// kernels/rounding.py. JavaScript's numbers are float64, so the roundings are the library's, too.
//
// pair = { start: { p, a, b }, end: { p, a, b } }, each point [x, y].
"use strict";

const AXES = [0, 1];
const UNIT_ROUNDOFF = 2 ** -53;
const TINY = 2 ** -900;
const TINY_DIRECTION = 2 ** -150;
const PROJECTION_ROOT = 4.25 * UNIT_ROUNDOFF; // error of a projection of the whole segment
const PROJECTION_PATCH = 8.25 * UNIT_ROUNDOFF; // and of a part of it
const MOVING = 2.0;
const ROUND_UP = 1.0 + 8.0 * UNIT_ROUNDOFF;
const ROUND_DOWN = 1.0 - 8.0 * UNIT_ROUNDOFF;
const FRACTION_DOWN = 1.0 - 12.0 * UNIT_ROUNDOFF;
const NARROWEST = 2 ** -50; // of a part of the segment, so that its ends are exact
const STACK_DEPTH = 64;
const MAX_ITERATIONS = 10000;
const NEVER = 2.0; // a time after the step
const NO_COLLISION = "NO_COLLISION";
const COLLISION = "COLLISION";
const INITIAL_CONTACT = "INITIAL_CONTACT";
const ITERATION_LIMIT = "ITERATION_LIMIT";
const RESOLUTION_LIMIT = "RESOLUTION_LIMIT";

const map = (v, f) => AXES.map((k) => f(v[k], k));
const dot = (v, w) => v[0] * w[0] + v[1] * w[1];
const mix = (v, w, t) => map(v, (x, k) => (1.0 - t) * x + t * w[k]);
const minus = (v, w) => map(v, (x, k) => x - w[k]);
const magnitudes = (v) => map(v, Math.abs);

/** The difference of p and the ends of the segment: the pair touches where this segment holds the origin. */
function cornersOf(points) {
  return { a: minus(points.p, points.a), b: minus(points.p, points.b) };
}

/** Both corners at a time. */
function cornersAt(patch, t) {
  return { a: mix(patch.start.a, patch.end.a, t), b: mix(patch.start.b, patch.end.b, t) };
}

/** The part [u0, u1] of the segment, over the whole step. */
function partOf(patch, u0, u1) {
  const cut = (c) => ({ a: mix(c.a, c.b, u0), b: mix(c.a, c.b, u1) });
  return { start: cut(patch.start), end: cut(patch.end) };
}

/** Longest side of the box around the points at both ends of the step: the unit of the tolerance. */
function longestSide(pair) {
  const points = [...Object.values(pair.start), ...Object.values(pair.end)];
  const side = (k) => Math.max(...points.map((x) => x[k])) - Math.min(...points.map((x) => x[k]));
  return Math.max(side(0), side(1));
}

/** The power of two s with 1/2 <= s x < 1. */
function inversePowerOfTwo(x) {
  let s = 1.0;
  while (x > 0.0 && s * x >= 1.0) s /= 2.0;
  while (x > 0.0 && s * x < 0.5) s *= 2.0;
  return s;
}

/** Corners with each axis scaled by a power of two, and the lengths that the tests compare with, per axis. */
function normalise(pair, tolerance) {
  const start = cornersOf(pair.start);
  const end = cornersOf(pair.end);
  const deltaLength = tolerance * longestSide(pair);
  const largest = AXES.map((k) => Math.max(...[start.a, start.b, end.a, end.b].map((w) => Math.abs(w[k]))));
  const scale = largest.map((m) => inversePowerOfTwo(Math.max(m, deltaLength)));
  const scaled = (c) => ({ a: map(c.a, (x, k) => x * scale[k]), b: map(c.b, (x, k) => x * scale[k]) });
  const size = map(largest, (m, k) => m * scale[k]);
  const error = map(size, (m) => PROJECTION_ROOT * m + TINY); // of a projection, by rounding
  return {
    patch: { start: scaled(start), end: scaled(end) },
    size,
    unit: map(scale, (s) => 1.0 / s),
    error,
    tolerance: map(scale, (s) => deltaLength * s),
    delta: map(scale, (s, k) => deltaLength * s + 2.0 * error[k]),
  };
}

/** The same problem with the rounding bounds that hold for parts of the segment. */
function forParts(problem) {
  const error = map(problem.size, (m) => PROJECTION_PATCH * m + TINY);
  return { ...problem, error, delta: map(problem.delta, (d, k) => d + 2.0 * error[k]) };
}

/** What both methods report; toi is null where nothing touches. */
function reported(answer, problem) {
  const { status, toi } = answer;
  if (status === NO_COLLISION || toi > 1.0) return { ...answer, status: NO_COLLISION, toi: null, u: null, gap: null };
  if (status !== COLLISION) return { ...answer, width: 1.0 - toi, u: null, gap: null };
  const beyond = map(answer.point, (x, k) => (Math.abs(x) + 3.0 * problem.error[k]) * problem.unit[k]);
  return { ...answer, status: toi === 0.0 ? INITIAL_CONTACT : COLLISION, gap: Math.max(...beyond) };
}

/** Points of the pair at a time, to draw it. */
function pairAt(pair, t) {
  return {
    p: mix(pair.start.p, pair.end.p, t),
    a: mix(pair.start.a, pair.end.a, t),
    b: mix(pair.start.b, pair.end.b, t),
  };
}
