// Two pictures of points. A click takes, of the points within some pixels of it, the one nearest to the viewer.
const by = (id) => document.getElementById(id);
const REACH_PX = 6;
const data = JSON.parse(by("data").textContent);
const shown = (mm) => mm.map((c) => c.toFixed(4)).join(",");
const picked = { cloud: null, cad: null };
const pairs = [];

function picture(side, colour) {
  const canvas = by(side);
  const xyz = new Float32Array(Uint8Array.from(atob(data[side]), (c) => c.charCodeAt(0)).buffer);
  const count = xyz.length / 3;
  const ends = [0, 1, 2].map((k) => { let [low, high] = [Infinity, -Infinity]; for (let i = k; i < xyz.length; i += 3) { low = Math.min(low, xyz[i]); high = Math.max(high, xyz[i]); } return [low, high]; });
  const middle = ends.map(([low, high]) => (low + high) / 2);
  const half = Math.hypot(...ends.map(([low, high]) => high - low)) / 2 || 1;
  // Seen from +x, a little from above; `mm` is half of the height of the picture.
  const view = { yaw: 0, pitch: 0.5, mm: half, right: 0, up: 0 };
  const project = () => {
    const [sy, cy, sp, cp] = [Math.sin(view.yaw), Math.cos(view.yaw), Math.sin(view.pitch), Math.cos(view.pitch)];
    const [w, h] = [canvas.clientWidth, canvas.clientHeight];
    const scale = h / (2 * view.mm);
    return (i) => {
      const [x, y, z] = [0, 1, 2].map((k) => xyz[3 * i + k] - middle[k]);
      const right = -sy * x + cy * y;
      const up = -sp * cy * x - sp * sy * y + cp * z;
      return [w / 2 + scale * (right - view.right), h / 2 - scale * (up - view.up), cp * cy * x + cp * sy * y + sp * z];
    };
  };
  const draw = () => {
    const [w, h] = [canvas.clientWidth, canvas.clientHeight];
    if (!w || !h) return;
    Object.assign(canvas, { width: w, height: h });
    const context = canvas.getContext("2d");
    const image = context.createImageData(w, h);
    const near = new Float32Array(w * h).fill(-Infinity);
    const place = project();
    for (let i = 0; i < count; i++) {
      const [x, y, depth] = place(i);
      const shade = 0.25 + 0.75 * Math.min(1, Math.max(0, (depth + half) / (2 * half)));
      for (let row = Math.round(y) - 1; row <= Math.round(y) + 1; row++) for (let column = Math.round(x) - 1; column <= Math.round(x) + 1; column++) {
        if (row < 0 || column < 0 || row >= h || column >= w || near[row * w + column] >= depth) continue;
        near[row * w + column] = depth;
        image.data.set([...colour.map((c) => c * shade), 255], 4 * (row * w + column));
      }
    }
    context.putImageData(image, 0, 0);
    const marks = pairs.map((pair, i) => [pair[side], `${i + 1}`]);
    if (picked[side] !== null) marks.push([picked[side], "?"]);
    for (const [i, name] of marks) {
      const [x, y] = place(i);
      context.lineWidth = 2;
      context.strokeStyle = context.fillStyle = "#d55e00";
      context.beginPath();
      context.arc(x, y, 6, 0, 7);
      context.stroke();
      context.font = "bold 14px sans-serif";
      context.fillText(name, x + 9, y - 6);
    }
  };
  // Many clicks or moves between two pictures of the screen are drawn once.
  let waiting = false;
  const redraw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  };
  const under = (event) => {
    const own = canvas.getBoundingClientRect();
    const [atX, atY] = [event.clientX - own.left, event.clientY - own.top];
    const place = project();
    let [best, front] = [null, -Infinity];
    for (let i = 0; i < count; i++) {
      const [x, y, depth] = place(i);
      if (Math.hypot(x - atX, y - atY) <= REACH_PX && depth > front) [best, front] = [i, depth];
    }
    return best;
  };
  let pressed = null;
  let moved = false;
  canvas.addEventListener("pointerdown", (event) => { pressed = event; moved = false; });
  addEventListener("pointerup", () => (pressed = null));
  canvas.addEventListener("pointermove", (event) => {
    if (!pressed) return;
    const [dx, dy] = [event.clientX - pressed.clientX, event.clientY - pressed.clientY];
    if (!moved && Math.hypot(dx, dy) < 4) return;
    moved = true;
    pressed = event;
    if (event.shiftKey) { const px = (2 * view.mm) / canvas.clientHeight; view.right -= dx * px; view.up += dy * px; }
    else { view.yaw -= dx * 0.008; view.pitch = Math.min(1.57, Math.max(-1.57, view.pitch + dy * 0.008)); }
    redraw();
  });
  canvas.addEventListener("click", (event) => {
    if (moved) return;
    picked[side] = under(event);
    tell();
  });
  const zoom = (factor) => { view.mm *= factor; redraw(); };
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(Math.max(-200, Math.min(200, event.deltaY)) * 0.0015)); }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (way) { view.yaw -= way[0] * 0.08; view.pitch = Math.min(1.57, Math.max(-1.57, view.pitch + way[1] * 0.08)); redraw(); }
    else if (event.key === "+" || event.key === "=") zoom(0.85);
    else if (event.key === "-") zoom(1.18);
    else return;
    event.preventDefault();
  });
  new ResizeObserver(redraw).observe(canvas);
  return { redraw, mm: (i) => [0, 1, 2].map((k) => xyz[3 * i + k]) };
}

const sides = { cloud: picture("cloud", [29, 92, 156]), cad: picture("cad", [93, 102, 111]) };
const names = Object.keys(sides);

function tell() {
  for (const side of names) {
    by(`${side}-at`).textContent = picked[side] === null ? "no point picked" : shown(sides[side].mm(picked[side]));
    sides[side].redraw();
  }
  by("add").disabled = names.some((side) => picked[side] === null);
  by("drop").disabled = !pairs.length;
  const text = pairs.map((pair) => names.map((side) => shown(sides[side].mm(pair[side]))).join(",") + "\n").join("");
  by("pairs").value = text;
  by("save").hidden = pairs.length < 3;
  by("save").href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
}

by("add").addEventListener("click", () => { pairs.push({ ...picked }); for (const side of names) picked[side] = null; tell(); });
by("drop").addEventListener("click", () => { pairs.pop(); tell(); });
