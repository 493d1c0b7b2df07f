"use strict";
// The light field as a picture: which views a viewpoint sees through, where a ray meets the map, EPIs and lines.

const SHAPES = {
  disc: (x, y) => Math.hypot(x, y) <= 1, square: (x, y) => Math.max(Math.abs(x), Math.abs(y)) <= 1,
  ring: (x, y) => Math.abs(Math.hypot(x, y) - 0.8) <= 0.3,
  "row of views": (x, y, dx, dy) => Math.abs(x) <= 1 && Math.abs(dy) <= 0.5,
  "column of views": (x, y, dx, dy) => Math.abs(y) <= 1 && Math.abs(dx) <= 0.5,
};
const STRIP = 7; // px of the page for a view in an EPI

class Field {
  constructor(gl, data) {
    Object.assign(this, { gl, data });
    [this.rows, this.columns, this.height, this.width] = data.shape;
    this.plain = program(gl, SCREEN, fieldShader(false));
    this.overlaid = program(gl, SCREEN, fieldShader(true));
    this.slice = program(gl, SCREEN, SLICE);
  }

  // Steps (u - u_c, v - v_c), layer and weight of the views that the aperture at p lets through.
  taps(p, radius, shape) {
    const found = [], tent = [];
    let nearest = null, least = Infinity;
    for (let v = 0; v < this.rows; v++) for (let u = 0; u < this.columns; u++) {
      const layer = v * this.columns + u;
      if (!this.data.views[layer]) continue;
      const s = u - (this.columns >> 1), t = v - (this.rows >> 1), dx = s - p[0], dy = t - p[1];
      // Linear on the two triangles of a cell: three views instead of four, which is a quarter of the picture's time.
      const near = 1 - Math.max(Math.abs(dx), Math.abs(dy), Math.abs(dx + dy)), far = Math.hypot(dx, dy);
      if (near > 1e-6) tent.push(s, t, layer, near);
      if (radius > 0 && SHAPES[shape](dx / radius, dy / radius, dx, dy)) found.push(s, t, layer, 1);
      if (far < least) [least, nearest] = [far, [s, t, layer, 1]];
    }
    return found.length ? found : tent.length ? tent : nearest;
  }

  // The disparity that the viewpoint sees at (x, y); the same search as the shader's.
  depth(layer, x, y, p) {
    const { disparity: map, bounds } = this.data.maps[layer];
    const pixel = (place, count) => Math.min(Math.max(Math.floor(place + 0.5), 0), count - 1);
    const at = (d) => map[pixel(y + p[1] * d, this.height) * this.width + pixel(x + p[0] * d, this.width)];
    // A script may click anywhere.
    const [row, column] = [pixel(y, this.height), pixel(x, this.width)].map((i) => Math.floor(i / BLOCK));
    const block = 2 * (row * Math.ceil(this.width / BLOCK) + column), [low, high] = bounds.subarray(block, block + 2);
    const reach = Math.max(Math.abs(p[0]), Math.abs(p[1]));
    if (reach < 1e-3) return at(0);
    if (high - low < FLAT) return at(high);
    const steps = Math.min(Math.max(Math.ceil(1.5 * reach * (high - low)) + 1, 2), 96);
    const pace = (high - low) / steps, thick = 1.5 * pace + FLAT;
    let best = low, miss = Infinity;
    for (let i = 0; i <= steps; i++) {
      const d = high - pace * i, there = at(d), past = there - d;
      if (there === UNKNOWN) continue;
      if (past >= -1e-4 && past < thick) return there;
      if (Math.abs(past) < miss) [miss, best] = [Math.abs(past), there];
    }
    return best;
  }

  // Draws one picture with its left edge at `left`; the canvas is `tall` px high.
  draw(state, common, left, tall) {
    const taps = this.taps(state.p, state.aperture, state.shape);
    loadTaps(this.gl, taps);
    this.gl.viewport(left, tall - this.height, this.width, this.height);
    const screen = common.kind > 0 || state.card[2] > 0 ? this.overlaid : this.plain;
    screen({ ...common, origin: [left, 0], height: tall, p: state.p, tapped: taps.length / 4, focus: state.focus,
      sharp: state.aperture > 0 ? state.sharp : 1e6, opacity: state.opacity, card: state.card });
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
  }

  drawSlices(state, common, tall) {
    const { gl } = this, grid = [this.columns, this.rows], low = this.columns * STRIP, side = this.rows * STRIP;
    gl.viewport(0, tall - this.height - 4 - low, this.width, low);
    this.slice({ ...common, origin: [0, this.height + 4], height: tall, line: state.at[1], thick: STRIP, column: 0, grid });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.viewport(this.width + 4, tall - this.height, side, this.height);
    this.slice({ ...common, origin: [this.width + 4, 0], height: tall, line: state.at[0], thick: STRIP, column: 1, grid });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // Lines of the chosen pixel, with two standard errors, and of edge points within half a pixel, over the slices.
  drawLines(pen, state, map, points, color) {
    const { width, height, rows, columns } = this, [x, y] = state.at;
    const line = (place, d, row, ink, dash = []) => {
      const count = row ? columns : rows, step = count >> 1;
      pen.strokeStyle = ink;
      pen.setLineDash(dash);
      pen.beginPath();
      for (const s of [-step - 0.5, step + 0.5]) { // a view's strip is a step long
        const along = place - s * d + 0.5, across = (s + step + 0.5) * STRIP + 4;
        row ? pen.lineTo(along, height + across) : pen.lineTo(width + across, along);
      }
      pen.stroke();
    };
    for (const [row, clip] of [[true, [0, height + 4, width, columns * STRIP]], [false, [width + 4, 0, rows * STRIP, height]]]) {
      pen.save();
      pen.beginPath();
      pen.rect(...clip);
      pen.clip();
      pen.lineWidth = 0.4;
      pen.globalAlpha = 0.6;
      if (points && state.edgeLines) for (let i = 0; i < points.x.length; i++) {
        if (Math.abs(row ? points.y[i] - y : points.x[i] - x) <= 0.5)
          line(row ? points.x[i] : points.y[i], points.disparity[i], row, color(points.disparity[i]));
      }
      pen.globalAlpha = 1;
      const index = Math.round(y) * width + Math.round(x), d = map ? map.disparity[index] : state.focus;
      const error = map && map.error ? map.error[index] : -1, place = row ? x : y;
      if (error > 0) for (const sign of [-2, 2]) line(place, d + sign * error, row, "#fff", [2, 2]);
      pen.lineWidth = 1.2;
      if (d !== UNKNOWN) line(place, d, row, "#ff3b30");
      pen.restore();
    }
    pen.strokeStyle = "#ff3b30";
    pen.setLineDash([3, 3]);
    pen.lineWidth = 0.6;
    for (const ends of [[0, y + 0.5, width, y + 0.5], [x + 0.5, 0, x + 0.5, height]]) {
      pen.beginPath();
      pen.moveTo(ends[0], ends[1]);
      pen.lineTo(ends[2], ends[3]);
      pen.stroke();
    }
  }
}
