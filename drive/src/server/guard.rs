//! Access control: host, origin, token and content security policy.

use std::fmt;
use std::net::IpAddr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, HOST, ORIGIN, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::Shared;
use super::connections::Connection;

/// Returns the content security policy: pages may load and contact this server only. The exceptions are for rerun's viewer,
/// which compiles WebAssembly, sets styles (egui) and is loaded from this server's other name.
fn policy(port: u16) -> String {
    let ours = format!("'self' http://localhost:{port} http://127.0.0.1:{port}");
    format!(
        "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; \
         img-src 'self' data: blob:; connect-src 'self'; frame-src {ours}; frame-ancestors {ours}; base-uri 'none'; \
         form-action 'none'"
    )
}

/// The secret in the printed address; sockets require it.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct Token(pub(super) String);

impl Token {
    /// Draws a token of 128 random bits.
    pub fn random() -> Self {
        Token(format!("{:032x}", rand::random::<u128>()))
    }

    /// Compares the token in constant time.
    fn is(&self, other: &str) -> bool {
        let differences = self.0.bytes().zip(other.bytes()).fold(0, |found, (a, b)| found | (a ^ b));
        self.0.len() == other.len() && differences == 0
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token")
    }
}

/// Refuses requests with a wrong host, origin or token, and adds the security headers.
pub(super) async fn check(State(shared): State<Shared>, request: Request, next: Next) -> Response {
    let is_socket = matches!(request.uri().path(), "/control" | "/view");
    let mut response = match refusal(&shared, &request, is_socket) {
        Some(reason) => (StatusCode::FORBIDDEN, reason).into_response(),
        None => next.run(request).await,
    };
    let headers = response.headers_mut();
    if let Ok(policy) = HeaderValue::from_str(&policy(shared.port)) {
        headers.insert(CONTENT_SECURITY_POLICY, policy);
    }
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.entry(CACHE_CONTROL).or_insert(HeaderValue::from_static("no-cache"));
    response
}

fn refusal(shared: &Shared, request: &Request, is_socket: bool) -> Option<&'static str> {
    let Some(host) = host(request.headers(), shared.port) else {
        return Some("open this page by IP address (as printed at start), not by host name\n");
    };
    let token = request.uri().query().and_then(|query| query.split('&').find_map(|pair| pair.strip_prefix("token=")));
    let has_token = token.is_some_and(|token| shared.token.is(token));
    if let Some(connection) = request.extensions().get::<Arc<Connection>>().filter(|_| has_token) {
        connection.trust();
    }
    if !is_socket {
        return None;
    }
    if single(request.headers(), ORIGIN.as_str()) != Some(&format!("http://{host}")) {
        return Some("this socket accepts only pages of this server\n");
    }
    if !has_token {
        return Some("the token is missing or wrong: open the address printed at start\n");
    }
    None
}

/// Returns the requested host if it is localhost or an IP address with our port (guards against DNS rebinding).
fn host(headers: &HeaderMap, port: u16) -> Option<&str> {
    let host = single(headers, HOST.as_str())?;
    // Browsers leave out the port of HTTP.
    let name = host.strip_suffix(&format!(":{port}")).or((port == 80).then_some(host))?;
    let name = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name);
    (name == "localhost" || name.parse::<IpAddr>().is_ok()).then_some(host)
}

fn single<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    let mut values = headers.get_all(name).iter();
    let value = values.next()?.to_str().ok()?;
    values.next().is_none().then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_ip_addresses_with_our_port_are_hosts() {
        let of = |values: &[&str]| {
            let mut headers = HeaderMap::new();
            for value in values {
                headers.append(HOST, value.parse().unwrap());
            }
            host(&headers, 9100).is_some()
        };
        for good in ["127.0.0.1:9100", "localhost:9100", "[::1]:9100", "192.168.1.7:9100"] {
            assert!(of(&[good]), "{good}");
        }
        for bad in ["evil.example", "localhost.evil.example", "", "127.0.0.1.nip.io"] {
            assert!(!of(&[&format!("{bad}:9100")]), "{bad}");
        }
        for bad in [&["127.0.0.1"][..], &["127.0.0.1:80"], &[""], &[], &["127.0.0.1:9100", "evil.example:9100"]] {
            assert!(!of(bad), "{bad:?}");
        }
    }

    #[test]
    fn token_matches_only_itself() {
        let token = Token::random();
        let text = token.0.clone();
        assert_eq!(text.len(), 32);
        assert!(token.is(&text));
        assert!(!token.is(&text[..31]) && !token.is("") && !token.is(&Token::random().0));
        assert!(!format!("{token:?}").contains(&text));
    }
}
