//! Mutations that know words, numbers and lines, and the header of a safetensors file.

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

/// Returns the words that the files of a target consist of.
pub fn words(target: &str) -> &'static [&'static str] {
    match target {
        "config" | "scenario" => YAML_WORDS,
        "checkpoint" | "policy" | "contact" | "session" => JSON_WORDS,
        "onnx" => ONNX_WORDS,
        "robot" => ROBOT_WORDS,
        "mjcf" => XML_WORDS,
        other => panic!("no words for target {other}"),
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
            let header = mutate(&[header.to_vec()], words(target), rng);
            [&(header.len() as u64).to_le_bytes()[..], &header, tensors].concat()
        }
        None => mutate(&[whole.to_vec()], words(target), rng),
    }
}

/// One of the corpus, changed in one to four places.
fn mutate(corpus: &[Vec<u8>], words: &[&str], rng: &mut ChaCha8Rng) -> Vec<u8> {
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

const YAML_WORDS: &[&str] = &[
    ": ",
    "\n",
    "\n  ",
    "- ",
    "[",
    "]",
    "{",
    "}",
    "&a ",
    "*a",
    "<<: *a",
    "!!binary ",
    "!x ",
    "null",
    "~",
    "true",
    "|\n",
    "\"",
    "'",
    "#",
    "---\n",
    "...\n",
    "? ",
    "base: compliant\n",
    "base: ",
    "\t",
    "%YAML 1.1\n",
    "ppo:\n",
    "perlin",
    "steps",
];
const JSON_WORDS: &[&str] = &[
    "{", "}", "[", "]", "\"", "\\\"", ":", ",", "null", "true", "[]", "{}", "\\u0000", "F16", "F64", "format", "[0,0]",
];
const XML_WORDS: &[&str] = &[
    "<body>",
    "</body>",
    "<geom type=\"box\" size=\"1 1 1\"/>",
    "<geom type=\"mesh\" mesh=\"m\"/>",
    "<freejoint/>",
    "<joint type=\"ball\"/>",
    "<joint/>",
    "type=\"hfield\"",
    "type=\"capsule\"",
    "type=\"ellipsoid\"",
    "fromto=\"0 0 0 1 1 1\"",
    "euler=\"1 2 3\"",
    "quat=\"0 0 0 0\"",
    "mass=\"0\"",
    "<inertial pos=\"0 0 0\" mass=\"1\" diaginertia=\"1 1 9\"/>",
    "name=\"\"",
    "class=\"x\"",
    "childclass=\"main\"",
    "<site/>",
    "<camera/>",
    "<light/>",
    "<include file=\"f.xml\"/>",
    "<!--",
    "-->",
    "&amp;",
    "<![CDATA[",
    "<composite type=\"grid\" count=\"3 3 1\" spacing=\"0.1\"/>",
    "<replicate/>",
    "mocap=\"true\"",
    "<?xml?>",
    "range=\"1 -1\"",
    "limited=\"true\"",
    "damping=\"1\"",
    "armature=\"1\"",
    "condim=\"6\"",
    "solref=\"0 0\"",
    "margin=\"1\"",
    "/>",
    "\"",
    "=",
];

const ONNX_WORDS: &[&str] = &[
    "Gemm",
    "MatMul",
    "Add",
    "Elu",
    "Tanh",
    "Relu",
    "Reshape",
    "Concat",
    "Slice",
    "Gather",
    "Split",
    "Shape",
    "Cast",
    "axis",
    "transB",
    "alpha",
    "obs",
    "actions",
    "\u{1}",
    "\u{7f}",
    "\u{0}\u{0}",
];
const ROBOT_WORDS: &[&str] = &[
    "<body>",
    "</body>",
    "<geom type=\"sphere\" size=\"0.02\"/>",
    "<joint axis=\"0 1 0\"/>",
    "<freejoint/>",
    "type=\"slide\"",
    "type=\"ball\"",
    "name=\"FR_foot\"",
    "<motor joint=\"FR_hip\"/>",
    "<position joint=\"FR_hip\" kp=\"1\"/>",
    "<default class=\"x\"/>",
    "class=\"x\"",
    "<key name=\"home\" qpos=\"0 0 1\"/>",
    "<tendon><fixed/></tendon>",
    "<include file=\"r.xml\"/>",
    "angle=\"degree\"",
    "autolimits=\"true\"",
    "range=\"1 -1\"",
    "mjcf: r.xml\n",
    "feet:\n",
    "joints:\n",
    "nominal_pose_rad: [0, 0, 0]\n",
    "torque_limits_n_m: [1, 1, 1]\n",
    "[",
    "]",
    "null",
];
