//! Numbers in the README are those of `research/results.md`.

use crate::support::repository;

/// How a row of the README begins, and the claim in the results that its numbers are of.
const ROWS: [(&str, &str); 5] = [
    (
        "| a sideways push of 0.5 m/s decays within |",
        "After a sideways push, compliant policies take longer to stabilise to 10 %:",
    ),
    ("| power in the second after it |", "After a push, compliant policies use less power:"),
    ("| a leash of 20 N changes the velocity by |", " Pulled with 20 N,"),
    ("| a box in the way (friction 1) is moved by |", "displace a box in their way less (friction 1):"),
    ("| pushes to ±1.5 m/s survived |", "The 80 % contour of push recovery"),
];

fn numbers(text: &str) -> Vec<&str> {
    text.split(|c: char| !(c.is_ascii_digit() || ".+−".contains(c))).filter(|word| !word.is_empty()).collect()
}

#[test]
fn every_number_of_the_readmes_table_is_that_of_its_claim_in_the_results() {
    let read = |path: &str| std::fs::read_to_string(repository(path)).unwrap();
    let (readme, results) = (read("README.md"), read("research/results.md"));
    for (row, claim) in ROWS {
        let row = readme.lines().find_map(|line| line.strip_prefix(row)).unwrap_or_else(|| panic!("no row {row}"));
        // The claim's number in its list is the first cell of its row in the table that follows.
        let mut rest = results.lines().skip_while(|line| !line.contains(claim));
        let number = rest.next().and_then(|line| line.split('.').next()).unwrap_or_else(|| panic!("no claim {claim}"));
        let claim = rest.find(|line| line.starts_with(&format!("| {number} |"))).unwrap();
        let known = numbers(claim);
        let found = numbers(row);
        assert!(found.len() > 4, "{row}");
        for number in found {
            assert!(known.contains(&number), "{number} of '{row}' is not in '{claim}'");
        }
    }
}
