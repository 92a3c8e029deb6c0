# SPDX-License-Identifier: GPL-3.0-or-later
"""A splat's limits: the numbers on which everything that draws Gaussians agrees, so that all pictures agree.

The trainer's rasterisers, the 3D view's shaders and the nodes that Cycles and EEVEE render take them from
here. They are those of gsplat 1.5 (``csrc/*.cu``, ``rendering.py``) and, but for the largest alpha and the
near plane, of 3DGS (``cuda_rasterizer/forward.cu``, ``auxiliary.h``: 0.99 and 0.2 m). What is done with each
stands in ``backend/rasterize/contract.py``.
"""

#: Added to both variances of a projected Gaussian, pixel²: EWA's low-pass filter, a pixel wide. Opacity is
#: not lowered in return.
LOW_PASS = 0.3
#: No Gaussian hides more of what is behind it: its gradient would have a division by zero.
ALPHA_MAX = 0.999
#: Below this alpha a Gaussian is not drawn: half of what an 8-bit picture could show. It ends a splat, at
#: √(2 ln 255) = 3.33 standard deviations where the opacity is 1.
ALPHA_MIN = 1.0 / 255.0
#: A pixel is finished before a Gaussian would bring its transmittance to this or below.
TRANSMITTANCE_MIN = 1e-4
#: The projection's Jacobian is taken no farther outside the picture than this, in half fields of view.
JACOBIAN_MARGIN = 0.3
#: Gaussians whose centre is nearer than this, metres along the optical axis, are not drawn.
NEAR_PLANE = 0.01
