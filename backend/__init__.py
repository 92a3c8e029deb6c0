# SPDX-License-Identifier: GPL-3.0-or-later
"""The trainer: reads data sets, trains, evaluates, exports. Torch lives here and nowhere else."""

import os

# OpenMP's threads must sleep while they wait: when they spin, a busy machine slows torch tenfold
# (shared/rasterisation.md section 3). It has to be said before torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
