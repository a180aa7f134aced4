// Tabs, tables and figures of the page of a scenario.

const HINT = "Click a name in the legend to switch it. Drag to move, turn the wheel to zoom, double-click to reset.";

const panel = document.getElementById("panel");
const RELATED = ["fixes", "lines", "models", "remarks", "failures", "claims", "studies", "counters"];

function showAll() {
  addTable(panel, "errors", null);
  addFigure(panel, data.figures[""].picture, `${data.figures[""].caption}. ${HINT}`);
  for (const name of ["cases", ...Object.keys(data.tables).filter((name) => !["errors", "cases", "metrics", "pairs"].includes(name))]) {
    addTable(panel, name, null);
  }
}

function showCase(name) {
  const drawn = data.figures[name];
  if (drawn) addFigure(panel, drawn.picture, `${drawn.caption}. ${HINT}`);
  addTable(panel, "metrics", name);
  addTable(panel, "pairs", name);
  for (const other of RELATED) {
    if (data.tables[other]?.columns.includes("case")) addTable(panel, other, name);
  }
}

function select(tab) {
  document.body.dataset.ready = "no";
  for (const other of document.querySelectorAll("[role=tab]")) {
    other.setAttribute("aria-selected", String(other === tab));
  }
  panel.replaceChildren();
  const title = document.createElement("h2");
  title.textContent = tab.textContent;
  panel.append(title);
  if (tab.dataset.case === undefined) showAll();
  else showCase(tab.dataset.case);
  document.body.dataset.ready = "yes";
}

const list = document.querySelector("[role=tablist]");
for (const entry of [{ title: "All cases" }, ...data.cases]) {
  const tab = document.createElement("button");
  tab.setAttribute("role", "tab");
  tab.textContent = entry.title;
  if (entry.case !== undefined) tab.dataset.case = entry.case;
  tab.addEventListener("click", () => select(tab));
  list.append(tab);
}
select(list.firstElementChild);
