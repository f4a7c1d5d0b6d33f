// The page: last values of the bus as they change, and the history.
"use strict";
const SILENT_MS = 20000;  // without an event for so long the connection counts as lost: the monitor sends its time every 5 s
const UNHEARD_MS = 15000;  // without live torque for so long the arm counts as not received: it comes every 10 s at least
const values = {};
let about = null, past = { t: [], joints: {}, replays: 0 }, drawing = null, charts = null, chosen = null;
let stops = [], stream = null, lost = null, heard = Date.now(), clock = null, torqueAt = null;

const friction = (joint) => values[`joint/${joint}/friction`];
const count = () => (about ? about.arm.links.length : 6);
const stateOf = (joint) => ((values.health && values.health.joints) || []).find((one) => one.joint === joint) || { state: null, why: "not known yet" };

const stale = () => make("span", "STALE", { class: "old", title: "nothing was learnt for too long: the state is of then, not of now" });
// advice for joints that are STALE
const STALE_ADVICE = "Look below, at Replays, why the last windows ended as they did, and at The monitor itself; once the arm may move, ask for a replay.";

// --- what is shown -----------------------------------------------------------------------------------

function verdict() {
  const health = values.health || { state: null };
  const state = $("state");
  state.replaceWith(Object.assign(chip(health.state), { id: "state" }));
  $("why").textContent = spoken(health.why) || "No replay has been assessed yet.";
  $("since").textContent = health.since ? `since ${moment(health.since)}` : "";
  $("said").textContent = moment(health.said_at);  // this element is outside the live region: a screen reader would read it aloud every minute
  $("old").hidden = $("stale").hidden = !health.stale;
  $("stale").textContent = health.stale ? `${health.stale_why.replace(/^STALE: /, "").replace(/^./, (letter) => letter.toUpperCase())}. ${STALE_ADVICE}` : "";
  $("due").textContent = moment(health.next_replay_due);
  $("revision").textContent = values.model ? String(values.model.revision) : "0";
  $("verdict").dataset.state = String(health.state);
  document.title = `${lost ? "NOT CONNECTED, " : ""}${health.stale ? "STALE, " : ""}${(STATES[health.state] || STATES.null)[1]}: ${about ? about.robot.id : ""} – joint-monitor`;
  for (let j = 1; j <= count(); j++) {
    const one = stateOf(j);
    if (drawing) drawing.state(j, String(one.state), `Joint ${j}, ${about.arm.links[j - 1].replaceAll("_", " ")}: ${(STATES[one.state] || STATES.null)[1]}${one.stale ? ", STALE" : ""}. ${one.why}`, one.stale);
    const tab = $(`tab-${j}`);
    if (tab) { tab.dataset.state = String(one.state); tab.classList.toggle("stale", Boolean(one.stale)); }
  }
}

// problems of the monitor itself are at the top, because the state below them may be out of date; returns whether they have changed
function problems() {
  const all = (values.monitor && values.monitor.troubles) || [];
  const name = (problem) => (problem.name === "arm" ? "The arm is not heard" : `The monitor has trouble, ${problem.name.replaceAll("_", " ")}`);
  const lines = [...stops.map((stop) => `Nothing moves until a person has looked at the arm and said so (joint-monitor allow): ${stop}`),
    ...all.map((problem) => `${name(problem)} since ${moment(problem.since)}: ${problem.text}`)];
  if ([...$("troubles").children].map((line) => line.textContent).join() === lines.join()) return false;
  $("troubles").replaceChildren(...lines.map((line) => make("p", line, { class: "bad" })));
  return true;
}

function joints() {
  const body = $("joints").tBodies[0];
  if (body.rows.length !== count()) {
    body.replaceChildren();
    for (let j = 1; j <= count(); j++) {
      const row = body.insertRow(), name = row.insertCell();
      const button = make("button", null, { type: "button" });
      button.append(`J${j} `, make("span", about.arm.links[j - 1].replaceAll("_", " "), { class: "dim" }));
      name.append(button);
      row.addEventListener("click", () => choose(j));
      for (const kind of ["", "n", "n wide", "n", "n wide"]) row.insertCell().className = kind;
    }
  }
  for (let j = 1; j <= count(); j++) {
    const row = body.rows[j - 1], own = friction(j), state = stateOf(j);
    row.cells[1].replaceChildren(chip(state.state), ...(state.stale ? [stale()] : []));
    row.cells[1].title = state.why || "";
    row.cells[2].textContent = own ? `${signed(100 * own.wear)} ± ${(100 * own.wear_std).toFixed(1)}` : "–";
    row.cells[3].textContent = own ? signed(3000 * own.wear_rate_per_day) : "–";
    row.cells[4].textContent = life(own);
    row.cells[5].textContent = own ? number(own.temperature_c) : "–";
    row.classList.toggle("on", j === chosen);
  }
}

// the causes of a change: they add up as logarithms, and are shown as percentages of friction torque
function attribution(parts) {
  const rows = [["measured change", parts.whole], ["of it temperature", parts.temperature], ["of it payload and context", parts.payload],
    ["of it wear", parts.wear], ["of it chance", parts.rest]];
  const table = make("table");
  for (const [name, value] of rows) {
    const row = table.insertRow();
    row.insertCell().textContent = name;
    const cell = row.insertCell();
    cell.className = "n";
    cell.textContent = percent(Math.expm1(value));
  }
  return table;
}

// the state that the monitor itself gives the joint; "advice" where the joint stays NORMAL
function stateOfAlert(alert) {
  if (!alert.active) return "null";
  const condition = about.conditions[alert.condition], state = condition ? condition.states[alert.tier] : null;
  return state === "NORMAL" ? "advice" : state || "CHECK_FUNCTION";
}
const keyOf = (alert) => `${alert.joint}/${alert.condition}`;
const shelved = (alert) => Boolean(alert.shelved_until) && Date.parse(alert.shelved_until) > now();
const waits = (alert) => !alert.acknowledged_at && !shelved(alert);

// the probability of the change that the condition is about, as a sentence; null for a condition of the data, which has none
function probability(alert) {
  const condition = about.conditions[alert.condition], what = condition ? condition.probability_of : null;
  const chance = alert.probability > 0.9999 ? "more than 99.99" : number(100 * alert.probability, 2);  // it never reaches 100 %
  return what && `Probability that friction ${what}: ${chance} %. Change ${percent(alert.change)}.`;
}

function alertCard(alert) {
  const card = make("article", null, { class: "alert", "data-state": stateOfAlert(alert), "data-key": keyOf(alert) });
  const name = `${place(alert.joint)}: ${words(alert.condition)}`, title = make("h3", name);
  title.append(make("span", alert.active ? alert.tier : "cleared", { class: "pill" }));
  if (alert.active && alert.acknowledged_at) title.append(make("span", "acknowledged", { class: "pill" }));
  if (alert.active && shelved(alert)) title.append(make("span", "shelved", { class: "pill" }));
  card.append(title, make("p", alert.text), make("p", alert.active ? alert.action : "", { class: "action" }));
  const steps = [`raised ${moment(alert.raised_at)}`];
  if (alert.updated_at !== alert.raised_at && alert.active) steps.push(`updated ${moment(alert.updated_at)}`);
  if (alert.cleared_at) steps.push(`cleared ${moment(alert.cleared_at)}`);
  if (alert.acknowledged_at) steps.push(`acknowledged by ${alert.acknowledged_by}, ${moment(alert.acknowledged_at)}${alert.acknowledged_why ? `: ${alert.acknowledged_why}` : ""}`);
  if (alert.shelved_until) steps.push(`${shelved(alert) ? "" : "was "}shelved by ${alert.shelved_by} until ${moment(alert.shelved_until)}${alert.shelved_why ? `: ${alert.shelved_why}` : ""}`);
  card.append(make("p", steps.join(" · "), { class: "dim" }));
  const evidence = make("details"), figure = probability(alert);
  evidence.append(make("summary", "Evidence", { "aria-label": `Evidence of ${name}` }));
  if (figure) evidence.append(make("p", figure));
  if (alert.split) evidence.append(attribution(alert.split));
  if (evidence.childElementCount > 1) card.append(evidence);
  if (alert.active) {
    const row = make("div", null, { class: "row" });
    const what = { joint: alert.joint, condition: alert.condition };
    if (!alert.acknowledged_at) {
      const button = make("button", "Acknowledge…", { type: "button", class: "primary", "data-do": "ack", "aria-label": `Acknowledge… ${name}` });
      button.addEventListener("click", () => ask("ack", what, `Acknowledge: ${place(alert.joint)}, ${words(alert.condition).toLowerCase()}`, "It has been seen. It clears by itself once its condition is gone."));
      row.append(button);
    }
    const shelf = make("button", "Shelve…", { type: "button", "data-do": "shelve", "aria-label": `Shelve… ${name}` });
    shelf.addEventListener("click", () => ask("shelve", what, `Shelve: ${place(alert.joint)}, ${words(alert.condition).toLowerCase()}`, "It stays active, and goes to the end of the list until then."));
    row.append(shelf);
    if (alert.joint != null) {
      const look = make("button", `Look at joint ${alert.joint}`, { type: "button", "data-do": "look" });
      look.addEventListener("click", () => { choose(alert.joint); $("detail-h").scrollIntoView({ block: "start" }); });
      row.append(look);
    }
    card.append(row);
  }
  return card;
}

function alerts() {
  const all = Object.entries(values).filter(([key]) => key.startsWith("alert/")).map(([, document_]) => document_);
  const order = ["limit", "wear", "advisory"];
  const active = all.filter((alert) => alert.active)
    .sort((a, b) => waits(b) - waits(a) || order.indexOf(a.tier) - order.indexOf(b.tier) || a.raised_at.localeCompare(b.raised_at));
  const waiting = active.filter(waits).length;
  $("count").textContent = waiting ? String(waiting) : "";
  $("count").title = waiting ? `${waiting} neither acknowledged nor shelved` : "";
  const opened = new Set([...document.querySelectorAll("#active details[open]")].map((one) => one.closest(".alert").dataset.key));
  const focused = document.activeElement && document.activeElement.closest("#active .alert");
  const had = focused && [focused.dataset.key, document.activeElement.dataset.do];
  const cards = active.map((alert) => {
    const card = alertCard(alert), evidence = card.querySelector("details");
    if (evidence) evidence.open = opened.has(keyOf(alert));
    return card;
  });
  $("active").replaceChildren(...(cards.length ? cards : [values.health && values.health.state ? make("p", "✓ No active alert.", { class: "none" }) : make("p", "Nothing can be said yet.", { class: "dim" })]));
  if (had) refocus(...had);
  const gone = all.filter((alert) => !alert.active);
  $("past").hidden = !gone.length;
  $("cleared").replaceChildren(...gone.map(alertCard));
}

// replaces the focus after the cards were made again, so that a person with a keyboard stays at the same alert
function refocus(key, what) {
  const card = [...document.querySelectorAll("#active .alert")].find((one) => one.dataset.key === key);
  if (card) (card.querySelector(what ? `[data-do="${what}"]` : "summary") || card.querySelector("button, summary")).focus();
}

function figures() {
  const own = friction(chosen), state = stateOf(chosen);
  $("which").textContent = String(chosen);
  $("link-name").textContent = about.arm.links[chosen - 1].replaceAll("_", " ");
  const shown = make("span");
  shown.append(chip(state.state), ...(state.stale ? [stale()] : []));
  const rows = [["State", shown], ["Learnt of it last", state.learnt_at ? moment(state.learnt_at) : "never"], ["Life left to the limit", life(own)]];
  if (own) {
    if (own.remaining_life.assumption) rows.push(["Life left assumes", own.remaining_life.assumption]);
    rows.push(
      ["Wear", `${signed(100 * own.wear)} ± ${(100 * own.wear_std).toFixed(1)} %`],
      ...(own.unseen_step == null ? [] : [["Fresh step", `of the last ${own.unseen_step_days.toFixed(0)} days, up to ${(100 * own.unseen_step).toFixed(0)} % may be unseen`]]),
      ["Pace", `${signed(3000 * own.wear_rate_per_day)} ± ${(3000 * own.wear_rate_std_per_day).toFixed(1)} % a month`],
      [`Friction at ${own.reference_speed_rad_s} rad/s, ${own.reference_temperature_c.toFixed(1)} °C`, `${number(own.reference_torque_nm, 2)} ± ${number(own.reference_torque_std_nm, 2)} Nm`],
      ["Coulomb fc", `${number(own.coulomb_nm, 2)} ± ${number(own.coulomb_std_nm, 2)} Nm`],
      ["Viscous fv", `${number(own.viscous_nm_s_per_rad, 2)} ± ${number(own.viscous_std_nm_s_per_rad, 2)} Nm·s/rad`],
      ["Temperature, last replay", `${number(own.temperature_c)} °C`],
    );
    if (own.remaining_life.before_service_probability != null) rows.push([`Limit before next service, ${about.life.service_days} d`, `${number(100 * own.remaining_life.before_service_probability, 0)} %`]);
  }
  rows.push(["Why", spoken(state.why) || "–"]);
  $("figures").replaceChildren(...rows.map(([term, value]) => {
    const pair = make("div"), description = make("dd");
    description.append(value);
    pair.append(make("dt", term), description);
    return pair;
  }));
}

function detail() {
  figures();
  const own = past.joints[String(chosen)];
  charts.wear(past.t, own, chosen, about.levels, friction(chosen), about.life.limit_rise);
  charts.law(own, values.model, chosen);
  charts.torque(chosen);
  for (let j = 1; j <= count(); j++) {
    const tab = $(`tab-${j}`);
    tab.setAttribute("aria-selected", String(j === chosen));
    tab.tabIndex = j === chosen ? 0 : -1;
  }
  drawing.chosen(chosen);
}

function choose(joint) {
  chosen = joint;
  joints();
  detail();
}

function live() {
  const sample = values["torque/live"];
  if (!sample) return;
  drawing.pose(sample.q_rad);
  if (now() - Date.parse(sample.at) > UNHEARD_MS) return unheard();  // the last sample of an arm that is no longer received
  torqueAt = Date.now();
  charts.sample(sample);
  charts.torque(chosen);
  const left = sample.residual_nm ? sample.residual_nm[chosen - 1] : null;
  $("residual").textContent = left == null ? "" : `residual ${signed(left, 2)} Nm${sample.extrapolated[chosen - 1] ? ", outside the temperatures learnt" : ""}`;
}

function unheard() {
  torqueAt = null;
  charts.still(`Nothing is heard of the arm since ${moment(values["torque/live"].at, true)}.`);
  $("residual").textContent = "";
}

async function history() {
  const [series, rows] = await Promise.all([read("/api/history"), read("/api/schedule")]);
  past = series;
  const next = rows.coming.map((window_) => `${moment(window_.opens, true)} (${window_.why})`).join(", ");
  $("cron").textContent = `To come: ${next || "none"}. ${past.replays} assessed${past.shown < past.replays ? `, ${past.shown} of them drawn` : ""}.`;
  $("windows").tBodies[0].replaceChildren(...rows.windows.map((window_) => {
    const row = make("tr");
    row.append(timed("td", window_.window), make("td", window_.kind), make("td", [window_.reason ? `${window_.state}: ${window_.reason}` : window_.state, ...(window_.tries || []).map((text, i) => `try ${i + 1} ended ${text}`)].join("; ")));
    return row;
  }));
  $("events").tBodies[0].replaceChildren(...rows.events.map((event) => {
    const row = make("tr");
    row.append(timed("td", event.at), make("td", `${place(event.joint)}: ${words(event.condition)}`), make("td", `${event.kind}, ${event.tier}`));
    return row;
  }));
  if (!rows.events.length) { const row = make("tr"); row.append(make("td", "nothing yet", { class: "dim", colspan: "3" })); $("events").tBodies[0].append(row); }
  detail();
}

async function self() {
  const own = await read("/api/monitor");
  stops = own.stops;
  problems();
  const hours = own.up_s / 3600;
  const rows = [["Version", own.version], ["Host", (values.info && values.info.host) || "–"], ["Up", hours < 1 ? `${Math.round(own.up_s / 60)} min` : hours < 72 ? `${hours.toFixed(1)} h` : `${(hours / 24).toFixed(0)} d`],
    ["Memory", `${number(own.resident_mb, 0)} MB`], ["History", `${number(own.history_mb, 1)} MB`], ["Disk free", `${own.disk_free_gb} GB (${(100 * own.disk_free_share).toFixed(0)} %)`],
    ["Documents dropped", String(own.documents_dropped)], ["Last windows", Object.entries(own.last_windows).map(([state, n]) => `${n} ${state}`).join(", ") || "none"],
    ["Its clock", moment(own.now, true)]];
  const document_ = values.monitor;  // null until the monitor has published it
  if (document_) {
    const texts = (document_.troubles || []).map((problem) => (typeof problem === "string" ? problem : problem.text || problem.what || JSON.stringify(problem)));
    rows.unshift(["Troubles", texts.join("; ") || "none"]);
    if (document_.next_replay_why) rows.push(["Next replay, why", document_.next_replay_why]);
    const slowest = Object.entries(document_.workers || {}).sort((a, b) => b[1] - a[1])[0];
    if (slowest) rows.push(["Longest silent worker", `${slowest[0]}, ${slowest[1].toFixed(0)} s`]);
  }
  $("self").replaceChildren(...rows.map(([term, value]) => { const pair = make("div"); pair.append(make("dt", term), make("dd", value)); return pair; }));
}

// --- what arrives --------------------------------------------------------------------------------------

let again = null;
function soon() { clearTimeout(again); again = setTimeout(() => { history().catch(report); self().catch(report); }, 300); }
function report(error) { console.warn(error); }

function take(key, document_) {
  values[key] = document_;
  if (key === "torque/live") return live();
  if ((key === "monitor" && problems()) || key === "replay") soon();
  if (key === "health" || key === "model") verdict();
  if (key === "health") { joints(); alerts(); }
  if (key.startsWith("alert/")) { alerts(); soon(); }
  if (key.endsWith("/friction")) { joints(); soon(); }
  if (key === "health" || key.endsWith("/friction")) figures();
}

function listen() {
  if (stream) stream.close();
  heard = Date.now();
  stream = new EventSource("/api/live");
  stream.addEventListener("time", (event) => { heard = Date.now(); clock = { time: Number(event.data), at: heard }; });
  stream.addEventListener("value", (event) => {
    heard = Date.now();
    const space = event.data.indexOf(" ");
    take(JSON.parse(event.data.slice(0, space)), JSON.parse(event.data.slice(space + 1)));
    if (!$("active").childElementCount) alerts();
  });
  stream.addEventListener("open", () => {
    if (lost && !$("dialog").open) return location.reload();  // the monitor has started again, and has a new page token
    lost = null;
    link();
  });
  stream.addEventListener("error", cut);
}

function cut() {
  if (!lost) lost = heard;
  link();
}

// shows whether the page is connected
function link() {
  $("link").textContent = lost ? "not connected" : "live";
  $("link").className = `pill ${lost ? "lost" : "live"}`;
  $("lost").hidden = !lost;
  if (lost) $("lost").textContent = `Nothing is heard of the monitor since ${moment(lost, true)}: all that stands here is of then. Trying again.`;
  document.body.classList.toggle("cut", Boolean(lost));
  verdict();
}

// every second: has the stream stopped without an error, was it refused, is the arm no longer received?
function tick() {
  if (Date.now() - heard > SILENT_MS) { cut(); listen(); }
  if (torqueAt && Date.now() - torqueAt > UNHEARD_MS) unheard();
}

async function begin() {
  about = await read("/api/about");
  $("robot").textContent = `${about.robot.site} / ${about.robot.id}`;
  $("model").textContent = `${about.robot.model.toUpperCase()}, ${about.robot.mounting}, ${about.robot.payload_kg} kg, tool ${about.robot.tool}`;
  charts = new Charts();
  drawing = new ArmDrawing($("arm"), about.arm, choose);
  $("legend").replaceChildren(...Object.keys(STATES).filter((state) => state !== "null").map((state) => { const item = make("li"); item.append(chip(state)); return item; }));
  for (let j = 1; j <= count(); j++) {
    const tab = make("button", `J${j}`, { type: "button", role: "tab", id: `tab-${j}`, "aria-controls": "panel", "data-state": "null" });
    tab.addEventListener("click", () => choose(j));
    $("tabs").append(tab);
  }
  chosen = 1;
  verdict(); joints();
  await history();
  self().catch(report);
  setInterval(() => self().catch(report), 30000);
  setInterval(tick, 1000);
  $("zone").textContent = `Times are those of ${Intl.DateTimeFormat().resolvedOptions().timeZone}.`;
  let first = true;
  const worst = () => {  // the joint in the worst state is shown first
    if (!first || !values.health) return;
    first = false;
    const order = Object.keys(STATES);
    const bad = [...(values.health.joints || [])].sort((a, b) => order.indexOf(b.state) - order.indexOf(a.state))[0];
    if (bad && bad.state !== "NORMAL") choose(bad.joint);
  };
  listen();
  const wait = setInterval(() => { worst(); if (!first) clearInterval(wait); }, 100);
}

const kept = localStorage.getItem("joint-monitor-theme");
if (kept === "light" || kept === "dark") document.documentElement.dataset.theme = kept;
begin().catch((error) => { $("why").textContent = `The page could not be loaded: ${error.message}`; report(error); });
