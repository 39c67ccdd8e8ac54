// The default method for a point and a segment in the plane: kernels/narrow_phase.py, advance.py, subdivide.py,
// contact_test.py and closest_point.py.
//
// In one plane the volume vanishes, so the direction of the closest point and the moving facets do all the work. The
// rounds of rounds.js settle most pairs; what they leave open is advanced here with the facets, and then halved.
"use strict";

const PATIENCE = 3; // small steps in a row until a stall
const FACET_STEPS = 12; // clips in a row with one facet

/** Clip with the widest facet, and with every facet if `isThorough` or if the widest one gains nothing. */
function advanceFacets(patch, problem, facet, start, end, isThorough, note) {
  let reached = start;
  const clip = (name) => {
    for (const time of clipFacet(patch, problem, name, start, end, FACET_STEPS)) {
      if (time > reached) {
        note({ from: reached, to: time, name });
        reached = time;
      }
    }
  };
  if (facet.name !== null) clip(facet.name);
  if ((isThorough || reached <= start) && facet.slack > 0.0) ["x", "y", "normal"].forEach(clip);
  return reached;
}

/** Weight of b at the point of the segment that is closest to the origin. */
function closestWeight(corners) {
  const side = minus(corners.b, corners.a);
  if (-dot(side, corners.a) <= 0.0) return 0.0;
  if (-dot(side, corners.b) >= 0.0) return 1.0;
  return -dot(corners.a, side) / dot(side, side);
}

/** A point of the segment within `size` of the origin on each axis, as the weight of b and its place; else null. */
function findContact(corners, size, weight) {
  const placeOf = (w) => map(corners.a, (x, k) => x + w * (corners.b[k] - x));
  const isWithin = (v) => AXES.every((k) => Math.abs(v[k]) <= size[k]);
  if (isWithin(placeOf(weight))) return { weight, point: placeOf(weight) };
  let [low, high] = [0.0, 1.0];
  for (const k of AXES) {
    for (const sign of [1.0, -1.0]) {
      const a = sign * corners.a[k] - size[k];
      const b = sign * corners.b[k] - size[k];
      if (a > 0.0 && b > 0.0) return null;
      if (a > 0.0) low = Math.max(low, a / (a - b));
      if (b > 0.0) high = Math.min(high, a / (a - b));
    }
  }
  return low <= high ? { weight: low, point: placeOf(low) } : null;
}

/**
 * Earliest time from `start` on at which a part of the segment is not certainly free.
 *
 * The outcome is "free", "contact", "slow" (halve the part) or "limit". Every clip goes to `note`, every step's time
 * to `noteStep`.
 */
function advance(patch, problem, start, end, maxSteps, note, noteStep) {
  const contactSize = map(problem.delta, (d, k) => d + 8.0 * problem.error[k]);
  const reached = { t: start, outcome: null, iterations: 0, weight: 0.0, point: null };
  const claim = (contact, t) => Object.assign(reached, contact, { t, outcome: "contact" });
  let slow = 0;
  let gap = 1.0e30;
  while (reached.outcome === null) {
    if (reached.iterations >= maxSteps) {
      reached.outcome = "limit";
      break;
    }
    reached.iterations += 1;
    const t = reached.t;
    const corners = cornersAt(patch, t);
    const facet = widestFacet(corners, problem, 8.0);
    const s = advanceFacets(patch, problem, facet, t, end, slow > 0, note);
    if (facet.isAtFloor || s <= t || slow > 0) reached.weight = closestWeight(corners);
    if (s > end) {
      reached.outcome = "free";
      break;
    }
    if (facet.isAtFloor) {
      const contact = findContact(corners, contactSize, reached.weight);
      if (contact !== null) {
        claim(contact, t);
        break;
      }
    }
    const newGap = facet.slack * facet.slack;
    if (s - t < 0.25 * (end - t) && newGap > 0.25 * gap) slow += 1;
    gap = newGap;
    reached.t = s;
    if (s <= t || slow >= PATIENCE) {
      const here = findContact(corners, contactSize, reached.weight);
      const later = here && findContact(cornersAt(patch, s), contactSize, here.weight);
      if (later) claim(later, s);
      else if (here) claim(here, t);
      else reached.outcome = "slow";
      slow = 0;
    }
    noteStep(reached.t);
  }
  return reached;
}

/** Earliest contact of a pair by the default method, every clip that led to it, and the bound after each step. */
function clipPair(pair, tolerance, maxSteps = MAX_ITERATIONS) {
  const whole = normalise(pair, tolerance);
  const parts = forParts(whole);
  const { clips, bounds, ...rounds } = runRounds(whole, maxSteps);
  const contacts = []; // the number of clips and the toi of each contact found, ever earlier
  const stack = [];
  let answer = { status: NO_COLLISION, toi: NEVER, u: null, width: 0.0, point: null };
  let { iterations } = rounds;
  if (rounds.outcome === null) {
    stack.push({ t: rounds.t, u0: 0.0, u1: 1.0 });
  } else {
    if (rounds.outcome === "contact") {
      const { t, weight, point } = rounds;
      answer = { status: COLLISION, toi: t, u: weight, width: 0.0, point };
      contacts.push({ clip: clips.length, toi: t, u: weight });
    }
    bounds[iterations] = Math.min(answer.toi, 1.0);
  }
  let problem = whole;
  while (stack.length > 0) {
    const box = stack.pop();
    if (box.t >= answer.toi) continue;
    const patch = problem === whole ? whole.patch : partOf(whole.patch, box.u0, box.u1);
    const note = (clip) => clips.push({ ...clip, u0: box.u0, u1: box.u1 });
    const noteStep = (t) => bounds.push(Math.min(answer.toi, t, ...stack.map((other) => other.t)));
    const end = Math.min(answer.toi, 1.0);
    const reached = advance(patch, problem, box.t, end, maxSteps - iterations, note, noteStep);
    iterations += reached.iterations;
    let { t, outcome } = reached;
    let status = COLLISION;
    if (outcome === "slow" && t < answer.toi) {
      if (problem === whole) {
        problem = parts; // the whole segment once more, with the bounds of its parts, before it is halved
        stack.push({ ...box, t });
      } else if (box.u1 - box.u0 <= NARROWEST || stack.length + 2 > STACK_DEPTH) {
        outcome = "contact";
        status = RESOLUTION_LIMIT;
      } else {
        // a segment without length would be halved along the other parameter of the patch, to the same effect
        const middle = 0.5 * (box.u0 + box.u1);
        const both = [
          { t, u0: box.u0, u1: middle },
          { t, u0: middle, u1: box.u1 },
        ];
        stack.push(...(reached.weight > 0.5 ? both : both.reverse())); // the nearer half is searched first
      }
    } else if (outcome === "limit") {
      t = Math.min(t, ...stack.map((other) => other.t));
      outcome = "contact";
      status = ITERATION_LIMIT;
      stack.length = 0;
    }
    if (outcome === "contact" && t < answer.toi) {
      const u = box.u0 + reached.weight * (box.u1 - box.u0);
      answer = { status, toi: t, u, width: 0.0, point: reached.point };
      if (status !== ITERATION_LIMIT) contacts.push({ clip: clips.length, toi: t, u });
    }
    if (outcome !== "slow") bounds[iterations] = Math.min(answer.toi, 1.0, ...stack.map((other) => other.t));
  }
  return { ...reported(answer, problem), iterations, clips, bounds, contacts };
}
