"""A headless Chromium that tests drive by the Chrome DevTools Protocol, over a pipe: no port and no further package."""

import itertools
import json
import os
import select
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

# Any of these will do: `apt-get install chromium` has the first.
_NAMES = "chromium chromium-browser chromium-headless-shell google-chrome google-chrome-stable".split()
# Without a sandbox, as it cannot run as root otherwise, which it does in most containers; the page is our own.
_ARGUMENTS = """--headless --remote-debugging-pipe --no-sandbox --disable-gpu --disable-dev-shm-usage --hide-scrollbars
--disable-background-networking --disable-component-update --no-first-run --force-color-profile=srgb""".split()
_SECONDS = 120.0  # for an answer; a start on a busy machine takes some seconds


def find_browser() -> str | None:
    """The path of a Chromium: that of the variable CCD_WARP_BROWSER, or the first on the search path."""
    if os.name != "posix":
        return None  # it could not be given the descriptors of the pipe
    chosen = os.environ.get("CCD_WARP_BROWSER")
    found = [shutil.which(name) for name in ([chosen] if chosen else _NAMES)]
    return next((path for path in found if path), None)


class Page:
    """One page in a browser; what it has written to the console and asked for is in `messages` and `requests`."""

    def __init__(self, read_end: int, write_end: int):
        self.messages: list[str] = []
        self.requests: list[str] = []
        self._ends = read_end, write_end
        self._rest = b""
        self._is_loaded = False
        self._numbers = itertools.count(1)
        self._session: dict[str, str] = {}
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self._session = {"sessionId": self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]}
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command of the protocol and return its result."""
        number = next(self._numbers)
        data = json.dumps({"id": number, "method": method, "params": parameters} | self._session).encode() + b"\0"
        while data:
            data = data[os.write(self._ends[1], data) :]
        while True:
            answer = self._next_message()
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]

    def _next_message(self) -> dict[str, Any]:
        deadline = time.monotonic() + _SECONDS
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._ends[0]], [], [], max(0.0, deadline - time.monotonic()))
            data = os.read(self._ends[0], 1 << 16) if ready else b""
            if not data:
                raise RuntimeError("the browser has ended" if ready else f"no answer in {_SECONDS:.0f} s")
            self._rest += data
        text, _, self._rest = self._rest.partition(b"\0")
        message = json.loads(text)
        parameters = message.get("params", {})
        match message.get("method"):
            case "Runtime.consoleAPICalled":
                self.messages.append(" ".join(str(value.get("value")) for value in parameters["args"]))
            case "Runtime.exceptionThrown":
                details = parameters["exceptionDetails"]
                self.messages.append(details.get("exception", {}).get("description", details["text"]))
            case "Log.entryAdded":
                self.messages.append(parameters["entry"]["text"])
            case "Network.requestWillBeSent":
                self.requests.append(parameters["request"]["url"])
            case "Page.loadEventFired":
                self._is_loaded = True
        return message

    def resize(self, width: int, height: int = 900) -> None:
        """Show the page in a window of this many CSS pixels."""
        self.send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def open(self, path: Path) -> None:
        """Open a file and wait until it is loaded."""
        self._is_loaded = False
        self.send("Page.navigate", url=path.resolve().as_uri())
        while not self._is_loaded:
            self._next_message()

    def evaluate(self, expression: str) -> Any:
        """The value of an expression in the page, which JSON can hold."""
        answer = self.send("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"]["exception"]["description"])
        return answer["result"].get("value")


@contextmanager
def opened_browser(browser: str) -> Iterator[Page]:
    """A page of a browser that is started here and ended in any case."""
    import fcntl  # not on every system

    to_browser, from_browser = os.pipe(), os.pipe()
    # descriptors above 9, so that neither is 3 or 4, where the browser reads and writes
    theirs = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in (to_browser[0], from_browser[1])]
    os.close(to_browser[0])
    os.close(from_browser[1])
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, open(Path(folder) / "log", "wb") as log:
        actions = [(os.POSIX_SPAWN_DUP2, theirs[0], 3), (os.POSIX_SPAWN_DUP2, theirs[1], 4)]
        actions += [(os.POSIX_SPAWN_DUP2, log.fileno(), 1), (os.POSIX_SPAWN_DUP2, log.fileno(), 2)]
        arguments = [browser, *_ARGUMENTS, f"--user-data-dir={folder}/profile"]
        environment = os.environ | {"HOME": folder}
        process = os.posix_spawn(browser, arguments, environment, file_actions=actions, setpgroup=0)
        for end in theirs:
            os.close(end)
        try:
            yield Page(from_browser[0], to_browser[1])
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process, signal.SIGKILL)
            os.waitpid(process, 0)
            os.close(to_browser[1])
            os.close(from_browser[0])
