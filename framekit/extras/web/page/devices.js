// The page of served devices: their values and memory, their faults, and the frames on the line.
import { Areas } from "./areas.js";
import { Cards } from "./cards.js";
import { Faults } from "./faults.js";
import { Frames } from "./frames.js";
import { Live, at } from "./live.js";
import { Points } from "./points.js";
import { Tables } from "./tables.js";
import { Trend } from "./trend.js";
import { changed } from "./parts.js";

const AREA_EVERY = 500;
const live = new Live({
  hello: begin,
  table: what => tables.take(what),
  values: what => points.take(what.values),
  frames: what => frames.take(what),
  fields: what => frames.takeFields(what),
  cards: what => cards.take(what.cards),
  history: takeHistory,
  ages: what => points.takeAges(what.ages),
  area: what => areas.take(what),
  find: what => areas.takeFound(what),
  faults: what => faults.take(what),
}, "set values and switch faults", { opened: () => frames.opened(), allowed: () => {} });

const cards = new Cards(at("cards")), frames = new Frames(live), tables = new Tables(live);
const areas = new Areas(live), faults = new Faults(live);
const points = new Points(live, { picked: key => trend.toggle(key), marked: key => trend.chosen.indexOf(key), behaves: true });
const trend = new Trend(live, points);
let began = null;

function begin(what) {
  if (began !== null && began !== what.began) { location.reload(); return; }
  began = what.began;
  document.title = what.hello;
  at("title").textContent = what.devices.map(device => device.name).join(", ");
  at("points").parentElement.hidden = !what.points.length;
  tables.begin(what.tables, what.controls);
  points.begin(what.points, behaviours(what));
  trend.begin(what.stored);
  areas.begin(what.devices);
  faults.begin(what.devices);
}

// What each point does by itself, by its name.
function behaviours({ devices }) {
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

setInterval(() => {
  if (!live.is_open || began === null) return;
  cards.second();
  points.second();
  trend.second();
  faults.ask();
}, 1000);
setInterval(() => { if (live.is_open && began !== null) areas.ask(); }, AREA_EVERY);
live.connect();
