// Elements and words that every part of the page uses. Times are by the `clock` of page.js.
"use strict";
const $ = (id) => document.getElementById(id);
const STATES = {
  NORMAL: ["✓", "Normal"], CHECK_FUNCTION: ["C", "Check function"], OFF_SPEC: ["S", "Out of specification"],
  MAINTENANCE_REQUIRED: ["M", "Maintenance required"], FAILURE: ["F", "Failure"], null: ["?", "Not known yet"],
};

const make = (tag, text, attributes = {}) => {
  const made = document.createElement(tag);
  if (text != null) made.textContent = text;
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
};
const chip = (state) => {
  const [letter, words] = STATES[state] || STATES.null;
  const made = make("span", null, { class: "chip", "data-state": String(state) });
  made.append(make("i", letter, { "aria-hidden": "true" }), make("span", words, { class: "words" }));
  return made;
};
const number = (value, digits = 1) => (value == null ? "–" : value.toFixed(digits));
const percent = (value, digits = 1) => (value == null ? "–" : `${signed(100 * value, digits)} %`);
const signed = (value, digits = 1) => { const text = Math.abs(value).toFixed(digits); return Number(text) === 0 ? text : `${value > 0 ? "+" : "−"}${text}`; };
const moment = (text, seconds = false) => {
  if (!text) return "–";
  const at = new Date(text);
  return at.toLocaleString(undefined, { year: "numeric", month: "short", day: "numeric", hour: "2-digit", minute: "2-digit", ...(seconds ? { second: "2-digit" } : {}) });
};
const now = () => (clock ? clock.time + Date.now() - clock.at : Date.now());  // by the monitor's clock, as a telephone's clock may be wrong
const brief = (text) => {  // with its year, unless that is the present year
  const at = new Date(text), other = at.getFullYear() !== new Date(now()).getFullYear();
  return at.toLocaleString(undefined, { ...(other ? { year: "numeric" } : {}), month: "short", day: "numeric", hour: "2-digit", minute: "2-digit" });
};
const timed = (tag, text) => make(tag, text ? brief(text) : "–", text ? { title: text, class: "time" } : {});
const words = (condition) => condition.replaceAll("_", " ").replace(/^./, (letter) => letter.toUpperCase());
const spoken = (why) => (why || "").replace(/\b[a-z]+(_[a-z]+)+\b/g, (word) => word.replaceAll("_", " "));
const place = (joint) => (joint == null ? "The arm" : `Joint ${joint}`);
function life(row) {
  const left = row && row.remaining_life;
  if (!left) return "–";
  if (left.verdict === "reached") return "limit reached";
  if (left.p50_days == null) return "no trend";
  const days = (d) => (d == null ? "–" : d >= 730 ? `${(d / 365.25).toFixed(1)} a` : `${d.toFixed(0)} d`);
  return `${days(left.p50_days)} (${days(left.p10_days)}–${days(left.p90_days)})`;
}
async function read(path) {
  const answer = await fetch(path, { credentials: "same-origin" });
  if (answer.status === 401) location.reload();
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer.json();
}
