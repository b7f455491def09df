// The question before something is written or fired: it names the old value and the new one, and shows a refusal.
import { element } from "./parts.js";

let dialog = null;

function made(name, parent, given) {
  return Object.assign(parent ? element(name, parent) : document.createElement(name), given);
}

// Opens a question. `title`, `lines`: what will happen; `button`: the word for it. `field`: {label, words, hint} asks for a
// value, and a second step confirms it. `act(value, ended)` does it; `ended(why)` closes the question or shows why not.
// `others`: further actions, a word and a function each.
export function ask({ title, lines, button, field = null, confirm = null, act, others = [] }) {
  dialog?.remove();
  dialog = made("dialog", document.body, { id: "ask" });
  const form = made("form", dialog, { autocomplete: "off" });
  made("h2", form, { textContent: title });
  for (const text of lines) made("p", form, { textContent: text });
  const input = field && fieldOf(form, field), question = made("p", form, { hidden: true, className: "strong" });
  const why = made("p", form, { className: "why" });
  why.setAttribute("role", "alert");
  const foot = element("footer", form);
  const cancel = made("button", foot, { type: "button", textContent: "Cancel" });
  const go = made("button", foot, { className: "main", textContent: button });
  cancel.addEventListener("click", () => dialog.close());
  const ended = reason => { if (reason) why.textContent = reason; else dialog.close(); };
  for (const [text, action] of others) {
    const more = made("button", null, { type: "button", textContent: text });
    foot.insertBefore(more, go);
    more.addEventListener("click", () => action(null, ended));
  }
  input?.addEventListener("input", () => { question.hidden = true; go.textContent = button; why.textContent = ""; });
  form.addEventListener("submit", event => {
    event.preventDefault();
    if (input && input.value === "") { why.textContent = "Give a value"; return; }
    if (input && question.hidden) {
      question.textContent = confirm(input.value);
      question.hidden = false;
      go.textContent = "Yes, write";
      return;
    }
    go.disabled = true;
    act(input?.value, reason => {
      go.disabled = false;
      ended(reason);
      question.hidden = true;
      go.textContent = button;
    });
  });
  dialog.showModal();
  (input ?? go).focus();
}

function fieldOf(form, { label, words, hint }) {
  const line = made("label", form, { textContent: label });
  const input = made(words.length ? "select" : "input", line, { id: "value" });
  for (const word of words) made("option", input, { value: word, textContent: word });
  if (hint) input.placeholder = hint;
  return input;
}
