//! Paths as text: any path, even one that is not UTF-8, can be stored in configurations and reports.

use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::PathBuf;

/// Converts a path to text, which [`as_path`] converts back: bytes that are not UTF-8 become characters of a
/// private-use area.
pub fn as_text(path: impl AsRef<OsStr>) -> String {
    let mut text = String::new();
    let escape = |bytes: &[u8], text: &mut String| {
        text.extend(
            bytes.iter().map(|byte| char::from_u32(PRIVATE + u32::from(*byte)).unwrap_or(char::REPLACEMENT_CHARACTER)),
        );
    };
    for chunk in path.as_ref().as_bytes().utf8_chunks() {
        for character in chunk.valid().chars() {
            match private(character) {
                // It would be read as something else.
                Some(_) => escape(character.encode_utf8(&mut [0; 4]).as_bytes(), &mut text),
                None => text.push(character),
            }
        }
        escape(chunk.invalid(), &mut text);
    }
    text
}

/// Converts a text of [`as_text`] back to its path.
pub fn as_path(text: &str) -> PathBuf {
    let mut bytes = Vec::with_capacity(text.len());
    for character in text.chars() {
        match private(character) {
            Some(byte) => bytes.push(byte),
            None => bytes.extend_from_slice(character.encode_utf8(&mut [0; 4]).as_bytes()),
        }
    }
    OsString::from_vec(bytes).into()
}

/// Returns true if a character stands for a byte of a path that is not UTF-8, see [`as_text`].
pub fn is_byte(character: char) -> bool {
    private(character).is_some()
}

/// First of the 256 private-use characters that stand for bytes.
const PRIVATE: u32 = 0xf700;

fn private(character: char) -> Option<u8> {
    u8::try_from(u32::from(character).checked_sub(PRIVATE)?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_path_survives_as_text() {
        for path in [&b"a/b.yaml"[..], b"caf\xe9/\xff\xfe", "\u{f741}\u{f7ff}é".as_bytes(), b""] {
            let text = as_text(OsStr::from_bytes(path));
            assert_eq!(as_path(&text).as_os_str().as_bytes(), path);
        }
        assert_eq!(as_text("é/x"), "é/x");
    }
}
