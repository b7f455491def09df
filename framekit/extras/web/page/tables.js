// The tables below: channels, stations, blocks, jobs, sinks, troubles – one at a time, behind tabs – and what may be done
// with a block or a channel.
import { Grid, changed, element } from "./parts.js";
import { at } from "./shell.js";
import { ask } from "./actions.js";
import { first } from "./words.js";

const NUMBERS = /^(services|errors|frames|bad|blocks|done|failed|overruns|taken|waiting|dropped|line load|load now|count)$/;
// The word on the buttons of a table.
const ACTIONS = { blocks: "Fire", channels: "Switch" };

export class Tables {
  constructor(live) {
    this.live = live;
    this.tables = new Map();
    this.tab = "";
  }

  // `described`: name and titles of each table. `controls`: whether the page has commands.
  begin(described, controls) {
    for (const [name, head] of described) {
      if (!this.tables.has(name)) this.tables.set(name, this.made(name, head, controls));
      this.tables.get(name).rows.clear();
    }
  }

  made(name, head, controls) {
    const place = element("div", at("tables")), tab = element("button", at("tabs"));
    Object.assign(place, { className: "grid" }).setAttribute("aria-label", name);
    place.dataset.table = name;
    tab.textContent = first(name);
    tab.addEventListener("click", () => this.show(name));
    const columns = head.map(text => ({ title: first(text), look: NUMBERS.test(text) ? "right" : "" }));
    const has_actions = controls && ACTIONS[name];
    const button = has_actions ? { text: ACTIONS[name], shown: () => true, pressed: key => this.question(name, key) } : null;
    if (has_actions) columns.push({ title: "", kind: "button" });
    return { place, tab, head, rows: new Map(), grid: new Grid(place, columns, { button, picked: () => {} }) };
  }

  show(name) {
    this.tab = name;
    for (const [key, { place, tab, rows }] of this.tables) {
      place.hidden = key !== name;
      tab.hidden = !rows.size;
      tab.classList.toggle("on", key === name);
      tab.setAttribute("aria-pressed", String(key === name));
    }
    changed(this.tables.get(name).grid);
  }

  take(what) {
    const table = this.tables.get(what.table);
    if (what.keys) table.rows = new Map(what.keys.map(key => [key, table.rows.get(key) ?? { key, state: "", cells: [] }]));
    for (const [key, [state, cells]] of Object.entries(what.rows)) Object.assign(table.rows.get(key), { state, cells });
    table.grid.rows = [...table.rows.values()];
    if (what.keys) this.show(this.tables.get(this.tab)?.rows.size ? this.tab : what.table);
    changed(table.grid);
  }

  cell(name, key, title) {
    const { head, rows } = this.tables.get(name);
    return rows.get(key)?.cells[head.indexOf(title)] ?? "";
  }

  question(name, key) {
    if (!this.live.may) { at("lock").open = true; at("token").focus(); return; }
    const state = this.cell(name, key, "state"), is_off = state === "off" || state === "switched off";
    const what = name === "blocks" ? `block ${key}, ${this.cell(name, key, "what")}` : `channel ${key}, ${this.cell(name, key, "driver")}`;
    const target = name === "blocks" ? key : `channel ${key}`;
    const lines = [`Now: ${state}`];
    if (name === "blocks") {
      const [done, failed, last] = ["done", "failed", "last failure"].map(title => this.cell(name, key, title));
      lines.push(`Done ${done} times, failed ${failed} times, last failure: ${last}`);
    }
    const verbs = is_off ? [["enable", "Switch on"]] : [["disable", "Switch off"]];
    if (name === "blocks" && !is_off) verbs.unshift(["fire", "Fire"]);
    const carry = verb => (_, ended) => this.live.act({ do: `${verb} ${target}` }, why => {
      ended(why);
      if (!why) this.live.tell(`Done: ${verb} ${target}`);
    });
    const [[verb, text], ...others] = verbs;
    ask({ title: `${first(what)}`, lines, button: text, act: carry(verb), others: others.map(([other, words]) => [words, carry(other)]) });
  }
}
