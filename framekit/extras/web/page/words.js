// Numbers and times as people read them.

// Groups of three digits with a thin space: 12 345.
export const count = number => number.toLocaleString("en").replaceAll(",", "\u202f");

export const many = (number, word) => `${count(number)} ${word}${number === 1 ? "" : "s"}`;

export const first = text => text.charAt(0).toUpperCase() + text.slice(1);

export const clock = seconds => new Date(seconds * 1000).toTimeString().slice(0, 8);

// A value as the table shows it: groups of digits; a fraction without digits that only rounding has made.
export function value(text, number) {
  if (text === "-") return "–";
  if (number === null || number === undefined || !/^-?\d+(\.\d+)?$/.test(text)) return text;
  const isLong = text.split(".")[1]?.length > 6;
  const rounded = isLong ? String(Number(number.toPrecision(8))) : text;
  if (rounded.includes("e")) return rounded;
  const [whole, digits] = rounded.split(".");
  const sign = whole.startsWith("-") ? "-" : "";
  const grouped = whole.replace("-", "").replace(/\B(?=(\d{3})+$)/g, "\u202f");
  return sign + grouped + (digits ? `.${digits}` : "");
}

// An age in seconds: 0.4 s, 12 s, 5 min, 3 h, 2 d.
export function age(seconds) {
  if (seconds === null) return "";
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 100) return `${Math.round(seconds)} s`;
  if (seconds < 6000) return `${Math.round(seconds / 60)} min`;
  return seconds < 172800 ? `${Math.round(seconds / 3600)} h` : `${Math.round(seconds / 86400)} d`;
}
