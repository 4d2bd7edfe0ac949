//! The files of the page and of rerun's viewer, embedded in the program.

use std::sync::OnceLock;

use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use re_web_viewer_server::WebViewerData;

use super::Routes;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// The page: path, type, text.
const PAGE: &[(&str, &str, &str)] = &[
    ("/", HTML, include_str!("../../page/index.html")),
    ("/style.css", CSS, include_str!("../../page/style.css")),
    ("/main.js", SCRIPT, include_str!("../../page/main.js")),
    ("/link.js", SCRIPT, include_str!("../../page/link.js")),
    ("/command.js", SCRIPT, include_str!("../../page/command.js")),
    ("/pad.js", SCRIPT, include_str!("../../page/pad.js")),
    ("/numbers.js", SCRIPT, include_str!("../../page/numbers.js")),
    ("/compliance.js", SCRIPT, include_str!("../../page/compliance.js")),
    ("/viewer.html", HTML, include_str!("../../page/viewer.html")),
    ("/viewer.js", SCRIPT, include_str!("../../page/viewer.js")),
];

/// A file of rerun's viewer: path, type, content.
type Part = (&'static str, &'static str, fn(&WebViewerData) -> &[u8]);

const VIEWER: &[Part] = &[
    ("/rerun/re_viewer.js", SCRIPT, WebViewerData::viewer_js),
    ("/rerun/re_viewer_bg.wasm", "application/wasm", WebViewerData::viewer_wasm),
    ("/favicon.ico", "image/x-icon", WebViewerData::favicon),
];

pub(super) fn routes() -> Routes {
    let page = |routes: Routes, (path, kind, text): &(&'static str, &'static str, &'static str)| {
        let (kind, text) = (*kind, *text);
        routes.route(path, get(move || async move { ([(CONTENT_TYPE, kind)], text) }))
    };
    let part = |routes: Routes, (path, kind, bytes): &Part| {
        let (kind, bytes) = (*kind, *bytes);
        routes.route(path, get(move || async move { viewer_file(kind, bytes) }))
    };
    let routes = PAGE.iter().fold(Routes::new(), page);
    VIEWER.iter().fold(routes, part)
}

fn viewer_file(kind: &'static str, bytes: fn(&WebViewerData) -> &[u8]) -> Response {
    static DATA: OnceLock<Option<WebViewerData>> = OnceLock::new();
    match DATA.get_or_init(|| WebViewerData::load(None).ok()) {
        // 40 MB that change only with the program.
        Some(data) => ([(CONTENT_TYPE, kind), (CACHE_CONTROL, "max-age=3600")], bytes(data)).into_response(),
        None => (StatusCode::NOT_FOUND, "this program was built without rerun's web viewer\n").into_response(),
    }
}
