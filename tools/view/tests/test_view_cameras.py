"""Cameras, links, commands, measures and camera paths of the page of `decouplegs view`."""

import json
import math
import os
import shlex
import subprocess

import pytest
from viewer_page import PROGRAM, Viewer, np, run

CAMERA = "() => structuredClone(window.viewer.state.panes[0].camera)"
CLIPBOARD = {"permissions": ["clipboard-read", "clipboard-write"]}


def drag(page, dx, dy):
    box = page.page.query_selector(".view").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x + dx, y + dy, steps=3)
    page.page.mouse.up()


def open_details(page):
    page.page.evaluate("() => document.querySelectorAll('details').forEach((one) => (one.open = true))")


def test_a_link_holds_camera_and_time_and_survives_a_reload(street, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer, **CLIPBOARD)
        page.choose("Camera of view 1", "orbit")
        page.choose("Image kind of view 1", "depth")
        page.after(lambda: page.page.keyboard.press("."))
        page.after(lambda: drag(page, 60, 20))
        page.page.wait_for_function("() => location.hash.includes('a.kind=depth')")
        before = page.page.evaluate(CAMERA), page.pixels()
        page.page.wait_for_timeout(700)
        link = page.page.evaluate("() => location.href")
        assert "token" not in link
        page.page.click("#copy-link")
        page.page.wait_for_function("() => !document.getElementById('notice').hidden")
        assert page.page.evaluate("() => navigator.clipboard.readText()") == link
        # Another time, another camera: the link brings both back, in this page and after a reload.
        page.choose("Camera of view 1", "birds-eye")
        page.after(lambda: page.page.keyboard.press("End"))
        page.page.evaluate("(link) => { location.href = link; }", link)
        page.page.wait_for_function("() => window.viewer.state.panes[0].choice === 'orbit'")
        page.wait(lambda frame: abs(frame["time_s"] - 0.1) < 1e-9)
        page.at_rest()
        assert (page.page.evaluate(CAMERA), page.pixels()) == before
        page.page.reload()
        page.at_rest()
        assert (page.page.evaluate(CAMERA), page.pixels()) == before
        assert page.page.input_value("[aria-label='Image kind of view 1']") == "depth"
        # What makes no sense is said, and harms nothing.
        for bad in ("#a=nowhere", "#a=orbit&a.far=-1", "#a=orbit&a.focus=1,2", "#a=fly&a.fov=1e9&time=x", "#a=fly&a.at=1,NaN,2"):
            page.page.evaluate("(bad) => { location.hash = bad; }", bad)
            page.page.wait_for_selector("#notice.fault:not([hidden])")
            assert "does not fit" in page.notice()
            page.page.click("#notice .close")
            page.at_rest()


def test_two_views_are_in_a_link(street, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer)
        page.after(lambda: page.page.keyboard.press("p"))
        page.choose("Camera of view 2", "named:front")
        page.page.wait_for_function("() => location.hash.includes('b=named')")
        page.page.reload()
        page.at_rest()
        assert len(page.newest()["panes"]) == 2
        assert page.page.input_value("[aria-label='Camera of view 2']") == "named:front"


def test_field_of_view_and_speed_follow_the_panel(street, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer)
        page.choose("Camera of view 1", "orbit")
        first = page.page.evaluate(CAMERA)
        page.after(lambda: page.page.locator("#fov").fill("30"))
        assert page.page.evaluate(CAMERA)["fov"] == 30
        camera = page.newest()["panes"][0]
        shown = 2 * math.degrees(math.atan(camera["size_px"][1] / 2 / camera["focal_px"][1]))
        assert shown == pytest.approx(30)
        page.after(lambda: page.page.click("#reset"))
        assert page.page.evaluate(CAMERA) == first
        page.page.keyboard.press("+")
        assert page.page.input_value("#fly-speed") == "2"
        page.page.keyboard.press("-")
        page.page.keyboard.press("-")
        assert page.page.input_value("#fly-speed") == "0.5"
        # A camera of the scene keeps its field of view when it is moved, and all of a rig has none.
        page.choose("Camera of view 1", "named:front")
        own = float(page.page.input_value("#fov"))
        page.after(lambda: drag(page, 40, 0))
        assert page.page.evaluate(CAMERA)["fov"] == pytest.approx(own, abs=0.5)
        page.choose("Camera of view 1", "rig")
        assert page.page.is_disabled("#fov")


def test_axes_in_the_corner_turn_the_camera(street, open_page):
    def forward(frame):
        """Unit vector in which the camera of the first view looks."""
        x, y, z, w = frame["panes"][0]["pose"]["rotation"]
        return [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]

    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer)
        page.choose("Camera of view 1", "orbit")
        focus = page.page.evaluate(CAMERA)["focus"]
        sides = {"X": [-1, 0, 0], "\u2212Y": [0, 1, 0], "Z": [0, 0, -1]}
        for name, towards in sides.items():
            # Ends may cover each other: keys reach all of them.
            end = page.page.get_by_role("button", name=f"Look from {name}", exact=True)
            frame = page.after(lambda: end.press("Enter"))
            assert forward(frame) == pytest.approx(towards, abs=1e-6)
            assert page.page.evaluate(CAMERA)["focus"] == focus
        # From above, the end of z is in the middle, in front of the others, and that of x in the image.
        places = page.page.evaluate("""() => Object.fromEntries([...document.querySelectorAll(".axes .end")].map((end) => {
            const { x, y, width } = end.getBoundingClientRect();
            return [end.title, [x, y, width, Number(end.style.zIndex)]];
        }))""")
        middle, below, beside = places["Look from Z"], places["Look from \u2212Z"], places["Look from X"]
        assert middle[:2] == pytest.approx(below[:2], abs=0.1) and middle[3] > below[3]
        assert math.hypot(beside[0] - middle[0], beside[1] - middle[1]) == pytest.approx(32, abs=0.1)
        assert middle[2] >= 24
        # A camera of the rig circles around what it saw.
        page.choose("Camera of view 1", "named:front")
        frame = page.after(lambda: page.page.get_by_role("button", name="Look from Z", exact=True).press("Enter"))
        assert page.page.input_value("[aria-label='Camera of view 1']") == "orbit"
        assert forward(frame) == pytest.approx([0, 0, -1], abs=1e-6)
        page.page.uncheck("#layer-axes")
        assert page.page.locator(".axes").is_hidden()


def test_saved_images_and_copied_commands_are_the_image(street, tmp_path, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer, **CLIPBOARD)
        page.choose("Camera of view 1", "follow")
        page.after(lambda: page.page.keyboard.press("."))
        with page.page.expect_download() as saved:
            page.page.keyboard.press("o")
        assert saved.value.suggested_filename == "scene_follow_0.10s.png"
        file = tmp_path / "saved.png"
        saved.value.save_as(file)
        assert page.decoded(file) == page.pixels()
        page.page.click("#copy-command")
        page.page.wait_for_function("() => document.getElementById('notice').textContent.includes('command')")
        command = shlex.split(page.page.evaluate("() => navigator.clipboard.readText()"))
        assert command[:2] == ["decouplegs", "render"]
        subprocess.run([PROGRAM, *command[1:]], cwd=tmp_path, check=True, capture_output=True)
        assert page.decoded(tmp_path / "image" / "view.png") == page.pixels()
        # Another view is another image.
        other = page.pixels()
        page.after(lambda: page.page.keyboard.press("."))
        assert page.pixels() != other
        # An image that is asked for while something plays is that of the moment at which it stands.
        page.page.click("#play")
        page.wait(lambda frame: frame["playing"])
        with page.page.expect_download() as saved:
            page.page.click("#save-image")
        saved.value.save_as(file)
        page.at_rest()
        assert page.decoded(file) == page.pixels()


def test_a_page_without_a_clipboard_shows_what_is_copied(street, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer)
        page.page.evaluate("() => { navigator.clipboard.writeText = () => Promise.reject(new Error('no')); }")
        page.page.click("#copy-command")
        page.page.wait_for_selector("#copy-dialog[open]")
        assert page.page.input_value("#copy-text").startswith("decouplegs render ")
        page.page.keyboard.press("Escape")
        assert page.page.is_hidden("#copy-dialog")


def test_distances_and_angles_are_measured_by_mouse_and_keyboard(street, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer)
        said = page.page.locator("#measure-said")
        page.page.keyboard.press("u")
        assert "Click a place" in said.inner_text()
        box = page.page.query_selector(".view").bounding_box()
        shares = [(0.3, 0.75), (0.7, 0.75), (0.55, 0.85)]
        for index, (x, y) in enumerate(shares):
            page.page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
            page.page.wait_for_function("(words) => document.getElementById('measure-said').textContent.includes(words)", arg=["second", "third", "angle"][index])
        picked = page.page.evaluate(
            """async (shares) => {
                const { ask } = await import("/page/state.js");
                const { stream, image } = window.viewer.state.panes[0].views[0];
                const places = [];
                for (const at of shares) places.push((await ask("pick", { stream, at })).position_m);
                return places;
            }""",
            shares,
        )
        a, b, c = (np.array(place) for place in picked)
        words = said.inner_text()
        first, second = np.linalg.norm(a - b), np.linalg.norm(b - c)
        assert float(words.split(" m")[0]) == pytest.approx(first, rel=0.02)
        assert float(words.split("), ")[1].split(" m")[0]) == pytest.approx(second, rel=0.02)
        u, v = a - b, c - b
        angle = math.degrees(math.acos(np.dot(u, v) / np.linalg.norm(u) / np.linalg.norm(v)))
        assert float(words.split("angle ")[1].rstrip("°")) == pytest.approx(angle, abs=1)
        # No agent was chosen meanwhile, and lines are drawn.
        assert page.page.inner_text("#selected").startswith("Click an agent")
        yellow = "() => { const c = document.querySelectorAll('.view canvas')[3]; const { data } = c.getContext('2d').getImageData(0, 0, c.width, c.height); let n = 0; for (let i = 0; i < data.length; i += 4) n += data[i] > 240 && data[i + 1] > 180 && data[i + 2] < 120 && data[i + 3] > 200; return n; }"
        assert page.page.evaluate(yellow) > 200
        if folder := os.environ.get("VIEW_SCREENSHOTS"):
            page.page.screenshot(path=f"{folder}/measure.png")
        page.page.keyboard.press("Backspace")
        assert "third place" in said.inner_text()
        page.page.click("#measure-clear")
        page.page.evaluate("() => document.activeElement.blur()")
        page.page.keyboard.press("Enter")
        page.page.wait_for_function("() => document.getElementById('measure-said').textContent.includes('second')")
        page.page.keyboard.press("Escape")
        page.page.click("#measure-clear")
        assert said.inner_text() == "" and page.page.evaluate(yellow) == 0


def test_a_camera_path_is_made_saved_opened_and_rendered(street, tmp_path, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer)
        open_details(page)
        page.choose("Camera of view 1", "orbit")
        for dx in (0, 80, 80):
            page.after(lambda: drag(page, dx, 5) if dx else page.page.keyboard.press("Home"))
            page.page.keyboard.press("i")
            page.after(lambda: page.page.keyboard.press("."))
        keys = page.page.locator("#keyframes li")
        assert keys.count() == 3
        # What is refused is not changed: all cameras together are no key.
        page.choose("Camera of view 1", "rig")
        page.page.click("#path-add")
        assert keys.count() == 3 and "one camera" in page.notice()
        with page.page.expect_download() as saved:
            page.page.click("#path-save")
        file = tmp_path / saved.value.suggested_filename
        saved.value.save_as(file)
        written = json.loads(file.read_text())
        assert [round(key["time_s"], 6) for key in written["keys"]] == [0, 0.1, 0.2]
        page.page.click("#path-clear")
        assert keys.count() == 0 and page.page.is_disabled("#record-path")
        page.page.set_input_files("#path-file", file)
        page.page.wait_for_function("() => document.querySelectorAll('#keyframes li').length === 3")
        # A dropped file is opened too; one that is no path is refused.
        page.drop("other.json", b"{}")
        page.page.wait_for_function("() => document.getElementById('notice').textContent.includes('other.json is no camera path')")
        assert keys.count() == 3
        two = {**written, "keys": written["keys"][:2]}
        page.drop("two.json", json.dumps(two).encode())
        page.page.wait_for_function("() => document.querySelectorAll('#keyframes li').length === 2")
        page.page.set_input_files("#path-file", file)
        page.page.wait_for_function("() => document.querySelectorAll('#keyframes li').length === 3")
        # A key is gone to, with its time; the preview ends at the last.
        page.after(lambda: keys.nth(1).locator("button").first.click())
        pose = page.newest()["panes"][0]["pose"]
        assert pose["position_m"] == pytest.approx(written["keys"][1]["position_m"])
        assert page.newest()["time_s"] == pytest.approx(0.1)
        page.page.click("#path-preview")
        page.wait(lambda frame: abs(frame["time_s"] - 0.2) < 1e-9)
        page.at_rest()
        # Recorded and rendered, each time is the same image.
        page.page.check("#record-path")
        page.page.fill("#record-folder", "along")
        page.page.fill("#record-rate", "5")
        page.page.click("#record")
        page.page.wait_for_function("() => document.getElementById('record-said').textContent.includes('2 images')")
        shown = page.newest()["panes"][0]["size_px"]
        size = "x".join(str(side) for side in shown)
        run("render", street / "scene.toml", "--camera-path", file, "--rate", 5, "--size", size, "--out", tmp_path / "out")
        images = [page.decoded(tmp_path / "out" / f"path_{index:05}.png") for index in (0, 1)]
        recorded = [page.decoded(street / "along" / f"view0000_{index:05}.png") for index in (0, 1)]
        assert images == recorded and images[0] != images[1]


def test_the_page_asks_for_nothing_beyond_the_viewer(street, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer, **CLIPBOARD)
        asked = []
        page.page.on("request", lambda request: asked.append(request.url))
        page.page.reload()
        page.at_rest()
        page.page.click("#save-image")
        page.page.click("#copy-link")
        host = viewer.url.split("?")[0]
        assert asked and all(url.startswith((host, "blob:" + host, "data:")) for url in asked), asked


def test_what_says_nothing_about_splats_is_hidden(street, open_page):
    with Viewer(street, "background.ply") as viewer:
        page = open_page(viewer, width=390, height=844, has_touch=True)
        for hidden in ("footer", "#agents-panel", "#edit", "#score", "#layer-lanes", "#layer-plan", "#layer-boxes"):
            assert page.page.is_hidden(hidden), hidden
        image = page.page.query_selector(".view").bounding_box()
        assert image["height"] > 0.5 * 844 and image["width"] == 390
        assert page.page.evaluate("() => document.documentElement.scrollWidth") <= 390
        small = page.page.evaluate(
            """() => [...document.querySelectorAll("header button, aside .row button")]
                .filter((one) => one.offsetParent).map((one) => [one.id, one.getBoundingClientRect().height]).filter(([, height]) => height < 36)"""
        )
        assert small == []
        if folder := os.environ.get("VIEW_SCREENSHOTS"):
            page.page.screenshot(path=f"{folder}/splats-390.png")
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer)
        for shown in ("footer", "#agents-panel", "#layer-lanes", "#layer-boxes"):
            assert page.page.is_visible(shown), shown
        assert page.page.is_hidden("#layer-plan")


def test_any_quantity_of_an_episode_is_plotted(episode, open_page):
    with Viewer(episode, "run/logs/hard_0000.log", "--against", "other/logs/hard_0000.log") as viewer:
        page = open_page(viewer)
        choices = page.page.locator("#quantity option").all_inner_texts()
        assert "Acceleration, m/s²" in choices and "Distance to the nearest agent, m" in choices
        curves = page.page.locator("#chart path.quantity")
        assert curves.count() == 0
        page.page.select_option("#quantity", label="Distance to the nearest agent, m")
        assert curves.count() == 2
        assert page.page.inner_text("#quantity-now").endswith(" m")
        if folder := os.environ.get("VIEW_SCREENSHOTS"):
            page.page.screenshot(path=f"{folder}/quantity.png")
        page.page.select_option("#quantity", "")
        assert curves.count() == 0


def test_views_are_saved_and_returned_to_without_a_keyboard(street, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer, width=390, height=844, has_touch=True)
        open_details(page)
        page.choose("Camera of view 1", "orbit")
        pose = page.newest()["panes"][0]["pose"]
        page.page.click("#bookmark")
        page.choose("Camera of view 1", "birds-eye")
        page.page.click("#bookmark")
        saved = page.page.locator("#bookmarks button")
        assert saved.all_inner_texts() == ["View 1", "View 2"]
        page.after(lambda: saved.first.click())
        assert page.newest()["panes"][0]["pose"] == pose
        for _ in range(7):
            page.page.click("#bookmark")
        assert saved.count() == 9 and page.page.is_disabled("#bookmark")
