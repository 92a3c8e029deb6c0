# SPDX-License-Identifier: GPL-3.0-or-later
"""A data set of the open scene: what the dialog asks, shows, and runs."""
