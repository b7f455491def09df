// Blocks and points of a file as tables: a changed cell asks the server for the edits of the text.
import { element } from "./parts.js";

const NARROW = new Set(["type", "scale", "unit", "every", "access"]), NUMBERS = new Set(["channel", "station", "count"]);
const TITLES = { blocks: "Blocks", points: "Points", values: "Points" };

export class Tables {
  // `ask({where, row, key, old, value} or {where, row, remove})`: a change. `goTo(line)`: shows a line of the text.
  constructor(place, ask, goTo) {
    Object.assign(this, { place, ask, goTo, shown: "", writable: false });
  }

  show(tables, writable) {
    const told = JSON.stringify([tables, writable]);
    if (told === this.shown) return;
    this.shown = told;
    this.writable = writable;
    const focused = document.activeElement?.dataset?.cell;
    this.place.replaceChildren();
    this.place.hidden = !tables.length;
    for (const table of tables) this.table(table);
    if (focused) [...this.place.querySelectorAll("[data-cell]")].find(one => one.dataset.cell === focused)?.focus();
  }

  table({ where, columns, rows }) {
    const head = element("header", this.place);
    element("h2", head).textContent = (where[0] === "sets" ? `Set ${where[1]}: ` : "") + TITLES[where.at(-1)];
    Object.assign(element("span", head), { className: "count", textContent: rows.length || "none yet" });
    const frame = element("div", this.place), table = element("table", frame), top = element("tr", element("thead", table));
    frame.className = "cells";
    for (const title of [where.at(-1) === "blocks" ? "No." : "Name", ...columns.map(one => one[0]), "Other keys", ""])
      Object.assign(element("th", top), { textContent: title, scope: "col" });
    const body = element("tbody", table);
    for (const row of rows) this.row(body, where, columns, row);
    if (this.writable) this.adds(body, where, columns, rows);
  }

  row(body, where, columns, { name, line, cells, other }) {
    const row = element("tr", body), link = element("button", element("td", row));
    Object.assign(link, { textContent: name, className: "name", title: `Line ${line}` });
    link.addEventListener("click", () => this.goTo(line));
    cells.forEach(([key, text, can], at) => this.cell(element("td", row), where, name, columns[at], key, text, can && this.writable));
    Object.assign(element("td", row), { textContent: other, className: "muted", title: other });
    const end = element("td", row);
    if (!this.writable) return;
    const remove = Object.assign(element("button", end), { textContent: "×", title: "Remove this row" });
    remove.setAttribute("aria-label", `remove ${name}`);
    remove.addEventListener("click", () => this.ask({ where, row: name, remove: true }));
  }

  cell(place, where, row, [title, keys], key, text, can) {
    const id = [...where, row, title].join(" "), choice = keyChoice(place, keys, key, `${title} of ${row}: kind`, `${id} kind`);
    const field = Object.assign(element("input", place), { value: text, disabled: !can, spellcheck: false, autocomplete: "off", title: text });
    field.setAttribute("aria-label", `${title} of ${row}`);
    field.dataset.cell = id;
    if (keys.length === 1) field.className = NARROW.has(keys[0]) ? "narrow" : NUMBERS.has(keys[0]) ? "number" : "";
    if (choice) choice.disabled = !can;
    const send = () => {
      const now = choice ? choice.value : keys[0], value = field.value.trim();
      if ((now !== key || value !== text) && (value || text)) this.ask({ where, row, key: value ? now : key, old: key, value });
    };
    field.addEventListener("change", send);
    field.addEventListener("keydown", event => { if (event.key === "Escape") field.value = text; });
    choice?.addEventListener("change", () => { if (field.value) send(); });
  }

  adds(body, where, columns, rows) {
    const row = element("tr", body), names = new Set(rows.map(one => one.name)), [title, keys] = columns[0];
    let free = 0;
    while (names.has(String(free))) free++;
    const name = Object.assign(element("input", element("td", row)), { value: where.at(-1) === "blocks" ? free : "", placeholder: "new", className: where.at(-1) === "blocks" ? "number" : "" });
    name.setAttribute("aria-label", "name of the new row");
    const place = element("td", row), choice = keyChoice(place, keys, "", "kind of the new row", `${where.join(" ")} new kind`);
    const field = Object.assign(element("input", place), { placeholder: "address", spellcheck: false, autocomplete: "off" });
    field.setAttribute("aria-label", `${title} of the new row`);
    field.dataset.cell = `${where.join(" ")} new`;
    const end = Object.assign(element("td", row), { colSpan: columns.length + 1 }), add = element("button", end);
    add.textContent = "Add";
    const send = () => this.ask({ where, row: name.value.trim(), key: choice ? choice.value : keys[0], old: "", value: field.value.trim() });
    add.addEventListener("click", send);
    field.addEventListener("keydown", event => { if (event.key === "Enter") send(); });
  }
}

// A list of the keys that a column may show; a column with a single key needs none.
function keyChoice(place, keys, key, label, id) {
  if (keys.length < 2) return null;
  const list = element("select", place);
  list.setAttribute("aria-label", label);
  list.dataset.cell = id;
  for (const word of keys) Object.assign(element("option", list), { textContent: word.replace("_", " "), value: word });
  list.value = key || keys[0];
  return list;
}
