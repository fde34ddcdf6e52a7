"use strict";
// The run: its words as JSON, its columns as typed arrays. A column has `first` (a bucket's first value), and `low` and
// `high`, the smallest and largest; where a bucket is one cycle these are all the same array.
const run = JSON.parse(document.getElementById("content").textContent);
const columns = (() => {
  const element = document.getElementById("columns");
  const bytes = decoded(element.textContent);
  element.remove(); // megabytes that are not needed any more
  const found = {};
  let at = 0;
  for (const { name, kinds, type } of run.columns) {
    const column = (found[name] = {});
    for (const kind of kinds) {
      const Kind = type === "f8" ? Float64Array : Float32Array;
      column[kind] = new Kind(bytes.buffer, at, run.rows);
      at += column[kind].byteLength;
    }
    column.low = column.low || column.first;
    column.high = column.high || column.first;
    column.first = column.first || column.low;
  }
  return found;
})();
const time = columns.time_s.first;

function decoded(base64) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(base64);
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

// The bucket that holds a time [s].
function bucketAt(t) {
  let low = 0, high = time.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (time[middle] <= t) low = middle; else high = middle - 1;
  }
  return low;
}

// The lanes (what it did, what held it back) of a bucket, by number.
function lanesAt(k) {
  let low = 0, high = run.masks.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (run.masks[middle][0] <= k) low = middle; else high = middle - 1;
  }
  return run.masks[low].slice(1);
}

const PREFIXES = [[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"], [1e-12, "p"]];

// The prefix that suits numbers up to `largest` of a unit: [factor, unit with prefix].
function prefixed(largest, unit) {
  if (!unit || !(largest > 0) || unit.includes("/")) return [1, unit];
  const [factor, prefix] = PREFIXES.find(([f]) => largest >= 0.9995 * f) || PREFIXES[PREFIXES.length - 1];
  return [factor, prefix + unit];
}

function short(value) {
  if (value == null || Number.isNaN(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return value.toExponential(1);
  return value.toFixed(size >= 99.95 ? 0 : size >= 9.995 ? 1 : size >= 0.9995 ? 2 : 3);
}

// A number, or from where to where it went in a bucket, with its unit: "0.28 µm", "-0.1 … 2 mm".
function span(low, high, unit) {
  if (Number.isNaN(low)) return "–";
  const [factor, prefix] = prefixed(Math.max(Math.abs(low), Math.abs(high)), unit);
  const [a, b] = [short(low / factor), short(high / factor)];
  return `${a === b ? a : `${a} … ${b}`} ${prefix}`;
}

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function element(tag, parent, text, kind) {
  const made = document.createElement(tag);
  if (text != null) made.textContent = text;
  if (kind) made.className = kind;
  if (parent) parent.append(made);
  return made;
}

// Let a long name end its line behind a slash or an underscore; unlike a zero-width space, copying it changes nothing.
function breakable(cell) {
  const parts = cell.textContent.split(/(?<=[/_])/);
  cell.replaceChildren(...parts.flatMap((part, i) => (i ? [document.createElement("wbr"), part] : [part])));
}
