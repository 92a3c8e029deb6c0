// SPDX-License-Identifier: GPL-3.0-or-later
// The page: its controls, its link, its loading, and when it draws.

const element = (id) => document.getElementById(id);
/** Most pixels that are drawn at full size, and how much smaller a picture may be while it moves. */
const MOST_PIXELS = 4e6, LEAST_SCALE = 0.3;
/** Frame times in milliseconds above and below which a moving picture gets smaller or larger. */
const SLOW = 40, FAST = 18;
/** Stops of a light's slider to each side. */
const LIGHT_STOPS = 6;
const KEYS = [
  ["Drag, arrows", "turn"], ["Shift-drag, right button, two fingers", "move sideways"], ["Wheel, pinch", "nearer, farther"],
  ["W A S D, Q E", "walk, down, up (Shift: faster)"], ["[ ] and 1 … 9", "cameras"], ["+ −", "exposure"], ["M", "orbit or walk"],
  ["H", "hide the panel"], ["F", "full screen"], ["R", "as at first"],
];

class Page {
  constructor(facts, planes) {
    this.facts = facts;
    // Kept for a graphics card that forgets everything.
    this.planes = planes;
    this.canvas = element("picture");
    this.drawing = new SplatDrawing(this.canvas, facts, planes);
    this.responses = responses(facts);
    this.walker = new Walker(this.canvas, facts, this.drawing.position, () => this.wake());
    this.sorter = new Sorter(this.drawing.position, (order, serial) => {
      this.drawing.setOrder(order);
      this.sorted = serial;
      this.wake();
    }, () => this.stop("The Gaussians could not be sorted, perhaps for want of memory. Close other pages, and load this one again."));
    this.hdr = this.screen = this.opening = null;
    this.scale = 1;
    this.frameTime = 0;
    this.sorted = this.asked = 0;
    this.askedFor = "";
    this.isAwake = this.isStopped = this.isLost = false;
    this.movedAt = -Infinity;
    this.build();
    this.reset();
    this.follow(location.hash);
    addEventListener("hashchange", () => { this.follow(location.hash); });
    addEventListener("resize", () => this.wake());
    addEventListener("keydown", (event) => this.key(event));
    this.canvas.addEventListener("webglcontextlost", (event) => this.lose(event));
    this.canvas.addEventListener("webglcontextrestored", () => this.restore());
    this.wake();
  }

  // ---- controls ----

  build() {
    const { facts } = this;
    element("title").textContent = facts.title;
    element("about").textContent = facts.about.join(" ");
    facts.cameras.forEach((camera, i) => element("camera").add(new Option(camera.name, String(i))));
    element("camera-row").hidden = facts.cameras.length < 2;
    element("camera").addEventListener("change", (event) => this.goTo(Number(event.target.value), true));
    element("previous").addEventListener("click", () => this.goTo(this.camera - 1, true));
    element("next").addEventListener("click", () => this.goTo(this.camera + 1, true));
    element("move").addEventListener("change", (event) => { this.walker.mode = event.target.value; this.walker.pivot = null; });
    const exposure = element("exposure");
    [exposure.min, exposure.max] = facts.exposure.range;
    exposure.addEventListener("input", () => this.told());
    exposure.addEventListener("dblclick", () => { exposure.value = facts.exposure.start; this.told(); });
    this.lights = facts.lights.map((name, k) => this.light(name, k));
    for (const [name, { title }] of Object.entries(this.responses)) if (title) element("response").add(new Option(title, name));
    element("response").addEventListener("change", () => this.told());
    element("confidence-row").hidden = !facts.confidence;
    element("confidence-row").title = facts.confidence?.meaning ?? "";
    element("confidence").addEventListener("change", () => this.wake());
    const support = hdrSupport();
    element("screen-note").textContent = support.words;
    element("hdr-row").hidden = !support.able;
    element("hdr-on").addEventListener("change", () => this.setHdr());
    element("share").addEventListener("click", () => this.share());
    element("full").addEventListener("click", () => this.fullScreen());
    element("full").hidden = !document.documentElement.requestFullscreen;
    element("reset").addEventListener("click", () => this.reset());
    element("help").addEventListener("click", () => this.help());
    element("fold").addEventListener("click", () => this.fold(true));
    element("unfold").addEventListener("click", () => this.fold(false));
    element("panel").addEventListener("submit", (event) => event.preventDefault());
    const list = document.createElement("dl");
    for (const [keys, what] of KEYS) {
      const term = document.createElement("dt"), told = document.createElement("dd");
      [term.textContent, told.textContent] = [keys, what];
      list.append(term, told);
    }
    element("help-text").append(list);
  }

  /** A light's row: on or off, its slider in stops, and what it says. */
  light(name, k) {
    const row = document.createElement("div"), on = document.createElement("input"), label = document.createElement("label");
    const told = document.createElement("output"), slider = document.createElement("input");
    row.className = "slider";
    Object.assign(on, { type: "checkbox", checked: true, id: `light-${k}-on`, title: "On or off" });
    on.setAttribute("aria-label", `${name}: on`);
    Object.assign(slider, { type: "range", id: `light-${k}`, step: "0.01", value: "0", title: "In stops; double-click: as captured" });
    // Set last: a range's bounds decide what its value may be.
    const levels = this.facts.levels, isBaked = levels.length > 0;
    [slider.min, slider.max] = isBaked ? [Math.log2(levels[0]), Math.log2(levels[levels.length - 1])] : [-LIGHT_STOPS, LIGHT_STOPS];
    slider.value = "0";
    label.htmlFor = slider.id;
    label.textContent = name;
    told.htmlFor = slider.id;
    on.hidden = isBaked;
    on.addEventListener("change", () => this.told());
    slider.addEventListener("input", () => { on.checked = true; this.told(); });
    slider.addEventListener("dblclick", () => { this.setLevel(k, this.facts.standard[k]); this.told(); });
    row.append(on, label, told, slider);
    element("lights").append(row);
    return { on, slider, told };
  }

  levels() { return this.lights.map(({ on, slider }) => on.checked ? 2 ** Number(slider.value) : 0); }

  setLevels(levels) { levels.forEach((level, k) => this.setLevel(k, level)); }

  setLevel(k, level) {
    const { on, slider } = this.lights[k];
    on.checked = this.facts.levels.length > 0 || level !== 0;
    slider.value = level > 0 ? String(Math.log2(level)) : "0";
  }

  /** What the controls say, in words; and draw it. */
  told() {
    const ev = Number(element("exposure").value), seconds = 2 ** ev;
    const time = seconds >= 0.3 ? `${Number(seconds.toPrecision(3))} s` : `1/${Number((1 / seconds).toPrecision(3))} s`;
    element("exposure-value").textContent = `${time} · EV ${ev >= 0 ? "+" : "−"}${Math.abs(ev).toFixed(2)}`;
    this.levels().forEach((level, k) => { this.lights[k].told.textContent = level ? `× ${Number(level.toPrecision(3))}` : "off"; });
    const chosen = element("response").value;
    if (chosen !== this.shown) {
      this.shown = chosen;
      const note = this.responses[chosen].note;
      element("response-note").textContent = note;
      element("response-note").hidden = !note;
    }
    this.wake();
  }

  reset() {
    const { facts } = this;
    element("exposure").value = facts.exposure.start;
    this.setLevels(facts.standard);
    element("response").value = Object.keys(this.responses)[0];
    element("move").value = this.walker.mode = "orbit";
    element("confidence").checked = false;
    this.goTo(0, false);
    this.told();
  }

  goTo(index, flies) {
    const { cameras } = this.facts;
    this.camera = (index + cameras.length) % cameras.length;
    element("camera").value = String(this.camera);
    this.walker.go(viewOf(cameras[this.camera]), flies);
    this.wake();
  }

  fold(isHidden) {
    element("panel").hidden = isHidden;
    element("unfold").hidden = !isHidden;
  }

  help() {
    const text = element("help-text");
    text.hidden = !text.hidden;
    element("help").setAttribute("aria-expanded", String(!text.hidden));
  }

  fullScreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else document.documentElement.requestFullscreen().catch(() => {});
  }

  key(event) {
    // Many keyboards have [ and ] on AltGr, which Windows tells as Ctrl and Alt, or on Option.
    const isBracket = event.altKey && /^[[\]]$/.test(event.key);
    if (event.metaKey || ((event.ctrlKey || event.altKey) && !isBracket) || /^(SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
    if (event.code in MOVES) return; // such a key walks, whatever letter a keyboard has there
    const step = (stops) => { const slider = element("exposure"); slider.value = String(Number(slider.value) + stops); this.told(); };
    const done = {
      "+": () => step(1 / 3), "=": () => step(1 / 3), "-": () => step(-1 / 3), "[": () => this.goTo(this.camera - 1, true),
      "]": () => this.goTo(this.camera + 1, true), h: () => this.bare(), f: () => this.fullScreen(), r: () => this.reset(), "?": () => this.help(),
      m: () => { element("move").value = this.walker.mode = this.walker.mode === "orbit" ? "walk" : "orbit"; this.walker.pivot = null; },
    }[event.key.length === 1 ? event.key.toLowerCase() : ""];
    if (done) done();
    else if (/^[1-9]$/.test(event.key) && this.facts.cameras[Number(event.key) - 1]) this.goTo(Number(event.key) - 1, true);
    else return;
    event.preventDefault();
  }

  /** H: the picture and nothing else, or the panel again. */
  bare() { document.body.classList.toggle("bare"); }

  // ---- a link to what is seen ----

  link() {
    const { eye, axes, lens } = this.walker.view, numbers = (list) => list.map((value) => Number(value.toPrecision(7))).join(",");
    const told = {
      eye: numbers(eye), turn: numbers(quaternionOf(axes)), lens: numbers(lens), ev: element("exposure").value,
      levels: numbers(this.levels()), response: element("response").value, move: this.walker.mode,
    };
    if (element("confidence").checked) told.confidence = "1";
    return `#${Object.entries(told).map(([key, value]) => `${key}=${encodeURIComponent(value)}`).join("&")}`;
  }

  /** Show what a link says; what is no number, or not of this model, is passed over. */
  follow(hash) {
    const told = new URLSearchParams(hash.replace(/^#/, ""));
    const list = (name, length) => {
      const values = (told.get(name) ?? "").split(",").map((text) => text.trim() === "" ? NaN : Number(text));
      return values.length === length && values.every(Number.isFinite) ? values : null;
    };
    const eye = list("eye", 3), turn = list("turn", 4), lens = list("lens", 5), ev = list("ev", 1);
    if (ev) element("exposure").value = String(ev[0]);
    const levels = list("levels", this.lights.length);
    if (levels && levels.every((level) => level >= 0)) this.setLevels(levels);
    if (this.responses[told.get("response")]?.title) element("response").value = told.get("response");
    if (["orbit", "walk"].includes(told.get("move"))) element("move").value = this.walker.mode = told.get("move");
    element("confidence").checked = Boolean(this.facts.confidence) && told.get("confidence") === "1";
    const length = turn ? Math.hypot(...turn) : 0;
    if (eye && length > 1e-3) {
      const lensThere = lens && lens[0] > 0 && lens[1] > 0 && lens[4] > 0 ? lens : this.walker.view.lens;
      this.walker.go(viewOf({ eye, turn: turn.map((value) => value / length), lens: lensThere }), false);
    }
    this.told();
  }

  async share() {
    const url = location.href.replace(/#.*$/, "") + this.link(), field = element("link"), button = element("share");
    history.replaceState(null, "", this.link());
    let copied = false;
    try { await navigator.clipboard.writeText(url); copied = true; } catch { /* not allowed: it is shown instead */ }
    field.hidden = copied;
    field.value = url;
    if (!copied) field.select();
    button.textContent = copied ? "Copied" : "Link below";
    setTimeout(() => { button.textContent = "Copy link"; }, 2000);
  }

  // ---- the HDR screen ----

  /** As the box says, also where it says another thing by the time that the screen is there. */
  async setHdr() {
    const box = element("hdr-on"), note = element("screen-note");
    if (box.checked && !this.screen) {
      try {
        if (!this.drawing.canReadBack()) throw new PageError("this graphics driver does not give half floats back");
        this.opening ??= HdrScreen.on(element("hdr"), () => this.endHdr("the graphics card was reset"));
        this.screen = await this.opening;
      }
      catch (error) {
        this.endHdr(error.message);
        return;
      }
    }
    const isOn = box.checked;
    this.hdr = isOn ? this.screen : null;
    element("hdr").hidden = !isOn;
    note.textContent = isOn ? "High range (HDR): Linear goes beyond white, as far as the screen can." : hdrSupport().words;
    this.wake();
  }

  /** No HDR screen any more, until it is switched on again. */
  endHdr(why) {
    this.screen = this.opening = null;
    element("hdr-on").checked = false;
    this.setHdr();
    element("screen-note").textContent = `Standard range (SDR): ${why}.`;
  }

  // ---- frames ----

  wake() {
    if (this.isStopped) return;
    document.documentElement.dataset.state = "drawing";
    this.movedAt = performance.now();
    if (this.isAwake) return;
    this.isAwake = true;
    this.last = performance.now();
    this.nextFrame();
  }

  frame(now) {
    const elapsed = Math.max(now - this.last, 0);
    this.last = now;
    const moves = this.walker.step(Math.min(elapsed, 100) / 1000, now) || this.walker.pointers.size > 0;
    if (moves) {
      this.movedAt = now;
      this.frameTime = this.frameTime ? 0.8 * this.frameTime + 0.2 * elapsed : elapsed;
      if (this.frameTime > SLOW) this.scale = Math.max(this.scale * Math.max(Math.sqrt(SLOW / this.frameTime), 0.6), LEAST_SCALE);
      else if (this.frameTime < FAST) this.scale = Math.min(this.scale * 1.05, 1);
      document.documentElement.dataset.frameTime = this.frameTime.toFixed(1);
    } else this.frameTime = 0;
    this.sort();
    const rests = !moves && now - this.movedAt > 120;
    if (this.sorted) this.draw(rests || !moves ? 1 : this.scale);
    if (rests && this.sorted === this.asked && this.sorted) {
      this.isAwake = false;
      document.documentElement.dataset.state = "settled";
      element("cover").classList.add("done");
      return;
    }
    this.nextFrame();
  }

  nextFrame() { this.next = requestAnimationFrame((now) => this.frame(now)); }

  // ---- what ends it ----

  /** Draw no more, and say why. */
  stop(message, isLost = false) {
    cancelAnimationFrame(this.next);
    this.isAwake = false;
    this.isStopped = true;
    this.isLost = isLost;
    fail(message);
  }

  /** The browser has taken the graphics card away, as phones do with a page in the background. */
  lose(event) {
    // Otherwise it would never be given back.
    event.preventDefault();
    if (this.isStopped && !this.isLost) return;
    this.stop("The graphics card was reset. The picture comes back when the browser may use it again; if it does not, load this page again.", true);
  }

  /** It is given back, and has forgotten everything. */
  restore() {
    if (!this.isLost) return;
    try { this.drawing = new SplatDrawing(this.canvas, this.facts, this.planes); }
    catch (error) {
      // Taken away once more meanwhile, it is given back once more.
      if (!this.drawing.gl.isContextLost()) this.stop(wordsOf(error));
      return;
    }
    this.walker.position = this.drawing.position;
    this.sorted = 0;
    this.askedFor = this.drawn = "";
    this.isStopped = this.isLost = false;
    element("loading").classList.remove("failed");
    element("loading-text").textContent = "Preparing…";
    this.wake();
  }

  /** Ask for the order of this view, where it is another one than that asked for last. */
  sort() {
    const { eye, axes } = this.walker.view, ahead = times(axes[2], -1), of = JSON.stringify([eye, ahead]);
    if (of === this.askedFor) return;
    if (this.sorter.ask(ahead, dot(ahead, eye), this.asked + 1)) {
      this.asked += 1;
      this.askedFor = of;
    }
  }

  draw(scale) {
    const { canvas } = this, ratio = devicePixelRatio || 1;
    let width = Math.max(1, Math.round(canvas.clientWidth * ratio)), height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    const shrink = Math.min(1, Math.sqrt(MOST_PIXELS / (width * height)));
    [width, height] = [Math.max(1, Math.round(width * shrink)), Math.max(1, Math.round(height * shrink))];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const w = Math.max(1, Math.round(width * scale)), h = Math.max(1, Math.round(height * scale));
    const look = { exposure: 2 ** Number(element("exposure").value), levels: this.levels(), confidence: element("confidence").checked };
    const response = this.responses[look.confidence ? "confidence" : this.shown];
    // Linear needs no curve, which would end at white.
    const tone = response === this.responses.linear && this.hdr ? { ...response, form: 2 } : response;
    const of = JSON.stringify([this.walker.view, width, height, w, h, look, this.shown, this.sorted, Boolean(this.hdr)]);
    if (of === this.drawn) return;
    this.drawn = of;
    this.drawing.setCurve(response);
    const halves = this.drawing.draw(projected(this.walker.view, w, h), w, h, look, tone, Boolean(this.hdr));
    this.hdr?.show(halves, width, height);
  }
}

const wordsOf = (error) => error instanceof PageError ? error.message : `Something went wrong: ${error.message}`;

/** Say why nothing is shown. */
function fail(message) {
  element("cover").classList.remove("done");
  element("loading").classList.add("failed");
  element("loading-text").textContent = message;
  document.documentElement.dataset.state = "failed";
}

async function start(facts) {
  element("poster").style.backgroundImage = facts.poster ? `url(${facts.poster})` : "";
  const bytes = facts.parts.reduce((sum, { size }) => sum + size, 0), megabytes = (bytes / 1e6).toFixed(1);
  try {
    const planes = await loadPlanes(facts, (done) => {
      element("loading-bar").value = done;
      element("loading-text").textContent = `Loading ${(done * bytes / 1e6).toFixed(1)} of ${megabytes} MB`;
    });
    element("loading-text").textContent = "Preparing…";
    // What stood in scripts is no longer needed, and is large.
    for (const script of [...document.scripts]) script.remove();
    await new Promise((resolve) => setTimeout(resolve, 0));
    new Page(facts, planes).fold(matchMedia("(max-width: 600px)").matches);
  } catch (error) {
    fail(wordsOf(error));
    if (!(error instanceof PageError)) throw error;
  }
}

start(window.MODEL_FACTS);
