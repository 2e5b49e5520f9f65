"""A headless Chromium over its debugging pipe: just enough to open a page, act on it and see what it complains of."""

from __future__ import annotations

import json
import os
import select
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")


def chromium_path() -> str | None:
    """Where Chromium is, or ``None``."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One page. ``requests`` and ``complaints`` collect what the page asked for and what it had to say."""

    def __init__(self, profile: Path, width: int = 1400) -> None:
        path = chromium_path()
        assert path is not None
        to_child, self._write = os.pipe()
        self._read, from_child = os.pipe()

        def as_three_and_four() -> None:
            # Chromium reads commands from descriptor 3 and answers on 4; out of their way first.
            first, second = (os.dup(fd) for fd in (to_child, from_child))
            high = [os.dup2(first, 100), os.dup2(second, 101)]
            os.dup2(high[0], 3, inheritable=True)
            os.dup2(high[1], 4, inheritable=True)

        command = [path, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--disable-extensions"]
        command += ["--disable-background-networking", "--no-first-run", "--remote-debugging-pipe"]
        command += [f"--user-data-dir={profile}", f"--window-size={width},1000", "about:blank"]
        self._process = subprocess.Popen(
            command, preexec_fn=as_three_and_four, close_fds=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        os.close(to_child)
        os.close(from_child)
        self._buffer, self._last, self._session = b"", 0, None
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self._loaded = False
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(target["targetId"] for target in targets if target["type"] == "page")
        self._session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.resize(width)

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()
        self._process.wait(10)
        os.close(self._read)
        os.close(self._write)

    def open(self, url: str) -> None:
        """Open a page and wait until it has loaded."""
        self._loaded = False
        self.call("Page.navigate", url=url)
        while not self._loaded:
            self._note(self._message())

    def evaluate(self, expression: str) -> Any:
        """Evaluate JavaScript in the page and return its value (plain data)."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def press(self, key: str, *, shift: bool = False) -> None:
        """Press a key such as ``ArrowRight``."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, modifiers=8 if shift else 0)

    def choose(self, select: str, value: str) -> None:
        """Choose a value of the ``select`` element with an id."""
        set_value = f"s.value = '{value}'; s.dispatchEvent(new Event('change'))"
        self.evaluate(f"{{const s = document.getElementById('{select}'); {set_value}}}")

    def click(self, element: str) -> None:
        """Click with the mouse where an element, given in JavaScript, is seen."""
        x, y = self.evaluate(
            f"(() => {{ const e = {element}; e.scrollIntoView({{block: 'center'}});"
            "const b = e.getBoundingClientRect(); return [b.left + b.width / 2, b.top + b.height / 2]; })()"
        )
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def resize(self, width: int) -> None:
        """Give the window another width."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=1000, deviceScaleFactor=1, mobile=False)

    def faults(self, url: str, widths: Sequence[int] = (1400, 700)) -> list[str]:
        """Open a page at several widths and return what it asked for outside, complained of, or could not hold."""
        found = []
        for width in widths:
            self.resize(width)
            self.requests.clear()
            self.complaints.clear()
            self.open("about:blank")
            self.open(url)
            found += [f"asks for {one[:80]}" for one in self.requests if not one.startswith(("data:", "about:", url))]
            found += self.complaints
            if (reach := self.evaluate("document.documentElement.scrollWidth")) > width:
                found.append(f"reaches to {reach} of {width} px")
            if not self.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 100)"):
                found.append("a picture is not decoded")
        self.resize(widths[0])
        return found

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send one command of the DevTools protocol and return its answer."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._message()
            if answer.get("id") == self._last:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                result: dict[str, Any] = answer["result"]
                return result
            self._note(answer)

    def _message(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._read], [], [], 60)
            data = os.read(self._read, 1 << 20) if ready else b""
            if not data:
                raise RuntimeError("Chromium has gone, or has not answered for a minute")
            self._buffer += data
        text, self._buffer = self._buffer.split(b"\0", 1)
        message: dict[str, Any] = json.loads(text)
        return message

    def _note(self, event: dict[str, Any]) -> None:
        method, details = event.get("method"), event.get("params", {})
        if method == "Page.loadEventFired":
            self._loaded = True
        elif method == "Network.requestWillBeSent":
            self.requests.append(details["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(details["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and details["type"] in ("error", "warning", "assert"):
            self.complaints.append(json.dumps(details["args"]))
        elif method == "Log.entryAdded" and details["entry"]["level"] in ("error", "warning"):
            self.complaints.append(json.dumps(details["entry"]))
