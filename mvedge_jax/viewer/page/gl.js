"use strict";
// The little of WebGL that the page needs: programs whose uniforms are set by name, textures, readings.

function makeGl(canvas) {
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true });
  if (!gl) throw new Error("This browser shows no WebGL 2, which the page needs.");
  return gl;
}

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  const places = new Map();
  for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
    const { name, type } = gl.getActiveUniform(made, i);
    places.set(name, [gl.getUniformLocation(made, name), type]);
  }
  const set = {
    [gl.FLOAT]: (at, v) => gl.uniform1f(at, v), [gl.INT]: (at, v) => gl.uniform1i(at, v),
    [gl.FLOAT_VEC2]: (at, v) => gl.uniform2f(at, ...v), [gl.FLOAT_VEC4]: (at, v) => gl.uniform4f(at, ...v),
    [gl.INT_VEC2]: (at, v) => gl.uniform2i(at, ...v), [gl.FLOAT_MAT4]: (at, v) => gl.uniformMatrix4fv(at, false, v),
    [gl.SAMPLER_2D]: (at, v) => gl.uniform1i(at, v), [gl.SAMPLER_2D_ARRAY]: (at, v) => gl.uniform1i(at, v),
  };
  return (values) => {
    gl.useProgram(made);
    for (const [name, value] of Object.entries(values)) {
      const place = places.get(name);
      if (place) set[place[1]](place[0], value);
    }
  };
}

function texture(gl, unit, target, filter) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(target, gl.createTexture());
  gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, filter);
  gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, filter);
  gl.texParameteri(target, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
}

// A view that is missing stays transparent.
async function loadViews(gl, data) {
  const [rows, columns, height, width] = data.shape;
  const most = gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS);
  if (rows * columns > most) throw new Error(`This browser takes ${most} views, not ${rows * columns}; use --views.`);
  texture(gl, 0, gl.TEXTURE_2D_ARRAY, gl.LINEAR);
  gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA8, width, height, rows * columns);
  for (let i = 0; i < data.views.length; i++) {
    if (!data.views[i]) continue;
    const image = await bitmap(data.views[i], "image/webp");
    gl.activeTexture(gl.TEXTURE0);
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, i, width, height, 1, gl.RGBA, gl.UNSIGNED_BYTE, image);
    image.close();
    data.views[i] = true;
  }
}

// An array of textures, one a map, of one or two numbers a pixel.
function loadNumbers(gl, unit, count, [width, height], arrays) {
  const [inside, given] = count === 1 ? [gl.R32F, gl.RED] : [gl.RG32F, gl.RG];
  texture(gl, unit, gl.TEXTURE_2D_ARRAY, gl.NEAREST);
  gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, inside, width, height, Math.max(arrays.length, 1));
  arrays.forEach((array, layer) =>
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, layer, width, height, 1, given, gl.FLOAT, array));
}

function loadMaps(gl, data) {
  const [, , height, width] = data.shape, size = [width, height];
  const others = data.maps.map(({ error, label }) => {
    const packed = new Float32Array(2 * width * height);
    for (let i = 0; i < width * height; i++) [packed[2 * i], packed[2 * i + 1]] = [error ? error[i] : UNKNOWN, label ? label[i] : 0];
    return packed;
  });
  loadNumbers(gl, 1, 2, size, others);
  loadNumbers(gl, 5, 2, size.map((side) => Math.ceil(side / BLOCK)), data.maps.map((map) => map.bounds));
  loadNumbers(gl, 6, 1, size, data.maps.map((map) => map.disparity));
  texture(gl, 2, gl.TEXTURE_2D, gl.NEAREST);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 3, 0, gl.RGB, gl.UNSIGNED_BYTE, data.lut);
  texture(gl, 3, gl.TEXTURE_2D, gl.NEAREST);
  texture(gl, 4, gl.TEXTURE_2D, gl.LINEAR);
}

function loadTaps(gl, taps) {
  gl.activeTexture(gl.TEXTURE3);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, taps.length / 4, 1, 0, gl.RGBA, gl.FLOAT, new Float32Array(taps));
}

function loadPicture(gl, image) {
  gl.activeTexture(gl.TEXTURE4);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
}
