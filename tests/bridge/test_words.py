# SPDX-License-Identifier: GPL-3.0-or-later
"""Words that both sides tell people."""

import pytest

from physhdr.bridge.words import counted


@pytest.mark.parametrize(("count", "told"), [(0, "0 views"), (1, "1 view"), (2, "2 views")])
def test_one_has_no_plural(count, told):
    assert counted(count, "view") == told
