"use strict";
// What can be set, in which mode, and the elements that set it.

const COLORS = ["picture", "disparity", "standard error", "difference", "superpixels"];

function controls(data) {
  const [rows, columns, height, width] = data.shape, [low, high] = data.range, wide = high - low;
  const mapped = data.maps.length > 0, names = data.results.map((r) => r.name);
  const kinds = [...COLORS.slice(0, mapped ? 2 : 1)];
  if (data.results.some((r) => r.error)) kinds.push(COLORS[2]);
  if (data.truth >= 0 || names.length > 1) kinds.push(COLORS[3]);
  if (data.results.some((r) => r.labels)) kinds.push(COLORS[4]);
  const points = data.results.some((r) => r.points), states = Math.max(0, ...data.results.map((r) => r.states.length));
  const slide = (name, label, modes, min, max, value, step = (max - min) / 200) => ({ name, label, modes, min, max, value, step });
  const check = (name, label, modes, value, hint) => ({ name, label, modes, value, check: true, hint });
  const pick = (name, label, modes, options, value = options[0]) => ({ name, label, modes, options, value });
  const reach = [(columns - 1) / 2, (rows - 1) / 2];
  return [
    pick("result", "result", "FG", names, names[0]),
    columns > 1 && slide("u", "viewpoint, column", "FCE", -reach[0], reach[0], 0, 0.05),
    rows > 1 && slide("v", "viewpoint, row", "FCE", -reach[1], reach[1], 0, 0.05),
    check("follow", "the view follows the pointer", "FE", false),
    slide("aperture", "aperture, radius in view steps", "F", 0, Math.max(...reach, 0.5), 0, 0.1),
    pick("shape", "shape of the aperture", "F", Object.keys(SHAPES)),
    slide("focus", "focus, disparity", "F", low, high, data.middle),
    mapped && slide("sharp", "sharp within ± (by the map)", "F", 0, wide, 0),
    kinds.length > 1 && pick("color", "overlay", "F", kinds, "picture"),
    kinds.length > 1 && slide("opacity", "opacity of the overlay", "F", 0, 1, 0.8, 0.02),
    points && check("edgeLines", "lines of the edge points in the EPIs", "F", true),
    points && check("marks", "edge points over the picture", "F", false),
    mapped && pick("colors", "colors", "G", kinds, "picture"),
    mapped && check("dense", "points of the map", "G", true),
    data.results.some((r) => r.hidden) && check("hidden", "what only other views show", "G", true),
    points && check("edges", "edge points", "G", true),
    points && check("normals", "their normals", "G", false),
    points && check("surfaces", "their surface vectors", "G", false),
    data.camera && check("cameras", "the cameras", "G", true),
    mapped && slide("dots", "size of a point", "G", 1, 12, Math.max(Math.round(1000 / width), 2), 0.5),
    mapped && check("byError", "larger where less certain", "G", false),
    mapped && slide("bound", "largest standard error, log10 px", "G", -4, 1.5, 1.5, 0.05),
    mapped && slide("relief", "depth scale", "G", 0.1, 3, data.camera ? 1 : 0.8, 0.05),
    pick("compare", "show", "C", ["side by side", "blink", "difference"]),
    pick("left", "first", "C", names, names[0]), pick("right", "second", "C", [...names, ...(data.truth >= 0 ? ["truth"] : [])], names[1] || "truth"),
    states > 1 && slide("history", "iteration", "FC", 0, states - 1, states - 1, 1),
    slide("span", "range of differences, ± px", "FGC", 0.01, 1, 0.2, 0.01),
    slide("cardDisparity", "disparity of the picture", "E", low - 0.2 * wide, high + 0.2 * wide, (low + high) / 2),
    slide("cardSize", "half its width, px", "E", 4, width / 2, width / 6, 1),
    { name: "file", label: "picture (PNG with alpha)", modes: "E", file: true },
  ].filter((c) => c && !(c.options && c.options.length < 1));
}

function element(name, properties, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

// One label a control; `changed(name, value)` is told of every change.
function build(form, list, state, changed) {
  const rows = new Map();
  for (const control of list) {
    const { name, label, options, check, file } = control;
    let input, out = "";
    if (options) input = element("select", {}, ...options.map((o) => element("option", { value: o, textContent: o })));
    else input = element("input", { type: file ? "file" : check ? "checkbox" : "range" });
    if (file) input.accept = "image/*";
    input.name = name;
    if (!options && !check && !file) {
      Object.assign(input, { min: control.min, max: control.max, step: control.step });
      out = element("output");
    }
    const row = element("label", { className: check ? "check" : "" }, ...(check ? [input, label] : [label, out, input]));
    const show = (value) => {
      if (check) input.checked = value;
      else if (!file) input.value = value;
      if (out) out.textContent = (+value).toFixed(Math.abs(control.step) >= 1 ? 0 : 2);
    };
    if (!file) { state[name] = control.value; show(control.value); }
    input.addEventListener("input", () => {
      if (file) return changed(name, input.files[0]);
      const value = check ? input.checked : options ? input.value : +input.value;
      show(value);
      changed(name, value);
    });
    form.append(row);
    rows.set(name, { row, show, control });
  }
  form.addEventListener("submit", (event) => event.preventDefault());
  return rows;
}
