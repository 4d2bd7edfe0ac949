//! Headless Chromium for tests, controlled over its own protocol: keys, mouse, scripts, pictures.
#![allow(dead_code)] // No test uses all of it.

use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

use crate::common::PATIENCE;

/// A page in a browser of its own.
pub struct Chromium {
    child: Child,
    _profile: tempfile::TempDir,
    socket: WebSocket<TcpStream>,
    session: String,
    count: u64,
    /// Addresses that the page has requested.
    pub requests: Vec<String>,
    /// Errors reported by the page.
    pub complaints: Vec<String>,
}

impl Chromium {
    /// Opens a page of this size [pixels]; returns `None` if there is no Chromium.
    pub fn open(url: &str, width: u32, height: u32, dark: bool) -> Option<Chromium> {
        let program = Path::new("/usr/bin/chromium");
        if !program.exists() {
            eprintln!("SKIPPED: there is no /usr/bin/chromium (Debian package chromium)");
            return None;
        }
        let profile = tempfile::tempdir().unwrap();
        let child = Command::new(program)
            .args(["--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--mute-audio"])
            .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
            .args(["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0"])
            .arg(format!("--window-size={width},{height}"))
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let start = Instant::now();
        let (port, path) = loop {
            assert!(start.elapsed() < PATIENCE, "Chromium does not start");
            let text = std::fs::read_to_string(profile.path().join("DevToolsActivePort")).unwrap_or_default();
            if let Some((port, path)) = text.split_once('\n') {
                break (port.to_owned(), path.trim().to_owned());
            }
            std::thread::sleep(Duration::from_millis(20));
        };
        let stream = TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let request = format!("ws://127.0.0.1:{port}{path}").into_client_request().unwrap();
        let (socket, _) = tungstenite::client(request, stream).unwrap();
        let (requests, complaints) = (Vec::new(), Vec::new());
        let mut browser =
            Chromium { child, _profile: profile, socket, session: String::new(), count: 0, requests, complaints };
        let target = browser.call("Target.createTarget", json!({ "url": "about:blank" }))["targetId"].clone();
        let attached = browser.call("Target.attachToTarget", json!({ "targetId": target, "flatten": true }));
        browser.session = attached["sessionId"].as_str().unwrap().to_owned();
        for domain in ["Page", "Runtime", "Network", "Log"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        let screen = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", screen);
        let scheme = if dark { "dark" } else { "light" };
        let features = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
        browser.call("Emulation.setEmulatedMedia", features);
        browser.call("Page.navigate", json!({ "url": url }));
        Some(browser)
    }

    /// Calls a method of the protocol.
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        let id = self.post(method, parameters);
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let message: Value = serde_json::from_str(&text).unwrap();
            if message["id"] == id {
                assert!(message["error"].is_null(), "{method}: {}", message["error"]);
                return message["result"].clone();
            }
            self.note(&message["params"], message["method"].as_str().unwrap_or_default());
        }
    }

    /// Calls a method without waiting for its answer.
    pub fn post(&mut self, method: &str, parameters: Value) -> u64 {
        self.count += 1;
        let mut message = json!({ "id": self.count, "method": method, "params": parameters });
        if !self.session.is_empty() {
            message["sessionId"] = json!(self.session);
        }
        self.socket.send(Message::text(message.to_string())).unwrap();
        self.count
    }

    fn note(&mut self, parameters: &Value, event: &str) {
        let complaint = match event {
            "Network.requestWillBeSent" => {
                return self.requests.push(parameters["request"]["url"].as_str().unwrap_or_default().to_owned());
            }
            "Runtime.exceptionThrown" => &parameters["exceptionDetails"],
            "Runtime.consoleAPICalled" if parameters["type"] == "error" => &parameters["args"],
            "Log.entryAdded" if parameters["entry"]["level"] == "error" => &parameters["entry"],
            _ => return,
        };
        self.complaints.push(complaint.to_string());
    }

    /// Evaluates an expression in the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let parameters = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let result = self.call("Runtime.evaluate", parameters);
        assert!(result["exceptionDetails"].is_null(), "{expression}: {}", result["exceptionDetails"]);
        result["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub fn wait(&mut self, expression: &str) {
        let start = Instant::now();
        while self.value(&format!("Boolean({expression})")) != true {
            if start.elapsed() > PATIENCE {
                let state = self.value("window.state ?? document.body.innerText");
                panic!("waited for {expression}; complaints: {:?}; state: {state}", self.complaints);
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub fn key(&mut self, code: &str, down: bool) {
        let kind = if down { "rawKeyDown" } else { "keyUp" };
        let event = json!({ "type": kind, "code": code, "key": code.trim_start_matches("Key") });
        self.call("Input.dispatchKeyEvent", event);
    }

    /// Sends mouse events, one right after the other.
    pub fn mouse(&mut self, events: &[(&str, [f64; 2])]) {
        for (kind, [x, y]) in events {
            let event = json!({ "type": kind, "x": x, "y": y, "button": "left", "buttons": 1, "clickCount": 1 });
            self.post("Input.dispatchMouseEvent", event);
        }
    }

    /// Returns the middle and the width of an element on the screen [pixels].
    pub fn place(&mut self, selector: &str) -> ([f64; 2], f64) {
        let find = format!(
            "(() => {{ const e = document.querySelector('{selector}'); e.scrollIntoView({{ block: 'center' }}); \
             const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2, r.width]; }})()"
        );
        let found = self.value(&find);
        let number = |index: usize| found[index].as_f64().unwrap();
        ([number(0), number(1)], number(2))
    }

    /// Returns a picture of the page as PNG, in base64.
    pub fn picture(&mut self) -> String {
        self.call("Page.captureScreenshot", json!({ "format": "png" }))["data"].as_str().unwrap().to_owned()
    }
}

impl Drop for Chromium {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
