// The pictures of the second part: the (t, u) plane of both methods, and the lower bound of the toi by step.
"use strict";

const PLANE_MARGIN = { left: 30, right: 10, top: 26, bottom: 38 };
const UNIT_TICKS = [
  [0, "0"],
  [0.5, "½"],
  [1, "1"],
];

function startPlane(canvas) {
  return startPlot(canvas, PLANE_MARGIN, [0, 1], [0, 1]);
}

function endPlane(plot) {
  drawAxes(plot, { xName: "t", yName: "u", xTicks: UNIT_TICKS, yTicks: UNIT_TICKS });
}

function fillBox({ context, x, y }, box, fill, stroke) {
  // whole pixels, so that no background shows between neighbours
  const [left, top] = [Math.round(x(box.t0)), Math.round(y(box.u1))];
  const [w, h] = [Math.round(x(box.t1)) - left, Math.round(y(box.u0)) - top];
  context.fillStyle = fill;
  context.fillRect(left, top, Math.max(w, 1), Math.max(h, 1));
  if (stroke !== undefined && w > 3 && h > 3) {
    context.strokeStyle = stroke;
    context.lineWidth = 1;
    context.strokeRect(left + 0.5, top + 0.5, w - 1, h - 1);
  }
}

/** A ring around a contact: boxes there are too small to be seen. */
function drawRing({ context, x, y }, t, u) {
  context.lineWidth = 2;
  context.strokeStyle = colour("contact");
  context.beginPath();
  context.arc(x(t), y(u), 8, 0, 2 * Math.PI);
  context.stroke();
}

/** How a box stands after so many steps; null if it is not there yet, or has been halved. */
function kindAfter(box, step, toi) {
  if (box.born > step) return null;
  if (box.step <= step) return box.kind === "split" ? null : box.kind;
  return box.t0 >= toi ? "later" : "open";
}

/** The toi of the last contact found up to a step; NEVER before the first. */
function contactToi(result, step) {
  const found = result.contacts.filter((contact) => contact.step <= step);
  return found.length > 0 ? found[found.length - 1].toi : NEVER;
}

function countBoxes(result, step) {
  const toi = contactToi(result, step);
  const counts = { free: 0, open: 0, contact: 0, later: 0 };
  for (const box of result.boxes) {
    const kind = kindAfter(box, step, toi);
    if (kind !== null) counts[kind] += 1;
  }
  return counts;
}

function drawBisection(canvas, result, step) {
  const plot = startPlane(canvas);
  const toi = contactToi(result, step);
  const fills = { free: colour("free"), open: colour("open"), contact: colour("contact"), later: colour("later") };
  const line = colour("box-line");
  let contact = null;
  for (const box of result.boxes) {
    const kind = kindAfter(box, step, toi);
    if (kind === null) continue;
    fillBox(plot, box, fills[kind], line);
    if (kind === "contact" && (contact === null || box.t0 < contact.t0)) contact = box;
  }
  const current = step > 0 ? result.examined[step - 1] : null;
  if (current !== null) {
    const { context, x, y } = plot;
    context.strokeStyle = colour("text");
    context.lineWidth = 2;
    const [w, h] = [x(current.t1) - x(current.t0), y(current.u0) - y(current.u1)];
    context.strokeRect(x(current.t0), y(current.u1), Math.max(w, 2), Math.max(h, 2));
  }
  if (contact !== null) drawRing(plot, contact.t0, 0.5 * (contact.u0 + contact.u1));
  endPlane(plot);
}

/** What each clip has proved free, up to a number of them, the last one outlined. */
function drawClips(canvas, result, count) {
  const plot = startPlane(canvas);
  fillBox(plot, { t0: 0, t1: 1, u0: 0, u1: 1 }, colour("open"));
  const found = result.contacts.filter((contact) => contact.clip <= count);
  const contact = found.length > 0 ? found[found.length - 1] : null;
  if (contact !== null) fillBox(plot, { t0: contact.toi, t1: 1, u0: 0, u1: 1 }, colour("later"));
  result.clips.slice(0, count).forEach((clip) => {
    fillBox(
      plot,
      { t0: clip.from, t1: Math.min(clip.to, 1), u0: clip.u0, u1: clip.u1 },
      colour("free"),
      colour("box-line"),
    );
  });
  const last = count > 0 ? result.clips[count - 1] : null;
  if (last !== null) {
    const { context, x, y } = plot;
    context.strokeStyle = colour("text");
    context.lineWidth = 2;
    const w = x(Math.min(last.to, 1)) - x(last.from);
    context.strokeRect(x(last.from), y(last.u1), Math.max(w, 2), y(last.u0) - y(last.u1));
  }
  if (contact !== null) drawRing(plot, contact.toi, contact.u);
  endPlane(plot);
}

/** Staircases of the lower bound of the toi: bisection by box, the default method by step. */
function drawBounds(canvas, bisection, clipping, step) {
  const largest = Math.max(10, bisection.iterations, clipping.iterations);
  const margin = { left: 30, right: 14, top: 26, bottom: 38 };
  const plot = startPlot(canvas, margin, [0, Math.log10(largest)], [0, 1]);
  const { context, x, y } = plot;
  const at = (n) => x(Math.log10(Math.max(1, n)));
  const staircase = (bounds, style, width) => {
    context.strokeStyle = style;
    context.lineWidth = width;
    context.beginPath();
    bounds.slice(1).forEach((bound, i) => {
      const py = y(Math.min(bound, 1));
      if (i === 0) context.moveTo(at(1), y(0));
      else context.lineTo(at(i + 1), y(Math.min(bounds[i], 1)));
      context.lineTo(at(i + 1), py);
    });
    context.lineTo(at(largest), y(Math.min(bounds[bounds.length - 1], 1)));
    context.stroke();
  };
  staircase(clipping.bounds, colour("clips"), 3);
  staircase(bisection.bounds, colour("bisection"), 2);
  context.fillStyle = colour("bisection");
  context.beginPath();
  context.arc(at(step), y(Math.min(bisection.bounds[step], 1)), 5, 0, 2 * Math.PI);
  context.fill();
  const decades = Array.from({ length: Math.floor(Math.log10(largest)) + 1 }, (_, k) => [k, String(10 ** k)]);
  drawAxes(plot, {
    xName: "boxes or steps (logarithmic)",
    yName: "toi is at least",
    xTicks: decades,
    yTicks: UNIT_TICKS,
  });
}
