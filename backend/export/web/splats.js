// SPDX-License-Identifier: GPL-3.0-or-later
// Draws the Gaussians with WebGL 2, as backend/rasterize does (contract.py): each one's radiance under the lights
// as they are, blended scene-linear in half floats from the farthest to the nearest, developed afterwards.
// Radiance is drawn as exposure × radiance, so that half floats do not overflow where a response is not yet white.

/** Numbers on which all that draws agrees (bridge/splatting.py, bridge/spherical_harmonics.py), for shaders. */
const defines = (contract) =>
  Object.entries(contract).map(([name, value]) => `#define ${name} ${Number.isInteger(value) ? value.toFixed(1) : value}`).join("\n");

const FULL_SCREEN = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;

/** One texel a Gaussian: exposure × radiance toward the eye, under the lights. */
const RADIANCE = `
precision highp float;
precision highp int;
uniform highp sampler2D place;
uniform highp usampler2D base;
uniform highp isampler2DArray rest;
#if LEVELS > 0
uniform highp isampler2DArray gain;
uniform ivec2 between;
uniform float blend;
#else
uniform highp sampler2DArray share;
uniform float levels[LIGHTS];
#endif
uniform vec3 eye;
uniform float exposure;
uniform bool shows_confidence;
out vec4 shine;

vec3 stepped(highp isampler2DArray layers, ivec2 at, int k) {
  ivec4 code = texelFetch(layers, ivec3(at, k), 0);
  return vec3(code.rgb) * (REST_STEP * exp2(float(code.a) / STEP_CODES));
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  uvec4 code = texelFetch(base, at, 0);
  vec3 sum = C0 * BASE_STEP * (vec3(code.rgb) - 32768.0);
#if DEGREE > 0
  vec3 w = normalize(texelFetch(place, at, 0).xyz - eye);
  sum += C1 * (-w.y * stepped(rest, at, 0) + w.z * stepped(rest, at, 1) - w.x * stepped(rest, at, 2));
#endif
#if DEGREE > 1
  float xx = w.x * w.x, yy = w.y * w.y, zz = w.z * w.z;
  sum += C2_0 * w.x * w.y * stepped(rest, at, 3) + C2_1 * w.y * w.z * stepped(rest, at, 4)
    + C2_2 * (2.0 * zz - xx - yy) * stepped(rest, at, 5) + C2_3 * w.x * w.z * stepped(rest, at, 6)
    + C2_4 * (xx - yy) * stepped(rest, at, 7);
#endif
#if DEGREE > 2
  sum += C3_0 * w.y * (3.0 * xx - yy) * stepped(rest, at, 8) + C3_1 * w.x * w.y * w.z * stepped(rest, at, 9)
    + C3_2 * w.y * (4.0 * zz - xx - yy) * stepped(rest, at, 10)
    + C3_3 * w.z * (2.0 * zz - 3.0 * (xx + yy)) * stepped(rest, at, 11)
    + C3_4 * w.x * (4.0 * zz - xx - yy) * stepped(rest, at, 12) + C3_5 * w.z * (xx - yy) * stepped(rest, at, 13)
    + C3_6 * w.x * (xx - 3.0 * yy) * stepped(rest, at, 14);
#endif
  vec3 lit = vec3(1.0);
#if LEVELS > 0
  sum += mix(stepped(gain, at, between.x), stepped(gain, at, between.y), blend);
#else
  vec3 fixed_share = vec3(1.0);
  lit = vec3(0.0);
  for (int k = 0; k < LIGHTS; k++) {
    vec3 root = sin(1.57079633 * texelFetch(share, ivec3(at, k), 0).rgb);
    fixed_share -= root * root;
    lit += levels[k] * root * root;
  }
  lit += max(fixed_share, 0.0);
#endif
  /* Nothing may be infinite in half floats, nor in what they are made from. */
  vec3 radiance = min(exp(min(sum + log(exposure), 80.0)) * lit, vec3(65000.0));
  if (shows_confidence) radiance = vec3(float(code.a) / 255.0);
  shine = vec4(radiance, 1.0);
}`;

/** A quad that holds all of a Gaussian that can be seen, in standard deviations along its axes on the screen. */
const SPLAT = `
precision highp float;
precision highp int;
layout(location = 0) in uint index;
uniform highp sampler2D place;
uniform highp sampler2D scale;
uniform highp isampler2D rotation;
uniform highp sampler2D shine;
uniform mat3 to_camera;
uniform vec3 eye;
uniform vec4 lens;
uniform vec2 size;
flat out vec4 colour;
out vec2 from_centre;

/* Rᵀ v of a unit quaternion wxyz. */
vec3 into_object(vec4 q, vec3 v) {
  vec3 t = 2.0 * cross(v, q.yzw);
  return v + q.x * t + cross(t, q.yzw);
}

void main() {
  int width = textureSize(place, 0).x, i = int(index);
  ivec2 at = ivec2(i % width, i / width);
  vec4 here = texelFetch(place, at, 0);
  vec3 p = to_camera * (here.xyz - eye);
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  if (p.z < NEAR_PLANE || here.w < ALPHA_MIN) return; /* the latter fill chunks */
  vec2 focal = lens.xy, centre = lens.zw, slope = p.xy / p.z, margin = JACOBIAN_MARGIN * 0.5 * size / focal;
  vec2 limited = clamp(slope, -(centre / focal + margin), (size - centre) / focal + margin);
  vec3 row_x = vec3(focal.x, 0.0, -focal.x * limited.x) / p.z, row_y = vec3(0.0, focal.y, -focal.y * limited.y) / p.z;
  vec4 q = normalize(vec4(texelFetch(rotation, at, 0)));
  vec3 s = texelFetch(scale, at, 0).xyz;
  vec3 a = into_object(q, row_x * to_camera) * s, b = into_object(q, row_y * to_camera) * s;
  float xx = dot(a, a), xy = dot(a, b), yy = dot(b, b);
  /* |a × b|² is the determinant without the cancellation of xx yy − xy². */
  vec3 normal = cross(a, b);
  float determinant = dot(normal, normal) + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS;
  float half_difference = 0.5 * (xx - yy), radius = length(vec2(half_difference, xy));
  float largest = 0.5 * (xx + yy) + radius + LOW_PASS, smallest = determinant / largest;
  vec2 axis = half_difference >= 0.0 ? vec2(half_difference + radius, xy) : vec2(xy, radius - half_difference);
  float axis_length = length(axis);
  axis = axis_length > 0.0 ? axis / axis_length : vec2(1.0, 0.0);
  float reach = sqrt(2.0 * log(here.w / ALPHA_MIN));
  vec2 pixel = focal * slope + centre;
  vec2 extent = reach * sqrt(vec2(xx, yy) + LOW_PASS);
  if (any(lessThan(pixel + extent, vec2(0.0))) || any(greaterThan(pixel - extent, size))) return;
  from_centre = (vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0) * reach;
  pixel += from_centre.x * axis * sqrt(largest) + from_centre.y * vec2(-axis.y, axis.x) * sqrt(smallest);
  gl_Position = vec4((2.0 * pixel / size - 1.0) * vec2(1.0, -1.0), 0.0, 1.0);
  colour = vec4(texelFetch(shine, at, 0).rgb, here.w);
}`;

const BLENDED = `
precision highp float;
flat in vec4 colour;
in vec2 from_centre;
out vec4 picture;
void main() {
  float alpha = min(ALPHA_MAX, colour.a * exp(-0.5 * dot(from_centre, from_centre)));
  if (alpha < ALPHA_MIN) discard;
  picture = vec4(colour.rgb * alpha, alpha);
}`;

/** The picture as it is shown: the response of what was blended. For an HDR screen its rows are upside down. */
const DEVELOPED = `
precision highp float;
uniform highp sampler2D picture;
uniform highp sampler2D curve;
uniform vec2 span;
uniform vec2 canvas;
uniform int form;
uniform bool is_hdr;
uniform mat3 inset;
uniform mat3 outset;
out vec4 shown;

vec3 srgb(vec3 x) { return mix(x * 12.92, 1.055 * pow(max(x, 0.0031308), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x)); }

/* The curve's row at a share of its span. */
vec3 row(float share) {
  float last = float(textureSize(curve, 0).x - 1), x = clamp(share, 0.0, 1.0) * last;
  int i = int(min(x, last - 1.0));
  return mix(texelFetch(curve, ivec2(i, 0), 0).rgb, texelFetch(curve, ivec2(i + 1, 0), 0).rgb, x - float(i));
}

float curved(float exposed, int channel) { return row((log(exposed + 1e-5) - span.x) / (span.y - span.x))[channel]; }

vec3 developed(vec3 x) {
  if (form == 2) return srgb(x);
  if (form == 3) return row(x.r);
  if (form == 1) x = inset * x;
  x = vec3(curved(x.r, 0), curved(x.g, 1), curved(x.b, 2));
  /* AgX: the curve's end is a code of power 2.2; the inset is undone in linear light. */
  if (form == 1) x = pow(clamp(outset * pow(max(x, 0.0), vec3(2.2)), 0.0, 1.0), vec3(1.0 / 2.2));
  return x;
}

void main() {
  vec2 at = gl_FragCoord.xy;
  if (is_hdr) at.y = canvas.y - at.y;
  /* Drawn smaller while it moves: bilinear. */
  vec2 source = at / canvas * vec2(textureSize(picture, 0)) - 0.5;
  ivec2 low = ivec2(floor(source)), most = textureSize(picture, 0) - 1;
  vec2 part = source - vec2(low);
  ivec2 a = clamp(low, ivec2(0), most), b = clamp(low + 1, ivec2(0), most);
  vec3 exposed = mix(mix(texelFetch(picture, a, 0).rgb, texelFetch(picture, ivec2(b.x, a.y), 0).rgb, part.x),
    mix(texelFetch(picture, ivec2(a.x, b.y), 0).rgb, texelFetch(picture, b, 0).rgb, part.x), part.y);
  shown = vec4(developed(exposed), 1.0);
}`;

class SplatDrawing {
  /** Raises PageError where the browser or its graphics card cannot. */
  constructor(canvas, facts, planes) {
    this.facts = facts;
    this.canvas = canvas;
    const gl = this.gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });
    if (!gl) throw new PageError("This page needs WebGL 2: update the browser, or switch on its hardware acceleration.");
    if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float"))
      throw new PageError("This graphics card cannot draw half floats, which this page needs. Try another device.");
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    this.width = 256;
    while (this.width * this.width < facts.count) this.width *= 2;
    this.rows = Math.ceil(facts.count / this.width);
    if (this.width > most) throw new PageError(`This graphics card has no room for ${facts.count} Gaussians: its textures end at ${most} pixels.`);
    const head = `#version 300 es
${defines({ ...facts.contract, REST_STEP: facts.rest_step, BASE_STEP: facts.base_step, STEP_CODES: facts.step_codes })}
#define DEGREE ${facts.degree}
#define LEVELS ${facts.levels.length}
#define LIGHTS ${facts.lights.length}
`;
    this.radiance = this.program(FULL_SCREEN, head + RADIANCE);
    this.splats = this.program(head + SPLAT, head + BLENDED);
    this.develop = this.program(FULL_SCREEN, head + DEVELOPED);
    this.upload(planes);
    this.shine = this.target(this.width, this.rows);
    this.order = gl.createBuffer();
    this.orderArray = gl.createVertexArray();
    gl.bindVertexArray(this.orderArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferData(gl.ARRAY_BUFFER, 4 * facts.count, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    this.nothing = gl.createVertexArray();
    this.picture = this.wide = this.halves = null;
    this.ordered = 0;
    this.curve = null;
    this.shineOf = "";
  }

  program(vertex, fragment) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source.trim());
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost())
        throw new PageError(`The graphics driver refuses a shader: ${gl.getShaderInfoLog(shader)}`);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost())
      throw new PageError(`The graphics driver refuses a program: ${gl.getProgramInfoLog(program)}`);
    const places = new Map();
    return { program, at: (name) => places.get(name) ?? places.set(name, gl.getUniformLocation(program, name)).get(name) };
  }

  texture(kind = this.gl.TEXTURE_2D) {
    const gl = this.gl, texture = gl.createTexture();
    gl.bindTexture(kind, texture);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(kind, name, gl.NEAREST);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(kind, name, gl.CLAMP_TO_EDGE);
    return { kind, texture };
  }

  upload(planes) {
    const gl = this.gl, facts = this.facts, size = this.width * this.rows;
    const flat = (internal, format, type, data) => {
      const made = this.texture();
      gl.texImage2D(gl.TEXTURE_2D, 0, internal, this.width, this.rows, 0, format, type, data);
      return made;
    };
    const layers = (internal, format, type, count, layer) => {
      const made = this.texture(gl.TEXTURE_2D_ARRAY);
      gl.texStorage3D(made.kind, 1, internal, this.width, this.rows, Math.max(count, 1));
      for (let k = 0; k < count; k++)
        gl.texSubImage3D(made.kind, 0, 0, 0, k, this.width, this.rows, 1, format, type, layer(k));
      return made;
    };
    const arrays = decode(facts, planes, size);
    this.position = arrays.position;
    this.place = flat(gl.RGBA32F, gl.RGBA, gl.FLOAT, arrays.place);
    this.scale = flat(gl.RGBA32F, gl.RGBA, gl.FLOAT, arrays.scale);
    this.rotation = flat(gl.RGBA16I, gl.RGBA_INTEGER, gl.SHORT, arrays.rotation);
    this.base = flat(gl.RGBA16UI, gl.RGBA_INTEGER, gl.UNSIGNED_SHORT, arrays.base);
    const stepped = (name) => (k) => steppedLayer(planes, name, k, facts, size);
    this.rest = layers(gl.RGBA8I, gl.RGBA_INTEGER, gl.BYTE, (facts.degree + 1) ** 2 - 1, stepped("rest"));
    this.light = facts.levels.length
      ? layers(gl.RGBA8I, gl.RGBA_INTEGER, gl.BYTE, facts.levels.length, stepped("gain"))
      : layers(gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, facts.lights.length, (k) => plainLayer(planes.share, k, facts.count, size));
    if (gl.getError() === gl.OUT_OF_MEMORY) throw new PageError("The graphics card has not enough memory for this model. Close other pages, or try another device.");
  }

  /** A half-float picture to draw into. */
  target(width, height) {
    const gl = this.gl, made = this.texture();
    gl.texStorage2D(made.kind, 1, gl.RGBA16F, width, height);
    const frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made.texture, 0);
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE)
      throw new PageError("This graphics card cannot draw half floats, which this page needs. Try another device.");
    return { ...made, frame, width, height };
  }

  setOrder(order) {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, order);
    this.ordered = order.length;
  }

  /** `rows`: `[M, 3]` codes at even steps of ln exposure within `span`. */
  setCurve({ rows, span }) {
    if (this.curve?.rows === rows) return;
    const gl = this.gl, texels = new Float32Array(4 * rows.length);
    rows.forEach((row, i) => texels.set(row, 4 * i));
    if (this.curve) gl.deleteTexture(this.curve.texture);
    this.curve = { ...this.texture(), rows, span };
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, rows.length, 1, 0, gl.RGBA, gl.FLOAT, texels);
  }

  bind({ program, at }, textures) {
    const gl = this.gl;
    gl.useProgram(program);
    Object.entries(textures).forEach(([name, { kind, texture }], slot) => {
      gl.activeTexture(gl.TEXTURE0 + slot);
      gl.bindTexture(kind, texture);
      gl.uniform1i(at(name), slot);
    });
    gl.activeTexture(gl.TEXTURE0);
  }

  /**
   * `view`: eye, rows of the rotation into the camera (x right, y down, z forward), lens in pixels of a picture of
   * `width` × `height`; `look`: exposure (s), levels, confidence; `tone`: form and matrices. With `isHdr` the
   * picture does not go onto the canvas but is returned, in half floats `[H, W, 4]` of the canvas's size.
   */
  draw(view, width, height, look, tone, isHdr) {
    const gl = this.gl;
    if (!this.picture || this.picture.width !== width || this.picture.height !== height) {
      this.forget(this.picture);
      this.picture = this.target(width, height);
    }
    this.drawRadiance(view, look);

    gl.bindFramebuffer(gl.FRAMEBUFFER, this.picture.frame);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.bind(this.splats, { place: this.place, scale: this.scale, rotation: this.rotation, shine: this.shine });
    gl.uniformMatrix3fv(this.splats.at("to_camera"), true, view.rows.flat());
    gl.uniform3fv(this.splats.at("eye"), view.eye);
    gl.uniform4fv(this.splats.at("lens"), view.lens);
    gl.uniform2f(this.splats.at("size"), width, height);
    gl.bindVertexArray(this.orderArray);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.ordered);
    gl.disable(gl.BLEND);

    const { width: w, height: h } = this.canvas;
    if (isHdr && (this.wide?.width !== w || this.wide.height !== h)) {
      this.forget(this.wide);
      this.wide = this.target(w, h);
      this.halves = new Uint16Array(4 * w * h);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, isHdr ? this.wide.frame : null);
    gl.viewport(0, 0, w, h);
    this.bind(this.develop, { picture: this.picture, curve: this.curve });
    gl.uniform2f(this.develop.at("span"), ...this.curve.span);
    gl.uniform2f(this.develop.at("canvas"), w, h);
    gl.uniform1i(this.develop.at("form"), tone.form);
    gl.uniform1i(this.develop.at("is_hdr"), isHdr ? 1 : 0);
    gl.uniformMatrix3fv(this.develop.at("inset"), true, tone.inset.flat());
    gl.uniformMatrix3fv(this.develop.at("outset"), true, tone.outset.flat());
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    if (isHdr) gl.readPixels(0, 0, w, h, gl.RGBA, gl.HALF_FLOAT, this.halves);
    return this.halves;
  }

  /** Whether half floats can be read back, as an HDR screen needs; not all drivers do. */
  canReadBack() {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shine.frame);
    return gl.getParameter(gl.IMPLEMENTATION_COLOR_READ_TYPE) === gl.HALF_FLOAT;
  }

  forget(target) {
    if (!target) return;
    this.gl.deleteTexture(target.texture);
    this.gl.deleteFramebuffer(target.frame);
  }

  /** Every Gaussian's radiance, where the eye, the exposure or a light are others than last time. */
  drawRadiance(view, look) {
    const gl = this.gl, of = JSON.stringify([view.eye, look]);
    if (of === this.shineOf) return;
    this.shineOf = of;
    const at = this.radiance.at, isBaked = this.facts.levels.length > 0;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shine.frame);
    gl.viewport(0, 0, this.width, this.rows);
    this.bind(this.radiance, { place: this.place, base: this.base, rest: this.rest, [isBaked ? "gain" : "share"]: this.light });
    gl.uniform3fv(at("eye"), view.eye);
    gl.uniform1f(at("exposure"), look.exposure);
    gl.uniform1i(at("shows_confidence"), look.confidence ? 1 : 0);
    if (isBaked) {
      const { low, high, blend } = levelBetween(this.facts.levels, look.levels[0]);
      gl.uniform2i(at("between"), low, high);
      gl.uniform1f(at("blend"), blend);
    } else gl.uniform1fv(at("levels"), look.levels);
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}

/** Between which of the rising `levels` a level lies, and how far, by its logarithm; constant outside. */
function levelBetween(levels, level) {
  const last = levels.length - 1;
  if (level <= levels[0]) return { low: 0, high: 0, blend: 0 };
  if (level >= levels[last]) return { low: last, high: last, blend: 0 };
  let low = 0;
  while (levels[low + 1] <= level) low++;
  return { low, high: low + 1, blend: Math.log(level / levels[low]) / Math.log(levels[low + 1] / levels[low]) };
}
