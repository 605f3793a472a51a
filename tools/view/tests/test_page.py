"""The page of `decouplegs view` in a headless browser: what is seen is what is rendered, with mouse and keyboard.

Needs playwright and Debian's chromium; without them the tests are skipped. Screenshots go to the folder VIEW_SCREENSHOTS, if it is set.
VIEW_SOAK_S=1800 runs the soak test for half an hour.
"""

import json
import os
import re
import time

import pytest
from viewer_page import KINDS, Viewer, np, run


def test_the_image_at_rest_is_that_of_render(street, tmp_path, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer)
        page.choose("Camera of view 1", "named:front")
        for _ in range(5):
            page.after(lambda: page.page.keyboard.press("."))
        assert page.newest()["time_s"] == pytest.approx(0.5)
        run("render", street / "scene.toml", "--time", "0.5", "--out", tmp_path)
        assert page.pixels() == page.decoded(tmp_path / "front.png")


def test_the_image_of_a_step_has_the_bits_of_the_log(episode, open_page):
    with Viewer(episode, "run/logs/hard_0000.log") as viewer:
        page = open_page(viewer)
        page.choose("Camera of view 1", "named:front")
        assert page.newest()["badge"] == "exact, same bits as the log"
        page.after(lambda: page.page.keyboard.press("."))
        assert page.newest()["badge"] == "exact, same bits as the log"
        # The first mark is the collision; there the score says what it cost.
        page.after(lambda: page.page.keyboard.press("m"))
        marked = page.page.locator("#events button").first.inner_text()
        assert marked.startswith(f"{page.newest()['time_s']:.1f} s: collision")
        assert "Driving score" in page.page.inner_text("#score")


def test_a_driver_of_alpasim_drives_and_its_plans_are_shown(episode, open_page):
    pytest.importorskip("carla_driver_interface", reason="the package carla-driver-interface is not installed")
    from carla_driver_interface.driver import BaseDriver, DriveResult
    from carla_driver_interface.geometry import Pose, Trajectory
    from carla_driver_interface.server import serving

    class Undecided(BaseDriver):
        """Goes straight on, and thinks about both sides."""

        name = "undecided"

        def drive(self, ctx):
            def to(side_m):
                plan = Trajectory.empty()
                for step in range(1, 31):
                    plan.append(ctx.time_now_us + 100_000 * step, Pose.from_xyz_yaw(0.6 * step, side_m * step / 30, 0.0, 0.0))
                return plan

            return DriveResult(trajectory_in_rig=to(0.0), sampled_trajectories_in_rig=[to(4.0), to(-4.0)])

    with serving(Undecided(), port=0, host="127.0.0.1", mode="alpasim") as port:
        planner = ["--planner", f"egodriver://127.0.0.1:{port}", "--driver-camera", "front=camera_front", "--size", "320x180"]
        with Viewer(episode, "run/scenarios/hard_0000.toml", *planner) as viewer:
            page = open_page(viewer)
            page.choose("Camera of view 1", "named:front")
            page.after(lambda: page.page.keyboard.press("."))
            page.after(lambda: page.page.keyboard.press("."))
            frame = page.shown()
            # Ten decisions a second.
            assert frame["time_s"] == pytest.approx(0.2)
            page.after(lambda: page.page.keyboard.press(","))
            source = page.newest()["sources"][0]
            left, right = source["alternatives"]
            assert len(left) == len(right) == len(source["plan"]) == 31
            across = [(a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 for a, b in zip(left, right)]
            assert across[-1] ** 0.5 == pytest.approx(8.0, abs=0.05)
            if folder := os.environ.get("VIEW_SCREENSHOTS"):
                page.page.screenshot(path=f"{folder}/driver.png")


def test_a_dragged_agent_is_saved_where_it_was_dropped(street, tmp_path, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer)
        mouse = page.page.mouse
        page.choose("Camera of view 1", "birds-eye")
        first = page.pixels()
        place = """() => {
            const { frame } = window.viewer;
            const [camera] = frame.panes;
            const agents = frame.sources[0].agents;
            const box = document.querySelector(".view").getBoundingClientRect();
            return import("/page/geometry.js").then((geometry) => {
                const shown = agents.map(({ name, pose }) => [name, geometry.project(camera, pose.position_m), pose.position_m]);
                const scale = box.width / camera.size_px[0];
                return shown.filter(([, at]) => at && at[0] > 60 && at[1] > 60 && at[0] < camera.size_px[0] - 60 && at[1] < camera.size_px[1] - 60)
                    .map(([name, at, position]) => [name, box.left + at[0] * scale, box.top + at[1] * scale, position]);
            });
        }"""
        name, x, y, before = page.page.evaluate(place)[0]
        mouse.click(x, y)
        page.page.wait_for_selector(f"#agents tr[data-name='{name}'] button[aria-pressed='true']")
        assert page.page.inner_text("#selected") == name
        page.wait(lambda frame: frame["badge"].startswith("exact"))
        mouse.move(x, y)
        mouse.down()
        for step in range(1, 6):
            mouse.move(x + step, y - 8 * step)
            time.sleep(0.05)
        mouse.up()
        page.page.wait_for_selector("#undo:not([disabled])")
        after = page.at_rest()
        moved = next(agent for agent in after["sources"][0]["agents"] if agent["name"] == name)
        by_m = [b - a for a, b in zip(before, moved["pose"]["position_m"])]
        assert 1 < abs(by_m[0]) + abs(by_m[1]) < 60
        page.page.fill("#save-name", "dragged.toml")
        page.page.click("#save")
        page.page.wait_for_selector("#notice:not([hidden])")
        assert "dragged.toml" in page.notice()
        page.choose("Camera of view 1", "named:back")
        run("render", street / "dragged.toml", "--time", "0", "--out", tmp_path)
        assert page.pixels() == page.decoded(tmp_path / "back.png")
        page.choose("Camera of view 1", "birds-eye")
        page.after(lambda: page.page.keyboard.press("Control+z"))
        assert page.pixels() == first
        (street / "dragged.toml").unlink()


def test_everything_is_done_by_keyboard(street, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer)
        keys = page.page.keyboard
        keys.press("Space")
        page.wait(lambda frame: frame["playing"] and frame["time_s"] > 0)
        keys.press("Space")
        page.wait(lambda frame: not frame["playing"] and frame["badge"].startswith("exact"))
        page.after(lambda: keys.press("End"))
        page.after(lambda: keys.press(","))
        page.after(lambda: keys.press("Home"))
        page.after(lambda: keys.press("c"))
        keys.press("Shift+Digit2")
        page.after(lambda: keys.press("v"))
        page.after(lambda: keys.press("2"))
        page.after(lambda: keys.press("p"))
        assert len(page.newest()["panes"]) == 2
        page.after(lambda: keys.press("p"))
        moved = page.newest()["panes"][0]["pose"]
        keys.down("w")
        time.sleep(0.3)
        keys.up("w")
        page.wait(lambda frame: frame["panes"][0]["pose"] != moved and frame["badge"].startswith("exact"))
        keys.press("?")
        assert page.page.locator("#keys").is_visible()
        # Its top is seen, also where the list is longer than the window.
        assert page.page.evaluate("() => document.activeElement.id") == "keys-title"
        keys.press("Escape")

        # Every control is reached by Tab, and its focus is seen.
        reached = set()
        for _ in range(80):
            keys.press("Tab")
            focused = page.page.evaluate(
                """() => {
                    const element = document.activeElement;
                    const style = getComputedStyle(element);
                    return [element.id || element.getAttribute("aria-label") || element.tagName, style.outlineStyle, element === document.body];
                }"""
            )
            if not focused[2]:
                assert focused[1] != "none", focused
                reached.add(focused[0])
        for control in ["play", "time", "two", "theme", "layer-boxes", "Camera of view 1", "speed"]:
            assert control in reached or control == (control, reached)
        # An agent is edited without a mouse.
        row = page.page.locator("#agents tbody tr").first.locator("button").first
        row.focus()
        keys.press("Enter")
        assert page.page.inner_text("#selected") != ""
        page.page.locator("#remove").focus()
        agents = len(page.newest()["sources"][0]["agents"])
        page.after(lambda: keys.press("Enter"))
        assert len(page.newest()["sources"][0]["agents"]) == agents - 1


@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_the_page_is_accessible(street, episode, open_page, scheme):
    axe = pytest.importorskip("axe_core_python.sync_playwright").Axe()
    for folder, what in [(street, ["scene.toml"]), (episode, ["run/logs/hard_0000.log", "--against", "other/logs/hard_0000.log"])]:
        with Viewer(folder, *what) as viewer:
            page = open_page(viewer, color_scheme=scheme, bypass_csp=True)
            page.page.evaluate("() => document.querySelectorAll('details').forEach((one) => (one.open = true))")
            if what == ["scene.toml"]:
                page.page.locator("#agents tbody button").first.click()
            found = axe.run(page.page)["violations"]
            assert [(one["id"], [node["target"] for node in one["nodes"]]) for one in found] == []


def test_an_episode_compared_with_itself_is_the_same(episode, open_page):
    log = "run/logs/hard_0000.log"
    with Viewer(episode, log, "--against", log) as viewer:
        page = open_page(viewer)
        page.after(lambda: page.page.keyboard.press("p"))
        # The name of a file is seen in a narrow menu; its folders are told beside it.
        content = page.page.locator("[aria-label='Content of view 1']")
        assert content.locator("option").all_inner_texts() == ["A: hard_0000.log", "B: hard_0000.log", "A and B"]
        assert content.get_attribute("title") == f"A: {log}\nB: {log}"
        page.choose("Content of view 1", "both")
        page.page.select_option("[aria-label='Comparison of view 1']", "difference")
        said = page.page.locator(".said").first
        assert said.inner_text() == "same bits"
        _, _, difference = page.pixels(canvas=2)
        assert len(difference) > 0 and not any(difference[i] for i in range(len(difference)) if i % 4 != 3)
        assert "A and B are the same" in page.page.inner_text("#score-words")
    with Viewer(episode, log, "--against", "other/logs/hard_0000.log") as viewer:
        page = open_page(viewer)
        page.after(lambda: page.page.keyboard.press("p"))
        page.choose("Content of view 1", "both")
        page.after(lambda: page.page.keyboard.press("End"))
        assert "dB" in page.page.locator(".said").first.inner_text()
        assert page.page.locator(".mark.parts").count() == 1


def test_overlays_lie_on_what_the_renderer_shows(street, tmp_path, open_page):
    run("render", street / "scene.toml", "--time", "0", "--boxes", "--force", "--out", tmp_path)
    boxes = json.loads((tmp_path / "boxes.json").read_text())
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer)
        page.choose("Camera of view 1", "rig")
        script = """async () => {
            const geometry = await import("/page/geometry.js");
            const { frame } = window.viewer;
            return frame.panes.map((camera) => frame.sources[0].agents.map((agent) => {
                const corners = geometry.corners(agent).map((corner) => geometry.project(camera, corner));
                return [agent.name, camera.lens?.kind ?? "pinhole", corners];
            }));
        }"""
        cameras = page.page.evaluate(script)
    compared = {"pinhole": 0, "fisheye": 0}
    for image, camera in zip(boxes["images"], cameras):
        seen = {agent["name"]: agent["amodal_px"] for agent in image["agents"]}
        for name, kind, corners in camera:
            if name not in seen or any(corner is None for corner in corners):
                continue
            xs, ys = zip(*corners)
            for mine, theirs in zip([min(xs), min(ys), max(xs), max(ys)], seen[name]):
                # Edges that a lens bends reach a little beyond their corners.
                assert abs(mine - theirs) < 0.5, (name, kind, corners, seen[name])
            compared[kind] += 1
    assert compared["pinhole"] > 1 and compared["fisheye"] > 0, compared


@pytest.mark.parametrize("width", [360, 768, 1440, 2560])
@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_nothing_overlaps_at_any_width(street, open_page, width, scheme):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer, width=width, height=900 if width > 400 else 740, color_scheme=scheme)
        if folder := os.environ.get("VIEW_SCREENSHOTS"):
            page.page.screenshot(path=f"{folder}/scene-{width}-{scheme}.png")
        page.page.locator("#agents tbody button").first.click()
        assert page.page.evaluate("() => document.documentElement.scrollWidth") <= width
        # The ends of the axes cover each other as in space, nearest first: only their circle is compared.
        controls = page.page.evaluate(
            """() => [...document.querySelectorAll("button:not(.end), select, input, summary, .axes")]
                .filter((one) => one.checkVisibility() && !one.closest("footer") && !one.closest(".scrolls"))
                .map((one) => { const { left, top, right, bottom } = one.getBoundingClientRect(); return [one.id || one.textContent, left, top, right, bottom]; })"""
        )
        assert any(name == "XYZ" for name, *_ in controls), controls
        for index, (name, left, top, right, bottom) in enumerate(controls):
            assert left >= -0.5 and right <= width + 0.5, (name, left, right)
            for other, left2, top2, right2, bottom2 in controls[index + 1 :]:
                apart = right <= left2 + 0.5 or right2 <= left + 0.5 or bottom <= top2 + 0.5 or bottom2 <= top + 0.5
                assert apart, (name, other)


def test_a_lost_viewer_is_told_and_found_again(street, open_page):
    with Viewer(street, "scene.toml", "--token", "open-sesame") as viewer:
        page = open_page(viewer)
        port = re.search(r":(\d+)/", viewer.url)[1]
    page.page.wait_for_selector("#notice.fault:not([hidden])")
    assert "No connection" in page.notice()
    page.page.wait_for_function("() => document.getElementById('badge').textContent === 'no connection'")
    # The page has the cookie of this token and port.
    with Viewer(street, "scene.toml", "--port", port, "--token", "open-sesame") as viewer:
        page.wait(lambda frame: page.notice() == "")
        page.after(lambda: page.page.keyboard.press("."))


def test_memory_stays_flat(street, open_page):
    seconds = float(os.environ.get("VIEW_SOAK_S", 15))
    with Viewer(street, "scene.toml") as viewer:
        pages = [open_page(viewer, width=640, height=480) for _ in range(3)]
        # Renderers of other kinds of images are made when they are asked for first.
        for _ in range(KINDS):
            pages[2].after(lambda: pages[2].page.keyboard.press("v"))
        pages[0].page.check("#loop")
        pages[0].page.click("#play")
        time.sleep(max(3, seconds / 10))
        first = viewer.memory_kib()
        began = time.monotonic()
        while time.monotonic() - began < seconds:
            pages[1].page.keyboard.press("c")
            pages[2].page.keyboard.press("v")
            time.sleep(1)
        last = viewer.memory_kib()
        print(f"{first} KiB, after {seconds:.0f} s {last} KiB")
        assert last < (1.05 if seconds > 600 else 1.15) * first
        assert all(page.faults == [] for page in pages)


def scaled_car(street, folder, size):
    """Name of a PLY in `folder` of a car of the street, `size` times as large."""
    car = folder / "car.ply"
    if not car.exists():
        run("decompress", next((street / "assets").glob("*.safetensors")), "--out", car)
    header, body = car.read_bytes().split(b"end_header\n", 1)
    names = [line.split()[-1].decode() for line in header.splitlines() if line.startswith(b"property")]
    rows = np.frombuffer(body, "<f4").reshape(-1, len(names)).copy()
    rows[:, [names.index(axis) for axis in "xyz"]] *= size
    rows[:, [names.index(f"scale_{axis}") for axis in range(3)]] += np.log(size)
    scaled = folder / f"car_{size}.ply"
    scaled.write_bytes(header + b"end_header\n" + rows.tobytes())
    return scaled.name


def test_a_splat_file_is_circled_and_flown_by_its_own_size(street, tmp_path, open_page):
    """A thing of a few centimeters, and one of hundreds of meters: the same car, scaled."""
    for size in (0.02, 1.0, 60.0):
        with Viewer(tmp_path, scaled_car(street, tmp_path, size)) as viewer:
            page = open_page(viewer)
            page.choose("Camera of view 1", "orbit")
            camera = lambda: page.page.evaluate("() => window.viewer.state.panes[0].camera")
            first = camera()
            assert 1.5 * size < first["far"] < 20 * size
            assert max(abs(axis) for axis in first["focus"]) < 2 * size
            box = page.page.query_selector(".view").bounding_box()
            x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

            def drag():
                page.page.mouse.move(x, y)
                page.page.mouse.down()
                page.page.mouse.move(x + 200, y)
                page.page.mouse.up()

            for act in (lambda: None, drag):
                act()
                page.at_rest()
                width, height, rgba = page.pixels()
                middle = 4 * (width * (height // 2) + width // 2)
                assert max(rgba[middle : middle + 3]) > 16, "it stays in the middle of the image"
            page.page.mouse.wheel(0, -100)
            page.at_rest()
            assert 0.8 < camera()["far"] / first["far"] < 1
            page.page.keyboard.press("f")
            page.at_rest()
            assert camera()["far"] == first["far"]
            assert page.faults == []


def test_two_fingers_zoom_and_a_refusal_goes(street, open_page):
    with Viewer(street, "scene.toml") as viewer:
        page = open_page(viewer, has_touch=True)
        page.choose("Camera of view 1", "orbit")
        camera = lambda: page.page.evaluate("() => window.viewer.state.panes[0].camera")
        box = page.page.query_selector(".view").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        before = camera()
        session = page.page.context.new_cdp_session(page.page)

        def touch(kind, *apart):
            points = [{"x": x + sign * half, "y": y, "id": sign + 1} for half in apart for sign in (-1, 1)]
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        touch("touchStart", 40)
        for half in (50, 60, 70, 80):
            touch("touchMove", half)
        touch("touchEnd")
        after = camera()
        assert abs(after["far"] / before["far"] - 0.5) < 0.02
        assert (after["yaw"], after["pitch"]) == (before["yaw"], before["pitch"])
        page.page.fill("#save-name", "../bad.toml")
        page.page.click("#save")
        page.page.wait_for_selector("#notice.fault:not([hidden])")
        page.page.click("#notice .close")
        assert page.page.is_hidden("#notice")
        page.page.click("#save")
        page.page.wait_for_selector("#notice.fault:not([hidden])")
        page.page.fill("#save-name", "good.toml")
        page.page.click("#save")
        page.page.wait_for_selector("#notice:not(.fault):not([hidden])")
        assert "good.toml" in page.notice()
