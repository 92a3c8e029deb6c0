# SPDX-License-Identifier: GPL-3.0-or-later
import zipfile
from pathlib import Path

import pytest

#: What other programs wrote, and which of them; see made.txt in it.
FIXTURES = Path(__file__).resolve().parents[2] / "fixtures" / "splat_files.zip"


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the files that other programs wrote, all of the Gaussians in ``source.ply``."""
    folder = tmp_path_factory.mktemp("splat_files")
    with zipfile.ZipFile(FIXTURES) as archive:
        archive.extractall(folder)
    return folder
