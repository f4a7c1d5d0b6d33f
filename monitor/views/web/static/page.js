// The page: last values of the bus as they change, and the history.
"use strict";
const SILENT_MS = 20000;  // without an event for so long the connection counts as lost: the monitor sends its time every 5 s
const UNHEARD_MS = 15000;  // without live torque for so long the arm counts as not received: it comes every 10 s at least
const values = {};
let about = null, past = { t: [], joints: {}, marks: [], replays: 0 }, drawing = null, charts = null, chosen = null, choice = false;
let stops = [], stream = null, lost = null, heard = Date.now(), clock = null, torqueAt = null;

const friction = (joint) => values[`joint/${joint}/friction`];
const count = () => (about ? about.arm.links.length : 6);
const stateOf = (joint) => {
  const found = ((values.health && values.health.joints) || []).find((one) => one.joint === joint);
  return found ? { ...found, pill: values.health.pills[joint] } : { pill: null, why: t("not known yet") };
};

const stale = () => make("span", t("OUT OF DATE"), { class: "old", title: t("Nothing was learned for too long: the state is of then, not of now.") });

// --- what is shown -----------------------------------------------------------------------------------

// the server says how the arm is shown; a stop that waits for a person is known here first
function shownArm() {
  const shown = values.health ? values.health.shown : { pill: null, text: t("No replay has been assessed yet."), of_arm: false };
  if (!stops.length || shown.of_arm || !["null", "NORMAL", "CHECK_FUNCTION"].includes(String(shown.pill))) return shown;
  return { pill: "CHECK_FUNCTION", text: t("The arm is stopped: nothing moves until a person has looked at it.") };
}

function verdict() {
  if (!about) return;
  const health = values.health || { state: null }, shown = shownArm();
  $("state").replaceWith(Object.assign(chip(shown.pill), { id: "state" }));
  $("why").textContent = sentence(shown.text);
  $("since").textContent = health.since && shown.pill === health.state ? t("since {when}", { when: brief(health.since) }) : "";
  $("said").textContent = health.said_at ? brief(health.said_at) : "–";  // this element is outside the live region: a screen reader would read it aloud every minute
  $("old").hidden = $("stale").hidden = !health.stale;
  $("stale").textContent = health.stale ? `${sentence(health.stale_why.replace(/^STALE: /, ""))} ${t("Look below, at Replays, why the last ones ended as they did, and at The monitor itself; once the arm may move, ask for a replay.")}` : "";
  const waits = values.monitor && values.monitor.due;  // for the node of the program that lends the arm
  $("due").textContent = waits ? t("due since {when}, {text}", { when: brief(waits.since), text: waits.text }) : health.next_replay_due ? brief(health.next_replay_due) : t("none");
  $("revision").textContent = values.model ? String(values.model.revision) : "0";
  $("verdict").dataset.state = String(shown.pill);
  document.title = `${lost ? `${t("NOT CONNECTED")}, ` : ""}${health.stale ? `${t("OUT OF DATE")}, ` : ""}${stateWords(shown.pill)}: ${about.robot.id} – joint-monitor`;
  for (let j = 1; j <= count(); j++) {
    const one = stateOf(j);
    if (drawing) drawing.state(j, String(one.pill), `${jointName(j)}: ${stateWords(one.pill)}${one.stale ? `, ${t("OUT OF DATE")}` : ""}. ${sentence(one.why)}`, one.stale);
    const tab = $(`tab-${j}`);
    if (tab) { tab.dataset.state = String(one.pill); tab.classList.toggle("stale", Boolean(one.stale)); }
  }
}

// problems of the monitor itself are at the top, because the state below them may be out of date; returns whether they have changed
function problems() {
  const all = (values.monitor && values.monitor.troubles) || [];
  const name = (problem) => (problem.name === "arm" ? t("The arm is not heard") : t("The monitor has a problem ({name})", { name: t(problem.name).replaceAll("_", " ") }));
  const lines = [...stops.map((stop) => `${t("Nothing moves until a person has looked at the arm and allows it:")} ${stop}`),
    ...all.map((problem) => `${name(problem)} ${t("since {when}", { when: brief(problem.since) })}: ${problem.text}`)];
  if ([...$("troubles").querySelectorAll("p")].map((line) => line.textContent).join() === lines.join()) return false;
  $("troubles").replaceChildren(...lines.map((line) => make("p", line, { class: "bad" })));
  if (stops.length) {
    const button = make("button", t("Allow motion…"), { type: "button", id: "allow", class: "primary" });
    button.addEventListener("click", () => ask("allow", {}, t("Allow motion again"), t("Look at the arm first. From then on it moves in the next window: {stop}", { stop: stops.join("; ") })));
    $("troubles").append(button);
  }
  return true;
}

// the estimates of one joint as a line without axes
function sparkline(own) {
  const points = (own ? own.wear : []).filter((one) => one != null).slice(-60), svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("class", "sparkline"); svg.setAttribute("viewBox", "0 0 96 24"); svg.setAttribute("aria-hidden", "true");
  if (points.length < 2) return svg;
  const low = Math.min(-0.02, ...points), high = Math.max(0.06, ...points);  // the same scale for all that hardly changes: noise must look calm
  const line = document.createElementNS("http://www.w3.org/2000/svg", "polyline");
  line.setAttribute("points", points.map((one, k) => `${((k * 92) / (points.length - 1) + 2).toFixed(1)},${(22 - (20 * (one - low)) / (high - low)).toFixed(1)}`).join(" "));
  svg.append(line);
  return svg;
}

function joints() {
  const body = $("joints").tBodies[0];
  if (body.rows.length !== count()) {
    body.replaceChildren();
    for (let j = 1; j <= count(); j++) {
      const row = body.insertRow(), name = row.insertCell();
      const button = make("button", null, { type: "button" });
      button.append(jointName(j), make("span", ` J${j}`, { class: "dim" }));
      name.append(button);
      row.addEventListener("click", () => choose(j));
      for (const kind of ["", "spark", "n", "n wide", "n"]) row.insertCell().className = kind;
    }
  }
  for (let j = 1; j <= count(); j++) {
    const row = body.rows[j - 1], own = friction(j), state = stateOf(j);
    row.cells[1].replaceChildren(chip(state.pill), ...(state.stale ? [stale()] : []));
    row.cells[1].title = sentence(state.why);
    row.dataset.state = String(state.pill);
    row.cells[2].replaceChildren(sparkline(past.joints[String(j)]));
    row.cells[3].replaceChildren(...(own ? [signed(100 * own.wear), make("span", ` ± ${number(100 * own.wear_std)}`, { class: "std" }), " %"] : ["–"]));
    row.cells[4].textContent = own ? `${signed(3000 * own.wear_rate_per_day)} %` : "–";
    row.cells[5].textContent = life(own);
    row.classList.toggle("on", j === chosen);
  }
}

// the last work on the joint that is shown, which whoever declared it by mistake takes back here
function worked() {
  const work = values[`joint/${chosen}/maintenance`], shown = work && !work.undone_at ? `${chosen} ${work.text}` : "";
  if ($("worked").dataset.shown === shown) return;  // a button that is made again would lose the focus
  $("worked").dataset.shown = shown;
  $("worked").replaceChildren();
  if (!shown) return;
  $("worked").append(make("span", work.text, { class: "dim" }));
  if (!["greased", "overhauled", "replaced"].includes(work.kind)) return;  // the configuration declares other work
  const name = jointName(work.joint), button = make("button", t("That was a mistake…"), { type: "button", id: "undo" });
  button.addEventListener("click", () => ask("unserviced", { joint: work.joint }, t("Take back the work on {joint}", { joint: name }), t("What was known before it counts again, and replays since then are judged once more.")));
  $("worked").append(button);
}

// the slow track of each order that is more than its noise: evidence beside the state, and never a reason of it
function rippleOf(own) {
  const ripple = own.ripple;
  if (!ripple) return "";
  const shown = ripple.cycles_per_turn.flatMap((cycles, k) => ripple.track_a[k] == null || ripple.track_a[k] < 2 * ripple.track_std_a[k] ? []
    : [`${cycles}: ${number(1000 * ripple.track_a[k], 0)} ± ${number(1000 * ripple.track_std_a[k], 0)} (${t("at first {value}", { value: number(1000 * ripple.first_a[k], 0) })})`]);
  return shown.join(", ");
}

// what came from the arm's ordinary work and what from replays, and how far the next replay is
function fromProduction() {
  const found = values.from_production, own = found && found.joints[chosen - 1];
  if (!own) return [];
  const next = found.next_replay, when = next.needed_from && Date.parse(next.needed_from) > now() ? moment(next.needed_from) : t("now");
  const held = `${own.share == null ? "–" : number(own.share, 2)}${own.reason ? ` (${own.reason})` : ""}`;
  return [[t("Learned from"), t("{replays} replays, {periods} periods of work", { replays: own.learnt_from_replays, periods: own.learnt_from_production })],
    [t("Held from work, 1 being enough"), held],
    ...(next.replay === "when_needed" ? [[t("Next replay needed"), `${when} (${next.why})`]] : [])];
}

// which temperatures of 0 to 50 °C friction is known at, and which are missing
function temperatures() {
  const own = values.compensation && values.compensation.joints[chosen - 1];
  if (!own) return [];
  const span = (rows) => (rows.length ? `${number(rows[0].temperature_c, 0)}–${number(rows[rows.length - 1].temperature_c, 0)}` : null);
  const rows = own.by_temperature, first = rows.findIndex((row) => !row.extrapolated), known = rows.filter((row) => !row.extrapolated);
  const missing = first < 0 ? [span(rows)] : [span(rows.slice(0, first)), span(rows.slice(first + known.length))];
  return [[t("Temperatures known"), `${span(known) || "–"} °C`], [t("Temperatures missing, of 0 to 50 °C"), missing.filter(Boolean).join(", ") || t("none")]];
}

function figures() {
  if (!chosen) return;
  worked();
  const own = friction(chosen), state = stateOf(chosen);
  $("which").textContent = jointName(chosen);
  $("link-name").textContent = t("joint {number}", { number: chosen });
  const shown = make("span");
  shown.append(chip(state.pill), ...(state.stale ? [stale()] : []));
  const rows = [[t("State"), shown]], physics = [];
  if (own) {
    const assumed = own.remaining_life.assumption;
    rows.push([t("Change of friction"), `${signed(100 * own.wear)} ± ${number(100 * own.wear_std)} %`],
      [t("Per month"), `${signed(3000 * own.wear_rate_per_day)} ± ${number(3000 * own.wear_rate_std_per_day)} %`]);
    physics.push(
      [t("Friction at {speed} rad/s, {temperature} °C", { speed: number(own.reference_speed_rad_s, 1), temperature: number(own.reference_temperature_c) }), `${number(own.reference_torque_nm, 2)} ± ${number(own.reference_torque_std_nm, 2)} N·m`],
      [t("Coulomb friction fc"), `${number(own.coulomb_nm, 2)} ± ${number(own.coulomb_std_nm, 2)} N·m`],
      [t("Viscous friction fv"), `${number(own.viscous_nm_s_per_rad, 2)} ± ${number(own.viscous_std_nm_s_per_rad, 2)} N·m·s/rad`],
      [t("Temperature, last replay"), `${number(own.temperature_c)} °C`],
      ...temperatures(),
      ...(own.unseen_step == null ? [] : [[t("Fresh step"), t("one of the last {days} days may be unseen up to {percent} %", { days: number(own.unseen_step_days, 0), percent: number(100 * own.unseen_step, 0) })]]),
      ...(rippleOf(own) ? [[t("Gear ripple, mA at cycles a turn"), rippleOf(own)]] : []),
      ...(own.remaining_life.before_service_probability == null ? [] : [[t("Limit before the next service, {days} days", { days: about.life.service_days }), `${number(100 * own.remaining_life.before_service_probability, 0)} %`]]),
      ...(assumed ? [[t("Time left assumes"), assumed]] : []),
    );
  }
  rows.push([t("Time left to the limit"), life(own)], [t("Learned of it last"), state.learnt_at ? moment(state.learnt_at) : t("never")], ...fromProduction());
  physics.push([t("Why"), sentence(state.why) || "–"]);
  pairs($("figures"), rows);
  pairs($("physics"), physics);
}

function detail() {
  figures();
  const own = past.joints[String(chosen)];
  charts.wear(past, own, chosen, about.levels, friction(chosen), about.life.limit_rise);
  charts.law(own, values.model, chosen);
  charts.torque(chosen);
  for (let j = 1; j <= count(); j++) {
    const tab = $(`tab-${j}`);
    tab.setAttribute("aria-selected", String(j === chosen));
    tab.tabIndex = j === chosen ? 0 : -1;
  }
  drawing.chosen(chosen);
}

function show(joint) {
  chosen = joint;
  joints();
  detail();
}

// what a person chose stays: no document that comes later chooses again
function choose(joint) {
  choice = true;
  show(joint);
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
  $("residual").textContent = left == null || charts.stands ? "" : t("measured − predicted {figure} N·m", { figure: signed(left, 2) }) + (sample.extrapolated[chosen - 1] ? `, ${t("outside the temperatures learned")}` : "");
}

function unheard() {
  torqueAt = null;
  charts.still(t("Nothing is heard of the arm since {when}.", { when: moment(values["torque/live"].at, true) }));
  $("residual").textContent = "";
}

// the windows that ended alike one after another are one row
function windowRow(row_) {
  const row = make("tr"), alike = row_.count > 1, when = timed("td", row_.window);
  if (alike) { const [first, last] = [days(row_.from), days(row_.window)]; when.textContent = first === last ? first : `${first} – ${last}`; }
  const lent = row_.borrowed, program = lent && (lent.program || t("a program without a name"));
  const from = !lent ? [] : [lent.waited_s == null ? t("borrowed from {program}, not given back", { program }) : t("borrowed from {program}, which waited {seconds} s", { program, seconds: number(lent.waited_s, 1) })];
  const told = [row_.reason ? `${t(row_.state)}: ${row_.reason}` : t(row_.state), ...from, ...(row_.tries || []).map((one, i) => t("try {number} ended {text}", { number: i + 1, text: `${brief(one.at)}: ${one.reason}` }))].join("; ");
  row.append(when, make("td", alike ? `${row_.count} × ${told}` : row_.kind === "scheduled" ? told : `${told} (${t(row_.kind)})`));
  return row;
}

async function history() {
  const [series, rows] = await Promise.all([read("/api/history"), read("/api/schedule")]);
  past = series;
  const [first, ...later] = rows.coming;
  const next = first ? t("Next: {when} ({why})", { when: brief(first.opens), why: first.why }) + (later.length ? `; ${t("then {when}", { when: later.slice(0, 2).map((one) => brief(one.opens)).join(", ") })}` : "") : t("None is planned");
  $("cron").textContent = `${next}. ${t("{count} assessed", { count: past.replays })}${past.shown < past.replays ? `, ${t("{count} of them drawn", { count: past.shown })}` : ""}.`;
  $("windows").tBodies[0].replaceChildren(...rows.windows.map(windowRow));
  $("events").tBodies[0].replaceChildren(...rows.events.map((event) => {
    const row = make("tr");
    row.append(timed("td", event.at), make("td", jointName(event.joint)), make("td", event.text || `${words(event.condition || event.kind)}: ${t(event.kind)}${event.tier ? `, ${t(TIER_WORDS[event.tier] || event.tier)}` : ""}`));
    return row;
  }));
  if (!rows.events.length) { const row = make("tr"); row.append(make("td", t("nothing yet"), { class: "dim", colspan: "3" })); $("events").tBodies[0].append(row); }
  joints();
  detail();
  drawProofs();
  if (charts && !document.querySelector(".proof-chart")) alerts();
}

async function self() {
  const own = await read("/api/monitor");
  stops = own.stops.map((stop) => stop.text);
  problems();
  verdict();
  const hours = own.up_s / 3600, up = hours < 1 ? t("{count} min", { count: number(own.up_s / 60, 0) }) : hours < 72 ? t("{count} h", { count: number(hours, 1) }) : t("{count} days", { count: number(hours / 24, 0) });
  const rows = [[t("Version"), own.version], [t("Computer"), (values.info && values.info.host) || "–"], [t("Running for"), up],
    [t("Memory"), `${number(own.resident_mb, 0)} MB`], [t("History"), `${number(own.history_mb, 1)} MB`], [t("Disk free"), `${number(own.disk_free_gb, 1)} GB${own.disk_free_share == null ? "" : ` (${number(100 * own.disk_free_share, 0)} %)`}`],
    [t("Documents dropped"), String(own.documents_dropped)], [t("Last windows"), Object.entries(own.last_windows).map(([state, n]) => `${n} ${t(state)}`).join(", ") || t("none")],
    [t("Its clock"), moment(own.now, true)]];
  if (values.info && values.info.prior) rows.push([t("What the plant taught it"), values.info.prior.text]);
  const document_ = values.monitor;  // null until the monitor has published it
  if (document_) {
    const texts = (document_.troubles || []).map((problem) => (typeof problem === "string" ? problem : problem.text || problem.what || JSON.stringify(problem)));
    rows.unshift([t("Problems"), texts.join("; ") || t("none")]);
    if (document_.next_replay_why) rows.push([t("Next replay, why"), document_.next_replay_why]);
    const slowest = Object.entries(document_.workers || {}).sort((a, b) => b[1] - a[1])[0];
    if (slowest) rows.push([t("Longest silent part"), `${t(slowest[0])}, ${number(slowest[1], 0)} s`]);
  }
  pairs($("self"), rows);
}

// --- what arrives --------------------------------------------------------------------------------------

let again = null;
function soon() { clearTimeout(again); again = setTimeout(() => { history().catch(report); self().catch(report); }, 300); }
function report(error) { console.warn(error); }

function take(key, document_) {
  values[key] = document_;
  if (key === "torque/live") return live();
  if (key.startsWith("alert/")) verdict();
  if ((key === "monitor" && problems()) || key === "replay") soon();
  if (key === "health" || key === "model" || key === "monitor") verdict();
  if (key === "health") { joints(); alerts(); }
  if (key.startsWith("alert/")) { alerts(); soon(); }
  if (key.endsWith("/friction")) { joints(); soon(); }
  if (key.endsWith("/maintenance")) { worked(); soon(); }
  if (key === "inspection") duties(document_);
  if (key === "health" || key === "from_production" || key.endsWith("/friction")) figures();
}

function listen() {
  if (stream) stream.close();
  heard = Date.now();
  stream = new EventSource(`${BASE}/api/live?lang=${LANG}`);
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
  stream.addEventListener("error", (event) => {
    cut();
    if (event.target.readyState === EventSource.CLOSED) read("/api/about").catch(report);  // refused: where the session has ended, this asks for the token
  });
}

function cut() {
  if (!lost) lost = heard;
  link();
}

// shows whether the page is connected
function link() {
  $("link").textContent = lost ? t("not connected") : t("live");
  $("link").className = `pill ${lost ? "lost" : "live"}`;
  $("lost").hidden = !lost;
  if (lost) $("lost").textContent = t("Nothing is heard of the monitor since {when}: all that stands here is of then. Trying again.", { when: moment(lost, true) });
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
  $("model").textContent = t("{model}, {mounting}, {payload} kg, tool {tool}", { model: about.robot.model.toUpperCase(), mounting: t(about.robot.mounting), payload: number(about.robot.payload_kg, 1), tool: about.robot.tool });
  charts = new Charts();
  drawing = new ArmDrawing($("arm"), about.arm, choose);
  $("legend").replaceChildren(...Object.keys(STATES).filter((state) => state !== "null").map((state) => { const item = make("li"); item.append(chip(state)); return item; }));
  for (let j = 1; j <= count(); j++) {
    const tab = make("button", jointName(j), { type: "button", role: "tab", id: `tab-${j}`, "aria-controls": "panel", "data-state": "null" });
    tab.addEventListener("click", () => choose(j));
    $("tabs").append(tab);
  }
  chosen = 1;
  verdict(); joints();
  await history();
  self().catch(report);
  setInterval(() => self().catch(report), 30000);
  setInterval(tick, 1000);
  $("zone").textContent = t("Times are those of {zone}.", { zone: Intl.DateTimeFormat().resolvedOptions().timeZone });
  $("home").hidden = !BASE;  // this page is one of a plant's screen
  $("home").href = `/?lang=${LANG}`;
  for (const [code, name] of Object.entries(about.languages)) if (code !== LANG) $("languages").append(make("a", name, { href: `${BASE}/?lang=${code}`, lang: code, hreflang: code, "data-lang": code }));
  const worst = () => {  // the joint in the worst state is shown first
    if (choice) return;
    const order = Object.keys(STATES);
    const bad = [...(values.health.joints || [])].sort((a, b) => order.indexOf(b.state) - order.indexOf(a.state))[0];
    if (bad && bad.state !== "NORMAL") show(bad.joint);
  };
  listen();
  const wait = setInterval(() => { if (!choice && !values.health) return; clearInterval(wait); worst(); }, 100);
}

const kept = localStorage.getItem("joint-monitor-theme");
if (kept === "light" || kept === "dark") document.documentElement.dataset.theme = kept;
begin().catch((error) => { $("why").textContent = t("The page could not be loaded: {why}", { why: error.message }); report(error); });
