"use strict";
// The map and the edges as points in space, seen from an orbit.

function product(a, b) {
  const out = new Float32Array(16);
  for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) for (let k = 0; k < 4; k++)
    out[4 * i + j] += a[4 * k + j] * b[4 * i + k];
  return out;
}

class Space {
  constructor(gl, data) {
    Object.assign(this, { gl, data });
    [this.rows, this.columns, this.height, this.width] = data.shape;
    this.dense = program(gl, DENSE, INK);
    this.edges = program(gl, EDGES, INK);
    this.cameras = program(gl, CAMERAS, INK);
    const place = ["x", "y", "disparity", "error"];
    this.buffers = data.results.map(({ points, hidden }) => ({
      points: this.upload(points, [...place, "normal_x", "normal_y", "surface_x", "surface_y"]),
      hidden: this.upload(hidden, [...place, "red", "green", "blue"]),
    }));
    this.empty = gl.createVertexArray();
  }

  upload(points, names) {
    if (!points) return null;
    const { gl } = this, count = points.x.length, packed = new Float32Array(8 * count);
    names.forEach((name, k) => points[name] && points[name].forEach((value, i) => { packed[8 * i + k] = value; }));
    const vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, packed, gl.STATIC_DRAW);
    for (const place of [0, 1]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 4, gl.FLOAT, false, 32, 16 * place);
    }
    gl.bindVertexArray(null);
    return { vao, count };
  }

  // Scale and middle of what is shown: meters with a camera, half widths of the view without.
  frame() {
    const { camera, middle, range } = this.data;
    if (!camera) return [2 / this.width, middle, 1 / Math.max(range[1] - range[0], 1e-6), 0];
    const z = 1 / Math.max(middle / (camera[0] * camera[1]) + camera[2], 1e-6);
    return [(2 * camera[0]) / (this.width * z), z, 0, 0];
  }

  pose(state, width, height) {
    const [a, b] = [state.yaw, state.pitch], [ca, sa, cb, sb] = [Math.cos(a), Math.sin(a), Math.cos(b), Math.sin(b)];
    const turn = product([1, 0, 0, 0, 0, cb, sb, 0, 0, -sb, cb, 0, 0, 0, 0, 1], [ca, 0, -sa, 0, 0, 1, 0, 0, sa, 0, ca, 0, 0, 0, 0, 1]);
    turn[14] -= state.distance;
    const f = 2.4, near = 0.02, far = 200;
    const lens = [f * height / width, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0];
    return product(lens, turn);
  }

  draw(state, common, width, height) {
    const { gl, data } = this, of = this.buffers[state.result];
    gl.viewport(0, 0, width, height);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    const values = { ...common, pose: this.pose(state, width, height), camera: data.camera ? [...data.camera, 0] : [0, 0, 0, 0],
      frame: this.frame(), relief: state.relief, dot_size: state.dots, by_error: state.byError ? 1 : 0, worst: state.worst,
      typical: data.typical, center: (this.rows >> 1) * this.columns + (this.columns >> 1), grid: [this.columns, this.rows] };
    if (state.dense) {
      gl.bindVertexArray(this.empty);
      this.dense(values);
      gl.drawArrays(gl.POINTS, 0, this.width * this.height);
    }
    if (of?.hidden && state.hidden) {
      gl.bindVertexArray(of.hidden.vao);
      this.edges({ ...values, arrows: 3, along: 0 });
      gl.drawArrays(gl.POINTS, 0, of.hidden.count);
    }
    if (of?.points && state.edges) this.drawEdges(state, values, of.points);
    if (data.camera && state.cameras) {
      gl.bindVertexArray(this.empty);
      this.cameras(values);
      gl.drawArrays(gl.POINTS, 0, this.rows * this.columns);
    }
    gl.bindVertexArray(null);
    gl.disable(gl.DEPTH_TEST);
  }

  drawEdges(state, values, { vao, count }) {
    const { gl } = this;
    gl.bindVertexArray(vao);
    this.edges({ ...values, arrows: 0, along: 0 });
    gl.drawArrays(gl.POINTS, 0, count);
    for (const place of [0, 1]) gl.vertexAttribDivisor(place, 1);
    if (state.normals) {
      this.edges({ ...values, arrows: 1, along: 4 });
      gl.drawArraysInstanced(gl.LINES, 0, 2, count);
    }
    if (state.surfaces) {
      this.edges({ ...values, arrows: 2, along: 4 });
      gl.drawArraysInstanced(gl.LINES, 0, 2, count);
    }
    for (const place of [0, 1]) gl.vertexAttribDivisor(place, 0);
  }
}
