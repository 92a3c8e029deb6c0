# SPDX-License-Identifier: GPL-3.0-or-later
"""The costly small parts of an iteration for a card without a compiler, in NVIDIA Warp.

What is here is what plain torch would do in many launches over much memory (lab/performance.md counts them):
spherical harmonics, networks, SSIM. The rest of an iteration is plain torch. Functions of ``backend.kernels``
come here by themselves where ``plain.card_takes`` says so; imported then, for warp-lang may not be installed.
"""
