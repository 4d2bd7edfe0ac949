//! The service `motion_switcher`: which mode the robot is in, and the release of that mode, which a controller of motors needs
//! first. [`serve`] is the robot's side, [`Client`] the controller's.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow, bail, ensure};
use dust_dds::infrastructure::type_support::DdsType;
use serde::Deserialize;

use super::{Arrival, Delivery, Node, Publisher, Subscription};

/// Defines messages of the service by their DDS names.
macro_rules! messages {
    ($($(#[$about:meta])* $name:ident = $dds:literal { $($field:ident: $t:ty),* })*) => {$(
        $(#[$about])*
        #[derive(DdsType, Debug, Clone, PartialEq)]
        #[dust_dds(name = $dds)]
        pub struct $name { $(pub $field: $t),* }
    )*};
}
messages! {
    /// Number of the request, which the response repeats, and number of the function.
    Identity = "unitree_api::msg::dds_::RequestIdentity_" { id: i64, api_id: i64 }
    /// The lease of a client; 0 for none.
    Lease = "unitree_api::msg::dds_::RequestLease_" { id: i64 }
    /// Handling of a request; `noreply` if no response is wanted.
    RequestPolicy = "unitree_api::msg::dds_::RequestPolicy_" { priority: i32, noreply: bool }
    RequestHeader = "unitree_api::msg::dds_::RequestHeader_" {
        identity: Identity, lease: Lease, policy: RequestPolicy
    }
    /// A request, with parameters as JSON.
    Request = "unitree_api::msg::dds_::Request_" { header: RequestHeader, parameter: String, binary: Vec<u8> }
    /// Result of a request: 0 if it succeeded.
    Status = "unitree_api::msg::dds_::ResponseStatus_" { code: i32 }
    ResponseHeader = "unitree_api::msg::dds_::ResponseHeader_" { identity: Identity, status: Status }
    /// A response, with its result as JSON.
    Response = "unitree_api::msg::dds_::Response_" { header: ResponseHeader, data: String, binary: Vec<u8> }
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

/// The robot's mode: the name of its own controller, or empty where it has been released.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mode(String);

/// The parameter of SelectMode, and the result of CheckMode.
#[derive(Deserialize)]
struct Name {
    name: String,
}

impl Mode {
    /// Returns the mode in which a robot starts.
    fn normal() -> Self {
        Mode("normal".to_owned())
    }

    pub fn is_released(&self) -> bool {
        self.0.is_empty()
    }

    fn set(&mut self, name: String) -> (i32, String) {
        self.0 = name;
        (0, String::new())
    }

    /// Answers a request: code and data.
    pub fn answer(&mut self, function: i64, parameter: &str) -> (i32, String) {
        match function {
            CHECK_MODE => (0, serde_json::json!({"form": "0", "name": self.0}).to_string()),
            SELECT_MODE => match serde_json::from_str(parameter) {
                Ok(Name { name }) => self.set(name),
                Err(_) => (BAD_PARAMETER, String::new()),
            },
            RELEASE_MODE => self.set(String::new()),
            _ => (NOT_IMPLEMENTED, String::new()),
        }
    }
}

/// Answers requests until it is dropped; calls `changed` with the mode after each request to the switcher. The robot's own controller
/// accepts every request until it is released; then it does not answer.
pub fn serve(node: &Node, mut changed: impl FnMut(&Mode) + Send + 'static) -> Result<impl Sized> {
    let mode = Arc::new(Mutex::new(Mode::normal()));
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
) -> Result<Subscription<Request>> {
    let [requests, responses] = topics(service);
    let responses: Publisher<Response> = node.publish(&responses, RESPONSE, Delivery::Reliable)?;
    let (sender, arrived) = channel::<Request>();
    // Answered in a thread of its own: a listener must not wait for a writer of the same participant.
    std::thread::spawn(move || {
        for Request { header, parameter, .. } in arrived {
            let answer = answer(header.identity.api_id, &parameter).filter(|_| !header.policy.noreply);
            let Some((code, data)) = answer else { continue };
            let header = ResponseHeader { identity: header.identity, status: Status { code } };
            // A client that is gone gets no answer.
            let _ = responses.send(Response { header, data, binary: Vec::new() });
        }
    });
    node.listen(&requests, REQUEST, Delivery::Reliable, move |arrival: Arrival<Request>| {
        let _ = sender.send(arrival.message);
    })
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
    pub fn new(node: &Node) -> Result<Self> {
        let (sender, responses) = channel();
        let [requests, replies] = topics(SWITCHER);
        let take = move |arrival: Arrival<Response>| drop(sender.send(arrival.message));
        let _listening = node.listen(&replies, RESPONSE, Delivery::Reliable, take)?;
        Ok(Client { requests: node.publish(&requests, REQUEST, Delivery::Reliable)?, responses, _listening, id: 0 })
    }

    fn call(&mut self, function: i64) -> Result<String> {
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
                let ResponseHeader { identity, status: Status { code } } = response.header;
                if identity.api_id == function && identity.id <= self.id {
                    ensure!(code == 0, "motion_switcher refuses function {function} with code {code}");
                    return Ok(response.data);
                }
            }
        }
        bail!(
            "motion_switcher does not answer within {} s: is the robot on, and its firmware 1.0.24 or newer? A simulator without this \
             service needs --no-release",
            TIMEOUT.as_secs()
        )
    }

    /// Returns the name of the robot's mode; empty if it has been released.
    fn mode(&mut self) -> Result<String> {
        let data = self.call(CHECK_MODE)?;
        let name = serde_json::from_str(&data).map(|Name { name }| name);
        name.map_err(|_| anyhow!("motion_switcher answers '{data}', expected JSON with a name"))
    }

    /// Releases the robot's own controller, and returns the mode in which the robot was; empty if it had none, or if `stop` comes first.
    pub fn release(&mut self, stop: &AtomicBool) -> Result<String> {
        let first = self.mode()?;
        let mut mode = first.clone();
        for _ in 0..RELEASES {
            if mode.is_empty() || stop.load(Ordering::Relaxed) {
                return Ok(if mode.is_empty() { first } else { String::new() });
            }
            self.call(RELEASE_MODE)?;
            mode = self.mode()?;
            std::thread::sleep(Duration::from_secs(u64::from(!mode.is_empty())));
        }
        ensure!(
            mode.is_empty(),
            "the robot stays in mode '{mode}' after {RELEASES} releases: switch its services off in the vendor's app"
        );
        Ok(first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mode_is_checked_selected_and_released() {
        let mut mode = Mode::normal();
        assert_eq!(mode.answer(CHECK_MODE, ""), (0, r#"{"form":"0","name":"normal"}"#.to_owned()));
        assert_eq!(mode.answer(RELEASE_MODE, ""), (0, String::new()));
        assert!(mode.is_released());
        assert_eq!(mode.answer(SELECT_MODE, r#"{"name": "ai"}"#), (0, String::new()));
        assert_eq!(mode.answer(CHECK_MODE, ""), (0, r#"{"form":"0","name":"ai"}"#.to_owned()));
        assert_eq!(mode.answer(SELECT_MODE, "ai").0, BAD_PARAMETER);
        assert_eq!(mode.answer(1009, "").0, NOT_IMPLEMENTED);
    }
}
