/*! The targets of `tests/fuzz`, guided by coverage: libFuzzer's mutations and ours, in turn.

One process is about one target, `SUPPLE_FUZZ_TARGET`; with `SUPPLE_FUZZ_SEEDS` it writes that target's seeds into a folder and its
words into a dictionary beside it, and ends.
*/
#![no_main]

#[path = "../../tests/fuzz/mutate.rs"]
mod mutate;
#[path = "../../tests/fuzz/targets.rs"]
mod targets;

use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};
use rand::RngExt;
use supple::util::random::{Purpose, stream};

use targets::{TARGETS, Target};

/// The repository.
const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("SUPPLE_FUZZ_TARGET").expect("SUPPLE_FUZZ_TARGET");
    TARGETS.iter().find(|target| target.name == name).expect("a target of tests/fuzz")
});

fn write_seeds(folder: &Path) {
    for (index, seed) in TARGET.seeds().iter().enumerate() {
        std::fs::write(folder.join(format!("seed{index}")), seed).expect("a file");
    }
    let quoted = |word: &&str| -> String { word.bytes().map(|byte| format!("\\x{byte:02x}")).collect() };
    let words: String = TARGET.words.iter().map(|word| format!("\"{}\"\n", quoted(word))).collect();
    std::fs::write(folder.with_extension("words"), words).expect("a file");
}

fuzz_target!(
    init: {
        if let Ok(folder) = std::env::var("SUPPLE_FUZZ_SEEDS") {
            write_seeds(Path::new(&folder));
            std::process::exit(0);
        }
    },
    |input: &[u8]| {
        (TARGET.run)(input);
    }
);

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let mut rng = stream(seed.into(), Purpose::Scenario, 0, 2);
    if rng.random() {
        return fuzzer_mutate(data, size, max_size);
    }
    let mutated = TARGET.mutated(&data[..size], rng.random_range(0..4) > 0, &mut rng);
    let length = mutated.len().min(max_size);
    data[..length].copy_from_slice(&mutated[..length]);
    length
});
