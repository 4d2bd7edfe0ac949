"""Headless Chromium through its debugging pipe, with the standard library alone."""
import json
import os
import subprocess
import tempfile
import time

PATIENCE_S = 120
PROGRAM = "/usr/bin/chromium"
ARGUMENTS = [
    "--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--mute-audio", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--remote-debugging-pipe",
]


class Chromium:
    """A page in a browser of its own. `complaints` are its errors, `requests` the addresses that it asked for."""

    def __init__(self, url, width, height, dark=False):
        self.profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        (commands, self.commands), (self.answers, answers) = os.pipe(), os.pipe()
        # Chromium reads from descriptor 3 and writes to 4.
        command = ["bash", "-c", f'exec 3<&{commands} 4>&{answers}; exec "$@"', "chromium", PROGRAM, *ARGUMENTS]
        command += [f"--user-data-dir={self.profile.name}", "about:blank"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self.child = subprocess.Popen(command, pass_fds=[commands, answers], **quiet)
        os.close(commands)
        os.close(answers)
        self.count, self.session, self.rest = 0, None, b""
        self.complaints, self.requests, self.received = [], [], 0
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ["Page", "Runtime", "Network", "Log"]:
            self.call(f"{domain}.enable")
        # Workers fetch, too.
        self.call("Target.setAutoAttach", autoAttach=True, waitForDebuggerOnStart=False, flatten=True)
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500)
        self.call("Emulation.setTouchEmulationEnabled", enabled=width < 500)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.opened = time.monotonic()
        self.call("Page.navigate", url=url)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.child.kill()
        self.child.wait()
        os.close(self.commands)
        os.close(self.answers)

    def post(self, method, session, parameters):
        self.count += 1
        message = {"id": self.count, "method": method, "params": parameters} | ({"sessionId": session} if session else {})
        os.write(self.commands, json.dumps(message).encode() + b"\0")
        return self.count

    def call(self, method, **parameters):
        """Calls a method of the protocol."""
        count = self.post(method, self.session, parameters)
        while True:
            while b"\0" not in self.rest:
                read = os.read(self.answers, 1 << 20)
                assert read, "Chromium has ended"
                self.rest += read
            text, self.rest = self.rest.split(b"\0", 1)
            message = json.loads(text)
            if message.get("id") == count:
                assert "error" not in message, f"{method}: {message['error']}"
                return message["result"]
            self.note(message.get("method"), message.get("params", {}))

    def note(self, event, parameters):
        if event == "Target.attachedToTarget" and self.session:
            for domain in ["Network", "Log", "Runtime"]:
                self.post(f"{domain}.enable", parameters["sessionId"], {})
        elif event == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])
        elif event == "Network.loadingFinished":
            self.received += parameters["encodedDataLength"]
        elif event == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(parameters["exceptionDetails"]))
        elif event == "Runtime.consoleAPICalled" and parameters["type"] in ["error", "warning"]:
            self.complaints.append(json.dumps(parameters["args"]))
        elif event == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.complaints.append(json.dumps(parameters["entry"]))

    def value(self, expression):
        """Evaluates an expression in the page."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, f"{expression}: {result['exceptionDetails']}"
        return result["result"].get("value")

    def wait(self, expression):
        """Waits until an expression is true."""
        start = time.monotonic()
        while not self.value(f"Boolean({expression})"):
            hint = self.value("document.querySelector('#hint')?.textContent")
            numbers = "JSON.stringify(window.state?.robots.map(({ reading }) => reading))"
            assert time.monotonic() < start + PATIENCE_S, f"waited for {expression}: {hint} {self.complaints} {self.value(numbers)}"
            time.sleep(0.03)

    def mouse(self, *events):
        """Sends mouse events: kind and place."""
        for kind, (x, y) in events:
            up = kind == "mouseReleased"
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=0 if up else 1, clickCount=1)

    def touch(self, kind, *places):
        """Sends a touch event with the fingers at these places."""
        self.call("Input.dispatchTouchEvent", type=kind, touchPoints=[{"x": x, "y": y} for x, y in places])

    def key(self, code, down):
        """Presses or releases a key."""
        self.call("Input.dispatchKeyEvent", type="rawKeyDown" if down else "keyUp", code=code, key=code.removeprefix("Key"))

    def picture(self):
        """Returns a picture of the page as PNG, in base64."""
        return self.call("Page.captureScreenshot", format="png")["data"]
