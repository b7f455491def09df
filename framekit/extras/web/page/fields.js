// The bytes of a frame, each field tinted, and the list of its fields; a field under the pointer is lit in both.
import { element } from "./parts.js";

const IN_A_ROW = 16, TINTS = 6;

// `rows`: path, offset, bytes, value – all texts – and offset and size as numbers. `fault`: its words and the byte.
export function fieldView(place, title, hex, rows, fault) {
  const bytes = hex.match(/../g) ?? [], owner = [];
  place.replaceChildren();
  element("h3", place).textContent = title + (fault ? ` · ${fault[0]} at byte ${fault[1]}` : "");
  const leaves = leavesOf(rows);
  leaves.forEach((row, field) => { for (let byte = row[4]; byte < row[4] + row[5]; byte++) owner[byte] = field; });
  const grid = Object.assign(element("div", place), { className: "bytes" });
  bytes.forEach((byte, number) => {
    if (number % IN_A_ROW === 0) element("i", grid).textContent = number.toString(16).padStart(4, "0").toUpperCase();
    const one = Object.assign(element("span", grid), { textContent: byte.toUpperCase(), className: fault?.[1] === number ? "fault" : "" });
    if (owner[number] !== undefined) Object.assign(one.dataset, { tint: owner[number] % TINTS, field: owner[number] });
  });
  if (!leaves.length) return;
  const list = Object.assign(element("table", place), { className: "fields" }), head = element("tr", list);
  for (const text of ["Field", "Offset", "Bytes", "Value"]) element("th", head).textContent = text;
  leaves.forEach(([path, offset, data, value], field) => {
    const row = element("tr", list);
    Object.assign(row.dataset, { tint: field % TINTS, field });
    for (const [text, look] of [[path.split(".").at(-1), "strong"], [offset, ""], [data, "mono"], [value, ""]])
      Object.assign(element("td", row), { textContent: text, className: look, title: path });
  });
}

// The fields that have bytes and hold no other field.
function leavesOf(rows) {
  const outer = new Set();
  for (const [path] of rows) {
    const parts = path.split(".");
    for (let length = 1; length < parts.length; length++) outer.add(parts.slice(0, length).join("."));
  }
  return rows.filter(row => row[5] && !outer.has(row[0]));
}

document.addEventListener("mouseover", event => {
  const field = event.target.closest?.("[data-field]")?.dataset.field;
  for (const one of document.querySelectorAll("[data-field]")) one.classList.toggle("lit", one.dataset.field === field);
});
