"""A viewer and its page in a headless browser.

Needs playwright and Debian's chromium; without them the tests that import this are skipped.
"""

import base64
import json
import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

np = pytest.importorskip("numpy")
playwright = pytest.importorskip("playwright.sync_api")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None:
    pytest.skip("chromium is not installed", allow_module_level=True)

PROGRAM = os.environ.get("DECOUPLEGS_PROGRAM", "decouplegs")
# As root Chromium needs --no-sandbox; it is to reach no other host, and has no WebGL.
BROWSER_ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-3d-apis",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
# With WebGL in software: views are drawn by the browser while their cameras move.
WEBGL_ARGUMENTS = [one for one in BROWSER_ARGUMENTS if one != "--disable-3d-apis"] + ["--enable-unsafe-swiftshader"]
PATIENCE_S = 60
# Kinds of images: color, depth and so on.
KINDS = 7
# Longer than the page waits before it asks for images at rest.
SETTLED_S = 0.4
FISHEYE = 'lens = { model = "opencv-fisheye", radial = [0.05, -0.01, 0.0, 0.0] }\n'


def run(*arguments, folder=None):
    subprocess.run([PROGRAM, *map(str, arguments)], cwd=folder, check=True, capture_output=True)


class Viewer:
    """A running viewer; its address is `url`."""

    def __init__(self, folder, *arguments):
        self.program = subprocess.Popen(
            [PROGRAM, "view", *map(str, arguments), *([] if "--port" in arguments else ["--port", "0"])],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self.url = self.program.stdout.readline().strip()
        assert self.url.startswith("http://127.0.0.1:")

    def __enter__(self):
        return self

    def __exit__(self, kind, *_):
        """Ends it as Ctrl-C does: then messages of the validation layers count as failure."""
        self.program.send_signal(signal.SIGINT)
        ended = self.program.wait(PATIENCE_S)
        assert kind is not None or ended == 0

    def memory_kib(self):
        status = Path(f"/proc/{self.program.pid}/status").read_text()
        return int(re.search(r"VmRSS:\s+(\d+)", status)[1])


DROP = """([name, text]) => {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const data = new DataTransfer();
    data.items.add(new File([bytes], name));
    document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true }));
}"""


class Page:
    """A page of a browser, and what it shows."""

    def __init__(self, page, url):
        self.page = page
        self.faults = []
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.on("console", self.note)
        page.goto(url)
        self.at_rest()

    def note(self, message):
        """Errors of the console are faults, but for those of a viewer that was ended."""
        if message.type == "error" and "/socket' failed" not in message.text:
            self.faults.append(message.text)

    def shown(self):
        """The state of the newest update; None while the page waits for what was asked for last."""
        return self.page.evaluate("() => window.viewer?.newest() ? window.viewer.frame : null")

    def newest(self):
        """The state of the newest update, once the page shows what was asked for last."""
        return self.wait(lambda frame: True)

    def wait(self, is_so):
        """The state of the first update that `is_so` holds for."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            frame = self.shown()
            if frame and is_so(frame):
                return frame
            time.sleep(0.02)
        raise TimeoutError(str(self.shown())[:500])

    def at_rest(self, after=0):
        """The newest exact update, which no other has followed for a while."""
        while True:
            frame = self.wait(lambda frame: frame["update"] > after and frame["badge"].startswith("exact"))
            time.sleep(SETTLED_S)
            now = self.shown()
            if now and now["update"] == frame["update"]:
                return frame

    def after(self, act):
        """The update at rest that follows `act`."""
        before = self.newest()["update"]
        act()
        return self.at_rest(before)

    def choose(self, label, value):
        return self.after(lambda: self.page.select_option(f"[aria-label='{label}']", value))

    def pixels(self, canvas=0):
        """Width, height and RGBA bytes of a canvas of the first view."""
        script = """(index) => {
            const canvas = document.querySelectorAll(".view")[0].querySelectorAll("canvas")[index];
            const { width, height } = canvas;
            const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
            let text = "";
            for (let i = 0; i < data.length; i += 32768) text += String.fromCharCode(...data.subarray(i, i + 32768));
            return [width, height, btoa(text)];
        }"""
        width, height, text = self.page.evaluate(script, canvas)
        return width, height, base64.b64decode(text)

    def decoded(self, png):
        """The same of a PNG file, decoded by the browser."""
        script = """async (text) => {
            const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
            const options = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
            const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/png" }), options);
            const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
            const context = canvas.getContext("2d");
            context.drawImage(bitmap, 0, 0);
            const { data } = context.getImageData(0, 0, bitmap.width, bitmap.height);
            let out = "";
            for (let i = 0; i < data.length; i += 32768) out += String.fromCharCode(...data.subarray(i, i + 32768));
            return [bitmap.width, bitmap.height, btoa(out)];
        }"""
        width, height, text = self.page.evaluate(script, base64.b64encode(png.read_bytes()).decode())
        return width, height, base64.b64decode(text)

    def drop(self, name, content):
        """Drops a file of this name with these bytes on the page."""
        self.page.evaluate(DROP, [name, base64.b64encode(content).decode()])

    def notice(self):
        return self.page.inner_text("#notice")
