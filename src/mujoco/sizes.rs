/*! Sizes that MuJoCo takes at their word.

An MJCF text says how large a height field, a texture or a buffer is, and MuJoCo 2.2.2 allocates and fills just that: a
slip of the keyboard costs all memory and minutes, where no error handler helps. Such sizes are refused before MuJoCo
sees the text. A guard against accidents: it reads attributes, not XML.
*/

/// Attributes, and the largest product of the numbers in one.
const LIMITS: [(&str, f64); 10] = [
    ("nrow", 4_096.0),
    ("ncol", 4_096.0),
    ("width", 16_384.0),
    ("height", 16_384.0),
    ("count", 100_000.0),
    ("njmax", 1e6),
    ("nconmax", 1e6),
    ("nkey", 1e6),
    ("nuserdata", 1e6),
    ("nstack", 1e9),
];

/// Refuses a text that asks for more than any scene needs.
///
/// # Errors
/// In words: the attribute, what was found and expected.
pub fn check(text: &str) -> Result<(), String> {
    for (name, limit) in LIMITS {
        for (start, _) in text.match_indices(name) {
            let Some(value) = attribute(text, start, name.len()) else { continue };
            let product: f64 = value.split_whitespace().map(leading_number).product();
            if product > limit {
                return Err(format!("{name} is '{value}', expected at most {limit}"));
            }
        }
    }
    Ok(())
}

/// The value of the attribute whose name starts at `start`, if it is one.
fn attribute(text: &str, start: usize, length: usize) -> Option<&str> {
    let (before, after) = (&text[..start], &text[start + length..]);
    if !before.ends_with(|character: char| character.is_whitespace() || "\"'".contains(character)) {
        return None;
    }
    let value = after.trim_start().strip_prefix('=')?.trim_start();
    let quote = value.chars().next().filter(|character| "\"'".contains(*character))?;
    value[1..].split(quote).next()
}

/// As the parser reads a whole number: digits up to whatever comes then.
fn leading_number(word: &str) -> f64 {
    let end = word.find(|character: char| !character.is_ascii_digit()).unwrap_or(word.len());
    word[..end].parse().unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_beyond_reason_are_refused_by_name_and_others_pass() {
        let refused = check(r#"<hfield name="g" nrow="2147483641e400" ncol="5"/>"#).unwrap_err();
        assert_eq!(refused, "nrow is '2147483641e400', expected at most 4096");
        assert!(check("<composite type='cloth' count = '1000 1000 1'/>").is_err());
        for fine in [
            r#"<hfield nrow="300" ncol="600"/>"#,
            r#"<body name="nrow"/>"#,
            "ncol",
            r#"count=""#,
            "<a\tcount='9 9 9'/>",
        ] {
            assert_eq!(check(fine), Ok(()), "{fine}");
        }
    }
}
