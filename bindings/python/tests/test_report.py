# SPDX-License-Identifier: Apache-2.0
"""The report of a solve, as a browser shows it."""

from __future__ import annotations

import os
import pathlib
import re
import shutil
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

import clba
from clba import __main__, _plot_data, plot

PLOTS = ("convergence", "residuals", "image-residuals", "scene", "timing")

# Lengths of the traces that are shown, and how many pixels of the plot are neither white nor grey.
LOOK = """
const [name, done] = arguments;
const plot = document.getElementById(name);
const traces = plot._fullData.filter(trace => trace.visible).map(trace => trace.x.length);
Plotly.toImage(plot, {format: "png", width: 800, height: 400}).then(url => {
    const image = new Image();
    image.onload = () => {
        const canvas = document.createElement("canvas");
        canvas.width = 800;
        canvas.height = 400;
        const context = canvas.getContext("2d", {willReadFrequently: true});
        context.drawImage(image, 0, 0);
        const rgba = context.getImageData(0, 0, 800, 400).data;
        let coloured = 0;
        for (let i = 0; i < rgba.length; i += 4) {
            const pixel = rgba.slice(i, i + 3);
            coloured += rgba[i + 3] > 0 && Math.max(...pixel) - Math.min(...pixel) > 40;
        }
        done([traces, coloured]);
    };
    image.src = url;
});
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("no chromium and chromedriver; Debian: chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in (
        "headless",
        "no-sandbox",
        "disable-gpu",
        "disable-quic",
        "no-first-run",
        "disable-background-networking",
        "disable-component-update",
        "disable-sync",
        "enable-unsafe-swiftshader",
        "window-size=1200,900",
        f"user-data-dir={tmp_path_factory.mktemp('chromium')}",
    ):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    chrome = webdriver.Chrome(options=options, service=Service(driver))
    chrome.set_script_timeout(120)
    yield chrome
    chrome.quit()


@pytest.fixture
def file(hall: clba.Problem, tmp_path: pathlib.Path) -> pathlib.Path:
    path = tmp_path / "hall & <co>.txt"
    hall.to_bal(path)
    return path


def errors(browser: webdriver.Chrome) -> list[Any]:
    return [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def test_command(
    file: pathlib.Path, hall: clba.Problem, browser: webdriver.Chrome, tmp_path: pathlib.Path
) -> None:
    page = tmp_path / "report.html"
    json = tmp_path / "log.json"
    arguments = ["solve", str(file), "--quiet", "--json", str(json), "--report", str(page)]
    assert __main__.main(arguments) == 0
    assert not list(tmp_path.glob(".*"))
    browser.get(page.as_uri())
    assert browser.title == "hall & <co>.txt"
    assert browser.find_element(By.TAG_NAME, "h1").text == "hall & <co>.txt"
    assert browser.find_element(By.CLASS_NAME, "outcome").text.startswith("Converged. Function to")
    numbers = {}
    for name in PLOTS:
        numbers[name], coloured = browser.execute_async_script(LOOK, name)
        assert coloured > 500, name
    rows = json.read_text(encoding="utf-8").count('"iteration":')
    assert numbers["convergence"] == [rows] * 4
    assert numbers["residuals"] == [_plot_data.NUM_BINS + 1] * 2
    assert numbers["image-residuals"] == [hall.num_images] * 2
    assert numbers["timing"] == [7, 7]
    points, frusta, centers = numbers["scene"]
    assert 0.9 * hall.num_points < points <= hall.num_points
    assert (frusta, centers) == (14 * hall.num_images, hall.num_images)
    assert browser.execute_script("return performance.getEntriesByType('resource').length") == 0
    assert errors(browser) == []


def test_buttons_of_the_scene(
    hall: clba.Problem, browser: webdriver.Chrome, tmp_path: pathlib.Path
) -> None:
    before = plot.State.of(hall)
    plot.report(tmp_path / "a.html", clba.solve(hall), hall, before)
    browser.get((tmp_path / "a.html").as_uri())
    visible = "return document.getElementById('scene').data.map(trace => trace.visible)"
    assert browser.execute_script(visible) == [False] * 3 + [True] * 3
    buttons = browser.find_elements(By.CSS_SELECTOR, "#scene .updatemenu-button")
    assert [button.text for button in buttons] == ["After", "Before", "Both"]
    for button, expected in ((1, [True] * 3 + [False] * 3), (2, [True] * 6)):
        browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", buttons[button])
        buttons[button].click()
        assert browser.execute_script(visible) == expected
        lengths, coloured = browser.execute_async_script(LOOK, "scene")
        assert len(lengths) == sum(expected) and min(lengths) >= hall.num_images
        assert coloured > 500
    assert errors(browser) == []


def test_a_large_scene_says_what_is_drawn(
    hall: clba.Problem,
    browser: webdriver.Chrome,
    tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_plot_data, "MAX_POINTS", 50)
    plot.report(tmp_path / "a.html", clba.solve(hall), hall)
    browser.get((tmp_path / "a.html").as_uri())
    note = browser.find_element(By.CSS_SELECTOR, "#scene .annotation-text").text
    assert note.startswith(f"50 of {hall.num_points} points, chosen at random.")


def test_the_page_needs_nothing_else(hall: clba.Problem, tmp_path: pathlib.Path) -> None:
    plot.report(tmp_path / "a.html", clba.solve(hall), hall, title="</title><script>alert(1)")
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "&lt;/title&gt;&lt;script&gt;alert(1)" in text and "<script>alert" not in text
    assert not re.search(r"<(script|img|link)[^>]*(src|href)=\"(?!data:)", text)
    # The library has a button that uploads the data.
    assert len(re.findall(r'"showSendToCloud": ?false', text)) == len(PLOTS)


def test_errors_come_before_the_solve(
    file: pathlib.Path,
    tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def solve(*_arguments: object, **_options: object) -> None:
        raise AssertionError("it was solved")

    monkeypatch.setattr(clba, "solve", solve)
    arguments = ["solve", str(file), "--report"]
    assert __main__.main([*arguments, str(tmp_path / "none/a.html")]) == 4
    assert "its folder does not exist" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "plotly", None)
    assert __main__.main([*arguments, str(tmp_path / "a.html")]) == 2
    assert "pip install clba[plot]" in capsys.readouterr().err


def test_a_failed_write_leaves_the_old_report(
    file: pathlib.Path,
    tmp_path: pathlib.Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = tmp_path / "a.html"
    page.write_text("old", encoding="utf-8")

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    assert __main__.main(["solve", str(file), "--quiet", "--report", str(page)]) == 4
    assert "a.html: cannot be written: No space left on device" in capsys.readouterr().err
    assert page.read_text(encoding="utf-8") == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.html", file.name]
