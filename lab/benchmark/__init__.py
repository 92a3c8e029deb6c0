# SPDX-License-Identifier: GPL-3.0-or-later
"""Methods × scenes × settings × seeds × budgets, each trained and evaluated in a process of its own.

A ``plan`` says what; the ``schedule`` hands each ``job`` to a pool, here or on a Ray cluster, and ``runs``
knows which results exist; ``search`` finds the iterations of a budget in CPU seconds; ``report`` sums up.
"""
