// Trouble at the top of the page: it stays, also when it is over, until the user says that it has been seen.
import { at } from "./shell.js";
import { element } from "./parts.js";
import { clock, first } from "./words.js";

const SEEN = "framekit-seen";
let notices = [], run = "";

// The number of the last notice that was seen, of the run that began at a time.
function seen() {
  const [began, number] = (localStorage.getItem(SEEN) ?? "").split(" ");
  return began === run ? Number(number) : 0;
}

export function beginNotices(began) {
  run = String(began);
  draw();
}

// `list`: number, sentence, begin, and end or null, in seconds since 1970.
export function takeNotices(list) {
  notices = list;
  draw();
}

function draw() {
  const fresh = notices.filter(([number]) => number > seen()).reverse(), lasting = fresh.filter(notice => notice[3] === null);
  at("notices").hidden = !fresh.length;
  const over = fresh.length - lasting.length, counts = [lasting.length && `${lasting.length} now`, over && `${over} over`];
  at("notices").querySelector(".count").textContent = counts.filter(Boolean).join(", ");
  at("notices").querySelector("ul").replaceChildren(...fresh.map(([, text, began, ended]) => {
    const line = document.createElement("li"), pill = element("span", line);
    pill.className = `pill ${ended === null ? "bad" : "good"}`;
    pill.textContent = ended === null ? "Now" : "Over";
    const [cause, ...more] = text.split(" – "), sentence = element("p", line);
    element("b", sentence).textContent = first(cause);
    if (more.length) element("span", sentence).textContent = ` – ${more.join(" – ")}`;
    element("time", line).textContent = ended === null ? `since ${clock(began)}` : `${clock(began)} – ${clock(ended)}`;
    return line;
  }));
}

at("notices").querySelector("button").addEventListener("click", () => {
  localStorage.setItem(SEEN, `${run} ${Math.max(...notices.map(notice => notice[0]))}`);
  draw();
});
