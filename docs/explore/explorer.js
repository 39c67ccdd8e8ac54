// The pair that is dragged by its points: bisection step by step, and beside it the clips of the default method.
"use strict";

const POINT_NAMES = ["p", "a", "b"];
const ENDS = ["start", "end"];
const EXAMPLES = {
  crossing: {
    start: { p: [0.2, 0.9], a: [0.1, 0.4], b: [0.9, 0.5] },
    end: { p: [0.6, 0.1], a: [0.2, 0.5], b: [0.8, 0.2] },
  },
  turning: {
    start: { p: [0.72, 0.92], a: [0.3, 0.15], b: [0.3, 0.85] },
    end: { p: [0.62, 0.3], a: [0.85, 0.5], b: [0.12, 0.4] },
  },
  sliding: {
    start: { p: [0.164, 0.275], a: [0.1, 0.2], b: [0.9, 0.7] },
    end: { p: [0.863, 0.671], a: [0.1, 0.2], b: [0.9, 0.7] },
  },
  grazing: {
    start: { p: [0.05, 0.5], a: [0.25, 0.9], b: [0.55, 0.62] },
    end: { p: [0.95, 0.42], a: [0.35, 0.95], b: [0.42, 0.3] },
  },
  beside: {
    start: { p: [0.12, 0.52], a: [0.08, 0.4], b: [0.6, 0.75] },
    end: { p: [0.85, 0.68], a: [0.3, 0.15], b: [0.9, 0.62] },
  },
};
const MAX_ROWS = 40; // of the table of clips
const DIRECTION_NAMES = {
  closest: "the direction of the closest point",
  x: "the x axis",
  y: "the y axis",
  normal: "the turning normal of the segment",
};

const state = {
  pair: EXAMPLES.crossing,
  tolerance: 1e-2,
  bisection: null,
  clipping: null,
  step: 0,
  clip: 0,
  timer: null,
};

/** Solve a pair by both methods and show the ends of both. */
function showPair(pair, tolerance) {
  state.pair = pair;
  state.tolerance = tolerance;
  state.bisection = bisect(pair, tolerance);
  state.clipping = clipPair(pair, tolerance);
  setStep(Infinity);
  setClip(Infinity);
}

/** The same after a change of the pair or of the tolerance: whoever looked at the last step still does. */
function solveAgain(pair, tolerance) {
  const { step, clip, bisection, clipping } = state;
  showPair(pair, tolerance);
  if (step < bisection.iterations) setStep(step);
  if (clip < clipping.clips.length) setClip(clip);
}

function setStep(step) {
  const { bisection, clipping } = state;
  state.step = Math.max(0, Math.min(step, bisection.iterations));
  byId("step").max = bisection.iterations;
  byId("step").value = state.step;
  drawBisection(byId("boxes"), bisection, state.step);
  drawBounds(byId("bounds"), bisection, clipping, state.step);
  const counts = countBoxes(bisection, state.step);
  for (const kind of ["free", "open", "contact", "later"]) byId(`count-${kind}`).textContent = counts[kind];
  showNumber("step-count", state.step, `${state.step} of ${bisection.iterations}`);
  showNumber("bound", bisection.bounds[state.step], shortTime(Math.min(bisection.bounds[state.step], 1)));
  byId("step-text").textContent = describeBox(bisection, state.step);
  showResult("bisection", bisection, "boxes");
}

function setClip(count) {
  const { clipping } = state;
  state.clip = Math.max(0, Math.min(count, clipping.clips.length));
  byId("clip").max = clipping.clips.length;
  byId("clip").value = state.clip;
  drawClips(byId("clips"), clipping, state.clip);
  showNumber("clip-count", state.clip, `${state.clip} of ${clipping.clips.length}`);
  byId("clip-text").textContent = describeClip(clipping, state.clip);
  byId("clip-rows").innerHTML = rowsOfClips(clipping, state.clip);
  const row = byId("clip-rows").querySelector(".current");
  const table = byId("clip-table");
  if (row !== null) table.scrollTop = row.offsetTop - 0.5 * table.clientHeight;
  showResult("clipping", clipping, `steps, which clip ${clipping.clips.length} times`);
  drawPair();
}

function showNumber(id, value, text) {
  byId(id).value = value === null ? "" : value;
  byId(id).textContent = text;
}

const VERDICTS = {
  NO_COLLISION: "certain: nothing touches",
  COLLISION: "contact",
  INITIAL_CONTACT: "contact at the start",
  ITERATION_LIMIT: `stopped after ${MAX_ITERATIONS.toLocaleString("en")}: free up to here, no more is known`,
  RESOLUTION_LIMIT: "not resolved: free up to here, no more is known",
};

function showResult(id, result, unit) {
  showNumber(`${id}-toi`, result.toi, result.toi === null ? "none" : shortTime(result.toi));
  showNumber(`${id}-status`, result.status, `${VERDICTS[result.status]} (${result.status})`);
  showNumber(`${id}-iterations`, result.iterations, `${result.iterations} ${unit}`);
}

const interval = (low, high) => `[${Number(low.toFixed(5))}, ${Number(high.toFixed(5))}]`;

function describeBox(result, step) {
  if (step === 0) return "One open box: all times of the step, all places u on the segment.";
  const box = result.examined[step - 1];
  const where = `Box ${step}: t in ${interval(box.t0, box.t1)}, u in ${interval(box.u0, box.u1)}.`;
  if (box.kind === "free")
    return `${where} Free: on the ${"xy"[box.axis]} axis p stays on one side of this part of the segment.`;
  if (box.kind === "split")
    return `${where} Open: on neither axis does p stay on one side, so it is halved in ${box.splitsTime ? "t" : "u"}.`;
  return `${where} A contact: its values are no wider than δ and hold zero. Boxes that begin later are dropped.`;
}

function describeClip(result, count) {
  if (count === 0) return "Nothing is proved yet.";
  const clip = result.clips[count - 1];
  const from = `Clip ${count}: at t = ${shortTime(clip.from)} ${DIRECTION_NAMES[clip.name]} separates p from `;
  const part = clip.u0 === 0.0 && clip.u1 === 1.0 ? "the segment" : `its part u in ${interval(clip.u0, clip.u1)}`;
  return `${from}${part}, and does so ${clip.to > 1.0 ? "to the end of the step" : `until t = ${shortTime(clip.to)}`}.`;
}

/** The clips around the current one, with how far each is from the end: of the contact, or of the step. */
function rowsOfClips(result, count) {
  const end = result.toi === null ? 1.0 : result.toi;
  const first = Math.max(0, Math.min(count - MAX_ROWS / 2, result.clips.length - MAX_ROWS));
  const rows = result.clips.slice(first, first + MAX_ROWS).map((clip, i) => {
    const number = first + i + 1;
    const to = Math.min(clip.to, 1.0);
    const left = end - to > 0.0 ? (end - to).toExponential(1) : "0";
    const kind = number === count ? ' class="current" aria-current="step"' : "";
    return `<tr${kind}><td>${number}</td><td>${shortTime(to)}</td><td>${left}</td><td>${clip.name}</td></tr>`;
  });
  return rows.join("");
}

/** Map a place in the plane to the drawing, whose y axis points down. */
const drawn = (v) => [100.0 * v[0], 100.0 * (1.0 - v[1])];

function lineOf(kind, v, w) {
  const [[x1, y1], [x2, y2]] = [drawn(v), drawn(w)];
  return `<line class="${kind}" x1="${x1}" y1="${y1}" x2="${x2}" y2="${y2}"/>`;
}

/** A line between p and a part of the segment, across the direction of a clip. */
function separatingLine(clip, points) {
  const [low, high] = [mix(points.a, points.b, clip.u0), mix(points.a, points.b, clip.u1)];
  const d = clip.name === "closest" ? clip.direction : directionOf(clip.name, { a: low, b: high });
  const length = Math.hypot(...d);
  const ends = [dot(d, low), dot(d, high)];
  const from = dot(d, points.p);
  const nearest = ends.reduce((best, x) => (Math.abs(x - from) < Math.abs(best - from) ? x : best));
  const middle = map(points.p, (x, k) => x + (d[k] * 0.5 * (nearest - from)) / (length * length));
  const along = [-d[1] / length, d[0] / length];
  return lineOf(
    "separator",
    map(middle, (x, k) => x - 2 * along[k]),
    map(middle, (x, k) => x + 2 * along[k]),
  );
}

function drawPair() {
  const { pair, clipping, clip } = state;
  const isDone = clip === clipping.clips.length;
  const last = clip > 0 ? clipping.clips[clip - 1] : null;
  const t = isDone ? (clipping.toi === null ? 1.0 : clipping.toi) : last === null ? 0.0 : last.from;
  const now = pairAt(pair, t);
  const corners = [pair.start.a, pair.start.b, pair.end.b, pair.end.a].map((v) => drawn(v).join(",")).join(" ");
  let shapes = `<polygon class="swept" points="${corners}"/>`;
  for (const name of POINT_NAMES) shapes += lineOf("track", pair.start[name], pair.end[name]);
  shapes += lineOf("segment", pair.start.a, pair.start.b) + lineOf("segment end", pair.end.a, pair.end.b);
  if (last !== null && !isDone) shapes += separatingLine(last, now);
  shapes += lineOf("segment now", now.a, now.b);
  const [x, y] = drawn(now.p);
  shapes += `<circle class="now" cx="${x}" cy="${y}" r="1.8"/>`;
  if (isDone && clipping.toi !== null) shapes += `<circle class="ring" cx="${x}" cy="${y}" r="5"/>`;
  byId("pair-shapes").innerHTML = shapes;
  byId("pair-time").textContent = `Drawn at t = ${shortTime(t)}`;
  for (const end of ENDS) for (const name of POINT_NAMES) placeHandle(end, name);
}

function placeHandle(end, name) {
  const place = state.pair[end][name];
  const handle = byId(`${name}-${end}`);
  handle.setAttribute("transform", `translate(${drawn(place).join(" ")})`);
  handle.setAttribute("aria-valuenow", place[0]);
  handle.setAttribute("aria-valuetext", `x ${place[0]}, y ${place[1]}`);
  AXES.forEach((k) => {
    const input = byId(`${name}-${end}-${"xy"[k]}`);
    if (document.activeElement !== input) input.value = place[k];
  });
}

function movePoint(end, name, place) {
  byId("example").value = "own";
  const clamped = map(place, (x) => Math.round(1000.0 * Math.min(1.0, Math.max(0.0, x))) / 1000.0);
  solveAgain({ ...state.pair, [end]: { ...state.pair[end], [name]: clamped } }, state.tolerance);
}
