// SPDX-License-Identifier: GPL-3.0-or-later
// An HDR screen: WebGPU's canvas can show more than white (toneMapping: extended), WebGL's own cannot in most
// browsers. So the developed picture is read back as half floats and handed over as it is.

/** Whether browser and screen can, in words; `able`: whether to offer it. */
function hdrSupport() {
  const screen = matchMedia("(dynamic-range: high)").matches;
  if (!screen) return { able: false, words: "This screen, or this browser on it, shows standard range (SDR)." };
  if (!navigator.gpu) return { able: false, words: "The screen has high range, but this browser has no WebGPU to use it: standard range (SDR)." };
  return { able: true, words: "The screen has high range: switch it on to see Linear beyond white." };
}

class HdrScreen {
  /** Resolves to a screen; raises PageError where WebGPU or its canvas refuses. `lost()`: its device is gone. */
  static async on(canvas, lost) {
    const made = new HdrScreen();
    const adapter = await navigator.gpu.requestAdapter();
    if (!adapter) throw new PageError("WebGPU finds no graphics card");
    made.device = await adapter.requestDevice();
    made.canvas = canvas;
    made.context = canvas.getContext("webgpu");
    made.context.configure({
      device: made.device, format: "rgba16float", usage: GPUTextureUsage.COPY_DST | GPUTextureUsage.RENDER_ATTACHMENT,
      colorSpace: "srgb", toneMapping: { mode: "extended" }, alphaMode: "opaque",
    });
    made.device.lost.then(lost);
    const told = made.context.getConfiguration?.();
    if (told && told.toneMapping?.mode !== "extended") throw new PageError("this browser's canvas has no extended range");
    return made;
  }

  /** Show half floats `[height, width, 4]`, codes of sRGB that go on above 1. */
  show(halves, width, height) {
    if (this.canvas.width !== width || this.canvas.height !== height) [this.canvas.width, this.canvas.height] = [width, height];
    const texture = this.context.getCurrentTexture();
    this.device.queue.writeTexture({ texture }, halves, { bytesPerRow: 8 * width }, [width, height]);
  }
}
