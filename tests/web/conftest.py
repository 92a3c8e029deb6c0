# SPDX-License-Identifier: GPL-3.0-or-later
"""A headless Chromium for the tests of web pages; without one they are skipped, with the reason."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

#: What a Chromium is called, as distributions and vendors have it.
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
#: Drawn by the processor, the same on every machine; --no-sandbox, because root has no other way.
ARGUMENTS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
#: Milliseconds that a page has to load, draw and be still.
PATIENCE = 120_000


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--shot", type=Path, help="also write the picture of the demo's page for README.md here")


class Page:
    """One opened page: ``told`` is what it wrote on the console, and its errors."""

    def __init__(self, page: Any) -> None:
        self.page, self.told = page, []
        page.on("console", lambda message: self.told.append(message.text))
        page.on("pageerror", lambda error: self.told.append(str(error)))
        page.on("request", lambda request: self.asked.append(request.url))
        self.asked: list[str] = []

    def open(self, url: str) -> str:
        """Go there and wait until it has drawn, or has said why not; which it was."""
        self.page.goto(url)
        return self.still()

    def still(self) -> str:
        """Wait until the page is still; ``settled`` or ``failed``."""
        self.page.wait_for_selector(
            "html[data-state=settled], html[data-state=failed]", state="attached", timeout=PATIENCE
        )
        return self.page.get_attribute("html", "data-state")

    def slide(self, name: str, value: float) -> None:
        """Move a slider to a value, as a hand does: its own events tell the page."""
        slider = self.page.locator(f"#{name}")
        slider.evaluate(
            "(e, v) => { e.value = v; e.dispatchEvent(new Event('input', { bubbles: true })); }", str(value)
        )

    def picture(self) -> bytes:
        """A PNG of the picture alone, once it is still."""
        self.page.wait_for_timeout(100)
        self.page.locator("#picture").focus()
        self.page.keyboard.press("h")
        self.still()
        shot = self.page.screenshot()
        self.page.keyboard.press("h")
        return shot


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A running browser."""
    sync_api = pytest.importorskip(
        "playwright.sync_api", reason="needs Playwright: pip install playwright (the extra web-test)"
    )
    with sync_api.sync_playwright() as playwright:
        own = playwright.chromium.executable_path
        found = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
        found = found or (own if Path(own).is_file() else None)
        if found is None:
            pytest.skip(
                "there is no Chromium: install it (Debian: apt install chromium), or set CHROMIUM=path"
            )
        browser = playwright.chromium.launch(executable_path=found, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture
def visit(chromium) -> Iterator[Any]:
    """``visit(width, height)`` gives an empty page of that size, of one who likes no motion: nothing fades or
    flies. Other options are Playwright's."""
    contexts = []

    def visit(width: int, height: int, **options: Any) -> Page:
        options = {"reduced_motion": "reduce"} | options
        contexts.append(chromium.new_context(viewport={"width": width, "height": height}, **options))
        return Page(contexts[-1].new_page())

    yield visit
    for context in contexts:
        context.close()
