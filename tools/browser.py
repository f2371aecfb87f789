"""A browser without a window, to look at the live page as a person would: Debian's chromium, driven by selenium.

`tools/setup browser` gets chromium and its driver.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.chrome.webdriver import WebDriver
from selenium.webdriver.common.by import By

_OPTIONS = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--hide-scrollbars",
)  # fmt: skip
_WAIT_S = 600.0  # a whole calibration, on a machine with other work


def there() -> bool:
    return bool(shutil.which("chromium") and shutil.which("chromedriver"))


@contextmanager
def browser(width_px: int, dark: bool = False) -> Iterator[WebDriver]:
    """A new browser with no past, which sends nothing but what the page asks for."""
    with TemporaryDirectory() as profile:
        options = webdriver.ChromeOptions()
        for option in (*_OPTIONS, f"--user-data-dir={profile}"):
            options.add_argument(option)
        options.binary_location = shutil.which("chromium") or ""
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        driver = webdriver.Chrome(options, Service(shutil.which("chromedriver")))
        try:
            _size(driver, width_px, 900)
            scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
            driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
            yield driver
        finally:
            driver.quit()


def _size(driver: WebDriver, width_px: int, height_px: int) -> None:
    size = {"width": width_px, "height": height_px, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def whole_page(driver: WebDriver, width_px: int, file: Path) -> None:
    """A PNG of all of the page."""
    height = driver.execute_script("return document.documentElement.scrollHeight")
    _size(driver, width_px, height)
    time.sleep(0.5)  # it is drawn again
    driver.save_screenshot(str(file))
    _size(driver, width_px, 900)


def text(driver: WebDriver, element: str) -> str:
    return str(driver.find_element(By.ID, element).text)


def press(driver: WebDriver, element: str) -> None:
    """As a person would: TimeoutError where the button cannot be pressed."""
    button = driver.find_element(By.ID, element)
    until(button.is_enabled)
    button.click()


def until(holds: Callable[[], bool]) -> None:
    """Waits; TimeoutError where it never holds."""
    deadline = time.monotonic() + _WAIT_S
    while not holds():
        if time.monotonic() > deadline:
            raise TimeoutError("the page never came so far")
        time.sleep(0.05)


@contextmanager
def page(*words: str | Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """`taut live` with these words in a process of its own: the page's address, and the process."""
    command = [sys.executable, "-m", "tautline", "live", *map(str, words)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            line = process.stderr.readline()
            if "http://" not in line:
                raise RuntimeError(f"no page is served: {line}")
            yield line.split()[1], process
        finally:
            process.terminate()
