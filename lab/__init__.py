# SPDX-License-Identifier: GPL-3.0-or-later
"""Compares and doubts: other methods, plans of many runs, and the reports on them.

It stands on ``backend/``, which knows of it by entry points alone (``backend/tables.py``).
"""
