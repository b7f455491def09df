// Parts of the page: a table of any length of which only what is seen is drawn, and drawings of numbers over time.
// Texts come from devices and files: they are set as text, never as markup.

const ROW = 22, TALLEST = 304, WIDEST = 48, WIDEST_LAST = 100;

export class Grid {
  // `follows`: it stays at its last row, until the user scrolls away from there.
  // Rows {key, state, cells, numbers, drawn}; `spark`: a last column draws the numbers, where `drawn` is not set. `picked` is told which row was clicked.
  constructor(place, head, { picked = null, spark = false, follows = undefined } = {}) {
    this.place = place;
    this.rows = [];
    this.picked = picked;
    this.spark = spark;
    this.follows = follows;
    this.chosen = null;
    this.pool = [];
    this.widths = head.map(text => text.length);
    const table = element("table", place);
    this.columns = [...head, ...(spark ? [""] : [])].map(() => element("col", this.group ??= element("colgroup", table)));
    const top = element("tr", element("thead", table));
    for (const text of [...head, ...(spark ? ["last minute"] : [])]) element("th", top).textContent = text;
    this.before = element("tr", element("tbody", table)).appendChild(document.createElement("td"));
    this.body = element("tbody", table);
    this.after = element("tr", element("tbody", table)).appendChild(document.createElement("td"));
    this.before.style.height = this.after.style.height = "0";
    this.measure(head);
    place.addEventListener("scroll", () => this.moved());
    this.body.addEventListener("click", event => this.click(event.target.closest("tr")));
  }

  measure(cells) {
    let wider = false;
    cells.forEach((text, at) => {
      const length = Math.min(at === cells.length - 1 ? WIDEST_LAST : WIDEST, text.length);
      if (length > (this.widths[at] ?? 0) || !this.columns[at].style.width) {
        this.widths[at] = Math.max(length, this.widths[at] ?? 0);
        this.columns[at].style.width = `${this.widths[at] + 2}ch`;
        wider = true;
      }
    });
    if (wider && this.spark) this.columns.at(-1).style.width = "17ch";
  }

  moved() {
    const followed = this.follows;
    if (followed !== undefined)
      this.follows = this.place.scrollTop + this.place.clientHeight >= this.place.scrollHeight - ROW;
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
    if (this.follows) this.place.scrollTop = ROW * (this.rows.length + 1);
  }

  line() {
    const row = element("tr", this.body);
    const cells = this.columns.map(() => element("td", row));
    if (!this.spark) return { row, cells, texts: [] };
    const canvas = element("canvas", cells.pop());
    canvas.width = 120;
    canvas.height = 20;
    return { row, cells, texts: [], canvas };
  }

  fill(line, what) {
    line.row.hidden = !what;
    line.key = what?.key;
    if (!what) return;
    const state = `row ${what.state}${what.key === this.chosen ? " picked" : ""}`;
    if (line.state !== state) line.row.className = line.state = state;
    this.measure(what.cells);
    what.cells.forEach((text, at) => {
      if (line.texts[at] !== text) {
        line.cells[at].textContent = line.texts[at] = text;
        line.cells[at].title = text.length > WIDEST ? text : "";
      }
    });
    if (line.canvas && (line.what !== what || !what.drawn)) {
      what.drawn = true;
      sparkline(line.canvas, what.numbers);
    }
    line.what = what;
  }

  click(row) {
    const line = this.pool.find(one => one.row === row);
    if (!line || !this.picked) return;
    this.chosen = line.key;
    this.draw();
    this.picked(line.key);
  }
}

export function element(name, parent) {
  return parent.appendChild(document.createElement(name));
}

function size(cell, height) {
  if (cell.style.height !== `${height}px`) cell.style.height = `${height}px`;
}

function bounds(numbers) {
  let low = Infinity, high = -Infinity;
  for (const number of numbers) if (number !== null) { low = Math.min(low, number); high = Math.max(high, number); }
  return low > high ? null : low === high ? [low - 1, high + 1] : [low, high];
}

function trace(pen, xs, numbers, [low, high], height) {
  let down = false;
  pen.beginPath();
  numbers.forEach((number, at) => {
    if (number === null) { down = false; return; }
    const y = height - 2 - (number - low) / (high - low) * (height - 4);
    down ? pen.lineTo(xs(at), y) : pen.moveTo(xs(at), y);
    if (!down) pen.lineTo(xs(at) + 1, y);
    down = true;
  });
  pen.stroke();
}

let color = null;
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { color = null; });

export function sparkline(canvas, numbers) {
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  const range = bounds(numbers);
  if (!range) return;
  pen.strokeStyle = color ??= getComputedStyle(document.body).color;
  const step = canvas.width / 60, start = canvas.width - step * numbers.length;
  trace(pen, at => start + at * step, numbers, range, canvas.height);
}

export function plot(canvas, times, numbers, told = clock) {
  canvas.width = canvas.clientWidth || 900;
  const pen = canvas.getContext("2d"), { width, height } = canvas;
  pen.fillStyle = pen.strokeStyle = color ??= getComputedStyle(document.body).color;
  pen.font = "12px ui-monospace, monospace";
  const range = bounds(numbers);
  if (!range) { pen.fillText("no good values yet", 10, 20); return; }
  const left = 90, bottom = 22, first = times[0], span = Math.max(1, times.at(-1) - first);
  pen.fillText(short(range[1]), 4, 14);
  pen.fillText(short(range[0]), 4, height - bottom);
  pen.fillText(told(first), left, height - 5);
  pen.textAlign = "right";
  pen.fillText(told(times.at(-1)), width - 4, height - 5);
  pen.save();
  pen.globalAlpha = 0.3;
  pen.strokeRect(left, 2, width - left - 4, height - bottom);
  pen.restore();
  pen.save();
  pen.translate(left, 2);
  trace(pen, at => (times[at] - first) / span * (width - left - 4), numbers, range, height - bottom);
  pen.restore();
}

function short(number) {
  return Number(number.toPrecision(6)).toString();
}

function clock(seconds) {
  return new Date(seconds * 1000).toTimeString().slice(0, 8);
}
