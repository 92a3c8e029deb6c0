// SPDX-License-Identifier: GPL-3.0-or-later
// An HDR screen: WebGPU's canvas can show more than white (toneMapping: extended). WebGL's picture comes to it as
// two halves of eight bits, high and low, because what WebGL shows is eight bits in most browsers.

/** How many times white is handed to the screen at the most; it shows as much of that as it can. */
const HDR_WHITE = 16;

const HDR_SHADER = `
@group(0) @binding(0) var halves: texture_2d<f32>;
@vertex fn corner(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
  return vec4f(vec2f(f32(i & 1u), f32(i >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}
@fragment fn whole(@builtin(position) at: vec4f) -> @location(0) vec4f {
  let pixel = vec2u(at.xy);
  let high = textureLoad(halves, pixel, 0).rgb;
  let low = textureLoad(halves, vec2u(pixel.x, pixel.y + textureDimensions(halves).y / 2u), 0).rgb;
  return vec4f((round(high * 255.0) * 256.0 + round(low * 255.0)) / 65535.0 * ${HDR_WHITE}.0, 1.0);
}`;

/** Whether browser and screen can, in words; `able`: whether to offer it. */
function hdrSupport() {
  const screen = matchMedia("(dynamic-range: high)").matches;
  if (!screen) return { able: false, words: "This screen, or this browser on it, shows standard range (SDR)." };
  if (!navigator.gpu) return { able: false, words: "The screen has high range, but this browser has no WebGPU to use it: standard range (SDR)." };
  return { able: true, words: "The screen has high range: switch it on to see Linear beyond white." };
}

class HdrScreen {
  /** Resolves to a screen; raises PageError where WebGPU or its canvas refuses. */
  static async on(canvas) {
    const made = new HdrScreen();
    const adapter = await navigator.gpu.requestAdapter();
    if (!adapter) throw new PageError("WebGPU finds no graphics card");
    made.device = await adapter.requestDevice();
    made.canvas = canvas;
    made.context = canvas.getContext("webgpu");
    made.context.configure({ device: made.device, format: "rgba16float", colorSpace: "srgb", toneMapping: { mode: "extended" }, alphaMode: "opaque" });
    const told = made.context.getConfiguration?.();
    if (told && told.toneMapping?.mode !== "extended") throw new PageError("this browser's canvas has no extended range");
    const module = made.device.createShaderModule({ code: HDR_SHADER });
    made.pipeline = made.device.createRenderPipeline({
      layout: "auto",
      vertex: { module, entryPoint: "corner" },
      fragment: { module, entryPoint: "whole", targets: [{ format: "rgba16float" }] },
    });
    return made;
  }

  /** Show what WebGL has just drawn, in the same task. */
  show(source) {
    const width = source.width, height = source.height;
    if (!this.halves || this.halves.width !== width || this.halves.height !== height) {
      this.halves?.destroy();
      const usage = GPUTextureUsage.TEXTURE_BINDING | GPUTextureUsage.COPY_DST | GPUTextureUsage.RENDER_ATTACHMENT;
      this.halves = this.device.createTexture({ size: [width, height], format: "rgba8unorm", usage });
      this.canvas.width = width;
      this.canvas.height = height / 2;
      this.group = this.device.createBindGroup({
        layout: this.pipeline.getBindGroupLayout(0),
        entries: [{ binding: 0, resource: this.halves.createView() }],
      });
    }
    this.device.queue.copyExternalImageToTexture({ source }, { texture: this.halves }, [width, height]);
    const encoder = this.device.createCommandEncoder();
    const pass = encoder.beginRenderPass({
      colorAttachments: [{ view: this.context.getCurrentTexture().createView(), loadOp: "clear", storeOp: "store" }],
    });
    pass.setPipeline(this.pipeline);
    pass.setBindGroup(0, this.group);
    pass.draw(3);
    pass.end();
    this.device.queue.submit([encoder.finish()]);
  }
}
