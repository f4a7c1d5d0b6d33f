// Three charts of one joint: friction over time with its interval, fv over temperature with its law, live torque.
"use strict";
const Charts = (() => {
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const SECONDS = 60, DAY = 86400, STILL_RAD = 0.01;

  function axes(x, y, xValues) {
    const stroke = css("--dim"), grid = { stroke: css("--line"), width: 1 }, ticks = { stroke: css("--line"), width: 1, size: 4 };
    const font = "12px system-ui, sans-serif";
    return [
      { stroke, grid: { ...grid, show: Boolean(x) }, ticks, font, label: x, labelSize: x ? 18 : 0, labelFont: font, size: x ? 30 : 40, space: 64, ...(xValues ? { values: xValues } : {}) },
      { stroke, grid, ticks, font, label: y, labelSize: 18, labelFont: font, size: 46, values: (_, splits) => splits.map((one) => (one == null ? "" : String(one).replace(".", DECIMAL))) },
    ];
  }

  const DECIMAL = number(1.5, 1)[1];
  const dated = (_, splits, __, ___, step) => {
    const short = new Intl.DateTimeFormat(LOCALE, step < 28 * DAY ? { day: "numeric", month: "short" } : { month: "short", year: "numeric" });
    let before = null;
    return splits.map((at) => {
      if (at == null) return "";
      const day = short.format(at * 1000), same = day === before;
      before = day;
      const hour = step < DAY ? new Date(at * 1000).toLocaleTimeString(LOCALE, { hour: "2-digit", minute: "2-digit" }) : "";
      return [hour, same ? "" : day].filter(Boolean).join("\n");  // below the hour, where the day is another
    });
  };
  const clocked = (_, splits) => splits.map((at) => (at == null ? "" : new Date(at * 1000).toLocaleTimeString(LOCALE)));

  // fv and its standard deviation over temperature for joint j, as the monitor predicts torque: a straight line, or the curve that errs less
  function lawOf(line, j) {
    const chosen = line.curve && line.curve.kind[j] > 0 ? line.curve : null, by = chosen || line, c = by.cov[j], T0 = by.reference_c[j];
    const inverse = (t) => 1 / Math.max(t - chosen.pole_c[j], 5);  // Vogel's law
    return (t) => {
      const x = chosen && chosen.kind[j] > 1 ? inverse(t) - inverse(T0) : t - T0;
      const value = chosen ? Math.exp(chosen.a[j] + chosen.b[j] * x) : line.intercept[j] + line.slope[j] * x;
      return [value, (chosen ? value : 1) * Math.sqrt(Math.max(0, c[0][0] + 2 * c[0][1] * x + c[1][1] * x * x))];
    };
  }

  return class {
    constructor() {
      this.plots = {}; this.live = [];
      this.observer = new ResizeObserver((entries) => {
        for (const entry of entries) {
          const plot = this.plots[entry.target.id], width = Math.floor(entry.contentRect.width);
          if (plot && width > 50 && plot.width !== width) plot.setSize({ width, height: plot.height });
        }
      });
      this.stands = true;
      for (const id of ["wear", "law", "torque"]) this.observer.observe(document.getElementById(id));
    }

    draw(id, options, data, height = 220) {
      const place = document.getElementById(id);
      if (this.plots[id]) this.plots[id].destroy();
      place.replaceChildren();
      this.plots[id] = new uPlot({ width: Math.max(place.clientWidth, 200), height, cursor: { y: false }, legend: { show: false }, ...options }, data, place);
      place.setAttribute("role", "img");
    }

    // what is under the pointer, in the caption: a legend without a pointer would be empty
    readout(id, told) {
      const line = document.getElementById(id).closest("figure").querySelector(".readout");
      return { hooks: { setCursor: [(u) => { if (line) line.textContent = u.cursor.idx == null ? "" : told(u, u.cursor.idx); }] } };
    }

    // ends the charts whose elements were replaced
    forget(prefix) { for (const id of Object.keys(this.plots)) if (id.startsWith(prefix)) { this.plots[id].destroy(); delete this.plots[id]; } }

    empty(id, text) {
      const place = document.getElementById(id);
      if (this.plots[id]) { this.plots[id].destroy(); delete this.plots[id]; }
      const note = document.createElement("div");
      note.className = "empty"; note.textContent = text;
      place.replaceChildren(note);
    }

    // remaining life: lines from now along P10, P50 and P90 to the limit, cut at the edge of the chart; null without a trend
    ahead(times, own, now, limit) {
      const left = now && now.remaining_life, begin = times[times.length - 1], wear = own.wear[own.wear.length - 1];
      if (!left || left.verdict !== "trend" || left.p50_days == null || wear == null || wear >= limit) return null;
      const room = Math.max(1.5 * (begin - times[0]), 60 * DAY), ends = [left.p10_days, left.p50_days, left.p90_days].map((days) => (days == null ? Infinity : days * DAY));
      const to = Math.min(room, 1.05 * ends[2]);
      const [early, middle, late] = ends.map((end) => { const part = Math.min(1, to / end); return [begin + (Number.isFinite(end) ? part * end : to), 100 * (wear + part * (limit - wear))]; });
      return { from: [begin, 100 * wear], early, middle, late, until: begin + to };
    }

    fan(u, ahead) {
      const { ctx, bbox } = u, at = ([x, y]) => [u.valToPos(x, "x", true), u.valToPos(y, "y", true)];
      ctx.save();
      ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
      ctx.fillStyle = css("--band"); ctx.strokeStyle = css("--line1"); ctx.lineWidth = 1.5 * devicePixelRatio;
      // the corner where P10 has reached the limit and P90 has not
      const corner = [ahead.late[0], ahead.early[1]];
      ctx.beginPath();
      [ahead.from, ahead.early, corner, ahead.late].forEach((point, k) => (k ? ctx.lineTo(...at(point)) : ctx.moveTo(...at(point))));
      ctx.closePath(); ctx.fill();
      ctx.setLineDash([6 * devicePixelRatio, 4 * devicePixelRatio]);
      ctx.beginPath(); ctx.moveTo(...at(ahead.from)); ctx.lineTo(...at(ahead.middle)); ctx.stroke();
      ctx.restore();
    }

    wear(past_, own, joint, tiers, now, limit, id = "wear", height = 260) {
      const times = past_.t;
      if (!times.length || !own) return this.empty(id, t("No replay has been assessed yet."));
      const percent = own.wear.map((w) => (w == null ? null : 100 * w));
      const side = (sign) => own.wear.map((w, k) => (w == null ? null : 100 * (w + sign * 2 * own.wear_std[k])));
      // the change that each replay shows by itself, relative to the unworn friction of its day; null where an old history lacks it
      const alone = own.wear.map((w, k) => {
        const one = own.replay_torque_nm[k], all = own.reference_torque_nm[k];
        return w == null || one == null || !all ? null : 100 * ((one * (1 + w)) / all - 1);
      });
      const reach = alone.map((a, k) => (a == null ? null : (2 * (100 + a) * own.replay_torque_std_nm[k]) / own.replay_torque_nm[k]));
      const missing = alone.filter((a, k) => a == null && own.wear[k] != null).length;
      const ends = [1, -1].map((sign) => side(sign).concat(alone.map((a, k) => (a == null ? null : a + sign * reach[k]))).filter((x) => x != null));
      const ahead = renewed(joint) ? null : this.ahead(times, own, now, limit);
      const top = ends[0].reduce((a, b) => Math.max(a, b), ahead ? Math.max(6, ahead.early[1]) : 6), low = ends[1].reduce((a, b) => Math.min(a, b), -3);
      const marks = (past_.marks || []).filter((mark) => mark.joint == null || mark.joint === joint).map((mark) => ({ ...mark, text: t(mark.text) }));
      const levels = { hooks: { draw: [(u) => { this.marks(u, marks); this.levels(u, tiers.map(({ name, rise, state }) => [100 * rise, `${t(name)} ${number(100 * rise, 100 * rise % 1 ? 1 : 0)} %`, state === "FAILURE" ? "--fail" : "--maint"])); }] } };
      const told = (u, k) => [days(u.data[0][k] * 1000), percent[k] == null ? null : t("estimate {figure} %", { figure: signed(percent[k]) }), alone[k] == null ? null : t("this replay {figure} %", { figure: signed(alone[k]) })].filter(Boolean).join(" · ");
      this.draw(id, {
        scales: { y: { range: [low * 1.1, top * 1.12] }, ...(times.length > 1 ? {} : { x: { range: [times[0] - DAY, times[0] + DAY] } }) },
        axes: axes("", t("change [%]"), dated),
        plugins: [levels, this.readout(id, told), ...(ahead ? [{ hooks: { drawAxes: [(u) => this.fan(u, ahead)] } }] : []), { hooks: { drawSeries: [(u, series) => { if (series === 4) this.intervals(u, alone, reach); }] } }],
        bands: [{ series: [2, 3], fill: css("--band") }],
        series: [
          {}, { stroke: css("--line1"), width: 2, points: { show: false } }, { stroke: "transparent", points: { show: false } },
          { stroke: "transparent", points: { show: false } },
          { stroke: css("--line2"), paths: () => null, points: { show: true, size: times.length > 300 || height < 200 ? 3 : 6, fill: css("--line2") } },
        ],
      }, [times, percent, side(1), side(-1), alone].map((column, k) => (ahead ? [...column, k ? null : ahead.until] : column)), height);
      const place = document.getElementById(id);
      if (id === "wear") {
        const lines = [t("Line: the estimate from all replays, ± 2σ. Points: each replay by itself, ± 2σ."), ahead ? t("Fan: to the limit, from the earliest to the latest likely day.") : "",
          missing ? t("Of {count} replays drawn, the history keeps the estimate only: no point of their own.", { count: missing }) : ""];
        const note = document.createElement("p");
        note.className = "dim small";
        note.textContent = lines.filter(Boolean).join(" ");
        place.append(note);
      }
      const last = percent[percent.length - 1];
      const text = t("{joint}: {count} replays shown, friction now {figure} % above the beginning", { joint: jointName(joint), count: times.length, figure: number(last ?? 0, 1) });
      const happened = marks.map((mark) => `; ${t("{what} on {day}", { what: mark.text, day: days(1000 * mark.t) })}`).join("");
      place.setAttribute("aria-label", text + happened + (ahead ? `; ${t("limit {days} days after the last replay", { days: number(now.remaining_life.p50_days, 0) })}` : ""));
    }

    // what happened to the joint: greased, replaced, another tool
    marks(u, marks) {
      const { ctx, bbox } = u, dpr = devicePixelRatio, ends = [];
      ctx.save();
      ctx.font = `${11 * dpr}px system-ui, sans-serif`; ctx.textBaseline = "bottom";
      ctx.strokeStyle = ctx.fillStyle = css("--ink");
      for (const mark of marks) {
        const x = Math.round(u.valToPos(mark.t, "x", true));
        if (x < bbox.left || x > bbox.left + bbox.width) continue;
        ctx.globalAlpha = 0.55; ctx.lineWidth = dpr; ctx.setLineDash([2 * dpr, 3 * dpr]);
        ctx.beginPath(); ctx.moveTo(x, bbox.top); ctx.lineTo(x, bbox.top + bbox.height); ctx.stroke();
        ctx.globalAlpha = 1;
        const width = ctx.measureText(mark.text).width, right = x + width + 8 * dpr > bbox.left + bbox.width;
        const from = right ? x - width - 5 * dpr : x + 5 * dpr;
        let row = 0;
        while (ends[row] > from - 6 * dpr) row++;  // labels of near marks go below each other
        ends[row] = from + width;
        ctx.fillText(mark.text, from, bbox.top + bbox.height - (2 + 14 * row) * dpr);  // below, where no limit is written
      }
      ctx.restore();
    }

    intervals(u, middles, reaches) {
      const { ctx } = u;
      ctx.save();
      ctx.strokeStyle = css("--line2"); ctx.globalAlpha = 0.45; ctx.lineWidth = devicePixelRatio;
      ctx.beginPath();
      middles.forEach((middle, k) => {
        if (middle == null || reaches[k] == null) return;
        const x = Math.round(u.valToPos(u.data[0][k], "x", true));
        ctx.moveTo(x, u.valToPos(middle + reaches[k], "y", true)); ctx.lineTo(x, u.valToPos(middle - reaches[k], "y", true));
      });
      ctx.stroke();
      ctx.restore();
    }

    levels(u, all) {
      const { ctx, bbox } = u;
      ctx.save();
      ctx.textAlign = "left"; ctx.textBaseline = "alphabetic";
      ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
      for (const [value, text, colour] of all) {
        const y = u.valToPos(value, "y", true);
        if (y < bbox.top || y > bbox.top + bbox.height) continue;
        ctx.strokeStyle = ctx.fillStyle = css(colour);
        ctx.setLineDash([5 * devicePixelRatio, 4 * devicePixelRatio]);
        ctx.lineWidth = devicePixelRatio;
        ctx.beginPath(); ctx.moveTo(bbox.left, y); ctx.lineTo(bbox.left + bbox.width, y); ctx.stroke();
        ctx.fillText(text, bbox.left + 6 * devicePixelRatio, y - 4 * devicePixelRatio);
      }
      ctx.restore();
    }

    law(own, model, joint) {
      if (!own) return this.empty("law", t("No replay has been assessed yet."));
      const points = own.temperature_c.map((t, k) => [t, own.viscous_nm_s_per_rad[k] / (1 + (own.wear[k] || 0))])
        .filter(([t, fv]) => t != null && Number.isFinite(fv));
      if (!points.length) return this.empty("law", t("No joint temperature has been measured yet."));
      const line = model && model.viscous, j = joint - 1;
      const known = line && line.intercept[j] != null, T0 = known && line.reference_c[j];
      const law = known ? lawOf(line, j) : () => [null, null], at = (t) => law(t)[0], std = (t) => law(t)[1];
      const T = points.map(([t]) => t), low = Math.min(...T, 1) - 1, high = Math.max(...T, 49) + 1;  // the working range: what lies outside the law is missing
      const rows = points.map(([t, fv]) => [t, fv]).concat(Array.from({ length: 51 }, (_, k) => [low + ((high - low) * k) / 50, null]));
      rows.sort((a, b) => a[0] - b[0]);
      const x = rows.map((row) => row[0]);
      const within = (t) => !known || line.range_c[j][0] == null || (t >= line.range_c[j][0] - line.margin_k && t <= line.range_c[j][1] + line.margin_k);
      this.draw("law", {
        scales: { x: { time: false } },
        axes: axes(t("joint temperature [°C]"), "fv [N·m·s/rad]"),
        bands: [{ series: [3, 4], fill: css("--band") }],
        plugins: [this.readout("law", (u, k) => [`${number(x[k], 1)} °C`, rows[k][1] == null ? null : t("replay {figure}", { figure: number(rows[k][1], 2) }), known ? t("law {figure}", { figure: number(at(x[k]), 2) }) : null].filter(Boolean).join(" · "))],
        series: [
          {}, { stroke: css("--line2"), paths: () => null, points: { show: true, size: 6, fill: css("--line2") } },
          { stroke: css("--line1"), width: 2, points: { show: false } }, { stroke: "transparent", points: { show: false } },
          { stroke: "transparent", points: { show: false } },
        ],
      }, [x, rows.map((row) => row[1]), x.map((t) => (within(t) ? at(t) : null)),
        x.map((t) => (known ? at(t) + 2 * std(t) : null)), x.map((t) => (known ? at(t) - 2 * std(t) : null))]);
      document.getElementById("law").setAttribute("aria-label", known
        ? t("{joint}: viscous friction {figure} at {temperature} °C, {slope} % per kelvin", { joint: jointName(joint), figure: number(at(T0), 2), temperature: number(T0, 1), slope: number((100 * (at(T0 + 0.5) - at(T0 - 0.5))) / at(T0), 2) })
        : t("{joint}: no law yet", { joint: jointName(joint) }));
    }

    // the arm is no longer received: past samples must not look like present ones
    still(text) { this.live = []; this.shown(true); this.empty("torque", text); this.quiet = text; document.getElementById("torque").setAttribute("aria-label", text); }

    sample(document_) {
      const at = Date.now() / 1000;
      this.live.push({ ...document_, at });
      while (this.live.length && this.live[0].at < at - SECONDS) this.live.shift();
    }

    shown(whether) { this.stands = !whether; document.getElementById("torque-figure").hidden = !whether; }

    // at standstill, torque holds the arm and says nothing of friction
    standsStill(all) {
      const first = all[0].q_rad;
      return all.every((one) => one.q_rad.every((q, k) => Math.abs(q - first[k]) < STILL_RAD));
    }

    torque(joint) {
      const j = joint - 1, all = this.live;
      if (!all.length) return this.empty("torque", this.quiet || t("Nothing is heard of the arm, or no replay has been assessed yet."));
      this.shown(!this.standsStill(all));
      if (this.stands) return;
      const x = all.map((one) => one.at), predicted = all.map((one) => one.predicted_nm[j]);
      const measured = all.map((one) => (one.measured_nm ? one.measured_nm[j] : null));
      const side = (sign) => all.map((one, k) => (one.std_nm[j] == null ? predicted[k] : predicted[k] + sign * 2 * one.std_nm[j]));
      const data = [x, predicted, measured, side(1), side(-1)];
      const plot = this.plots.torque;
      if (plot && plot.joint === joint) plot.setData(data);
      else {
        this.draw("torque", {
          scales: { x: { range: (_, low, high) => [high - SECONDS, high] }, y: { range: (_, low, high) => { const room = Math.max(0.15 * (high - low), 0.3); return [low - room, high + room]; } } },
          axes: axes("", t("torque [N·m]"), clocked),
          bands: [{ series: [3, 4], fill: css("--band") }],
          series: [{}, { stroke: css("--line1"), width: 2, points: { show: false } }, { stroke: css("--line2"), width: 1.5, points: { show: false } },
            { stroke: "transparent", points: { show: false } }, { stroke: "transparent", points: { show: false } }],
        }, data);
        this.plots.torque.joint = joint;
        const key = document.createElement("p");
        key.className = "dim small key";
        for (const [name, text] of [["line1", t("predicted, ± 2σ")], ["line2", t("measured")]]) {
          const mark = document.createElement("i");
          mark.className = name;
          key.append(mark, ` ${text}  `);
        }
        document.getElementById("torque").append(key);
      }
      const last = all[all.length - 1];
      document.getElementById("torque").setAttribute("aria-label",
        t("{joint}: predicted {predicted} N·m, measured {measured} N·m", { joint: jointName(joint), predicted: number(last.predicted_nm[j], 1), measured: last.measured_nm ? number(last.measured_nm[j], 1) : "–" }));
    }

    again() { for (const id of Object.keys(this.plots)) { this.plots[id].destroy(); delete this.plots[id]; } }
  };
})();
