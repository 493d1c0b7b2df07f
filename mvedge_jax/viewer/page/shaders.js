"use strict";
// Positions are pixels with their centers at integers, y down. `p` is the viewpoint in view steps from the
// center: a point at c of the center view with disparity d is at c - p d, and in view s at c - s d.

const COMMON = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D; precision highp sampler2DArray;
uniform sampler2DArray views, depths, maps, bounds; uniform sampler2D lut;
uniform ivec2 size; uniform vec2 range, errors; uniform float span; uniform int layer, other, kind;
const float UNKNOWN = -1e8;
vec3 shade(float t, int row) { return texelFetch(lut, ivec2(clamp(t, 0., 1.) * 255. + .5, row), 0).rgb; }
ivec3 texel(int which, vec2 c) { return ivec3(clamp(c + .5, vec2(0), vec2(size) - .5), which); }
float disparityAt(int which, vec2 c) { return texelFetch(depths, texel(which, c), 0).x; }
vec3 mapped(int which, vec2 c) { // disparity, standard error, label
  return vec3(disparityAt(which, c), texelFetch(maps, texel(which, c), 0).xy);
}
vec4 seen(vec2 c, float view) { return texture(views, vec3((c + .5) / vec2(size), view)); }
vec3 meaning(int what, float disparity, float error, float label, float reference) {
  if (what == 1) return shade((disparity - range.x) / (range.y - range.x), 0);
  if (what == 2) return error < 0. ? vec3(.9, .3, .7)
    : shade((log(error) - errors.x) / (errors.y - errors.x), 1);
  if (what == 3) return reference < UNKNOWN ? vec3(.5) : shade(.5 + .5 * (disparity - reference) / span, 2);
  vec3 hue = fract(label * vec3(.6180340, .7548777, .5698403));
  return label <= 0. ? vec3(.1) : .25 + .7 * hue;
}
`;

const SCREEN = `#version 300 es
void main() { gl_Position = vec4(4 * (gl_VertexID & 1) - 1, 4 * (gl_VertexID >> 1) - 1, 0, 1); }`;

// With the overlay and the card, or without them, which is faster.
const fieldShader = (overlaid) => COMMON + `
#define BLOCK ${BLOCK}
#define FLAT ${FLAT}
${overlaid ? "#define OVERLAID" : ""}
uniform sampler2D taps, picture; uniform int tapped; uniform vec2 origin, p;
uniform float focus, sharp, opacity; uniform vec4 card; uniform float height;
out vec4 result;
// The disparity seen at x from p: from near to far, the first surface that the ray meets.
float depth(vec2 x) {
  if (layer < 0) return focus;
  float reach = max(abs(p.x), abs(p.y));
  if (reach < 1e-3) return disparityAt(layer, x);
  vec2 around = texelFetch(bounds, ivec3(ivec2(x / float(BLOCK)), layer), 0).xy;
  if (around.y - around.x < FLAT) return disparityAt(layer, x + p * around.y);
  int steps = clamp(int(ceil(1.5 * reach * (around.y - around.x))) + 1, 2, 96);
  float pace = (around.y - around.x) / float(steps), thick = 1.5 * pace + FLAT;
  float best = around.x, miss = 1e9;
  for (int i = 0; i <= steps; i++) {
    float d = around.y - pace * float(i), there = disparityAt(layer, x + p * d), past = there - d;
    if (there < UNKNOWN) continue;
    if (past >= -1e-4 && past < thick) return there;
    if (abs(past) < miss) { miss = abs(past); best = there; }
  }
  return best;
}
void main() {
  vec2 x = vec2(gl_FragCoord.x - .5, height - .5 - gl_FragCoord.y) - origin;
  float d = depth(x), off = d - focus;
  if (d < UNKNOWN) { d = focus; off = 0.; }
  float at = focus + clamp(off, -sharp, sharp); // blurred as far as the depth is not sharp
  vec2 from = (x + p * at + .5) / vec2(size), pace = at / vec2(size);
  vec3 sum = vec3(0); float total = 0.;
  for (int i = 0; i < tapped; i++) {
    vec4 tap = texelFetch(taps, ivec2(i, 0), 0);
    vec3 level = texture(views, vec3(from - tap.xy * pace, tap.z)).rgb;
    sum += tap.w * level * level; total += tap.w; // light, nearly, and back without loss
  }
  vec3 color = sqrt(sum / max(total, 1e-6));
#ifdef OVERLAID
  vec2 c = x + p * d;
  if (kind > 0 && layer >= 0) {
    vec3 here = mapped(layer, c);
    float reference = other < 0 ? -1e9 : disparityAt(other, c);
    color = mix(color, meaning(kind, here.x, here.y, here.z, reference), opacity);
  }
  // A card on a plane: center x and y, half a width, disparity; what is nearer hides it.
  if (card.z > 0. && (layer < 0 || card.w > d)) {
    vec2 extent = vec2(textureSize(picture, 0));
    vec2 q = (x + p * card.w - card.xy) / card.z * vec2(1, extent.x / extent.y);
    vec4 ink = texture(picture, .5 + .5 * q);
    if (max(abs(q.x), abs(q.y)) <= 1.) color = mix(color, ink.rgb, ink.a);
  }
#endif
  result = vec4(color, 1);
}`;

// Slices through the views: of a row below the picture, of a column beside it.
const SLICE = COMMON + `
uniform vec2 origin; uniform float height, line, thick; uniform int column; uniform ivec2 grid;
out vec4 result;
void main() {
  vec2 x = vec2(gl_FragCoord.x - .5, height - .5 - gl_FragCoord.y) - origin;
  int view = int(floor(((column == 1 ? x.x : x.y) + .5) / thick));
  ivec2 s = column == 1 ? ivec2(grid.x / 2, view) : ivec2(view, grid.y / 2);
  vec4 c = seen(column == 1 ? vec2(line, x.y) : vec2(x.x, line), float(s.y * grid.x + s.x));
  result = vec4(c.a > .5 ? c.rgb : vec3(.12), 1);
}`;

const SPACE = COMMON + `
uniform mat4 pose; uniform vec4 camera; uniform vec4 frame; uniform float relief, dot_size, by_error, worst, typical;
// Meters where the camera (focal length, baseline, 1 / focus distance) is known, else a relief.
vec4 placed(vec2 c, float d) {
  vec2 q = c - .5 * vec2(size - 1);
  if (camera.x <= 0.) return pose * vec4(q.x * frame.x, -q.y * frame.x, relief * (d - frame.y) * frame.z, 1);
  float inverse = d / (camera.x * camera.y) + camera.z;
  if (inverse <= 0.) return vec4(0, 0, 9, 1);
  float z = 1. / inverse;
  return pose * vec4(vec3(q.x * z / camera.x, -q.y * z / camera.x, -relief * (z - frame.y)) * frame.x, 1);
}
float dotted(float error) { return by_error > .5 ? dot_size * clamp(sqrt(max(error, 0.) / typical), .6, 5.) : dot_size; }
`;
const DENSE = SPACE + `
out vec3 ink; uniform float center;
void main() {
  vec2 c = vec2(gl_VertexID % size.x, gl_VertexID / size.x);
  vec3 here = mapped(layer, c);
  gl_Position = here.x < UNKNOWN || here.y > worst ? vec4(0, 0, 9, 1) : placed(c, here.x);
  gl_PointSize = dotted(here.y);
  ink = kind == 0 ? seen(c, center).rgb
    : meaning(kind, here.x, here.y, here.z, other < 0 ? -1e9 : disparityAt(other, c));
}`;
const EDGES = SPACE + `
// x y disparity error; then normal and surface vector, or of hidden surfaces their color.
layout(location = 0) in vec4 edge; layout(location = 1) in vec4 arrow;
out vec3 ink; uniform float center, along; uniform int arrows;
void main() {
  vec2 c = edge.xy;
  if (arrows == 1) c += along * float(gl_VertexID) * arrow.xy;
  if (arrows == 2) c += along * float(gl_VertexID) * arrow.zw;
  gl_Position = edge.w > worst ? vec4(0, 0, 9, 1) : placed(c, edge.z);
  gl_PointSize = dotted(edge.w) + 1.;
  if (arrows == 3) // the center view's map knows nothing of it
    ink = kind == 0 ? arrow.rgb : kind > 2 ? vec3(.5) : meaning(kind, edge.z, edge.w, 0., 0.);
  else ink = arrows == 1 ? vec3(.34, .71, .91) : arrows == 2 ? vec3(.9, .62, 0) : kind == 0 ? seen(edge.xy, center).rgb
    : meaning(kind, edge.z, edge.w, mapped(layer, edge.xy).z, other < 0 ? -1e9 : disparityAt(other, edge.xy));
}`;
const CAMERAS = SPACE + `
out vec3 ink; uniform ivec2 grid;
void main() {
  vec2 s = vec2(gl_VertexID % grid.x - grid.x / 2, gl_VertexID / grid.x - grid.y / 2);
  gl_Position = pose * vec4(vec3(s.x * camera.y, -s.y * camera.y, relief * frame.y) * frame.x, 1);
  gl_PointSize = 5.; ink = vec3(.84, .37, 0);
}`;
const INK = `#version 300 es
precision highp float; in vec3 ink; out vec4 result; void main() { result = vec4(ink, 1); }`;
