// The page of an unknown line: what is known of each byte in colours, and names for fields. What the user names goes to
// the definition, which the program checks and writes.
import { HexLines, tint } from "./hexlines.js";
import { Live, at } from "./live.js";
import { plot } from "./draw.js";
import { element } from "./parts.js";

const POINTING = 120;
const SHADES = {
  mark: "where frames begin and end", constant: "always the same", function: "tells the kinds of frames apart",
  length: "length", count: "count", counter: "counter", copy: "as in the request", check: "check", text: "text",
  value: "changes", named: "has a name", noise: "noise: in no frame", faulty: "not a good frame",
};
const LOOKED = ["u16", "i16", "f32"];
let kinds = [], types = {}, round = 0, file = "", canName = false, chosen = null, shown = null, tipTimer = 0, pointing = null;
const tips = new Map();

const live = new Live({
  hello: begin,
  list: what => what.lines === undefined ? takeFields(what) : takeLines(what),
  point: takePoint,
  course: takeCourse,
  draft: takeDraft,
  problems: takeRound,
  done: what => { if (!what.why) at("name").blur(); },
}, "name fields", { opened: () => lines.lost(), allowed: () => drawNaming() });

const lines = new HexLines(at("lines"), at("heads"), {
  ask: (first, most, kind, width) => live.say({ lines: first, most, kind, width }),
  pointed,
  picked: choose,
});
lines.drawn = drawLegend;

// ---- what there is

function begin(what) {
  if (document.title === what.hello && kinds.length !== what.kinds.length) { location.reload(); return; }
  document.title = what.hello;
  at("title").textContent = what.hello;
  at("title").title = `framekit ${what.version}`;
  ({ kinds, types, file } = what);
  canName = what.names;
  const select = at("kinds"), before = select.value;
  select.replaceChildren();
  option(select, "", `Everything: ${counted(what.rows, "row")}`);
  kinds.forEach(([name, side, count], number) => option(select, number, `${name}${side ? `, ${side}` : ""}: ${counted(count, "frame")}`));
  if (what.others) option(select, -1, `No good frame: ${counted(what.others, "row")}`);
  if ([...select.options].some(one => one.value === before)) select.value = before;
  at("said").hidden = !what.statements.length;
  at("said").querySelector("ul").replaceChildren(...what.statements.map(statement));
  at("definition").hidden = !canName;
  document.body.classList.toggle("shows", !canName);
  lines.kind = wanted();
  lines.begin(what);
  if (kinds.length && !chosen) live.say({ fields: Math.max(0, wanted() ?? 0) });
}

function counted(count, what) {
  return `${count.toLocaleString("en")} ${what}${count === 1 ? "" : "s"}`;
}

function option(select, value, words) {
  const one = element("option", select);
  one.value = value;
  one.textContent = words;
}

function statement([sure, words, evidence, against]) {
  const line = document.createElement("li");
  const badge = element("b", line);
  badge.textContent = sure ? "Sure" : "Maybe";
  badge.className = sure ? "sure" : "";
  line.append(`${words} (${evidence})`);
  if (against) {
    const more = element("span", line);
    more.className = "against";
    more.textContent = ` – against it: ${against}`;
  }
  return line;
}

function wanted() {
  return at("kinds").value === "" ? null : Number(at("kinds").value);
}

function takeLines(what) {
  if (what.round < round) return;
  lines.put(what);
}

function drawLegend() {
  const known = Object.keys(SHADES).filter(shade => lines.shades.has(shade));
  if (at("legend").dataset.known === known.join()) return;
  at("legend").dataset.known = known.join();
  at("legend").replaceChildren(...known.map(shade => {
    const one = document.createElement("span");
    chip(one, shade);
    one.append(SHADES[shade]);
    return one;
  }));
}

function chip(parent, shade) {
  element("span", parent).className = `chip ${shade}`;
}

// ---- pointing at a byte

function pointed(byte, event) {
  clearTimeout(tipTimer);
  if (!byte) { at("tip").hidden = true; pointing = null; return; }
  const key = `${byte.line.row} ${byte.at}`;
  if (pointing?.key !== key) at("tip").hidden = true;
  pointing = { key, x: event.clientX, y: event.clientY };
  if (tips.has(key)) drawTip(tips.get(key));
  else tipTimer = setTimeout(() => live.say({ point: byte.line.row, first: byte.at, size: 1 }), POINTING);
}

function drawTip(what) {
  const tip = at("tip"), head = document.createElement("div");
  tip.replaceChildren(head);
  if (what.field) chip(head, `${what.field[3]} ${tint(what.field[3], what.field[2])}`);
  else if (what.kind < 0) chip(head, what.fault ? "faulty" : "noise");
  head.append(`byte ${what.first}: ${placeText(what)}`);
  const seen = element("div", tip);
  seen.textContent = seenText(what);
  const table = element("table", tip);
  const rows = what.types.filter(([size, type]) => size === 1 ? type === "u8" || type === "text" : LOOKED.includes(type));
  for (const [size, type, order, here, least, greatest] of rows) {
    const line = element("tr", table);
    const span = what.kind < 0 ? "" : least === greatest ? "always" : `${least} to ${greatest}`;
    for (const cell of [typeText([size, type, order]), here, span]) element("td", line).textContent = cell;
  }
  tip.hidden = false;
  const { width, height } = tip.getBoundingClientRect();
  tip.style.left = `${Math.max(4, Math.min(pointing.x + 14, innerWidth - width - 8))}px`;
  tip.style.top = `${pointing.y + 18 + height > innerHeight ? Math.max(4, pointing.y - height - 12) : pointing.y + 18}px`;
}

function placeText(what) {
  if (!what.field) return what.kind < 0 ? what.fault || "in no frame" : what.covers.length ? what.covers.join(", ") : "no field";
  const [, , name, shade, about] = what.field;
  return [name, shade === "named" ? "" : SHADES[shade], about].filter((text, number, all) => text && all.indexOf(text) === number).join(" · ");
}

function seenText(what) {
  if (what.kind < 0) return "";
  return what.different === 1 ? `the same in ${counted(what.frames, "frame")}` : `${counted(what.different, "different value")} in ${counted(what.frames, "frame")}`;
}

function takePoint(what) {
  const key = `${what.point} ${what.first}`;
  if (what.size === 1) {
    if (tips.size > 500) tips.clear();
    tips.set(key, what);
    if (pointing?.key === key) drawTip(what);
  }
  if (chosen && !shown && what.point === chosen.row && what.first === chosen.first && what.size === chosen.size) drawChosen(what);
}

// ---- what is chosen

function choose(choice) {
  chosen = choice;
  shown = null;
  lines.choose(choice);
  at("course").hidden = true;
  if (!choice) {
    at("where").textContent = "Point at a byte, or click it";
    at("what").textContent = "";
    at("types").parentElement.hidden = true;
    drawNaming();
    return;
  }
  const size = Math.min(choice.size, 64);
  chosen = { ...choice, size };
  lines.choose(chosen);
  drawNaming();
  live.say({ point: chosen.row, first: chosen.first, size });
  if (chosen.kind >= 0) live.say({ fields: chosen.kind });
}

function drawChosen(what) {
  shown = what;
  const { row, first, size, kind } = chosen;
  const where = size === 1 ? `byte ${first}` : `bytes ${first} to ${first + size - 1}`;
  at("where").textContent = `${kind < 0 ? `row ${row + 1}` : kinds[kind][0]}, ${where}`;
  const words = at("what");
  words.replaceChildren();
  if (what.field) chip(words, `${what.field[3]} ${tint(what.field[3], what.field[2])}`);
  const evidence = what.field?.[5] ? ` (${what.field[5]})` : "";
  words.append(`${placeText(what)}${evidence}${what.kind < 0 ? "" : ` – ${seenText(what)}`}`);
  const body = at("types").tBodies[0];
  body.replaceChildren();
  at("types").parentElement.hidden = false;
  for (const cells of what.types) {
    const line = element("tr", body);
    line.className = "row";
    for (const text of [typeText(cells), ...cells.slice(3, 6)]) element("td", line).textContent = text;
    line.addEventListener("click", () => pickType(cells, line));
  }
  fillNaming(what);
  drawFieldPick();
}

function typeText([size, type, order]) {
  return size === 1 || ["text", "decimal", "bytes"].includes(type) ? type : `${type} ${order}`;
}

function pickType([size, type, order], line) {
  for (const one of at("types").querySelectorAll("tr")) one.classList.toggle("picked", one === line);
  if (size !== chosen.size) { chosen = { ...chosen, size }; lines.choose(chosen); shown = { ...shown, size }; fillTypes(); }
  if ([...at("type").options].some(one => one.value === type)) {
    at("type").value = type;
    fillOrders();
    at("order").value = order;
  }
  if (!["bits", "bytes", "text"].includes(type)) live.say({ course: chosen.row, first: chosen.first, size, type, order });
  else at("course").hidden = true;
}

function takeCourse(what) {
  if (!chosen || what.course !== chosen.row || what.first !== chosen.first) return;
  at("course").hidden = what.numbers.length < 2;
  if (!at("course").hidden) plot(at("course"), what.times, what.numbers, lines.timed ? seconds => `${seconds.toFixed(1)} s` : row => `row ${row + 1}`);
}

// ---- names

function fillNaming(what) {
  const [type, order] = (what.field?.[6] ?? "").split(" ");
  const is_whole = what.field && what.field[0] === chosen.first && what.field[1] === chosen.size;
  at("name").value = type && is_whole ? what.field[2] : "";
  at("forget").hidden = !type;
  at("open").hidden = !what.field?.[7];
  at("whole").checked = false;
  at("type").replaceChildren();
  fillTypes();
  if (type && is_whole) { at("type").value = type; fillOrders(); at("order").value = order; }
  drawNaming();
}

function fillTypes() {
  const select = at("type"), size = at("whole").checked ? 0 : chosen.size, before = select.value;
  const fitting = shown.types.filter(one => one[0] === size), seen = new Set(fitting.map(one => one[1]));
  select.replaceChildren();
  for (const [name, sizes] of Object.entries(types)) {
    const fits = size ? (sizes.length ? sizes.includes(size) : name === "bytes" || seen.has(name)) : ["text", "bytes"].includes(name);
    if (fits && (name !== "bcd" || seen.has("bcd"))) option(select, name, name);
  }
  const values = [...select.options].map(one => one.value);
  select.value = values.includes(before) ? before : fitting.find(one => values.includes(one[1]))?.[1] ?? values[0];
  fillOrders();
}

function fillOrders() {
  const orders = chosen.size > 1 && !at("whole").checked ? shown.types.filter(one => one[0] === chosen.size && one[1] === at("type").value).map(one => one[2]) : [];
  at("order").replaceChildren();
  for (const one of orders.length ? orders : ["big"]) option(at("order"), one, one);
  at("ordered").hidden = orders.length < 2;
}

function drawNaming() {
  at("naming").hidden = !(canName && live.may && chosen && chosen.kind >= 0 && shown);
  if (canName && !live.may && chosen && chosen.kind >= 0) live.tell("With the token these bytes can be named");
  else if (at("told").textContent.startsWith("With the token")) live.tell("");
}

function give(event) {
  event.preventDefault();
  if (!chosen || !shown) return;
  const whole = at("whole").checked;
  live.act({
    name: at("name").value.trim(), kind: kinds[chosen.kind][0], first: whole ? shown.field[0] : chosen.first, size: whole ? 0 : chosen.size,
    type: at("type").value, order: at("order").value,
  });
}

function takeRound(what) {
  const before = round;
  round = what.round;
  tips.clear();
  const right = !what.problems.length;
  at("definition").querySelector(".count").textContent = right ? (file ? `${file} is written and passes its check` : "passes its check") : "not right yet";
  at("problems").replaceChildren(...[...what.problems.map(text => [text, "wrong"]), ...what.warnings.map(text => [text, ""])].map(([text, look]) => {
    const line = document.createElement("li");
    line.textContent = text;
    line.className = look;
    return line;
  }));
  if (at("definition").querySelector("details").open) live.say({ draft: true });
  if (before && before !== round) {
    lines.shades.clear();
    lines.anew();
    if (chosen) choose(chosen);
  }
}

function takeDraft(what) {
  at("definition").querySelector("pre").textContent = what.draft;
  at("download").dataset.name = `${what.file}.yaml`;
}

// ---- fields of a kind

function takeFields(what) {
  const box = at("layout"), body = box.querySelector("tbody");
  box.hidden = false;
  box.querySelector(".count").textContent = `of ${kinds[what.fields][0]}`;
  body.replaceChildren();
  for (const [offset, size, name, shade, about] of what.list) {
    const line = element("tr", body);
    line.className = "row";
    line.dataset.offset = offset;
    element("td", line).textContent = size > 1 ? `${offset}–${offset + size - 1}` : offset;
    chip(element("td", line), `${shade} ${tint(shade, name)}`);
    const named = element("td", line);
    named.textContent = name.split(".").at(-1);
    named.title = name;
    element("td", line).textContent = about || SHADES[shade] || "";
    line.addEventListener("click", () => choose({ row: chosen && chosen.kind === what.fields ? chosen.row : what.row, kind: what.fields, first: offset, size }));
  }
  drawFieldPick();
}

function drawFieldPick() {
  for (const line of at("layout").querySelectorAll("tr.row")) line.classList.toggle("picked", chosen !== null && Number(line.dataset.offset) === shown?.field?.[0]);
}

// ---- what the user does

function listen() {
  at("kinds").addEventListener("change", () => {
    lines.show(wanted());
    choose(null);
    if (wanted() !== null && wanted() >= 0) live.say({ fields: wanted() });
  });
  at("naming").addEventListener("submit", give);
  at("forget").addEventListener("click", () => live.act({ forget: kinds[chosen.kind][0], first: shown.field[0] }));
  at("type").addEventListener("change", fillOrders);
  at("whole").addEventListener("change", fillTypes);
  document.addEventListener("keydown", event => { if (event.key === "Escape") choose(null); });
  at("definition").querySelector("details").addEventListener("toggle", event => { if (event.target.open) live.say({ draft: true }); });
  at("copy").addEventListener("click", async () => {
    const text = at("definition").querySelector("pre");
    try {
      await navigator.clipboard.writeText(text.textContent);
      live.tell("Copied");
    } catch {
      getSelection().selectAllChildren(text);
      live.tell("The text is selected: copy it with the keys of your system");
    }
  });
  at("download").addEventListener("click", () => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([at("definition").querySelector("pre").textContent], { type: "application/yaml" }));
    link.download = at("download").dataset.name;
    link.click();
    URL.revokeObjectURL(link.href);
  });
}

listen();
live.connect();
