// What a person does: the dialog of the commands, the theme, the tabs by keyboard.
"use strict";
const TOKEN = document.querySelector('meta[name="page-token"]').content;
let pending = null;  // the command of the open dialog

function ask(command, what, title, text) {
  pending = { command, what, key: keyOf(what) };
  $("dialog-h").textContent = title;
  $("dialog-text").textContent = text;
  $("problem").textContent = "";
  $("hours-l").hidden = $("hours").disabled = command !== "shelve";  // a hidden field must not be required
  if (command === "shelve") $("hours").value = "24";
  $("by").value = localStorage.getItem("joint-monitor-name") || "";
  $("reason").value = "";
  $("ok").textContent = { ack: t("Acknowledge"), shelve: t("Shelve"), replay: t("Ask for a replay"), allow: t("Allow motion"), unack: t("Take back"), unshelve: t("Show again"), serviced: t("Declare the work"), unserviced: t("Take back"), inspected: t("Record the check") }[command];
  $("work").hidden = $("kind").disabled = $("at").disabled = command !== "serviced";
  $("at").value = new Date(now()).toISOString().slice(0, 10);
  $("at").max = $("at").value;
  $("fields").hidden = false; $("ok").hidden = false; $("cancel").textContent = t("Cancel");
  $("reason").required = ["allow", "serviced", "unserviced", "inspected"].includes(command);  // somebody will ask why it moves again
  $("dialog").showModal();
  ($("by").value ? $("reason") : $("by")).focus();
}

$("cancel").addEventListener("click", () => $("dialog").close());
$("dialog").addEventListener("close", () => { if (pending.command === "replay") $("replay").focus(); else if (pending.command === "allow") ($("allow") || $("replay")).focus(); else if (pending.command === "unserviced") ($("undo") || $(`tab-${chosen}`)).focus(); else if (pending.command === "inspected") $("checks").querySelector("button").focus(); else refocus(pending.key, pending.command); });
$("form").addEventListener("submit", async (event) => {
  event.preventDefault();
  const { command, what } = pending;
  const request = { ...what, by: $("by").value.trim(), why: $("reason").value.trim() };
  if (command === "shelve") request.hours = Number($("hours").value);
  if (command === "serviced") {
    delete request.condition;
    request.kind = $("kind").value;
    if ($("at").value && $("at").value !== $("at").max) request.at = `${$("at").value}T12:00:00Z`;  // today's work is done now
  }
  localStorage.setItem("joint-monitor-name", request.by);
  $("ok").disabled = true;
  try {
    const answer = await fetch(`${BASE}/api/cmd/${command}?lang=${LANG}`, {
      method: "POST", credentials: "same-origin", headers: { "Content-Type": "application/json", "X-Page-Token": TOKEN }, body: JSON.stringify(request),
    });
    const reply = await answer.json();
    if (!answer.ok) throw new Error(reply.error || String(answer.status));
    soon();
    if (command !== "serviced" && command !== "unserviced") return $("dialog").close();
    // what it means is said before the dialog goes
    $("fields").hidden = $("ok").hidden = true;
    $("dialog-text").textContent = (reply.text || []).join(" ");
    $("cancel").textContent = t("Close");
    $("cancel").focus();
  } catch (error) {
    $("problem").textContent = error.message;
  } finally {
    $("ok").disabled = false;
  }
});
$("replay").addEventListener("click", () => ask("replay", {}, t("Ask for a replay now"), t("The arm moves if every condition of a replay holds: make sure that nobody is near it.")));
$("languages").addEventListener("click", (event) => { if (event.target.dataset.lang) localStorage.setItem("joint-monitor-language", event.target.dataset.lang); });
{
  const wanted = localStorage.getItem("joint-monitor-language");
  if (wanted && wanted !== LANG && !location.search) location.replace(`${BASE}/?lang=${encodeURIComponent(wanted)}`);
}

$("theme").addEventListener("click", () => {
  const dark = document.documentElement.dataset.theme ? document.documentElement.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "light" : "dark";
  localStorage.setItem("joint-monitor-theme", document.documentElement.dataset.theme);
  repaint();
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => repaint());
let screenTheme;  // paper is white
addEventListener("beforeprint", () => { screenTheme = document.documentElement.dataset.theme; document.documentElement.dataset.theme = "light"; repaint(); });
addEventListener("afterprint", () => {
  if (screenTheme) document.documentElement.dataset.theme = screenTheme; else delete document.documentElement.dataset.theme;
  repaint();
});
function repaint() { if (charts && chosen) { charts.again(); detail(); drawProofs(); } }

$("tabs").addEventListener("keydown", (event) => {
  const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
  const to = event.key === "Home" ? 1 : event.key === "End" ? count() : step ? ((chosen - 1 + step + count()) % count()) + 1 : null;
  if (to == null) return;
  event.preventDefault();
  choose(to);
  $(`tab-${to}`).focus();
});
