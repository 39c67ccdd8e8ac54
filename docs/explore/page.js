// What all parts of the page use: elements by name, numbers of sliders, colours, and canvases of the right resolution.
"use strict";

const byId = (id) => document.getElementById(id);
const numberOf = (id) => Number(byId(id).value);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** Times and bounds with six digits, and all that matter where six would hide them. */
function shortTime(t) {
  return t === 0.0 || t === 1.0 ? String(t) : t.toFixed(6);
}

/**
 * Clear a canvas and give its context, with lengths in CSS pixels, and the frame in which to plot [x0, x1] × [y0, y1].
 */
function startPlot(canvas, margin, [x0, x1], [y0, y1]) {
  const { width, height } = canvas.getBoundingClientRect();
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.max(1, Math.round(width * ratio));
  canvas.height = Math.max(1, Math.round(height * ratio));
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "12px system-ui, sans-serif";
  const [w, h] = [width - margin.left - margin.right, height - margin.top - margin.bottom];
  const x = (value) => margin.left + (w * (value - x0)) / (x1 - x0);
  const y = (value) => margin.top + h - (h * (value - y0)) / (y1 - y0);
  return { context, x, y, width, height, w, h, margin };
}

/** The frame of a plot with the labels of its axes. */
function drawAxes(plot, { xName, yName, xTicks, yTicks }) {
  const { context, x, y, margin, w, h, height } = plot;
  context.strokeStyle = colour("line");
  context.lineWidth = 1;
  context.strokeRect(margin.left, margin.top, w, h);
  context.fillStyle = colour("muted");
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const [value, label] of xTicks) context.fillText(label, x(value), margin.top + h + 5);
  context.textBaseline = "alphabetic";
  context.fillText(xName, margin.left + 0.5 * w, height - 3);
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const [value, label] of yTicks) context.fillText(label, margin.left - 6, y(value));
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  context.fillText(yName, 2, margin.top - 11);
}

/** Call `render` when the page changes size or between light and dark. */
function renderOnChange(render) {
  let isAsked = false;
  const ask = () => {
    if (isAsked) return;
    isAsked = true;
    requestAnimationFrame(() => {
      isAsked = false;
      render();
    });
  };
  window.addEventListener("resize", ask);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", ask);
}
