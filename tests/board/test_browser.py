"""The live page in a browser: driven through a whole calibration, as wide as a desk's screen and as a phone's, light
and dark. `--basetemp` keeps the pictures where one can look at them."""

from __future__ import annotations

import json
import re
import signal
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("selenium", reason="needs the extra `test`")

from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from tautline.live.setup import open_live
from tautline.live.until import calibrate_until
from tautline.model import Effect, Model
from tautline.simulated.instrument import preset
from tools import browser as tool

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not tool.there(), reason="no chromium with its driver: tools/setup browser"),
]

# WCAG 2.1: contrast of text, and of large or bold text on buttons.
CONTRAST = """
const linear = (v) => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
const light = (c) => { const [r, g, b] = c.map((v) => linear(v / 255));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
const parts = (text) => text.match(/[\\d.]+/g).map(Number);
const behind = (e) => { for (; e; e = e.parentElement) { const c = parts(getComputedStyle(e).backgroundColor);
  if (c.length < 4 || c[3] > 0) return c.slice(0, 3); } return [255, 255, 255]; };
return [...document.querySelectorAll("h1, h2, p, li, dt, dd, strong, button:enabled, figcaption")].filter((e) =>
  e.offsetWidth && e.textContent.trim() && e.id !== "nothing").map((e) => {
  const [a, b] = [parts(getComputedStyle(e).color).slice(0, 3), behind(e)].map(light).sort((x, y) => y - x);
  return [(a + 0.05) / (b + 0.05), e.textContent.trim().slice(0, 30)]; });
"""
OVERFLOW = """
return [...document.querySelectorAll("body *")].filter((e) => !e.closest("svg") && e.offsetWidth &&
  e.getBoundingClientRect().right > document.documentElement.clientWidth + 1).map((e) => e.id || e.tagName);
"""


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1200, 400])
def test_a_whole_calibration_by_the_page(tmp_path: Path, width: int, dark: bool) -> None:
    name = f"{width}-{'dark' if dark else 'light'}"
    model = tmp_path / "model"
    with (
        tool.page("--simulate", "--seed", "3", "--out", model) as (address, process),
        tool.browser(width, dark) as seen,
    ):
        seen.get(address)
        canvas = seen.find_element(By.ID, "picture")
        tool.until(lambda: "the marker is at" in (canvas.get_attribute("aria-label") or ""))
        u, v = (float(n.strip(", px")) for n in canvas.get_attribute("aria-label").split(" at ")[1].split(",")[:2])
        scale = canvas.size["width"] / int(canvas.get_attribute("width"))
        middle = canvas.size["width"] / 2, canvas.size["height"] / 2
        at = round(u * scale - middle[0]), round(v * scale - middle[1])
        ActionChains(seen).move_to_element_with_offset(canvas, *at).click().perform()
        tool.until(lambda: tool.text(seen, "says").startswith("the marker is"))
        assert not seen.find_element(By.ID, "stop").is_enabled()
        tool.press(seen, "start")
        tool.until(lambda: bool(seen.find_elements(By.CSS_SELECTOR, "#backlash .curve")))
        tool.press(seen, "rest")
        tool.until(lambda: tool.text(seen, "doing") == "at rest")
        tool.whole_page(seen, width, tmp_path / f"rest-{name}.png")
        assert re.search("B is (not measured|measured only) from", tool.text(seen, "missing"))
        tool.press(seen, "start")
        tool.until(lambda: tool.text(seen, "state") == "ready")
        assert tool.text(seen, "says").startswith("done: sigma of B(q) is")
        assert tool.text(seen, "verdict").startswith("good") and tool.text(seen, "missing") == "nothing"
        assert len(seen.find_elements(By.CSS_SELECTOR, "#backlash path.up, #backlash path.down")) > 10
        told = seen.find_element(By.ID, "backlash").get_attribute("aria-label")
        tool.whole_page(seen, width, tmp_path / f"done-{name}.png")
        assert seen.execute_script(OVERFLOW) == []
        assert min(seen.execute_script(CONTRAST))[0] >= 4.5, min(seen.execute_script(CONTRAST))
        assert seen.get_log("browser") == []
        process.send_signal(signal.SIGINT)
        assert process.wait(20.0) == 0
    found = Model.load(model)
    width_there = preset("reference", seed=3).backlash(found.q)
    inside = (found.q >= found.measured[0]) & (found.q <= found.measured[1])
    assert abs(found.width - width_there)[inside].max() < 0.02
    assert f"B(q) from {found.measured[0]:.3g} to {found.measured[1]:.3g} mm" in told


def test_stop_and_the_keyboard(tmp_path: Path) -> None:
    """Escape stops; a marker is picked by arrow keys and Enter; the recording that is left can be played."""
    with tool.page("--simulate", "--out", tmp_path / "model") as (address, _), tool.browser(800) as seen:
        seen.get(address)
        canvas = seen.find_element(By.ID, "picture")
        tool.until(lambda: "the marker is at" in (canvas.get_attribute("aria-label") or ""))
        u, v = (float(n.strip(", px")) for n in canvas.get_attribute("aria-label").split(" at ")[1].split(",")[:2])
        right, down = (
            round((goal - 0.5 * int(canvas.get_attribute(size))) / 8) for goal, size in ((u, "width"), (v, "height"))
        )
        keys = (Keys.ARROW_RIGHT if right > 0 else Keys.ARROW_LEFT) * abs(right)
        keys += (Keys.ARROW_DOWN if down > 0 else Keys.ARROW_UP) * abs(down)
        canvas.send_keys(keys + Keys.ENTER)
        tool.until(lambda: tool.text(seen, "says").startswith("the marker is"))
        tool.press(seen, "start")
        tool.until(lambda: tool.text(seen, "doing").startswith("round 1"))
        ActionChains(seen).send_keys(Keys.ESCAPE).perform()
        tool.until(lambda: tool.text(seen, "state") == "ready")
        assert "the axis is at rest" in tool.text(seen, "says")
    assert not (tmp_path / "model").exists()
    with tool.page(tmp_path / "model-recording", "--pace", "20") as (address, _), tool.browser(800) as seen:
        seen.get(address)
        tool.press(seen, "start")
        tool.until(lambda: "was played" in tool.text(seen, "says"))
        assert tool.text(seen, "verdict") != "none yet"
        assert json.loads(seen.execute_script("return JSON.stringify(document.body.className)")) == "replay"


@pytest.mark.parametrize(("width", "dark"), [(1200, False), (400, True)], ids=["1200-light", "400-dark"])
def test_a_diagnosis_by_the_page(tmp_path: Path, width: int, dark: bool) -> None:
    """A lag that came after the calibration, until it is sure or no motion helps."""
    with open_live(simulate="reference", seed=3) as live:
        found, _ = calibrate_until(live, tmp_path / "calibration")
    late = Effect("transmission.lag", {"lag": 0.12, "lag_second": 0.0})
    replace(found.model, effects=(late,)).save(tmp_path / "lagging")
    words = "--simulate", tmp_path / "lagging", "--diagnose", tmp_path / "calibration", "--out", tmp_path / "found"
    with tool.page(*words) as (address, process), tool.browser(width, dark) as seen:
        seen.get(address)
        tool.press(seen, "start")
        tool.until(lambda: tool.text(seen, "doing").startswith("recording"))
        assert not seen.find_element(By.ID, "rest").is_displayed()
        assert tool.text(seen, "cause") == "nothing was recorded yet"
        tool.until(lambda: tool.text(seen, "state") == "ready")
        tool.whole_page(seen, width, tmp_path / f"diagnosis-{width}.png")
        names = [e.text for e in seen.find_elements(By.CSS_SELECTOR, "#answers dt")]
        assert names[0] == "transmission.lag" and "transmission.lag" in tool.text(seen, "cause")
        assert tool.text(seen, "led").startswith("after recording 1:")
        assert seen.execute_script(OVERFLOW) == []
        assert min(seen.execute_script(CONTRAST))[0] >= 4.5, min(seen.execute_script(CONTRAST))
        assert seen.get_log("browser") == []
        process.send_signal(signal.SIGINT)
        assert process.wait(20.0) == 0
    assert (tmp_path / "found" / "report.html").is_file()
