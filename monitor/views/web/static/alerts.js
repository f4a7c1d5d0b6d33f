// The alerts: each leads with the sentence that decides, beside the chart that convinces; the physics is behind a click.
"use strict";
const OF_FRICTION = ["wear_rising", "sudden_step", "friction_falling"];  // a chart of the joint's friction convinces
const TIER_WORDS = { advisory: N_("notice"), wear: N_("wear"), limit: N_("limit") };
const keyOf = (alert) => `${alert.joint}/${alert.condition}`;
const shelved = (alert) => Boolean(alert.shelved_until) && Date.parse(alert.shelved_until) > now();
const waits = (alert) => !alert.acknowledged_at && !shelved(alert);
const allAlerts = () => Object.entries(values).filter(([key]) => key.startsWith("alert/")).map(([, document_]) => document_);

// the causes of a change: they add up as logarithms, and are shown as percentages of friction torque
function attribution(parts) {
  const rows = [[t("measured change"), parts.whole], [t("of it temperature"), parts.temperature], [t("of it payload and context"), parts.payload],
    [t("of it wear"), parts.wear], [t("of it chance"), parts.rest]];
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

// the probability of the change that the condition is about, as a sentence; null for a condition of the data, which has none
function probability(alert) {
  const condition = about.conditions[alert.condition], what = condition && condition.probability_of ? condition.probability_of.text : null;
  const chance = alert.probability > 0.9999 ? t("more than {percent} %", { percent: number(99.99, 2) }) : `${number(100 * alert.probability, 2)} %`;  // it never reaches 100 %
  return what && t("Probability that friction {what}: {chance}. Change {change}.", { what, chance, change: percent(alert.change) });
}

function stepsOf(alert) {
  const steps = [t("raised {when}", { when: brief(alert.raised_at) })], because = (why) => (why ? `: ${why}` : "");
  if (alert.updated_at !== alert.raised_at && alert.active) steps.push(t("updated {when}", { when: brief(alert.updated_at) }));
  if (alert.cleared_at) steps.push(t("cleared {when}", { when: brief(alert.cleared_at) }));
  if (alert.cleared_why) steps.push(alert.cleared_why);
  if (alert.serviced_at && alert.active) steps.push(t("serviced by {who}, {when}", { who: alert.serviced_by, when: brief(alert.serviced_at) }) + because(alert.serviced_why));
  if (alert.acknowledged_at) steps.push(t("acknowledged by {who}, {when}", { who: alert.acknowledged_by, when: brief(alert.acknowledged_at) }) + because(alert.acknowledged_why));
  if (alert.shelved_until) steps.push(t(shelved(alert) ? "shelved by {who} until {when}" : "was shelved by {who} until {when}", { who: alert.shelved_by, when: brief(alert.shelved_until) }) + because(alert.shelved_why));
  return steps.join(" · ");
}

function evidenceOf(alert, name) {
  const evidence = make("details"), figure = probability(alert);
  evidence.append(make("summary", t("Evidence"), { "aria-label": t("Evidence: {name}", { name }) }), make("p", alert.text));
  if (alert.gravest && alert.gravest.text !== alert.text) evidence.append(make("p", `${t("At its gravest, {when}:", { when: brief(alert.gravest.at) })} ${alert.gravest.text}`));
  if (figure) evidence.append(make("p", figure));
  if (alert.attribution) evidence.append(attribution(alert.attribution));
  return evidence;
}

function buttonsOf(alert, name) {
  const row = make("div", null, { class: "row" }), what = { joint: alert.joint, condition: alert.condition };
  const add = (label, command, title, text, kind = {}) => {
    const button = make("button", label, { type: "button", "data-do": command, "aria-label": `${label} ${name}`, ...kind });
    button.addEventListener("click", () => ask(command, what, title, text));
    row.append(button);
  };
  if (alert.acknowledged_at) add(t("Not acknowledged after all…"), "unack", t("Take back the acknowledgement: {name}", { name }), t("The alert waits for a person again."));
  else add(t("Acknowledge…"), "ack", t("Acknowledge: {name}", { name }), t("You have seen it. It clears by itself once its condition is gone."), { class: "primary" });
  if (alert.joint != null && OF_FRICTION.includes(alert.condition)) add(t("Work was done…"), "serviced", t("Work on {joint}", { joint: jointName(alert.joint) }), t("What was done, and when? The next replays show what it did to friction; a replaced joint begins anew."));
  if (shelved(alert)) add(t("Show again…"), "unshelve", t("Show again: {name}", { name }), t("It goes to its place in the list again."));
  else add(t("Shelve…"), "shelve", t("Shelve: {name}", { name }), t("It stays active, and goes to the end of the list until then."));
  if (alert.joint != null) {
    const look = make("button", t("Look at {joint}", { joint: jointName(alert.joint) }), { type: "button", "data-do": "look" });
    look.addEventListener("click", () => { choose(alert.joint); $("detail-h").scrollIntoView({ block: "start" }); });
    row.append(look);
  }
  return row;
}

function alertCard(alert) {
  const card = make("article", null, { class: "alert", "data-state": String(alert.pill), "data-key": keyOf(alert) });
  const name = `${jointName(alert.joint)}: ${words(alert.condition)}`, said = alert.said || { headline: name, pace: "", due: alert.action };
  const text = make("div", null, { class: "text" }), label = make("p", null, { class: "kind" });
  label.append(name, make("span", alert.active ? t(TIER_WORDS[alert.tier] || alert.tier) : t("cleared"), { class: "pill" }));
  if (alert.active && alert.acknowledged_at) label.append(make("span", t("acknowledged"), { class: "pill" }));
  if (alert.awaiting_proof) label.append(make("span", t("waits for its proof"), { class: "pill" }));
  if (alert.active && shelved(alert)) label.append(make("span", t("shelved"), { class: "pill" }));
  text.append(label, make("h3", said.headline));
  if (said.pace) text.append(make("p", said.pace));
  if (alert.active && said.due) text.append(make("p", said.due, { class: "action" }));
  if (alert.active && said.due !== alert.action) text.append(make("p", alert.action));
  text.append(make("p", stepsOf(alert), { class: "dim small" }), evidenceOf(alert, name));
  if (alert.active) text.append(buttonsOf(alert, name));
  card.append(text);
  if (alert.active && alert.joint != null && OF_FRICTION.includes(alert.condition) && past.joints[String(alert.joint)]) {
    const figure = make("figure", null, { class: "proof" });
    figure.append(make("figcaption", t("{joint}: friction since the beginning", { joint: jointName(alert.joint) })), make("div", null, { id: `proof-${alert.joint}-${alert.condition}`, class: "proof-chart", "data-joint": alert.joint }));
    figure.querySelector("figcaption").append(" ", make("span", "", { class: "readout dim" }));
    card.append(figure);
  }
  return card;
}

function drawProofs() {
  if (!charts) return;
  charts.forget("proof-");
  for (const place_ of document.querySelectorAll("#active .proof-chart")) {
    const joint = Number(place_.dataset.joint);
    charts.wear(past, past.joints[String(joint)], joint, about.levels, friction(joint), about.life.limit_rise, place_.id, 190);
  }
}

function alerts() {
  const all = allAlerts(), order = ["limit", "wear", "advisory"];
  const active = all.filter((alert) => alert.active)
    .sort((a, b) => waits(b) - waits(a) || order.indexOf(a.tier) - order.indexOf(b.tier) || a.raised_at.localeCompare(b.raised_at));
  const waiting = active.filter(waits).length;
  $("count").textContent = waiting ? String(waiting) : "";
  $("count").title = waiting ? t("{count} neither acknowledged nor shelved", { count: waiting }) : "";
  const opened = new Set([...document.querySelectorAll("#active details[open]")].map((one) => one.closest(".alert").dataset.key));
  const focused = document.activeElement && document.activeElement.closest("#active .alert");
  const had = focused && [focused.dataset.key, document.activeElement.dataset.do];
  const cards = active.map((alert) => {
    const card = alertCard(alert);
    card.querySelector("details").open = opened.has(keyOf(alert));
    return card;
  });
  const nothing = values.health && values.health.state ? make("p", `✓ ${t("No active alert.")}`, { class: "none" }) : make("p", t("Nothing can be said yet."), { class: "dim" });
  $("active").replaceChildren(...(cards.length ? cards : [nothing]));
  drawProofs();
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
