# SPDX-License-Identifier: GPL-3.0-or-later
"""What ``tests/stress/fuzz.py`` is made of: bad inputs, what takes them, and processes that may die of it."""
