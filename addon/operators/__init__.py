# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators of the panels and of scripts, one file a subject."""
