// The page of a run or of devices: what has changed comes over the connection, what the user wants goes there.
import { Live, at } from "./live.js";
import { Grid, element, plot } from "./parts.js";

const MINUTE = 60, KEPT = 200, DRAWN = 50;
const tables = new Map();   // by name: {grid, rows: Map, filter, section}
const points = [];          // {key, state, cells, numbers, asked, place …}
const frames = [];
let pointGrid = null, frameGrid = null, paused = false, chosen = null, history = null;
let dirty = new Set(), drawn = [], arrived = 0;

const live = new Live({
  hello: begin,
  table: takeTable,
  values: takeValues,
  frames: takeFrames,
  fields: takeFields,
  history: takeHistory,
}, "fire and write", {
  opened: ask,
  allowed,
  arrives: () => { if (!dirty.size) arrived = performance.now(); },
});
const say = what => live.say(what), act = what => live.act(what);

function ask() {
  say({ filter: at("frame-filter").value, bad: at("bad").checked });
  say({ pause: paused });
}

// ---- drawing: once a frame of the screen, whatever has come

function changed(grid) {
  if (!dirty.size) requestAnimationFrame(draw);
  dirty.add(grid);
}

function draw() {
  const grids = [...dirty];
  for (const grid of grids) grid.draw();
  if (dirty.has(pointGrid)) { counted(); drawPoint(); }
  dirty.clear();
  const from = arrived;
  requestAnimationFrame(() => {
    drawn.push(performance.now() - from);
    if (drawn.length > DRAWN) drawn.shift();
    document.body.dataset.drawn = Math.max(...drawn).toFixed(1);
    document.body.dataset.mean = (drawn.reduce((sum, one) => sum + one) / drawn.length).toFixed(1);
  });
}

// ---- tables

function begin(what) {
  if (tables.size && document.title !== what.hello) { location.reload(); return; }
  document.title = what.hello;
  at("title").textContent = what.hello;
  at("title").title = `framekit ${what.version}`;
  for (const [name, head] of what.tables) if (!tables.has(name)) tables.set(name, table(name, head));
  for (const one of tables.values()) one.rows.clear();
  points.length = frames.length = 0;
  what.points.forEach(([name, unit, place, about, writable, range, words], key) => points.push(
    { key, state: "stale", cells: [name, "-", unit, "", place], numbers: [], name, about, writable, range, words }));
  pointGrid ??= new Grid(at("points").querySelector(".grid"), [...what.pointHead, "place"],
    { picked: choosePoint, spark: true });
  at("points").hidden = !points.length;
  frameGrid ??= new Grid(at("frames").querySelector(".grid"),
    ["no.", "time", "ch", "", "size", "result", "frame", "bytes", "fields"], { picked: key => say({ frame: Number(key) }), follows: true });
  choose();
}

function table(name, head) {
  let section = at(name);
  if (!section) {
    section = at("section").content.firstElementChild.cloneNode(true);
    section.id = name;
    section.querySelector("h2").textContent = name;
    document.querySelector("main").append(section);
    if (["channels", "stations", "devices"].includes(name)) document.querySelector("main").insertBefore(section, at("points"));
  }
  const one = { section, rows: new Map(), grid: new Grid(section.querySelector(".grid"), head,
    { picked: name === "blocks" ? chooseBlock : null }) };
  section.querySelector(".filter")?.addEventListener("input", () => arrange(one));
  section.hidden = true;
  return one;
}

function takeTable(what) {
  const one = tables.get(what.table);
  if (what.keys) {
    const before = one.rows;
    one.rows = new Map(what.keys.map(key => [key, before.get(key) ?? { key, state: "", cells: [] }]));
  }
  for (const [key, [state, cells]] of Object.entries(what.rows)) Object.assign(one.rows.get(key), { state, cells });
  arrange(one);
}

function arrange(one) {
  const wanted = (one.section.querySelector(".filter")?.value ?? "").toLowerCase();
  const rows = [...one.rows.values()];
  one.grid.rows = wanted ? rows.filter(row => row.cells.some(text => text.toLowerCase().includes(wanted))) : rows;
  one.section.hidden = !rows.length;
  const count = one.section.querySelector(".count");
  if (count) count.textContent = `${one.grid.rows.length} of ${rows.length}`;
  changed(one.grid);
}

function chooseBlock(key) {
  const row = tables.get("blocks").rows.get(key);
  at("block").hidden = !row;
  at("block").dataset.key = key;
  at("block").querySelector("h3").textContent = `block ${key}: ${row?.cells[2] ?? ""}`;
}

// ---- points

function takeValues(what) {
  for (const [key, [text, quality, reason, number]] of Object.entries(what.values)) {
    const point = points[key];
    point.cells[1] = text;
    point.cells[3] = reason ? `${quality}, ${reason}` : quality;
    point.state = quality === "good" ? "" : quality;
    point.number = number;
  }
  changed(pointGrid);
}

function counted() {
  const good = points.filter(point => !point.state).length;
  at("points").querySelector(".count").textContent =
    `${pointGrid.rows.length} of ${points.length}, ${good} good, ${points.length - good} not`;
}

function choose() {
  const wanted = at("points").querySelector(".filter").value.toLowerCase();
  pointGrid.rows = wanted ? points.filter(point => point.name.toLowerCase().includes(wanted)) : points;
  changed(pointGrid);
}

function second() {
  if (!live.is_open || !pointGrid) return;
  for (const point of points) {
    point.numbers.push(point.number ?? null);
    if (point.numbers.length > MINUTE) point.numbers.shift();
    point.drawn = false;
  }
  const fresh = (pointGrid.shown ?? []).filter(point => !point.asked).slice(0, 64);
  if (fresh.length) {
    fresh.forEach(point => { point.asked = true; });
    say({ history: fresh.map(point => point.key), last: MINUTE });
  }
  if (history && chosen !== null) {
    history[0].push(Date.now() / 1000);
    history[1].push(points[chosen].number ?? null);
    history.drawn = false;
    if (history[0].length > 3600) history.forEach(list => list.shift());
  }
  changed(pointGrid);
}

function choosePoint(key) {
  chosen = key;
  history = null;
  const point = points[key];
  at("point").hidden = false;
  at("range").textContent = point.range;
  at("words").replaceChildren(...point.words.map(word => { const one = document.createElement("option"); one.value = word; return one; }));
  at("value").value = "";
  say({ history: [key], last: 3600 });
  drawPoint();
}

function takeHistory(what) {
  for (const [key, [times, numbers]] of Object.entries(what.history)) {
    points[key].numbers = numbers.slice(-MINUTE);
    points[key].asked = true;
    points[key].drawn = false;
    if (Number(key) === chosen && !history) history = [times, numbers];
  }
  changed(pointGrid);
}

function drawPoint() {
  const point = chosen === null ? null : points[chosen];
  at("point").hidden = !point;
  if (!point) return;
  const [name, value, unit, quality, place] = point.cells;
  at("point").querySelector("h3").textContent =
    [name, `${value} ${unit}`.trim(), quality, place, point.about].filter(Boolean).join(" · ");
  at("write").hidden = !(live.may && point.writable);
  if (history && !history.drawn) {
    history.drawn = true;
    plot(at("point").querySelector("canvas"), history[0], history[1]);
  }
}

// ---- frames

function takeFrames(what) {
  if (what.anew) frames.length = 0;
  if (what.anew) frameGrid.follows = true;
  for (const cells of what.frames) frames.push({ key: cells[0], state: cells[6].startsWith("! ") ? "bad" : "", cells });
  if (frames.length > KEPT) frames.splice(0, frames.length - KEPT);
  const [good, bad, noise] = what.counts;
  at("frames").querySelector(".count").textContent = `${good} good, ${bad} bad, ${noise} times noise`
    + (what.missed ? `; ${what.missed} more than are shown` : "");
  frameGrid.rows = frames;
  changed(frameGrid);
}

function takeFields(what) {
  const box = at("bytes"), body = at("fields").tBodies[0];
  at("frame").hidden = false;
  box.replaceChildren();
  body.replaceChildren();
  if (what.gone) { at("frame").querySelector("h3").textContent = `frame ${what.fields} is no longer kept`; return; }
  const bytes = what.bytes.match(/../g) ?? [];
  const fault = what.fault ? ` – ${what.fault[0]} at byte ${what.fault[1]}` : "";
  at("frame").querySelector("h3").textContent = `frame ${what.fields}: ${what.what}, ${bytes.length} bytes${fault}`;
  const owner = new Array(bytes.length).fill(null);
  for (const row of [...what.rows].sort((one, other) => other[5] - one[5]))
    for (let place = row[4]; place < row[4] + row[5]; place++) owner[place] = row;
  for (let first = 0, end; first < bytes.length; first = end) {
    for (end = first + 1; end < bytes.length && owner[end] === owner[first] && end !== what.fault?.[1]; end++);
    const row = owner[first], one = element("div", box);
    for (const [kind, text] of [["name", row?.[0] ?? ""], ["hex", bytes.slice(first, end).join(" ").toUpperCase()], ["value", row?.[3] ?? ""]]) {
      const part = element("div", one);
      part.className = kind;
      part.textContent = text || "\u00a0";
    }
    if (what.fault && first === what.fault[1]) one.classList.add("fault");
  }
  for (const row of what.rows) {
    const line = element("tr", body);
    for (const text of row.slice(0, 4)) element("td", line).textContent = text;
  }
}

// ---- what the user does

function allowed(yes) {
  for (const button of at("block").querySelectorAll("button")) button.disabled = !yes;
  drawPoint();
}

function listen() {
  at("write").addEventListener("submit", event => {
    event.preventDefault();
    act({ write: chosen, value: at("value").value });
  });
  for (const button of at("block").querySelectorAll("button"))
    button.addEventListener("click", () => act({ do: `${button.dataset.do} ${at("block").dataset.key}` }));
  at("pause").addEventListener("click", () => {
    paused = !paused;
    at("pause").textContent = paused ? "go on" : "pause";
    say({ pause: paused });
  });
  let waiting = 0;
  at("frame-filter").addEventListener("input", () => { clearTimeout(waiting); waiting = setTimeout(ask, 250); });
  at("bad").addEventListener("change", ask);
  at("points").querySelector(".filter").addEventListener("input", choose);
}

listen();
live.allow(false);
setInterval(second, 1000);
live.connect();
