# SPDX-License-Identifier: GPL-3.0-or-later
"""From a user's bracketed photos to a data set: exposures, brackets, cameras, pictures without distortion."""
