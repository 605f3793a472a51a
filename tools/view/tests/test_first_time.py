"""The time that `decouplegs view --time` shows first, on the page."""

import json

import pytest
from viewer_page import Viewer


def test_the_viewer_shows_a_time_first(street, episode, tmp_path, open_page):
    shown = "() => document.getElementById('clock').textContent"
    with Viewer(tmp_path, street / "scene.toml", "--time", "0.7") as viewer:
        page = open_page(viewer)
        assert page.newest()["time_s"] == pytest.approx(0.7) and page.page.evaluate(shown) == "0.70 s"
        page.page.wait_for_function("() => location.hash.includes('time=0.7')")
        assert page.page.evaluate("() => viewer.state.change.span_s[0]") == 0
        # A link that was opened before has its own time.
        page.after(lambda: page.page.evaluate("() => { location.hash = location.hash.replace('time=0.7', 'time=0.2'); }"))
        assert page.newest()["time_s"] == pytest.approx(0.2)
    report = json.loads((episode / "run/report.json").read_text())["episodes"][0]
    crash_s = report["infractions"][0]["time_s"]
    with Viewer(episode, report["log"], "--time", str(crash_s)) as viewer:
        page = open_page(viewer)
        assert page.newest()["time_s"] == pytest.approx(crash_s, abs=1e-3)
        assert page.page.evaluate(shown) == f"{crash_s:.2f} s"
