# SPDX-License-Identifier: GPL-3.0-or-later
"""The capture that a model is of: its data set's files and cameras, where it stands, its originals."""
