// Figures of the page: values under the pointer, series switched in the legend, zoom.
// ggbench/figures/interactive.py draws them and names their groups.

const NEAR = 12; // Distance within which a point is pointed at, in units of the picture.
const EQUAL = 0.5; // Distance of points that are shown as equal.

// Points of the visible series of a figure.
function pointsOf(svg, hidden) {
  const points = [];
  for (const group of svg.querySelectorAll("[id^='series-']")) {
    const series = Number(group.id.split("-")[1]);
    if (hidden.has(series)) continue;
    for (const mark of group.querySelectorAll("use")) {
      points.push({ series, x: Number(mark.getAttribute("x")), y: Number(mark.getAttribute("y")) });
    }
    for (const path of group.querySelectorAll("path")) {
      if (path.closest("defs")) continue;
      for (const [, x, y] of path.getAttribute("d").matchAll(/[ML] ([-\d.]+) ([-\d.]+)/g)) {
        points.push({ series, x: Number(x), y: Number(y) });
      }
    }
  }
  return points;
}

// The value at a share of an axis, with its name.
function valueOf({ limits: [low, high], log, label, names }, share) {
  const value = log ? low * (high / low) ** share : low + (high - low) * share;
  return names.length ? names[Math.round(value)] : `${label && `${label}: `}${significant(value, 3)}`;
}

function addFigure(parent, { svg: text, names, hidden: off, panels }, caption) {
  const figure = document.createElement("figure");
  const place = document.createElement("div");
  place.className = "chart";
  place.innerHTML = text;
  const words = document.createElement("figcaption");
  words.textContent = caption;
  const tip = document.createElement("div");
  tip.className = "tip";
  tip.hidden = true;
  figure.append(place, tip, words);
  parent.append(figure);

  const svg = place.querySelector("svg");
  const whole = svg.getAttribute("viewBox").split(" ").map(Number);
  const hidden = new Set(off);
  let points = pointsOf(svg, hidden);
  const groups = (kind, series) => svg.querySelectorAll(`[id^='${kind}-${series}-']`);
  function show(series) {
    for (const kind of ["series", "range"]) {
      for (const group of groups(kind, series)) group.style.display = hidden.has(series) ? "none" : "";
    }
    for (const group of groups("legend", series)) group.style.opacity = hidden.has(series) ? 0.3 : 1;
  }
  names.forEach((_, series) => {
    show(series);
    for (const group of groups("legend", series)) {
      group.addEventListener("click", () => {
        if (!hidden.delete(series)) hidden.add(series);
        show(series);
        points = pointsOf(svg, hidden);
      });
    }
  });

  const at = (event) => new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  function point(event) {
    const here = at(event);
    const distance = ({ x, y }) => Math.hypot(x - here.x, y - here.y);
    const near = points.reduce((best, next) => (distance(next) <= distance(best) ? next : best), { x: Infinity, y: 0 });
    tip.hidden = !(distance(near) < NEAR);
    if (tip.hidden) return;
    panels.forEach(({ x, y }, number) => {
      const box = svg.querySelector(`#panel-${number}`).getBBox();
      const [right, up] = [(near.x - box.x) / box.width, (box.y + box.height - near.y) / box.height];
      if (right < -0.01 || right > 1.01 || up < -0.01 || up > 1.01) return;
      const equal = points.filter((other) => Math.hypot(other.x - near.x, other.y - near.y) < EQUAL);
      const series = [...new Set(equal.map((other) => names[other.series]))];
      tip.textContent = [series.join(", "), valueOf(x, right), valueOf(y, up)].join("\n");
    });
    const frame = figure.getBoundingClientRect();
    const left = event.clientX - frame.left + 12;
    tip.style.left = `${Math.max(0, Math.min(left, frame.width - tip.offsetWidth))}px`;
    tip.style.top = `${event.clientY - frame.top + 16}px`;
  }

  const view = () => svg.getAttribute("viewBox").split(" ").map(Number);
  let held = null;
  svg.addEventListener("pointerdown", (event) => { if (event.pointerType === "mouse") held = at(event); });
  svg.addEventListener("pointerup", () => { held = null; });
  svg.addEventListener("pointerleave", () => { held = null; tip.hidden = true; });
  svg.addEventListener("pointermove", (event) => {
    if (held === null) return point(event);
    const [x, y, width, height] = view();
    const here = at(event);
    svg.setAttribute("viewBox", [x + held.x - here.x, y + held.y - here.y, width, height].join(" "));
  });
  svg.addEventListener("wheel", (event) => {
    event.preventDefault();
    const [x, y, width] = view();
    const here = at(event);
    const scale = Math.min(1.002 ** event.deltaY, whole[2] / width);
    const corner = [here.x - scale * (here.x - x), here.y - scale * (here.y - y)];
    const size = [scale * width, (scale * width * whole[3]) / whole[2]];
    svg.setAttribute("viewBox", scale * width > 0.999 * whole[2] ? whole.join(" ") : [...corner, ...size].join(" "));
  }, { passive: false });
  svg.addEventListener("dblclick", () => svg.setAttribute("viewBox", whole.join(" ")));
}
