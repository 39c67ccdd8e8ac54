// What the keys, the mouse and touch do.
"use strict";

const KEY_STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

function makeHandle(end, name) {
  const handle = byId(`${name}-${end}`);
  const drag = (event) => {
    const inverse = byId("pair").getScreenCTM().inverse();
    const place = new DOMPoint(event.clientX, event.clientY).matrixTransform(inverse);
    movePoint(end, name, [place.x / 100.0, 1.0 - place.y / 100.0]);
  };
  handle.addEventListener("pointerdown", (event) => {
    handle.setPointerCapture(event.pointerId);
    handle.focus();
    event.preventDefault();
  });
  handle.addEventListener("pointermove", (event) => handle.hasPointerCapture(event.pointerId) && drag(event));
  handle.addEventListener("keydown", (event) => {
    const step = KEY_STEPS[event.key];
    if (step === undefined) return;
    const size = event.shiftKey ? 0.1 : 0.01;
    movePoint(
      end,
      name,
      map(state.pair[end][name], (x, k) => x + size * step[k]),
    );
    event.preventDefault();
  });
  AXES.forEach((k) => {
    const input = byId(`${name}-${end}-${"xy"[k]}`);
    input.addEventListener("input", () => {
      const place = [...state.pair[end][name]];
      place[k] = input.valueAsNumber;
      if (Number.isFinite(place[k])) movePoint(end, name, place);
    });
    input.addEventListener("blur", () => placeHandle(end, name));
  });
}

function stopPlaying() {
  clearInterval(state.timer);
  state.timer = null;
  byId("play").textContent = "Play";
}

function play() {
  if (state.timer !== null) {
    stopPlaying();
    return;
  }
  if (state.step === state.bisection.iterations) setStep(0);
  const stride = Math.ceil(state.bisection.iterations / 120);
  byId("play").textContent = "Pause";
  state.timer = setInterval(() => {
    setStep(state.step + stride);
    if (state.step === state.bisection.iterations) stopPlaying();
  }, 80);
}

function onStep(id, move) {
  byId(id).addEventListener("click", () => {
    stopPlaying();
    move();
  });
}

function setTolerance() {
  const tolerance = 10.0 ** numberOf("delta");
  showNumber("delta-value", tolerance, tolerance.toPrecision(2));
  byId("delta").setAttribute("aria-valuetext", tolerance.toPrecision(2));
  solveAgain(state.pair, tolerance);
}

function start() {
  for (const id of ["travel", "thickness", "samples"]) byId(id).addEventListener("input", renderBullet);
  for (const end of ENDS) for (const name of POINT_NAMES) makeHandle(end, name);
  byId("delta").addEventListener("input", setTolerance);
  byId("example").addEventListener("change", () => {
    stopPlaying();
    const chosen = EXAMPLES[byId("example").value];
    if (chosen !== undefined) showPair(chosen, state.tolerance);
  });
  byId("step").addEventListener("input", () => {
    stopPlaying();
    setStep(numberOf("step"));
  });
  onStep("first", () => setStep(0));
  onStep("back", () => setStep(state.step - 1));
  onStep("forward", () => setStep(state.step + 1));
  onStep("last", () => setStep(Infinity));
  byId("play").addEventListener("click", play);
  byId("clip").addEventListener("input", () => setClip(numberOf("clip")));
  byId("clip-back").addEventListener("click", () => setClip(state.clip - 1));
  byId("clip-forward").addEventListener("click", () => setClip(state.clip + 1));
  renderOnChange(() => {
    setStep(state.step);
    setClip(state.clip);
  });
  renderBullet();
  showPair(EXAMPLES.crossing, 10.0 ** numberOf("delta"));
  setTolerance();
}

start();
