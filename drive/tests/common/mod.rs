//! A running `drive` for tests, and pages that talk to it.
#![allow(dead_code)] // No test uses all of it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

/// Longest time that a test waits for anything; busy machines are slow.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// A running program, killed when it goes out of scope.
pub struct Drive {
    child: Child,
    /// Host and port of the program.
    pub host: String,
    pub token: String,
}

impl Drive {
    /// Starts the program in a folder.
    pub fn start(folder: &Path, arguments: &[&str]) -> Drive {
        let mut command = Command::new(env!("CARGO_BIN_EXE_drive"));
        command.args(["--no-open", "--port", "0"]).args(arguments).current_dir(folder).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        let (host, token) = url.trim().strip_prefix("http://").unwrap().split_once("/?token=").unwrap();
        Drive { child, host: host.to_owned(), token: token.to_owned() }
    }

    pub fn url(&self) -> String {
        format!("http://{}/?token={}", self.host, self.token)
    }

    /// Opens a socket as the server's own pages do.
    pub fn open(&self, path: &str) -> WebSocket<TcpStream> {
        self.socket(path, Some(&format!("http://{}", self.host)), &self.token).unwrap()
    }

    /// Opens the socket of a page.
    pub fn page(&self) -> Page {
        let socket = self.open("/control");
        let mut page = Page { socket, state: Value::Null, me: 0 };
        page.me = page.wait("a greeting", |_, message| message["hello"]["page"].as_u64());
        page
    }

    /// Opens a socket; returns the HTTP status if it is refused.
    pub fn socket(&self, path: &str, origin: Option<&str>, token: &str) -> Result<WebSocket<TcpStream>, u16> {
        let mut request = format!("ws://{}{path}?token={token}", self.host).into_client_request().unwrap();
        if let Some(origin) = origin {
            request.headers_mut().insert("Origin", origin.parse().unwrap());
        }
        let stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.set_nodelay(true).unwrap();
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => Ok(socket),
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(response))) => {
                Err(response.status().as_u16())
            }
            Err(error) => panic!("{error}"),
        }
    }

    /// Returns the answer to a plain GET request.
    pub fn get(&self, path: &str, host: &str) -> String {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8_lossy(&answer).into_owned()
    }

    /// Returns the number of threads of the program.
    pub fn threads(&self) -> usize {
        std::fs::read_dir(format!("/proc/{}/task", self.child.id())).unwrap().count()
    }

    /// Sends a signal to the program, by its name.
    pub fn signal(&self, name: &str) {
        let sent = Command::new("kill").args(["-s", name, &self.child.id().to_string()]).status();
        assert!(sent.unwrap().success());
    }

    /// Waits for the end of the program and returns its exit code; `None` if it goes on.
    pub fn ends_within(&mut self, time: Duration) -> Option<i32> {
        let start = Instant::now();
        while start.elapsed() < time {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        None
    }
}

impl Drop for Drive {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A page's connection, without a browser.
pub struct Page {
    pub socket: WebSocket<TcpStream>,
    /// The newest state that the program sent.
    pub state: Value,
    pub me: u64,
}

impl Page {
    pub fn send(&mut self, request: &Value) {
        self.socket.send(Message::text(request.to_string())).unwrap();
    }

    /// Reads states until one has these values, by their JSON pointers.
    pub fn wait_for(&mut self, what: &str, values: &[(&str, Value)]) {
        let is =
            |state: &Value, (pointer, value): &(&str, Value)| state.pointer(pointer).unwrap_or(&Value::Null) == value;
        self.wait(what, |state, _| (state.is_object() && values.iter().all(|pair| is(state, pair))).then_some(()));
    }

    /// Reads states and answers until `find` returns something.
    pub fn wait<T>(&mut self, what: &str, mut find: impl FnMut(&Value, &Value) -> Option<T>) -> T {
        let start = Instant::now();
        loop {
            assert!(start.elapsed() < PATIENCE, "waited for {what}; the last state was {}", self.state);
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let message: Value = serde_json::from_str(&text).unwrap();
            if message["state"].is_object() {
                self.state = message["state"].clone();
            }
            if let Some(found) = find(&self.state, &message) {
                return found;
            }
        }
    }

    /// Repeats a command, as pages do, for a given time.
    pub fn ask_for(&mut self, command: [f64; 3], time: Duration) {
        let start = Instant::now();
        while start.elapsed() < time {
            self.send(&serde_json::json!({ "command": command }));
            let next = Instant::now() + Duration::from_millis(50);
            self.wait("states", |_, _| (Instant::now() >= next).then_some(()));
        }
    }

    /// Returns a number of the newest state, by its JSON pointer.
    pub fn number(&self, pointer: &str) -> f64 {
        self.state.pointer(pointer).and_then(Value::as_f64).unwrap_or_else(|| panic!("{pointer} of {}", self.state))
    }

    /// Waits for a notice that contains `part` and returns it.
    pub fn notice(&mut self, part: &str) -> String {
        self.wait(part, |state, _| {
            let texts = state["notices"][1].as_array()?;
            texts.iter().filter_map(Value::as_str).find(|text| text.contains(part)).map(ToOwned::to_owned)
        })
    }
}

/// A running program in a folder of its own, and a page.
pub fn start(arguments: &[&str]) -> (tempfile::TempDir, Drive, Page) {
    let folder = tempfile::tempdir().unwrap();
    let drive = Drive::start(folder.path(), arguments);
    let page = drive.page();
    (folder, drive, page)
}

/// Replays a session with the program, and returns its output.
pub fn replay(folder: &Path, session: &str, arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_drive"));
    program.args(["--replay", session, "--headless"]).args(arguments).current_dir(folder).output().unwrap()
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).trim().to_owned()
}
