//! Mutations that know words, numbers and lines, and the header of a safetensors file.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Longer inputs are cut.
const MAX_LENGTH: usize = 1 << 16;

/// Words that the files of targets consist of, and numbers on which programs trip.
static WORDS: LazyLock<BTreeMap<String, Vec<String>>> =
    LazyLock::new(|| serde_json::from_str(include_str!("words.json")).expect("lists of words"));

/// Returns the words that the files of a target consist of.
pub fn words(target: &str) -> &'static [String] {
    match target {
        "config" | "scenario" => &WORDS["yaml"],
        "checkpoint" | "policy" | "contact" | "session" => &WORDS["json"],
        other => &WORDS[other],
    }
}

/// Header and tensors of a safetensors file.
fn header(file: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = file.split_first_chunk::<8>()?;
    rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)
}

/// Changes an input somewhere; three times of four within the header, if the target reads safetensors files.
pub fn mutated(target: &str, whole: &[u8], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let framed = ["checkpoint", "policy", "contact"].contains(&target) && rng.random_range(0..4) > 0;
    match header(whole).filter(|_| framed) {
        Some((header, tensors)) => {
            let header = mutate(header, words(target), rng);
            [&(header.len() as u64).to_le_bytes()[..], &header, tensors].concat()
        }
        None => mutate(whole, words(target), rng),
    }
}

/// An input, changed in one to four places.
fn mutate(whole: &[u8], words: &[String], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut input = whole.to_vec();
    for _ in 0..rng.random_range(1..=4) {
        change(&mut input, whole, words, rng);
        input.truncate(MAX_LENGTH);
    }
    input
}

fn pick<'a, T>(from: &'a [T], rng: &mut ChaCha8Rng) -> &'a T {
    &from[rng.random_range(0..from.len())]
}

fn change(input: &mut Vec<u8>, whole: &[u8], words: &[String], rng: &mut ChaCha8Rng) {
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
            let from = rng.random_range(0..=whole.len());
            let piece = &whole[from..(from + rng.random_range(0..=64)).min(whole.len())];
            input.splice(at..until, piece.iter().copied());
        }
        5 => drop(input.splice(at..at, pick(words, rng).bytes())),
        6 => replace_run(input, at, rng, u8::is_ascii_alphanumeric, words),
        7 | 8 => replace_run(input, at, rng, |byte| byte.is_ascii_digit() || b".-+e".contains(byte), &WORDS["numbers"]),
        _ => swap_lines(input, rng),
    }
}

/// Replaces the next run of bytes of a kind after `at`.
fn replace_run(input: &mut Vec<u8>, at: usize, rng: &mut ChaCha8Rng, kind: impl Fn(&u8) -> bool, by: &[String]) {
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
