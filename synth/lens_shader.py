# SPDX-License-Identifier: GPL-3.0-or-later
"""A ``Lens`` as a camera of Cycles: a shader in OSL that gives the ray of each point of the picture.

Cycles asks where the ray of a pixel goes, so the lens is run backward: Newton's method in float32, whose
rounding leaves 0.0001 pixels at a width of 800 (the same steps in numpy; rendered: tests/synth/test_lens.py).
Cycles' camera has z forward and y up; its raster runs from 0 to 1 in both directions from the lower left.
"""

import hashlib
import tempfile
from pathlib import Path
from typing import Any

import bpy

from .errors import RenderError
from .lens import COEFFICIENTS, FISHEYE, ITERATIONS, Lens
from .progress import quiet

SOURCE = f"""
shader physhdr_lens(
    int fisheye = 0,
    float fx = 1, float fy = 1, float cx = 0.5, float cy = 0.5,
    float c1 = 0, float c2 = 0, float c3 = 0, float c4 = 0,
    output point position = 0,
    output vector direction = 0,
    output color throughput = 1)
{{
  point raster = camera_shader_raster_position();
  float p = (raster.x - cx) / fx;
  float q = (1 - raster.y - cy) / fy;
  if (fisheye) {{
    float wanted = sqrt(p * p + q * q);
    float t = wanted;
    for (int i = 0; i < {ITERATIONS}; i++) {{
      float s = t * t;
      float off = t * (1 + s * (c1 + s * (c2 + s * (c3 + s * c4)))) - wanted;
      t -= off / (1 + s * (3 * c1 + s * (5 * c2 + s * (7 * c3 + s * 9 * c4))));
    }}
    float across = wanted > 0 ? sin(t) / wanted : 1;
    direction = vector(p * across, -q * across, cos(t));
  }}
  else {{
    float a = p, b = q;
    for (int i = 0; i < {ITERATIONS}; i++) {{
      float s = a * a + b * b;
      float radial = 1 + s * (c1 + s * c2);
      float slope = 2 * (c1 + 2 * s * c2);
      float da = a * radial + 2 * c3 * a * b + c4 * (s + 2 * a * a) - p;
      float db = b * radial + c3 * (s + 2 * b * b) + 2 * c4 * a * b - q;
      float aa = radial + a * a * slope + 2 * c3 * b + 6 * c4 * a;
      float ab = a * b * slope + 2 * c3 * a + 2 * c4 * b;
      float bb = radial + b * b * slope + 6 * c3 * b + 2 * c4 * a;
      float area = aa * bb - ab * ab;
      a -= (bb * da - ab * db) / area;
      b -= (aa * db - ab * da) / area;
    }}
    direction = normalize(vector(a, -b, 1));
  }}
}}
"""


def mount(lens: Lens, camera: bpy.types.Camera) -> None:
    """Let ``camera`` see through ``lens``; its own focal length and shift no longer matter.

    Raises:
        RenderError: this Blender's Cycles has no OSL, or does not compile ours.
    """
    if not bpy.app.build_options.cycles_osl:
        raise RenderError(
            "this Blender was built without OSL, which a lens needs", "use blender.org's Blender"
        )
    code = _compiled()
    camera.type = "CUSTOM"
    camera.custom_mode = "INTERNAL"
    camera.custom_bytecode, camera.custom_bytecode_hash = code, hashlib.sha256(SOURCE.encode()).hexdigest()
    settings: Any = camera.cycles_custom  # whose properties are the shader's parameters
    settings["fisheye"] = int(lens.model == FISHEYE)
    for name, value in (
        ("fx", lens.fx / lens.width),
        ("fy", lens.fy / lens.height),
        ("cx", lens.cx / lens.width),
        ("cy", lens.cy / lens.height),
        *((f"c{k + 1}", lens.coefficients[k]) for k in range(len(COEFFICIENTS[lens.model]))),
    ):
        settings[name] = float(value)
    camera.update_tag()


def _compiled() -> str:
    """The shader's byte code."""
    import _cycles  # of Cycles, and not there at all in a Blender without it

    with tempfile.TemporaryDirectory(prefix="physhdr-lens-", ignore_cleanup_errors=True) as made:
        source, target = Path(made) / "lens.osl", Path(made) / "lens.oso"
        source.write_text(SOURCE, encoding="utf-8")
        with quiet():
            done = _cycles.osl_compile(str(source), str(target))
        if not done or not target.exists():
            raise RenderError("Cycles does not compile the lens", "its console says why: report it")
        return target.read_text(encoding="utf-8")
