// The table of points: values, quality in colour and word, age, the last minute; groups, a filter, and a button to write.
import { MINUTE } from "./draw.js";
import { Grid, changed, element } from "./parts.js";
import { at, onTheme } from "./shell.js";
import { age, value } from "./words.js";
import { ask } from "./actions.js";

const MOST_ASKED = 64, WIDEST_QUALITY = 16, ROW = 31, LOWEST = 361, HIGHEST = 560;

export class Points {
  // `live`: the connection; `picked(key)`: a point was chosen; `marked(key)`: the number of its colour, or -1.
  // `behaves`: the points are values of devices, which behave instead of being good and having an age.
  constructor(live, { picked, marked, behaves = false }) {
    Object.assign(this, { live, behaves, list: [] });
    const past = { title: "Last minute", kind: "spark" }, write = { title: "", kind: "button" };
    const columns = [
      { title: behaves ? "Name" : "Point", look: "strong" }, { title: "Value", look: "right" },
      { title: "Unit", look: "muted unit", name: "unit" },
      ...(behaves ? [past, write, { title: "Behaviour", look: "muted rest" }]
        : [{ title: "Quality", look: "quality", widest: WIDEST_QUALITY }, { title: "Age", look: "right muted" }, past, write]),
    ];
    const button = { text: "Write", shown: row => row.writable, pressed: key => this.write(key) };
    const empty = () => at("point-filter").value || at("group").value !== "!" ? "No name fits the filter" : "All are good";
    this.grid = new Grid(at("points").querySelector(".grid"), columns, { picked, marked, button, empty });
    at("point-filter").addEventListener("input", () => this.arrange());
    at("group").addEventListener("change", () => this.arrange());
    at("wrong").addEventListener("click", () => { at("group").value = at("group").value === "!" ? "" : "!"; this.arrange(); });
    onTheme(() => { for (const point of this.list) point.drawn = false; changed(this.grid); });
  }

  // `behaviours`: sentences by the names of points.
  begin(described, behaviours = new Map()) {
    this.list.length = 0;
    described.forEach(([name, unit, place, about, writable, range, words, group, codes], key) => this.list.push({
      key, name, unit, place, about, writable, range, words, codes, of: group, behaviour: behaviours.get(name) ?? "",
      state: "stale", cells: [name, "–", unit, "", ""].slice(0, this.behaves ? 4 : 5), numbers: [], number: null,
    }));
    this.grid.hide("button", !this.list.some(point => point.writable));
    this.grid.hide("unit", !this.list.some(point => point.unit));
    this.groups = [...new Set(this.list.map(point => point.of))];
    const select = at("group"), before = select.value;
    select.hidden = this.behaves && this.groups.length < 2;
    select.replaceChildren();
    for (const [id, text] of [["", "All"], ["!", "Not good"], ...(this.groups.length > 1 ? this.groups.map(group => [`=${group}`, group]) : [])])
      Object.assign(element("option", select), { value: id, textContent: text });
    if ([...select.options].some(one => one.value === before)) select.value = before;
    this.arrange();
  }

  // Values: text, quality, reason and the number to draw, by the number of the point.
  take(values) {
    for (const [key, [text, quality, reason, number]] of Object.entries(values)) {
      const point = this.list[key];
      Object.assign(point, { text, number, state: quality === "good" ? "" : quality });
      const state = this.behaves ? [point.behaviour] : [reason ? `${quality}, ${reason}` : quality, point.cells[4]];
      point.cells = [point.name, value(text, number), point.unit, ...state];
    }
    this.warn();
    if (at("group").value === "!") this.arrange();
    else changed(this.grid);
  }

  // How many are not good, at the head of the table: their rows may be below the others. A click shows them alone.
  warn() {
    const wrong = this.behaves ? [] : this.list.filter(point => point.state && point.text !== undefined);
    at("wrong").hidden = !wrong.length;
    at("wrong").textContent = `${wrong.length} not good`;
    at("wrong").className = `pill ${wrong.some(point => point.state === "failed") ? "bad" : "warn"}`;
    at("wrong").setAttribute("aria-pressed", String(at("group").value === "!"));
  }

  arrange() {
    const wanted = at("point-filter").value.toLowerCase(), group = at("group").value;
    const chosen = this.list.filter(point =>
      (!wanted || [point.name, point.unit, point.about].some(text => text.toLowerCase().includes(wanted)))
      && (!group || (group === "!" ? point.state : point.of === group.slice(1))));
    this.grid.rows = this.groups.length < 2 || group ? chosen : this.groups.flatMap(name => {
      const members = chosen.filter(point => point.of === name);
      return members.length ? [{ key: `group ${name}`, state: "", group: true, cells: [name] }, ...members] : [];
    });
    const high = Math.min(HIGHEST, Math.max(LOWEST, ROW * (this.grid.rows.length + 1) + 1));
    if (!wanted && !group) this.grid.place.style.flexBasis = `${high}px`;
    this.warn();
    at("points").querySelector(".count").textContent = wanted || group ? `${chosen.length} of ${this.list.length}` : "";
    changed(this.grid);
  }

  // Once a second: the numbers of the last minute move on; rows in view ask for their past and their age.
  second() {
    for (const point of this.list) {
      point.numbers.push(point.number);
      if (point.numbers.length > MINUTE) point.numbers.shift();
      point.drawn = false;
    }
    const shown = (this.grid.shown ?? []).filter(row => !row.group).slice(0, MOST_ASKED), fresh = shown.filter(point => !point.asked);
    fresh.forEach(point => { point.asked = true; });
    if (fresh.length) this.live.say({ history: fresh.map(point => point.key), last: MINUTE });
    if (shown.length && !this.behaves) this.live.say({ ages: shown.map(point => point.key) });
    changed(this.grid);
  }

  takeAges(ages) {
    for (const [key, seconds] of Object.entries(ages)) this.list[key].cells[4] = age(seconds);
    changed(this.grid);
  }

  // The last minute, for the small drawing.
  takePast(key, numbers) {
    Object.assign(this.list[key], { numbers: numbers.slice(-MINUTE), asked: true, drawn: false });
    changed(this.grid);
  }

  // A value with its unit, as sentences show it.
  spoken(key) {
    const { cells, unit, text } = this.list[key];
    return text === undefined || text === "-" ? "not known" : `${cells[1]} ${unit}`.trim();
  }

  write(key) {
    const point = this.list[key];
    if (!this.live.may) { at("lock").open = true; at("token").focus(); return; }
    const before = this.spoken(key);
    ask({
      title: `Write ${point.name}`,
      lines: [`Now: ${before}`, ...(point.place ? [`At ${point.place}`] : [])],
      button: "Write",
      field: { label: point.range ? `New value, ${point.range} ${point.unit}` : `New value ${point.unit}`, words: point.words, hint: point.range },
      confirm: text => `Write ${text} ${point.unit} in place of ${this.spoken(key)}?`,
      act: (text, ended) => this.live.act({ write: key, value: text }, why => {
        ended(why);
        if (!why) this.live.tell(`${point.name} is written: ${text}, before ${before}`);
      }),
    });
  }
}
