// A drawing of the arm from its Denavit-Hartenberg parameters, seen from the front and a little above; joints have the colour of their state.
"use strict";
const ArmDrawing = (() => {
  const SVG = "http://www.w3.org/2000/svg";
  const AZIMUTH = (-70 * Math.PI) / 180, ELEVATION = (14 * Math.PI) / 180;
  const times = (A, B) => A.map((row) => B[0].map((_, k) => row.reduce((sum, a, i) => sum + a * B[i][k], 0)));
  const apply = (A, v) => A.map((row) => row.reduce((sum, a, i) => sum + a * v[i], 0));

  // the origin of every frame, and the corner between d and a where both are not zero
  function chain(arm, q) {
    let R = arm.base, p = [0, 0, 0];
    const origins = [p], way = [[p]];
    q.forEach((angle, i) => {
      const c = Math.cos(angle + arm.zero_rad[i]), s = Math.sin(angle + arm.zero_rad[i]);
      R = times(R, [[c, -s, 0], [s, c, 0], [0, 0, 1]]);
      const add = (v) => { const moved = apply(R, v); return p.map((x, k) => x + moved[k]); };
      const corner = add([0, 0, arm.d_m[i]]);
      const part = [p, corner];
      p = add([arm.a_m[i], 0, arm.d_m[i]]);
      part.push(p);
      const ca = Math.cos(arm.alpha_rad[i]), sa = Math.sin(arm.alpha_rad[i]);
      R = times(R, [[1, 0, 0], [0, ca, -sa], [0, sa, ca]]);
      origins.push(p);
      way.push(part);
    });
    return { origins, way };
  }

  const seen = ([x, y, z]) => {
    const across = Math.cos(AZIMUTH) * y - Math.sin(AZIMUTH) * x, depth = Math.cos(AZIMUTH) * x + Math.sin(AZIMUTH) * y;
    return [across, -(Math.cos(ELEVATION) * z - Math.sin(ELEVATION) * depth)];
  };

  function element(name, attributes, parent) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (parent) parent.append(made);
    return made;
  }

  return class {
    constructor(svg, arm, choose) {
      this.svg = svg; this.arm = arm; this.joints = [];
      const reach = arm.a_m.slice(1).concat(arm.d_m.slice(1)).reduce((sum, x) => sum + Math.abs(x), 0);
      const up = arm.base[2][2] >= -0.5 ? 1 : -1;
      this.unit = reach / 100;
      const foot = up > 0 ? [-0.8 * reach, -1.06 * reach - arm.d_m[0]] : [-0.8 * reach, -0.12 * reach];
      svg.setAttribute("viewBox", `${foot[0]} ${foot[1]} ${1.6 * reach} ${1.2 * reach + arm.d_m[0]}`);
      const u = this.unit;
      element("ellipse", { class: "ground", cx: 0, cy: 0, rx: 24 * u, ry: 7 * u, "stroke-width": 0.6 * u }, svg);
      element("rect", { class: "foot", x: -9 * u, y: up > 0 ? -4 * u : 0, width: 18 * u, height: 4 * u, rx: 1.4 * u }, svg);
      this.edges = []; this.links = [];
      const thick = arm.max_torque_nm.map((torque) => (6 + 7.5 * Math.sqrt(torque / Math.max(...arm.max_torque_nm))) * u);
      arm.links.forEach((_, i) => this.edges.push(element("polyline", { class: "edge", "stroke-width": thick[i] + 1.2 * u }, svg)));
      arm.links.forEach((_, i) => this.links.push(element("polyline", { class: "link", "stroke-width": thick[i] }, svg)));
      this.tool = element("circle", { class: "tool", r: 2 * u }, svg);
      arm.links.forEach((_, i) => {
        const group = element("g", { class: "joint", role: "button", tabindex: "0", "data-state": "null" }, svg);
        element("circle", { r: 5.6 * u, "stroke-width": 0.9 * u }, group);
        element("circle", { class: "ring", r: 7.2 * u, "stroke-width": 1.1 * u }, group);
        element("text", { "font-size": 6.6 * u }, group).textContent = String(i + 1);
        group.addEventListener("click", () => choose(i + 1));
        group.addEventListener("keydown", (event) => {
          if (event.key === "Enter" || event.key === " ") { event.preventDefault(); choose(i + 1); }
        });
        this.joints.push(group);
      });
      this.pose([0, -Math.PI / 2 - 0.25, 1.1, -0.9, -Math.PI / 2, 0].slice(0, arm.links.length));
    }

    pose(q) {
      const { origins, way } = chain(this.arm, q);
      way.slice(1).forEach((part, i) => {
        const points = part.map((point) => seen(point).map((x) => x.toFixed(4)).join(",")).join(" ");
        this.edges[i].setAttribute("points", points);
        this.links[i].setAttribute("points", points);
      });
      // the circles of joints keep a distance, so that a person can read and press them where the wrist folds
      const at = origins.slice(0, -1).map(seen), apart = 11.6 * this.unit;
      for (let round = 0; round < 12; round++)
        for (let i = 0; i < at.length; i++)
          for (let j = i + 1; j < at.length; j++) {
            const d = [at[j][0] - at[i][0], at[j][1] - at[i][1]], far = Math.hypot(...d) || 1e-6;
            if (far >= apart) continue;
            const push = (apart - far) / 2;
            const away = far > 1e-5 ? d.map((x) => x / far) : [1, 0];
            at[j] = [at[j][0] + away[0] * push, at[j][1] + away[1] * push];
            if (i > 0) at[i] = [at[i][0] - away[0] * push, at[i][1] - away[1] * push];
          }
      this.joints.forEach((group, i) => group.setAttribute("transform", `translate(${at[i][0].toFixed(4)} ${at[i][1].toFixed(4)})`));
      const [x, y] = seen(origins[origins.length - 1]);
      this.tool.setAttribute("cx", x); this.tool.setAttribute("cy", y);
    }

    state(joint, state, words, stale) {
      const group = this.joints[joint - 1];
      if (!group) return;
      group.dataset.state = state;
      group.classList.toggle("stale", Boolean(stale));
      group.setAttribute("aria-label", words);
      let title = group.querySelector("title");
      if (!title) title = element("title", {}, group);
      title.textContent = words;
    }

    chosen(joint) { this.joints.forEach((group, i) => group.classList.toggle("on", i + 1 === joint)); }
  };
})();
