"""A headless Chromium, driven through its own protocol over a pipe: no package is needed, and no port is opened."""

import base64
import itertools
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync", "--disable-quic", "--hide-scrollbars",
         "--remote-debugging-pipe")  # fmt: skip

# what a page answers that is left for another one, or loaded again, before it has answered
LEFT = {f"Runtime.evaluate: {why}" for why in
        ("Inspected target navigated or closed", "Execution context was destroyed.",
         "Cannot find default execution context")}  # fmt: skip


class Browser:
    """One page of one browser; `errors` are what went wrong in it, `asked` the addresses that it wanted."""

    def __init__(self, profile: Path, width: int = 1400, height: int = 1000):
        # the browser reads commands from its descriptor 3 and answers on its descriptor 4
        to_browser, self._commands = os.pipe()
        self._answers, from_browser = os.pipe()
        command = f"exec '{CHROMIUM}' {' '.join(FLAGS)} '--user-data-dir={profile}' 3<&{to_browser} 4>&{from_browser}"
        self._process = subprocess.Popen(["bash", "-c", command], pass_fds=(to_browser, from_browser),
                                         stderr=subprocess.DEVNULL)  # fmt: skip
        os.close(to_browser)
        os.close(from_browser)
        self._numbers, self._rest, self._session = itertools.count(1), b"", None
        self.errors: list[str] = []
        self.asked: list[str] = []
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.send(f"{domain}.enable")
        self.resize(width, height)

    def close(self) -> None:
        """End the browser."""
        self._session = None
        self.send("Browser.close")
        self._process.wait(timeout=20)
        os.close(self._commands)
        os.close(self._answers)

    def send(self, method: str, **params: Any) -> dict[str, Any]:
        """A command's result. Raises `RuntimeError` where the browser refuses it."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            part = os.read(self._answers, 1 << 20)
            if not part:
                raise RuntimeError("the browser has gone")
            self._rest += part
        text, _, self._rest = self._rest.partition(b"\0")
        answer = json.loads(text)
        about = answer.get("params", {})
        match answer.get("method"):
            case "Runtime.exceptionThrown":
                details = about["exceptionDetails"]
                self.errors.append(str(details.get("exception", {}).get("description", details["text"])))
            case "Log.entryAdded" if about["entry"]["level"] == "error":
                self.errors.append(about["entry"]["text"])
            case "Network.requestWillBeSent":
                self.asked.append(about["request"]["url"])
        return answer

    def run(self, script: str) -> Any:
        """The value of an expression in the page, awaited. Raises `RuntimeError` where it throws."""
        found = self.send("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(str(found["exceptionDetails"].get("exception", {}).get("description")))
        return found["result"].get("value")

    def until(self, script: str, seconds: float = 20.0) -> Any:
        """The value of an expression as soon as it is true, also of a page that is loaded. Raises `TimeoutError`."""
        end = time.monotonic() + seconds
        while not (value := self._run_unless_loaded(script)):
            if time.monotonic() > end:
                raise TimeoutError(f"not within {seconds:g} s: {script}; {self.errors}")
            time.sleep(0.02)
        return value

    def _run_unless_loaded(self, script: str) -> Any:
        # None where the page went while it was asked, as after `location.reload()`
        try:
            return self.run(script)
        except RuntimeError as error:
            if str(error) not in LEFT:
                raise
            return None

    def open(self, path: Path) -> None:
        """Open a file, and wait for it."""
        self.errors.clear()
        self.asked.clear()
        self.send("Page.navigate", url=path.resolve().as_uri())
        self.until("document.readyState === 'complete'")

    def resize(self, width: int, height: int, dark: bool = False, ratio: float = 1.0) -> None:
        """Size of the window in CSS pixels, theme, and pixels of the screen for each."""
        self.send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=ratio, mobile=False
        )
        theme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.send("Emulation.setEmulatedMedia", features=[theme])

    def picture(self, path: Path, whole: bool = False) -> None:
        """Write what is seen, or the whole page, as PNG."""
        found = self.send("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))

    def place(self, selector: str) -> tuple[float, float, float, float]:
        """Left, top, width, height of an element in the window, after scrolling to it."""
        box = self.run(f"""(() => {{ const e = document.querySelector({json.dumps(selector)});
            e.scrollIntoView({{block: "center", behavior: "instant"}}); const b = e.getBoundingClientRect();
            return [b.left, b.top, b.width, b.height] }})()""")
        return tuple(box)

    def mouse(self, kind: str, x: float, y: float, held: bool = False) -> None:
        """`Moved`, `Pressed` or `Released` at a place of the window."""
        button = {} if kind == "Moved" and not held else {"button": "left", "clickCount": 1}
        self.send("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, buttons=int(held), **button)

    def click(self, x: float, y: float) -> None:
        """Press and let go."""
        self.mouse("Moved", x, y)
        self.mouse("Pressed", x, y, held=True)
        self.mouse("Released", x, y)

    def drag(self, x: float, y: float, to_x: float, to_y: float, steps: int = 8) -> None:
        """Press, go there in some steps, let go."""
        self.mouse("Moved", x, y)
        self.mouse("Pressed", x, y, held=True)
        for k in range(1, steps + 1):
            self.mouse("Moved", x + (to_x - x) * k / steps, y + (to_y - y) * k / steps, held=True)
        self.mouse("Released", to_x, to_y)

    def key(self, name: str, shift: bool = False) -> None:
        """Press a key by its name, such as `ArrowLeft` or `Enter`."""
        text = {"text": "\r"} if name == "Enter" else {"text": name} if len(name) == 1 else {}
        for kind in ("keyDown", "keyUp"):
            self.send(
                "Input.dispatchKeyEvent",
                type=kind,
                key=name,
                modifiers=8 * shift,
                **(text if kind == "keyDown" else {}),
            )
