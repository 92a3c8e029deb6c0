# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr export``: what is refused before anything is read or written."""

from pathlib import Path

import pytest

from physhdr.backend.cli.export import Export
from physhdr.bridge.errors import BadValueError


@pytest.mark.parametrize("exposure_ev", [2000.0, -31.0, float("inf"), float("nan")])
def test_an_exposure_beyond_all_pictures_is_refused(tmp_path: Path, exposure_ev: float) -> None:
    with pytest.raises(BadValueError, match=r"EV[\s\S]*−30 to 30"):
        Export(tmp_path, exposure_ev=exposure_ev).run()
