# SPDX-License-Identifier: GPL-3.0-or-later
"""README.md, docs/ and lab/: links lead somewhere, and files and names that pages mention exist."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "lab").rglob("*.md")])
#: Folders of the repository, by whose names a path in a page is known to be one of it.
FOLDERS = "addon|backend|benchmarks|bridge|docs|lab|locks|synth|tests|tools"

LINK = re.compile(r"!?\[[^\]]*\]\(([^()\s]+)\)")
#: `backend/train/losses.py` or `backend/simd/`; what has a star or a blank is a pattern or a command.
MENTION = re.compile(rf"`((?:{FOLDERS})/[\w./†+-]*)`")
#: `backend/model/radiance.py`: `ProductComposer`, `LearnedComposer`
NAMES = re.compile(rf"`((?:{FOLDERS})/[\w./]+\.py)`: ((?:`\w+(?:\.\w+)?`(?:, )?)+)")


def page_id(page: Path) -> str:
    return str(page.relative_to(ROOT))


def prose(page: Path) -> str:
    """The page without its blocks of code."""
    return re.sub(r"^( *)```.*?^\1```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """What a link to one of its headings may say, as GitHub makes it of them."""
    headings = re.findall(r"^#+ +(.+?)\s*$", prose(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_there_are_pages() -> None:
    assert {"README.md", "docs/architecture.md", "docs/method.md"} <= {page_id(page) for page in PAGES}


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_every_link_leads_somewhere(page: Path) -> None:
    for target in LINK.findall(prose(page)):
        if re.match(r"[a-z]+:", target):
            continue  # another site
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists() and file.is_relative_to(ROOT), f"{target}: there is no such file"
        assert not anchor or anchor in anchors(file), f"{target}: there is no such heading"


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_every_file_that_is_named_exists(page: Path) -> None:
    for name in MENTION.findall(prose(page)):
        if not Path(name).name.startswith("my_"):  # a file that the reader of the page is to write
            assert (ROOT / name).exists(), f"{name} does not exist"


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_what_is_named_beside_a_file_stands_in_it(page: Path) -> None:
    for file, names in NAMES.findall(prose(page)):
        source = (ROOT / file).read_text(encoding="utf-8")
        for name in re.findall(r"[\w.]+", names):
            if name.endswith(".py"):
                assert (ROOT / file).with_name(name).is_file(), f"there is no {name} beside {file}"
            else:
                for part in name.split("."):
                    assert re.search(rf"\b{part}\b", source), f"{file} has no {name}"


def test_pictures_are_shown_and_small() -> None:
    text = "".join(prose(page) for page in PAGES)
    for picture in (ROOT / "docs" / "images").rglob("*.*"):
        assert picture.name in text, f"no page shows {picture.name}"
        assert picture.stat().st_size < 2_000_000, f"{picture.name} is too large for a page"
