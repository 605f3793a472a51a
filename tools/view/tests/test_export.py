"""A page in one file (`view --export`), in Chromium with WebGL by software, from a `file://` address."""

import io
import json
import os
import re
import subprocess

import pytest
from viewer_page import PROGRAM, np, run

Image = pytest.importorskip("PIL.Image")

LIMIT_MS = 120_000
SAID = re.compile(r"^(\S+): (\d+) of (\d+) splats, (?:(\d+) moving agents?, (\S+) s at (\S+) poses per second, )?(\S+) MB\n$")


def export(*arguments, folder, code=0):
    """Standard output and standard error of `view` as it writes a page."""
    done = subprocess.run([PROGRAM, "view", *map(str, arguments)], cwd=folder, capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    return done.stdout, done.stderr


@pytest.fixture(scope="session")
def scene(tmp_path_factory):
    """A street whose colors are the same from all sides, and whose cars move; and its page."""
    folder = tmp_path_factory.mktemp("exported")
    sizes = ["--background", 6000, "--agents", 4, "--agent-splats", 400, "--degree", 0, "--seed", 5]
    run("synth", "street", *sizes, "--size", "320x180", "--movable", "--out", folder)
    said, _ = export("scene.toml", "--export", "street.html", folder=folder)
    return folder, SAID.match(said)


@pytest.fixture
def open_file(webgl_browser):
    """Opens a page by its file, lets no request but that leave it, and checks its console in the end."""
    opened, asked, faults = [], [], []

    def open_(path, browser=webgl_browser, width=1280, height=800, **options):
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        context.set_default_timeout(LIMIT_MS)
        page = context.new_page()

        def only_the_file(route):
            asked.append(route.request.url)
            route.continue_() if route.request.url == path.as_uri() else route.abort()

        context.route("**/*", only_the_file)
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(path.as_uri())
        opened.append((context, path))
        return page

    yield open_
    own = {path.as_uri() for _, path in opened}
    # Modules and workers are parts of the file.
    others = [url for url in asked if url not in own and not url.startswith(("data:", "blob:"))]
    for context, _ in opened:
        context.close()
    assert others == [] and faults == []


def at_rest(page, time_s=None):
    """Facts of the image of the page, once all splats are drawn in their order."""
    same_time = "true" if time_s is None else f"Math.abs(window.drawn.time_s - {time_s}) < 1e-6"
    page.wait_for_timeout(300)
    page.wait_for_function(f"() => window.drawn?.isWhole && {same_time}", timeout=LIMIT_MS)
    return page.evaluate("() => window.drawn")


def seen(page):
    png = page.locator(".view").first.screenshot()
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")) / 255.0


def psnr(a, b):
    return -10 * np.log10(max(1e-12, ((a - b) ** 2).mean()))


def set_time(page, time_s):
    page.locator("#time").evaluate("(slider, value) => { slider.value = value; slider.dispatchEvent(new Event('input')); }", time_s)


def screenshot(page, name):
    if folder := os.environ.get("VIEW_SCREENSHOTS"):
        page.screenshot(path=f"{folder}/{name}.png")


def test_the_page_draws_what_render_draws(scene, tmp_path, open_file):
    folder, said = scene
    kept, everything = int(said[2]), int(said[3])
    assert kept == everything > 6000 and int(said[4]) == 4
    assert float(said[7]) == pytest.approx((folder / "street.html").stat().st_size / 1e6, abs=0.06)
    page = open_file(folder / "street.html")
    # Only the image: no axes over it.
    page.uncheck("#layer-axes")
    page.select_option("#camera", "named:front")
    drawn = at_rest(page)
    assert drawn["count"] > 100
    assert page.inner_text("#badge") == f"drawn by the browser: all {kept:,} splats"
    screenshot(page, "exported")
    image = seen(page)
    assert image.std() > 0.02
    width, height = drawn["camera"]["size_px"]
    view = image.shape
    own = image[(view[0] - height) // 2 :][:height, (view[1] - width) // 2 :][:, :width]
    out = tmp_path / "exact"
    run("render", "scene.toml", "--size", f"{width}x{height}", "--out", out, folder=folder)
    images = {one.stem: np.asarray(Image.open(one).convert("RGB")) / 255.0 for one in out.glob("*.png")}
    [exact] = [image for name, image in images.items() if name == "front"]
    of_others = [psnr(own, image) for name, image in images.items() if name != "front"]
    print(f"{psnr(own, exact):.1f} dB, of other cameras {max(of_others):.1f} dB at most")
    # The bound fails for another camera.
    assert psnr(own, exact) > 30 > max(of_others)


def test_agents_move_along_their_tracks(scene, open_file):
    folder, said = scene
    page = open_file(folder / "street.html")
    places = []
    for time_s in (0, 5):
        set_time(page, time_s)
        drawn = at_rest(page, time_s)
        places.append({agent["name"]: np.array(agent["pose"]["position_m"]) for agent in drawn["agents"]})
        assert page.inner_text("#clock") == f"{time_s:.2f} s"
    assert len(places[0]) == 4
    assert max(np.linalg.norm(places[0][name] - places[1][name]) for name in places[0]) > 1
    # Between two samples it goes straight.
    step_s = 1 / float(said[6])
    ends = []
    for share in (0, 0.25, 1):
        set_time(page, 10 * step_s + share * step_s)
        ends.append(np.array([agent["pose"]["position_m"] for agent in at_rest(page)["agents"]]))
    assert np.allclose(ends[1], 0.75 * ends[0] + 0.25 * ends[2], atol=1e-3)
    assert not np.allclose(ends[1], ends[0], atol=1e-3)
    # The image shows it too.
    page.select_option("#camera", "birds-eye")
    at_rest(page)
    later = seen(page)
    set_time(page, 0)
    at_rest(page, 0)
    assert psnr(seen(page), later) < 40
    page.click("#play")
    page.wait_for_function("() => window.drawn.time_s > 0.2", timeout=LIMIT_MS)
    assert page.inner_text("#play") == "Pause"
    page.keyboard.press("Space")
    assert page.inner_text("#play") == "Play"
    stands = at_rest(page)["time_s"]
    page.wait_for_timeout(300)
    assert page.evaluate("() => window.drawn.time_s") == stands


def test_the_camera_moves_by_mouse_wheel_keys_and_menu(scene, open_file):
    folder, _ = scene
    page = open_file(folder / "street.html")
    pose = lambda: at_rest(page)["camera"]["pose"]
    box = page.locator(".view").first.bounding_box()
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)

    def drag(button):
        page.mouse.move(*middle)
        page.mouse.down(button=button)
        page.mouse.move(middle[0] + 60, middle[1] + 20, steps=3)
        page.mouse.up(button=button)

    def hold(key):
        # Until it has moved: on a busy machine no frame may come for a while.
        before = page.evaluate("() => JSON.stringify(window.drawn.camera.pose)")
        page.keyboard.down(key)
        page.wait_for_function("(before) => JSON.stringify(window.drawn.camera.pose) !== before", arg=before, timeout=LIMIT_MS)
        page.keyboard.up(key)

    page.select_option("#camera", "orbit")
    before = pose()
    acts = [
        lambda: drag("left"), lambda: drag("right"), lambda: page.mouse.wheel(0, -200),
        lambda: hold("w"), lambda: page.get_by_role("button", name="Look from Z", exact=True).press("Enter"),
        lambda: page.keyboard.press("f"), lambda: page.select_option("#camera", "named:back"),
        # A camera of the rig is left where it was.
        lambda: hold("ArrowLeft"),
    ]
    for act in acts:
        act()
        now = pose()
        assert now != before
        before = now
    assert page.input_value("#camera") == "fly"


def test_fewer_splats_are_told(scene, tmp_path, open_file):
    folder, full = scene
    path = tmp_path / "few.html"
    said, _ = export("scene.toml", "--export", path, "--browser-splats", 2000, folder=folder)
    said = SAID.match(said)
    assert said[2] == "2000" and said[3] == full[3]
    page = open_file(path)
    at_rest(page)
    assert page.inner_text("#badge") == f"drawn by the browser, reduced: 2,000 of {int(full[3]):,} splats"
    page.click("#about")
    assert f"holds 2,000 splats of {folder.name}, those that cover most of its" in page.inner_text("#about-splats")

    assert not page.is_visible("#about-missing-said")


def test_what_is_missing_is_told(street, tmp_path, open_file):
    export("scene.toml", "--export", tmp_path / "street.html", folder=street)
    page = open_file(tmp_path / "street.html")
    page.select_option("#camera", "named:back")
    focal = at_rest(page)["camera"]["focal_px"]
    assert focal[0] == focal[1] > 1
    page.click("#about")
    missing = page.inner_text("#about-missing")
    assert "degree 1" in missing and "lenses" in missing and "fog" not in missing


def test_a_splat_file_has_no_time(scene, tmp_path, open_file):
    folder, _ = scene
    [asset, *_] = sorted((folder / "assets").glob("*.safetensors"))
    run("decompress", asset, "--out", tmp_path / "car.ply")
    said, _ = export("car.ply", "--export", "car.html", folder=tmp_path)
    assert SAID.match(said)[4] is None
    page = open_file(tmp_path / "car.html")
    drawn = at_rest(page)
    assert drawn["count"] > 50 and not page.is_visible("#timeline")
    assert page.input_value("#camera") == "orbit"
    assert page.title() == "car.ply – DecoupleGS"
    screenshot(page, "exported-file")


def test_an_episode_is_a_page_too(episode, open_file):
    said, _ = export("run/logs/hard_0000.log", "--export", "episode.html", folder=episode)
    assert float(SAID.match(said)[5]) > 1
    page = open_file(episode / "episode.html")
    egos = []
    for time_s in (0, 1):
        set_time(page, time_s)
        egos.append(at_rest(page, time_s)["camera"]["pose"]["position_m"])
    assert egos[0] != egos[1]


def test_without_webgl_a_sentence_says_so(scene, browser, open_file):
    folder, _ = scene
    page = open_file(folder / "street.html", browser=browser)
    assert "no WebGL 2" in page.inner_text("#empty")
    assert page.inner_text("#badge") == "not drawn"


@pytest.mark.parametrize("width, height, scheme", [(1280, 800, "dark"), (1280, 800, "light"), (390, 844, "light")])
def test_the_page_is_accessible_and_fits(scene, open_file, width, height, scheme):
    axe = pytest.importorskip("axe_core_python.sync_playwright").Axe()
    folder, _ = scene
    page = open_file(folder / "street.html", width=width, height=height, color_scheme=scheme)
    at_rest(page)
    screenshot(page, f"exported-{width}-{scheme}")
    assert page.evaluate("() => [document.documentElement.scrollWidth, document.documentElement.scrollHeight]") == [width, height]
    assert page.locator(".view").first.bounding_box()["height"] > 0.5 * height
    for button, dialog in ((None, None), ("#about", "#about-dialog"), ("#help", "#keys")):
        if button:
            page.click(button)
            screenshot(page, f"exported-{width}-{scheme}-{dialog[1:]}")
        found = axe.run(page)["violations"]
        assert [(one["id"], [node["target"] for node in one["nodes"]]) for one in found] == []
        if button:
            page.click(f"{dialog} button")


def test_two_fingers_zoom(scene, open_file):
    folder, _ = scene
    page = open_file(folder / "street.html", width=390, height=844, has_touch=True, is_mobile=True)
    page.select_option("#camera", "orbit")
    before = at_rest(page)["camera"]["pose"]["position_m"]
    session = page.context.new_cdp_session(page)
    box = page.locator(".view").first.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    points = lambda apart: [{"x": x - apart, "y": y, "id": 0}, {"x": x + apart, "y": y, "id": 1}]
    touch = lambda kind, points: session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    touch("touchStart", points(40))
    for apart in (50, 65, 80):
        touch("touchMove", points(apart))
    touch("touchEnd", [])
    after = at_rest(page)["camera"]["pose"]["position_m"]
    assert before != after


def test_outputs_and_combinations_are_checked(scene, tmp_path):
    folder, _ = scene
    page = folder / "street.html"
    old = page.read_bytes()
    _, said = export("scene.toml", "--export", "street.html", folder=folder, code=1)
    assert "street.html exists already" in said and "--force" in said and page.read_bytes() == old
    # The same scene gives the same bytes.
    export("scene.toml", "--export", "street.html", "--force", folder=folder)
    assert page.read_bytes() == old
    refused = [
        ["--export", "a.html", "--port", 8090], ["--export", "a.html", "--address", "127.0.0.1"], ["--export", "a.html", "--token", "abcdefgh"],
        ["--export", "a.html", "--no-token"], ["--export", "a.html", "--against", "scene.toml"], ["--export", "a.png"], ["--force"],
        ["--export", "a.html", "--browser-splats", 0],
    ]
    for words in refused:
        _, said = export("scene.toml", *words, folder=folder, code=2)
        assert said.startswith("error: "), said
    assert not (folder / "a.html").exists() and not list(folder.glob(".writing-*"))
    (tmp_path / "bad.ply").write_bytes(b"ply\nformat nonsense\n")
    _, said = export("bad.ply", "--export", "bad.html", folder=tmp_path, code=1)
    assert "bad.ply" in said and not (tmp_path / "bad.html").exists()


def test_the_file_holds_no_address_and_no_folder(scene):
    folder, _ = scene
    text = (folder / "street.html").read_text()
    assert not re.search(r"(src|href)=\"(?!data:)", text)
    [found] = re.findall(r'<script type="application/json" id="scene">(.*?)</script>', text)
    facts = json.loads(found)
    assert str(folder) not in text and facts["title"]
    assert text.count("<script") == text.count("</script>")
