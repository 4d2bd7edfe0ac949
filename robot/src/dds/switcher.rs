//! The service `motion_switcher`: which mode the robot is in, and the release of that mode, which a controller of motors needs
//! first. [`serve`] is the robot's side, [`Client`] the controller's.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use dust_dds::infrastructure::type_support::DdsType;
use serde::Deserialize;

use super::{Delivery, Node, NodeError, Publisher, Subscription};

/// Name and number of a request.
#[derive(DdsType, Debug, Clone, PartialEq)]
#[dust_dds(name = "unitree_api::msg::dds_::RequestIdentity_")]
pub struct Identity {
    /// Number of the request, which the response repeats.
    pub id: i64,
    /// Number of the function.
    pub api_id: i64,
}

/// The lease of a client.
#[derive(DdsType, Debug, Clone, PartialEq)]
#[dust_dds(name = "unitree_api::msg::dds_::RequestLease_")]
pub struct Lease {
    /// Number of the lease; 0 for none.
    pub id: i64,
}

/// Handling of a request.
#[derive(DdsType, Debug, Clone, PartialEq)]
#[dust_dds(name = "unitree_api::msg::dds_::RequestPolicy_")]
pub struct RequestPolicy {
    /// Priority.
    pub priority: i32,
    /// True if no response is wanted.
    pub noreply: bool,
}

/// Header of a request.
#[derive(DdsType, Debug, Clone, PartialEq)]
#[dust_dds(name = "unitree_api::msg::dds_::RequestHeader_")]
pub struct RequestHeader {
    /// Name and number.
    pub identity: Identity,
    /// Lease of the client.
    pub lease: Lease,
    /// Handling.
    pub policy: RequestPolicy,
}

/// A request.
#[derive(DdsType, Debug, Clone, PartialEq)]
#[dust_dds(name = "unitree_api::msg::dds_::Request_")]
pub struct Request {
    /// Header.
    pub header: RequestHeader,
    /// Parameters as JSON.
    pub parameter: String,
    /// Binary parameters.
    pub binary: Vec<u8>,
}

/// Result of a request.
#[derive(DdsType, Debug, Clone, PartialEq)]
#[dust_dds(name = "unitree_api::msg::dds_::ResponseStatus_")]
pub struct Status {
    /// 0 if it succeeded.
    pub code: i32,
}

/// Header of a response.
#[derive(DdsType, Debug, Clone, PartialEq)]
#[dust_dds(name = "unitree_api::msg::dds_::ResponseHeader_")]
pub struct ResponseHeader {
    /// That of the request.
    pub identity: Identity,
    /// Result.
    pub status: Status,
}

/// A response.
#[derive(DdsType, Debug, Clone, PartialEq)]
#[dust_dds(name = "unitree_api::msg::dds_::Response_")]
pub struct Response {
    /// Header.
    pub header: ResponseHeader,
    /// Result as JSON.
    pub data: String,
    /// Binary result.
    pub binary: Vec<u8>,
}

/// Names of the services that the robot answers: the switcher, and its own controller, which clients ask to lie down first.
const SWITCHER: &str = "motion_switcher";
const SPORT: &str = "sport";

const REQUEST: &str = "unitree_api::msg::dds_::Request_";
const RESPONSE: &str = "unitree_api::msg::dds_::Response_";

/// Returns the topics of requests and responses of a service.
fn topics(service: &str) -> [String; 2] {
    ["request", "response"].map(|kind| format!("rt/api/{service}/{kind}"))
}

const CHECK_MODE: i64 = 1001;
const SELECT_MODE: i64 = 1002;
const RELEASE_MODE: i64 = 1003;
const NOT_IMPLEMENTED: i32 = 3203;
const BAD_PARAMETER: i32 = 7001;

/// Name of the mode in which a robot starts.
const NORMAL: &str = "normal";

/// The robot's mode: the name of its own controller, or empty where it has been released.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mode(String);

impl Default for Mode {
    fn default() -> Self {
        Mode(NORMAL.to_owned())
    }
}

/// The parameter of SelectMode, and the result of CheckMode.
#[derive(Deserialize)]
struct Name {
    name: String,
}

impl Mode {
    /// Returns true if the robot's own controller has been released.
    pub fn is_released(&self) -> bool {
        self.0.is_empty()
    }

    /// Answers a request: code and data.
    pub fn answer(&mut self, function: i64, parameter: &str) -> (i32, String) {
        match function {
            CHECK_MODE => (0, serde_json::json!({"form": "0", "name": self.0}).to_string()),
            SELECT_MODE => match serde_json::from_str(parameter) {
                Ok(Name { name }) => {
                    self.0 = name;
                    (0, String::new())
                }
                Err(_) => (BAD_PARAMETER, String::new()),
            },
            RELEASE_MODE => {
                self.0.clear();
                (0, String::new())
            }
            _ => (NOT_IMPLEMENTED, String::new()),
        }
    }
}

/// Answers requests until it is dropped; calls `changed` with the mode after each request to the switcher. The robot's own
/// controller says yes to everything until it is released, and is silent then.
///
/// # Errors
/// The topics cannot be opened.
pub fn serve(node: &Node, mut changed: impl FnMut(&Mode) + Send + 'static) -> Result<impl Sized, NodeError> {
    let mode = Arc::new(Mutex::new(Mode::default()));
    let asked = Arc::clone(&mode);
    let switcher = answer(node, SWITCHER, move |function, parameter| {
        let mut mode = asked.lock().unwrap_or_else(PoisonError::into_inner);
        let answer = mode.answer(function, parameter);
        changed(&mode);
        Some(answer)
    })?;
    let sport = answer(node, SPORT, move |_, _| {
        let mode = mode.lock().unwrap_or_else(PoisonError::into_inner);
        (!mode.is_released()).then_some((0, String::new()))
    })?;
    Ok([switcher, sport])
}

/// Answers the requests to a service with code and data; `None` is no answer.
fn answer(
    node: &Node,
    service: &str,
    mut answer: impl FnMut(i64, &str) -> Option<(i32, String)> + Send + 'static,
) -> Result<Subscription<Request>, NodeError> {
    let [requests, responses] = topics(service);
    let responses: Publisher<Response> = node.publish(&responses, RESPONSE, Delivery::Reliable)?;
    let (sender, arrived) = channel::<Request>();
    // Answered in a thread of its own: a listener must not wait for a writer of the same participant.
    std::thread::spawn(move || {
        for Request { header, parameter, .. } in arrived {
            let Some((code, data)) = answer(header.identity.api_id, &parameter) else { continue };
            if !header.policy.noreply {
                let header = ResponseHeader { identity: header.identity, status: Status { code } };
                // A client that is gone gets no answer.
                let _ = responses.send(Response { header, data, binary: Vec::new() });
            }
        }
    });
    node.listen::<Request>(&requests, REQUEST, Delivery::Reliable, move |arrival| {
        let _ = sender.send(arrival.message);
    })
}

/// The reason why the robot's mode could not be asked or released.
#[derive(Debug, thiserror::Error)]
pub enum SwitchError {
    /// The robot does not answer.
    #[error(
        "motion_switcher does not answer within {} s: is the robot on, and its firmware 1.0.24 or newer? A simulator without this \
         service needs --no-release", TIMEOUT.as_secs()
    )]
    Silent,
    /// The robot refuses.
    #[error("motion_switcher refuses function {function} with code {code}")]
    Refused {
        /// Number of the function.
        function: i64,
        /// Code of the response.
        code: i32,
    },
    /// The answer is no JSON of a mode.
    #[error("motion_switcher answers '{found}', expected JSON with a name")]
    Answer {
        /// The data of the response.
        found: String,
    },
    /// The robot keeps its mode.
    #[error("the robot stays in mode '{mode}' after {RELEASES} releases: switch its services off in the vendor's app")]
    Kept {
        /// Name of the mode.
        mode: String,
    },
    /// DDS fails.
    #[error(transparent)]
    Node(#[from] NodeError),
}

/// Time that a response may take.
const TIMEOUT: Duration = Duration::from_secs(3);

/// Number of releases before giving up.
const RELEASES: u32 = 5;

/// The controller's side of the service.
pub struct Client {
    requests: Publisher<Request>,
    responses: Receiver<Response>,
    _listening: Subscription<Response>,
    id: i64,
}

impl Client {
    /// Opens the topics.
    ///
    /// # Errors
    /// The topics cannot be opened.
    pub fn new(node: &Node) -> Result<Self, NodeError> {
        let (sender, responses) = channel();
        let [requests, replies] = topics(SWITCHER);
        let listening = node.listen::<Response>(&replies, RESPONSE, Delivery::Reliable, move |arrival| {
            let _ = sender.send(arrival.message);
        })?;
        let requests = node.publish(&requests, REQUEST, Delivery::Reliable)?;
        Ok(Client { requests, responses, _listening: listening, id: 0 })
    }

    fn call(&mut self, function: i64) -> Result<String, SwitchError> {
        let deadline = Instant::now() + TIMEOUT;
        // A request that is sent before the service has been discovered is lost: it is sent again.
        while Instant::now() < deadline {
            self.id += 1;
            let header = RequestHeader {
                identity: Identity { id: self.id, api_id: function },
                lease: Lease { id: 0 },
                policy: RequestPolicy { priority: 0, noreply: false },
            };
            self.requests.send(Request { header, parameter: String::new(), binary: Vec::new() })?;
            let until = Instant::now() + Duration::from_millis(500);
            while let Ok(response) = self.responses.recv_timeout(until.saturating_duration_since(Instant::now())) {
                if response.header.identity.api_id != function || response.header.identity.id > self.id {
                    continue;
                }
                return match response.header.status.code {
                    0 => Ok(response.data),
                    code => Err(SwitchError::Refused { function, code }),
                };
            }
        }
        Err(SwitchError::Silent)
    }

    /// Returns the name of the robot's mode; empty if it has been released.
    ///
    /// # Errors
    /// The robot does not answer, or refuses.
    pub fn mode(&mut self) -> Result<String, SwitchError> {
        let data = self.call(CHECK_MODE)?;
        match serde_json::from_str(&data) {
            Ok(Name { name }) => Ok(name),
            Err(_) => Err(SwitchError::Answer { found: data }),
        }
    }

    /// Releases the robot's own controller, and returns the mode in which the robot was. Nothing is released once `stop` is true.
    ///
    /// # Errors
    /// The robot does not answer, refuses, or keeps its mode.
    pub fn release(&mut self, stop: &AtomicBool) -> Result<String, SwitchError> {
        let first = self.mode()?;
        let mut mode = first.clone();
        for _ in 0..RELEASES {
            if mode.is_empty() || stop.load(Ordering::Relaxed) {
                return Ok(first);
            }
            self.call(RELEASE_MODE)?;
            mode = self.mode()?;
            if !mode.is_empty() {
                std::thread::sleep(Duration::from_secs(1));
            }
        }
        if mode.is_empty() { Ok(first) } else { Err(SwitchError::Kept { mode }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mode_is_checked_selected_and_released() {
        let mut mode = Mode::default();
        assert_eq!(mode.answer(CHECK_MODE, ""), (0, r#"{"form":"0","name":"normal"}"#.to_owned()));
        assert_eq!(mode.answer(RELEASE_MODE, ""), (0, String::new()));
        assert!(mode.is_released());
        assert_eq!(mode.answer(SELECT_MODE, r#"{"name": "ai"}"#), (0, String::new()));
        assert_eq!(mode.answer(CHECK_MODE, ""), (0, r#"{"form":"0","name":"ai"}"#.to_owned()));
        assert_eq!(mode.answer(SELECT_MODE, "ai").0, BAD_PARAMETER);
        assert_eq!(mode.answer(1009, "").0, NOT_IMPLEMENTED);
    }
}
