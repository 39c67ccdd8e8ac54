// The bullet and the wall: a test at both ends of the step, a test at several samples, and CCD over the whole step.
"use strict";

const BULLET = [
  [-0.3, -0.13],
  [0.1, -0.13],
  [0.3, 0.0],
  [0.1, 0.13],
  [-0.3, 0.13],
]; // around its centre
const BULLET_LENGTH = 0.6;
const BULLET_START = [0.6, 0.0];
const WALL_CENTRE = 5.0;
const WALL_HALF_HEIGHT = 0.5;
const LATE = 5e-5; // of the step: what is less shows as 0
const TOUCH = 1e-9; // m: what is nearer touches, however positions that are decimals were rounded

const shifted = (polygon, by) => polygon.map((x) => [x[0] + by[0], x[1] + by[1]]);
const bulletAt = (travel, t) => shifted(BULLET, [BULLET_START[0] + t * travel, BULLET_START[1]]);

function wallOf(thickness) {
  const [left, right] = [WALL_CENTRE - 0.5 * thickness, WALL_CENTRE + 0.5 * thickness];
  return [
    [left, -WALL_HALF_HEIGHT],
    [right, -WALL_HALF_HEIGHT],
    [right, WALL_HALF_HEIGHT],
    [left, WALL_HALF_HEIGHT],
  ];
}

const sidesOf = (polygon) => polygon.map((x, i) => [x, polygon[(i + 1) % polygon.length]]);

/** Whether two convex polygons overlap or touch: no side of either separates them. */
function overlap(first, second) {
  return [...sidesOf(first), ...sidesOf(second)].every(([x, y]) => {
    const d = [y[1] - x[1], x[0] - y[0]];
    const range = (polygon) => [Math.min(...polygon.map((v) => dot(d, v))), Math.max(...polygon.map((v) => dot(d, v)))];
    const [a, b] = [range(first), range(second)];
    const slack = TOUCH * Math.hypot(...d);
    return a[0] <= b[1] + slack && b[0] <= a[1] + slack;
  });
}

/** Every point of one polygon against every side of the other, over the step. */
function bulletPairs(travel, thickness) {
  const [start, end, wall] = [bulletAt(travel, 0.0), bulletAt(travel, 1.0), wallOf(thickness)];
  const pairs = [];
  const add = (points, sides) =>
    points[0].forEach((_, i) =>
      sidesOf(sides[0]).forEach(([a, b], j) => {
        const [c, d] = sidesOf(sides[1])[j];
        pairs.push({ start: { p: points[0][i], a, b }, end: { p: points[1][i], a: c, b: d } });
      }),
    );
  add([start, end], [wall, wall]);
  add([wall, wall], [start, end]);
  return pairs;
}

/** What the three tests find: overlaps at the ends, overlaps at the samples, and the earliest toi (null if free). */
function shoot(travel, thickness, numSamples) {
  const wall = wallOf(thickness);
  const hits = (t) => overlap(bulletAt(travel, t), wall);
  const times = Array.from({ length: numSamples }, (_, k) => k / (numSamples - 1));
  const tois = bulletPairs(travel, thickness).map((pair) => clipPair(pair, 1e-6).toi);
  const found = tois.filter((toi) => toi !== null);
  return {
    ends: [0.0, 1.0].map((t) => ({ t, isHit: hits(t) })),
    samples: times.map((t) => ({ t, isHit: hits(t) })),
    toi: found.length > 0 ? Math.min(...found) : null,
    numPairs: tois.length,
  };
}

const outline = (polygon, kind) => `<polygon class="${kind}" points="${polygon.map((x) => x.join(",")).join(" ")}"/>`;

function drawLane(id, thickness, shapes) {
  byId(id).innerHTML =
    `<line class="track" x1="0" x2="10.4" y1="0" y2="0"/>${outline(wallOf(thickness), "wall")}${shapes}`;
}

function drawGhosts(id, travel, thickness, tests) {
  const shapes = tests.map(({ t, isHit }) => outline(bulletAt(travel, t), isHit ? "bullet hit" : "bullet"));
  drawLane(id, thickness, shapes.join(""));
}

function say(id, isHit, text) {
  byId(id).innerHTML =
    `<strong class="${isHit ? "verdict hit" : "verdict miss"}">${isHit ? "hit" : "miss"}</strong> ${text}`;
}

function describeEnds({ ends, toi }) {
  if (ends[1].isHit && ends[1].t - toi < LATE) return "The bullet touches the wall just at the end, where this test looks.";
  if (ends[1].isHit) return "The bullet ends in the wall. When it got there is not known.";
  return toi === null ? "Right, but this test cannot know." : "It went through the wall and was never seen inside.";
}

function describeSamples({ samples, toi }, travel, thickness) {
  const first = samples.find((test) => test.isHit);
  const spacing = `Samples are ${(travel / (samples.length - 1)).toFixed(2)} m apart.`;
  if (first !== undefined) {
    const late = first.t - toi < LATE ? "just when it is touched" : `late by ${(first.t - toi).toFixed(4)}`;
    return `${spacing} The first that sees the wall is at t = ${first.t.toFixed(4)}, ${late}.`;
  }
  if (toi === null) return `${spacing} Right, but it cannot know what happens between them.`;
  const enough = `${(BULLET_LENGTH + thickness).toFixed(2)} m apart, bullet and wall together,`;
  return `${spacing} The bullet passes between two of them. Only samples at most ${enough} cannot miss it.`;
}

function describeCcd({ toi, numPairs }) {
  if (toi === null) return '<data id="bullet-toi" value="">Certain</data>: nothing touches in the whole step.';
  const shown = `<data id="bullet-toi" value="${toi}">${toi.toFixed(6)}</data>`;
  return `toi = ${shown}, the least of ${numPairs} pairs of a point and a side; never late.`;
}

/** The path of the bullet, and the bullet where CCD stops it, with a ring around it. */
function drawCcd(travel, thickness, toi) {
  const [first, last] = [bulletAt(travel, 0.0), bulletAt(travel, 1.0)];
  const path = outline([...first.slice(3), first[0], ...last.slice(0, 4)], "swept");
  const end = toi === null ? 1.0 : toi;
  const bullet = outline(bulletAt(travel, end), toi === null ? "bullet" : "bullet hit");
  const centre = BULLET_START[0] + end * travel;
  const ring = toi === null ? "" : `<circle class="ring" cx="${centre}" cy="0" r="0.46"/>`;
  drawLane("lane-ccd", thickness, path + bullet + ring);
}

function renderBullet() {
  const [travel, thickness, numSamples] = [numberOf("travel"), numberOf("thickness"), numberOf("samples")];
  const shot = shoot(travel, thickness, numSamples);
  byId("travel-value").textContent = `${travel.toFixed(2)} m`;
  byId("thickness-value").textContent = `${thickness.toFixed(2)} m`;
  byId("samples-value").textContent = numSamples;
  drawGhosts("lane-ends", travel, thickness, shot.ends);
  drawGhosts("lane-samples", travel, thickness, shot.samples);
  drawCcd(travel, thickness, shot.toi);
  const anyHit = (tests) => tests.some((test) => test.isHit);
  say("verdict-ends", anyHit(shot.ends), describeEnds(shot));
  say("verdict-samples", anyHit(shot.samples), describeSamples(shot, travel, thickness));
  say("verdict-ccd", shot.toi !== null, describeCcd(shot));
}
