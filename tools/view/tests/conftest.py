"""Fixtures of the tests of the viewer's page."""

import pytest

@pytest.fixture(scope="session")
def launch():
    """Starts Chromium with given arguments."""
    from viewer_page import CHROMIUM, playwright

    with playwright.sync_playwright() as started:
        yield lambda arguments: started.chromium.launch(executable_path=CHROMIUM, args=arguments)


@pytest.fixture(scope="session")
def browser(launch):
    from viewer_page import BROWSER_ARGUMENTS

    launched = launch(BROWSER_ARGUMENTS)
    yield launched
    launched.close()


@pytest.fixture(scope="session")
def webgl_browser(launch):
    from viewer_page import WEBGL_ARGUMENTS

    launched = launch(WEBGL_ARGUMENTS)
    yield launched
    launched.close()


@pytest.fixture
def open_webgl_page(webgl_browser):
    """Opens the page in a browser with WebGL, and checks in the end that no script failed."""
    yield from opener(webgl_browser)


@pytest.fixture
def open_page(browser):
    """Opens the page of a viewer, and checks in the end that no script failed."""
    yield from opener(browser)


def opener(browser):
    from viewer_page import Page

    pages = []

    def opened(viewer, width=1280, height=800, **options):
        page = browser.new_page(viewport={"width": width, "height": height}, **options)
        pages.append(Page(page, viewer.url))
        return pages[-1]

    yield opened
    for page in pages:
        page.page.close()
        assert page.faults == []


@pytest.fixture(scope="session")
def street(tmp_path_factory):
    """A street whose cars move; the back camera is a fisheye."""
    from viewer_page import FISHEYE, run

    folder = tmp_path_factory.mktemp("street")
    sizes = ["--background", 20000, "--agents", 8, "--agent-splats", 400, "--degree", 1, "--seed", 5]
    run("synth", "street", *sizes, "--size", "320x180", "--movable", "--out", folder)
    scene = folder / "scene.toml"
    back = '[[rig]]\nname = "back"\n'
    text = scene.read_text()
    assert back in text
    scene.write_text(text.replace(back, back + FISHEYE))
    return folder


@pytest.fixture(scope="session")
def episode(tmp_path_factory):
    """Logs of one scenario, by constant velocity, which crashes, and by lane-follow."""
    from viewer_page import run

    folder = tmp_path_factory.mktemp("episode")
    place = ["--background", 8000, "--agent-splats", 300, "--size", "160x90"]
    planner = ["--planner", "constant-velocity"]
    run("drive", "--level", "hard", "--episodes", 1, "--seed", 3, *place, *planner, "--out", "run", folder=folder)
    other = ["--planner", "lane-follow", "--size", "160x90"]
    run("drive", "run/scenarios/hard_0000.toml", *other, "--out", "other", folder=folder)
    return folder
