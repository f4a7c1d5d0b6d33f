// Three charts of one joint: friction over time with its interval, fv over temperature with its law, live torque.
"use strict";
const Charts = (() => {
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const SECONDS = 60, DAY = 86400;

  function axes(x, y, xValues) {
    const stroke = css("--dim"), grid = { stroke: css("--line"), width: 1 }, ticks = { stroke: css("--line"), width: 1, size: 4 };
    const font = "12px system-ui, sans-serif";
    return [
      { stroke, grid, ticks, font, label: x, labelSize: x ? 18 : 0, labelFont: font, size: x ? 30 : 44, ...(xValues ? { values: xValues } : {}) },
      { stroke, grid, ticks, font, label: y, labelSize: 18, labelFont: font, size: 52 },
    ];
  }

  const plain = (digits, unit = "") => (_, value) => (value == null ? "–" : `${value.toFixed(digits)}${unit}`);

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
      for (const id of ["wear", "law", "torque"]) this.observer.observe(document.getElementById(id));
    }

    draw(id, options, data, height = 220) {
      const place = document.getElementById(id);
      if (this.plots[id]) this.plots[id].destroy();
      place.replaceChildren();
      this.plots[id] = new uPlot({ width: Math.max(place.clientWidth, 200), height, cursor: { y: false }, ...options }, data, place);
      place.setAttribute("role", "img");
    }

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

    wear(times, own, joint, tiers, now, limit) {
      if (!times.length || !own) return this.empty("wear", "No replay has been assessed yet.");
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
      const ahead = this.ahead(times, own, now, limit);
      const top = ends[0].reduce((a, b) => Math.max(a, b), ahead ? Math.max(6, ahead.early[1]) : 6), low = ends[1].reduce((a, b) => Math.min(a, b), -3);
      const levels = { hooks: { draw: [(u) => this.levels(u, tiers.map(({ name, rise, state }) => [100 * rise, `${name} ${+(100 * rise).toFixed(2)} %`, state === "FAILURE" ? "--fail" : "--maint"]))] } };
      this.draw("wear", {
        scales: { y: { range: [low * 1.1, top * 1.12] }, ...(times.length > 1 ? {} : { x: { range: [times[0] - DAY, times[0] + DAY] } }) },
        axes: axes("", "change [%]"),
        plugins: [levels, ...(ahead ? [{ hooks: { drawAxes: [(u) => this.fan(u, ahead)] } }] : []), { hooks: { drawSeries: [(u, series) => { if (series === 4) this.intervals(u, alone, reach); }] } }],
        bands: [{ series: [2, 3], fill: css("--band") }],
        series: [
          {}, { label: "estimate", stroke: css("--line1"), width: 2, points: { show: false }, value: plain(1, " %") },
          { label: "+2σ", stroke: "transparent", points: { show: false }, value: plain(1, " %") },
          { label: "−2σ", stroke: "transparent", points: { show: false }, value: plain(1, " %") },
          { label: "replay", stroke: css("--line2"), paths: () => null, points: { show: true, size: times.length > 300 ? 3 : 6, fill: css("--line2") }, value: plain(1, " %") },
        ],
      }, [times, percent, side(1), side(-1), alone].map((column, k) => (ahead ? [...column, k ? null : ahead.until] : column)), 250);
      if (missing) {
        const note = document.createElement("p");
        note.className = "dim";
        note.textContent = `Of ${missing} replays drawn, the history keeps the estimate only: no point of their own.`;
        document.getElementById("wear").append(note);
      }
      const last = percent.length - 1;
      document.getElementById("wear").setAttribute("aria-label",
        `Joint ${joint}: ${times.length} replays shown, friction now ${percent[last].toFixed(1)} % above the beginning${ahead ? `; limit ${now.remaining_life.p50_days.toFixed(0)} days after the last replay` : ""}`);
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
      if (!own) return this.empty("law", "No replay has been assessed yet.");
      const points = own.temperature_c.map((t, k) => [t, own.viscous_nm_s_per_rad[k] / (1 + (own.wear[k] || 0))])
        .filter(([t, fv]) => t != null && Number.isFinite(fv));
      if (!points.length) return this.empty("law", "No joint temperature has been measured yet.");
      const line = model && model.viscous, j = joint - 1;
      const known = line && line.intercept[j] != null, T0 = known && line.reference_c[j];
      const law = known ? lawOf(line, j) : () => [null, null], at = (t) => law(t)[0], std = (t) => law(t)[1];
      const T = points.map(([t]) => t), low = Math.min(...T) - 1, high = Math.max(...T) + 1;
      const rows = points.map(([t, fv]) => [t, fv]).concat(Array.from({ length: 30 }, (_, k) => [low + ((high - low) * k) / 29, null]));
      rows.sort((a, b) => a[0] - b[0]);
      const x = rows.map((row) => row[0]);
      const within = (t) => !known || line.range_c[j][0] == null || (t >= line.range_c[j][0] - line.margin_k && t <= line.range_c[j][1] + line.margin_k);
      this.draw("law", {
        scales: { x: { time: false } },
        axes: axes("joint temperature [°C]", "fv [Nm·s/rad]"),
        bands: [{ series: [3, 4], fill: css("--band") }],
        series: [
          { label: "T", value: plain(1, " °C") },
          { label: "replay", stroke: css("--line2"), paths: () => null, points: { show: true, size: 6, fill: css("--line2") }, value: plain(3) },
          { label: "law", stroke: css("--line1"), width: 2, points: { show: false }, value: plain(3) },
          { label: "+2σ", stroke: "transparent", points: { show: false }, value: plain(3) },
          { label: "−2σ", stroke: "transparent", points: { show: false }, value: plain(3) },
        ],
      }, [x, rows.map((row) => row[1]), x.map((t) => (within(t) ? at(t) : null)),
        x.map((t) => (known ? at(t) + 2 * std(t) : null)), x.map((t) => (known ? at(t) - 2 * std(t) : null))]);
      document.getElementById("law").setAttribute("aria-label", known
        ? `Joint ${joint}: viscous friction ${at(T0).toFixed(2)} at ${T0.toFixed(1)} °C, ${((100 * (at(T0 + 0.5) - at(T0 - 0.5))) / at(T0)).toFixed(2)} % per kelvin`
        : `Joint ${joint}: no law yet`);
    }

    // the arm is no longer received: past samples must not look like present ones
    still(text) { this.live = []; this.empty("torque", text); this.quiet = text; document.getElementById("torque").setAttribute("aria-label", text); }

    sample(document_) {
      const at = Date.now() / 1000;
      this.live.push({ ...document_, at });
      while (this.live.length && this.live[0].at < at - SECONDS) this.live.shift();
    }

    torque(joint) {
      const j = joint - 1, all = this.live;
      if (!all.length) return this.empty("torque", this.quiet || "Nothing is heard of the arm, or no replay has been assessed yet.");
      const x = all.map((one) => one.at), predicted = all.map((one) => one.predicted_nm[j]);
      const measured = all.map((one) => (one.measured_nm ? one.measured_nm[j] : null));
      const side = (sign) => all.map((one, k) => (one.std_nm[j] == null ? predicted[k] : predicted[k] + sign * 2 * one.std_nm[j]));
      const data = [x, predicted, measured, side(1), side(-1)];
      const plot = this.plots.torque;
      if (plot && plot.joint === joint) plot.setData(data);
      else {
        this.draw("torque", {
          scales: { x: { range: (_, low, high) => [high - SECONDS, high] }, y: { range: (_, low, high) => { const room = Math.max(0.15 * (high - low), 0.3); return [low - room, high + room]; } } },
          axes: axes("", "torque [Nm]"),
          bands: [{ series: [3, 4], fill: css("--band") }],
          series: [{}, { label: "predicted", stroke: css("--line1"), width: 2, points: { show: false }, value: plain(2, " Nm") },
            { label: "measured", stroke: css("--line2"), width: 1.5, points: { show: false }, value: plain(2, " Nm") },
            { label: "+2σ", stroke: "transparent", points: { show: false }, value: plain(2) }, { label: "−2σ", stroke: "transparent", points: { show: false }, value: plain(2) }],
        }, data);
        this.plots.torque.joint = joint;
      }
      const last = all[all.length - 1];
      document.getElementById("torque").setAttribute("aria-label",
        `Joint ${joint}: predicted ${last.predicted_nm[j].toFixed(1)} Nm, measured ${last.measured_nm ? last.measured_nm[j].toFixed(1) : "unknown"} Nm`);
    }

    again() { for (const id of Object.keys(this.plots)) { this.plots[id].destroy(); delete this.plots[id]; } }
  };
})();
