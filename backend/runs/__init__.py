# SPDX-License-Identifier: GPL-3.0-or-later
"""A run's folder: who holds it, and what lies in it."""
