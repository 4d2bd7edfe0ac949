//! Tables of plain text, as wide as a terminal.

use super::Report;
use super::markdown::{self, used_columns};

/// The columns between two cells.
const GAP: usize = 2;

/// The width of the column with the experiment and the gap after it.
const INDENT: usize = 6;

/// Returns the claims of a report, each with the numbers of all sets, their difference and the verdict below it. Lines have at most `width`
/// characters where the words allow it. The paper's numbers and relative changes are in the files.
pub fn claims(report: &Report, width: usize) -> String {
    let (columns, rows) = markdown::claim_rows(report);
    let numbers = |row: &Vec<String>| [&row[3..row.len() - 2], &row[row.len() - 1..]].concat();
    // Intervals are not broken, and verdicts are without their reasons.
    let short = |cell: &String| cell.split(':').next().unwrap_or_default().replace(", ", ",\u{a0}");
    let short = |row: &Vec<String>| numbers(row).iter().map(short).collect();
    let numbers: Vec<_> = std::iter::once(numbers(&columns)).chain(rows.iter().map(short)).collect();
    let mut numbers = laid_out(&numbers, width.saturating_sub(INDENT)).into_iter();
    let head = numbers.next().into_iter().flatten();
    let mut text = if report.has_too_few_pairs() { format!("{}\n\n", super::TOO_FEW) } else { String::new() };
    text.extend(head.map(|line| format!("{:INDENT$}{line}\n", "")));
    for (row, numbers) in rows.iter().zip(numbers) {
        let claim = lines(&row[1], width.saturating_sub(INDENT));
        for (id, line) in std::iter::once(&*row[0]).chain(std::iter::repeat("")).zip(claim.into_iter().chain(numbers)) {
            text.push_str(&format!("{id:<INDENT$}{line}\n"));
        }
    }
    text.replace('\u{a0}', " ")
}

/// Returns rows as a table without its empty columns, in lines of at most `width` characters. Cells that do not fit are broken
/// between words, in the widest columns first.
pub fn table(rows: &[Vec<String>], width: usize) -> String {
    laid_out(rows, width).into_iter().flatten().map(|line| line + "\n").collect()
}

/// Returns the lines of each row of a table.
fn laid_out(rows: &[Vec<String>], width: usize) -> Vec<Vec<String>> {
    let used = used_columns(rows.first().map_or(0, Vec::len), rows.get(1..).unwrap_or_default());
    let length = |text: &str| text.chars().count();
    let longest_word = |cell: &str| cell.split(' ').map(length).max().unwrap_or(0);
    let widest = |of: &dyn Fn(&str) -> usize| -> Vec<usize> {
        used.iter().map(|column| rows.iter().map(|row| of(&row[*column])).max().unwrap_or(0)).collect()
    };
    let (mut widths, least) = (widest(&length), widest(&longest_word));
    while widths.iter().sum::<usize>() + GAP * widths.len().saturating_sub(1) > width {
        let shrinkable = (0..widths.len()).filter(|column| widths[*column] > least[*column]);
        let Some(column) = shrinkable.max_by_key(|column| widths[*column]) else { break };
        widths[column] -= 1;
    }
    let of_row = |row: &Vec<String>| {
        let cells: Vec<_> = used.iter().zip(&widths).map(|(column, width)| lines(&row[*column], *width)).collect();
        let line = |index: usize| {
            let parts = cells.iter().map(|cell| cell.get(index).map_or("", String::as_str)).zip(&widths);
            let parts: Vec<String> = parts.map(|(part, width)| format!("{part:<width$}")).collect();
            parts.join(&" ".repeat(GAP)).trim_end().to_owned()
        };
        (0..cells.iter().map(Vec::len).max().unwrap_or(0)).map(line).collect()
    };
    rows.iter().map(of_row).collect()
}

/// Breaks a text between words into lines of at most `width` characters, as far as its words are no longer.
fn lines(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_fits_its_width() {
        let row = |cells: [&str; 4]| cells.map(ToOwned::to_owned).to_vec();
        let rows = [row(["", "claim", "", "a"]), row(["E1", "takes a longer time", "", "0.5 s"])];
        assert_eq!(table(&rows, 80), "    claim                a\nE1  takes a longer time  0.5 s\n");
        assert_eq!(table(&rows, 22), "    claim        a\nE1  takes a      0.5 s\n    longer time\n");
        // No word is broken.
        assert_eq!(table(&rows, 3), "    claim   a\nE1  takes   0.5\n    a       s\n    longer\n    time\n");
    }
}
