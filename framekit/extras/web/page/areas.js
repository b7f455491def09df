// The memory of a device: an area as a table of its elements, of which only the rows in view are read. A click on an
// element sets it.
import { element } from "./parts.js";
import { at } from "./shell.js";
import { ask } from "./actions.js";

const ROW = 30, MORE = 2, BLINK = 1200, MOST_TABS = 8;
// Elements in a row by their bits, in a wide and in a narrow table.
const COLUMNS = { 1: [16, 8], 8: [16, 8], 16: [10, 5] }, LONG = [4, 2], WIDE = 640;

export class Areas {
  constructor(live) {
    Object.assign(this, { live, devices: [], device: 0, number: 0, first: 0, before: new Map(), marked: -1 });
    this.place = at("areas").querySelector(".grid");
    this.table = element("table", this.place);
    this.table.className = "cells";
    this.head = element("tr", element("thead", this.table));
    this.above = element("td", element("tr", element("tbody", this.table)));
    this.body = element("tbody", this.table);
    this.below = element("td", element("tr", element("tbody", this.table)));
    this.place.addEventListener("scroll", () => this.draw());
    this.body.addEventListener("click", event => this.clicked(event.target.closest("button")));
    at("device").addEventListener("change", () => { this.device = Number(at("device").value); this.show(this.devices[this.device].used); });
    new ResizeObserver(() => this.fit()).observe(this.place);
    at("form").addEventListener("change", () => { this.before.clear(); this.ask(); });
    at("go").addEventListener("submit", event => {
      event.preventDefault();
      if (at("address").value) this.live.say({ find: this.device, address: at("address").value });
    });
  }

  begin(devices) {
    this.devices = devices;
    at("device").replaceChildren();
    devices.forEach(({ name, station }, number) => {
      const textContent = station ? `${name}, station ${station}` : name;
      Object.assign(element("option", at("device")), { value: number, textContent });
    });
    at("device").hidden = devices.length < 2;
    this.show(devices[this.device]?.used ?? 0);
  }

  get area() {
    const [name, size, unit, bits, access] = this.devices[this.device].areas[this.number];
    return { name, size, unit, bits, access, columns: (COLUMNS[bits] ?? LONG)[this.place.clientWidth > WIDE ? 0 : 1] };
  }

  // Shows an area of the device, from an element on.
  show(number, first = 0) {
    if (!this.devices[this.device]?.areas.length) { at("areas").hidden = true; return; }
    this.number = number;
    this.before.clear();
    this.name(this.devices[this.device].areas);
    this.head.replaceChildren();
    Object.assign(element("th", this.head), { textContent: "Address", scope: "col" });
    for (let column = 0; column < this.area.columns; column++)
      Object.assign(element("th", this.head), { textContent: `+${column}`, className: "right", scope: "col" });
    this.body.replaceChildren();
    this.place.scrollTop = Math.floor(first / this.area.columns) * ROW;
    this.draw();
  }

  // The names of the areas: a tab each, or a list if they are many.
  name(areas) {
    at("area-tabs").replaceChildren();
    if (areas.length > MOST_TABS) {
      const list = element("select", at("area-tabs"));
      areas.forEach(([name], one) => Object.assign(element("option", list), { value: one, textContent: name }));
      list.setAttribute("aria-label", "area");
      list.value = this.number;
      list.addEventListener("change", () => this.show(Number(list.value)));
      return;
    }
    areas.forEach(([name, size, unit], one) => {
      const tab = Object.assign(element("button", at("area-tabs")), { textContent: name, title: `${size} × ${unit}` });
      tab.classList.toggle("on", one === this.number);
      tab.setAttribute("aria-pressed", String(one === this.number));
      tab.addEventListener("click", () => this.show(one));
    });
  }

  fit() {
    if (this.devices.length && this.head.cells.length - 1 !== this.area.columns) this.show(this.number, this.first);
    else if (this.devices.length) this.draw();
  }

  // Makes the rows in view, and asks for their values.
  draw() {
    const { size, columns } = this.area, rows = Math.ceil(size / columns), seen = Math.ceil(this.place.clientHeight / ROW) + MORE;
    const top = Math.max(0, Math.min(Math.floor(this.place.scrollTop / ROW), rows - seen));
    this.first = top * columns;
    this.count = Math.min(seen * columns, size - this.first);
    const shown = Math.ceil(this.count / columns);
    this.above.style.height = `${top * ROW}px`;
    this.below.style.height = `${(rows - top - shown) * ROW}px`;
    while (this.body.rows.length < shown) this.row(columns);
    while (this.body.rows.length > shown) this.body.lastChild.remove();
    this.ask();
  }

  row(columns) {
    const row = element("tr", this.body);
    row.className = "row";
    element("th", row).scope = "row";
    for (let column = 0; column < columns; column++) element("button", element("td", row)).className = "cell";
  }

  // Called some times a second: the values of the rows in view.
  ask() {
    if (!(this.count > 0) || document.hidden) return;
    this.live.say({ area: this.device, number: this.number, first: this.first, count: this.count, step: this.area.columns });
  }

  take(what) {
    if (what.area !== this.device || what.number !== this.number || what.first !== this.first) return;
    const { columns } = this.area;
    what.addresses.forEach((address, number) => {
      const row = this.body.rows[number];
      if (row) row.cells[0].textContent = address || String(what.first + number * columns);
    });
    [...this.body.rows].forEach((row, line) => {
      for (let column = 0; column < columns; column++) {
        const number = line * columns + column;
        this.fill(row.cells[column + 1].firstChild, what.first + number, what.elements[number]);
      }
    });
  }

  // Shows the value of an element; a cell after the last element is hidden.
  fill(cell, number, value) {
    cell.hidden = value === undefined;
    if (cell.hidden) return;
    const now = performance.now(), last = this.before.get(number);
    if (!last || last.value !== value) this.before.set(number, { value, at: last ? now : -BLINK });
    Object.assign(cell, { textContent: this.written(BigInt(value), this.area.bits), value: number, title: `${value}, element ${number}` });
    cell.classList.toggle("zero", String(value) === "0");
    cell.classList.toggle("moved", now - this.before.get(number).at < BLINK);
    cell.classList.toggle("found", number === this.marked);
  }

  // A value in the chosen form.
  written(value, bits) {
    const form = at("form").value;
    if (form === "hex") return value.toString(16).toUpperCase().padStart(Math.ceil(bits / 4), "0");
    if (form === "binary") return value.toString(2).padStart(bits, "0");
    return String(form === "signed" ? BigInt.asIntN(bits, value) : value);
  }

  takeFound(what) {
    if (what.why) { this.live.tell(what.why); return; }
    this.live.tell("");
    this.marked = what.element;
    this.show(what.number, what.element);
  }

  clicked(cell) {
    if (!cell) return;
    if (!this.live.may) { at("lock").open = true; at("token").focus(); return; }
    const { name, columns, unit, bits } = this.area, number = Number(cell.value), now = cell.textContent;
    const row = cell.closest("tr").cells[0].textContent, device = this.devices[this.device];
    const place = number % columns ? `${row} + ${number % columns}` : row;
    ask({
      title: `Set ${place} of ${device.name}`,
      lines: [`${name}, ${unit} ${number}`, `Now: ${now}`],
      button: "Set",
      field: { label: "New value", words: bits === 1 ? ["1", "0"] : [], hint: "12, 0x1F or -5" },
      confirm: text => `Set ${text} in place of ${now}?`,
      act: (text, ended) => this.live.act({ set: this.device, number: this.number, element: number, value: text }, why => {
        ended(why);
        if (!why) { this.live.tell(`${place} is set: ${text}, before ${now}`); this.ask(); }
      }),
    });
  }
}
