# SPDX-License-Identifier: GPL-3.0-or-later
"""Methods × scenes × settings × seeds × budgets, each trained and evaluated in a process of its own.

A ``plan`` says what; the ``schedule`` has each ``job`` done by a pool, here or on a Ray cluster, and ``runs``
knows what is there already; ``search`` finds the iterations of a budget in CPU seconds; ``report`` tells all.
"""
