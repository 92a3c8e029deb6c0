# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that other processes do at the same time, on this machine or on those of a Ray cluster."""
