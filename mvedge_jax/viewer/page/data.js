"use strict";
// What the page carries, unpacked: pictures as bitmaps, columns of 16-bit codes as numbers.

const UNKNOWN = -1e9;

function bytes(text) {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out;
}

async function inflated(text) {
  const stream = new Blob([bytes(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Rows of differences of 16-bit codes, all low bytes first; the last code stands for "not known".
async function numbers(packed) {
  if (!packed) return null;
  const raw = await inflated(packed.data), count = raw.length / 2;
  const width = packed.shape[packed.shape.length - 1], out = new Float32Array(count);
  const step = (packed.high - packed.low) / 65534;
  for (let i = 0, code = 0; i < count; i++) {
    code = i % width === 0 ? 0 : code;
    code = (code + raw[i] + 256 * raw[count + i]) & 65535;
    const value = packed.low + step * code;
    out[i] = code === 65535 ? UNKNOWN : packed.log ? Math.exp(value) : value;
  }
  return out;
}

async function labels(packed) {
  if (!packed) return null;
  const raw = await inflated(packed.data), out = new Float32Array(raw.length / 4);
  const view = new DataView(raw.buffer);
  for (let i = 0; i < out.length; i++) out[i] = view.getInt32(4 * i, true);
  return out;
}

function bitmap(text, type) {
  const options = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
  return createImageBitmap(new Blob([bytes(text)], { type }), options);
}

async function unpack(element) {
  const data = JSON.parse(element.textContent);
  element.textContent = "";
  // One map a layer: disparity, standard error, label.
  const maps = [], results = [];
  const add = (disparity, error, label) => maps.push({ disparity, error, label }) - 1;
  for (const packed of data.results) {
    const error = await numbers(packed.error), label = await labels(packed.labels);
    const layer = add(await numbers(packed.disparity), error, label);
    const states = [];
    for (const state of packed.states) states.push(add(await numbers(state), null, label));
    const points = {};
    for (const [name, column] of Object.entries(packed.points || {})) points[name] = await numbers(column);
    results.push({ name: packed.name, scores: packed.scores, layer, states, points: packed.points && points,
      error: !!error, labels: !!label });
  }
  const truth = data.truth ? add(await numbers(data.truth), null, null) : -1;
  const lut = bytes(data.lut);
  return { ...data, results, truth, maps, lut };
}
