// The cells of a run in space and time. What is shown stands in the page: a table of contents as JSON
// and packed columns as gzip in base64 (written by viewer/pack.py). No network, no storage.
"use strict";
(async () => {
const root = document.getElementById("viewer");
const find = (name) => root.querySelector(`[data-part="${name}"]`);
const canvas = find("canvas"), status = find("status");
const say = (text) => { status.textContent = text; };
const about = JSON.parse(document.getElementById("viewer-about").textContent);

// ---- data: columns of each frame, as differences from the frame before; see pack.py
async function unpacked(text) {
  const coded = atob(text.trim()), bytes = new Uint8Array(coded.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = coded.charCodeAt(i);
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(plain).arrayBuffer());
}
const KINDS = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };
function allColumns(bytes) {
  let at = 0, before = null;
  return about.frames.map(({ shown: count }) => {
    const columns = {}, from = new Int32Array(count).fill(-1);  // the row of each cell in the frame before
    for (const { name, kind } of about.columns) {
      const values = new KINDS[kind](count), size = values.BYTES_PER_ELEMENT;
      for (let i = 0; i < count; i++) {
        let folded = 0;
        for (let k = 0; k < size; k++) folded |= bytes[at + k * count + i] << (8 * k);
        const change = (folded >>> 1) ^ -(folded & 1);
        if (name === "id") values[i] = change + (i ? values[i - 1] : 0);
        else values[i] = change + (from[i] < 0 ? 0 : before[name][from[i]]);
      }
      at += size * count;
      columns[name] = values;
      if (name !== "id" || !before) continue;
      for (let i = 0, j = 0; i < count; i++) {
        while (j < before.id.length && before.id[j] < values[i]) j++;
        if (before.id[j] === values[i]) from[i] = j;
      }
    }
    return (before = columns);
  });
}
const scaled = (column, level) => column.low + (column.high - column.low) * level / column.top;
const columnOf = Object.fromEntries(about.columns.map((column) => [column.name, column]));

// ---- drawing: each cell is a square that faces the eye, on which a sphere is drawn point by point
// (four corners of their own, not instances of one square: software draws each instance as a call)
const VERTEX = `
in vec4 position; in vec3 colour;
uniform mat4 modelViewMatrix, projectionMatrix; uniform vec2 range;
out vec2 corner; flat out vec3 middle; flat out float size; flat out vec3 tint; flat out float far;
void main() {
  int k = gl_VertexID % 4;
  corner = vec2(k == 1 || k == 2 ? 1.0 : -1.0, k >= 2 ? 1.0 : -1.0);
  float radius = position.w;
  size = radius; tint = colour;
  middle = (modelViewMatrix * vec4(position.xyz, 1.0)).xyz;
  far = 0.72 + 0.28 * clamp((middle.z - range.x) / (range.y - range.x), 0.0, 1.0);
  gl_Position = projectionMatrix * vec4(middle + vec3(corner * radius, 0.0), 1.0);
}`;
const FRAGMENT = `
precision highp float;
in vec2 corner; flat in vec3 middle; flat in float size; flat in vec3 tint; flat in float far;
uniform mat4 projectionMatrix; uniform vec4 plane; uniform bool cutting;
out vec4 shade;
void main() {
  float out2 = dot(corner, corner);
  if (out2 > 1.0) discard;
  float high = sqrt(1.0 - out2);
  float depth = middle.z + size * high;
  // daylight from above, a soft gleam, a darker rim that parts neighbours, and less light further off
  float facing = dot(vec3(corner, high), vec3(0.30, 0.46, 0.836));
  float light = (0.68 + 0.44 * facing) * (0.72 + 0.28 * smoothstep(1.0, 0.72, out2)) * far;
  float gleam = max(facing, 0.0);
  gleam *= gleam; gleam *= gleam; gleam *= gleam;
  gleam *= 0.16 * gleam * far;
  if (cutting) {
    vec2 aside = size * corner;
    float beyond = dot(plane.xy, middle.xy + aside) + plane.z * depth + plane.w;
    if (beyond > 0.0) {  // the near side is cut away: is there a cut face behind it?
      if (plane.z <= 0.0) discard;
      float down = beyond / plane.z;
      if (down > 2.0 * size * high) discard;
      depth -= down;
      float inward = (depth - middle.z) / size;  // the line round the face is where the sphere ends
      light = 0.74 + 0.26 * smoothstep(1.0, 0.8, out2 + inward * inward);
      gleam = 0.0;
    }
  }
  shade = vec4(tint * light + gleam, 1.0);
  gl_FragDepth = 0.5 * (projectionMatrix[2][2] * depth + projectionMatrix[3][2]) + 0.5;  // seen without perspective
}`;

let renderer;
try {
  renderer = new THREE.WebGLRenderer({ canvas, antialias: false, alpha: true });
} catch (error) {
  say("This browser cannot draw in three dimensions (WebGL 2): the pictures below show the same run.");
  root.classList.add("flat");
  return;
}
const frames = about.frames, table = allColumns(await unpacked(document.getElementById("viewer-data").textContent));
const columnsAt = (k) => table[k];
const most = Math.max(1, ...about.frames.map((frame) => frame.shown));

// four corners of each cell that is not hidden behind others, and the two triangles of its square
const geometry = new THREE.BufferGeometry();
const spheres = new THREE.BufferAttribute(new Float32Array(16 * most), 4);
const colours = new THREE.BufferAttribute(new Uint8Array(16 * most), 4, true);
const tints = new Uint32Array(colours.array.buffer);  // a colour as one number
const corners = new Uint32Array(6 * most);
for (let n = 0; n < most; n++) corners.set([0, 1, 2, 0, 2, 3].map((k) => 4 * n + k), 6 * n);
for (const attribute of [spheres, colours]) attribute.setUsage(THREE.StreamDrawUsage);
geometry.setAttribute("position", spheres);
geometry.setAttribute("colour", colours);
geometry.setIndex(new THREE.BufferAttribute(corners, 1));
let drawnCells = 0;
const place = new Float32Array(3 * most), extent = new Float32Array(most), tint = new Uint32Array(most);
const seen = new Float32Array(3 * most), away = new Float32Array(most);  // places as the eye sees them; beyond the cut
const uniforms = { plane: { value: [0, 0, 1, 0] }, cutting: { value: false }, range: { value: [0, 1] } };
const material = new THREE.RawShaderMaterial({
  glslVersion: THREE.GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms,
});
const mesh = new THREE.Mesh(geometry, material);
mesh.frustumCulled = false;
const scene = new THREE.Scene();
scene.add(mesh);
const reach = about.reach, middle = about.middle;
const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, -20 * reach, 20 * reach);
const controls = new THREE.OrbitControls(camera, canvas);
controls.enableDamping = false;
controls.addEventListener("change", draw);

function home() {
  controls.target.set(...middle);
  const tilt = about.flat ? [0, 0, 1] : [0.45, -0.8, 0.4];
  camera.up.set(0, about.flat ? 1 : 0, about.flat ? 0 : 1);
  camera.position.set(...middle.map((x, k) => x + reach * tilt[k]));
  camera.zoom = 1;
  camera.updateProjectionMatrix();
  controls.update();
  draw();
}

// ---- what is shown
let shown = 0, colouring = about.colourings[0].name, pending = false;
function fillColours() {
  const column = columnOf[colouring], values = columnsAt(shown)[colouring];
  const about_ = about.colourings.find((entry) => entry.name === colouring);
  const palette = about_.palette.map((rgb) => rgb.map((c) => Math.round(255 * c)));
  const codes = palette.map(([r, g, b]) => r | (g << 8) | (b << 16));
  if (column.words) {
    for (let i = 0; i < values.length; i++) tint[i] = codes[values[i] % codes.length];
  } else {
    const of = Array.from({ length: column.top + 1 }, (_, level) => {
      if (column.gaps && !level) return GAP;
      const share = (scaled(column, level) - about_.low) / (about_.high - about_.low);
      return codes[Math.round((codes.length - 1) * Math.min(1, Math.max(0, share)))];
    });
    for (let i = 0; i < values.length; i++) tint[i] = of[values[i]];
  }
}
function fillPlaces() {
  const columns = columnsAt(shown), count = frames[shown].shown;
  const unscale = (name, into, k, every) => {
    const values = columns[name], { low } = columnOf[name], step = scaled(columnOf[name], 1) - low;
    for (let i = 0; i < count; i++) into[every * i + k] = low + step * values[i];
  };
  ["x", "y", "z"].forEach((axis, k) => unscale(axis, place, k, 3));
  unscale("radius", extent, 0, 1);
}

// ---- what is hidden behind other cells is not drawn: of a dense ball that is all but its surface.
// Each cell covers the squares of a grid that its disc contains, at the depth of its centre (at that
// of its far end where it is cut); a cell is hidden where something covers every square that it meets.
let cover = new Float32Array(0), everything = false;
function fillVisible() {
  const count = frames[shown].shown, m = camera.matrixWorldInverse.elements;
  const [a, b, c, d] = uniforms.plane.value, cutting = uniforms.cutting.value;
  let low0 = Infinity, low1 = Infinity, high0 = -Infinity, high1 = -Infinity, mean = 0;
  let back = Infinity, front = -Infinity;
  for (let i = 0; i < count; i++) {
    const x = place[3 * i], y = place[3 * i + 1], z = place[3 * i + 2], r = extent[i];
    const u = m[0] * x + m[4] * y + m[8] * z + m[12], v = m[1] * x + m[5] * y + m[9] * z + m[13];
    seen[3 * i] = u; seen[3 * i + 1] = v;
    seen[3 * i + 2] = m[2] * x + m[6] * y + m[10] * z + m[14];
    low0 = Math.min(low0, u - r); high0 = Math.max(high0, u + r);
    low1 = Math.min(low1, v - r); high1 = Math.max(high1, v + r);
    back = Math.min(back, seen[3 * i + 2]); front = Math.max(front, seen[3 * i + 2]);
    away[i] = cutting ? a * u + b * v + c * seen[3 * i + 2] + d : -Infinity;
    mean += r / count;
  }
  uniforms.range.value = [0.5 * (back + front), Math.max(front, back + 1e-6)];
  const step = Math.max(0.4 * mean, (high0 - low0) / 1500, (high1 - low1) / 1500, 1e-6);
  const wide = Math.floor((high0 - low0) / step) + 2, high = Math.floor((high1 - low1) / step) + 2;
  if (cover.length < wide * high) cover = new Float32Array(wide * high);
  cover.fill(-Infinity, 0, wide * high);
  const whole = step * Math.SQRT1_2;
  for (let i = 0; i < count; i++) {
    if (away[i] > extent[i]) continue;
    const u = seen[3 * i], v = seen[3 * i + 1], inner = extent[i] - whole;
    if (inner <= 0) continue;
    let depth = seen[3 * i + 2];
    if (away[i] > -extent[i]) depth -= extent[i];
    const first = Math.max(0, Math.floor((v - inner - low1) / step)), last = Math.floor((v + inner - low1) / step);
    for (let row = first; row <= last; row++) {
      const dy = low1 + (row + 0.5) * step - v, left2 = inner * inner - dy * dy;
      if (left2 <= 0) continue;
      const half = Math.sqrt(left2);
      const from = Math.max(0, Math.ceil((u - half - low0) / step - 0.5)), to = Math.floor((u + half - low0) / step - 0.5);
      for (let at = row * wide + from; at <= row * wide + to; at++) if (cover[at] < depth) cover[at] = depth;
    }
  }
  let n = 0;
  const list = spheres.array;
  for (let i = 0; i < count; i++) {
    if (away[i] > extent[i]) continue;
    const r = extent[i], near = seen[3 * i + 2] + r;
    const row0 = Math.floor((seen[3 * i + 1] - r - low1) / step), row1 = Math.floor((seen[3 * i + 1] + r - low1) / step);
    const from = Math.floor((seen[3 * i] - r - low0) / step), to = Math.floor((seen[3 * i] + r - low0) / step);
    let hidden = true;
    for (let row = row0; hidden && row <= row1; row++)
      for (let at = row * wide + from; at <= row * wide + to; at++) if (cover[at] < near) { hidden = false; break; }
    if (hidden && !everything) continue;
    for (let k = 4 * n; k < 4 * n + 4; k++) {
      tints[k] = tint[i];
      list[4 * k] = place[3 * i]; list[4 * k + 1] = place[3 * i + 1]; list[4 * k + 2] = place[3 * i + 2];
      list[4 * k + 3] = r;
    }
    n++;
  }
  for (const attribute of [spheres, colours]) {
    attribute.clearUpdateRanges();
    attribute.addUpdateRange(0, 16 * n);
    attribute.needsUpdate = true;
  }
  geometry.setDrawRange(0, 6 * n);
  drawnCells = n;
}
function countsOf(name) {  // of all cells, also those that are not drawn; of clones these are unknown
  const known = frames[shown].groups[name];
  if (known) return known;
  const counts = [];
  for (const value of columnsAt(shown)[name]) counts[value] = (counts[value] ?? 0) + 1;
  return counts;
}
function legend() {
  const about_ = about.colourings.find((entry) => entry.name === colouring), box = find("legend");
  box.textContent = "";
  const column = columnOf[colouring];
  if (column.words) {
    const counts = countsOf(colouring);
    column.words.forEach((word, k) => {
      if (!counts[k]) return;
      const entry = document.createElement("span"), dot = document.createElement("i");
      dot.style.background = `rgb(${about_.palette[k].map((c) => Math.round(255 * c)).join()})`;
      entry.append(dot, `${word} (${counts[k].toLocaleString("en")})`);
      box.append(entry);
    });
    if (about_.hint) box.append(about_.hint);
    return;
  }
  const bar = document.createElement("span"), shades = document.createElement("b");
  const stops = about_.palette.map((rgb) => `rgb(${rgb.map((c) => Math.round(255 * c)).join()})`);
  shades.style.background = `linear-gradient(to right, ${stops.join()})`;
  const number = (value) => Number(value.toPrecision(3)).toString();
  bar.append(number(about_.low), shades, `${number(about_.high)} ${about_.unit}`);
  box.append(bar);
  if (column.gaps) box.append("grey: cells without it");
}
function tell() {
  const frame = frames[shown];
  const thinned = frame.shown < frame.cells ? ` (${frame.shown.toLocaleString("en")} of them drawn)` : "";
  const text = `${frame.label}: ${frame.cells.toLocaleString("en")} cell${frame.cells === 1 ? "" : "s"}${thinned}`;
  say(text);
  canvas.setAttribute("aria-label", `The cells in space, ${text}, coloured by ${colouring}`);
}
function show(k) {
  shown = Math.min(frames.length - 1, Math.max(0, k));
  find("time").value = shown;
  find("time").setAttribute("aria-valuetext", frames[shown].label);
  fillPlaces(); fillColours(); legend(); tell(); follow(); setPlane(); draw();
}
function setPlane() {
  const axis = find("axis").value, slider = find("cut");
  slider.disabled = axis === "none";
  uniforms.cutting.value = axis !== "none";
  find("cut-text").textContent = "";
  if (axis === "none") return;
  const k = "xyz".indexOf(axis), at = middle[k] + reach * (2 * slider.value / 1000 - 1);
  const side = camera.position.toArray()[k] >= middle[k] ? 1 : -1;  // what lies nearer to the eye goes
  find("cut-text").textContent = `${axis} = ${Math.round(at) || 0} µm`;
  cut = { k, at, side };
}
let cut = null;
function planeInView() {
  if (!uniforms.cutting.value || !cut) return;
  const normal = [0, 0, 0];
  normal[cut.k] = cut.side;
  const m = camera.matrixWorldInverse.elements;
  const turn = (v) => [0, 1, 2].map((r) => m[r] * v[0] + m[r + 4] * v[1] + m[r + 8] * v[2]);
  const n = turn(normal), place = [...middle];
  place[cut.k] = cut.at;
  const p = turn(place).map((x, r) => x + m[12 + r]);
  uniforms.plane.value = [...n, -(n[0] * p[0] + n[1] * p[1] + n[2] * p[2])];
}
let size = { wide: 1, high: 1 };  // of the canvas where it was last seen, in px
function resize() {
  const wide = canvas.clientWidth, high = canvas.clientHeight;
  if (!wide || !high) return;
  size = { wide, high };
  renderer.setSize(wide, high, false);
  const half = 1.08 * reach, ratio = wide / high;
  camera.left = -half * Math.max(1, ratio); camera.right = -camera.left;
  camera.top = half * Math.max(1, 1 / ratio); camera.bottom = -camera.top;
  camera.updateProjectionMatrix();
  draw();
}
// ---- a bar of a round length in the lower left corner, and where x, y and z point in the lower right
const SVG = "http://www.w3.org/2000/svg";
function part(parent, kind, attributes, text) {
  const made = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  parent.append(made);
  return made;
}
const axes = ["x", "y", "z"].map((name) => ({
  line: part(find("axes"), "line", { x1: 0, y1: 0 }), name: part(find("axes"), "text", {}, name),
}));
function barLength() {  // a third of the width at most: its length in µm and as a part of the width
  const wide = (camera.right - camera.left) / camera.zoom, ten = 10 ** Math.floor(Math.log10(wide / 3));
  const length = ten * [5, 2, 1].find((n) => n * ten <= wide / 3);
  return { length, part: length / wide };
}
function marks() {
  const bar = barLength(), m = camera.matrixWorldInverse.elements;
  find("bar").style.width = `${100 * bar.part}%`;
  find("bar").textContent = `${bar.length} µm`;
  axes.forEach(({ line, name }, k) => {
    const right = m[4 * k], down = -m[4 * k + 1], far = Math.hypot(right, down) < 0.05;
    line.setAttribute("x2", 26 * right); line.setAttribute("y2", 26 * down);
    name.setAttribute("x", 36 * right); name.setAttribute("y", 36 * down);
    for (const mark of [line, name]) mark.style.display = far ? "none" : "";
  });
}
function picture() {  // the cells with their time, bar and colours, for files and for paper
  const sheet = find("still"), ink = sheet.getContext("2d"), scale = 2 * screen(), { wide, high: low } = size;
  const entries = [...find("legend").children], aside = (wide - 28) / 3;
  sheet.width = scale * wide; sheet.height = scale * (low + 30 + 24 * Math.ceil(entries.length / 3));
  renderer.setPixelRatio(scale);
  planeInView(); fillVisible();
  renderer.render(scene, camera);
  ink.fillStyle = "#fff"; ink.fillRect(0, 0, sheet.width, sheet.height);
  ink.drawImage(canvas, 0, 0);
  ink.scale(scale, scale);
  ink.font = "15px system-ui, sans-serif"; ink.fillStyle = "#22303c";
  const bar = barLength();
  ink.fillRect(14, low - 16, bar.part * wide, 4);
  ink.fillText(`${bar.length} µm`, 14, low - 23);
  ink.fillText(status.textContent, 14, low + 18);
  entries.forEach((entry, k) => {
    const x = 14 + (k % 3) * aside, y = low + 42 + 24 * Math.floor(k / 3);
    if (entry.querySelector("i")) {
      ink.fillStyle = entry.querySelector("i").style.background;
      ink.beginPath(); ink.arc(x + 6, y - 5, 6, 0, 7); ink.fill();
    }
    ink.fillStyle = "#22303c"; ink.fillText(entry.textContent, x + 18, y, aside - 24);
  });
  return sheet;
}
function draw() {
  if (pending) return;
  pending = true;
  requestAnimationFrame(() => {
    pending = false;
    resolution(still ? Math.max(2, screen()) : screen() * sharpness);
    camera.updateMatrixWorld();
    if (cut && uniforms.cutting.value) {
      cut.side = camera.position.toArray()[cut.k] >= middle[cut.k] ? 1 : -1;
    }
    planeInView();
    fillVisible();
    renderer.render(scene, camera);
    marks();
    drawn += 1;
    const now = performance.now();
    settle(now - before);  // a call may return long before its picture is there: pictures are counted
    before = now;
  });
}
let drawn = 0, before = 0;

// ---- moving pictures are as coarse as they must be to follow the hand; still ones are drawn twice as
// fine as the screen, which makes edges smooth
let sharpness = 1, quick = 0, still = false, rest = null;
const screen = () => Math.min(2, window.devicePixelRatio || 1);
function resolution(ratio) {
  if (renderer.getPixelRatio() !== ratio) renderer.setPixelRatio(ratio);
}
function settle(took) {
  clearTimeout(rest);
  if (still) { still = false; return; }
  if (took < 300) {  // it moves
    quick = took < 20 ? quick + 1 : 0;
    if (took > 40) sharpness = Math.max(0.42, 0.75 * sharpness);
    else if (quick > 30) { sharpness = Math.min(1, sharpness / 0.75); quick = 0; }
  }
  rest = setTimeout(() => { still = true; draw(); }, 250);
}

// ---- under the pointer
function pick(event) {
  const box = canvas.getBoundingClientRect();
  const x = ((event.clientX - box.left) / box.width) * 2 - 1, y = 1 - ((event.clientY - box.top) / box.height) * 2;
  const m = camera.matrixWorldInverse.elements, count = frames[shown].shown;
  const px = (x * (camera.right - camera.left)) / 2 / camera.zoom, py = (y * (camera.top - camera.bottom)) / 2 / camera.zoom;
  const [a, b, c, d] = uniforms.plane.value;
  let best = -1, nearest = -Infinity;
  for (let i = 0; i < count; i++) {
    const cx = place[3 * i], cy = place[3 * i + 1], cz = place[3 * i + 2];
    const vx = m[0] * cx + m[4] * cy + m[8] * cz + m[12], vy = m[1] * cx + m[5] * cy + m[9] * cz + m[13];
    const out2 = (px - vx) ** 2 + (py - vy) ** 2, r = extent[i];
    if (out2 > r * r) continue;
    const half = Math.sqrt(r * r - out2);
    const vz = m[2] * cx + m[6] * cy + m[10] * cz + m[14];
    let z = vz + half;
    if (uniforms.cutting.value) {
      const beyond = a * px + b * py + c * z + d;
      if (beyond > 0) {
        if (c <= 0 || beyond / c > 2 * half) continue;
        z -= beyond / c;
      }
    }
    if (z > nearest) { nearest = z; best = i; }
  }
  return best;
}
const tip = find("tip");
canvas.addEventListener("pointermove", (event) => {
  const i = event.buttons ? -1 : pick(event);
  tip.hidden = i < 0;
  if (i < 0) return;
  const columns = columnsAt(shown), lines = [];
  for (const column of about.columns) {
    if (column.hidden) continue;
    const value = columns[column.name][i];
    let text;
    if (column.words) text = column.words[value] ?? String(value);
    else if (column.name === "id") text = String(value);
    else if (column.gaps && !value) text = "none";
    else text = `${Number(scaled(column, value).toPrecision(3))} ${column.unit}`;
    lines.push(`${column.label}: ${text}`);
  }
  tip.textContent = lines.join("\n");
  const box = root.querySelector(".stage").getBoundingClientRect();
  tip.style.left = `${Math.min(event.clientX - box.left + 14, box.width - 180)}px`;
  tip.style.top = `${event.clientY - box.top + 14}px`;
});
canvas.addEventListener("pointerleave", () => { tip.hidden = true; });

// ---- curves that follow the time
const charts = about.curves.map((curve) => {
  const svg = document.createElementNS(SVG, "svg");
  const wide = 320, high = 130, left = 6, top = 22, bottom = 18;
  svg.setAttribute("viewBox", `0 0 ${wide} ${high}`);
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", `${curve.label} over time`);
  const last = about.end || 1, known = curve.values.filter((v) => v !== null);
  const least = Math.min(0, ...known), range = Math.max(1e-12, ...known) - least;  // pressure may be a pull
  const px = (t) => left + (wide - 2 * left) * t / last;
  const py = (v) => high - bottom - (high - bottom - top) * (v - least) / range;
  let path = "", open = false;
  curve.values.forEach((v, k) => {
    if (v === null) { open = false; return; }
    path += `${open ? "L" : "M"}${px(about.times[k]).toFixed(1)},${py(v).toFixed(1)}`;
    open = true;
  });
  const make = (kind, attributes, text) => part(svg, kind, attributes, text);
  make("line", { x1: left, x2: wide - left, y1: py(0), y2: py(0), class: "axis" });
  make("path", { d: path, class: "curve" });
  const line = make("line", { y1: top - 4, y2: high - bottom, class: "now" });
  make("text", { x: left, y: 13 }, curve.label);
  const value = make("text", { x: wide - left, y: 13, "text-anchor": "end", class: "value" }, "");
  make("text", { x: left, y: high - 4, class: "small" }, "0");
  make("text", { x: wide - left, y: high - 4, "text-anchor": "end", class: "small" }, about.end_label);
  find("curves").append(svg);
  svg.addEventListener("click", (event) => {  // to the frame next to the place
    const box = svg.getBoundingClientRect(), t = last * ((event.clientX - box.left) / box.width * wide - left) / (wide - 2 * left);
    const off = (frame) => Math.abs(frame.time - t);
    stop(); show(frames.reduce((best, frame, k) => (off(frame) < off(frames[best]) ? k : best), 0));
  });
  return { curve, line, value, px };
});
const exact = new Intl.NumberFormat("en", { maximumSignificantDigits: 4 });
function follow() {
  const { time, point } = frames[shown];
  for (const { curve, line, value, px } of charts) {
    line.setAttribute("x1", px(time)); line.setAttribute("x2", px(time));
    const now = point === null ? null : curve.values[point];
    value.textContent = now === null ? "none" : Number.isInteger(now) ? `${now.toLocaleString("en")} ${curve.unit}` : `${exact.format(now)} ${curve.unit}`;
  }
}

// ---- controls
for (const entry of about.colourings) {
  const option = document.createElement("option");
  option.value = entry.name; option.textContent = entry.label;
  find("colour").append(option);
}
find("time").max = frames.length - 1;
find("time").addEventListener("input", (event) => { stop(); show(Number(event.target.value)); });
find("colour").addEventListener("change", (event) => { colouring = event.target.value; show(shown); });
find("axis").addEventListener("change", () => { setPlane(); draw(); });
find("cut").addEventListener("input", () => { setPlane(); draw(); });
find("home").addEventListener("click", home);
let playing = false, due = 0;
function stop() { playing = false; find("play").textContent = "Play"; }
function play() {
  if (playing) { stop(); return; }
  if (shown === frames.length - 1) show(0);
  playing = true; due = performance.now(); find("play").textContent = "Pause";
  requestAnimationFrame(advance);
}
function advance(now) {  // where a frame takes longer than it is due, the next one waits for it
  if (!playing) return;
  const every = 1000 / Number(find("speed").value);
  if (now >= due + every) {
    due = Math.max(due + every, now - every);
    show(shown + 1);
    if (shown === frames.length - 1) { stop(); return; }
  }
  requestAnimationFrame(advance);
}
find("play").addEventListener("click", play);
document.addEventListener("keydown", (event) => {  // in fields and buttons space has a meaning of its own
  if (event.key !== " " || event.target.closest("button, select, summary, a, input:not([type=range])")) return;
  event.preventDefault();
  play();
});
find("picture").addEventListener("click", () => picture().toBlob((blob) => {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = `cells ${frames[shown].label}.png`;
  link.click();
  URL.revokeObjectURL(link.href);
  draw();
}));
find("full").hidden = !document.fullscreenEnabled;
find("full").addEventListener("click", () => (document.fullscreenElement ? document.exitFullscreen() : root.requestFullscreen()));
// where it is printed the page shows a still: the canvas itself would be empty
const paper = window.matchMedia("print");
paper.addEventListener("change", () => { if (paper.matches) picture(); else draw(); });
function orbit(right, up) {
  const { x, y, z } = camera.position.clone().sub(controls.target);
  const cos = Math.cos(right), sin = Math.sin(right);
  const turned = about.flat ? [x, y, z] : [cos * x - sin * y, sin * x + cos * y, z];
  const length = Math.hypot(...turned), flat = Math.hypot(turned[0], turned[1]) || 1e-9;
  const angle = Math.min(1.5, Math.max(-1.5, Math.atan2(turned[2], flat) + (about.flat ? 0 : up)));
  const share = (length * Math.cos(angle)) / flat;
  if (!about.flat) camera.position.set(turned[0] * share, turned[1] * share, length * Math.sin(angle)).add(controls.target);
  controls.update();
  draw();
}
canvas.addEventListener("keydown", (event) => {
  const turn = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
  if (turn) orbit(...turn);
  else if (event.key === "+" || event.key === "=" || event.key === "-") {
    camera.zoom *= event.key === "-" ? 0.9 : 1 / 0.9;
    camera.updateProjectionMatrix(); draw();
  } else return;
  event.preventDefault();
});
new ResizeObserver(resize).observe(canvas);
root.classList.add("ready");
resize();
if (!about.flat) find("axis").value = "y";  // cut open towards the eye
show(frames.length - 1);
home();
window.multicellViewer = {  // for tests
  show, home, orbit, pick, frames, canvas, play, across: () => (camera.right - camera.left) / camera.zoom, draws: () => drawn, visible: () => drawnCells, sharpness: () => sharpness,
  all: (yes) => { everything = yes; draw(); },
};
})();
