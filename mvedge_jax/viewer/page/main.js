"use strict";
// The page: its modes, what is drawn when. For scripts: `await mvedge.ready`, then `set`, `click`, `state`, `measure`.

const MODES = { F: "Light field", G: "Geometry", C: "Compare", E: "Edit" };
const SPACE_SIZE = [960, 720], GAP = 4;

class Viewer {
  constructor() {
    const find = (selector) => document.querySelector(selector);
    Object.assign(this, { canvas: find(".picture"), over: find(".lines"), stage: find(".stage"), status: find(".status") });
    this.state = { mode: "F", at: [0, 0], yaw: 0.2, pitch: 0.12, distance: 2.6 };
    Object.assign(this, { pen: this.over.getContext("2d"), turn: 0, waiting: false, drawn: {} });
    this.ready = this.open(find);
  }

  async open(find) {
    const started = performance.now(), gl = this.gl = makeGl(this.canvas), data = this.data = await unpack(find("#data"));
    [this.rows, this.columns, this.height, this.width] = data.shape;
    find("h1").textContent = document.title = data.name;
    await loadViews(gl, data);
    loadMaps(gl, data);
    loadPicture(gl, cardOf(data.name));
    gl.clearColor(0.086, 0.094, 0.114, 1);
    this.field = new Field(gl, data);
    this.space = new Space(gl, data);
    this.state.at = [Math.floor(this.width / 2), Math.floor(this.height / 2)];
    this.elements = build(find("form"), controls(data), this.state, (name, value) => (name === "file" ? this.choose(value) : this.set(name, value)));
    this.buttons = Object.keys(MODES).filter((mode) => this.has(mode)).map((mode) =>
      element("button", { textContent: MODES[mode], value: mode, onclick: () => this.set("mode", mode) }));
    find("nav").append(...this.buttons);
    writeNotes(find(".notes"), data);
    listen(this);
    window.addEventListener("resize", () => this.fit());
    setInterval(() => this.blink(), 700);
    this.draw();
    this.pixel(0, 0); // waits for the graphics card
    return this.loaded = performance.now() - started;
  }

  has(mode) {
    const { maps, results, truth } = this.data;
    return mode === "G" ? maps.length > 0 : mode === "C" ? results.length > 0 && results.length + (truth >= 0) > 1 : true;
  }

  index(name) { return this.data.results.findIndex((r) => r.name === name); }

  layerOf(name) {
    if (name === "truth") return this.data.truth;
    const result = this.data.results[this.index(name)];
    if (!result) return -1;
    return result.states.length > 1 ? result.states[this.state.history] ?? result.layer : result.layer;
  }

  // Every result may be missing: a scene alone has its truth, or nothing.
  shown() { return this.data.results.length ? this.layerOf(this.state.result) : this.data.truth; }

  // What `difference` means: to the truth, or else to the other result.
  reference(layer) {
    const { results, truth } = this.data;
    if (truth >= 0 && results.length) return truth;
    const other = results.find((r) => r.layer !== layer && r.name !== this.state.result);
    return other ? other.layer : -1;
  }

  common(layer, kind, other) {
    const { range, errors } = this.data;
    return { views: 0, maps: 1, lut: 2, taps: 3, picture: 4, bounds: 5, depths: 6, size: [this.width, this.height], range, errors, span: this.state.span, layer, other, kind };
  }

  // As large as the window lets it be, pixels up to three times their size.
  fit() {
    const { width: w, height: h } = this.canvas, tall = Math.max(window.innerHeight - 130, 240);
    const wide = Math.min(3 * w, (tall * w) / h, this.stage.parentElement.clientWidth);
    this.stage.style.width = `${wide}px`;
    return wide / w;
  }

  resize(w, h) {
    const { canvas, over } = this;
    if (canvas.width === w && canvas.height === h) return; // setting them clears
    [canvas.width, canvas.height] = [w, h];
    // Lines are thinner than a pixel of the picture: they have those of the window.
    const fine = Math.min(Math.max(this.fit() * devicePixelRatio, 1), 3);
    [over.width, over.height] = [Math.round(w * fine), Math.round(h * fine)];
    this.pen.setTransform(fine, 0, 0, fine, 0, 0);
    this.drawn = {};
  }

  size() {
    const { width, height, state } = this;
    if (state.mode === "F") return [width + GAP + this.rows * STRIP, height + GAP + this.columns * STRIP];
    if (state.mode === "G") return SPACE_SIZE;
    return [state.mode === "C" && state.compare === "side by side" ? 2 * width + GAP : width, height];
  }

  draw() {
    this.waiting = false;
    const { state, gl } = this, { mode } = state, [w, h] = this.size(), layer = this.shown();
    state.p = [state.u || 0, state.v || 0];
    this.resize(w, h);
    if (mode !== "F" || mode !== this.drawn.mode) {
      gl.clear(gl.COLOR_BUFFER_BIT);
      this.pen.clearRect(0, 0, w, h);
      this.drawn = { mode };
    }
    ({ F: () => this.drawField(layer, w, h), G: () => this.drawSpace(layer, w, h), C: () => this.drawCompared(h), E: () => this.drawEdited(layer, h) })[mode]();
    for (const { row, control } of this.elements.values()) row.hidden = !control.modes.includes(mode);
    for (const button of this.buttons) button.setAttribute("aria-pressed", button.value === mode);
    const said = words(this.data, state, layer);
    if (mode === "C" && state.compare === "blink") said.push(`shows ${this.turn % 2 ? state.right : state.left}`);
    if (this.rate) said.push(`${this.rate.toFixed(0)} frames per second`);
    this.say(said.join(" · "));
  }

  drawField(layer, w, h) {
    const { state, data, field, pen } = this, kind = COLORS.indexOf(state.color || "picture");
    field.draw({ ...state, card: [0, 0, 0, 0] }, this.common(layer, kind, this.reference(layer)), 0, h);
    const lines = [state.at, layer, state.edgeLines, state.marks && state.p, layer < 0 && state.focus].join();
    if (this.drawn.lines === lines) return; // the viewpoint moves the picture alone
    this.drawn.lines = lines;
    const result = data.results[this.index(state.result)], points = result && result.points, ink = (d) => colorOf(data, d);
    field.drawSlices(state, this.common(layer, 0, -1), h);
    pen.clearRect(0, 0, w, h);
    field.drawLines(pen, state, layer < 0 ? null : data.maps[layer], points, ink);
    if (points && state.marks) for (let i = 0; i < points.x.length; i++) {
      const d = points.disparity[i];
      pen.fillStyle = ink(d);
      pen.fillRect(points.x[i] - state.p[0] * d, points.y[i] - state.p[1] * d, 1.2, 1.2);
    }
  }

  drawSpace(layer, w, h) {
    const { state } = this, worst = state.bound >= 1.5 ? 1e9 : 10 ** state.bound;
    const common = this.common(layer, COLORS.indexOf(state.colors), this.reference(layer));
    this.space.draw({ ...state, worst, result: Math.max(this.index(state.result), 0) }, common, w, h);
  }

  drawCompared(h) {
    const { state, field } = this, [a, b] = [this.layerOf(state.left), this.layerOf(state.right)];
    const whole = { ...state, aperture: 0, opacity: 1, card: [0, 0, 0, 0] };
    if (state.compare === "difference") field.draw(whole, this.common(a, 3, b), 0, h);
    else if (state.compare === "blink") field.draw(whole, this.common(this.turn % 2 ? b : a, 1, -1), 0, h);
    else [a, b].forEach((layer, i) => field.draw(whole, this.common(layer, 1, -1), i * (this.width + GAP), h));
  }

  drawEdited(layer, h) {
    const { state } = this, card = [...state.at, state.cardSize, state.cardDisparity];
    this.field.draw({ ...state, aperture: 0, opacity: 0, card }, this.common(layer, 0, -1), 0, h);
  }

  blink() {
    if (this.state.mode !== "C" || this.state.compare !== "blink" || document.hidden) return;
    this.turn++;
    this.draw();
  }

  say(text) { if (this.status.textContent !== text) this.status.textContent = text; } // what is new alone is laid out

  async choose(file) {
    if (!file) return;
    try { loadPicture(this.gl, await createImageBitmap(file)); } catch { return this.say(`${file.name} is no picture.`); }
    this.draw();
  }

  set(name, value) {
    if (!(name in this.state)) throw new Error(`there is no setting ${name}`);
    this.state[name] = value;
    this.elements.get(name)?.show(value);
    if (!this.waiting) { this.waiting = true; requestAnimationFrame(() => this.draw()); }
  }

  // At a pixel of the picture: what is seen there is the pixel of the EPIs, and in focus; or the card's new place.
  click(x, y) {
    const { state, width, height } = this, layer = this.shown(), p = [state.u || 0, state.v || 0];
    const d = layer < 0 ? state.focus : this.field.depth(layer, x, y, p), focus = d === UNKNOWN ? state.focus : d;
    const bound = (value, most) => Math.min(Math.max(Math.round(value), 0), most - 1);
    const lift = state.mode === "E" ? state.cardDisparity : focus;
    state.at = [bound(x + p[0] * lift, width), bound(y + p[1] * lift, height)];
    this.set("focus", state.mode === "E" ? state.focus : focus);
  }

  pixel(x, y) {
    const out = new Uint8Array(4);
    this.gl.readPixels(x, this.canvas.height - 1 - y, 1, 1, this.gl.RGBA, this.gl.UNSIGNED_BYTE, out);
    return [...out];
  }

  // Frames per second of a viewpoint on a circle, each frame finished (a pixel is read back).
  async measure(seconds) {
    const { state } = this, { u, v } = state, begin = performance.now();
    let frames = 0;
    while (performance.now() - begin < 1000 * seconds) {
      await new Promise(requestAnimationFrame);
      Object.assign(state, { u: Math.cos(frames / 12) * (this.columns >> 1), v: Math.sin(frames / 12) * (this.rows >> 1) });
      this.draw();
      this.pixel(0, 0);
      frames++;
    }
    this.rate = (1000 * frames) / (performance.now() - begin);
    Object.assign(state, { u, v });
    this.draw();
    return this.rate;
  }
}

const mvedge = new Viewer();
mvedge.ready.catch((reason) => { mvedge.say(String(reason.message || reason)); console.error(reason); });
