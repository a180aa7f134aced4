// Tables of a page, from its data.

const data = JSON.parse(document.getElementById("data").textContent);
const source = document.getElementById("datatables").textContent;
const address = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
const { default: DataTable } = await import(address);
URL.revokeObjectURL(address);

const HEADS = {
  errors: "Errors", metrics: "All metrics", pairs: "Pairs of estimators, run by run", cases: "Cases",
  studies: "Changed assumptions", standing: "Standing over the cases", claims: "Claims of the source", gravity_claims: "Claims on gravity",
  fixes: "Fixes of matchers", lines: "Survey lines", models: "Models over time", counters: "Counters of estimators", failures: "Failed runs", remarks: "Remarks on runs",
  standings: "Estimators", questions: "Questions",
};

// The formats of ggbench/report/columns.py.
function significant(value, digits) {
  if (value === 0) return "0";
  const rounded = Number(value.toPrecision(digits));
  const exponent = Math.floor(Math.log10(Math.abs(rounded)));
  if (exponent < -4 || exponent >= 6) return rounded.toExponential(digits - 1);
  return rounded.toFixed(Math.max(0, digits - 1 - exponent));
}
const LARGEST = 1e7;
const limited = (value, digits) => (value > LARGEST ? ">1e7" : significant(value, digits));
const FORMS = {
  count: (value) => String(value),
  number: (value) => significant(value, 3),
  metres: (value) => limited(value, 3),
  ratio: (value) => limited(value, 2),
  efficiency: (value) => (value < 9.995 ? value.toFixed(2) : limited(value, 2)),
  share: (value) => {
    const text = significant(100 * value, 2);
    return text === "100" && value < 1 ? ">99%" : `${text}%`;
  },
  time: (value) => (value >= 1 ? `${significant(value, 1)} s` : `${significant(1e3 * value, 1)} ms`),
  p: (value) => (value < 1e-3 ? "< 0.001" : significant(value, 2)),
};
function shown(value, form) {
  if (value === null || value === "") return "–";
  if (typeof value === "boolean") return value ? "yes" : "no";
  return typeof value === "number" && FORMS[form] ? FORMS[form](value) : String(value);
}

// The number with which a text begins; texts without one come last.
function leading(text) {
  const number = Number.parseFloat(text);
  return Number.isNaN(number) ? Infinity : number;
}

// Rows of a table as arrays of values, of one case or of all.
function rowsOf(name, wanted) {
  const { columns, packed } = data.tables[name];
  const values = packed.map(({ texts, values }) => (texts ? values.map((k) => texts[k]) : values));
  const at = columns.indexOf("case");
  const rows = (values[0] ?? []).map((_, row) => values.map((column) => column[row]));
  return wanted === null || at < 0 ? rows : rows.filter((row) => row[at] === wanted);
}

const escaped = document.createElement("span");
function plain(text) { escaped.textContent = text; return escaped.innerHTML; }

function addTable(parent, name, wanted) {
  const { columns } = data.tables[name];
  const rows = rowsOf(name, wanted);
  if (!rows.length) return;
  const most = name === "errors" ? 20 : 60; // Rows of a page of the table.
  const kept = columns.map((_, k) => k).filter((k) =>
    !(wanted !== null && columns[k] === "case") && rows.some((row) => row[k] !== null && row[k] !== ""));
  const head = document.createElement("h2");
  head.textContent = HEADS[name] ?? name;
  const table = document.createElement("table");
  parent.append(head, table);
  new DataTable(table, {
    data: rows,
    columns: kept.map((k) => {
      const { head: title, form } = data.columns[columns[k]];
      const numeric = form === "error" || rows.some((row) => typeof row[k] === "number");
      return {
        data: k,
        title: plain(title),
        className: numeric ? "number" : "",
        type: numeric ? "num" : "string",
        // Sorted by the number itself, missing ones last.
        render: (value, kind) => (kind === "sort" || kind === "type"
          ? (form === "error" ? leading(value) : value ?? (numeric ? Infinity : ""))
          : plain(shown(value, form))),
      };
    }),
    paging: rows.length > most, pageLength: most, lengthChange: false, info: false, autoWidth: false, order: [],
    deferRender: true,
    layout: { topStart: rows.length > 4 ? "search" : null, topEnd: null, bottomEnd: rows.length > most ? "paging" : null },
    language: { search: "", searchPlaceholder: "filter rows", zeroRecords: "no row" },
    initComplete() {
      kept.forEach((k, place) => {
        const meaning = data.columns[columns[k]].definition;
        if (meaning) table.querySelectorAll("thead th")[place].title = meaning;
      });
    },
  });
}
