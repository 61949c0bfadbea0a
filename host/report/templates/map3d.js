// Draws the maps of #data in space and two sections of the chosen part. Lengths in mm, deviations in µm; z of the tool is upright.
const by = (id) => document.getElementById(id);
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const shorts = (text) => new Int16Array(bytes(text).buffer);
const number = (value, digits = 1) => value.toFixed(digits).replace("-", "\u2212");
const add = (a, b, k = 1) => [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const ABSENT = -32768;
const MOST_MARKS = 24;
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

const CELLS = `#version 300 es
uniform mat3 axes; uniform vec3 target; uniform vec2 scale; uniform vec4 depth; uniform vec2 cut; uniform bool bore;
in vec3 middle; in vec3 across; in vec3 down; in vec2 value;
flat out float share; flat out int id; out float shade; out float near;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  // Slightly larger than the cell, so that rounding leaves no cracks.
  vec3 seen = (middle + 1.02 * (corner.x * across + corner.y * down) - target) * axes;
  vec3 towards = vec3(axes[2]);
  share = value.x; id = gl_InstanceID + 1; near = seen.z;
  shade = 0.82 + 0.18 * abs(dot(normalize(cross(across, down) + 1e-12), towards));
  gl_Position = vec4(seen.xy * scale, -seen.z * depth.x, 1.0);
  bool hidden = cut.x > 0.5 && value.y > cut.y || bore && dot(middle.xy, towards.xy) > 0.25 * length(middle.xy);
  if (hidden) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
}`;
const COLOURS = `#version 300 es
precision highp float; precision highp int;
uniform sampler2D colours; uniform vec3 unseen[2]; uniform bool picking; uniform vec4 depth;
flat in float share; flat in int id; in float shade; in float near; out vec4 colour;
void main() {
  if (near > depth.y) discard;
  if (picking) { colour = vec4(ivec4(id, id >> 8, id >> 16, 255) & 255) / 255.0; return; }
  float last = float(textureSize(colours, 0).x - 1);
  vec3 of = share > 1.5 ? unseen[int(share) - 2] : texelFetch(colours, ivec2(int(0.5 + 0.5 * last * (clamp(share, -1.0, 1.0) + 1.0)), 0), 0).rgb;
  colour = vec4(of * shade, 1.0);
}`;
const LINES = `#version 300 es
uniform mat3 axes; uniform vec3 target; uniform vec2 scale; uniform vec4 depth; uniform vec2 shift;
in vec3 middle; out float near;
void main() {
  vec3 seen = (middle - target) * axes;
  near = seen.z;
  gl_Position = vec4(seen.xy * scale + shift, -(seen.z + depth.z) * depth.x, 1.0);
}`;
const INK = `#version 300 es
precision highp float; uniform vec4 ink; uniform vec4 depth; in float near; out vec4 colour;
void main() { if (near > depth.y) discard; colour = ink; }`;

// Cells by number, with grid, column and row; arrays for the GPU: middle, half a cell across and down, share of the scale, height.
function cellsOf(data) {
  const [middles, deviations] = [shorts(data.middles), shorts(data.deviations)];
  const at = (cell) => (middles[3 * cell] === ABSENT ? null : [0, 1, 2].map((k) => data.origin_mm[k] + data.step_mm * middles[3 * cell + k]));
  const cells = [];
  let first = 0;
  for (const grid of data.grids) {
    const columns = grid.along_mm.length;
    const um = (row, column) => { const stored = deviations[grid.first + row * columns + column]; return stored === ABSENT ? null : stored * data.step_um; };
    Object.assign(grid, { first, um, height: (row) => grid.up_mm[0] + row * grid.up_mm[1] });
    const place = (row, column) => (row < 0 || column < 0 || row >= grid.rows || column >= columns ? null : at(grid.first + row * columns + column));
    grid.place = place;
    // Half of the distance between neighbours on both sides, or to the only one.
    const half = (here, before, after) => (before && after ? add(after, before, -1).map((c) => c / 4) : after ? add(after, here, -1).map((c) => c / 2) : before ? add(here, before, -1).map((c) => c / 2) : null);
    for (let row = 0; row < grid.rows; row++) for (let column = 0; column < columns; column++) {
      const here = place(row, column);
      if (!here) continue;
      const down = half(here, place(row - 1, column), place(row + 1, column)) || [0, 0, grid.up_mm[1] / 2];
      // A lone column is as wide as high, around the axis.
      const r = Math.hypot(here[0], here[1]) || 1;
      const across = half(here, place(row, column - 1), place(row, column + 1)) || [-here[1] / r, here[0] / r, 0].map((c) => (c * Math.hypot(...down)));
      cells.push({ grid, row, column, here, across, down, um: um(row, column) });
    }
    first += grid.rows * columns;
  }
  const array = new Float32Array(11 * cells.length);
  cells.forEach((cell, i) => {
    const share = cell.um === null ? 2 + ((cell.row + cell.column) % 3 ? 1 : 0) : cell.um / data.full_um;
    array.set([...cell.here, ...cell.across, ...cell.down, clamp(share, cell.um === null ? 2 : -1, cell.um === null ? 3 : 1), cell.grid.height(cell.row)], 11 * i);
  });
  return { cells, array };
}

function linesOf(data) {
  const stored = shorts(data.lines);
  return Float32Array.from(stored, (value, i) => data.origin_mm[i % 3] + data.step_mm * value);
}

function show(data) {
  const canvas = document.querySelector("canvas");
  const gl = canvas.getContext("webgl2", { antialias: true });
  const { cells, array } = cellsOf(data);
  if (!gl || !cells.length) {
    by("with").hidden = true;
    by("without").hidden = false;
    return;
  }
  const lines = linesOf(data);
  const program = (vertex, fragment) => {
    const linked = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(linked, shader);
    }
    gl.linkProgram(linked);
    if (!gl.getProgramParameter(linked, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(linked));
    const places = {};
    const uniform = (name) => (places[name] ??= gl.getUniformLocation(linked, name));
    return { linked, uniform };
  };
  const [surface, wire] = [program(CELLS, COLOURS), program(LINES, INK)];
  const attributes = (of, names, values) => {
    const object = gl.createVertexArray();
    const buffer = gl.createBuffer();
    gl.bindVertexArray(object);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
    const stride = 4 * names.reduce((sum, [, size]) => sum + size, 0);
    let offset = 0;
    for (const [name, size] of names) {
      const place = gl.getAttribLocation(of.linked, name);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, stride, offset);
      if (names.length > 1) gl.vertexAttribDivisor(place, 1);
      offset += 4 * size;
    }
    return { object, buffer };
  };
  const faces = attributes(surface, [["middle", 3], ["across", 3], ["down", 3], ["value", 2]], array);
  const outline = attributes(wire, [["middle", 3]], lines);
  const marked = attributes(wire, [["middle", 3]], new Float32Array(3));
  let [markedRuns, markedHalf] = [[], 0];
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  const colours = bytes(data.colours);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, colours.length / 3, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, colours);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  // What is under the pointer is found by drawing the cells' numbers into a picture of their own.
  const pick = gl.createFramebuffer();
  const [numbers, depths] = [gl.createRenderbuffer(), gl.createRenderbuffer()];

  // Centre, half of the size, and upper end of some points.
  const extent = (points) => {
    const [low, high] = [[0, 1, 2].map((k) => points.reduce((m, p) => Math.min(m, p[k]), Infinity)), [0, 1, 2].map((k) => points.reduce((m, p) => Math.max(m, p[k]), -Infinity))];
    return { middle: add(low, high).map((c) => c / 2), half: Math.hypot(...add(high, low, -1)) / 2, top: high[2] };
  };
  const ofPart = data.parts.map(() => []);
  for (const cell of cells) if (cell.grid.part !== null) ofPart[cell.grid.part].push(cell);
  const outlinePoints = Array.from({ length: lines.length / 3 }, (_, i) => [...lines.subarray(3 * i, 3 * i + 3)]);
  const everything = [...cells.map((cell) => cell.here), ...outlinePoints];
  const all = extent(everything);
  const groups = new Map();
  data.parts.forEach((part, i) => groups.set(part.mark, [...(groups.get(part.mark) || []), i]));
  const marks = [...groups].map(([mark, parts]) => ({ mark, parts, ...extent(parts.flatMap((i) => ofPart[i].map((cell) => cell.here))) })).filter((of) => of.half >= 0);
  const order = ["no-go", "warn", "indeterminate", "go", null];
  const least = ofPart.map((own) => own.reduce((m, cell) => Math.min(m, cell.um ?? 0), 0));
  const ranked = data.parts.map((_, i) => i).filter((i) => ofPart[i].length).sort((a, b) => order.indexOf(data.parts[a].verdict) - order.indexOf(data.parts[b].verdict) || least[a] - least[b]);
  const view = { yaw: 0, pitch: 0.5, mm: 1, middle: all.middle };
  let chosen = null;

  const axes = () => {
    const [sy, cy, sp, cp] = [Math.sin(view.yaw), Math.cos(view.yaw), Math.sin(view.pitch), Math.cos(view.pitch)];
    return [[-sy, cy, 0], [-sp * cy, -sp * sy, cp], [cp * cy, cp * sy, sp]];
  };
  const lookFrom = (towards) => {
    view.yaw = Math.atan2(towards[1], towards[0]);
    view.pitch = clamp(Math.atan2(towards[2], Math.hypot(towards[0], towards[1])), -1.55, 1.55);
  };
  // These points fill this share of the picture.
  const fit = (points, middle, share) => {
    const [right, up] = axes();
    const aspect = canvas.clientWidth / canvas.clientHeight;
    const reach = points.reduce((most, point) => { const off = add(point, middle, -1); return Math.max(most, Math.abs(dot(off, up)), Math.abs(dot(off, right)) / aspect); }, 0.1);
    Object.assign(view, { middle, mm: reach / share });
    redraw();
  };
  const whole = () => { view.pitch = 0.75; fit(everything, all.middle, 0.92); };
  const focus = (part) => {
    const points = ofPart[part].map((cell) => cell.here);
    const { middle } = extent(points);
    const out = data.parts[part].outward;
    const [x, y] = middle;
    const away = [x / (Math.hypot(x, y) || 1), y / (Math.hypot(x, y) || 1), 0];
    const along = dot(out, away);
    // The next tooth would hide a flank that is seen along its normal.
    const aside = Math.abs(along) < 0.7 ? 1.2 * Math.sign(along) : 0;
    lookFrom(add(add(out, away, aside), [0, 0, 0.45]));
    fit(points, middle, 0.75);
  };
  const reset = () => (data.bore || !ranked.length ? (lookFrom(data.bore && ranked.length ? ofPart[ranked[0]][0].here.map((c, k) => (k < 2 ? -c : 0)) : [1, 0.4, 0]), whole()) : focus(ranked[0]));

  let waiting = false;
  const redraw = () => {
    if (!waiting) requestAnimationFrame(draw);
    waiting = true;
  };
  const place = (of, frame) => {
    const aspect = canvas.width / canvas.height;
    gl.useProgram(of.linked);
    gl.uniformMatrix3fv(of.uniform("axes"), false, frame.flat());
    gl.uniform3fv(of.uniform("target"), view.middle);
    gl.uniform2f(of.uniform("scale"), 1 / (view.mm * aspect), 1 / view.mm);
    // Depth per mm; what stands farther towards the viewer is left out; lines lie in front of the faces.
    gl.uniform4f(of.uniform("depth"), 0.3 / all.half, 3 * view.mm, 0.02 * view.mm, 0);
  };
  const drawFaces = (frame, picking) => {
    place(surface, frame);
    gl.uniform2f(surface.uniform("cut"), by("cut").checked ? 1 : 0, +by("height").value + 1e-6);
    gl.uniform1i(surface.uniform("bore"), data.bore ? 1 : 0);
    gl.uniform1i(surface.uniform("picking"), picking ? 1 : 0);
    gl.uniform1i(surface.uniform("colours"), 0);
    gl.uniform3fv(surface.uniform("unseen"), data.unmeasured.flat().map((c) => c / 255));
    gl.bindVertexArray(faces.object);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, cells.length);
  };
  const rgb = (name) => { const hex = getComputedStyle(document.documentElement).getPropertyValue(name).trim(); return [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255); };
  const drawLines = (of, runs, frame, name, thick) => {
    place(wire, frame);
    gl.uniform4f(wire.uniform("ink"), ...rgb(name), 1);
    gl.bindVertexArray(of.object);
    for (let i = -thick; i <= thick; i++) for (let k = -thick; k <= thick; k++) {
      gl.uniform2f(wire.uniform("shift"), (2 * i) / canvas.width, (2 * k) / canvas.height);
      let first = 0;
      for (const count of runs) { gl.drawArrays(gl.LINE_STRIP, first, count); first += count; }
    }
  };
  const draw = () => {
    waiting = false;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((px) => Math.max(1, Math.round(px * devicePixelRatio)));
    if (canvas.width !== width || canvas.height !== height) {
      [canvas.width, canvas.height] = [width, height];
      for (const [buffer, format] of [[numbers, gl.RGBA8], [depths, gl.DEPTH_COMPONENT24]]) {
        gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
        gl.renderbufferStorage(gl.RENDERBUFFER, format, width, height);
      }
      gl.bindFramebuffer(gl.FRAMEBUFFER, pick);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, numbers);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depths);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    const frame = axes();
    drawFaces(frame, false);
    drawLines(outline, data.line_points, frame, "--muted", 0);
    // Thick lines would cover a flank that is seen from afar.
    drawLines(marked, markedRuns, frame, "--ink", markedHalf > 0.3 * view.mm ? 1 : 0);
    const shown = marks.length <= MOST_MARKS ? marks : marks.filter((of) => of.parts.includes(chosen));
    document.querySelector(".marks").replaceChildren(...shown.flatMap((of) => {
      const seen = add([of.middle[0], of.middle[1], of.top], view.middle, -1);
      const [x, y, near] = frame.map((axis) => dot(axis, seen));
      const at = [50 + (50 * x * height) / (view.mm * width), 50 - (50 * y) / view.mm];
      if (near > 3 * view.mm || at.some((share) => share < 1 || share > 99)) return [];
      const span = document.createElement("span");
      span.textContent = of.mark;
      span.style.left = at[0] + "%";
      span.style.top = `calc(${at[1]}% - 14px)`;
      return [span];
    }));
  };
  const under = (event) => {
    const box = canvas.getBoundingClientRect();
    const [x, y] = [Math.floor((event.clientX - box.left) * (canvas.width / box.width)), Math.floor((box.bottom - event.clientY) * (canvas.height / box.height))];
    gl.bindFramebuffer(gl.FRAMEBUFFER, pick);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(x, y, 1, 1);
    drawFaces(axes(), true);
    const pixel = new Uint8Array(4);
    gl.readPixels(x, y, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    gl.disable(gl.SCISSOR_TEST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return cells[pixel[0] + 256 * pixel[1] + 65536 * pixel[2] - 1];
  };

  const note = document.createElement("output");
  note.className = "note";
  document.body.append(note);
  const say = (event, text) => {
    note.textContent = text;
    note.style.left = Math.max(4, Math.min(event.pageX + 12, document.documentElement.clientWidth - 240)) + "px";
    note.style.top = event.pageY + 16 + "px";
    note.style.display = text ? "block" : "none";
  };
  const deviation = (um) => (um === null ? "not seen" : `${um > 0 ? "+" : ""}${number(um)} µm (${um < 0 ? "missing" : "proud"})`);
  const where = (cell) => `${number(cell.grid.along_mm[cell.column], 2)} mm along, ${number(cell.grid.height(cell.row), 2)} ${data.axes[1]}`;
  const sayCell = (event, cell) => {
    const part = cell && data.parts[cell.grid.part];
    say(event, cell ? [part ? part.name : "between the flanks", "deviation " + deviation(cell.um), "at " + where(cell), part && part.wear, part && part.verdict].filter(Boolean).join(" · ") : "");
  };

  // The sections: deviations of the chosen part along the profile at one height, and up at one place of the profile.
  const rowAt = (grid, height) => {
    const row = Math.round((height - grid.up_mm[0]) / grid.up_mm[1]);
    return row < 0 || row >= grid.rows ? [] : grid.along_mm.map((along, column) => ({ grid, row, column, at: along }));
  };
  const columnAt = (grid, along) => {
    const [first, last] = [grid.along_mm[0], grid.along_mm[grid.along_mm.length - 1]];
    const cell = (last - first) / Math.max(1, grid.along_mm.length - 1);
    if (along < first - cell || along > last + cell) return [];
    const column = grid.along_mm.reduce((best, mm, i) => (Math.abs(mm - along) < Math.abs(grid.along_mm[best] - along) ? i : best), 0);
    return Array.from({ length: grid.rows }, (_, row) => ({ grid, row, column, at: grid.height(row) }));
  };
  const section = () => {
    const [height, along] = [+by("height").value, +by("along").value];
    by("height-at").textContent = `${number(height, 2)} ${data.axes[1]}`;
    by("along-at").textContent = `${number(along, 2)} mm along`;
    const grids = chosen === null ? [] : data.grids.filter((grid) => grid.part === chosen);
    const [rows, columns] = [grids.map((grid) => rowAt(grid, height)), grids.map((grid) => columnAt(grid, along))];
    // Borders of the chosen part, and the lines of the sections.
    const runs = [];
    for (const grid of grids) {
      const [last, end] = [grid.along_mm.length - 1, grid.rows - 1];
      const span = (count, at) => Array.from({ length: count + 1 }, (_, i) => at(i));
      runs.push([...span(last, (i) => grid.place(0, i)), ...span(end, (i) => grid.place(i, last)), ...span(last, (i) => grid.place(end, last - i)), ...span(end, (i) => grid.place(end - i, 0))]);
    }
    for (const line of [...rows, ...columns]) runs.push(line.map(({ grid, row, column }) => grid.place(row, column)));
    const kept = runs.map((run) => run.filter(Boolean));
    markedRuns = kept.map((run) => run.length);
    markedHalf = extent(kept.flat()).half;
    gl.bindBuffer(gl.ARRAY_BUFFER, marked.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(kept.flat(2)), gl.DYNAMIC_DRAW);
    const points = (lines) => lines.flat().map(({ grid, row, column, at }) => [at, grid.um(row, column)]).sort((a, b) => a[0] - b[0]);
    const [profile, lead] = [points(rows), points(columns)];
    // One scale for both.
    const reach = 1.1 * Math.max(10, ...(data.limits_um || []), ...[...profile, ...lead].map(([, um]) => Math.abs(um ?? 0)));
    chart(by("profile"), profile, data.axes[0], along, reach);
    chart(by("lead"), lead, "up / mm", height, reach);
    redraw();
  };
  // `other` is where the other section crosses.
  const chart = (box, points, axis, other, reach) => {
    const seen = points.filter(([, um]) => um !== null);
    if (!seen.length) {
      box.textContent = chosen === null ? "" : "Nothing was seen along this line.";
      return;
    }
    const [wide, high, left, right, top, bottom] = [Math.max(280, box.clientWidth), 230, 46, 40, 12, 38];
    const [from, to] = [points[0][0], Math.max(points[points.length - 1][0], points[0][0] + 1e-3)];
    const limits = data.limits_um || [0, 0];
    const x = (along) => left + ((along - from) / (to - from)) * (wide - left - right);
    const y = (um) => top + ((reach - um) / (2 * reach)) * (high - top - bottom);
    const step = (range, count) => { const raw = range / count, size = 10 ** Math.floor(Math.log10(raw)); return [1, 2, 5, 10].map((m) => m * size).find((s) => s >= raw); };
    const ticks = (low, end, every) => Array.from({ length: Math.floor(end / every) - Math.ceil(low / every) + 1 }, (_, i) => (Math.ceil(low / every) + i) * every);
    const [stepX, stepY] = [step(to - from, wide / 90), step(2 * reach, 6)];
    const digits = (of) => Math.max(0, -Math.floor(Math.log10(of) + 1e-9));
    const grid = ticks(from, to, stepX).map((v) => `<line x1="${x(v)}" x2="${x(v)}" y1="${top}" y2="${high - bottom}" class="grid"/><text x="${x(v)}" y="${high - bottom + 15}" text-anchor="middle">${number(v, digits(stepX))}</text>`)
      .concat(ticks(-reach, reach, stepY).map((v) => `<line x1="${left}" x2="${wide - right}" y1="${y(v)}" y2="${y(v)}" class="grid${Math.abs(v) < 1e-9 ? " zero" : ""}"/><text x="${left - 5}" y="${y(v) + 4}" text-anchor="end">${number(v, digits(stepY))}</text>`));
    const crossing = `<line x1="${x(other)}" x2="${x(other)}" y1="${top}" y2="${high - bottom}" class="crossing"/>`;
    const bounds = data.limits_um ? ["warn", "stop"].map((name, i) => `<line x1="${left}" x2="${wide - right}" y1="${y(-limits[i])}" y2="${y(-limits[i])}" class="mark ${name}"/><text x="${wide - right + 4}" y="${y(-limits[i]) + 4}" class="mark ${name}">${name}</text>`) : [];
    // A curve ends where a cell was not seen.
    let curve = "", pen = "M";
    for (const [along, um] of points) { if (um !== null) curve += `${pen}${x(along).toFixed(1)} ${y(um).toFixed(1)}`; pen = um === null ? "M" : "L"; }
    const dots = seen.length <= 120 ? seen.map(([along, um]) => `<circle cx="${x(along).toFixed(1)}" cy="${y(um).toFixed(1)}" r="2.2"/>`).join("") : "";
    const [low, most] = [Math.min(...seen.map(([, um]) => um)), Math.max(...seen.map(([, um]) => um))];
    const title = `Deviation from ${number(low)} to ${number(most)} µm; ${seen.length} of ${points.length} cells seen`;
    // Only numbers and fixed words: names of the data are set as text elsewhere.
    box.innerHTML = `<svg viewBox="0 0 ${wide} ${high}" role="img" aria-label="${title}">${grid.join("")}${crossing}${bounds.join("")}<path d="${curve}" class="curve"/>${dots}<text x="${(left + wide - right) / 2}" y="${high - 5}" text-anchor="middle" class="axis"></text><text transform="translate(11 ${(top + high - bottom) / 2}) rotate(-90)" text-anchor="middle">deviation / µm</text></svg><p class="muted">${title}.</p>`;
    box.querySelector(".axis").textContent = axis;
    box.firstChild.addEventListener("pointermove", (event) => {
      const own = event.currentTarget.getBoundingClientRect();
      const at = from + ((((event.clientX - own.left) / own.width) * wide - left) / (wide - left - right)) * (to - from);
      const [along, um] = points.reduce((best, point) => (Math.abs(point[0] - at) < Math.abs(best[0] - at) ? point : best));
      say(event, `${deviation(um)} at ${number(along, 2)} mm`);
    });
    box.firstChild.addEventListener("pointerleave", (event) => say(event, ""));
  };
  // The sections go through a cell: the deepest, unless one was picked.
  const choose = (part, picked) => {
    chosen = part;
    by("part").value = part ?? "";
    const of = data.parts[part];
    by("which").textContent = of ? `Sections of ${of.name}` : "";
    by("wear").textContent = of ? [of.wear, of.verdict].filter(Boolean).join(" · ") : "";
    const grids = data.grids.filter((grid) => grid.part === part);
    if (grids.length) {
      const through = picked ?? ofPart[part].reduce((best, cell) => ((cell.um ?? 0) < (best.um ?? 0) ? cell : best));
      const slide = (id, ends, value) => {
        Object.assign(by(id), { min: Math.min(...ends), max: Math.max(...ends), step: "any" });
        by(id).value = value;
      };
      slide("height", grids.flatMap((grid) => [grid.height(0), grid.height(grid.rows - 1)]), through.grid.height(through.row));
      slide("along", grids.flatMap((grid) => grid.along_mm), through.grid.along_mm[through.column]);
    }
    section();
  };

  for (const i of data.parts.keys()) if (ofPart[i].length) by("part").add(new Option([data.parts[i].name, data.parts[i].verdict].filter(Boolean).join(" · "), i));
  by("part").addEventListener("change", () => { choose(+by("part").value); focus(chosen); });
  for (const id of ["height", "along"]) by(id).addEventListener("input", section);
  by("cut").addEventListener("change", redraw);
  by("reset").addEventListener("click", reset);
  by("whole").addEventListener("click", whole);
  const zoom = (factor) => { view.mm = clamp(view.mm * factor, 0.2, 4 * all.half); redraw(); };
  const turn = (right, up) => { view.yaw -= right; view.pitch = clamp(view.pitch + up, -1.55, 1.55); redraw(); };
  const move = (right, up) => { const [u, v] = axes(); view.middle = add(add(view.middle, u, -right), v, -up); redraw(); };
  by("nearer").addEventListener("click", () => zoom(0.8));
  by("farther").addEventListener("click", () => zoom(1.25));
  const perPx = () => (2 * view.mm) / canvas.clientHeight;
  const pointers = new Map();
  let pressed = null;
  canvas.addEventListener("pointerdown", (event) => { pointers.set(event.pointerId, event); canvas.setPointerCapture(event.pointerId); pressed = event; say(event, ""); });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("pointerleave", (event) => say(event, ""));
  let hovering = null;
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) {
      if (!hovering) requestAnimationFrame(() => { sayCell(hovering, under(hovering)); hovering = null; });
      hovering = event;
      return;
    }
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    const other = [...pointers.values()].find((of) => of.pointerId !== event.pointerId);
    pointers.set(event.pointerId, event);
    if (other) {
      const apart = (of) => Math.hypot(of.clientX - other.clientX, of.clientY - other.clientY);
      zoom(apart(before) / Math.max(1, apart(event)));
      move((dx / 2) * perPx(), (-dy / 2) * perPx());
    } else if (event.shiftKey || event.buttons === 4) move(dx * perPx(), -dy * perPx());
    else turn(dx * 0.008, dy * 0.008);
  });
  canvas.addEventListener("click", (event) => {
    // The end of a drag picks nothing.
    if (pressed && Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) > 4) return;
    const cell = under(event);
    sayCell(event, cell);
    if (cell && cell.grid.part !== null) choose(cell.grid.part, cell);
  });
  canvas.addEventListener("dblclick", (event) => { const cell = under(event); if (cell) { view.middle = cell.here; zoom(0.6); } });
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(clamp(event.deltaY, -200, 200) * 0.0015)); }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (way && event.shiftKey) move(way[0] * 0.1 * view.mm, way[1] * 0.1 * view.mm);
    else if (way) turn(way[0] * 0.08, -way[1] * 0.08);
    else if (event.key === "+" || event.key === "=") zoom(0.85);
    else if (event.key === "-") zoom(1.18);
    else if (event.key === "0" || event.key === "Home") reset();
    else return;
    event.preventDefault();
  });
  new ResizeObserver(section).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  if (ranked.length) choose(ranked[0]);
  else section();
  reset();
}
show(JSON.parse(by("data").textContent));
