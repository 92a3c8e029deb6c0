# SPDX-License-Identifier: GPL-3.0-or-later
"""The capture as a light: probes, the world that they make, CG that stands in it."""
