"""report.html in a real browser: nothing fails, every picture is shown, the certificate can be read."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dualms.measure.certificate import Check
from dualms.page import readable
from tests.dualms.bodies import build_box
from tests.dualms.shapes import end_ports, small_spec

pytestmark = pytest.mark.browser

DESKTOP, PHONE = (1200, 900), (390, 800)
REQUIRED = {"min_passage_m": 0.001, "max_overhang_fraction": 1e-9}  # one that is met, one that cannot be


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small design whose certificate fails on one line."""
    folder = tmp_path_factory.mktemp("page")
    spec = small_spec(
        end_ports(),
        graph={"sites": 32},
        field={"method": "phase-field", "resolution": 40},
        surface={"resolution": 48},
        require=REQUIRED,
    )
    build_box(folder, spec)
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless Chromium, the machine's own."""
    playwright = pytest.importorskip("playwright.sync_api")
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        pytest.skip("no Chromium is installed")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(params=[DESKTOP, PHONE], ids=["desktop", "phone"])
def opened(request: pytest.FixtureRequest, browser: Any, folder: Path) -> Iterator[tuple[Any, list[str]]]:
    """The page, and what went wrong or was asked of the network while it was opened."""
    width, height = request.param
    page = browser.new_page(viewport={"width": width, "height": height})
    page_url, trouble = (folder / "report.html").as_uri(), []
    page.on("console", lambda message: trouble.append(f"console: {message.text}"))
    page.on("pageerror", lambda error: trouble.append(f"error: {error}"))
    page.on("requestfailed", lambda asked: trouble.append(f"failed: {asked.url[:80]}"))
    page.on(
        "request", lambda asked: asked.url.startswith(("data:", page_url)) or trouble.append(f"asked: {asked.url[:80]}")
    )
    page.goto(page_url, wait_until="load")
    yield page, trouble
    page.close()


def test_nothing_fails_and_nothing_is_fetched(opened: tuple[Any, list[str]]) -> None:
    page, trouble = opened
    assert page.title()
    assert trouble == []


def test_every_picture_is_shown(opened: tuple[Any, list[str]]) -> None:
    page, _ = opened
    pictures = page.locator("img").all()
    assert len(pictures) == 3  # preview, sections, maps
    for picture in pictures:
        picture.scroll_into_view_if_needed()
        natural, shown = picture.evaluate("i => [i.naturalWidth, i.getBoundingClientRect().width]")
        assert natural > 100
        assert shown > 0.7 * page.viewport_size["width"]
        assert picture.get_attribute("alt")


def test_the_certificate_can_be_read_line_by_line(opened: tuple[Any, list[str]], folder: Path) -> None:
    page, _ = opened
    checks = json.loads((folder / "report.json").read_text())["certificate"]
    rows = page.locator("section#certificate table tr").all()[1:]
    assert len(rows) == len(checks) > 20
    for row, check in zip(rows, checks, strict=True):
        name, value, limit, verdict = row.locator("td").all()
        assert row.is_visible()
        assert (name.inner_text(), value.inner_text(), limit.inner_text()) == readable(Check.model_validate(check))
        assert value.bounding_box()["height"] == limit.bounding_box()["height"]
        assert verdict.inner_text() == ("pass" if check["passed"] else "fail")
        assert float(name.evaluate("e => parseFloat(getComputedStyle(e).fontSize)")) >= 13
        colour = verdict.evaluate("e => getComputedStyle(e).color")
        assert _contrast(colour) > 4.5, colour  # WCAG 2, level AA, on white


def test_what_fails_stands_on_top(opened: tuple[Any, list[str]]) -> None:
    page, _ = opened
    assert page.locator("h1 .badge").inner_text() == "certificate fails"
    told = page.locator("main > p.fail")
    assert "required: overhang share" in told.inner_text()
    assert told.bounding_box()["y"] < page.viewport_size["height"]


def test_the_page_does_not_scroll_sideways(opened: tuple[Any, list[str]]) -> None:
    page, _ = opened
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]


def _contrast(colour: str) -> float:
    """Contrast of an ``rgb(…)`` colour to white, by WCAG 2."""
    channels = [int(part) / 255 for part in colour.removeprefix("rgb(").removesuffix(")").split(",")]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 1.05 / (0.05 + sum(k * c for k, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True)))
