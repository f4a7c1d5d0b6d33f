// Elements, words, figures and times that every part of the page uses. `WORDS` is the catalogue of the page's language.
"use strict";
const $ = (id) => document.getElementById(id);
const LANG = document.documentElement.lang;
const BASE = document.querySelector("meta[name=base]").content;  // where the page lies: empty, or a path of a plant's screen
const LOCALE = (navigator.languages || []).find((one) => one.toLowerCase().startsWith(LANG)) || LANG;  // a region has its own dates
// a text in the page's language, with values in its places
const t = (text, values) => (WORDS[text] || text).replace(/\{(\w+)\}/g, (place_, name) => (values && name in values ? values[name] : place_));
const N_ = (text) => text;  // marks a text for the catalogue
const STATES = {
  NORMAL: ["✓", N_("Normal")], NOTICE: ["i", N_("Notice")], CHECK_FUNCTION: ["C", N_("Check function")], OFF_SPEC: ["S", N_("Out of specification")],
  MAINTENANCE_REQUIRED: ["M", N_("Maintenance required")], FAILURE: ["F", N_("Failure")], null: ["?", N_("Not known yet")],
};
const stateWords = (state) => t((STATES[state] || STATES.null)[1]);

const make = (tag, text, attributes = {}) => {
  const made = document.createElement(tag);
  if (text != null) made.textContent = text;
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
};
const chip = (state) => {
  const made = make("span", null, { class: "chip", "data-state": String(state) });
  made.append(make("i", (STATES[state] || STATES.null)[0], { "aria-hidden": "true" }), make("span", stateWords(state), { class: "words" }));
  return made;
};
const pairs = (list, rows) => list.replaceChildren(...rows.map(([term, value]) => {
  const pair = make("div"), description = make("dd");
  description.append(value);
  pair.append(make("dt", term), description);
  return pair;
}));
const formats = {};
const number = (value, digits = 1) => {
  if (value == null) return "–";
  const format = (formats[digits] ||= new Intl.NumberFormat(LOCALE, { minimumFractionDigits: digits, maximumFractionDigits: digits, useGrouping: false }));
  return format.format(Number(value.toFixed(digits)) === 0 ? 0 : value);
};
const signed = (value, digits = 1) => { const text = number(Math.abs(value), digits); return Number(value.toFixed(digits)) === 0 ? text : `${value > 0 ? "+" : "−"}${text}`; };
const percent = (value, digits = 1) => (value == null ? "–" : `${signed(100 * value, digits)} %`);
const moment = (text, seconds = false) => {
  if (!text) return "–";
  return new Date(text).toLocaleString(LOCALE, { year: "numeric", month: "short", day: "numeric", hour: "2-digit", minute: "2-digit", ...(seconds ? { second: "2-digit" } : {}) });
};
const now = () => (clock ? clock.time + Date.now() - clock.at : Date.now());  // by the monitor's clock, as a telephone's clock may be wrong
const otherYear = (at) => at.getFullYear() !== new Date(now()).getFullYear();
const brief = (text) => {  // with its year, unless that is the present year
  const at = new Date(text);
  return at.toLocaleString(LOCALE, { ...(otherYear(at) ? { year: "numeric" } : {}), month: "short", day: "numeric", hour: "2-digit", minute: "2-digit" });
};
const days = (text) => {
  const at = new Date(text);
  return at.toLocaleDateString(LOCALE, { ...(otherYear(at) ? { year: "numeric" } : {}), month: "short", day: "numeric" });
};
const timed = (tag, text) => make(tag, text ? brief(text) : "–", text ? { title: text, class: "time" } : {});
const words = (condition) => { const known = t(condition); return (known === condition ? condition.replaceAll("_", " ") : known).replace(/^./, (letter) => letter.toUpperCase()); };
const spoken = (why) => (why || "").replace(/\b[a-z]+(_[a-z]+)+\b/g, (word) => t(word).replaceAll("_", " "));
const sentence = (text) => (text ? spoken(text).replace(/^./, (letter) => letter.toUpperCase()).replace(/([^.!?])$/, "$1.") : "");
const jointName = (joint) => (joint == null ? t("The arm") : about && about.joints[joint - 1] ? t(about.joints[joint - 1]) : t("Joint {number}", { number: joint }));
// whether the joint began anew after its last replay: what is known of its wear is of the old one
const renewed = (joint) => (past.marks || []).some((mark) => mark.renews && mark.joint === joint && mark.t > (past.t[past.t.length - 1] || 0));
function life(row) {
  if (row && renewed(row.joint)) return t("not known yet");
  const left = row && row.remaining_life;
  if (!left) return "–";
  if (left.verdict === "reached") return t("limit reached");
  if (left.p50_days == null) return t("no trend");
  const ends = [left.p10_days, left.p50_days, left.p90_days];
  const years = left.p50_days >= 730, span = (d) => (d == null ? "…" : years ? number(d / 365.25, 1) : number(d, 0));
  return t(years ? "{middle} years ({early}–{late})" : "{middle} days ({early}–{late})", { early: span(ends[0]), middle: span(ends[1]), late: span(ends[2]) });
}
async function read(path) {
  const answer = await fetch(`${BASE}${path}?lang=${LANG}`, { credentials: "same-origin" });
  if (answer.status === 401) location.reload();
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer.json();
}
