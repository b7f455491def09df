// A table of any length: only the rows in view exist as elements. Texts come from devices and files: they are set as
// text, never as markup.
import { sparkline } from "./draw.js";

const ROW = 30, TALLEST = 361, WIDEST = 48, WIDEST_LAST = 100;
const KINDS = { spark: "14ch", button: "9ch" };

export class Grid {
  // `columns`: {title, look, kind, name, widest} of each; kind "spark" draws the numbers of a row, kind "button" has a
  // button; a look with "rest": the column has the rest of the width. `name`: the column can be hidden; `widest`: the most characters that widen it.
  // Rows: {key, state, cells, numbers, drawn, group}; a row with `group` is a head of the rows below it.
  // `picked(key)`: a row was chosen. `marked(key)`: the number of its colour, or -1. `button`: {text, shown, pressed}.
  // `follows`: the table stays at its last row, until the user scrolls away from there. `empty()`: the words in place of
  // rows.
  constructor(place, columns, { picked = null, follows = undefined, marked = null, button = null, empty = null } = {}) {
    Object.assign(this, { place, columns, picked, follows, marked, button, empty });
    this.rows = [];
    this.chosen = this.cursor = null;
    this.pool = [];
    this.widths = [];
    const table = element("table", place), group = element("colgroup", table);
    const top = element("tr", element("thead", table));
    this.bars = columns.map(() => element("col", group));
    this.texts = columns.map((_, at) => at).filter(at => !columns[at].kind);
    columns.forEach(({ kind }, at) => { if (kind) this.bars[at].style.width = KINDS[kind]; });
    for (const { title, look, kind } of columns)
      Object.assign(element("th", top), { textContent: title, className: kind ? `for-${kind}` : look ?? "", scope: "col" });
    this.before = element("td", element("tr", element("tbody", table)));
    this.body = element("tbody", table);
    this.after = element("td", element("tr", element("tbody", table)));
    this.before.style.height = this.after.style.height = "0";
    this.before.style.padding = this.after.style.padding = "0";
    this.measure(this.texts.map(at => columns[at].title));
    this.note = Object.assign(element("p", place), { className: "empty", hidden: true });
    place.tabIndex = 0;
    place.addEventListener("scroll", () => this.moved());
    place.addEventListener("keydown", event => this.key(event));
    this.body.addEventListener("click", event => this.click(event));
  }

  // Hides the columns of a kind or a name, or shows them.
  hide(which, yes) {
    this.columns.forEach(({ kind, name }, at) => { if (kind === which || name === which) this.bars[at].hidden = yes; });
    this.place.classList.toggle(`no-${which}`, yes);
  }

  measure(cells) {
    cells.forEach((text, at) => {
      const { look, widest = at === cells.length - 1 ? WIDEST_LAST : WIDEST } = this.columns[this.texts[at]];
      if (look?.includes("rest")) return;
      const length = Math.min(widest, text.length);
      if (length > (this.widths[at] ?? -1)) {
        this.widths[at] = length;
        this.bars[this.texts[at]].style.width = `${length + around(this.columns[this.texts[at]])}ch`;
      }
    });
  }

  moved() {
    const followed = this.follows;
    if (followed !== undefined) this.follows = this.place.scrollTop + this.place.clientHeight >= this.place.scrollHeight - ROW;
    if (!(followed && this.follows)) this.draw();
  }

  draw() {
    const count = Math.ceil(Math.max(this.place.clientHeight, TALLEST) / ROW) + 1;
    const top = this.follows ? Infinity : Math.floor(this.place.scrollTop / ROW);
    const first = Math.max(0, Math.min(top, this.rows.length - count));
    const last = Math.min(this.rows.length, first + count);
    size(this.before, first * ROW);
    size(this.after, (this.rows.length - last) * ROW);
    this.shown = this.rows.slice(first, last);
    while (this.pool.length < this.shown.length) this.pool.push(this.line());
    this.pool.forEach((line, at) => this.fill(line, this.shown[at]));
    this.note.hidden = Boolean(this.rows.length || !this.empty);
    if (!this.note.hidden) this.note.textContent = this.empty();
    if (this.follows) this.place.scrollTop = ROW * (this.rows.length + 1);
  }

  line() {
    const row = element("tr", this.body), line = { row, cells: [], texts: [] };
    for (const column of this.columns) {
      const { kind, look, widest } = column;
      const cell = Object.assign(element("td", row), { className: kind ? `for-${kind}` : look ?? "" });
      if (widest) cell.style.maxWidth = `${widest + around(column)}ch`;
      if (kind === "spark") line.canvas = Object.assign(element("canvas", cell), { width: 200, height: 40 });
      else if (kind === "button") line.button = Object.assign(element("button", cell), { textContent: this.button.text });
      else line.cells.push(cell);
    }
    return line;
  }

  fill(line, what) {
    line.row.hidden = !what;
    line.key = what?.key;
    if (!what) return;
    const mark = this.marked?.(what.key) ?? -1, is_picked = mark >= 0 || what.key === this.chosen && !this.marked;
    const look = `row ${what.state}${what.group ? " group" : ""}${is_picked ? " picked" : ""}${what.key === this.cursor ? " cursor" : ""}`;
    if (line.look !== look) line.row.className = line.look = look;
    if (mark >= 0) line.row.dataset.tint = mark;
    else delete line.row.dataset.tint;
    if (!what.group) this.measure(what.cells);
    line.cells.forEach((cell, at) => {
      const text = what.cells[at] ?? "";
      if (line.texts[at] === text) return;
      cell.textContent = line.texts[at] = text;
      cell.title = text.length > (this.columns[this.texts[at]].widest ?? 24) ? text : "";
    });
    if (line.canvas) line.canvas.hidden = Boolean(what.group);
    if (line.canvas && !what.group && (line.what !== what || !what.drawn)) {
      what.drawn = true;
      sparkline(line.canvas, what.numbers ?? []);
    }
    if (line.button) line.button.hidden = what.group || !this.button.shown(what);
    line.what = what;
  }

  choose(key) {
    this.chosen = this.cursor = key;
    this.draw();
    this.picked?.(key);
  }

  click(event) {
    const line = this.pool.find(one => one.row === event.target.closest("tr"));
    if (!line || line.what?.group) return;
    if (event.target.closest("button")) this.button.pressed(line.key);
    else if (this.picked) this.choose(line.key);
  }

  // The keys up, down, home, end move; enter and space choose.
  key(event) {
    const rows = this.rows.filter(row => !row.group), now = rows.findIndex(row => row.key === this.cursor);
    const step = { ArrowDown: 1, ArrowUp: -1, Home: -Infinity, End: Infinity }[event.key];
    if (event.target !== this.place || !rows.length) return;
    if (step !== undefined) {
      event.preventDefault();
      this.cursor = rows[Math.max(0, Math.min(rows.length - 1, now + step))].key;
      this.reveal(this.rows.findIndex(row => row.key === this.cursor));
    } else if ((event.key === "Enter" || event.key === " ") && now >= 0 && this.picked) {
      event.preventDefault();
      this.choose(this.cursor);
    }
  }

  // Scrolls so that a row is in view.
  reveal(at) {
    const top = ROW * at, height = this.place.clientHeight - 2 * ROW;
    if (this.follows !== undefined) this.follows = false;
    if (top < this.place.scrollTop) this.place.scrollTop = top;
    else if (top > this.place.scrollTop + height) this.place.scrollTop = top - height;
    this.draw();
  }
}

// The padding of a column of texts in digits; letters may be wider than digits.
const around = ({ look }) => look?.includes("right") ? 2 : 3;

// Draws tables together, once for each frame of the screen.
const dirty = new Set();
export function changed(grid) {
  if (!dirty.size) requestAnimationFrame(() => { for (const one of dirty) one.draw(); dirty.clear(); });
  dirty.add(grid);
}

export function element(name, parent) {
  return parent.appendChild(document.createElement(name));
}

function size(cell, height) {
  if (cell.style.height !== `${height}px`) cell.style.height = `${height}px`;
}
