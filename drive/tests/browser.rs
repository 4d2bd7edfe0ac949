//! Tests of `drive` in headless Chromium, with keys, mouse and gamepad.

#[path = "common/chromium.rs"]
mod chromium;
mod common;

use std::time::Duration;

use chromium::Chromium;
use common::Drive;

/// Expression for the first robot's forward velocity in the page.
const FORWARD: &str = "state?.robots[0].reading?.velocity[0]";

#[test]
fn keys_walk_and_pad_pushes_and_pulls_robots() {
    let folder = tempfile::tempdir().unwrap();
    let drive = Drive::start(folder.path(), &["--policy", "compliant", "--compare", "baseline"]);
    let Some(mut browser) = Chromium::open(&drive.url(), 1280, 900, false) else { return };
    browser.wait("window.state?.robots[1].reading");
    // The viewer takes the focus when it starts, and keys that are held are let go.
    browser.wait("document.querySelector('iframe').dataset.ready");

    // Forward as long as W is held, at the fraction of the range that a key commands.
    browser.key("KeyW", true);
    browser.wait(&format!("{FORWARD} > 0.6 * 0.6 * state.range[0] && state.robots[1].position[0] > 0.15"));
    browser.key("KeyW", false);
    browser.wait("state.robots[0].reading.command.every((part) => part === 0)");
    browser.key("ArrowLeft", true);
    browser.wait("state.robots[0].reading.velocity[2] > 0.2 && state.robots[1].reading.velocity[2] > 0.2");
    browser.key("ArrowLeft", false);
    // A turning robot falls more easily, and another command ends the measurement of a push.
    let calm = "reading.command.every((part) => part === 0) && reading.velocity.every((part) => Math.abs(part) < 0.15)";
    browser.wait(&format!("state.robots.every(({{ reading }}) => {calm})"));

    // A third of the way to the left rim of the pad is a third of the largest push: 1 m/s to the left.
    let (middle, width) = browser.place("#pad");
    let (half, third) = (50.0 / 220.0 * width, 100.0 / 3.0 / 220.0 * width);
    let [x, y] = middle;
    let left = [x - third, y];
    let moved = "mouseMoved";
    browser.mouse(&[("mousePressed", middle), (moved, [x - 10.0, y]), (moved, left), ("mouseReleased", left)]);
    browser.wait("state.robots[1].reading.push?.carried_m > 0.1");
    let sizes = browser.value("state.robots.map((robot) => robot.reading.push.size_m_s)");
    for size in sizes.as_array().unwrap() {
        let [forward, left] = [0, 1].map(|part| size[part].as_f64().unwrap());
        assert!(forward.abs() < 0.02 && (left - 1.0).abs() < 0.03, "{sizes}");
    }
    browser.wait("state.robots[0].reading.push.carried_m !== state.robots[1].reading.push.carried_m");
    browser.wait("document.querySelector('#numbers').innerText.includes('1.00')");

    // Held still, a drag forward pulls, for as long as it is held: half of the largest force.
    browser.mouse(&[("mousePressed", middle), ("mouseMoved", [x, y - half])]);
    browser.wait("state.robots.every(({ reading }) => Math.abs(reading.pull?.force_n - 50) < 1)");
    browser.wait("state.robots.every(({ reading }) => Math.abs(reading.felt_n?.[0] - 50) < 5)");
    browser.wait("document.querySelector('#numbers').innerText.includes(' forward')");
    browser.mouse(&[("mouseReleased", [x, y - half])]);
    browser.wait("state.robots.every(({ reading }) => reading.pull === null)");
    assert_eq!(browser.value("state.robots[0].reading.push.size_m_s[1] > 0.9"), true, "letting go is no push");

    // By keyboard alone: the numbers beside the pad.
    browser.value("document.querySelector('#left').value = '-0.7'; document.querySelector('#push-button').focus()");
    browser.value("document.querySelector('#ahead').value = '0'");
    let enter = serde_json::json!({ "type": "keyDown", "key": "Enter", "code": "Enter", "text": "\r" });
    browser.call("Input.dispatchKeyEvent", enter);
    browser.wait("state.robots[0].reading.push.size_m_s[1] === -0.7");
    // The numbers as a pull, during which a push comes from a gamepad: letting go still ends it.
    browser.value("document.querySelector('#unit').value = 'N'; document.querySelector('#unit').onchange()");
    let enter = |kind: &str| serde_json::json!({ "type": kind, "key": "Enter", "code": "Enter" });
    browser.call("Input.dispatchKeyEvent", enter("rawKeyDown"));
    browser.wait("state.robots.every(({ reading }) => reading.pull?.force_n > 0.6)");
    browser.value("navigator.getGamepads = () => [{ axes: [0, 0, 0, 0], buttons: [{ pressed: true }] }], 0");
    browser.wait("document.querySelector('#push-button').textContent === 'Push'");
    browser.value("navigator.getGamepads = () => [], 0");
    browser.call("Input.dispatchKeyEvent", enter("keyUp"));
    browser.wait("!document.querySelector('#push-button').classList.contains('held')");
    browser.wait("state.robots.every(({ reading }) => reading.pull === null)");

    // A gamepad, its left stick forward to the end.
    browser.value("navigator.getGamepads = () => [{ axes: [0, -1, 0, 0], buttons: [] }], 0");
    browser.wait("state.robots.every(({ reading }) => reading.command[0] === state.range[0])");
    browser.value("navigator.getGamepads = () => [], 0");

    // The middle of the second slider: half of the second robot's largest commanded compliance.
    let (middle, _) = browser.place("#compliance label:nth-child(2) input");
    browser.mouse(&[("mousePressed", middle), ("mouseReleased", middle)]);
    browser.wait("Math.abs(state.robots[1].compliance - 0.5 * state.robots[1].reach[0][1]) < 0.002");
    assert_eq!(browser.value("state.robots[0].compliance"), serde_json::Value::Null);
    browser.wait("document.querySelector('#compliance').innerText.includes('own, 0.0')");
    // Titles say what is commanded now.
    let title = "`${state.robots[1].name}@${+state.robots[1].compliance.toFixed(6)}`";
    for place in ["#numbers thead", "#legend .second"] {
        browser.wait(&format!("document.querySelector('{place}').innerText.includes({title})"));
    }
    assert_eq!(browser.value("document.querySelector('#legend .first').innerText"), "compliant");

    assert_eq!(browser.complaints, [""; 0]);
    let ours = format!("http://{}", drive.host);
    let other = ours.replace("127.0.0.1", "localhost");
    let is_ours = |url: &str| url.starts_with(&ours) || url.starts_with(&other);
    let strange: Vec<&String> = browser.requests.iter().filter(|url| !is_ours(url)).collect();
    assert!(strange.iter().all(|url| url.starts_with("data:") || url.starts_with("blob:")), "{strange:?}");
}

#[test]
fn viewer_draws_and_page_fits_phone() {
    let folder = tempfile::tempdir().unwrap();
    let drive = Drive::start(folder.path(), &[]);
    let Some(mut browser) = Chromium::open(&drive.url(), 390, 780, true) else { return };
    // The viewer has started, and has drawn something of many colours where there was one.
    browser.wait("document.querySelector('iframe')?.dataset.ready");
    let mut looks = (0..100).map(|_| {
        std::thread::sleep(Duration::from_millis(200));
        browser.picture().len()
    });
    assert!(looks.any(|bytes| bytes > 60_000), "the viewer draws nothing");
    // Nothing is wider than the screen, and sticks are whole on phones and beside robots.
    assert_eq!(browser.value("document.documentElement.scrollWidth"), 390);
    let fits = "['#stick', '#wheel', '#pad'].every((it) => document.querySelector(it).getBoundingClientRect().bottom < innerHeight)";
    let narrow = "document.querySelector('#panel').scrollWidth - document.querySelector('#panel').clientWidth";
    for [width, height] in [[390, 780], [900, 600], [1440, 900]] {
        let size = serde_json::json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", size);
        browser.wait(&format!("innerWidth === {width} && {fits}"));
        assert_eq!(browser.value(narrow), 0, "{width}");
    }
    assert_eq!(browser.complaints, [""; 0]);
}
