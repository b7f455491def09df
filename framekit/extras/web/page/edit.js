// The page of the editor: the text goes to the server when the user pauses; its problems and its meaning come back.
import { NewFile } from "./edit_new.js";
import { Form, showFrames, showReadings, showSequences } from "./edit_bytes.js";
import { Tables } from "./edit_table.js";
import { TextField } from "./edit_text.js";
import { Trial } from "./edit_trial.js";
import { Live, at } from "./live.js";
import { element } from "./parts.js";

const PAUSE = 300;
const TABS = [["frames", "Frames"], ["build", "Build"], ["sequences", "Sequences"], ["trial", "Try it"]];

const live = new Live({ hello, opened, checked, decoded: showReadings, form: what => form.fill(what), build: built, words: offered, cell: edited, outside,
  offer: what => trial.offer(what), known: what => news.take(what.known), try: what => trial.show(what), done: saved },
  "edit and save", { opened: () => {}, allowed });
const text = new TextField(at("editor"), { changed, words: (content, offset) => askWords(content, offset), save });
const form = new Form(at("build"), (frame, inside) => live.say({ form: frame, inside, protocol: protocol() }),
  (frame, rows) => live.say({ build: frame, rows, protocol: protocol() }));
const tables = new Tables(at("table"), change => askEdits(change), line => text.goTo(line));
const trial = new Trial(at("trial"), ({ service, ...given }) => live.say({ try: service, ...given }));
const news = new NewFile((what, ended) => live.act(what, ended));
const kept = new Map();
let files = [], file = "", digest = "", number = 0, waiting = 0, isOut = false, isStale = false, drawn = "", protocols = [], rows = [], edit = { number: 0, text: "" };

for (const [id, name] of TABS) {
  const tab = Object.assign(element("button", at("tabs")), { textContent: name, type: "button" });
  tab.dataset.tab = id;
  tab.setAttribute("role", "tab");
  tab.addEventListener("click", () => show(id));
}
show("frames");

function show(id) {
  for (const tab of at("tabs").children) {
    const on = tab.dataset.tab === id;
    tab.classList.toggle("on", on);
    tab.setAttribute("aria-selected", on);
    at(tab.dataset.tab).hidden = !on;
  }
  if (id === "build") form.offer(framesOf());
  if (id === "trial") live.say({ offer: true });
}

// ---- files -------------------------------------------------------------------------------------------------------

function hello(what) {
  document.title = `framekit ${what.hello}`;
  at("title").textContent = what.hello.replace("edit ", "");
  at("new").hidden = !what.makes;
  const before = file || what.first;
  list(what.files, before);
  if (before) live.say({ open: before });
  else at("what").textContent = what.makes ? "No YAML file here yet: press New" : "";
}

function list(names, chosen) {
  files = names;
  at("file").replaceChildren();
  for (const name of names) Object.assign(element("option", at("file")), { textContent: name, value: name });
  at("file").value = chosen;
}

function opened(what) {
  if (what.opened === null) { live.tell(what.why); at("file").value = file; return; }
  keep();
  const known = kept.get(what.opened);
  file = what.opened;
  digest = known?.digest ?? what.digest;
  at("file").value = file;
  const here = document.activeElement === text.area ? text.area.selectionStart : null;
  const content = known?.text ?? what.text;
  if (content !== text.text || here === null) text.open(content);
  text.stored = known?.stored ?? what.text;
  isOut = false;
  unsaved();
  check();
}

// Another program has changed the file: its text comes again, unless changes of the user would be lost.
function outside(what) {
  if (what.outside !== file) return;
  if (text.text === text.stored) live.say({ open: file });
  else live.tell(`${file} has changed on disk: copy your changes, and open it again`);
}

// Keeps the changes of a file that are not saved, while another one is edited.
function keep() {
  if (!file) return;
  if (text.text === text.stored) kept.delete(file);
  else kept.set(file, { text: text.text, stored: text.stored, digest });
}

at("file").addEventListener("change", () => live.say({ open: at("file").value }));
at("save").addEventListener("click", save);
at("new").addEventListener("click", () => {
  if (!live.may) { at("lock").open = true; at("token").focus(); return; }
  live.say({ known: true });
  news.ask(files);
});
addEventListener("beforeunload", event => { keep(); if (kept.size) event.preventDefault(); });

function allowed(yes) {
  text.area.readOnly = !yes;
  tables.show(rows, yes);
  unsaved();
}

function unsaved() {
  const differs = text.text !== text.stored;
  at("changed").hidden = !differs;
  at("save").disabled = !live.may || !differs;
}

function save() {
  if (at("save").disabled) return;
  const content = text.text;
  live.act({ save: content, file, digest }, why => {
    live.tell(why ? `Not saved: ${why}` : "");
    if (!why) text.stored = content;
    unsaved();
  });
}

function saved(what) {
  if (what.made) {
    list(what.files, what.made);
    live.say({ open: what.made });
    live.tell(`${what.made} is made`);
  }
  if (what.saved === file) digest = what.digest;
  unsaved();
}

// ---- problems ----------------------------------------------------------------------------------------------------

function changed() {
  unsaved();
  clearTimeout(waiting);
  waiting = setTimeout(check, PAUSE);
}

// Sends the text, one at a time: what was typed meanwhile goes when the answer has come.
function check() {
  isStale = isOut;
  if (!file || isOut) return;
  isOut = true;
  live.say({ text: text.text, file, number: ++number });
}

function checked(what) {
  if (what.checked !== number) return;
  isOut = false;
  if (isStale) check();
  if (what.why) live.tell(what.why);
  if (what.why || what.file !== file) return;
  at("what").textContent = what.what;
  showProblems(what.problems);
  text.mark(what.problems.filter(one => one[0]).map(([line, column, words, todo, warning]) => [line, column, todo ? `${words} – ${todo}` : words, warning]));
  rows = what.tables;
  tables.show(rows, live.may);
  at("meaning").classList.toggle("old", what.protocols === null && drawn === file);
  if (what.protocols || drawn !== file) draw(what.protocols);
  decode();
}

// While the text has errors, the pictures of the last text without errors stay.
function draw(found) {
  drawn = found ? file : "";
  showFrames(at("frames"), found, (name, frame) => { at("protocol").value = name; form.frame = frame; show("build"); });
  showSequences(at("sequences"), found);
  if (!at("trial").hidden) live.say({ offer: true });
  offerProtocols(found ?? []);
}

function showProblems(problems) {
  const errors = problems.filter(one => !one[4]).length, pill = at("problems").querySelector(".pill"), list = at("problems").querySelector("ol");
  pill.textContent = errors ? `${errors} to correct` : problems.length ? `${problems.length} to look at` : "None";
  pill.className = `pill ${errors ? "bad" : problems.length ? "warn" : "good"}`;
  list.replaceChildren();
  for (const [line, column, words, todo, warning, other] of problems) {
    const item = element("li", list), button = element("button", item);
    item.className = warning ? "warning" : "error";
    element("b", button).textContent = other || (line ? `Line ${line}` : "File");
    const said = element("span", button);
    said.append(words);
    if (todo) element("i", said).textContent = todo;
    button.disabled = !line;
    button.addEventListener("click", () => text.goTo(line, column));
  }
}

// ---- bytes -------------------------------------------------------------------------------------------------------

function offerProtocols(found) {
  protocols = found;
  const before = at("protocol").value;
  at("protocol").replaceChildren();
  for (const { name } of found) Object.assign(element("option", at("protocol")), { textContent: name, value: name });
  if (found.some(one => one.name === before)) at("protocol").value = before;
  at("protocol").hidden = found.length < 2;
  form.offer(framesOf());
}

const protocol = () => at("protocol").value;

function framesOf() {
  return (protocols.find(one => one.name === protocol())?.frames ?? []).map(([name]) => name);
}

function decode() {
  if (at("hex").value.trim()) live.say({ hex: at("hex").value, protocol: protocol() });
  else showReadings({ decoded: at("hex").value });
}

at("hex").addEventListener("input", decode);
at("protocol").addEventListener("change", () => { decode(); form.offer(framesOf()); });

function built(what) {
  form.refuse(what);
  if (!what.built) return;
  at("hex").value = what.built;
  decode();
}

// ---- completions -------------------------------------------------------------------------------------------------

function askWords(content, offset) {
  live.say({ complete: content, offset, file });
}

function offered({ offset, from, words }) {
  text.offer(offset, from, words);
}

// ---- tables ------------------------------------------------------------------------------------------------------

function askEdits(change) {
  edit = { number: edit.number + 1, text: text.text };
  live.say({ cell: edit.text, number: edit.number, ...change });
}

function edited({ cell, why, edits = [] }) {
  if (cell !== edit.number) return;
  const focused = document.activeElement, isNew = text.text !== edit.text;
  live.tell(why ? `Not changed: ${why}` : isNew ? "Not changed: the text has changed meanwhile" : "");
  if (isNew || why) return;
  for (const [from, to, inserted] of edits.sort((one, two) => two[0] - one[0])) text.replace(from, to, inserted);
  focused?.focus();
}

live.connect();
