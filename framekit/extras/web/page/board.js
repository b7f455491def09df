// The page of a run, and of simulated devices: what has changed comes over the connection, and each part takes its own.
import { Areas } from "./areas.js";
import { Cards } from "./cards.js";
import { Faults } from "./faults.js";
import { Frames } from "./frames.js";
import { Live, at } from "./live.js";
import { Points } from "./points.js";
import { Tables } from "./tables.js";
import { Trend } from "./trend.js";
import { beginNotices, takeNotices } from "./notices.js";
import { changed } from "./parts.js";

const AREA_EVERY = 500;
const live = new Live({
  hello: begin,
  table: what => tables.take(what),
  values: what => points.take(what.values),
  frames: what => frames.take(what),
  fields: what => frames.takeFields(what),
  cards: what => cards.take(what.cards),
  notices: what => takeNotices(what.notices),
  history: takeHistory,
  course: what => trend.takeCourse(what),
  ages: what => points.takeAges(what.ages),
  area: what => areas.take(what),
  find: what => areas.takeFound(what),
  faults: what => faults.take(what),
}, "fire and write", { opened: () => frames.opened(), allowed: () => {}, arrives: () => measure() });

const cards = new Cards(at("cards")), frames = new Frames(live), tables = new Tables(live);
let areas = null, faults = null, points = null, trend = null, began = null;

// The first message of a connection: the parts are made once. A page that began anew is loaded anew.
function begin(what) {
  if (began !== null && began !== what.began) { location.reload(); return; }
  if (began === null) make(what.devices !== null);
  began = what.began;
  document.title = what.hello;
  at("title").textContent = what.devices ? what.devices.map(device => device.name).join(", ") : what.hello.replace(/^run /, "");
  at("points").parentElement.hidden = !what.points.length;
  tables.begin(what.tables, what.controls);
  points.begin(what.points, behaviours(what.devices ?? []));
  trend.begin(what.stored);
  if (what.devices) {
    areas.begin(what.devices);
    faults.begin(what.devices);
  } else beginNotices(what.began);
}

function make(are_devices) {
  at("devices").hidden = !are_devices;
  points = new Points(live, { picked: key => trend.toggle(key), marked: key => trend.chosen.indexOf(key), behaves: are_devices });
  trend = new Trend(live, points);
  if (!are_devices) return;
  at("points").querySelector("h2").textContent = "Values";
  live.allows("set values and switch faults");
  areas = new Areas(live);
  faults = new Faults(live);
}

// What each value of a device does by itself, by its name.
function behaviours(devices) {
  const found = new Map();
  for (const { name, behaviours } of devices)
    for (const [point, text] of Object.entries(behaviours)) found.set(devices.length > 1 ? `${name}: ${point}` : point, text);
  return found;
}

function takeHistory(what) {
  for (const [key, [, numbers]] of Object.entries(what.history)) points.takePast(key, numbers);
  trend.takeHistory(what);
  changed(points.grid);
}

// How long the screen takes to show a message, for benchmarks/page.py: the latest drawings, their mean and their longest.
const drawn = [];
function measure() {
  const began = performance.now();
  requestAnimationFrame(() => setTimeout(() => {
    drawn.push(performance.now() - began);
    if (drawn.length > 200) drawn.shift();
    document.body.dataset.drawn = Math.round(Math.max(...drawn));
    document.body.dataset.mean = Math.round(drawn.reduce((sum, one) => sum + one, 0) / drawn.length);
  }));
}

setInterval(() => {
  if (!live.is_open || began === null) return;
  cards.second();
  points.second();
  trend.second();
  faults?.ask();
}, 1000);
setInterval(() => { if (live.is_open && began !== null) areas?.ask(); }, AREA_EVERY);
live.connect();
