//! Blind mutation that knows words, numbers and lines.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Longer inputs are cut.
const MAX_LENGTH: usize = 1 << 16;

/// Numbers on which programs trip.
const NUMBERS: [&str; 22] = [
    "0",
    "-0",
    "1",
    "-1",
    "2",
    "0.5",
    "1e-9",
    "1e9",
    "1e308",
    "1e400",
    "-1e308",
    "nan",
    ".nan",
    "inf",
    ".inf",
    "-.inf",
    "255",
    "65536",
    "2147483648",
    "4294967296",
    "18446744073709551616",
    "0x10",
];

/// One of the corpus, changed in one to four places.
pub fn mutate(corpus: &[Vec<u8>], words: &[&str], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut input = pick(corpus, rng).clone();
    for _ in 0..rng.random_range(1..=4) {
        change(&mut input, corpus, words, rng);
        input.truncate(MAX_LENGTH);
    }
    input
}

fn pick<'a, T>(from: &'a [T], rng: &mut ChaCha8Rng) -> &'a T {
    &from[rng.random_range(0..from.len())]
}

fn change(input: &mut Vec<u8>, corpus: &[Vec<u8>], words: &[&str], rng: &mut ChaCha8Rng) {
    let at = rng.random_range(0..=input.len());
    let until = (at + rng.random_range(0..=32)).min(input.len());
    match rng.random_range(0..10) {
        0 if at < input.len() => input[at] ^= 1 << rng.random_range(0..8),
        1 if at < input.len() => input[at] = rng.random(),
        2 => drop(input.drain(at..until)),
        3 => {
            let piece = input[at..until].to_vec();
            let copies = rng.random_range(1..=8);
            input.splice(at..at, piece.repeat(copies));
        }
        4 => {
            let other = pick(corpus, rng);
            let from = rng.random_range(0..=other.len());
            let piece = &other[from..(from + rng.random_range(0..=64)).min(other.len())];
            input.splice(at..until, piece.iter().copied());
        }
        5 => drop(input.splice(at..at, pick(words, rng).bytes())),
        6 => replace_run(input, at, rng, u8::is_ascii_alphanumeric, words),
        7 | 8 => replace_run(input, at, rng, |byte| byte.is_ascii_digit() || b".-+e".contains(byte), &NUMBERS),
        _ => swap_lines(input, rng),
    }
}

/// Replaces the next run of bytes of a kind after `at`.
fn replace_run(input: &mut Vec<u8>, at: usize, rng: &mut ChaCha8Rng, kind: impl Fn(&u8) -> bool, by: &[&str]) {
    let Some(start) = (at..input.len()).find(|index| kind(&input[*index])) else { return };
    let end = (start..input.len()).find(|index| !kind(&input[*index])).unwrap_or(input.len());
    input.splice(start..end, pick(by, rng).bytes());
}

fn swap_lines(input: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    let mut lines: Vec<Vec<u8>> = input.split(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
    let (a, b) = (rng.random_range(0..lines.len()), rng.random_range(0..lines.len()));
    match rng.random_range(0..3) {
        0 => lines.swap(a, b),
        1 => drop(lines.remove(a)),
        _ => {
            let copy = lines[a].clone();
            lines.insert(b, copy);
        }
    }
    *input = lines.join(&b'\n');
}
