// The head of every page: its title, the state of the connection, links to its parts, the token, light or dark.
import { element } from "./parts.js";
import { forgetInks } from "./draw.js";

const THEME = "framekit-theme", system = matchMedia("(prefers-color-scheme: dark)");
const repaint = [];

export const at = id => document.getElementById(id);

// `paint` is called when the colours change: what is drawn on a canvas has to be drawn again.
export const onTheme = paint => repaint.push(paint);

function made(name, parent, given) {
  const { dataset = {}, ...properties } = given;
  const one = Object.assign(element(name, parent), properties);
  Object.assign(one.dataset, dataset);
  return one;
}

// Fills the empty header of a page. `words`: what the token allows, such as "fire and write".
export function buildShell(words) {
  const bar = document.querySelector("header.bar");
  made("h1", bar, { id: "title", textContent: "framekit" });
  made("nav", bar, { id: "pages", hidden: true }).setAttribute("aria-label", "pages");
  made("span", bar, { id: "state", className: "pill", textContent: "Connecting" }).setAttribute("role", "status");
  made("nav", bar, { id: "parts" }).setAttribute("aria-label", "parts of the page");
  made("p", bar, { id: "told" }).setAttribute("role", "status");
  const lock = made("details", bar, { id: "lock" });
  made("summary", lock, { id: "may", className: "pill", textContent: "Read only" });
  const key = made("form", lock, { id: "key", className: "card", autocomplete: "off" });
  made("p", key, { id: "allowed" });
  showWords(words);
  const token = made("input", key, { id: "token", type: "password", autocomplete: "new-password", placeholder: "Token", spellcheck: false });
  token.setAttribute("aria-label", "token");
  made("button", key, { textContent: "Unlock" });
  const theme = made("button", bar, { id: "theme", className: "quiet", textContent: "◐", title: "Light or dark" });
  theme.setAttribute("aria-label", "light or dark");
  theme.addEventListener("click", () => {
    const now = document.documentElement.dataset.theme ?? (system.matches ? "dark" : "light");
    localStorage.setItem(THEME, now === "dark" ? "light" : "dark");
    paint();
  });
  system.addEventListener("change", paint);
  paint();
  linkParts();
}

// A link to each part that is shown now: the cards with a heading.
function linkParts() {
  const parts = [...document.querySelectorAll("main .card[id]")].filter(part => part.querySelector("header h2"));
  const links = parts.map(part => made("a", at("parts"), { href: `#${part.id}` }));
  const show = () => parts.forEach((part, number) => {
    const text = part.querySelector("header h2").textContent;
    links[number].hidden = part.closest("[hidden]") !== null;
    if (links[number].textContent !== text) links[number].textContent = text;
  });
  new MutationObserver(show).observe(document.querySelector("main"), { attributes: true, attributeFilter: ["hidden"], subtree: true });
  show();
}

export function showWords(words) {
  at("allowed").textContent = `With the token you may ${words}. framekit prints it at the start.`;
}

// Links to the pages of this program, if there are several. `pages`: path and name of each.
export function showPages(pages) {
  const place = at("pages"), here = location.pathname.slice(1);
  place.hidden = pages.length < 2;
  place.replaceChildren();
  for (const [path, name] of pages) {
    const link = made("a", place, { href: `/${path}`, textContent: name });
    if (path === here) link.setAttribute("aria-current", "page");
  }
}

function paint() {
  const theme = localStorage.getItem(THEME);
  if (theme) document.documentElement.dataset.theme = theme;
  forgetInks();
  for (const one of repaint) one();
}

export function showFoot(version, chart) {
  const foot = at("foot");
  if (foot) foot.textContent = `framekit ${version}` + (window.uPlot ? ` · Charts: ${chart}` : "");
}
