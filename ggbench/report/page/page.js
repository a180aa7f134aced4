// What the libraries do not do by themselves: start them, and show what a word means.

for (const place of document.querySelectorAll(".chart")) {
  const spec = JSON.parse(document.getElementById(place.dataset.chart).textContent);
  const bind = place.previousElementSibling;
  vegaEmbed(place, spec, { mode: "vega-lite", renderer: "svg", actions: false, bind });
}

const source = document.getElementById("datatables").textContent;
const address = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
const { default: DataTable } = await import(address);
URL.revokeObjectURL(address);
for (const table of document.querySelectorAll("main table")) {
  const blocks = table.dataset.blocks > 0;
  new DataTable(table, {
    paging: false, info: false, autoWidth: false, order: [],
    orderFixed: blocks ? { pre: [[0, "asc"]] } : null,
    columnDefs: blocks ? [{ targets: 0, visible: false, searchable: false }] : [],
    layout: { topStart: table.rows.length > 4 ? "search" : null, topEnd: null },
    language: { search: "", searchPlaceholder: "filter rows" },
  });
}

const tip = document.getElementById("tip");
const hide = () => { tip.hidden = true; };
function show(event) {
  const own = event.target.closest("[data-term]");
  const term = own ?? event.target.closest("th")?.querySelector("[data-term]");
  const meaning = term && document.getElementById(term.dataset.term);
  if (!meaning) return hide();
  tip.innerHTML = meaning.innerHTML;
  tip.hidden = false;
  const at = term.getBoundingClientRect();
  const left = Math.min(at.left, document.documentElement.clientWidth - tip.offsetWidth - 8);
  const above = at.bottom + tip.offsetHeight + 8 > innerHeight && at.top > tip.offsetHeight + 8;
  tip.style.left = `${Math.max(left, 8) + scrollX}px`;
  tip.style.top = `${scrollY + (above ? at.top - tip.offsetHeight - 4 : at.bottom + 4)}px`;
}
for (const kind of ["mouseover", "focusin"]) document.addEventListener(kind, show);
document.addEventListener("focusout", hide);
document.addEventListener("keydown", (event) => { if (event.key === "Escape") hide(); });
document.body.dataset.ready = "yes";
