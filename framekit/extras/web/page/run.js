// The page of a run: what has changed comes over the connection, and each part takes its own.
import { Cards } from "./cards.js";
import { Frames } from "./frames.js";
import { Live, at } from "./live.js";
import { Points } from "./points.js";
import { Tables } from "./tables.js";
import { Trend } from "./trend.js";
import { beginNotices, takeNotices } from "./notices.js";
import { changed } from "./parts.js";

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
}, "fire and write", { opened: () => frames.opened(), allowed: () => {}, arrives: () => measure() });

const cards = new Cards(at("cards")), frames = new Frames(live), tables = new Tables(live);
const points = new Points(live, { picked: key => trend.toggle(key), marked: key => trend.chosen.indexOf(key) });
const trend = new Trend(live, points);
let began = null;

function begin(what) {
  if (began !== null && began !== what.began) { location.reload(); return; }
  began = what.began;
  document.title = what.hello;
  at("title").textContent = what.hello.replace(/^(run|serve) /, "");
  at("points").parentElement.hidden = !what.points.length;
  tables.begin(what.tables, what.controls);
  points.begin(what.points);
  trend.begin(what.stored);
  beginNotices(what.began);
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
}, 1000);
live.connect();
