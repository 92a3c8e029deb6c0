# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface that a capture's Gaussians stand for: which way it faces."""
