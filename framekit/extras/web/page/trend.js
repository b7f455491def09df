// The course of chosen points: a lane for each unit, and for each point without a unit; one time axis. The last minutes
// come from memory and go on; longer spans come from the history of the run.
import { around, ink } from "./draw.js";
import { element } from "./parts.js";
import { at, onTheme } from "./shell.js";
import { count, value } from "./words.js";

const MOST = 6, LEFT = 52, HIGH = 361, KEPT = 3600, MEMORY = 600, AXIS = 26;
const SPANS = [[60, "1 min"], [300, "5 min"], [600, "10 min"]];
const STORED = [[3600, "1 h"], [86400, "24 h"], [604800, "7 d"]];
const MOST_CODES = 8, LONGEST_WORD = 8;
const AGAIN = 10000, FONT = "11px system-ui, sans-serif";

export class Trend {
  // `points`: the table of points, `live`: the connection.
  constructor(live, points) {
    Object.assign(this, { live, points, chosen: [], lanes: [], data: null, span: MEMORY, zoom: null, asked: 0 });
    new ResizeObserver(() => this.fit()).observe(at("lanes"));
    onTheme(() => { if (this.lanes.length) this.draw(); });
  }

  begin(stored) {
    at("spans").replaceChildren();
    for (const [span, text] of stored ? [...SPANS, ...STORED] : SPANS) {
      const button = Object.assign(element("button", at("spans")), { textContent: text });
      button.dataset.span = span;
      button.setAttribute("aria-pressed", String(span === this.span));
      button.classList.toggle("on", span === this.span);
      button.addEventListener("click", () => this.show(span));
    }
    const keys = this.points.list.map(point => point.key);
    this.chosen = this.chosen.filter(key => key < keys.length);
    if (!this.chosen.length) this.chosen = keys.filter(key => !this.points.list[key].words.length).slice(0, 3);
    this.ask();
  }

  show(span) {
    this.span = span;
    this.zoom = null;
    for (const one of at("spans").children) {
      one.classList.toggle("on", Number(one.dataset.span) === span);
      one.setAttribute("aria-pressed", String(Number(one.dataset.span) === span));
    }
    this.ask();
  }

  get is_stored() {
    return this.span > MEMORY;
  }

  toggle(key) {
    this.chosen.includes(key) ? this.chosen.splice(this.chosen.indexOf(key), 1) : this.chosen.push(key);
    if (this.chosen.length > MOST) this.chosen.shift();
    this.ask();
  }

  // ---- data

  ask() {
    this.asked = performance.now();
    if (!this.chosen.length) { this.data = null; this.draw(); return; }
    if (!this.is_stored) { this.data = null; this.live.say({ history: this.chosen, last: MEMORY }); return; }
    const now = Math.ceil(Date.now() / 1000), [since, until] = this.zoom ?? [now - this.span, now];
    this.live.say({ course: this.chosen, since: Math.floor(since), until: Math.max(Math.ceil(until), Math.floor(since) + 2) });
  }

  takeHistory({ history, last }) {
    if (this.is_stored || this.data || last !== MEMORY || !this.chosen.every(key => history[key])) return;
    this.use(history[this.chosen[0]][0], new Map(this.chosen.map(key => [key, history[key][1]])));
  }

  takeCourse(what) {
    if (!this.is_stored || String(what.course) !== String(this.chosen)) return;
    if (what.why) { this.live.tell(what.why); return; }
    this.use(what.times, new Map(what.course.map((key, at) => [key, what.numbers[at]])), [what.since, what.until]);
  }

  use(times, numbers, range = null) {
    const is_same = this.lanes.length && this.data && String([...this.data.numbers.keys()]) === String([...numbers.keys()]);
    this.data = { times, numbers, range };
    if (is_same) this.follow();
    else this.draw();
  }

  // Once a second: a moment more from memory, or now and then a new query of the history.
  second() {
    if (this.is_stored) {
      if (!this.zoom && !document.hidden && performance.now() - this.asked > AGAIN) this.ask();
      return;
    }
    if (!this.data) return;
    this.data.times.push(Date.now() / 1000);
    for (const [key, numbers] of this.data.numbers) numbers.push(this.points.list[key].number);
    if (this.data.times.length > KEPT) for (const list of [this.data.times, ...this.data.numbers.values()]) list.shift();
    if (!document.hidden) this.follow();
  }

  // ---- drawing

  draw() {
    this.lanes.forEach(({ plot }) => plot.destroy());
    this.lanes = [];
    at("lanes").replaceChildren();
    const missing = "There are no charts: install framekit with the extra 'web' again";
    const hint = !window.uPlot ? missing : this.chosen.length ? "" : "Choose points in the table to see their course";
    if (hint) Object.assign(element("p", at("lanes")), { className: "empty", textContent: hint });
    if (hint || !this.data) return;
    const lanes = Map.groupBy(this.chosen, key => this.points.list[key].unit || key);
    this.high = at("lanes").clientHeight || HIGH;
    const high = (this.high - AXIS) / lanes.size;
    for (const keys of lanes.values()) this.lanes.push(this.lane(this.points.list[keys[0]].unit, keys, high, this.lanes.length === lanes.size - 1));
    this.follow();
    queueMicrotask(() => this.follow());  // a new chart clears its values once
  }

  lane(unit, keys, high, is_last) {
    const axis = { stroke: () => ink("--muted"), grid: { stroke: () => ink("--line"), width: 1 }, ticks: { show: false }, font: FONT };
    const colour = key => ink(`--s${this.chosen.indexOf(key)}`);
    const plot = new window.uPlot({
      width: at("lanes").clientWidth,
      height: high - 20 + (is_last ? AXIS : 0),
      padding: [6, 30, is_last ? 0 : 8, 0],
      cursor: { y: false, sync: { key: "trend" }, points: { size: 6 }, drag: { x: true, y: false } },
      legend: { markers: { width: 0, fill: (_, number) => colour(keys[number - 1]) } },
      scales: { x: { time: true }, y: { range: (_, low, top) => limits(low, top, this.codes(keys)) } },
      axes: [
        { ...axis, size: is_last ? AXIS : 0, space: 80, values: (_, ticks) => ticks.map(tick => is_last ? this.time(tick) : "") },
        { ...axis, size: LEFT, space: high > 150 ? 40 : 18, ...this.marks(keys) },
      ],
      series: [{}, ...keys.map(key => this.series(key, unit, colour))],
      hooks: { setSelect: [one => this.selected(one)] },
    }, [this.data.times, ...keys.map(key => this.data.numbers.get(key))], at("lanes"));
    plot.over.addEventListener("dblclick", () => this.zoomed(null));
    return { plot, keys };
  }

  series(key, unit, colour) {
    const { name, words } = this.points.list[key];
    const spoken = number => number === null || number === undefined ? "–" : `${this.spoken(key, number)} ${unit}`;
    return {
      label: name, stroke: () => colour(key), width: 1.75, points: { show: false }, spanGaps: false,
      paths: words.length ? window.uPlot.paths.stepped({ align: 1 }) : undefined, value: (_, number) => spoken(number),
    };
  }

  // The numbers that have words, of a lane with a single point that has few of them.
  codes(keys) {
    const { codes } = this.points.list[keys[0]];
    return keys.length === 1 && codes.length <= MOST_CODES ? codes : [];
  }

  // The marks of the axis of values: words for states, else numbers.
  marks(keys) {
    const codes = this.codes(keys), word = code => short(this.spoken(keys[0], code));
    return codes.length ? { splits: () => codes, values: (_, ticks) => ticks.map(word) } : { values: (_, ticks) => ticks.map(count) };
  }

  // A number as the table shows it: its word, or as many decimals.
  spoken(key, number) {
    const { words, codes, text } = this.points.list[key], decimals = /^-?\d+\.(\d{1,6})$/.exec(text ?? "");
    if (words.length) return words[codes.indexOf(number)] ?? number;
    return value(decimals ? number.toFixed(decimals[1].length) : String(+number.toPrecision(6)), number);
  }

  time(seconds) {
    const at = new Date(seconds * 1000), clock = at.toTimeString();
    const [from, to] = this.range;
    if (to - from <= 3600) return clock.slice(0, 8);
    return to - from <= 172800 ? clock.slice(0, 5) : `${at.getDate()}.${at.getMonth() + 1}. ${clock.slice(0, 5)}`;
  }

  // The span that is shown, in seconds since 1970.
  get range() {
    const { times, range } = this.data, end = times.at(-1) ?? 0;
    const [min, max] = this.zoom ?? range ?? [Math.max(end - this.span, times[0] ?? 0), end];
    return [min, Math.max(max, min + 1)];
  }

  selected({ select, posToVal }) {
    if (select.width > 4) this.zoomed([posToVal(select.left, "x"), posToVal(select.left + select.width, "x")]);
  }

  zoomed(range) {
    this.zoom = range;
    if (this.is_stored) this.ask();
    if (this.data) this.follow();
  }

  follow() {
    at("trend").classList.toggle("zoomed", Boolean(this.zoom));
    const [min, max] = this.range;
    for (const { plot, keys } of this.lanes) {
      plot.setData([this.data.times, ...keys.map(key => this.data.numbers.get(key))], false);
      plot.setScale("x", { min, max });
      if (!(plot.cursor.left >= 0)) plot.setLegend({ idx: this.data.times.length - 1 });
    }
  }

  fit() {
    if (this.lanes.length && this.high !== at("lanes").clientHeight) { this.draw(); return; }
    this.lanes.forEach(({ plot }) => plot.setSize({ width: at("lanes").clientWidth, height: plot.height }));
  }
}

// A word that fits beside the axis.
const short = word => String(word).length > LONGEST_WORD ? `${String(word).slice(0, LONGEST_WORD - 1)}…` : word;

// The limits of an axis: a margin around the numbers, and around the states if they have words.
function limits(low, high, codes) {
  if (codes.length) return [Math.min(...codes, low ?? Infinity) - 0.2, Math.max(...codes, high ?? -Infinity) + 0.2];
  if (low === null) return [0, 1];
  return low === high ? around(low) : window.uPlot.rangeNum(low, high, 0.1, false);
}
