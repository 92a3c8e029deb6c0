# SPDX-License-Identifier: GPL-3.0-or-later
"""Other programs' files of Gaussians that need more than numpy: SOG, glTF and USD.

Those that Python alone can read, and Blender's importer therefore too, are in ``bridge/splat_files/``.
"""
