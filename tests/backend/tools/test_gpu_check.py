# SPDX-License-Identifier: GPL-3.0-or-later
"""``make gpu-check`` without a card: every line but the kernels, and that a wrong side is found."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from physhdr.backend.rasterize import reference
from physhdr.bridge import splatting

ROOT = Path(__file__).resolve().parents[3]


def gpu_check(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    # From elsewhere and isolated from this process: the check brings the package with it.
    return subprocess.run(
        [sys.executable, str(ROOT / "tools" / "gpu_check.py"), *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        check=False,
    )


@pytest.mark.long
@pytest.mark.parametrize("packages", ["all", "bare"])
def test_the_whole_check_can_be_rehearsed(packages, tmp_path):
    """By the reference and, where it is installed, by Warp's kernels on the CPU, against the CPU's own; and
    where nothing but torch, NumPy and Warp is installed."""
    bare = ["--bare"] if packages == "bare" else ["--profile"]
    done = gpu_check("--rehearse", *bare, "--json", tmp_path / "out.json", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith("all comparisons hold\n")
    assert ("numba" in done.stdout.splitlines()[0]) == (packages == "bare")
    reports = json.loads((tmp_path / "out.json").read_text())
    of_warp = reports.get("rehearsal by Warp")
    for report in filter(None, (reports["rehearsal"], of_warp)):
        errors = {finding["what"]: finding["error"] for finding in report["parity"]}
        assert "10 channels: gradient of quaternions" in errors
        assert "paper: gradient of composer.network.w1" in errors
        assert all(finding["passed"] for finding in report["parity"])
        if packages == "all" or report is of_warp:  # two implementations: equal to rounding, not to the bit
            assert 0 < max(error for what, error in errors.items() if "gradient" in what) < 1e-4
        measured = {figure["what"] for figure in report["figures"]}
        assert {"default: LDR pictures", "paper: 30000 such iterations"} <= measured
    if of_warp:
        errors = {finding["what"]: finding["error"] for finding in of_warp["parity"]}
        assert errors["sorted accumulation: numbers that differ the second time"] == 0.0
        measured = {figure["what"] for figure in of_warp["figures"]}
        assert "60 Gaussians, 16×16, 6 channels: with sorted accumulation" in measured


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a card")
def test_without_a_card_it_says_so_in_one_line(tmp_path):
    done = gpu_check(cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "skipped: torch sees no CUDA device\n")


def test_a_side_that_draws_otherwise_is_found(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    from card import parity
    from card.side import Side, oracle

    def failures() -> set[str]:
        side = Side("rehearsal", torch.device("cpu"), "reference", plain=True)
        findings = parity.rasteriser(side, oracle(True), 60, 3)
        return {finding.what for finding in findings if not finding.passed}

    assert failures() == set()
    # A rasteriser that leaves out faint edges.
    monkeypatch.setattr(reference, "ALPHA_MIN", 4 * splatting.ALPHA_MIN)
    assert {"3 channels: picture", "3 channels: gradient of means"} <= failures()
