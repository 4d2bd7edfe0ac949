#!/usr/bin/env python3
"""The page with robots to push, in headless Chromium: it plays as scenarios do, hands push and pull, all files are its own.

    scripts/check_web [--pictures FOLDER]

Starts and pushes are the same in the page, whose MuJoCo is a newer one, and in the scenarios `push` and `leash`. Joint targets agree to
0.0001 rad over the first half second, decay and carried distance of ten pushes and the velocity along a leash to 5 %.
"""
import argparse
import base64
import functools
import http.server
import json
import math
import pathlib
import tempfile
import threading
import time

import numpy as np
import supple
from chromium import PROGRAM, Chromium

TOLERANCE_RAD, TOLERANCE = 1e-4, 0.05
MOST_BYTES = 6e6
ROBOTS = [("compliant", None), ("baseline", None), ("real", 0.03)]
COMMAND, PUSHES, PUSH_M_S, LEASH_N = [0.5, 0.0, 0.0], 10, [0.0, 0.5], [0.0, 20.0]
RATE_HZ = 60

# Plays scripts in a worker of the test's own, and measures pushes as the page does.
PLAY = """(async (scripts) => {
  const { Readout } = await import("./readout.js");
  const worker = new Worker("physics.js", { type: "module" });
  const answer = () => new Promise((resolve, reject) => (worker.onmessage = ({ data: [name, value] }) =>
    name === "fail" ? reject(new Error(value)) : name === "frames" && resolve(value)));
  const played = [];
  for (const play of scripts) {
    worker.postMessage(["play", play]);
    const frames = await answer();
    const readout = new Readout(1 / 60);
    for (const frame of frames) readout.note({ ...frame, pull: null });
    const some = ({ target, velocity, yaw, felt }) => ({ target, velocity, yaw, felt: felt.force });
    played.push({ frames: frames.map(some), push: readout.push });
  }
  worker.terminate();
  return played;
})"""

# The place of the first robot on the screen [pixels].
ROBOT = """(() => { const { views: [{ trunk, camera }], areas: [[left, , width, height]] } = state.picture;
    const { x, y } = trunk.clone().project(camera); return [left + (x + 1) / 2 * width, (1 - y) / 2 * height]; })()"""


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


def check_against_scenarios(page):
    """The same starts, pushes and pulls."""
    for policy, compliance in ROBOTS:
        commanded = {} if compliance is None else {"compliance": compliance}
        pushes = [supple.run_scenario("push", policy, seed, push_m_s=PUSH_M_S[1], **commanded) for seed in range(PUSHES)]
        leash = supple.run_scenario("leash", policy, force_n=LEASH_N[1], **commanded)
        start = time.monotonic()
        *played, pulled = page.value(f"{PLAY}({json.dumps(scripts(policy, compliance, pushes, leash))})")
        print(f"{policy}, compliance {compliance or 'its own'}: {PUSHES} pushes and a leash in {time.monotonic() - start:.1f} s")
        half = slice(0, RATE_HZ // 2)
        targets = np.array([frame["target"] for frame in played[0]["frames"]])[half] - pushes[0].trace["joint_targets"][half]
        print(f"  joint targets over the first half second: {np.abs(targets).max():.1e} rad")
        assert np.abs(targets).max() < TOLERANCE_RAD
        close("decay of a push to 10 % [s]", [it["push"]["decay_s"] for it in played], [run.metrics["decay_10_s"] for run in pushes])
        close("carried by a push [m]", [it["push"]["carried_m"] for it in played], [carried(run) for run in pushes])
        late = pulled["frames"][-5 * RATE_HZ:]
        close("velocity along a leash of 20 N [m/s]", [np.mean([along(frame) for frame in late])], [leash.metrics["leash_offset_m_s"]])
        felt = np.hypot(*leash.trace["felt_force"][-5 * RATE_HZ:, :2].T)
        close("felt force of the leash [N]", [np.mean([np.hypot(*frame["felt"][:2]) for frame in late])], [felt.mean()])


def scripts(policy, compliance, pushes, leash):
    """What the page plays: the pushes, then the leash."""
    common = {"policy": policy, "compliance": compliance, "command": COMMAND}
    step = lambda time_s: round(time_s * RATE_HZ)
    push = lambda run: {"steps": len(run.trace["time_s"]), "push": {"step": step(run.metrics["push_time_s"]), "size": PUSH_M_S}}
    pull = {"steps": len(leash.trace["time_s"]), "pull": {"step": step(2.0), "force": LEASH_N}}
    return [common | push(run) for run in pushes] + [common | pull]


def close(what, page, scenario):
    """Compares means, and tells how far a single one is off."""
    difference = np.mean(page) / np.mean(scenario) - 1
    single = np.abs(np.array(page) / np.array(scenario) - 1).max()
    one = f", a single one up to {100 * single:.0f} %" if len(page) > 1 else ""
    print(f"  {what}: {np.mean(page):.3f}, scenario {np.mean(scenario):.3f} ({100 * difference:+.2f} %{one})")
    assert abs(difference) < TOLERANCE, what


def along(frame):
    """The velocity to the left of the world beyond the commanded one, in a frame of the page [m/s]."""
    [forward, left, _], yaw = frame["velocity"], frame["yaw"]
    return (left - COMMAND[1]) * math.cos(yaw) + (forward - COMMAND[0]) * math.sin(yaw)


def carried(run):
    """The displacement to the left within two seconds, beyond the velocity of the second before [m]."""
    left, push = run.trace["velocity_in_heading"][:, 1], round(run.metrics["push_time_s"] * RATE_HZ)
    return (left[push:push + 2 * RATE_HZ] - left[push - RATE_HZ:push].mean()).sum() / RATE_HZ


def check_hands(page, pictures):
    """A drag pulls, a flick pushes, keys walk; on a large screen."""
    page.wait("window.state?.poses")
    print(f"first movement after {time.monotonic() - page.opened:.1f} s, {page.received / 1e6:.2f} MB")
    assert page.received < MOST_BYTES, page.received
    assert page.value("innerWidth >= document.documentElement.scrollWidth"), "the page is wider than the window"
    page.wait("state.rate && state.picture.rate")
    print("  {:.2f} times real time, {:.0f} pictures a second, drawn without a graphics processor".format(*page.value("[state.rate, state.picture.rate]")))
    keep(page, pictures, "before")
    robot = page.value(ROBOT)
    drag = [("mouseMoved", (robot[0] - 10 * step, robot[1] - 5 * step)) for step in range(1, 11)]
    page.mouse(("mousePressed", robot), *drag)
    pulled = "reading?.pull?.force_n > 10 && Math.hypot(...(reading.felt_n ?? [0])) > 0.8 * reading.pull.force_n"
    page.wait(f"state.robots.every(({{ reading }}) => {pulled})")
    page.wait("state.robots[0].reading.pull.gives_m_s > state.robots[1].reading.pull.gives_m_s + 0.1")
    keep(page, pictures, "during")
    # The mouse comes back, elsewhere, with no button pressed: it was released in another tab.
    x, y = page.value("(({ left, top }) => [left + 5, top + 5])(document.querySelector('#numbers').getBoundingClientRect())")
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, button="none", buttons=0)
    page.wait("state.robots.every(({ reading }) => reading.pull === null)")
    page.value("document.querySelector('#reset').click()")
    time.sleep(1)  # The camera follows.
    # The flick is made in the page: over the pipe, events may come too late.
    flick = f"""(() => {{ const canvas = document.querySelector("#robots canvas"), [x, clientY] = {ROBOT}; canvas.setPointerCapture = () => 0;
        for (const [kind, clientX] of [["down", x], ["move", x - 150], ["up", x - 150]])
          canvas.dispatchEvent(new PointerEvent("pointer" + kind, {{ pointerId: 9, buttons: 1, clientX, clientY, bubbles: true }})); }})()"""
    page.value(flick)
    page.wait("state.robots.every(({ reading }) => reading?.push?.carried_m > 0.01)")
    page.key("KeyW", True)
    page.wait("state.robots.every(({ reading }) => reading.command[0] > 0.5 && reading.velocity[0] > 0.3)")
    page.key("KeyW", False)
    # While paused, a reset is seen.
    page.value("document.querySelector('#pause').click()")
    time.sleep(0.5)  # What was on its way has arrived.
    page.value("(() => { state.poses = null; document.querySelector('#reset').click(); })()")
    page.wait("state.poses")
    page.value("document.querySelector('#pause').click()")
    for scene in ["ball pit", "blocks"]:
        choose = f"const list = document.querySelector('#scene'); list.value = '{scene}'; list.onchange()"
        page.value(f"(() => {{ state.robots[0].reading = null; {choose}; }})()")
        page.wait("state.poses[0].places.length > 100 && state.robots[0].reading")
    page.value("(() => { const list = document.querySelector('#pair'); list.selectedIndex = 1; list.onchange(); })()")
    page.wait("state.robots[0].name === 'compliant' && state.robots[1].reading")
    page.wait("document.querySelector('#numbers').innerText.includes('baseline')")


def check_fingers(page, pictures):
    """A finger pulls on a telephone, and a robot that lies stands up by a button."""
    page.wait("window.state?.robots[1]?.reading")
    assert page.value("innerWidth >= document.documentElement.scrollWidth"), "the page is wider than the window"
    keep(page, pictures, "telephone, before")
    robot = page.value(ROBOT)
    page.touch("touchStart", robot)
    for step in range(1, 11):
        page.touch("touchMove", (robot[0] - 5 * step, robot[1] - 4 * step))
    page.wait("state.robots.every(({ reading }) => reading?.pull?.force_n > 10)")
    page.wait("state.robots[0].reading.pull.gives_m_s > state.robots[1].reading.pull.gives_m_s + 0.1")
    keep(page, pictures, "telephone, during")
    page.touch("touchMove", (robot[0], 2))
    page.wait("state.robots.every(({ reading }) => reading.pull.force_n > 50)")  # Above the horizon, too.
    page.touch("touchStart", (robot[0], 2), robot)
    page.wait("state.robots.every(({ reading }) => reading.pull === null)")  # Two fingers zoom.
    page.touch("touchEnd")
    page.value("state.send('push', [0, 6])")
    page.wait("state.poses.some(({ lies }) => lies) && state.robots.some(({ falls }) => falls)")
    page.value("document.querySelector('#stand').click()")
    page.wait("state.poses.every(({ lies, position }) => !lies && position[2] > 0.28)")
    falls = page.value("state.robots.map(({ falls }) => falls)")
    page.value("state.send('push', [1e9, 0])")  # Too large for MuJoCo, which starts anew: a fall.
    page.wait(f"state.robots.every(({{ falls }}, robot) => falls > {falls}[robot])")


def keep(page, pictures, name):
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
        # As fine as a graphics processor draws.
        page.value("(() => { state.picture.count = () => 0; state.picture.fineness = 0; state.picture.resize(); })()")
        time.sleep(2)
        (pictures / f"{name}.png").write_bytes(base64.b64decode(page.picture()))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", type=pathlib.Path, help="the folder that scripts/site makes")
    parser.add_argument("--pictures", type=pathlib.Path, help="writes pictures of the page into this folder")
    given = parser.parse_args()
    if not pathlib.Path(PROGRAM).exists():
        raise SystemExit(f"error: there is no {PROGRAM}: scripts/setup chromium installs it")
    with tempfile.TemporaryDirectory() as root:
        # From a sub-path, as sites of repositories have.
        (pathlib.Path(root) / "sub").symlink_to(given.site.resolve())
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=root))
        threading.Thread(target=server.serve_forever, daemon=True).start()
        host = f"http://127.0.0.1:{server.server_port}/"
        for check, width, height, dark in [(check_hands, 1440, 900, False), (check_fingers, 390, 844, True)]:
            with Chromium(f"{host}sub/web/index.html", width, height, dark) as page:
                check(page, given.pictures)
                if check is check_hands:
                    check_against_scenarios(page)
                assert page.complaints == [], page.complaints
                strange = [url for url in page.requests if not url.startswith((host, "data:", f"blob:{host}"))]
                assert strange == [], strange
    print("3 passed, 0 failed")


main()
