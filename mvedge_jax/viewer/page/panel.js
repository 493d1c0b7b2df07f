"use strict";
// What is written beside the picture: scores, the bar of colors, notes, the line below.

function colorOf(data, d) {
  const [low, high] = data.range, i = 3 * Math.round(255 * Math.min(Math.max((d - low) / (high - low), 0), 1));
  return `rgb(${data.lut[i]} ${data.lut[i + 1]} ${data.lut[i + 2]})`;
}

function table(results) {
  const cells = (name, words) => words.map((word) => element(name, { textContent: word }));
  const head = element("tr", {}, ...cells("th", ["", ...results[0].scores.map(([label]) => label)]));
  const rows = results.map((r) => element("tr", {}, ...cells("td", [r.name, ...r.scores.map(([, v]) => v.toPrecision(3))])));
  return element("table", {}, head, ...rows);
}

function writeNotes(box, data) {
  const scored = data.results.filter((r) => r.scores.length), [low, high] = data.range;
  if (scored.length) box.append(table(scored));
  if (data.maps.length) {
    const stops = Array.from({ length: 9 }, (_, i) => colorOf(data, low + (i / 8) * (high - low)));
    const bar = element("div", { className: "bar" });
    bar.style.background = `linear-gradient(to right, ${stops.join(",")})`;
    const ends = data.range.map((r) => element("span", { textContent: r.toFixed(2) }));
    box.append(bar, element("div", { className: "ends" }, ends[0], "disparity: far, near", ends[1]));
  }
  for (const text of data.notes) box.append(element("p", { textContent: text }));
}

// What is known of the chosen pixel.
function words(data, state, layer) {
  const [x, y] = state.at.map(Math.round), index = y * data.shape[3] + x, said = [`pixel (${x}, ${y})`];
  const d = layer < 0 ? UNKNOWN : data.maps[layer].disparity[index];
  if (d !== UNKNOWN) {
    const { error } = data.maps[layer], s = error ? error[index] : UNKNOWN;
    const step = data.shape[0] * data.shape[1] > 1 ? "view step" : "baseline";
    said.push(`disparity ${d.toFixed(3)}${s > 0 ? ` ± ${s.toPrecision(2)}` : ""} px per ${step}`);
    if (data.camera) {
      const inverse = d / (data.camera[0] * data.camera[1]) + data.camera[2];
      said.push(inverse > 0 ? `${(1 / inverse).toPrecision(4)} ${data.unit}` : "beyond infinity");
    }
  }
  const truth = data.truth < 0 ? UNKNOWN : data.maps[data.truth].disparity[index];
  if (truth !== UNKNOWN) said.push(`truth ${truth.toFixed(3)}`);
  return said;
}

// The picture to put into the scene until another is chosen.
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
