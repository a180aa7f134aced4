// The tables of checked cards.

const panel = document.getElementById("panel");
for (const name of Object.keys(data.tables)) addTable(panel, name, null);
document.body.dataset.ready = "yes";
