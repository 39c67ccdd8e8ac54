// Plain inclusion bisection in the (t, u) plane, as in kernels/bisection.py: u runs along the segment from a to b.
//
// A box is free if on one axis all corners of its part of the segment lie on one side of the origin. It is a contact if
// its values are no wider than the tolerance. Otherwise its widest side is halved, and the earlier or lower half is
// examined first.
"use strict";

/** Length of v - w in units of the tolerance. */
function share(v, w, delta) {
  return Math.max(...map(v, (x, k) => Math.abs(x - w[k]) / delta[k]));
}

/** One box: whether it is free, and on which axis; whether it is narrow; and which side is the widest. */
function examine(box, problem) {
  const part = partOf(problem.patch, box.u0, box.u1);
  const early = cornersAt(part, box.t0);
  const late = cornersAt(part, box.t1);
  const corners = [early.a, early.b, late.a, late.b];
  const low = AXES.map((k) => Math.min(...corners.map((w) => w[k])));
  const high = AXES.map((k) => Math.max(...corners.map((w) => w[k])));
  const axis = AXES.findIndex((k) => low[k] > MOVING * problem.error[k] || high[k] < -MOVING * problem.error[k]);
  const middle = 0.5 * (box.t0 + box.t1);
  let dt = Math.max(share(late.a, early.a, problem.delta), share(late.b, early.b, problem.delta));
  let du = Math.max(share(early.b, early.a, problem.delta), share(late.b, late.a, problem.delta));
  if (!(middle > box.t0 && middle < box.t1)) dt = -1.0;
  if (box.u1 - box.u0 <= NARROWEST) du = -1.0;
  const isNarrow = AXES.every((k) => high[k] - low[k] <= problem.delta[k]);
  return { isFree: axis >= 0, axis, isNarrow, canSplit: Math.max(dt, du) >= 0.0, splitsTime: dt >= du, point: early.a };
}

/** Both halves of a box, the one to examine first last. */
function halves(box, splitsTime, born) {
  const child = { t0: box.t0, t1: box.t1, u0: box.u0, u1: box.u1, born, kind: "open", step: Infinity };
  if (splitsTime) {
    const middle = 0.5 * (box.t0 + box.t1);
    return [
      { ...child, t0: middle },
      { ...child, t1: middle },
    ];
  }
  const middle = 0.5 * (box.u0 + box.u1);
  return [
    { ...child, u0: middle },
    { ...child, u1: middle },
  ];
}

/**
 * Earliest contact of a pair by bisection.
 *
 * Every contact lies in a box of the stack, or at or after toi. A box keeps the step in which it was made (born) and
 * examined (step), so that every stage can be drawn; bounds[n] is the lower bound of the toi after n boxes.
 */
function bisect(pair, tolerance, maxBoxes = MAX_ITERATIONS) {
  const problem = forParts(normalise(pair, tolerance));
  const root = { t0: 0.0, t1: 1.0, u0: 0.0, u1: 1.0, born: 0, kind: "open", step: Infinity };
  const stack = [root];
  const boxes = [root];
  const examined = [];
  const bounds = [0.0];
  const contacts = []; // the step and the toi of each contact found, ever earlier
  let answer = { status: NO_COLLISION, toi: NEVER, u: null, width: 0.0, point: null };
  while (stack.length > 0) {
    const box = stack.pop();
    if (box.t0 >= answer.toi) continue; // no earlier than the contact found
    if (examined.length >= maxBoxes) {
      const toi = Math.min(answer.toi, box.t0, ...stack.map((other) => other.t0));
      answer = { ...answer, status: ITERATION_LIMIT, toi };
      break;
    }
    const found = examine(box, problem);
    examined.push(box);
    box.step = examined.length;
    box.axis = found.axis;
    if (found.isFree) {
      box.kind = "free";
    } else if (found.isNarrow || !found.canSplit || stack.length + 2 > STACK_DEPTH) {
      box.kind = "contact";
      const status = found.isNarrow ? COLLISION : RESOLUTION_LIMIT;
      answer = { status, toi: box.t0, u: box.u0, width: box.t1 - box.t0, point: found.point };
      contacts.push({ step: box.step, toi: box.t0 });
    } else {
      box.kind = "split";
      box.splitsTime = found.splitsTime;
      const children = halves(box, found.splitsTime, box.step);
      stack.push(...children);
      boxes.push(...children);
    }
    bounds.push(Math.min(answer.toi, 1.0, ...stack.map((other) => other.t0)));
  }
  return { ...reported(answer, problem), iterations: examined.length, boxes, examined, bounds, contacts };
}
