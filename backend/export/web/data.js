// SPDX-License-Identifier: GPL-3.0-or-later
// The model's bytes: they come as base64 in classic scripts, which also a page from file:// may load, and are
// unpacked while they come. What they mean: backend/export/quantised.py.

/** Raised where something cannot be shown; its message says what to do. */
class PageError extends Error {}

/** The parts that have come: `MODEL_PART(k, "base64")`, each in a script of its own. */
const parts = new Map();
let partArrived = () => {};
window.MODEL_PART = (index, text) => { parts.set(index, text); partArrived(); };

function bytesOf(base64) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(base64);
  const text = atob(base64), bytes = new Uint8Array(text.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

/** Part `index`, which stands in the page or in a file beside it. */
function part(index, file) {
  return new Promise((resolve, reject) => {
    const take = () => {
      if (!parts.has(index)) return false;
      const text = parts.get(index);
      parts.delete(index);
      partArrived = () => {};
      resolve(bytesOf(text));
      return true;
    };
    if (take()) return;
    partArrived = take;
    if (!file) {
      const missing = () => take() || reject(new PageError("The page is not whole: its end is missing. Load or copy it again."));
      if (document.readyState === "complete") missing(); else addEventListener("load", missing);
      return;
    }
    const script = document.createElement("script");
    script.src = file;
    script.onload = () => {
      script.remove();
      if (parts.has(index)) take();
      else if (partArrived === take) reject(new PageError(`${file} is damaged. Copy the page's folder again, whole.`));
    };
    script.onerror = () => reject(new PageError(`${file} is missing. Load this page again; if that does not help, copy the folder of index.html again, whole.`));
    document.head.append(script);
  });
}

/** All planes of bytes by name; `progress` is told a number from 0 to 1. */
async function loadPlanes(facts, progress) {
  if (typeof DecompressionStream === "undefined")
    throw new PageError("This browser is too old to unpack the model. Update it: Chrome 80, Firefox 113, Safari 16.4 or newer.");
  const whole = new Uint8Array(facts.bytes);
  const stream = new DecompressionStream("deflate");
  const writer = stream.writable.getWriter(), reader = stream.readable.getReader();
  let at = 0;
  const reading = (async () => {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      if (at + value.length > whole.length) throw new PageError("The model's data are damaged: there are too many.");
      whole.set(value, at);
      at += value.length;
    }
  })();
  reading.catch(() => {});
  // A write waits for what came before to be read: where reading has ended by an error, it would for ever.
  const written = (writing) => Promise.race([writing, reading]);
  try {
    for (let k = 0; k < facts.parts.length; k++) {
      await written(writer.write(await part(k, facts.parts[k].file)));
      progress((k + 1) / facts.parts.length);
    }
    await written(writer.close());
    await reading;
  } catch (error) {
    // Nobody waits for the rest; that it cannot be had is told already.
    for (const ending of [reader.cancel(), writer.abort()]) ending.catch(() => {});
    if (error instanceof PageError) throw error;
    throw new PageError("The model's data are damaged. Copy the page again, or export it again.");
  }
  if (at !== whole.length) throw new PageError("The model's data are not whole. Copy the page again.");
  const planes = {};
  let start = 0;
  for (const [name, size] of facts.planes) {
    planes[name] = whole.subarray(start, start + size);
    start += size;
  }
  return planes;
}

/** What is drawn, in arrays that go to the GPU as they are. `size`: Gaussians that there is room for. */
function decode(facts, planes, size) {
  const n = facts.count, chunk = facts.chunk;
  const bounds = new Float32Array(planes.bounds.slice().buffer);
  const position = new Float32Array(3 * n);
  const place = new Float32Array(4 * size), scale = new Float32Array(4 * size), rotation = new Int16Array(4 * size);
  const base = new Uint16Array(4 * size);
  const P = planes.position, S = planes.scale, B = planes.base, R = planes.rotation;
  const unit = Math.SQRT1_2 * 1023;
  for (let i = 0; i < n; i++) {
    const box = 12 * Math.floor(i / chunk);
    for (let a = 0; a < 3; a++) {
      const code = P[2 * a * n + i] << 8 | P[(2 * a + 1) * n + i];
      position[3 * i + a] = place[4 * i + a] = bounds[box + a] + code * bounds[box + 3 + a] / 65535;
      scale[4 * i + a] = Math.exp(bounds[box + 6 + a] + S[a * n + i] * bounds[box + 9 + a] / 255);
      base[4 * i + a] = B[2 * a * n + i] << 8 | B[(2 * a + 1) * n + i];
    }
    place[4 * i + 3] = planes.opacity[i] / 255;
    base[4 * i + 3] = planes.confidence ? planes.confidence[i] : 255;
    const word = (R[i] | R[n + i] << 8 | R[2 * n + i] << 16 | R[3 * n + i] << 24) >>> 0, largest = word & 3;
    let rest = 1;
    for (let k = 1; k < 4; k++) {
      const value = ((word >>> (10 * k - 8) & 1023) - 512) / unit;
      rest -= value * value;
      rotation[4 * i + (largest + k) % 4] = Math.round(32767 * value);
    }
    rotation[4 * i + largest] = Math.round(32767 * Math.sqrt(Math.max(rest, 0)));
  }
  return { position, place, scale, rotation, base };
}

/** Layer k of signed bytes, with the code of each step in the fourth channel. */
function steppedLayer(planes, name, k, facts, size) {
  const n = facts.count, chunks = Math.ceil(n / facts.chunk), codes = planes[`${name}_steps`];
  const values = new Int8Array(planes[name].buffer, planes[name].byteOffset, planes[name].length);
  const layer = new Int8Array(4 * size);
  for (let i = 0; i < n; i++) {
    for (let c = 0; c < 3; c++) layer[4 * i + c] = values[(3 * k + c) * n + i];
    layer[4 * i + 3] = codes[k * chunks + Math.floor(i / facts.chunk)];
  }
  return layer;
}

/** Layer k of unsigned bytes. */
function plainLayer(plane, k, n, size) {
  const layer = new Uint8Array(4 * size);
  for (let i = 0; i < n; i++) for (let c = 0; c < 3; c++) layer[4 * i + c] = plane[(3 * k + c) * n + i];
  return layer;
}
