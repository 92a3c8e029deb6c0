# SPDX-License-Identifier: GPL-3.0-or-later
"""The trainer: reads data sets, trains, evaluates, exports. Torch lives here and nowhere else."""

import os

# OpenMP's threads must sleep while they wait: when they spin, a busy machine slows torch tenfold (measured on
# two busy cores: SSIM of a picture of 400×400 650 ms instead of 75, a step of Adam 200 ms instead of 10). It
# has to be said before torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
