/*! The targets of `tests/fuzz`, guided by coverage: libFuzzer's mutations and ours, in turn.

One process is about one target, `SUPPLE_FUZZ_TARGET`; with `SUPPLE_FUZZ_SEEDS` it writes that target's seeds into a folder and its
words into a dictionary beside it, and ends; with `SUPPLE_FUZZ_KEEP` it packs the smallest inputs of a folder into the repository.
*/
#![no_main]

mod mutate;
#[path = "../../tests/fuzz/targets.rs"]
mod targets;

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};
use rand::RngExt;
use supple::util::files::write_atomically;
use supple::util::random::{Purpose, stream};

use targets::{TARGETS, Target};

/// The repository.
const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

/// Maximum size of a target's corpus in the repository \[bytes\].
const MAX_KEPT_BYTES: usize = 32 << 10;

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("SUPPLE_FUZZ_TARGET").expect("SUPPLE_FUZZ_TARGET");
    TARGETS.iter().find(|target| target.name == name).expect("a target of tests/fuzz")
});

fn write_seeds(folder: &Path) {
    for (index, seed) in (TARGET.seeds)().iter().chain(&TARGET.corpus()).enumerate() {
        std::fs::write(folder.join(format!("seed{index}")), seed).expect("a file");
    }
    let quoted = |word: &String| -> String { word.bytes().map(|byte| format!("\\x{byte:02x}")).collect() };
    let words: String = mutate::words(TARGET.name).iter().map(|word| format!("\"{}\"\n", quoted(word))).collect();
    std::fs::write(folder.with_extension("words"), words).expect("a file");
}

/// Keeps as many of the smallest inputs as fit in the corpus of the repository.
fn keep(folder: &Path) {
    let files = std::fs::read_dir(folder).expect("a folder").map(|file| std::fs::read(file.expect("a file").path()));
    let mut inputs = files.collect::<Result<Vec<_>, _>>().expect("files");
    inputs.sort_by_key(|input| (input.len(), input.clone()));
    let mut packed = Vec::new();
    for input in inputs {
        if packed.len() + 4 + input.len() > MAX_KEPT_BYTES {
            break;
        }
        packed.extend(u32::try_from(input.len()).expect("inputs are small").to_le_bytes());
        packed.extend(input);
    }
    write_atomically(&TARGET.corpus_file(), &packed).expect("a file");
}

fuzz_target!(
    init: {
        if let Ok(folder) = std::env::var("SUPPLE_FUZZ_KEEP") {
            keep(Path::new(&folder));
            std::process::exit(0);
        }
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
    let mutated = mutate::mutated(TARGET.name, &data[..size], &mut rng);
    let length = mutated.len().min(max_size);
    data[..length].copy_from_slice(&mutated[..length]);
    length
});
