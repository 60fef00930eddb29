// The player: moves marks over the plan and the error curves of one recording. No library, nothing from outside the page.
"use strict";
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const NOTHING = 65535, BEYOND = 65534; // of testbed/report/player.py
  const LIT = 0.12; // s: how long a read's line stays
  const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8, 16];
  const STATUS = ["ok", "coasting", "lost"];
  const STEP = 0.1, STRIDE = 1.0; // s: arrow keys, with shift
  const CALM = 0.5; // s between two pictures where people want no motion

  // ------------------------------------------------------------ data

  function column(packed) {
    const raw = Uint8Array.from(atob(packed.d), (c) => c.charCodeAt(0));
    const view = new DataView(raw.buffer);
    const wide = packed.k === "f4" ? 4 : 2;
    const out = new Float64Array(raw.length / wide);
    for (let i = 0; i < out.length; i++) {
      const n = wide === 4 ? view.getFloat32(4 * i, true) : view.getUint16(2 * i, true);
      out[i] = wide === 4 ? n : n === NOTHING ? NaN : n === BEYOND ? Infinity : packed.o + packed.s * n;
    }
    return out;
  }

  function times(t) {
    return t.list ? column(t.list) : Float64Array.from({ length: t.n }, (_, i) => t.first + t.step * i);
  }

  /** Index of the last entry at or before t, -1 before the first. Times are rounded: a hair early counts. */
  function before(list, t) {
    let low = 0, high = list.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (list[middle] <= t + 1e-9) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  /** Value at t on the straight line between neighbours; at the nearer side's own value where the other has none. */
  function between(list, values, t) {
    const k = Math.max(0, before(list, t));
    if (k + 1 >= list.length || !Number.isFinite(values[k]) || !Number.isFinite(values[k + 1])) return values[k];
    const share = Math.min(1, Math.max(0, (t - list[k]) / (list[k + 1] - list[k])));
    return values[k] + share * (values[k + 1] - values[k]);
  }

  function turning(list, values, t) {
    const k = Math.max(0, before(list, t));
    if (k + 1 >= list.length) return values[k];
    const share = Math.min(1, Math.max(0, (t - list[k]) / (list[k + 1] - list[k])));
    const step = Math.atan2(Math.sin(values[k + 1] - values[k]), Math.cos(values[k + 1] - values[k]));
    return values[k] + share * step;
  }

  const holder = document.getElementById("player-data");
  const root = document.getElementById("player");
  if (!holder || !root) return;
  const data = JSON.parse(holder.textContent);
  const unpack = (thing, names) => {
    const out = { ...thing, t: times(thing.t) };
    for (const name of names) out[name] = column(thing[name]);
    return out;
  };
  const targets = data.targets.map((one) => unpack(one, ["x", "y"]));
  const bodies = data.bodies.map((one) => unpack(one, ["x", "y", "yaw"]));
  const estimators = data.estimators.map((one) => ({
    ...one,
    targets: one.targets.map((line) => {
      if (!line) return null;
      const cloud = line.cloud && { n: line.cloud.n, t: column(line.cloud.t), x: column(line.cloud.x), y: column(line.cloud.y) };
      return { ...unpack(line, ["x", "y", "a", "b", "angle", "error"]), cloud };
    }),
  }));
  const reads = { t: column(data.reads.t), antenna: column(data.reads.antenna), tag: column(data.reads.tag) };
  const wanted = new Set(data.wanted);

  // ------------------------------------------------------------ places on the page

  const planU = (x) => data.plan.u[0] + data.plan.u[1] * x;
  const planV = (y) => data.plan.v[0] + data.plan.v[1] * y;
  const scale = Math.abs(data.plan.u[1]);

  function bodyAt(i, t) {
    const b = bodies[i];
    return { x: between(b.t, b.x, t), y: between(b.t, b.y, t), yaw: turning(b.t, b.yaw, t) };
  }

  /** Where an antenna or a tag [id, body, x, y] is, m. */
  function endAt(end, t) {
    if (end[1] < 0) return [end[2], end[3]];
    const b = bodyAt(end[1], t), c = Math.cos(b.yaw), s = Math.sin(b.yaw);
    return [b.x + c * end[2] - s * end[3], b.y + s * end[2] + c * end[3]];
  }

  function make(name, attributes, parent) {
    const element = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    if (parent) parent.appendChild(element);
    return element;
  }

  const MARKS = {
    o: (r) => `M ${-r} 0 A ${r} ${r} 0 1 0 ${r} 0 A ${r} ${r} 0 1 0 ${-r} 0 Z`,
    s: (r) => `M ${-r} ${-r} H ${r} V ${r} H ${-r} Z`,
    "^": (r) => `M 0 ${-1.2 * r} L ${1.15 * r} ${r} H ${-1.15 * r} Z`,
    v: (r) => `M 0 ${1.2 * r} L ${1.15 * r} ${-r} H ${-1.15 * r} Z`,
    D: (r) => `M 0 ${-1.3 * r} L ${1.3 * r} 0 L 0 ${1.3 * r} L ${-1.3 * r} 0 Z`,
    P: (r) => `M ${-r / 2} ${-r} h ${r} v ${r / 2} h ${r / 2} v ${r} h ${-r / 2} v ${r / 2} h ${-r} v ${-r / 2} h ${-r / 2} v ${-r} h ${r / 2} Z`,
  };

  function overlay(figure, boxes, name) {
    const svg = document.getElementById(figure);
    const clip = make("clipPath", { id: `${figure}-${name}` }, make("defs", {}, svg));
    for (const [left, top, right, bottom] of boxes) make("rect", { x: left, y: top, width: right - left, height: bottom - top }, clip);
    return { svg, layer: make("g", { class: "live-layer", "clip-path": `url(#${figure}-${name})` }, svg) };
  }

  const plan = overlay(data.plan.figure, [data.plan.box], "inside");
  const drawn = {
    other: make("path", { class: "link other" }, plan.layer),
    link: make("path", { class: "link" }, plan.layer),
    carried: make("path", { class: "carried" }, plan.layer),
    bodies: bodies.map(() => make("path", { class: "body" }, plan.layer)),
    lines: estimators.map((e) =>
      targets.map((_, k) => {
        const group = make("g", { class: "estimate", "data-estimator": e.id, "data-target": k, style: `color: ${e.colour}` }, plan.layer);
        return {
          group,
          cloud: make("path", { class: "cloud" }, group),
          ring: make("ellipse", { class: "ring" }, group),
          mark: make("path", { class: "mark", d: (MARKS[e.marker] || MARKS.o)(4) }, group),
        };
      }),
    ),
  };

  drawn.truth = targets.map((_, k) => make("path", { class: "truth", "data-target": k, d: MARKS.o(3.4) }, plan.layer)); // over all others

  const panels = data.errors ? data.errors.panels : [];
  const curves = data.errors ? overlay(data.errors.figure, panels.map((p) => p.box), "inside") : null;
  const cursors = panels.map((panel, k) => ({
    line: make("path", { class: "cursor" }, curves.layer),
    dots: estimators.map((e) =>
      make("path", { class: "mark", "data-estimator": e.id, d: (MARKS[e.marker] || MARKS.o)(3.4), style: `color: ${e.colour}` }, curves.layer),
    ),
  }));

  // ------------------------------------------------------------ a picture

  const show = { truth: true, links: true, others: false };
  estimators.forEach((e) => (show[e.id] = true));
  let now = 0, speed = 1, playing = false, lit = [];

  const put = (element, x, y) => element.setAttribute("transform", `translate(${x.toFixed(3)} ${y.toFixed(3)})`);
  const visible = (element, is) => (is ? element.removeAttribute("display") : element.setAttribute("display", "none"));

  /** What an estimator says of a target at t; x and y are null where it says nothing. */
  function estimateAt(e, k, t) {
    const line = e.targets[k];
    if (!line) return { x: null, y: null, error: null, status: "no track" };
    const i = Math.max(0, before(line.t, t));
    const status = STATUS[Number(line.status[i])] || "ok";
    const x = between(line.t, line.x, t), y = between(line.t, line.y, t);
    const error = between(line.t, line.error, t);
    const there = Number.isFinite(x) && Number.isFinite(y);
    const said = there || status === "lost" ? status : Number.isNaN(line.x[i]) ? "no estimate" : "far off the plan";
    return { x: there ? x : null, y: there ? y : null, error: Number.isNaN(error) ? null : error, status: said, index: i };
  }

  function drawEstimates(t) {
    estimators.forEach((e, i) =>
      targets.forEach((_, k) => {
        const at = estimateAt(e, k, t), { group, cloud, ring, mark } = drawn.lines[i][k];
        visible(group, show[e.id] && at.x !== null);
        if (at.x === null) return;
        put(mark, planU(at.x), planV(at.y));
        mark.setAttribute("class", `mark ${at.status}`);
        const line = e.targets[k], particles = line.cloud;
        visible(cloud, Boolean(particles));
        if (particles) cloud.setAttribute("d", cloudPath(particles, t));
        const a = line.a[at.index], b = line.b[at.index];
        const has = !particles && Number.isFinite(a) && Number.isFinite(b);
        visible(ring, has);
        if (!has) return;
        ring.setAttribute("rx", (a * scale).toFixed(2));
        ring.setAttribute("ry", (b * scale).toFixed(2));
        const turn = (-line.angle[at.index] * 180) / Math.PI; // the page's y points down
        ring.setAttribute("transform", `translate(${planU(at.x).toFixed(2)} ${planV(at.y).toFixed(2)}) rotate(${turn.toFixed(2)})`);
      }),
    );
  }

  function cloudPath(cloud, t) {
    const k = Math.max(0, before(cloud.t, t)) * cloud.n;
    let path = "";
    for (let i = k; i < k + cloud.n; i++) {
      if (Number.isFinite(cloud.x[i]) && Number.isFinite(cloud.y[i])) path += `M${planU(cloud.x[i]).toFixed(1)} ${planV(cloud.y[i]).toFixed(1)}h0`;
    }
    return path;
  }

  function drawLinks(t) {
    const pairs = new Map();
    for (let i = before(reads.t, t); i >= 0 && reads.t[i] > t - LIT; i--) pairs.set(`${reads.antenna[i]} ${reads.tag[i]}`, i);
    const paths = { link: "", other: "" };
    lit = [];
    for (const i of pairs.values()) {
      const antenna = data.antennas[reads.antenna[i]], tag = data.tags[reads.tag[i]];
      if (!antenna || !tag) continue;
      const mine = wanted.has(reads.tag[i]);
      if (!mine && !show.others) continue;
      const [ax, ay] = endAt(antenna, t), [tx, ty] = endAt(tag, t);
      paths[mine ? "link" : "other"] += `M${planU(ax).toFixed(2)} ${planV(ay).toFixed(2)}L${planU(tx).toFixed(2)} ${planV(ty).toFixed(2)}`;
      lit.push({ antenna: antenna[0], tag: tag[0] });
    }
    drawn.link.setAttribute("d", paths.link);
    drawn.other.setAttribute("d", paths.other);
    visible(drawn.link, show.links);
    visible(drawn.other, show.links && show.others);
  }

  function drawBodies(t) {
    bodies.forEach((body, i) => {
      const at = bodyAt(i, t), c = Math.cos(at.yaw), s = Math.sin(at.yaw);
      const corners = body.outline.map(([x, y]) => `${planU(at.x + c * x - s * y).toFixed(2)} ${planV(at.y + s * x + c * y).toFixed(2)}`);
      drawn.bodies[i].setAttribute("d", corners.length && Number.isFinite(at.x) ? `M${corners.join("L")}Z` : "");
    });
    const carried = data.antennas.filter((a) => a[1] >= 0).map((a) => endAt(a, t));
    drawn.carried.setAttribute("d", carried.map(([x, y]) => `M${planU(x).toFixed(2)} ${planV(y).toFixed(2)}h0`).join(""));
    targets.forEach((target, k) => {
      const x = between(target.t, target.x, t), y = between(target.t, target.y, t);
      visible(drawn.truth[k], show.truth && Number.isFinite(x) && Number.isFinite(y));
      if (Number.isFinite(x) && Number.isFinite(y)) put(drawn.truth[k], planU(x), planV(y));
    });
  }

  function drawCursors(t) {
    cursors.forEach(({ line, dots }, k) => {
      const panel = panels[k], u = panel.u[0] + panel.u[1] * t;
      line.setAttribute("d", `M${u.toFixed(2)} ${panel.box[1]}V${panel.box[3]}`);
      estimators.forEach((e, i) => {
        const { error } = estimateAt(e, k, t);
        const there = show[e.id] && error !== null && (!panel.log || error > 0);
        visible(dots[i], there);
        if (there) put(dots[i], u, panel.v[0] + panel.v[1] * (panel.log ? Math.log10(error) : error));
      });
    });
  }

  // ------------------------------------------------------------ controls

  const part = (name) => root.querySelector(`[data-part="${name}"]`);
  const button = part("play"), slider = part("time"), clock = part("clock"), rate = part("speed"), readout = part("readout"), told = part("told");
  const seconds = (t) => `${t.toFixed(2)} s`;

  function drawReadout(t) {
    let row = 0;
    estimators.forEach((e) =>
      targets.forEach((_, k) => {
        const at = estimateAt(e, k, t), cells = readout.rows[row++].cells;
        cells[cells.length - 2].textContent = at.error === null ? "–" : `${at.error < 10 ? at.error.toFixed(2) : at.error.toPrecision(3)} m`;
        cells[cells.length - 1].textContent = at.status;
      }),
    );
  }

  /** What a guided person was told last, as they read it. */
  function instruction(t) {
    return data.told ? data.told.text[before(data.told.t, t)] || "" : "";
  }

  function draw() {
    drawLinks(now);
    drawBodies(now);
    drawEstimates(now);
    drawCursors(now);
    drawReadout(now);
    if (told) told.textContent = instruction(now);
    slider.value = now;
    slider.setAttribute("aria-valuetext", seconds(now));
    clock.textContent = `${seconds(now)} of ${seconds(data.duration)}`;
  }

  function seek(t) {
    now = Math.min(data.duration, Math.max(0, Number(t) || 0));
    live();
    draw();
  }

  /** From the first touch on, what moves stands out from what is drawn for the whole recording. */
  function live() {
    plan.svg.classList.add("live");
  }

  let last = null, wait = 0;
  function frame(stamp) {
    if (!playing) return;
    if (last !== null) {
      const passed = Math.min(0.25, (stamp - last) / 1000);
      wait += passed;
      const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
      if (!calm || wait >= CALM) {
        const to = now + wait * speed;
        wait = 0;
        seek(to);
        if (to >= data.duration) pause();
      }
    }
    last = stamp;
    if (playing) window.requestAnimationFrame(frame);
  }

  function play() {
    if (now >= data.duration) now = 0;
    playing = true;
    last = null;
    wait = 0;
    button.textContent = "Pause";
    live();
    window.requestAnimationFrame(frame);
  }

  function pause() {
    playing = false;
    button.textContent = "Play";
  }

  function setSpeed(value) {
    speed = SPEEDS.reduce((best, s) => (Math.abs(s - value) < Math.abs(best - value) ? s : best));
    rate.value = String(speed);
  }

  function faster(step) {
    setSpeed(SPEEDS[Math.min(SPEEDS.length - 1, Math.max(0, SPEEDS.indexOf(speed) + step))]);
  }

  function toggle(name, is) {
    show[name] = is;
    const e = estimators.find((one) => one.id === name);
    for (const figure of [plan.svg, curves && curves.svg]) {
      if (!figure) continue;
      const layers = e ? [`e${e.layer}`, `b${e.layer}`] : name === "truth" ? ["truth"] : [];
      for (const layer of layers) figure.querySelectorAll(`[data-layer="${layer}"]`).forEach((g) => g.classList.toggle("off", !is));
    }
    draw();
  }

  function pressed(event) {
    const kind = event.target.tagName;
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = event.shiftKey ? STRIDE : STEP;
    const actions = {
      " ": () => (kind === "BUTTON" || kind === "INPUT" && event.target.type === "checkbox" ? false : playing ? pause() : play()),
      ArrowLeft: () => (kind === "SELECT" ? false : seek(now - step)),
      ArrowRight: () => (kind === "SELECT" ? false : seek(now + step)),
      Home: () => (kind === "SELECT" ? false : seek(0)),
      End: () => (kind === "SELECT" ? false : seek(data.duration)),
      "+": () => faster(1),
      "=": () => faster(1),
      "-": () => faster(-1),
    };
    const act = actions[event.key];
    if (act && act() !== false) event.preventDefault(); // not false: the key was ours
  }

  /** A click on the error curves goes to that time. */
  function clicked(event) {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(curves.svg.getScreenCTM().inverse());
    const panel = panels[0];
    if (at.x >= panel.box[0] && at.x <= panel.box[2]) seek((at.x - panel.u[0]) / panel.u[1]);
  }

  for (const s of SPEEDS) rate.add(new Option(`${s} ×`, String(s), s === 1, s === 1));
  slider.max = data.duration;
  button.addEventListener("click", () => (playing ? pause() : play()));
  slider.addEventListener("input", () => seek(slider.value));
  rate.addEventListener("change", () => setSpeed(Number(rate.value)));
  root.querySelectorAll("input[data-show]").forEach((box) => box.addEventListener("change", () => toggle(box.dataset.show, box.checked)));
  root.addEventListener("keydown", pressed);
  if (curves) curves.svg.addEventListener("click", clicked);
  root.querySelectorAll("[data-scripted]").forEach((element) => element.removeAttribute("hidden"));
  for (const figure of [plan.svg, curves && curves.svg]) if (figure) figure.classList.add("ready");
  draw();

  const named = (id) => estimators.find((e) => e.id === id);
  window.testbedPlayer = {
    seek, play, pause, toggle, setSpeed,
    get time() { return now; },
    get playing() { return playing; },
    get speed() { return speed; },
    get duration() { return data.duration; },
    estimators: estimators.map((e) => e.id),
    targets: targets.map((t) => t.name),
    links: () => lit.slice(),
    told: () => instruction(now),
    /** Where an estimator's mark (or that of "truth") is now: x and y in metres, null where it says nothing. */
    position(id, target = 0) {
      if (id === "truth") {
        const one = targets[target];
        return { x: between(one.t, one.x, now), y: between(one.t, one.y, now), error: 0, status: "ok" };
      }
      if (!named(id)) throw new RangeError(`no estimator ${id}`);
      const { x, y, error, status } = estimateAt(named(id), target, now);
      return { x, y, error, status };
    },
  };
})();

// Everything is on paper, what is folded away on the screen as well.
(() => {
  let opened = [];
  window.addEventListener("beforeprint", () => {
    opened = [...document.querySelectorAll("details:not([open])")];
    opened.forEach((one) => (one.open = true));
  });
  window.addEventListener("afterprint", () => opened.forEach((one) => (one.open = false)));
})();
