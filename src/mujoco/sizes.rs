/*! Limits on the sizes that an MJCF text may ask for.

An MJCF text states the size of a height field, a texture or a buffer, and the number of solver iterations, and MuJoCo
allocates and iterates as stated: one typing error costs all memory and minutes, where no error handler helps. Such
numbers are refused before MuJoCo sees the text, and so are references to other files than the given ones.
*/

use crate::util::xml::Element;

/// Limited attributes: element, attributes, and the largest product of their numbers.
const LIMITS: [(&str, &str, f64); 23] = [
    ("hfield", "nrow", 4_096.0),
    ("hfield", "ncol", 4_096.0),
    ("texture", "width", 8_192.0),
    ("texture", "height", 8_192.0),
    ("composite", "count", 1_000.0),
    ("flexcomp", "count", 1_000.0),
    ("skin", "subgrid", 10.0),
    ("numeric", "size", 100_000.0),
    ("user", "dim", 1_000.0),
    // Of rows, MuJoCo keeps a square matrix.
    ("size", "njmax", 10_000.0),
    ("size", "nconmax", 100_000.0),
    ("size", "nkey", 1_000.0),
    ("size", "nuserdata", 1e6),
    ("size", "nstack", 1e8),
    ("size", "memory", 4e9),
    ("option", "iterations", 10_000.0),
    ("option", "noslip_iterations", 10_000.0),
    ("option", "mpr_iterations", 10_000.0),
    ("option", "ccd_iterations", 10_000.0),
    ("option", "ls_iterations", 10_000.0),
    ("option", "sdf_iterations", 10_000.0),
    ("option", "sdf_initpoints", 10_000.0),
    ("lengthrange", "inttotal", 1_000.0),
];

/// Limit of the copies that `replicate` makes of what is in it, and of replicates in one another.
const COPIES: f64 = 1_000.0;

/// Prefix and limit of the attributes that add numbers to each body, joint and so on: `nuser_body` and its like.
const PER_ELEMENT: (&str, f64) = ("nuser_", 100.0);

/// The reason why an MJCF tree is not passed to MuJoCo.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum SizeError {
    #[error("{attribute} is '{found}', expected at most {limit}")]
    Beyond { attribute: String, found: String, limit: f64 },
    #[error("it includes '{0}', which is not among the given files")]
    Include(String),
}

/// Checks that an MJCF tree does not ask for more memory or time than any scene needs.
pub(crate) fn check_sizes(element: &Element) -> Result<(), SizeError> {
    check_copied(element, 1.0)
}

/// Checks an element of which there will be some copies.
fn check_copied(element: &Element, mut copies: f64) -> Result<(), SizeError> {
    if let ("replicate", Some(count)) = (element.name.as_str(), element.get("count")) {
        copies *= leading_number(count);
        if copies > COPIES {
            return Err(SizeError::Beyond { attribute: "count".into(), found: count.to_owned(), limit: COPIES });
        }
    }
    for (name, value) in &element.attributes {
        let own = LIMITS.iter().find(|(of, limited, _)| *of == element.name && limited == name);
        let user = name.starts_with(PER_ELEMENT.0).then_some(PER_ELEMENT.1);
        let Some(limit) = own.map(|(_, _, limit)| *limit).or(user) else { continue };
        let product: f64 = value.split_whitespace().map(leading_number).product();
        if product > limit {
            return Err(SizeError::Beyond { attribute: name.clone(), found: value.clone(), limit });
        }
    }
    element.children.iter().try_for_each(|child| check_copied(child, copies))
}

/// Checks that an MJCF tree includes no other files than the given ones.
pub(crate) fn check_includes(element: &Element, given: &[&str]) -> Result<(), SizeError> {
    if let ("include", Some(file)) = (element.name.as_str(), element.get("file"))
        && !given.contains(&file)
    {
        return Err(SizeError::Include(file.to_owned()));
    }
    element.children.iter().try_for_each(|child| check_includes(child, given))
}

/// Parses a whole number as MuJoCo does: digits up to the first other character. A memory may have one of the letters behind it.
fn leading_number(word: &str) -> f64 {
    let word = word.strip_prefix('+').unwrap_or(word);
    let end = word.find(|character: char| !character.is_ascii_digit()).unwrap_or(word.len());
    let letter = word[end..].chars().next().and_then(|letter| "KMGTP".find(letter.to_ascii_uppercase()));
    let unit = letter.map_or(1.0, |power| 1024_f64.powi(power as i32 + 1));
    word[..end].parse().map_or(1.0, |number: f64| unit * number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::util::xml::parse;

    fn check(text: &str) -> Result<(), SizeError> {
        check_sizes(&parse(text).unwrap())
    }

    #[test]
    fn sizes_beyond_reason_are_refused_by_name_and_others_pass() {
        let refused = check(r#"<asset><hfield name="g" nrow="2147483641e400" ncol="5"/></asset>"#).unwrap_err();
        assert_eq!(refused.to_string(), "nrow is '2147483641e400', expected at most 4096");
        for bad in [
            "<composite type='cloth' count = '100 100 1'/>",
            "<size nuser_body='2147483647'/>",
            "<size nuser_cam='+2147483647'/>",
            "<size nkey='1000000'/>",
            "<option iterations='2147483647'/>",
            "<option noslip_iterations='2147483647'/>",
            "<numeric name='n' size='2147483647'/>",
            "<size memory='5G'/>",
            "<option ccd_iterations='2147483647'/>",
            "<replicate count='40'><body><replicate count='40'/></body></replicate>",
        ] {
            assert!(check(bad).is_err(), "{bad}");
        }
        for fine in [
            r#"<hfield nrow="300" ncol="600"/>"#,
            r#"<body name="nrow"/>"#,
            "<a><!-- nrow='2147483647' --></a>",
            "<composite\tcount='9 9 9'/>",
            "<size memory='15M'/>",
            "<worldbody><replicate count='40'/><replicate count='40'/></worldbody>",
            "<geom size='2147483647'/>",
        ] {
            assert_eq!(check(fine), Ok(()), "{fine}");
        }
    }

    #[test]
    fn files_beside_those_that_are_given_are_not_read() {
        let text = parse("<mujoco><include file='robot.xml'/></mujoco>").unwrap();
        assert_eq!(check_includes(&text, &["scene.xml", "robot.xml"]), Ok(()));
        assert!(check_includes(&text, &["scene.xml"]).is_err());
    }
}
