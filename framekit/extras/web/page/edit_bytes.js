// Bytes read as frames while they are typed, and a form that builds a frame from its fields.
import { fieldView } from "./fields.js";
import { element } from "./parts.js";
import { at } from "./shell.js";

const OTHER = "Other readings of the same bytes";

export function showReadings({ decoded, why, bytes, readings = [] }) {
  const place = document.querySelector("#try .readings");
  if (decoded !== at("hex").value) return;
  place.replaceChildren();
  at("hex").classList.toggle("wrong", Boolean(why || readings[0]?.fault));
  if (why && decoded.trim()) Object.assign(element("p", place), { className: "why", textContent: why });
  readings.forEach(({ frame, rows, fault, notes }, number) => {
    if (number === 1) element("h3", place).textContent = OTHER;
    const reading = element("div", place);
    fieldView(reading, `${frame} · ${bytes.length / 2} bytes`, bytes, rows, fault);
    for (const text of notes) Object.assign(element("p", reading), { className: "note", textContent: text });
  });
}

export class Form {
  // `ask(frame, inside)`: asks for the fields of a frame; `build(frame, rows)`: for its bytes.
  constructor(place, ask, build) {
    Object.assign(this, { place, ask, build, frame: "", frames: [] });
  }

  // `frames`: the names of the frames.
  offer(frames) {
    this.frames = frames;
    if (!frames.includes(this.frame)) this.frame = frames[0] ?? "";
    if (!this.frame) Object.assign(this.place, { textContent: "No frame can be built yet" });
    else if (!this.place.hidden) this.ask(this.frame, "");
  }

  show(frame) {
    this.frame = frame;
    this.ask(frame, "");
  }

  fill({ frame, why, inner = [], inside = "", rows = [] }) {
    if (frame !== this.frame && !why) return;
    this.place.replaceChildren();
    const form = element("form", this.place), choices = element("p", form);
    choices.className = "choices";
    choice(choices, "frame", this.frames, this.frame, name => this.show(name));
    if (inner.length) choice(choices, "frame inside", inner, inside, name => this.ask(this.frame, name));
    const list = element("div", form);
    list.className = "values";
    this.fields = rows.map(([steps, text]) => {
      const label = element("label", list);
      element("span", label).textContent = steps.join(".");
      const field = Object.assign(element("input", label), { value: text, spellcheck: false, autocomplete: "off" });
      return [steps, field];
    });
    if (!rows.length && !why) element("p", list).textContent = "This frame has no fields of its own.";
    element("button", form).textContent = "Build";
    this.why = Object.assign(element("p", form), { className: "why", textContent: why ?? "" });
    form.addEventListener("submit", event => { event.preventDefault(); this.send(); });
  }

  send() {
    this.build(this.frame, this.fields.map(([steps, field]) => [steps, field.value]));
  }

  refuse({ why = "", field = "" }) {
    this.why.textContent = why;
    for (const [steps, one] of this.fields) one.classList.toggle("wrong", Boolean(why) && steps.at(-1) === field.split(".").at(-1));
  }
}

function choice(place, name, words, chosen, taken) {
  const list = element("select", place);
  list.setAttribute("aria-label", name);
  for (const word of words) Object.assign(element("option", list), { textContent: word, value: word, selected: word === chosen });
  list.addEventListener("change", () => taken(list.value));
}

// The frames of all protocols as rows of boxes. `picked(protocol, frame)`: the user wants to build it.
export function showFrames(place, protocols, picked) {
  place.replaceChildren();
  if (protocols === null) { Object.assign(element("p", place), { className: "empty", textContent: "Drawn as soon as the errors are corrected" }); return; }
  if (!protocols.length) Object.assign(element("p", place), { className: "empty", textContent: "This file has no frames" });
  for (const { name, about, frames, more } of protocols) {
    if (protocols.length > 1) element("h2", place).textContent = `${name} ${about}`;
    for (const [frame, words, boxes] of frames) {
      const head = element("h3", place), button = element("button", head);
      Object.assign(button, { textContent: frame, className: "name", title: "Build this frame" });
      button.addEventListener("click", () => picked(name, frame));
      element("span", head).textContent = words;
      const row = element("div", place);
      row.className = "boxes";
      for (const [title, below, size, shade, optional] of boxes) {
        const box = element("div", row);
        box.className = `box ${shade}${optional ? " optional" : ""}`;
        element("b", box).textContent = title;
        element("span", box).textContent = below || "\u00a0";
        element("i", box).textContent = size;
      }
    }
    if (more) element("p", place).textContent = `and ${more} more frames`;
  }
}

// The state diagrams of the sequences: pictures that the server has drawn.
export function showSequences(place, protocols) {
  place.replaceChildren();
  if (protocols === null) { Object.assign(element("p", place), { className: "empty", textContent: "Drawn as soon as the errors are corrected" }); return; }
  for (const { name, sequences } of protocols)
    for (const [sequence, svg] of sequences) {
      element("h3", place).textContent = protocols.length > 1 ? `${name} ${sequence}` : sequence;
      const picture = element("div", place);
      picture.className = "picture";
      picture.append(document.adoptNode(new DOMParser().parseFromString(svg, "image/svg+xml").documentElement));
    }
  if (!place.children.length) Object.assign(element("p", place), { className: "empty", textContent: "This file has no sequences" });
}
