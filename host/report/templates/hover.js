// Says the value under the pointer over every picture with a scale, and enlarges what is clicked. The values are the colours:
// the page holds no second copy of them.
const note = document.createElement("output");
note.className = "note";
document.body.append(note);
const number = (value) => value.toFixed(Math.abs(value) < 100 ? 1 : 0).replace("-", "\u2212");
function meaning([r, g, b], scale, full) {
  if ([[120, 124, 130], [186, 190, 195]].some((hatch) => hatch[0] === r && hatch[1] === g && hatch[2] === b)) return "not measured";
  if (scale === "amount") return number((full * (238 - r)) / 220);
  const share = r < b ? -(((255 - r) / 222) ** 2) : ((255 - b) / 212) ** 2;
  return number(full * share) + " µm";
}
for (const shown of document.querySelectorAll("[data-scale]")) {
  const { scale, full, x, y } = shown.dataset;
  const axis = (text) => { const [from, to, ...label] = text.split(" "); return { from: +from, to: +to, label: label.join(" ") }; };
  const axes = [axis(x), axis(y)];
  const picture = new Image();
  picture.src = shown.getAttribute("href") || shown.src;
  let pixels;
  shown.addEventListener("pointermove", (event) => {
    if (!pixels) {
      const canvas = document.createElement("canvas");
      [canvas.width, canvas.height] = [picture.naturalWidth, picture.naturalHeight];
      pixels = canvas.getContext("2d", { willReadFrequently: true });
      pixels.drawImage(picture, 0, 0);
    }
    const box = shown.getBoundingClientRect();
    const at = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    const [column, row] = [Math.floor(at[0] * picture.naturalWidth), Math.floor(at[1] * picture.naturalHeight)];
    const value = meaning(pixels.getImageData(column, row, 1, 1).data, scale, +full);
    note.textContent = value + " at " + axes.map((axis, i) => number(axis.from + at[i] * (axis.to - axis.from)) + " " + axis.label).join(", ");
    note.style.left = Math.min(event.pageX + 12, document.documentElement.clientWidth - 230) + "px";
    note.style.top = event.pageY + 16 + "px";
    note.style.display = "block";
  });
  shown.addEventListener("pointerleave", () => (note.style.display = "none"));
}
for (const figure of document.querySelectorAll(".zoomable")) {
  figure.addEventListener("click", (event) => {
    const box = figure.getBoundingClientRect();
    const at = [(event.clientX - box.left + figure.scrollLeft) / figure.scrollWidth, (event.clientY - box.top) / figure.scrollHeight];
    figure.classList.toggle("zoomed");
    figure.scrollLeft = at[0] * figure.scrollWidth - 0.5 * box.width;
  });
}
