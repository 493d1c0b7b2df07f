"use strict";
// What the page carries, unpacked: pictures as bitmaps, columns of 16-bit codes as numbers.

const UNKNOWN = -1e9;
const BLOCK = 8; // px of a block that knows how near and far its surroundings are
const FLAT = 0.05; // disparities that a search does not tell apart

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

async function columnsOf(packed) {
  if (!packed) return null;
  const found = {};
  for (const [name, column] of Object.entries(packed)) found[name] = await numbers(column);
  return found;
}

function bitmap(text, type) {
  const options = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
  return createImageBitmap(new Blob([bytes(text)], { type }), options);
}

// Lowest and highest disparity of all that a viewpoint may see within a block of pixels.
function boundsOf(disparity, [rows, columns, height, width], [low, high]) {
  const across = Math.ceil(width / BLOCK), down = Math.ceil(height / BLOCK);
  const reach = Math.ceil(((Math.max(rows, columns) >> 1) * Math.max(Math.abs(low), Math.abs(high)) + 1) / BLOCK);
  const own = new Float32Array(2 * across * down);
  for (let i = 0; i < own.length; i += 2) [own[i], own[i + 1]] = [Infinity, -Infinity];
  disparity.forEach((d, i) => {
    if (d === UNKNOWN) return;
    const block = 2 * (Math.floor(i / width / BLOCK) * across + Math.floor((i % width) / BLOCK));
    own[block] = Math.min(own[block], d);
    own[block + 1] = Math.max(own[block + 1], d);
  });
  const grown = (from, count, step, place) => {
    const found = new Float32Array(from.length);
    for (let i = 0; i < from.length; i += 2) {
      let [least, most] = [Infinity, -Infinity];
      for (let k = -Math.min(reach, place(i)); k <= Math.min(reach, count - 1 - place(i)); k++) {
        least = Math.min(least, from[i + 2 * k * step]);
        most = Math.max(most, from[i + 2 * k * step + 1]);
      }
      [found[i], found[i + 1]] = [least, most];
    }
    return found;
  };
  const wide = grown(own, across, 1, (i) => (i / 2) % across);
  const found = grown(wide, down, across, (i) => Math.floor(i / 2 / across));
  for (let i = 0; i < found.length; i += 2) if (found[i] > found[i + 1]) found[i] = found[i + 1] = low;
  return found;
}

async function unpack(element) {
  const data = JSON.parse(element.textContent);
  element.textContent = "";
  // One map a layer: disparity, standard error, label.
  const maps = [], results = [];
  const add = (disparity, error, label) =>
    maps.push({ disparity, error, label, bounds: boundsOf(disparity, data.shape, data.range) }) - 1;
  for (const packed of data.results) {
    const error = await numbers(packed.error), label = await labels(packed.labels);
    const layer = add(await numbers(packed.disparity), error, label);
    const states = [];
    for (const state of packed.states) states.push(add(await numbers(state), null, label));
    const points = await columnsOf(packed.points), hidden = await columnsOf(packed.hidden);
    results.push({ name: packed.name, scores: packed.scores, layer, states, points, hidden, error: !!error, labels: !!label });
  }
  const truth = data.truth ? add(await numbers(data.truth), null, null) : -1;
  const lut = bytes(data.lut);
  return { ...data, results, truth, maps, lut };
}
