# SPDX-License-Identifier: GPL-3.0-or-later
"""The shader that puts a picture with depth into the 3D view (``overlay`` says how it is used)."""

from enum import IntFlag, auto

import gpu

from ...bridge import srgb
from . import seen

#: Samples of a tone curve on the GPU, equally spaced in ln(exposure).
TONE_SAMPLES = 1024


class Flag(IntFlag):
    """Bits of the shader's ``flags``; meanings as in ``overlay.Layer``."""

    ORTHOGRAPHIC = auto()
    TOP_ROW_FIRST = auto()
    DEPTH_IS_SUM = auto()
    USE_TONE = auto()
    #: Put out 1 − alpha, to be multiplied with what is there.
    ERASE = auto()
    #: Dim what no training camera has seen (``seen``).
    FADE = auto()


# The picture is a card that faces its own camera at `plane_depth`. Seen by that camera it fills the
# region exactly; seen by one that has moved since, it moves as a thing at that depth would.
_VERTEX = """
vec3 in_picture_space(vec2 at, float depth)
{
  vec2 on_plane = (at * size_and_centre.xy - size_and_centre.zw) / focal_and_tone.xy;
  return vec3((flags & ORTHOGRAPHIC) != 0 ? on_plane : on_plane * depth, depth);
}

void main()
{
  at = corner;
  vec4 clip = picture_to_clip * vec4(in_picture_space(corner, plane_depth), 1.0);
  // Depth is the fragment shader's: the card itself is never cut by the clipping planes.
  gl_Position = vec4(clip.xy, 0.0, clip.w);
}
"""

_FRAGMENT = """
vec3 in_picture_space(vec2 at, float depth)
{
  vec2 on_plane = (at * size_and_centre.xy - size_and_centre.zw) / focal_and_tone.xy;
  return vec3((flags & ORTHOGRAPHIC) != 0 ? on_plane : on_plane * depth, depth);
}

float tone_channel(float radiance, int channel)
{
  float place = (log(max(radiance, 1e-30)) - focal_and_tone.z) / focal_and_tone.w;
  place = clamp(place, 0.0, float(TONE_SAMPLES - 1));
  int below = min(int(place), TONE_SAMPLES - 2);
  float low = texelFetch(tone_curve, ivec2(below, 0), 0)[channel];
  float high = texelFetch(tone_curve, ivec2(below + 1, 0), 0)[channel];
  float display = mix(low, high, place - float(below));
  // The learned response is a display value. As light, so that the Standard view shows just it.
  return display <= SRGB_CODE_KNEE ? display / SRGB_SLOPE
                                   : pow((display + SRGB_OFFSET) / SRGB_SCALE, SRGB_POWER);
}

// How much is shown of a point: all where a training camera saw it. Their frustums: three rows each.
float shown_of(vec3 place)
{
  float nearest = OUTSIDE;
  for (int k = 0; k < textureSize(frustums, 0).y && nearest > INSIDE; k++) {
    vec3 seen = vec3(dot(texelFetch(frustums, ivec2(0, k), 0), vec4(place, 1.0)),
                     dot(texelFetch(frustums, ivec2(1, k), 0), vec4(place, 1.0)),
                     dot(texelFetch(frustums, ivec2(2, k), 0), vec4(place, 1.0)));
    if (seen.z > 0.0) {
      nearest = min(nearest, max(abs(seen.x), abs(seen.y)) / seen.z);
    }
  }
  return mix(1.0, LEAST, smoothstep(INSIDE, OUTSIDE, nearest));
}

void main()
{
  vec2 in_texture = vec2(at.x, (flags & TOP_ROW_FIRST) != 0 ? at.y : 1.0 - at.y);
  vec4 colour = texture(picture, in_texture);
  ivec2 texel = ivec2(in_texture * vec2(textureSize(picture, 0)));
  texel = clamp(texel, ivec2(0), textureSize(picture, 0) - 1);
  // Between two depths there is nothing: the nearest, not a mean.
  float coverage = texelFetch(picture, texel, 0).a;
  if (colour.a <= 0.0 || coverage <= 0.0) {
    discard;
  }
  float depth = texelFetch(picture_depth, texel, 0).r;
  depth = (flags & DEPTH_IS_SUM) != 0 ? depth / coverage : depth;
  vec3 place = in_picture_space(at, depth);
  vec4 clip = picture_to_clip * vec4(place, 1.0);
  gl_FragDepth = clamp(clip.z / clip.w * 0.5 + 0.5, 0.0, 1.0);

  if ((flags & FADE) != 0) {
    colour *= shown_of(place);
  }
  if ((flags & ERASE) != 0) {
    result = vec4(1.0 - min(colour.a, 1.0));
    return;
  }
  if ((flags & USE_TONE) != 0) {
    vec3 radiance = colour.rgb / colour.a;
    colour.rgb = colour.a * vec3(tone_channel(radiance.r, 0),
                                 tone_channel(radiance.g, 1),
                                 tone_channel(radiance.b, 2));
  }
  // The view's colour buffer is half float: no infinity may get in.
  result = vec4(min(colour.rgb, vec3(65000.0)), min(colour.a, 1.0));
}
"""


def create() -> gpu.types.GPUShader:
    info = gpu.types.GPUShaderCreateInfo()
    info.define("TONE_SAMPLES", str(TONE_SAMPLES))
    for name in ("CODE_KNEE", "SLOPE", "OFFSET", "SCALE", "POWER"):
        info.define(f"SRGB_{name}", repr(getattr(srgb, name)))
    info.vertex_in(0, "VEC2", "corner")
    interface = gpu.types.GPUStageInterfaceInfo("physhdr_overlay")
    interface.smooth("VEC2", "at")
    info.vertex_out(interface)
    info.push_constant("MAT4", "picture_to_clip")
    # Together less than 128 bytes: what every GPU has room for.
    info.push_constant("VEC4", "size_and_centre")  # width, height, cx, cy
    info.push_constant("VEC4", "focal_and_tone")  # fx, fy, first ln(exposure), step
    info.push_constant("FLOAT", "plane_depth")
    info.push_constant("INT", "flags")
    for flag in Flag:
        info.define(str(flag.name), str(flag.value))
    info.sampler(0, "FLOAT_2D", "picture")
    info.sampler(1, "FLOAT_2D", "picture_depth")
    info.sampler(2, "FLOAT_2D", "tone_curve")
    info.sampler(3, "FLOAT_2D", "frustums")
    for name in ("INSIDE", "OUTSIDE", "LEAST"):
        info.define(name, repr(getattr(seen, name)))
    info.fragment_out(0, "VEC4", "result")
    info.depth_write("ANY")
    info.vertex_source(_VERTEX)
    info.fragment_source(_FRAGMENT)
    return gpu.shader.create_from_info(info)
