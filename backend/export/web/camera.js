// SPDX-License-Identifier: GPL-3.0-or-later
// Where the eye is and how it is moved. A view: eye (metres), axes (rows: right, up, back, in the world), lens
// (of the picture that it was made for: focal lengths and principal point by its width and height, and aspect).

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, times = 1) => [a[0] + times * b[0], a[1] + times * b[1], a[2] + times * b[2]];
const times = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => times(a, 1 / Math.hypot(...a));

/** `v` turned by `angle` about the unit vector `axis`. */
function turned(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return plus(plus(times(v, c), cross(axis, v), s), axis, dot(axis, v) * (1 - c));
}

/** Rows right, up, back of a unit quaternion wxyz. */
function axesOf([w, x, y, z]) {
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
    [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
    [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
  ];
}

/** The quaternion wxyz, w ≥ 0, of rows right, up, back. */
function quaternionOf([[a, b, c], [d, e, f], [g, h, i]]) {
  const trace = a + e + i;
  let q;
  if (trace > 0) q = [1 + trace, f - h, g - c, b - d];
  else if (a > e && a > i) q = [f - h, 1 + a - e - i, b + d, c + g];
  else if (e > i) q = [g - c, b + d, 1 - a + e - i, f + h];
  else q = [b - d, c + g, f + h, 1 - a - e + i];
  const length = Math.hypot(...q) * (q[0] < 0 ? -1 : 1);
  return q.map((value) => value / length);
}

/** Of a row of facts.cameras, or of a link. */
const viewOf = ({ eye, turn, lens }) => ({ eye: [...eye], axes: axesOf(turn), lens: [...lens] });

/** What the drawing takes, of a picture of so many pixels: the whole of the view's own picture is in it. */
function projected(view, width, height) {
  const [fx, fy, cx, cy, aspect] = view.lens;
  // The view's own picture in pixels, as large as fits.
  const w = Math.min(width, height * aspect), h = w / aspect;
  const [right, up, back] = view.axes;
  return {
    eye: view.eye,
    rows: [right, times(up, -1), times(back, -1)],
    lens: [fx * w, fy * h, cx * w + 0.5 * (width - w), cy * h + 0.5 * (height - h)],
  };
}

/** Half way and so on between two views; `t` from 0 to 1. */
function between(a, b, t) {
  const s = t * t * (3 - 2 * t), qa = quaternionOf(a.axes);
  let qb = quaternionOf(b.axes);
  if (qa.reduce((sum, value, i) => sum + value * qb[i], 0) < 0) qb = qb.map((value) => -value);
  const q = qa.map((value, i) => value + s * (qb[i] - value)), length = Math.hypot(...q);
  const mixed = (from, to) => from.map((value, i) => value + s * (to[i] - value));
  return { eye: mixed(a.eye, b.eye), axes: axesOf(q.map((value) => value / length)), lens: mixed(a.lens, b.lens) };
}

const MOVES = {
  KeyW: [0, 0, -1], KeyS: [0, 0, 1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyE: [0, 1, 0], KeyQ: [0, -1, 0],
};
const TURNS = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

class Walker {
  /** `changed()` is called when the view is another one by the user's hand. */
  constructor(canvas, facts, position, changed) {
    Object.assign(this, { canvas, up: facts.up, size: facts.size, position, changed });
    this.mode = "orbit";
    this.view = viewOf(facts.cameras[0]);
    this.flight = null;
    this.keys = new Set();
    this.isFast = false;
    this.pointers = new Map();
    this.pivot = null;
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("keyup", (event) => this.keys.delete(event.code));
    addEventListener("blur", () => this.keys.clear());
  }

  /** Go to a view, by flight where the user likes motion. */
  go(view, flies) {
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.pivot = null;
    if (!flies || still) { this.view = view; this.flight = null; return; }
    this.flight = { from: this.view, to: view, begun: performance.now() };
  }

  /** What turns go around: ahead, as far as the middle one of the Gaussians that are seen there. */
  centre() {
    if (this.pivot) return this.pivot;
    const ahead = times(this.view.axes[2], -1), step = 3 * Math.max(1, Math.floor(this.position.length / 60000));
    const depths = [];
    for (let i = 0; i < this.position.length; i += step) {
      const to = plus([this.position[i], this.position[i + 1], this.position[i + 2]], this.view.eye, -1), depth = dot(to, ahead);
      if (depth > 0 && depth > 0.98 * Math.hypot(...to)) depths.push(depth);
    }
    depths.sort((a, b) => a - b);
    const distance = depths.length ? depths[depths.length >> 1] : this.size;
    this.pivot = plus(this.view.eye, ahead, Math.min(distance, 3 * this.size));
    return this.pivot;
  }

  turn(across, upwards, about) {
    const { axes } = this.view, ahead = times(axes[2], -1);
    // Not over the top: there left and right would change places.
    const height = Math.asin(Math.max(-1, Math.min(1, dot(ahead, this.up)))), limit = 1.54;
    const pitch = Math.max(-limit - height, Math.min(limit - height, upwards));
    const turn = (v) => turned(turned(v, axes[0], Math.abs(height) > limit ? 0 : pitch), this.up, across);
    const eye = about ? plus(about, turn(plus(this.view.eye, about, -1))) : this.view.eye;
    const right = unit(turn(axes[0])), back = turn(axes[2]), up = unit(cross(back, right));
    this.view = { ...this.view, eye, axes: [right, up, cross(right, up)] };
    if (!about) this.pivot = null;
  }

  shift(right, up, back) {
    const { eye, axes } = this.view, by = plus(plus(times(axes[0], right), axes[1], up), axes[2], back);
    this.view = { ...this.view, eye: plus(eye, by) };
    if (this.pivot && !back) this.pivot = plus(this.pivot, by);
  }

  /** Nearer to what is ahead, or away from it, by a factor of the distance. */
  nearer(factor) {
    const centre = this.centre(), distance = Math.hypot(...plus(this.view.eye, centre, -1));
    const least = 0.02 * this.size, next = distance * factor;
    this.shift(0, 0, next - distance);
    if (next < least) this.pivot = plus(this.view.eye, this.view.axes[2], -least);
  }

  press(event) {
    this.flight = null;
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY], others = [...this.pointers].filter(([id]) => id !== event.pointerId);
    this.pointers.set(event.pointerId, now);
    const x = now[0] - before[0], y = now[1] - before[1], height = this.canvas.clientHeight;
    const pans = event.buttons & 6 || event.shiftKey;
    if (others.length) {
      const other = others[0][1], far = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      this.pan(0.5 * x, 0.5 * y);
      this.nearer(Math.min(Math.max(far(before) / Math.max(far(now), 1), 0.5), 2));
    } else if (pans) this.pan(x, y);
    else {
      const speed = 3 / height, about = this.mode === "orbit" ? this.centre() : null;
      // Orbiting one turns the scene, walking one turns the head; both follow the hand.
      this.turn(about ? -x * speed : x * speed * 0.6, about ? -y * speed : y * speed * 0.6, about);
    }
    this.changed();
  }

  pan(x, y) {
    const distance = Math.hypot(...plus(this.view.eye, this.centre(), -1));
    const metres = distance / (projected(this.view, this.canvas.clientWidth, this.canvas.clientHeight).lens[1]);
    this.shift(-x * metres, y * metres, 0);
  }

  wheel(event) {
    event.preventDefault();
    this.flight = null;
    const lines = event.deltaMode === 1 ? 33 : event.deltaMode === 2 ? 300 : 1;
    const amount = Math.max(-300, Math.min(300, event.deltaY * lines));
    if (this.mode === "walk") this.shift(0, 0, amount * 0.0006 * this.size);
    else this.nearer(Math.exp(amount * 0.001));
    this.changed();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || /^(SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
    if (!(event.code in MOVES || event.code in TURNS)) return;
    if (event.target.type === "text") return; // where a link is selected by the keyboard
    if (event.code in TURNS && event.target.type === "range") return; // arrows move a slider
    event.preventDefault();
    this.flight = null;
    this.keys.add(event.code);
    this.isFast = event.shiftKey;
    // A tap may end before the next frame begins: it moves, too.
    if (!event.repeat) this.move(1 / 30);
    this.changed();
  }

  /** Move on by `seconds`; whether anything moves. */
  step(seconds, now) {
    if (this.flight) {
      const t = Math.min((now - this.flight.begun) / 700, 1);
      this.view = t < 1 ? between(this.flight.from, this.flight.to, t) : this.flight.to;
      if (t === 1) this.flight = null;
      return true;
    }
    if (!this.keys.size) return false;
    this.move(seconds);
    return true;
  }

  /** What the keys that are held do in so many seconds. */
  move(seconds) {
    const speed = (this.isFast ? 3 : 1) * 0.35 * this.size * seconds;
    for (const code of this.keys) {
      if (code in MOVES) { this.shift(...times(MOVES[code], speed)); this.pivot = null; }
      if (code in TURNS) {
        const about = this.mode === "orbit" ? this.centre() : null, sign = about ? -1 : 1;
        this.turn(sign * TURNS[code][0] * 1.2 * seconds, sign * TURNS[code][1] * 1.2 * seconds, about);
      }
    }
  }
}
