# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests/stress/torture.py does to PhysHDR, and how it finds out whether PhysHDR withstood it."""
