// A text field for YAML: a plain <textarea> under a painted copy of the lines in view, with line numbers, marks and a
// list of completions.
import { element } from "./parts.js";

const LINE = 20, LONGEST_PAINTED = 2000, ROOM = 8, MOST_WORDS = 60, LONGEST_ASKED = 100_000;
const TOKEN = /(\s+)|("(?:[^"\\]|\\.)*"?|'(?:[^']|'')*'?)|([{}[\],]|-(?=\s|$)|:(?=\s|$))|([^\s{}[\],#:"'][^{}[\],#:]*?(?=:(?:\s|$)))|([^\s{}[\],]+)/y;
const LOOKS = ["", "quoted", "sign", "key", ""];

// The parts of a line, each a text with its class.
export function tokens(line) {
  const found = [];
  if (line.length > LONGEST_PAINTED) return [[line, ""]];
  let place = 0;
  while (place < line.length) {
    if (line[place] === "#" && (place === 0 || /\s/.test(line[place - 1]))) { found.push([line.slice(place), "note"]); break; }
    TOKEN.lastIndex = place;
    const match = TOKEN.exec(line);
    if (!match) { found.push([line.slice(place), ""]); break; }
    found.push([match[0], LOOKS[match.slice(1).findIndex(part => part !== undefined)]]);
    place += match[0].length;
  }
  return found;
}

export class TextField {
  // `changed(text)`: the user has typed. `words(text, offset)`: asks for completions, which `offer` shows. `save`: Ctrl+S.
  constructor(place, { changed, words, save }) {
    Object.assign(this, { changed, words, save });
    this.lines = [""];
    this.marks = new Map();
    place.classList.add("text");
    this.gutter = element("div", place);
    this.gutter.className = "gutter";
    this.sheet = element("div", place);
    this.sheet.className = "sheet";
    this.paint = element("pre", this.sheet);
    this.paint.setAttribute("aria-hidden", "true");
    this.area = element("textarea", this.sheet);
    Object.assign(this.area, { spellcheck: false, wrap: "off", autocomplete: "off", readOnly: true });
    this.area.setAttribute("aria-label", "definition");
    this.list = element("ul", this.sheet);
    Object.assign(this.list, { className: "words", id: "words", hidden: true });
    this.list.setAttribute("role", "listbox");
    this.area.setAttribute("aria-controls", "words");
    this.area.addEventListener("input", () => this.typed());
    this.area.addEventListener("scroll", () => { this.close(); this.draw(); });
    this.area.addEventListener("keydown", event => this.key(event));
    this.area.addEventListener("blur", () => setTimeout(() => this.close(), 150));
    document.addEventListener("selectionchange", () => { if (document.activeElement === this.area) this.moved(); });
    new ResizeObserver(() => this.draw()).observe(place);
  }

  get text() {
    return this.area.value;
  }

  // Shows another text; its history of changes begins anew.
  open(text) {
    this.area.value = text;
    this.area.setSelectionRange(0, 0);
    this.area.scrollTop = this.area.scrollLeft = 0;
    this.split();
    this.mark([]);
  }

  // Replaces characters as if the user had typed: undo works.
  replace(from, to, text) {
    if (this.area.readOnly) return;
    this.area.focus();
    this.area.setSelectionRange(from, to);
    if (!document.execCommand("insertText", false, text)) {
      this.area.setRangeText(text, from, to, "end");
      this.typed();
    }
  }

  typed() {
    this.split();
    this.changed(this.area.value);
    const { selectionStart: at } = this.area, before = this.area.value.slice(0, at);
    if (this.area.value.length > LONGEST_ASKED) this.close();  // a long text is sent with Ctrl+Space only
    else if (!this.list.hidden || /(^|[\s{,[])[A-Za-z][\w.-]*$/.test(before)) this.ask();
    else this.close();
  }

  split() {
    this.lines = this.area.value.split("\n");
    this.draw();
  }

  // `problems`: line, column, words, whether it is a warning.
  mark(problems) {
    this.marks = new Map();
    for (const [line, column, words, warning] of problems) {
      const known = this.marks.get(line) ?? { columns: [], words: [], warning: true };
      known.columns.push([column, warning]);
      known.words.push(words);
      known.warning &&= warning;
      this.marks.set(line, known);
    }
    this.draw();
  }

  goTo(line, column = 1) {
    const place = this.lines.slice(0, line - 1).reduce((sum, text) => sum + text.length + 1, 0) + column - 1;
    this.area.focus();
    this.area.setSelectionRange(place, place);
    this.area.scrollTop = Math.max(0, (line - 4) * LINE);
    this.draw();
  }

  // The line and the column of the cursor, from 0.
  get cursor() {
    const before = this.area.value.slice(0, this.area.selectionStart), start = before.lastIndexOf("\n") + 1;
    let line = 0;
    for (let at = before.indexOf("\n"); at >= 0; at = before.indexOf("\n", at + 1)) line++;
    return { line, column: before.length - start };
  }

  moved() {
    const { line } = this.cursor;
    if (line !== this.active) { this.active = line; this.close(); this.draw(); }
  }

  draw() {
    const top = this.area.scrollTop, first = Math.floor(top / LINE);
    const last = Math.min(this.lines.length, first + Math.ceil(this.area.clientHeight / LINE) + 1);
    this.paint.replaceChildren();
    this.gutter.replaceChildren();
    for (let number = first; number < last; number++) {
      const row = element("div", this.paint), mark = this.marks.get(number + 1), label = element("div", this.gutter);
      row.className = number === this.active ? "line active" : "line";
      this.fill(row, this.lines[number], mark);
      label.textContent = number + 1;
      if (mark) Object.assign(label, { className: mark.warning ? "warn" : "bad", title: mark.words.join("\n") });
    }
    const shift = `translate(${-this.area.scrollLeft}px, ${first * LINE - top}px)`;
    this.paint.style.transform = shift;
    this.gutter.style.transform = `translateY(${first * LINE - top}px)`;
  }

  fill(row, line, mark) {
    let column = 0;
    const spans = (mark?.columns ?? []).map(([from, warning]) => [from - 1, from - 1 + wordAt(line, from - 1), warning]);
    for (const [text, look] of tokens(line)) {
      const hit = spans.find(([from, to]) => column < to && from < column + Math.max(1, text.length));
      const cuts = hit ? [Math.max(0, hit[0] - column), Math.min(text.length, hit[1] - column)] : [text.length, text.length];
      for (const [part, marked] of [[text.slice(0, cuts[0]), false], [text.slice(...cuts), true], [text.slice(cuts[1]), false]]) {
        if (!part) continue;
        const classes = [look, marked ? (hit[2] ? "doubt" : "wrong") : ""].filter(Boolean).join(" ");
        if (classes) Object.assign(element("span", row), { textContent: part, className: classes });
        else row.append(part);
      }
      column += text.length;
    }
    if (!line) row.append(" ");
  }

  // ---- keys ----------------------------------------------------------------------------------------------------

  key(event) {
    const { area } = this, open = !this.list.hidden;
    if ((event.ctrlKey || event.metaKey) && event.key === "s") { event.preventDefault(); this.save(); return; }
    if (event.ctrlKey && event.key === " ") { event.preventDefault(); this.ask(true); return; }
    if (open && ["ArrowDown", "ArrowUp"].includes(event.key)) { event.preventDefault(); this.choose(event.key === "ArrowDown" ? 1 : -1); return; }
    if (open && ["Enter", "Tab"].includes(event.key)) { event.preventDefault(); this.take(this.chosen); return; }
    if (event.key === "Escape") { if (open) { event.preventDefault(); this.close(); } else this.leaves = true; return; }
    if (event.key === "Tab" && !event.shiftKey && !this.leaves && !area.readOnly) {
      event.preventDefault();
      this.replace(area.selectionStart, area.selectionEnd, " ".repeat(2 - this.cursor.column % 2));
    } else if (event.key === "Enter" && !event.ctrlKey && !area.readOnly) {
      event.preventDefault();
      const before = this.lines[this.cursor.line].slice(0, this.cursor.column), indent = /^\s*(?:- )?/.exec(before)[0];
      const deeper = /:\s*$/.test(before) && !before.trimStart().startsWith("#") ? "  " : "";
      this.replace(area.selectionStart, area.selectionEnd, `\n${indent.replace("-", " ")}${deeper}`);
    }
    this.leaves = false;
  }

  // ---- completions -----------------------------------------------------------------------------------------------

  ask(always = false) {
    this.always = always;
    this.asked = this.area.selectionStart;
    this.words(this.area.value, this.asked);
  }

  // `from`: where the word begins that a completion replaces. `words`: text, what it means, text to insert.
  offer(offset, from, words) {
    if (offset !== this.area.selectionStart || document.activeElement !== this.area) return;
    const typed = this.area.value.slice(from, offset);
    this.from = from;
    this.offered = words.slice(0, MOST_WORDS);
    if (!this.offered.length || (!this.always && this.offered.length === 1 && this.offered[0][0] === typed)) { this.close(); return; }
    this.list.replaceChildren();
    this.offered.forEach(([word, about], number) => {
      const item = element("li", this.list);
      item.setAttribute("role", "option");
      item.id = `word-${number}`;
      element("b", item).textContent = word;
      element("span", item).textContent = about;
      item.addEventListener("mousedown", event => { event.preventDefault(); this.take(number); });
    });
    const { line, column } = this.cursor;
    this.list.hidden = false;
    this.list.style.left = `${Math.max(0, Math.min(ROOM + (column - typed.length) * this.letter - this.area.scrollLeft, this.sheet.clientWidth - 320))}px`;
    const below = (line + 1) * LINE - this.area.scrollTop, height = this.list.offsetHeight;
    this.list.style.top = `${below + height > this.sheet.clientHeight && below > height + LINE ? below - LINE - height : below}px`;
    this.chosen = -1;
    this.choose(1);
  }

  get letter() {
    const probe = element("span", this.paint);
    probe.textContent = "0".repeat(50);
    const width = probe.getBoundingClientRect().width / 50;
    probe.remove();
    return width;
  }

  choose(step) {
    this.list.children[this.chosen]?.removeAttribute("aria-selected");
    this.chosen = (this.chosen + step + this.offered.length) % this.offered.length;
    const item = this.list.children[this.chosen];
    item.setAttribute("aria-selected", "true");
    item.scrollIntoView({ block: "nearest" });
    this.area.setAttribute("aria-activedescendant", item.id);
  }

  take(number) {
    const insert = this.offered[number][2];
    this.close();
    this.replace(this.from, this.area.selectionStart, insert);
    this.close();
  }

  close() {
    this.list.hidden = true;
    this.area.removeAttribute("aria-activedescendant");
  }
}

// The length of the word that is marked: at least one character.
function wordAt(line, column) {
  const quoted = /^(?:"[^"]*"|'[^']*')/.exec(line.slice(column));
  return (quoted ?? /^[^\s{}[\],:]+/.exec(line.slice(column)))?.[0].length ?? 1;
}
