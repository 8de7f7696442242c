"""A headless Chromium driven over its debugging protocol, for tests of pages."""

import base64
import contextlib
import io
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def find() -> str | None:
    """Path of a browser, if there is one."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Page:
    """One open page."""

    def __init__(self, socket):
        self.socket, self.number = socket, 0

    def call(self, method: str, **params):
        """Sends a command and returns its result."""
        self.number += 1
        self.socket.send(json.dumps({"id": self.number, "method": method, "params": params}))
        while True:
            answer = json.loads(self.socket.recv(timeout=60))
            if answer.get("id") == self.number:
                assert "error" not in answer, answer
                return answer["result"]

    def evaluate(self, expression: str):
        """Value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        return answer["result"].get("value")

    def text(self) -> str:
        """What the page shows in words."""
        return self.evaluate("document.body.innerText")

    def has_button(self, label: str) -> bool:
        """Whether there is a button with this label, also in a folder that is closed."""
        return self.evaluate(f"!!{_button(label)}")

    def click(self, label: str) -> None:
        """Clicks the button with this label."""
        self.evaluate(f"{_button(label)}.click()")

    def press(self, letter: str, is_shifted: bool) -> None:
        """Types a key."""
        key = letter if is_shifted else letter.lower()
        for kind in ("rawKeyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                code=f"Key{letter}",
                modifiers=8 if is_shifted else 0,
                windowsVirtualKeyCode=ord(letter),
            )

    def screenshot(self) -> np.ndarray:
        """uint8 [H, W, 3]."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))


def _button(label: str) -> str:
    buttons = "[...document.querySelectorAll('button')]"
    return f"{buttons}.find(button => button.innerText == {json.dumps(label)})"


def wait_for(is_true: Callable[[], bool], seconds: float, what: str) -> None:
    """Raises AssertionError if it does not become true in time."""
    end = time.monotonic() + seconds
    while not is_true():
        assert time.monotonic() < end, f"{what}: not within {seconds} s"
        time.sleep(0.1)


@contextlib.contextmanager
def opened(url: str, profile: Path, width: int = 1280, height: int = 800) -> Iterator[Page]:
    """A page at an address; its browser ends with the block."""
    from websockets.sync.client import connect

    flags = ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--hide-scrollbars")
    browser = subprocess.Popen(
        [
            find(),
            *flags,
            "--enable-unsafe-swiftshader",
            "--disable-dev-shm-usage",
            "--remote-debugging-port=0",
            f"--user-data-dir={profile}",
            f"--window-size={width},{height}",
            url,
        ],
        stderr=subprocess.DEVNULL,
    )
    try:
        chosen = profile / "DevToolsActivePort"
        wait_for(lambda: chosen.exists() and chosen.read_text().count("\n") > 0, 60, "browser")
        port = chosen.read_text().split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as reply:
            pages = [page for page in json.load(reply) if page["type"] == "page"]
        with connect(pages[0]["webSocketDebuggerUrl"], max_size=None) as socket:
            yield Page(socket)
    finally:
        browser.terminate()
        browser.wait(30)
