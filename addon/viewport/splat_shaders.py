# SPDX-License-Identifier: GPL-3.0-or-later
"""GLSL that draws Gaussians as the trainer's rasterisers do (backend/rasterize/contract.py).

Two programs. ``projection`` runs once for each Gaussian when the camera or the light changed (a fragment
each): where it is on the screen, its two axes in pixels, its radiance toward the camera. ``drawing`` puts a
triangle for each into the picture, the farthest first.
"""

import gpu

from ...bridge import spherical_harmonics as sh
from ...bridge import splatting
from .splat_data import WIDTH

#: Bits of ``counts.w``.
DEGREE, ORTHOGRAPHIC, HAS_LEVELS = 3, 4, 8

_FULL_SCREEN = """
void main()
{
  gl_Position = vec4(corner, 0.0, 1.0);
}
"""

_PROJECTION = """
/* Σ_k≥1 sh_k Y_k(ω), in the order and with the signs of bridge/spherical_harmonics.py. */
vec3 harmonics_at(ivec2 texel, vec3 w, int degree)
{
  vec3 total = vec3(0.0);
  if (degree >= 1) {
    total += -C1 * w.y * texelFetch(harmonics, ivec3(texel, 0), 0).rgb;
    total += C1 * w.z * texelFetch(harmonics, ivec3(texel, 1), 0).rgb;
    total += -C1 * w.x * texelFetch(harmonics, ivec3(texel, 2), 0).rgb;
  }
  float xx = w.x * w.x, yy = w.y * w.y, zz = w.z * w.z;
  if (degree >= 2) {
    total += C2_0 * w.x * w.y * texelFetch(harmonics, ivec3(texel, 3), 0).rgb;
    total += C2_1 * w.y * w.z * texelFetch(harmonics, ivec3(texel, 4), 0).rgb;
    total += C2_2 * (2.0 * zz - xx - yy) * texelFetch(harmonics, ivec3(texel, 5), 0).rgb;
    total += C2_3 * w.x * w.z * texelFetch(harmonics, ivec3(texel, 6), 0).rgb;
    total += C2_4 * (xx - yy) * texelFetch(harmonics, ivec3(texel, 7), 0).rgb;
  }
  if (degree >= 3) {
    float ring = 4.0 * zz - xx - yy;
    total += C3_0 * w.y * (3.0 * xx - yy) * texelFetch(harmonics, ivec3(texel, 8), 0).rgb;
    total += C3_1 * w.x * w.y * w.z * texelFetch(harmonics, ivec3(texel, 9), 0).rgb;
    total += C3_2 * w.y * ring * texelFetch(harmonics, ivec3(texel, 10), 0).rgb;
    total += C3_3 * w.z * (2.0 * zz - 3.0 * (xx + yy)) * texelFetch(harmonics, ivec3(texel, 11), 0).rgb;
    total += C3_4 * w.x * ring * texelFetch(harmonics, ivec3(texel, 12), 0).rgb;
    total += C3_5 * w.z * (xx - yy) * texelFetch(harmonics, ivec3(texel, 13), 0).rgb;
    total += C3_6 * w.x * (xx - 3.0 * yy) * texelFetch(harmonics, ivec3(texel, 14), 0).rgb;
  }
  return total;
}

/* Rᵀ v of a unit quaternion wxyz. */
vec3 into_object(vec4 q, vec3 v)
{
  vec3 t = 2.0 * cross(v, q.yzw);
  return v + q.x * t + cross(t, q.yzw);
}

void main()
{
  vec2 focal = lens.xy, centre = lens.zw, size = size_and_blend.xy;
  float level_blend = size_and_blend.z;
  vec3 eye = eye_and_gain.xyz;
  int first_row = counts.x, count = counts.y;
  bool is_orthographic = (counts.w & ORTHOGRAPHIC) != 0, has_levels = (counts.w & HAS_LEVELS) != 0;

  ivec2 texel = ivec2(int(gl_FragCoord.x), int(gl_FragCoord.y) - first_row);
  out_place = vec4(0.0);
  out_axes = vec4(0.0);
  out_radiance = vec4(0.0);
  if (texel.y * WIDTH + texel.x >= count) {
    return;
  }
  vec4 place = texelFetch(geometry, ivec3(texel, 0), 0);
  vec4 rotation = texelFetch(geometry, ivec3(texel, 1), 0);
  vec3 scale = texelFetch(geometry, ivec3(texel, 2), 0).xyz;
  vec3 in_camera = (object_to_camera * vec4(place.xyz, 1.0)).xyz;
  if (place.w < ALPHA_MIN || (!is_orthographic && in_camera.z < NEAR_PLANE)) {
    return;
  }

  /* Rows of the projection's Jacobian; far off the picture it is taken at the margin. */
  vec3 row_x = vec3(focal.x, 0.0, 0.0), row_y = vec3(0.0, focal.y, 0.0);
  vec2 on_plane = in_camera.xy;
  if (!is_orthographic) {
    float z = in_camera.z;
    on_plane /= z;
    vec2 margin = JACOBIAN_MARGIN * 0.5 * size / focal;
    vec2 limited = clamp(on_plane, -(centre / focal + margin), (size - centre) / focal + margin);
    row_x = vec3(focal.x, 0.0, -focal.x * limited.x) / z;
    row_y = vec3(0.0, focal.y, -focal.y * limited.y) / z;
  }
  /* A = J W R S, so that the covariance on the screen is A Aᵀ; its rows. */
  mat3 linear = mat3(object_to_camera);
  vec3 a = into_object(rotation, row_x * linear) * scale;
  vec3 b = into_object(rotation, row_y * linear) * scale;
  float xx = dot(a, a), xy = dot(a, b), yy = dot(b, b);
  /* |a × b|² is det(A Aᵀ) without the cancellation of xx yy − xy². */
  vec3 normal = cross(a, b);
  float determinant = dot(normal, normal) + LOW_PASS * (xx + yy) + LOW_PASS * LOW_PASS;
  float half_difference = 0.5 * (xx - yy);
  float radius = length(vec2(half_difference, xy));
  float largest = 0.5 * (xx + yy) + radius + LOW_PASS;
  float smallest = determinant / largest;
  vec2 main_axis = half_difference >= 0.0 ? vec2(half_difference + radius, xy)
                                          : vec2(xy, radius - half_difference);
  float axis_length = length(main_axis);
  main_axis = axis_length > 0.0 ? main_axis / axis_length : vec2(1.0, 0.0);

  vec3 direction = is_orthographic ? eye : normalize(place.xyz - eye);
  vec3 log_radiance = C0 * texelFetch(geometry, ivec3(texel, 3), 0).rgb;
  log_radiance += harmonics_at(texel, direction, counts.w & DEGREE);
  vec3 radiance;
  if (has_levels) {
    vec3 low = texelFetch(light, ivec3(texel, counts.z), 0).rgb;
    vec3 high = texelFetch(light, ivec3(texel, counts.z + int(level_blend > 0.0)), 0).rgb;
    radiance = exp(log_radiance + mix(low, high, level_blend));
  }
  else {
    vec3 gain = texelFetch(light, ivec3(texel, 0), 0).rgb;
    for (int k = 0; k < counts.z; k++) {
      gain += texelFetch(levels, ivec2(k, 0), 0).r * texelFetch(light, ivec3(texel, k + 1), 0).rgb;
    }
    radiance = exp(log_radiance) * gain;
  }

  out_place = vec4(focal * on_plane + centre, in_camera.z, place.w);
  out_axes = vec4(main_axis * sqrt(largest), vec2(-main_axis.y, main_axis.x) * sqrt(smallest));
  /* The picture is half float: no infinity may get in. */
  out_radiance = vec4(min(radiance * eye_and_gain.w, vec3(65000.0)), sqrt(2.0 * log(place.w / ALPHA_MIN)));
}
"""

_TRIANGLE = """
void main()
{
  int rank = first + gl_VertexID / 3;
  float entry = texelFetch(order, ivec2(rank % WIDTH, rank / WIDTH), 0).r;
  bool is_selected = entry < 0.0;
  int index = int(is_selected ? -1.0 - entry : entry);
  ivec2 texel = ivec2(index % WIDTH, index / WIDTH);
  vec4 place = texelFetch(projected_place, texel, 0);
  vec4 axes = texelFetch(projected_axes, texel, 0);
  vec4 shine = texelFetch(projected_radiance, texel, 0);
  opacity = place.w;
  depth = place.z;
  radiance = shine.rgb;
  if (is_selected) {
    /* In shades of the tint, whatever the radiance and the exposure are. */
    float bright = dot(radiance, vec3(0.2126, 0.7152, 0.0722));
    radiance = tint * (0.3 + 0.7 * bright / (1.0 + bright));
  }
  /* The triangle encloses where alpha is 1/255 or more: so many standard deviations along the two axes. */
  vec2 pixel = place.xy + shine.w * (corner.x * axes.xy + corner.y * axes.zw);
  /* As gl_FragCoord counts, from the bottom left. */
  centre = vec2(place.x, size.y - place.y);
  per_pixel = vec4(axes.xy / dot(axes.xy, axes.xy), axes.zw / dot(axes.zw, axes.zw));
  per_pixel *= vec4(1.0, -1.0, 1.0, -1.0);
  vec2 clip = 2.0 * pixel / size - 1.0;
  /* Not drawn: outside the clip volume. */
  gl_Position = opacity > 0.0 ? vec4(clip.x, -clip.y, 0.0, 1.0) : vec4(2.0, 2.0, 2.0, 1.0);
}
"""

_BLENDED = """
void main()
{
  /* For each pixel: what a GPU interpolates is only as exact as it snaps corners, often to 1/256 pixel. */
  vec2 away = gl_FragCoord.xy - centre;
  vec2 deviations = vec2(dot(away, per_pixel.xy), dot(away, per_pixel.zw));
  float alpha = min(ALPHA_MAX, opacity * exp(-0.5 * dot(deviations, deviations)));
  if (alpha < ALPHA_MIN) {
    discard;
  }
  out_colour = vec4(radiance * alpha, alpha);
  out_depth = vec4(depth * alpha, 0.0, 0.0, alpha);
}
"""


def create_projection() -> gpu.types.GPUShader:
    info = _new_info()
    info.define("C0", repr(sh.C0))
    info.define("C1", repr(sh.C1))
    for name, constants in (("C2", sh.C2), ("C3", sh.C3)):
        for index, value in enumerate(constants):
            info.define(f"{name}_{index}", f"({value!r})")
    info.push_constant("MAT4", "object_to_camera")
    # With the matrix 128 bytes: what every GPU has room for.
    info.push_constant("VEC4", "lens")  # fx, fy, cx, cy
    info.push_constant("VEC4", "size_and_blend")  # width, height, blend of two levels, nothing
    # The camera's place, or an orthographic camera's direction of view, in the object's space; 2^EV.
    info.push_constant("VEC4", "eye_and_gain")
    # First row, Gaussians, lower level or number of lights, SH degree and flags.
    info.push_constant("IVEC4", "counts")
    for name in ("DEGREE", "ORTHOGRAPHIC", "HAS_LEVELS"):
        info.define(name, str(globals()[name]))
    for slot, name in enumerate(("geometry", "harmonics", "light")):
        info.sampler(slot, "FLOAT_2D_ARRAY", name)
    info.sampler(3, "FLOAT_2D", "levels")
    for slot, name in enumerate(("out_place", "out_axes", "out_radiance")):
        info.fragment_out(slot, "VEC4", name)
    info.vertex_source(_FULL_SCREEN)
    info.fragment_source(_PROJECTION)
    return gpu.shader.create_from_info(info)


def create_drawing() -> gpu.types.GPUShader:
    info = _new_info()
    interface = gpu.types.GPUStageInterfaceInfo("physhdr_splat")
    interface.flat("VEC2", "centre")  # pixels
    interface.flat("VEC4", "per_pixel")  # the two axes, standard deviations for each pixel along them
    interface.flat("VEC3", "radiance")
    interface.flat("FLOAT", "opacity")
    interface.flat("FLOAT", "depth")
    info.vertex_out(interface)
    info.push_constant("VEC2", "size")
    info.push_constant("INT", "first")
    info.push_constant("VEC3", "tint")
    info.sampler(0, "FLOAT_2D", "order")
    for slot, name in enumerate(("projected_place", "projected_axes", "projected_radiance"), 1):
        info.sampler(slot, "FLOAT_2D", name)
    info.fragment_out(0, "VEC4", "out_colour")
    info.fragment_out(1, "VEC4", "out_depth")
    info.vertex_source(_TRIANGLE)
    info.fragment_source(_BLENDED)
    return gpu.shader.create_from_info(info)


def _new_info() -> gpu.types.GPUShaderCreateInfo:
    info = gpu.types.GPUShaderCreateInfo()
    info.vertex_in(0, "VEC2", "corner")
    info.define("WIDTH", str(WIDTH))
    for name in ("LOW_PASS", "ALPHA_MAX", "ALPHA_MIN", "JACOBIAN_MARGIN", "NEAR_PLANE"):
        info.define(name, repr(getattr(splatting, name)))
    return info
