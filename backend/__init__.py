# SPDX-License-Identifier: GPL-3.0-or-later
"""The trainer: reads data sets, trains, evaluates, exports. Torch lives here and nowhere else."""

import os
import platform

# OpenMP's threads must sleep while they wait: when they spin, a busy machine slows torch tenfold (measured on
# two busy cores: SSIM of a picture of 400×400 650 ms instead of 75, a step of Adam 200 ms instead of 10). It
# has to be said before torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# NumPy's and SciPy's linear algebra takes every core, whatever number of threads we are asked for, and its
# threads spin, too; nothing here is worth a second one (measured on two busy cores: 24 systems of 256
# unknowns 0.2 CPU seconds on one thread, 3.3 on two). Torch's own is another library, but for ARM.
if platform.machine() in ("x86_64", "AMD64"):
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
