"use strict";
// Modes, drawing, pointer and keys. `mvedge` is for scripts: `await mvedge.ready`, then `set`, `click`, `state`, `measure`.

const MODES = { F: "Light field", G: "Geometry", C: "Compare", E: "Edit" };
const mvedge = { state: { mode: "F", at: [0, 0], card: [0, 0, 0, 0], yaw: 0.2, pitch: 0.12, distance: 2.6 } };

mvedge.ready = (async () => {
  const started = performance.now(), find = (selector) => document.querySelector(selector);
  const canvas = find(".picture"), over = find(".lines"), pen = over.getContext("2d"), stage = find(".stage");
  const { state } = mvedge, gl = makeGl(canvas), data = await unpack(find("#data"));
  const [rows, columns, height, width] = data.shape;
  find("h1").textContent = document.title = data.name;
  await loadViews(gl, data);
  loadMaps(gl, data);
  const field = new Field(gl, data), space = new Space(gl, data);
  state.at = [Math.floor(width / 2), Math.floor(height / 2)];
  let image = cardOf(data.name), turn = 0, waiting = false, drawn = {};
  gl.clearColor(0.086, 0.094, 0.114, 1);
  loadPicture(gl, image);
  const list = controls(data);
  const elements = build(find("form"), list, state, (name, value) => (name === "file" ? choosePicture(value) : mvedge.set(name, value)));
  for (const [mode, label] of Object.entries(MODES)) {
    if (!data.maps.length && (mode === "G" || mode === "C")) continue;
    if (mode === "C" && data.results.length + (data.truth >= 0) < 2) continue;
    find("nav").append(element("button", { textContent: label, onclick: () => mvedge.set("mode", mode), value: mode }));
  }

  const resultOf = (name) => data.results.findIndex((r) => r.name === name);
  function layerOf(name) {
    if (name === "truth") return data.truth;
    const result = data.results[resultOf(name)];
    if (!result) return -1;
    return result.states.length > 1 ? result.states[state.history] ?? result.layer : result.layer;
  }
  const at = (layer, x, y) => (layer < 0 ? UNKNOWN : data.maps[layer].disparity[Math.round(y) * width + Math.round(x)]);
  // Every result may be missing: a scene alone has its truth, or nothing.
  const shown = () => (data.results.length ? layerOf(state.result) : data.truth);

  function common(layer, kind, other) {
    return { views: 0, maps: 1, lut: 2, taps: 3, picture: 4, size: [width, height], range: data.range, errors: data.errors,
      span: state.span, layer, other, kind };
  }
  function resize(w, h) {
    if (canvas.width === w && canvas.height === h) return; // setting them clears
    [canvas.width, canvas.height] = [w, h];
    const scale = fit(), fine = Math.min(Math.max(Math.ceil(scale * devicePixelRatio - 0.3), 1), 3);
    // Lines are thinner than a pixel of the picture.
    [over.width, over.height] = [w * fine, h * fine];
    pen.setTransform(fine, 0, 0, fine, 0, 0);
  }

  // As large as the window lets it be, pixels up to three times their size.
  function fit() {
    const { width: w, height: h } = canvas, tall = Math.max(window.innerHeight - 130, 240);
    const wide = Math.min(3 * w, (tall * w) / h, find("section").clientWidth);
    stage.style.width = `${wide}px`;
    return wide / w;
  }

  mvedge.draw = () => {
    waiting = false;
    const { mode } = state, layer = shown();
    state.p = [state.u || 0, state.v || 0];
    const side = mode === "C" && state.compare === "side by side";
    const w = mode === "F" ? width + 4 + rows * STRIP : mode === "G" ? 960 : side ? 2 * width + 4 : width;
    const h = mode === "F" ? height + 4 + columns * STRIP : mode === "G" ? 720 : height;
    resize(w, h);
    if (mode !== "F" || mode !== drawn.mode) {
      gl.clear(gl.COLOR_BUFFER_BIT);
      pen.clearRect(0, 0, w, h);
      drawn = { mode };
    }
    if (mode === "F") drawField(layer, w, h);
    if (mode === "G") drawSpace(layer, w, h);
    if (mode === "C") drawCompared(side, h);
    if (mode === "E") field.draw({ ...state, aperture: 0, opacity: 0, card: [...state.at, state.cardSize, state.cardDisparity] }, common(layer, 0, -1), 0, h);
    describe(layer);
  };
  function drawField(layer, w, h) {
    const kind = COLOURS.indexOf(state.colour || "picture"), reference = reference_of(layer);
    field.draw({ ...state, card: [0, 0, 0, 0] }, common(layer, kind, reference), 0, h);
    const marks = state.marks && `${state.p}`, lines = [state.at, layer, state.edgeLines, marks, layer < 0 && state.focus].join();
    if (drawn.lines === lines) return; // the viewpoint moves the picture alone
    drawn.lines = lines;
    field.drawSlices(state, common(layer, 0, -1), h);
    const result = data.results[resultOf(state.result)], points = result && result.points;
    pen.clearRect(0, 0, w, h);
    field.drawLines(pen, state, layer < 0 ? null : data.maps[layer], points, colourOf);
    if (points && state.marks) for (let i = 0; i < points.x.length; i++) {
      pen.fillStyle = colourOf(points.disparity[i]);
      pen.fillRect(points.x[i] - state.p[0] * points.disparity[i], points.y[i] - state.p[1] * points.disparity[i], 1.2, 1.2);
    }
  }
  // What `difference` means: to the truth, or else to the other result.
  function reference_of(layer) {
    if (data.truth >= 0 && data.results.length) return data.truth;
    const other = data.results.find((r) => r.layer !== layer);
    return other ? other.layer : -1;
  }
  function colourOf(d) {
    const i = 3 * Math.round(255 * Math.min(Math.max((d - data.range[0]) / (data.range[1] - data.range[0]), 0), 1));
    return `rgb(${data.lut[i]} ${data.lut[i + 1]} ${data.lut[i + 2]})`;
  }
  function drawSpace(layer, w, h) {
    const worst = state.bound >= 1.5 ? 1e9 : 10 ** state.bound, kind = COLOURS.indexOf(state.colours);
    space.draw({ ...state, worst, result: Math.max(resultOf(state.result), 0) }, common(layer, kind, reference_of(layer)), w, h);
  }
  function drawCompared(side, h) {
    const [a, b] = [layerOf(state.left), layerOf(state.right)], whole = { ...state, aperture: 0, opacity: 1, card: [0, 0, 0, 0] };
    if (side) {
      field.draw(whole, common(a, 1, b), 0, h);
      field.draw(whole, common(b, 1, a), width + 4, h);
    } else if (state.compare === "blink") field.draw(whole, common(turn % 2 ? b : a, 1, -1), 0, h);
    else field.draw(whole, common(a, 3, b), 0, h);
  }

  function describe(layer) {
    for (const { row, control } of elements.values()) row.hidden = !control.modes.includes(state.mode);
    for (const button of find("nav").children) button.setAttribute("aria-pressed", button.value === state.mode);
    const [x, y] = state.at, d = at(layer, x, y), words = [`pixel (${x}, ${y})`];
    if (d !== UNKNOWN) {
      const error = data.maps[layer].error, s = error ? error[y * width + x] : UNKNOWN;
      words.push(`disparity ${d.toFixed(3)}${s > 0 ? ` ± ${s.toPrecision(2)}` : ""} px per view step`);
      if (data.camera) words.push(`${(1 / (d / (data.camera[0] * data.camera[1]) + data.camera[2])).toPrecision(4)} m`);
    }
    if (data.truth >= 0 && at(data.truth, x, y) !== UNKNOWN) words.push(`truth ${at(data.truth, x, y).toFixed(3)}`);
    if (state.mode === "C" && state.compare === "blink") words.push(`shows ${turn % 2 ? state.right : state.left}`);
    if (mvedge.rate) words.push(`${mvedge.rate.toFixed(0)} frames per second`);
    find(".status").textContent = words.join(" · ");
  }
  function notes() {
    const box = find(".notes"), scored = data.results.filter((r) => r.scores.length);
    if (scored.length) box.append(element("table", {},
      element("tr", {}, ...["", ...scored[0].scores.map(([n]) => n)].map((t) => element("th", { textContent: t }))),
      ...scored.map((r) => element("tr", {}, element("td", { textContent: r.name }), ...r.scores.map(([, v]) => element("td", { textContent: v.toPrecision(3) }))))));
    if (data.maps.length) {
      const stops = Array.from({ length: 9 }, (_, i) => colourOf(data.range[0] + (i / 8) * (data.range[1] - data.range[0])));
      const bar = element("div", { className: "bar" });
      bar.style.background = `linear-gradient(to right, ${stops.join(",")})`;
      const ends = data.range.map((r) => element("span", { textContent: r.toFixed(2) }));
      box.append(bar, element("div", { className: "ends" }, ends[0], "disparity: far, near", ends[1]));
    }
    for (const text of data.notes) box.append(element("p", { textContent: text }));
  }
  function cardOf(text) {
    const card = element("canvas", { width: 256, height: 160 }), ink = card.getContext("2d");
    ink.fillStyle = "#e69f00";
    ink.beginPath();
    ink.roundRect(4, 4, 248, 152, 40);
    ink.fill();
    ink.fillStyle = "#16181d";
    ink.font = "bold 44px system-ui, sans-serif";
    ink.textAlign = "center";
    ink.fillText(text.slice(0, 9), 128, 95);
    return card;
  }
  async function choosePicture(file) {
    if (!file) return;
    try { image = await createImageBitmap(file); } catch { find(".status").textContent = `${file.name} is no picture.`; return; }
    loadPicture(gl, image);
    mvedge.draw();
  }

  mvedge.set = (name, value) => {
    if (!(name in state)) throw new Error(`there is no setting ${name}`);
    state[name] = value;
    elements.get(name)?.show(value);
    if (!waiting) { waiting = true; requestAnimationFrame(mvedge.draw); }
  };
  // A click at a pixel of the picture: what is seen there is the pixel of the EPIs, and in focus.
  mvedge.click = (x, y) => {
    const layer = shown(), p = [state.u || 0, state.v || 0];
    const d = layer < 0 ? state.focus : field.depth(layer, x, y, p), known = d === UNKNOWN ? state.focus : d;
    const bound = (value, most) => Math.min(Math.max(Math.round(value), 0), most - 1);
    state.at = state.mode === "E" ? [x, y] : [bound(x + p[0] * known, width), bound(y + p[1] * known, height)];
    mvedge.set("focus", known);
  };
  mvedge.pixel = (x, y) => {
    const out = new Uint8Array(4);
    gl.readPixels(x, canvas.height - 1 - y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, out);
    return [...out];
  };
  // Frames per second of a viewpoint on a circle, each frame finished (a pixel is read back).
  mvedge.measure = async (seconds) => {
    const { u, v } = state, begin = performance.now();
    let frames = 0;
    while (performance.now() - begin < 1000 * seconds) {
      await new Promise(requestAnimationFrame);
      const angle = frames / 12;
      Object.assign(state, { u: Math.cos(angle) * (columns >> 1), v: Math.sin(angle) * (rows >> 1) });
      mvedge.draw();
      mvedge.pixel(0, 0);
      frames++;
    }
    mvedge.rate = (1000 * frames) / (performance.now() - begin);
    Object.assign(state, { u, v });
    mvedge.draw();
    return mvedge.rate;
  };

  let last = null;
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [((event.clientX - box.left) / box.width) * canvas.width - 0.5, ((event.clientY - box.top) / box.height) * canvas.height - 0.5];
  };
  stage.addEventListener("pointerdown", (event) => {
    last = place(event);
    stage.setPointerCapture(event.pointerId);
    const [x, y] = last.map(Math.round);
    if (state.mode !== "G" && state.mode !== "C" && x >= 0 && y >= 0 && x < width && y < height) mvedge.click(x, y);
  });
  stage.addEventListener("pointerup", () => { last = null; });
  stage.addEventListener("pointercancel", () => { last = null; });
  stage.addEventListener("pointermove", (event) => {
    const now = place(event);
    if (state.mode === "G" && last) {
      state.yaw += (now[0] - last[0]) * 0.006;
      mvedge.set("pitch", Math.min(Math.max(state.pitch + (now[1] - last[1]) * 0.006, -1.5), 1.5));
      last = now;
    } else if (state.follow && (state.mode === "F" || state.mode === "E")) {
      const part = (value, most, count) => Math.min(Math.max((value / most) * 2 - 1, -1), 1) * ((count - 1) / 2);
      if (rows > 1) mvedge.set("v", part(now[1], height, rows));
      if (columns > 1) mvedge.set("u", part(now[0], width, columns));
    }
  });
  stage.addEventListener("wheel", (event) => {
    if (state.mode !== "G") return;
    event.preventDefault();
    mvedge.set("distance", Math.min(Math.max(state.distance * Math.exp(event.deltaY * 0.001), 0.1), 40));
  }, { passive: false });
  setInterval(() => {
    if (state.mode === "C" && state.compare === "blink" && !document.hidden) { turn++; mvedge.draw(); }
  }, 700);
  canvas.addEventListener("webglcontextlost", () => { find(".status").textContent = "The graphics card has dropped the page: reload it."; });

  window.addEventListener("resize", fit);
  notes();
  mvedge.draw();
  mvedge.pixel(0, 0);
  mvedge.loaded = performance.now() - started;
  return mvedge.loaded;
})();
mvedge.ready.catch((reason) => { document.querySelector(".status").textContent = String(reason.message || reason); console.error(reason); });
