// SPDX-License-Identifier: GPL-3.0-or-later
// What becomes of exposure × radiance on the screen: the response that the model learned, or a known one.

const CURVE_POINTS = 2048, CURVE_SPAN = [-12, 8];
const IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

/** sRGB's code of linear light from 0 to 1. */
const srgbCode = (x) => x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055;

/** J. Hable's curve of 2010, white at 11.2; twice the exposure, as he has it. */
function filmic(x) {
  const bent = (v) => (v * (0.15 * v + 0.05) + 0.004) / (v * (0.15 * v + 0.5) + 0.06) - 1 / 15;
  return srgbCode(Math.min(bent(2 * x) / bent(11.2), 1));
}

/** AgX's curve (T. Sobotka, 2022): a sigmoid over −10 … +6.5 stops around 0.18, slope 2, ends of power 3 and 3.25. */
function agx(x) {
  const pivot = 10 / 16.5, middle = 0.5, slope = 2;
  const at = Math.min(Math.max((Math.log2(Math.max(x, 1e-10) / 0.18) + 10) / 16.5, 0), 1);
  const end = (length, height, power) => ((slope * length) ** -power * ((slope * length / height) ** power - 1)) ** (-1 / power);
  const bent = (t, power) => t / (1 + t ** power) ** (1 / power);
  if (at < pivot) {
    const scale = end(pivot, middle, 3);
    return Math.max(middle - scale * bent(slope * (pivot - at) / scale, 3), 0);
  }
  const scale = end(1 - pivot, 1 - middle, 3.25);
  return Math.min(middle + scale * bent(slope * (at - pivot) / scale, 3.25), 1);
}

/** AgX's inset: what each primary takes of the others, so that bright colours go to white. */
const AGX_INSET = [
  [0.842479062253094, 0.0784335999999992, 0.0792237451477643],
  [0.0423282422610123, 0.878468636469772, 0.0791661274605434],
  [0.0423756549057051, 0.0784336, 0.879142973793104],
];

function inverse(m) {
  const [[a, b, c], [d, e, f], [g, h, i]] = m;
  const A = e * i - f * h, B = f * g - d * i, C = d * h - e * g, D = a * A + b * B + c * C;
  return [[A, c * h - b * i, b * f - c * e], [B, a * i - c * g, c * d - a * f], [C, b * g - a * h, a * e - b * d]]
    .map((row) => row.map((value) => value / D));
}

/** Codes at even steps of ln exposure, of a function of exposure × radiance. */
function sampled(code) {
  const [low, high] = CURVE_SPAN;
  const rows = Array.from({ length: CURVE_POINTS }, (_, i) => {
    const y = code(Math.max(Math.exp(low + (high - low) * i / (CURVE_POINTS - 1)) - 1e-5, 0));
    return [y, y, y];
  });
  return { rows, span: CURVE_SPAN };
}

/** Name → what is said of it, its curve, and its form for the shader; `learned` and `confidence` where known. */
function responses(facts) {
  const plain = { form: 0, inset: IDENTITY, outset: IDENTITY };
  const known = {
    agx: { title: "AgX", note: "T. Sobotka's AgX, its base look; Blender's own is a little different.", ...sampled(agx), form: 1, inset: AGX_INSET, outset: inverse(AGX_INSET) },
    filmic: { title: "Filmic", note: "J. Hable's curve.", ...sampled(filmic), ...plain },
    linear: { title: "Linear", note: "Exposure × radiance as it is, in sRGB: white where it is 1 or more.", ...sampled((x) => srgbCode(Math.min(x, 1))), ...plain },
  };
  if (facts.confidence) known.confidence = { rows: facts.confidence.ramp, span: [0, 1], ...plain, form: 3 };
  if (!facts.curve) return known;
  const learned = { title: facts.curve.title, note: facts.curve.note, rows: facts.curve.rows, span: facts.curve.span, ...plain };
  return { learned, ...known };
}
