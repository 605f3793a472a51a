"""Splat files that are dropped on the page of `decouplegs view`."""

import http.client
import os
import shutil
import threading
import time
from urllib.parse import urlsplit

import pytest
from viewer_page import PATIENCE_S, Viewer, run

LIMIT_MS = 1000 * PATIENCE_S


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Two files of splats of other places, as PLY and in other formats."""
    folder = tmp_path_factory.mktemp("files")
    for name, seed in [("first", 5), ("second", 6)]:
        street = folder / f"street_{name}"
        sizes = ["--background", 3000, "--agents", 0, "--degree", 0, "--seed", seed]
        run("synth", "street", *sizes, "--size", "160x90", "--out", street)
        shutil.copy(street / "background.ply", folder / f"{name}.ply")
    for ending in ["spz", "splat", "sog", "glb"]:
        run("convert", folder / "second.ply", folder / f"second.{ending}")
    return folder


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """Folder in which the viewer keeps files for a while."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    return folder


def screenshot(page, name):
    if folder := os.environ.get("VIEW_SCREENSHOTS"):
        page.page.screenshot(path=f"{folder}/{name}.png")


def drop(page, file, name=None):
    page.drop(name or file.name, file.read_bytes())


def title(page, expected):
    page.page.wait_for_function("(title) => document.title.startsWith(title) && window.viewer", arg=expected, timeout=LIMIT_MS)
    return page.at_rest()


def notice(page, text):
    page.page.wait_for_function("(text) => document.getElementById('notice').textContent.includes(text)", arg=text, timeout=LIMIT_MS)
    return page.notice()


def forget_refusals(page):
    """Browsers note each refused request in their console."""
    noted = "Failed to load resource: the server responded with a status of 4"
    page.faults[:] = [fault for fault in page.faults if not fault.startswith(noted)]


def put(viewer, name="second.ply", body=b"", token=True, headers=(), length=None):
    """Status and text of the answer to a file that is sent without a page."""
    parts = urlsplit(viewer.url)
    connection = http.client.HTTPConnection(parts.netloc, timeout=PATIENCE_S)
    query = {True: f"?{parts.query}", False: ""}.get(token, f"?token={token}")
    connection.putrequest("PUT", f"/files/{name}{query}")
    for key, value in dict(headers).items():
        connection.putheader(key, value)
    connection.putheader("Content-Length", str(len(body) if length is None else length))
    connection.endheaders()
    connection.send(body)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


@pytest.mark.parametrize("name", ["second.ply", "second.sog"])
def test_a_dropped_file_is_shown_as_the_command_shows_it(files, tmp_path, temporary, open_page, name):
    with Viewer(tmp_path, files / name) as viewer:
        page = open_page(viewer)
        page.choose("Camera of view 1", "orbit")
        alone = page.pixels()
    with Viewer(tmp_path, files / "first.ply") as viewer:
        page = open_page(viewer)
        other = open_page(viewer)
        page.choose("Camera of view 1", "orbit")
        before = page.pixels()
        drop(page, files / name)
        for one in [page, other]:
            title(one, name)
            assert name in notice(one, "is shown now")
        screenshot(page, f"dropped_{name}")
        # A reload shows it still.
        page.page.reload()
        title(page, name)
        page.choose("Camera of view 1", "orbit")
        assert page.pixels() == alone and page.pixels() != before
        ask = "() => viewer.state.connection.request('render_command', { stream: viewer.frame.panes[0].stream })"
        assert page.page.evaluate(ask)["text"].startswith(f"decouplegs render {name} --view ")
        assert list(temporary.iterdir()) == []


def test_files_of_all_formats_are_taken_one_after_the_other(files, tmp_path, temporary, open_page):
    shutil.copy(files / "second.sog", tmp_path / "second.zip")
    with Viewer(tmp_path, files / "first.ply") as viewer:
        page = open_page(viewer)
        for file in [files / "second.spz", files / "second.splat", files / "second.glb", tmp_path / "second.zip"]:
            drop(page, file)
            title(page, file.name)
        assert list(temporary.iterdir()) == []


def test_the_browser_draws_a_dropped_file(files, tmp_path, temporary, open_webgl_page):
    with Viewer(tmp_path, files / "first.ply") as viewer:
        page = open_webgl_page(viewer)
        drop(page, files / "second.spz")
        title(page, "second.spz")
        page.page.check("#browser")
        page.choose("Camera of view 1", "orbit")
        box = page.page.locator(".view").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.page.wait_for_timeout(500)
        page.page.mouse.move(x, y)
        page.page.mouse.down()
        end = time.monotonic() + PATIENCE_S
        while not page.page.evaluate("() => window.drawn?.count"):
            assert time.monotonic() < end
            x += 3
            page.page.mouse.move(x, y)
            page.page.wait_for_timeout(100)
        assert page.page.evaluate("() => window.drawn.count") > 1000
        page.page.mouse.up()
        page.at_rest()


def test_what_cannot_be_read_leaves_the_scene(files, street, tmp_path, temporary, open_page):
    broken = tmp_path / "broken.ply"
    broken.write_bytes((files / "second.ply").read_bytes()[:5000])
    text = tmp_path / "notes.txt"
    text.write_text("no splats")
    with Viewer(tmp_path, files / "first.ply") as viewer:
        page = open_page(viewer)
        before = page.pixels()
        for file, word in [(broken, "broken.ply"), (text, "tell a splat format")]:
            drop(page, file)
            said = notice(page, word)
            assert "/" not in said.replace("http://", ""), said
            assert page.page.is_hidden("#sending")
        screenshot(page, "broken")
        drop(page, text, "kept.ksplat")
        assert "splat-transform" in notice(page, "kept.ksplat")
        # A scene would name other files of the viewer's machine.
        drop(page, text, "scene.toml")
        assert "decouplegs view scene.toml" in notice(page, "scene.toml")
        drop(page, text, "path.json")
        notice(page, "path.json is no camera path")
        forget_refusals(page)
        page.at_rest()
        assert page.pixels() == before and page.page.title().startswith(str(files / "first.ply"))
        assert list(temporary.iterdir()) == []
        # The button takes files too.
        page.page.set_input_files("#file", files / "second.ply")
        title(page, "second.ply")


def test_edits_are_not_lost_without_a_question(files, street, tmp_path, temporary, open_page):
    with Viewer(tmp_path, street / "scene.toml") as viewer:
        page = open_page(viewer)
        name = page.newest()["sources"][0]["agents"][0]["name"]
        page.page.evaluate("(name) => viewer.state.connection.request('edit', { edit: 'remove', agent: name })", name)
        page.page.wait_for_function("() => viewer.state.change.sources[0].edits.undo")
        asked = []
        page.page.once("dialog", lambda dialog: (asked.append(dialog.message), dialog.dismiss()))
        drop(page, files / "second.ply")
        assert len(asked) == 1 and "edited" in asked[0]
        assert page.page.is_hidden("#sending")
        page.page.once("dialog", lambda dialog: dialog.accept())
        drop(page, files / "second.ply")
        title(page, "second.ply")
        assert page.page.is_hidden("#edit") and page.page.is_hidden("#agents-panel")


def test_only_the_page_sends_files_and_none_that_are_too_large(files, tmp_path, temporary):
    body = (files / "second.ply").read_bytes()
    with Viewer(tmp_path, files / "first.ply") as viewer:
        host = urlsplit(viewer.url).netloc
        status, text = put(viewer, body=body, token=False)
        # As all requests without the token are answered.
        assert status == 401 and "token" in text
        assert put(viewer, body=body, token="wrong-token")[0] == 401
        assert put(viewer, body=body, headers={"Origin": "http://evil.example"})[0] == 403
        assert put(viewer, body=body, headers={"Origin": f"http://{host}x"})[0] == 403
        status, text = put(viewer, length=(2 << 30) + 1)
        assert status == 413 and "decouplegs view" in text
        for name in ["a%2Fb.ply", "..%2F..%2Fa.ply", "a%00.ply", "a%5Cb.ply", "scene.toml", "run.log"]:
            assert put(viewer, name, body)[0] == 415, name
        status, text = put(viewer, "broken.ply", body[:3000])
        assert status == 422 and text.startswith("broken.ply")
        assert put(viewer, body=b"")[0] == 422
        assert list(temporary.iterdir()) == []
        assert put(viewer, body=body, headers={"Origin": f"http://{host}"})[0] == 204


def test_one_file_at_a_time_and_one_that_does_not_come_is_forgotten(files, tmp_path, temporary, open_page):
    body = (files / "second.ply").read_bytes()
    with Viewer(tmp_path, files / "first.ply") as viewer:
        page = open_page(viewer)
        parts = urlsplit(viewer.url)
        first = http.client.HTTPConnection(parts.netloc, timeout=PATIENCE_S)
        first.putrequest("PUT", f"/files/second.ply?{parts.query}")
        first.putheader("Content-Length", str(len(body)))
        first.endheaders()
        first.send(body[:1000])
        wait_until(lambda: any(temporary.rglob("splats.ply")))
        kept = next(temporary.rglob("splats.ply"))
        assert kept.stat().st_mode & 0o777 == 0o600
        status, text = put(viewer, body=body)
        assert status == 409 and "another file" in text
        drop(page, files / "second.ply")
        notice(page, "another file")
        # One that breaks off frees the place.
        first.close()
        wait_until(lambda: list(temporary.iterdir()) == [])
        answers = []
        many = [threading.Thread(target=lambda: answers.append(put(viewer, body=body)[0])) for _ in range(4)]
        for one in many:
            one.start()
        for one in many:
            one.join()
        assert 204 in answers and set(answers) <= {204, 409}
        title(page, "second.ply")
        forget_refusals(page)


def test_what_a_killed_viewer_left_is_removed(files, tmp_path, temporary):
    with pytest.raises(Killed), Viewer(tmp_path, files / "first.ply") as viewer:
        parts = urlsplit(viewer.url)
        first = http.client.HTTPConnection(parts.netloc, timeout=PATIENCE_S)
        first.putrequest("PUT", f"/files/second.ply?{parts.query}")
        first.putheader("Content-Length", "1000000")
        first.endheaders()
        first.send(b"ply\n")
        wait_until(lambda: any(temporary.rglob("splats.ply")))
        # Another viewer leaves it: it is in use.
        with Viewer(tmp_path, files / "first.ply") as other:
            # It serves by now.
            assert put(other, token=False)[0] == 401
            assert len(list(temporary.iterdir())) == 1
        # The program that `decouplegs` runs is its process.
        viewer.program.kill()
        viewer.program.wait(PATIENCE_S)
        assert len(list(temporary.iterdir())) == 1
        with Viewer(tmp_path, files / "first.ply") as other:
            assert put(other, token=False)[0] == 401
            assert list(temporary.iterdir()) == []
        raise Killed


class Killed(Exception):
    """The viewer of the test was killed: its exit code says nothing."""


def wait_until(is_so):
    end = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.05)
