// Inspection duties: operating hours, stops of the arm's safety system, and checks with their due dates.
"use strict";
const CHECK_STATES = { unrecorded: N_("due, never recorded"), done: N_("not due yet"), soon: N_("due soon"), due: N_("due") };

function checkRow(item) {
  const row = make("tr"), grave = item.state === "due" || item.state === "unrecorded";
  const left = item.hours_left == null ? "" : ` (${t("{hours} h left", { hours: number(item.hours_left, 0) })})`;
  const button = make("button", t("Done…"), { type: "button", "aria-label": t("Record {check}", { check: t(item.name) }) });
  button.addEventListener("click", () => ask("inspected", { item: item.name }, t("Record {check}", { check: t(item.name) }), t("The next due date counts from now. Write down what was found.")));
  const last = item.last_done ? `${days(item.last_done)}${item.last_by ? `, ${item.last_by}` : ""}` : "–";
  row.append(make("td", t(item.name)), make("td", t(CHECK_STATES[item.state]), grave ? { class: "warn" } : {}), make("td", (item.due ? days(item.due) : "–") + left),
    make("td", last), make("td", String(item.stops_since), { class: "n" }));
  const cell = make("td");
  cell.append(button);
  row.append(cell);
  return row;
}

function stopRow(stop) {
  const row = make("tr");
  row.append(timed("td", stop.at), make("td", `${words(stop.kind)}${stop.during_replay ? ` (${t("during a replay")})` : ""}`), make("td", stop.joint == null ? "–" : jointName(stop.joint)), make("td", stop.code || "–"));
  return row;
}

// the document comes every ten minutes and at every stop: rows are made anew only where what they show has changed, so that a button keeps its focus
function duties(found) {
  $("inspection").hidden = false;
  pairs($("duty"), [[t("Operating hours"), `${number(found.operating_h, 1)} h`],
    ...(found.counted_since ? [[t("Counted since"), days(found.counted_since)], [t("In motion"), `${number(found.moving_h, 1)} h`]] : []),
    [t("Stops by the arm's safety system"), t("{count}, in 28 days {recent}", { count: found.stops, recent: found.stops_28_days })]]);
  const shown = JSON.stringify([found.items.map((item) => [item.name, item.state, (item.due || "").slice(0, 10), Math.round(item.hours_left || 0), item.last_done, item.stops_since]), found.last_stops]);
  if ($("inspection").dataset.shown === shown) return;
  $("inspection").dataset.shown = shown;
  $("checks").hidden = !found.items.length;
  $("checks").tBodies[0].replaceChildren(...found.items.map(checkRow));
  $("plan").textContent = found.plan ? t("The checks are those of {source}; their intervals are the shortest that it names, unless the file says others.", { source: found.plan }) : "";
  $("stops-kept").hidden = !found.last_stops.length;
  $("safety-stops").tBodies[0].replaceChildren(...found.last_stops.map(stopRow));
}
