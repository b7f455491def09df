// Drawings of numbers over time on a canvas, in the colours of the stylesheet.
import { element } from "./parts.js";

export const MINUTE = 60, FEWEST = 15;
const inks = new Map();
let probe = null;

// The colour of a name such as --accent, for light or dark.
export function ink(name) {
  probe ??= element("i", document.body);
  if (!inks.has(name)) { probe.style.color = `var(${name})`; inks.set(name, getComputedStyle(probe).color); }
  return inks.get(name);
}

export const forgetInks = () => inks.clear();

export function bounds(numbers) {
  let low = Infinity, high = -Infinity;
  for (const number of numbers) if (number !== null) { low = Math.min(low, number); high = Math.max(high, number); }
  return low > high ? null : low === high ? around(low) : [low, high];
}

// Limits around a single number, of any size.
export function around(number) {
  const margin = Math.max(1, Math.abs(number) / 100);
  return [number - margin, number + margin];
}

function trace(pen, xs, numbers, [low, high], height) {
  let down = false;
  pen.beginPath();
  numbers.forEach((number, at) => {
    if (number === null) { down = false; return; }
    const y = height - 2 - (number - low) / (high - low) * (height - 4);
    down ? pen.lineTo(xs(at), y) : pen.moveTo(xs(at), y);
    if (!down) pen.lineTo(xs(at) + 1, y);
    down = true;
  });
  pen.stroke();
}

// The last minute, a number a second, right-aligned; `span`: the numbers of the whole width. A few numbers are no course yet. A number that stays is a quiet line.
export function sparkline(canvas, numbers, range = bounds(numbers), span = MINUTE) {
  const pen = canvas.getContext("2d");
  pen.clearRect(0, 0, canvas.width, canvas.height);
  if (!range || numbers.length < FEWEST) return;
  const known = numbers.filter(number => number !== null), stays = known.every(number => number === known[0]);
  pen.strokeStyle = ink(stays ? "--edge" : "--accent");
  pen.lineWidth = canvas.height / 16;
  const step = canvas.width / span, start = canvas.width - step * numbers.length;
  trace(pen, at => start + at * step, numbers, range, canvas.height);
}

// A course with its limits at the left and its times below; `told` writes a time.
export function plot(canvas, times, numbers, told) {
  canvas.width = canvas.clientWidth || 900;
  const pen = canvas.getContext("2d"), { width, height } = canvas, range = bounds(numbers);
  pen.fillStyle = ink("--muted");
  pen.font = "11px system-ui, sans-serif";
  if (!range) { pen.fillText("No good values yet", 10, 20); return; }
  const left = 76, bottom = 22, first = times[0], span = Math.max(1, times.at(-1) - first);
  pen.fillText(short(range[1]), 4, 14);
  pen.fillText(short(range[0]), 4, height - bottom);
  pen.fillText(told(first), left, height - 5);
  pen.textAlign = "right";
  pen.fillText(told(times.at(-1)), width - 4, height - 5);
  pen.strokeStyle = ink("--line");
  pen.strokeRect(left, 2, width - left - 4, height - bottom);
  pen.strokeStyle = ink("--accent");
  pen.lineWidth = 1.75;
  pen.save();
  pen.translate(left, 2);
  trace(pen, at => (times[at] - first) / span * (width - left - 4), numbers, range, height - bottom);
  pen.restore();
}

function short(number) {
  return Number(number.toPrecision(6)).toString();
}
