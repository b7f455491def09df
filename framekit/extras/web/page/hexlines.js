// Lines of bytes, of any number: only those that are seen are drawn, and they are asked for a page at a time.
import { element } from "./parts.js";

const ROW = 22, PAGE = 100, KEPT = 40, TALLEST = 8000000, ASKED_EVERY = 30;
const LONGEST_NAME = 16, TINTS = 4, BYTE = 3, BORDERS = 8, MORE = 3, WHEEL = 3, SMALL = 480;

export class HexLines {
  // `ask(first, count, kind, width)` brings lines by `put`; `pointed(byte, event)` and `chosen(byte, more)` are told of
  // bytes {line, at}; `widths`: bytes that a line may have.
  constructor(place, heads, { ask, pointed, picked }) {
    Object.assign(this, { place, heads, ask, pointed, picked });
    this.widths = [16];
    this.width = 16;
    this.kind = null;
    this.kinds = [];
    this.rows = this.of = 0;
    this.timed = 0;
    this.pages = new Map();
    this.asked = new Set();
    this.pool = [];
    this.choice = null;
    this.shades = new Set();
    this.first = 0;
    this.tall = element("div", place);
    this.tall.className = "tall";
    this.body = element("div", this.tall);
    this.body.className = "body";
    place.addEventListener("scroll", () => { this.moved(); this.heads.scrollLeft = place.scrollLeft; });
    place.addEventListener("wheel", event => this.wheel(event), { passive: false });
    place.addEventListener("mousedown", event => this.press(event));
    place.addEventListener("mousemove", event => this.move(event));
    place.addEventListener("mouseleave", () => this.pointed(null, null));
    window.addEventListener("mouseup", () => this.release());
    new ResizeObserver(() => this.fit()).observe(place);
  }

  // ---- what there is

  begin(what) {
    for (const name of ["kinds", "timed", "rows"]) this[name] = what[name];
    const enough = what.widths.findIndex(width => width >= what.longest);
    this.widths = enough < 0 ? what.widths : what.widths.slice(0, enough + 1);
    this.fit(true);
  }

  show(kind) {
    this.kind = kind;
    this.place.scrollTop = 0;
    this.anew();
  }

  anew() {
    this.pages.clear();
    this.asked.clear();
    this.want(0);
    this.draw();
  }

  fit(always = false) {
    const sign = this.sign(), before = sign * this.columns.reduce((sum, [, size]) => sum + size, MORE);
    const fitting = this.widths.filter(width => before + (BYTE * sign + BORDERS) * width <= this.place.clientWidth);
    const width = fitting.length ? fitting.at(-1) : this.widths[0];
    this.place.classList.toggle("narrow", !fitting.length);
    if (width !== this.width || always) {
      this.width = width;
      this.pool = [];
      this.body.replaceChildren();
      this.head();
      this.place.scrollTop = 0;
      this.anew();
    } else this.draw();
  }

  sign() {
    const one = element("span", this.heads);
    one.textContent = "0".repeat(20);
    const size = one.getBoundingClientRect().width / 20;
    one.remove();
    return size || 7.5;
  }

  named() {
    return Math.min(LONGEST_NAME, Math.max(5, ...this.kinds.map(kind => kind[0].length))) + 1;
  }

  put(what) {
    if (what.width !== this.width || what.kind !== this.kind) return;
    this.of = what.of;
    const page = what.lines / PAGE;
    this.asked.delete(page);
    this.pages.set(page, what.list);
    if (this.pages.size > KEPT) this.pages.delete(this.pages.keys().next().value);
    for (const line of what.list) {
      for (const span of line[8]) this.shades.add(span[2]);
      if (line[5] < 0) this.shades.add(line[9] ? "faulty" : "noise");
    }
    this.draw();
  }

  want(page) {
    if (this.pages.has(page) || this.asked.has(page) || page < 0) return;
    this.asked.add(page);
    this.ask(page * PAGE, PAGE, this.kind, this.width);
  }

  lost() {
    this.asked.clear();
  }

  line(number) {
    const cells = this.pages.get(Math.floor(number / PAGE))?.[number % PAGE];
    if (!cells) return undefined;
    const [row, offset, time, pause, way, kind, size, hex, spans, fault] = cells;
    return { row, offset, time, pause, way, kind, size, hex, spans, fault };
  }

  // ---- drawing

  get seen() {
    return Math.max(1, Math.floor(this.place.clientHeight / ROW));
  }

  get scaled() {
    return this.of * ROW > TALLEST;
  }

  top() {
    if (!this.scaled) return Math.floor(this.place.scrollTop / ROW);
    return this.first;
  }

  moved() {
    if (this.scaled) {
      const share = this.place.scrollTop / Math.max(1, TALLEST - this.place.clientHeight);
      if (this.setting) this.setting = false;
      else this.first = Math.round(share * Math.max(0, this.of - this.seen));
    }
    this.draw();
  }

  wheel(event) {
    if (!this.scaled) return;
    event.preventDefault();
    this.first = Math.max(0, Math.min(this.of - this.seen, this.first + Math.sign(event.deltaY) * WHEEL));
    this.setting = true;
    this.place.scrollTop = this.first / Math.max(1, this.of - this.seen) * (TALLEST - this.place.clientHeight);
    this.draw();
  }

  draw() {
    if (this.waits) return;
    this.waits = true;
    requestAnimationFrame(() => { this.waits = false; this.drawNow(); });
  }

  drawNow() {
    const tall = `${Math.min(TALLEST, this.of * ROW)}px`;
    if (this.tall.style.height !== tall) this.tall.style.height = tall;
    const first = Math.max(0, Math.min(this.top(), this.of - 1)), count = Math.min(this.seen + 1, this.of - first);
    this.body.style.height = `${Math.min(this.of, this.seen) * ROW}px`;
    while (this.pool.length < count) this.pool.push(this.made());
    this.pool.forEach((cells, at) => this.fill(cells, at < count ? first + at : null));
    this.asks ||= setTimeout(() => this.wantSeen(), ASKED_EVERY);
    this.drawn?.();
  }

  // What is seen now is asked for, not all that was passed by.
  wantSeen() {
    this.asks = 0;
    const first = Math.max(0, this.top());
    for (let page = Math.floor(first / PAGE); page <= Math.floor((first + this.seen) / PAGE); page++)
      if (page * PAGE < this.of || !page) this.want(page);
  }

  // The columns before the bytes, with their sizes in characters; times have no room on a telephone.
  get columns() {
    const timed = this.place.clientWidth < SMALL ? 0 : this.timed;
    const digits = Math.max(3, String(this.rows).length) + 1;
    return [["number", digits, "right dim", "no."], ["time", timed ? Math.max(6, timed) + 1 : 0, "right", "s"], ["pause", timed ? 7 : 0, "right dim", "+ ms"],
      ["way", 2.5, "", ""], ["kind", this.named(), "kind", "frame"]];
  }

  head() {
    this.heads.replaceChildren();
    const line = element("div", this.heads);
    line.className = "cells";
    for (const [, size, look, name] of this.columns) cell(line, size, look).textContent = name;
    const hex = cell(line, 0, "hex");
    hex.hidden = false;
    for (let at = 0; at < this.width; at++) element("i", hex).textContent = at;
  }

  made() {
    const line = element("div", this.body), cells = { line, bytes: [], signs: [], data: null };
    line.className = "cells";
    for (const [name, size, look] of this.columns) cells[name] = cell(line, size, look);
    for (const [name, list] of [["hex", cells.bytes], ["ascii", cells.signs]]) {
      const box = element("span", line);
      box.className = name;
      for (let at = 0; at < this.width; at++) {
        const one = element("i", box);
        one.dataset.at = at;
        list.push(one);
      }
    }
    return cells;
  }

  fill(cells, number) {
    const line = number === null ? undefined : this.line(number);
    cells.line.hidden = number === null;
    cells.data = line;
    if (number === null) return;
    const first = line && !line.offset;
    cells.line.className = `cells${first ? " first" : ""}${line?.fault ? " bad" : ""}`;
    text(cells.number, first ? String(line.row + 1) : "");
    text(cells.time, first ? line.time : "");
    text(cells.pause, first && line.pause ? `+${line.pause}` : "");
    text(cells.way, first ? { in: "←", out: "→" }[line.way] ?? "" : line ? "" : "…");
    text(cells.kind, first ? (line.kind < 0 ? (line.fault ? "bad" : "noise") : this.kinds[line.kind][0]) : "");
    cells.kind.title = line ? line.fault || this.kinds[line.kind]?.[0] || "" : "";
    const looks = new Array(this.width).fill("");
    for (const [begin, end, shade, name, start] of line?.spans ?? []) {
      const look = `${shade} ${tint(shade, name)}`;
      for (let at = begin; at < end; at++) looks[at - line.offset] = at === start ? `${look} begin` : look;
    }
    const count = (line?.hex.length ?? 0) / 2, bad = line && line.kind < 0 ? (line.fault ? "faulty" : "noise") : "";
    for (let at = 0; at < this.width; at++) {
      let look = at < count ? looks[at] || bad || "unread" : "none";
      if (at < count) look += this.mark(line, line.offset + at);
      const byte = at < count ? parseInt(line.hex.slice(2 * at, 2 * at + 2), 16) : 0;
      const readable = byte >= 32 && byte < 127;
      set(cells.bytes[at], look, at < count ? line.hex.slice(2 * at, 2 * at + 2).toUpperCase() : "");
      set(cells.signs[at], readable || at >= count ? look : `${look} odd`, at < count ? (readable ? String.fromCharCode(byte) : "·") : "");
    }
  }

  mark(line, at) {
    const choice = this.choice;
    if (!choice || at < choice.first || at >= choice.first + choice.size) return "";
    if (line.row === choice.row) return " here";
    return line.kind >= 0 && line.kind === choice.kind ? " alike" : "";
  }

  // ---- what the user does

  byte(event) {
    const cell = event.target.closest?.("i");
    if (!cell || cell.classList.contains("none")) return null;
    const line = this.pool.find(one => one.line === cell.closest(".cells"))?.data;
    return line ? { line, at: line.offset + Number(cell.dataset.at) } : null;
  }

  press(event) {
    const byte = event.button ? null : this.byte(event);
    if (!byte) return;
    this.pressed = byte;
    this.dragged = false;
  }

  move(event) {
    const byte = this.byte(event);
    if (this.pressed && byte && event.buttons & 1 && byte.line.row === this.pressed.line.row && byte.at !== this.pressed.at) this.dragged = true;
    if (this.dragged && byte && byte.line.row === this.pressed.line.row) {
      const first = Math.min(byte.at, this.pressed.at), last = Math.max(byte.at, this.pressed.at);
      this.choose({ row: byte.line.row, kind: byte.line.kind, first, size: last - first + 1 });
    }
    this.pointed(this.dragged ? null : byte, event);
  }

  release() {
    const pressed = this.pressed;
    this.pressed = null;
    if (!pressed) return;
    if (this.dragged) this.picked(this.choice);
    else this.picked(this.clicked(pressed));
    this.dragged = false;
  }

  // A click chooses the field, and of a chosen field the byte.
  clicked({ line, at }) {
    const one = { row: line.row, kind: line.kind, first: at, size: 1 }, choice = this.choice;
    if (choice && choice.row === line.row && choice.size > 1 && at >= choice.first && at < choice.first + choice.size) return one;
    const span = this.spans(line).find(([begin, end]) => begin <= at && at < end);
    if (!span || span[2] === "value" || span[1] - span[0] > 64) return one;
    return { ...one, first: span[0], size: span[1] - span[0] };
  }

  // The fields of a row that its lines show, put together.
  spans(line) {
    const found = new Map();
    for (const list of this.pages.values()) for (const cells of list) if (cells[0] === line.row)
      for (const [begin, end, shade, name, start] of cells[8]) {
        const before = found.get(start);
        found.set(start, before ? [Math.min(begin, before[0]), Math.max(end, before[1]), shade, name] : [begin, end, shade, name]);
      }
    return [...found.values()];
  }

  choose(choice) {
    this.choice = choice;
    this.draw();
  }
}

const tints = new Map();

// Names have one of some colours, always the same one.
export function tint(shade, name) {
  if (shade !== "named") return "";
  if (!tints.has(name)) tints.set(name, tints.size % TINTS);
  return `tint${tints.get(name)}`;
}

function cell(line, size, look) {
  const one = element("span", line);
  one.className = look;
  if (size) one.style.width = `${size}ch`;
  else one.hidden = true;
  return one;
}

function text(cell, what) {
  if (cell.textContent !== what) cell.textContent = what;
}

function set(cell, look, what) {
  if (cell.className !== look) cell.className = look;
  text(cell, what);
}
