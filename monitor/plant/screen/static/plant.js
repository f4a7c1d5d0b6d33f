// The plant's screen: all arms, the worst first; the alerts of all; one joint among its peers; who did what.
"use strict";
const PERIOD_MS = 3000, PATIENCE_MS = 20000, FEW_ALERTS = 5, MOST_ALERTS = 200, FIRST_ROWS = 60, SAME = 0.005, STEPS = [0.02, 0.05, 0.1, 0.2, 0.5];
const GRADES = { sick: N_("sick"), unseen: N_("not seen"), doubtful: N_("doubtful"), well: N_("well") };
const about = JSON.parse($("about-data").textContent), TOKEN = document.querySelector("meta[name=page-token]").content;
const TIERS = ["advisory", "wear", "limit"];
const ROLES = ["look", "acknowledge", "move", "configure"], may = (role, site) => ROLES.indexOf(about.sites[site] || about.role) >= ROLES.indexOf(role);
let allAlerts = false, plant = JSON.parse($("arms-data").textContent), heard = Date.now(), clock = null, grade = "", pending = null, past = { marks: [], t: [] };
const filters = { search: "", site: "", model: "" };

const href = (arm) => `/arms/${encodeURIComponent(arm.site)}/${encodeURIComponent(arm.robot)}/?lang=${LANG}`;
const API = "/api/v1/arms", of = (arm) => `${API}/${encodeURIComponent(arm.site)}/${encodeURIComponent(arm.robot)}`;
const nameOf = (arm) => `${arm.site} / ${arm.robot}`;
const shown = () => plant.arms.filter((arm) => (!filters.site || arm.site === filters.site) && (!filters.model || arm.model === filters.model)
  && filters.search.toLowerCase().split(/\s+/).every((word) => `${arm.site}/${arm.robot} ${arm.model || ""} ${arm.why || ""}`.toLowerCase().includes(word)));

// what a person must know of an arm, the worst first
function known(arm) {
  const lines = [];
  if (arm.silent_since) lines.push([t("Nothing is heard of it since {when}: {why}", { when: brief(arm.silent_since), why: arm.silent_why }), "bad"]);
  if (arm.stale) lines.push([t("Nothing was learned of it for too long: its state is of then."), "warn"]);
  if (arm.same_history.length) lines.push([t("Its history is that of {names} as well: was it renamed, or its disk copied?", { names: arm.same_history.join(", ") }), "warn"]);
  if (arm.problem) lines.push([t("Its history is not copied: {why}", { why: arm.problem }), "warn"]);
  if (arm.set_aside) lines.push([sentence(arm.set_aside), "warn"]);
  if (arm.clock_ahead_s !== null) {
    const off = Math.abs(arm.clock_ahead_s), time = off > 7200 ? `${Math.round(off / 3600)} h` : `${Math.round(off / 60)} min`;
    lines.push([arm.clock_ahead_s > 0 ? t("Its clock is {time} ahead of the plant's.", { time }) : t("Its clock is {time} behind the plant's.", { time }), "warn"]);
  }
  if (arm.waiting) lines.push([t("Alerts that wait for a person: {count}", { count: arm.waiting }), ""]);
  if (arm.age === "now" && arm.pill !== "NORMAL") lines.push([sentence(arm.why), ""]);
  if (arm.troubles.length) lines.push([t("Problems of its monitor: {names}", { names: arm.troubles.map((name) => t(name).replaceAll("_", " ")).join(", ") }), ""]);
  if (arm.version && plant.version && arm.version !== plant.version) lines.push([t("Its monitor is of version {theirs}, the plant of {ours}.", { theirs: arm.version, ours: plant.version }), ""]);
  return lines;
}

function row(arm) {
  const made = make("tr", null, { "data-key": nameOf(arm), "data-state": String(arm.pill) }), where = make("td"), joints = make("td", null, { class: "wide" }), what = make("td");
  const state = make("td");
  state.append(chip(arm.pill));
  where.append(make("a", nameOf(arm), { href: href(arm) }), make("div", (arm.model || "?").toUpperCase(), { class: "dim small" }));
  const group = make("div", null, { class: "joints" });
  arm.joints.forEach((one, k) => {
    const words_ = t("{arm}, joint {number}: {state}; beside its peers", { arm: nameOf(arm), number: k + 1, state: stateWords(one) });
    const button = make("button", String(k + 1), { type: "button", "data-state": String(one), title: words_, "aria-label": words_ });
    button.addEventListener("click", () => peers(arm, k + 1));
    group.append(button);
  });
  joints.append(group);
  for (const [text, kind] of known(arm)) what.append(make("p", text, kind ? { class: kind } : {}));
  made.append(state, where, joints, what, Object.assign(timed("td", arm.last_replay), { className: "wide time" }));
  return made;
}

const drawn = new Map();  // key of an arm → [what its row was made of, the row]
function list() {
  const chosen = shown().filter((arm) => !grade || arm.grade === grade), rows = [];
  const arms = drawn.size ? chosen : chosen.slice(0, FIRST_ROWS);  // what is seen first is drawn first
  if (arms.length < chosen.length) requestAnimationFrame(() => setTimeout(list, 0));  // after these are painted
  for (const arm of arms) {
    const key = nameOf(arm), made_of = JSON.stringify(arm), old = drawn.get(key);
    if (!old || old[0] !== made_of) drawn.set(key, [made_of, row(arm)]);
    rows.push(drawn.get(key)[1]);
  }
  const body = $("arms").tBodies[0];
  if (rows.length !== body.rows.length || rows.some((one, k) => body.rows[k] !== one)) {
    const key = document.activeElement && body.contains(document.activeElement) ? document.activeElement.closest("tr").dataset.key : null;
    body.replaceChildren(...rows);  // a row that has not changed stays the same element
    if (key && document.activeElement === document.body) focusRow(key);
  }
  $("arm-count").textContent = chosen.length === plant.arms.length ? String(chosen.length) : t("{count} of {all}", { count: chosen.length, all: plant.arms.length });
}
const focusRow = (key) => { const found = [...$("arms").tBodies[0].rows].find((one) => one.dataset.key === key); if (found) found.querySelector("a").focus(); };

function counts() {
  const all = shown();
  const buttons = [["", t("all"), all.length], ...Object.entries(GRADES).map(([name, text]) => [name, t(text), all.filter((arm) => arm.grade === name).length])];
  const old = [...$("counts").children];
  buttons.forEach(([name, text, count], k) => {
    const button = old[k] || make("button", null, { type: "button", "data-grade": name });
    button.replaceChildren(make("b", String(count)), ` ${text}`);
    button.setAttribute("aria-pressed", String(grade === name));
    if (!old[k]) { button.addEventListener("click", () => { grade = name; draw(); }); $("counts").append(button); }
  });
}

function choices(id, values) {
  const select = $(id), wanted = [...new Set(values)].filter(Boolean).sort();
  if ([...select.options].slice(1).map((one) => one.value).join() === wanted.join()) return;
  select.replaceChildren(select.options[0], ...wanted.map((value) => make("option", value, { value })));
  select.value = filters[id];
  if (select.selectedIndex < 0) { select.value = ""; filters[id] = ""; }
}

function alerts() {
  const found = shown().flatMap((arm) => arm.alerts.map((alert) => ({ arm, alert })));
  for (const one of found) one.rank = [one.alert.acknowledged_at ? 1 : 0, one.alert.person === "shelved" ? 1 : 0, 9 - TIERS.indexOf(one.alert.tier)].join("");
  const order = (a, b) => (a < b ? -1 : a > b ? 1 : 0);
  found.sort((a, b) => order(a.rank, b.rank) || order(b.alert.raised_at, a.alert.raised_at));
  const open = found.filter((one) => one.alert.person === "waits").length;
  $("alert-count").textContent = found.length ? t("{open} open, {all} in all", { open, all: found.length }) : "";
  const most = allAlerts ? MOST_ALERTS : FEW_ALERTS, made_of = JSON.stringify([found.slice(0, most).map(({ arm, alert }) => [nameOf(arm), alert]), found.length, about.role, allAlerts]);
  if ($("alerts").dataset.madeOf === made_of) return;
  const focused = document.activeElement && document.activeElement.dataset ? document.activeElement.dataset.act : null;
  $("alerts").dataset.madeOf = made_of;
  $("alerts").replaceChildren(...found.slice(0, most).map(({ arm, alert }) => alertRow(arm, alert)));
  if (!found.length) $("alerts").append(make("p", t("No alert is active."), { class: "dim" }));
  if (allAlerts && found.length > most) $("alerts").append(make("p", t("{count} more are not shown: search, or choose a site.", { count: found.length - most }), { class: "dim" }));
  if (found.length > FEW_ALERTS) {
    const button = make("button", allAlerts ? t("Show fewer") : t("Show all {count}", { count: found.length }), { type: "button", "data-act": "all" });
    button.addEventListener("click", () => { allAlerts = !allAlerts; alerts(); });
    $("alerts").append(button);
  }
  if (focused) { const again = [...$("alerts").querySelectorAll("button")].find((one) => one.dataset.act === focused); if (again) again.focus(); }
}

function alertRow(arm, alert) {
  const made = make("div", null, { class: `alert-row${alert.acknowledged_at ? " done" : ""}` }), text = make("p"), buttons = make("div", null, { class: "row" });
  const joint = alert.joint == null ? t("The arm") : t("Joint {number}", { number: alert.joint });
  text.append(make("a", nameOf(arm), { href: href(arm) }), ` ${joint}: ${words(alert.condition)}. `, make("span", sentence(alert.text), { class: "dim" }));
  const told = [t("since {when}", { when: brief(alert.raised_at) })];
  if (alert.acknowledged_at) told.push(t("seen by {name}", { name: alert.acknowledged_by || "?" }));
  if (alert.person === "shelved") told.push(t("shelved until {when}", { when: brief(alert.shelved_until) }));
  text.append(" ", make("span", told.join(", "), { class: "dim small" }));
  if (alert.ticket) {
    const name = t("ticket {number}", { number: alert.ticket.number || "?" });
    text.append(" ", alert.ticket.url ? make("a", name, { href: alert.ticket.url, rel: "noreferrer", class: "small" }) : make("span", name, { class: "dim small" }));
  }
  if (may("acknowledge", arm.site)) {
    const acts = alert.acknowledged_at ? [["shelve", t("Shelve…")]] : [["ack", t("Acknowledge…")], ["shelve", t("Shelve…")]];
    for (const [act, label] of acts) {
      const button = make("button", label, { type: "button", "data-act": `${act} ${nameOf(arm)} ${alert.joint} ${alert.condition}` });
      button.addEventListener("click", () => ask(act, arm, alert));
      buttons.append(button);
    }
  }
  made.append(chip(alert.pill), text, buttons);
  return made;
}

function problems() {
  const lines = [];
  if (plant.not_running) lines.push(t("What stands here is old: {why}", { why: plant.not_running }));
  for (const [endpoint, up] of Object.entries(plant.ways || {})) if (!up) lines.push(t("No answer from the router {endpoint}", { endpoint }));
  if (Date.now() - heard > PATIENCE_MS) lines.push(t("Nothing is heard of the plant since {when}: all that stands here is of then. Trying again.", { when: moment(heard, true) }));
  $("problems").hidden = !lines.length;
  if ([...$("problems").children].map((one) => one.textContent).join() !== lines.join()) $("problems").replaceChildren(...lines.map((line) => make("p", line, { class: "bad" })));
  $("link").textContent = Date.now() - heard > PATIENCE_MS ? t("not connected") : t("live");
  $("link").className = `pill ${Date.now() - heard > PATIENCE_MS ? "lost" : "live"}`;
}

function draw() {
  choices("site", plant.arms.map((arm) => arm.site));
  choices("model", plant.arms.map((arm) => arm.model));
  problems(); counts(); alerts(); list();
  const worst = plant.arms.filter((arm) => arm.grade === "sick").length;
  document.title = `${worst ? `${worst} ${t(GRADES.sick)}: ` : ""}${t("The plant")} – joint-monitor`;
}

async function look() {
  if (document.hidden) return;
  try {
    plant = await read(API);
    heard = Date.now();
  } catch (error) { console.warn(error); }
  draw();
}

// --- one joint among its peers ----------------------------------------------------------------------
async function peers(arm, joint) {
  const found = await read(`${of(arm)}/joints/${joint}/peers`);
  const own = found.peers.find((one) => one.this), others = found.peers.filter((one) => one.wear != null);
  $("peers-h").textContent = t("{arm}, joint {number}, among {count} peers", { arm: nameOf(arm), number: joint, count: Math.max(0, found.peers.length - (own ? 1 : 0)) });
  if (!own || own.wear == null) { $("peers-text").textContent = t("Nothing is known of this joint yet."); $("peers-plot").replaceChildren(); return show(); }
  const below = others.filter((one) => !one.this && one.wear < own.wear - SAME).length, rest = others.length - 1;
  $("peers-text").textContent = t("Its friction changed by {change} since the beginning; that is more than in {below} of {all} other arms of this model ({model}).",
    { change: percent(own.wear), below, all: rest, model: (found.model || "?").toUpperCase() });
  $("peers-plot").replaceChildren(strip(others));
  show();
  function show() { $("peers").showModal(); }
}

function strip(rows) {
  const NS = "http://www.w3.org/2000/svg", svg = document.createElementNS(NS, "svg"), element = (name, attributes, text) => {
    const made = document.createElementNS(NS, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text != null) made.textContent = text;
    svg.append(made);
    return made;
  };
  svg.setAttribute("viewBox", "0 0 800 150"); svg.setAttribute("role", "img"); svg.setAttribute("aria-label", $("peers-text").textContent);
  const wears = rows.map((one) => one.wear), least = Math.min(-0.05, ...wears), most = Math.max(0.05, ...wears);
  const step = STEPS.find((one) => one * 8 >= most - least) || (most - least) / 4, low = step * Math.floor(least / step), high = step * Math.ceil(most / step);
  const x = (value) => 20 + (760 * (value - low)) / (high - low);
  element("line", { x1: 20, x2: 780, y1: 120, y2: 120 });
  for (let value = low; value < high + step / 2; value += step) { element("line", { x1: x(value), x2: x(value), y1: 10, y2: 124 }); element("text", { x: x(value), y: 140, "text-anchor": "middle" }, percent(value, 0)); }
  const levels = new Map();
  for (const one of [...rows].sort((a, b) => (a.this ? 1 : 0) - (b.this ? 1 : 0) || a.wear - b.wear)) {
    const place = Math.round(x(one.wear) / 7), level = levels.get(place) || 0;
    levels.set(place, level + 1);
    const dot = element("circle", { cx: x(one.wear), cy: 112 - ((level * 8) % 100), r: one.this ? 6 : 4, ...(one.this ? { class: "this" } : {}) });
    dot.append(Object.assign(document.createElementNS(NS, "title"), { textContent: `${one.site} / ${one.robot}: ${percent(one.wear)}` }));
  }
  return svg;
}

// --- acts -------------------------------------------------------------------------------------------
function ask(command, arm, alert) {
  pending = { command, arm, alert };
  $("dialog-h").textContent = command === "ack" ? t("Acknowledge") : t("Shelve");
  $("dialog-text").textContent = `${nameOf(arm)}, ${alert.joint == null ? t("The arm") : t("Joint {number}", { number: alert.joint })}: ${words(alert.condition)}`;
  $("by-l").hidden = $("by").disabled = about.named;
  $("hours-l").hidden = $("hours").disabled = command !== "shelve";
  $("by").value = about.named ? about.who : localStorage.getItem("joint-monitor-name") || "";
  $("problem").textContent = "";
  $("dialog").showModal();
}
$("cancel").addEventListener("click", () => $("dialog").close());
$("form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const { command, arm, alert } = pending, request = { joint: alert.joint, condition: alert.condition, by: $("by").value.trim(), why: $("reason").value.trim() };
  if (command === "shelve") request.hours = Number($("hours").value);
  if (!about.named) localStorage.setItem("joint-monitor-name", request.by);
  $("ok").disabled = true;
  try {
    const answer = await fetch(`${of(arm)}/${command}?lang=${LANG}`, {
      method: "POST", credentials: "same-origin", headers: { "Content-Type": "application/json", "X-Page-Token": TOKEN }, body: JSON.stringify(request),
    });
    const reply = await answer.json();
    if (!answer.ok) throw new Error(reply.detail || String(answer.status));
    $("dialog").close();
    setTimeout(look, 500);
  } catch (error) {
    $("problem").textContent = error.message;
  } finally { $("ok").disabled = false; }
});

async function audit() {
  const rows = (await read("/api/v1/audit")).rows;
  $("audit").hidden = false;
  $("audit").querySelector("tbody").replaceChildren(...rows.map((one) => { const made = make("tr"); made.append(timed("td", one.at), make("td", one.who), make("td", one.act), make("td", one.robot || ""), make("td", one.text)); return made; }));
}

// --- keys -------------------------------------------------------------------------------------------
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || $("dialog").open || $("peers").open) return;
  const typing = ["INPUT", "TEXTAREA", "SELECT"].includes(document.activeElement.tagName);
  if (event.key === "/" && !typing) { event.preventDefault(); $("search").focus(); return; }
  if (event.key === "Escape" && document.activeElement === $("search")) { $("search").value = filters.search = ""; draw(); return; }
  const step = { ArrowDown: 1, ArrowUp: -1, j: 1, k: -1 }[event.key];
  if (!step || (typing && document.activeElement !== $("search")) || (typing && event.key.length === 1)) return;
  const links = [...$("arms").tBodies[0].querySelectorAll("a")], at = links.indexOf(document.activeElement);
  const next = links[at < 0 ? 0 : at + step];
  if (next) { event.preventDefault(); next.focus(); }
});

for (const id of ["search", "site", "model"]) $(id).addEventListener("input", () => { filters[id] = $(id).value; draw(); });
$("peers-close").addEventListener("click", () => $("peers").close());
$("theme").addEventListener("click", () => {
  const root = document.documentElement, dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
  localStorage.setItem("joint-monitor-theme", root.dataset.theme);
});
const kept = localStorage.getItem("joint-monitor-theme");
if (kept === "light" || kept === "dark") document.documentElement.dataset.theme = kept;
const at_sites = Object.entries(about.sites).map(([site, role]) => `; ${site}: ${t(role)}`).join("");
$("person").textContent = about.named ? t("{who}, may {role}", { who: about.who, role: t(about.role) }) + at_sites : "";
$("zone").textContent = t("Times are those of {zone}.", { zone: Intl.DateTimeFormat().resolvedOptions().timeZone });
for (const [code, name] of Object.entries(about.languages)) if (code !== LANG) $("languages").append(make("a", name, { href: `/?lang=${code}`, lang: code, hreflang: code }));
draw();
setInterval(look, PERIOD_MS);
document.addEventListener("visibilitychange", look);
if (may("configure")) { audit().catch(console.warn); setInterval(() => audit().catch(console.warn), 10 * PERIOD_MS); }
